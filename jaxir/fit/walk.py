"""From starts to the solution of a prepared fit.

A first walk of the solver on logarithmic residuals leads near the solution, a second on the ordinary ones to it. Where
fewer rays lead, see `Observation`, the first walk is on those alone. The second then takes its slopes from them but its
residuals from all rays, so a step costs one evaluation of all rays and none ends where they say that it is worse; and
`settle` goes the rest, a fraction of a standard deviation, with the slopes of all rays, which the uncertainty needs
anyway.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax import lax
from jaxtyping import Array, Float

from jaxir._arrays import as_float
from jaxir.fit.descent import LevenbergMarquardt
from jaxir.fit.problem import Problem, Residual, value_and_jacobian, with_jacobian

NEAR, THERE = 0.1, 0.03  # distance from the solution at which walks end [standard deviations]
MISLED = 1.0  # distance at which fewer rays have led to the wrong place
SETTLING = 4  # steps of `settle` at most
DETERMINED = 1.0  # standard deviation in natural steps up to which `settle` moves a combination of parameters


class Walked(NamedTuple):
    """Where walks from all starts ended [start, p], their losses, steps and result codes [start]."""

    end: Array
    loss: Array
    steps: Array
    result: optx.RESULTS


class Settled(NamedTuple):
    """A point, predictions and Jacobian there, and how far the solution is [standard deviations]."""

    z: Array
    halves: tuple[Array, ...]
    prior: Array
    jacobian: Array
    distance: float


@eqx.filter_jit
def walk(problem: Problem, starts: Array, size: Array, solver: Any, max_steps: int, leads: bool) -> Walked:
    """Solve from every start.

    The solver moves w = (z - z_begin) * size: a unit step moves the residuals by about one standard deviation
    whatever the parameter, so damping and tolerances mean the same for all of them. Both walks are one compiled loop.

    Args:
        problem: what to solve.
        starts: z of the starts [start, p].
        size: norm of each column of the Jacobian at a start [p].
        solver: of optimistix; `LevenbergMarquardt` for None.
        max_steps: of each walk.
        leads: whether fewer rays lead where there are such.
    """
    fewer = problem.thins and leads

    def one_walk(begin: Array, near: Array) -> tuple[Array, Walked]:
        def moved(function: Residual) -> Residual:
            def residual(w: Array) -> Array:
                r = function(begin + w / size)
                return problem.robustly(jnp.where(near, problem.logarithmic(r), r))

            return residual

        def value(z: Array) -> Array:
            if not fewer:
                return problem.residual(z)
            return lax.cond(near, lambda: problem.thinned(z), lambda: problem.residual(z))

        function, chosen = moved(value), solver
        if solver is None:
            function = with_jacobian(function, moved(problem.thinned if fewer else problem.residual))
            rounding = jnp.sqrt(8 * jnp.finfo(begin.dtype).eps).astype(begin.dtype)
            chosen = LevenbergMarquardt(as_float(jnp.where(near, NEAR, THERE)), rounding)
        found: optx.Solution = optx.least_squares(
            lambda w, _: function(w), chosen, jnp.zeros_like(begin), max_steps=max_steps, throw=False
        )
        end = begin + found.value / size
        end = jnp.where(jnp.isfinite(end).all(), end, begin)
        loss = found.state.loss if solver is None else jnp.sum(function((end - begin) * size) ** 2)
        return end, Walked(end, loss, found.stats["num_steps"], found.result)

    def one(start: Array) -> Walked:
        both = lax.scan(one_walk, start, jnp.array([True, False]))[1]
        last = jax.tree.map(lambda leaf: leaf[-1], both)
        return last._replace(steps=jnp.sum(both.steps))

    if starts.shape[0] == 1:
        return jax.tree.map(lambda leaf: leaf[None], one(starts[0]))
    return jax.vmap(one)(starts)


@eqx.filter_jit
def linearised(problem: Problem, z: Array, leads: bool) -> tuple[Float[Array, " row"], Float[Array, "row p"]]:
    """Residuals and their Jacobian; of the rays that lead, if so told."""
    return value_and_jacobian(problem.thinned if leads else problem.residual, z)


@eqx.filter_jit
def predicted(problem: Problem, z: Array) -> tuple[tuple[Array, ...], Array]:
    """Residuals of both halves of all rays, and of the priors."""
    return problem.halves(z), problem.prior(z)


def loss_at(problem: Problem, z: Array) -> float:
    """The loss of all rays."""
    return float(jnp.sum(problem.robustly(problem.stacked(*predicted(problem, z))) ** 2))


def settle(problem: Problem, z: Array, steps: int) -> Settled:
    """Gauss-Newton steps with the Jacobian of all rays at `z`, as long as they lower the loss.

    Combinations of parameters that the data do not determine stay where they are. On the host, in double precision.

    Args:
        problem: what to solve.
        z: next to the solution [p].
        steps: at most; 0 looks and does not move.
    """
    value, jacobian = linearised(problem, z, False)
    loss, solved = _solved(problem, value, jacobian)
    step, distance = solved(value)
    reached = None
    while steps > 0 and distance > THERE:
        trial = z + as_float(step)
        ahead = predicted(problem, trial)
        residual = problem.stacked(*ahead)
        lower = loss(residual)
        if not lower < loss(value):
            break
        z, value, reached, steps = trial, residual, ahead, steps - 1
        step, distance = solved(residual)
    halves, prior = predicted(problem, z) if reached is None else reached
    return Settled(z, halves, prior, jacobian, distance)


Solved = tuple[Callable[[Array], float], Callable[[Array], tuple[np.ndarray, float]]]


def _solved(problem: Problem, value: Array, jacobian: Array) -> Solved:
    """The loss of residuals, and the step to the solution with this Jacobian and its distance."""
    slope = np.asarray(jax.jvp(problem.robustly, (value,), (jnp.ones_like(value),))[1], np.float64)
    left, singular, right = np.linalg.svd(slope[:, None] * np.asarray(jacobian, np.float64), full_matrices=False)
    known = singular * DETERMINED > 1

    def robust(residual: Array) -> np.ndarray:
        return np.asarray(problem.robustly(residual), np.float64)

    def solved(residual: Array) -> tuple[np.ndarray, float]:
        along = left.T @ robust(residual)
        return -(along[known] / singular[known]) @ right[known], float(np.linalg.norm(along[known]))

    return lambda residual: float(np.sum(robust(residual) ** 2)), solved
