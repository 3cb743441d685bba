"""A fit ready to be solved: residuals as a function of one vector of unbounded coordinates.

The residuals are (prediction - measured) / standard deviation of every measured number, then those of the priors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Key

from jaxir._arrays import as_float, enforce
from jaxir._math import matmul
from jaxir.fit._observation import Observation
from jaxir.fit._parameter import Coordinates
from jaxir.fit._prior import AbstractPrior

BATCH = 8  # columns or rows of a Jacobian at once


class Problem(eqx.Module):
    """Everything the residuals need.

    Attributes:
        coordinates: parameters and start.
        observations: measurements with their traced paths.
        priors: of each parameter in order, or None.
        robust: residual (in standard deviations) from which the pseudo-Huber loss grows linearly; inf for squares [].
        key: with which rays were traced.
        surrogate: fewer rays that lead to the solution, see `_surrogate`; None where all of them walk.
    """

    coordinates: Coordinates
    observations: tuple[Observation, ...]
    priors: tuple[AbstractPrior | None, ...]
    robust: Float[Array, ""]
    key: Key[Array, ""]
    surrogate: eqx.Module | None

    @property
    def data(self) -> int:
        """How many numbers were measured or are known before."""
        known = zip(self.priors, self.coordinates.sizes, strict=True)
        return self.measured + sum(prior.count(size) for prior, size in known if prior is not None)

    @property
    def measured(self) -> int:
        """How many numbers were measured."""
        return sum(o.measurement.value.size for o in self.observations)

    def halves(self, z: Float[Array, " p"]) -> tuple[Float[Array, "block 2 row band"], ...]:
        """Residuals of both halves of the rays in each block, per measurement."""
        scene = self.coordinates.scene(self.coordinates.values(z))
        predicted = ((o.measurement, o.predict_halves(scene)) for o in self.observations)
        return tuple((halves - m.value[None, None]) / m.standard_deviation[None, None] for m, halves in predicted)

    def of_priors(self, z: Float[Array, " p"]) -> dict[str, Float[Array, " m"]]:
        """Residuals of the priors, by the parameters that have some."""
        pieces = self.coordinates.pieces(self.coordinates.values(z))
        every = zip(self.coordinates.parameters, self.priors, pieces, strict=True)
        return {parameter.name: prior.residual(piece) for parameter, prior, piece in every if prior is not None}

    def prior(self, z: Float[Array, " p"]) -> Float[Array, " row"]:
        """Residuals of the priors."""
        return jnp.concatenate([jnp.zeros(0, z.dtype), *self.of_priors(z).values()])

    def residual(self, z: Float[Array, " p"]) -> Float[Array, " row"]:
        """All residuals, priors last. Differentiable in both modes."""
        return self.stacked(self.halves(z), self.prior(z))

    def stacked(self, halves: tuple[Array, ...], prior: Array) -> Float[Array, " row"]:
        """One vector of the mean over halves and blocks, and the priors."""
        return jnp.concatenate([*(half.mean(axis=(0, 1)).reshape(-1) for half in halves), prior])

    def logarithmic(self, residual: Float[Array, " row"]) -> Float[Array, " row"]:
        """Residuals on a logarithmic scale, equal to `residual` near the solution and far flatter away from it.

        Radiance rises with a high power of temperature, so ln(prediction / measured) * measured / deviation is nearly
        linear in the logarithms of temperature, depth and emissivity, and a solver that walks it finds the
        neighbourhood of the solution from far away. Values within 3 standard deviations of 0 and predictions that
        are not positive keep their ordinary residual.
        """
        measured = [o.measurement for o in self.observations]
        value = jnp.concatenate([m.value.reshape(-1) for m in measured])
        deviation = jnp.concatenate([m.standard_deviation.reshape(-1) for m in measured])
        r = residual[: value.size]
        ratio = 1 + r * deviation / jnp.where(value > 0, value, 1)
        usable = (value > 3 * deviation) & (ratio > 0)
        flat = jnp.where(usable, jnp.log(jnp.where(usable, ratio, 1)) * value / deviation, r)
        return jnp.concatenate([flat, residual[value.size :]])

    def robustly(self, r: Float[Array, " row"]) -> Float[Array, " row"]:
        """Residuals whose squares are the loss: r sqrt(2 / (1 + sqrt(1 + (r / robust)^2))), pseudo-Huber."""
        return r * jnp.sqrt(2 / (1 + jnp.sqrt(1 + (r / self.robust) ** 2)))

    def widening(self, residual: Float[Array, " row"]) -> Float[np.ndarray, "row 1"]:
        """Standard deviation of what each row tells under the robust loss over that under squares; 1 of priors.

        With psi = r / sqrt(1 + (r / robust)^2), half the slope of the loss, its square is E psi^2 / (E psi')^2 (Huber
        1964). Data whose mean of psi' is less than that of normal ones have outliers for the rest, of psi^2 up to
        robust^2. Of a mean with none, a tenth and a fifth of outliers of 10, `robust` 1 to 5, 10 to 200 numbers, told
        over found is .98 to 1.15. On the host.
        """
        bend = float(self.robust)
        if np.isinf(bend):
            return np.ones((residual.shape[0], 1), residual.dtype)
        normal = np.linspace(-8.0, 8.0, 16001)
        weight = np.exp(-(normal**2) / 2) / np.exp(-(normal**2) / 2).sum()
        square = weight @ (normal**2 / (1 + (normal / bend) ** 2))
        slope = weight @ (1 + (normal / bend) ** 2) ** -1.5
        found = np.mean((1 + (np.asarray(residual, np.float64)[: self.measured] / bend) ** 2) ** -1.5)
        inliers = min(found / slope, 1.0)
        factor = np.sqrt(inliers * square + (1 - inliers) * bend**2) / (inliers * slope)
        return np.where(np.arange(residual.shape[0]) < self.measured, factor, 1.0)[:, None].astype(residual.dtype)

    def with_values(self, values: Sequence[Any]) -> Problem:
        """The same problem, rays included, with other measured values (one array per measurement, shaped as given)."""
        if len(values) != len(self.observations):
            raise ValueError(
                f"values: got {len(values)} arrays, expected {len(self.observations)}, one per measurement"
            )
        changed = []
        for observation, value in zip(self.observations, values, strict=True):
            old = observation.measurement.value
            new = as_float(value, "values")
            if new.size != old.size:
                raise ValueError(f"values: got shape {new.shape}, expected {old.size} numbers shaped as measured")
            measured = eqx.tree_at(lambda m: m.value, observation.measurement, new.reshape(old.shape))
            changed.append(eqx.tree_at(lambda o: o.measurement, observation, enforce(measured, measured.checks())))
        return eqx.tree_at(lambda p: p.observations, self, tuple(changed))


Residual = Callable[[Array], Array]


def value_and_jacobian(
    function: Callable[[Array], tuple[Array, Any]], z: Float[Array, " p"]
) -> tuple[tuple[Float[Array, " row"], Any], Float[Array, "row p"]]:
    """What a function returns, which is residuals and anything beside, and the Jacobian of the residuals.

    In the mode that needs fewer passes. Passes are taken `BATCH` at a time, so that memory does not grow with their
    number; up to `BATCH` columns come with one evaluation.
    """
    rows, count = jax.eval_shape(function, z)[0].shape[0], z.shape[0]
    if count > rows:
        value, pull, beside = jax.vjp(function, z, has_aux=True)
        jacobian = lax.map(lambda t: pull(t)[0], jnp.eye(rows, dtype=z.dtype), batch_size=BATCH)
        return (value, beside), jacobian

    def push(tangent: Array) -> tuple[Array, Array, Any]:
        return jax.jvp(function, (z,), (tangent,), has_aux=True)

    basis = jnp.eye(count, dtype=z.dtype)
    if count <= BATCH:
        value, jacobian, beside = jax.vmap(push, out_axes=(None, 1, None))(basis)
        return (value, beside), jacobian
    return function(z), lax.map(lambda t: push(t)[1], basis, batch_size=BATCH).T


def with_jacobian(function: Residual) -> Residual:
    """The same function, whose linearisation holds its Jacobian and nothing else.

    A solver that linearises a long computation would else keep every intermediate result of it.
    """

    @jax.custom_jvp
    def held(z: Array) -> Array:
        return function(z)

    @held.defjvp
    def held_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
        (value, _), jacobian = value_and_jacobian(lambda z: (function(z), None), primals[0])
        return value, matmul(jacobian, tangents[0])

    return held
