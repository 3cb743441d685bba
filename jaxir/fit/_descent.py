"""The solver of fits: Levenberg and Marquardt's, which takes a Jacobian only where it has arrived.

With the singular values s_k and left and right vectors u_k, v_k of the Jacobian, its columns divided by the norms d
that they have at the start (Marquardt 1963), a step is

    d delta = - sum_k v_k s_k c_k / (s_k^2 + damping),    c_k = u_k . residual,

so damping means the same for all parameters, whatever their units, and one decomposition serves every damping that a
rejected step asks for. Where steps are `even`, d is 1 and the damping at first the loss over the square of `REACH`: far
from the solution, parameters that do little stay nearly where they are, which columns divided by their norms let go
astray, as the temperature of a cold face beside hot ones towards 0. The damping follows the ratio of the fall of the
loss to the predicted one as in Nielsen, "Damping parameter in Marquardt's method" (IMM-REP-1999-05, DTU, 1999).

|c| is the distance to the solution of the linearised problem in units of the residual: where residuals are in standard
deviations, so is it. Of each c_k counts what one natural step along v_k may change: at a bound, towards which a column
fades, the rest is out of reach. The solver stops there, not where a step is short, so a damped step far from the
solution ends nothing, and neither does a flat direction that the data do not determine keep it going.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jax import lax
from jaxtyping import Array, Bool, Float, PyTree

from jaxir._math import matmul

START = 1e-5  # damping at first, in units of the largest squared singular value
REACH = 0.3  # natural steps at first, where they are even
FLAT = 1e-3  # of the largest norm of a column: of a parameter that does less, a step would be all there is
LEAST_RATIO = 1e-3  # of the fall of the loss to the predicted one, for a step to be taken
NEARLY = 10  # tolerances from the solution within which a step that gains nothing tells rounding, and is the last


class _State(eqx.Module):
    """Where the solver stands: the point it tries next, and the linearised problem at the point it holds.

    `size` are the norms of the first Jacobian's columns.
    """

    trial: Float[Array, " p"]
    loss: Float[Array, ""]
    left: Float[Array, "row k"]
    singular: Float[Array, " k"]
    right: Float[Array, "k p"]
    size: Float[Array, " p"]
    along: Float[Array, " k"]
    damping: Float[Array, ""]
    growth: Float[Array, ""]
    predicted: Float[Array, ""]
    first: Bool[Array, ""]
    done: Bool[Array, ""]
    result: Any


class LevenbergMarquardt(optx.AbstractLeastSquaresSolver):
    """Damped Gauss-Newton steps; one evaluation each, and a Jacobian where the step was taken.

    Attributes:
        atol: distance from the solution at which to stop, in units of the residual.
        rtol: as `atol`, in units of the residual's norm.
        even: whether natural steps of all parameters are damped alike.
        norm: unused; optimistix asks for one.
    """

    atol: Any
    rtol: Any = 0.0
    even: Any = False
    norm: Callable[[PyTree], Any] = optx.two_norm

    def init(
        self, fn: Any, y: Any, args: Any, options: Any, f_struct: Any, aux_struct: Any, tags: frozenset[object]
    ) -> _State:
        """See `optimistix.AbstractIterativeSolver.init`."""
        rank = min(y.shape[0], f_struct.shape[0])
        zero = jnp.zeros((), y.dtype)
        return _State(
            trial=y,
            loss=zero,
            left=jnp.zeros((f_struct.shape[0], rank), y.dtype),
            singular=jnp.zeros(rank, y.dtype),
            right=jnp.zeros((rank, y.shape[0]), y.dtype),
            size=jnp.zeros_like(y),
            along=jnp.zeros(rank, y.dtype),
            damping=zero,
            growth=zero + 2,
            predicted=zero,
            first=jnp.array(True),
            done=jnp.array(False),
            result=optx.RESULTS.successful,
        )

    def step(
        self, fn: Any, y: Any, args: Any, options: Any, state: _State, tags: frozenset[object]
    ) -> tuple[Array, _State, Any]:
        """See `optimistix.AbstractIterativeSolver.step`."""
        residual, aux = fn(state.trial, args)
        loss = jnp.sum(residual * residual)
        ratio = (state.loss - loss) / jnp.where(state.first, 1, state.predicted)
        taken = state.first | (ratio > LEAST_RATIO)

        def linearised() -> tuple[Array, ...]:
            basis = jnp.eye(y.shape[0], dtype=y.dtype)
            jacobian = jax.vmap(lambda t: jax.jvp(lambda y: fn(y, args)[0], (state.trial,), (t,))[1], out_axes=1)(basis)
            size = jnp.where(state.first, jnp.sqrt(jnp.sum(jacobian * jacobian, axis=0)), state.size)
            left, singular, right = jnp.linalg.svd(jacobian / self._divisor(size)[None, :], full_matrices=False)
            return loss, left, singular, right, size, matmul(left.T, residual)

        held = state.loss, state.left, state.singular, state.right, state.size, state.along
        held_loss, left, singular, right, size, along = lax.cond(taken, linearised, lambda: held)
        shrunk = state.damping * jnp.maximum(1 / 3, 1 - (2 * jnp.minimum(ratio, 1) - 1) ** 3)
        damping = jnp.where(taken, shrunk, state.damping * state.growth)
        damping = jnp.where(state.first, self._first_damping(loss, singular), damping)
        square = singular * singular
        damped = square + damping
        ways = right / self._divisor(size)[None, :]
        delta = matmul(-(singular * along / jnp.where(damped > 0, damped, 1)), ways)
        left_over = damping / jnp.where(damped > 0, damped, 1)
        predicted = jnp.sum(along * along * (1 - left_over * left_over))
        tolerance = self.atol + self.rtol * jnp.sqrt(held_loss)
        seen = singular > jnp.finfo(y.dtype).eps * jnp.max(singular, initial=0)
        longest = jnp.max(jnp.abs(ways), axis=1)
        within = singular / jnp.where(longest > 0, longest, 1)  # of one natural step
        distance = jnp.linalg.norm(jnp.where(seen, jnp.minimum(jnp.abs(along), within), 0))
        near = distance <= NEARLY * tolerance
        arrived = (distance <= tolerance) | (near & ~taken)
        gains = predicted > tolerance * tolerance  # not where nothing is finite any more
        stuck = ~gains & ~(taken & jnp.isfinite(predicted))  # where a step was taken, the next is damped less
        here = jnp.where(taken, state.trial, y)
        return (
            here,
            _State(
                trial=here + delta,
                loss=held_loss,
                left=left,
                singular=singular,
                right=right,
                size=size,
                along=along,
                damping=damping,
                growth=jnp.where(taken, 2, 2 * state.growth),
                predicted=predicted,
                first=jnp.array(False),
                done=arrived | stuck,
                result=optx.RESULTS.where(stuck & ~near, optx.RESULTS.nonlinear_divergence, optx.RESULTS.successful),
            ),
            aux,
        )

    def terminate(
        self, fn: Any, y: Any, args: Any, options: Any, state: _State, tags: frozenset[object]
    ) -> tuple[Bool[Array, ""], optx.RESULTS]:
        """See `optimistix.AbstractIterativeSolver.terminate`."""
        return state.done, state.result

    def postprocess(
        self, fn: Any, y: Any, aux: Any, args: Any, options: Any, state: _State, tags: frozenset[object], result: Any
    ) -> tuple[Array, Any, dict[str, Any]]:
        """See `optimistix.AbstractIterativeSolver.postprocess`."""
        return y, aux, {}

    def _divisor(self, size: Float[Array, " p"]) -> Float[Array, " p"]:
        """Norms of columns, and a share of the largest of those that are less; 1 where there are none."""
        least = FLAT * jnp.max(size, initial=0)
        return jnp.where((least > 0) & ~jnp.asarray(self.even), jnp.maximum(size, least), 1)

    def _first_damping(self, loss: Float[Array, ""], singular: Float[Array, " k"]) -> Float[Array, ""]:
        return jnp.where(self.even, loss / REACH**2, START * jnp.max(singular, initial=0) ** 2)
