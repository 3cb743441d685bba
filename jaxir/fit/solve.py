"""Entry: `fit`, `expected_uncertainty` and `sensitivity`.

Rays are traced once, before the solver starts; every step only evaluates them. The residuals are
(prediction - measured) / standard deviation, and (value - mean) / standard deviation for every prior.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, Key

from jaxir._arrays import as_float, enforce
from jaxir.fit.measurement import Measurement, Observation, observe
from jaxir.fit.parameter import AbstractParameter, Coordinates, at_values
from jaxir.fit.result import Fit, Uncertainty, uncertainty
from jaxir.scene.scene import Scene


class Problem(eqx.Module):
    """A fit ready to be solved: everything the residuals need.

    Attributes:
        coordinates: parameters and start.
        observations: measurements with their traced paths.
        prior_mean: of every number, physical [p].
        prior_weight: 1 / standard deviation of the prior, 0 for none [p].
        robust: residual (in standard deviations) from which the pseudo-Huber loss grows linearly; inf for squares [].
    """

    coordinates: Coordinates
    observations: tuple[Observation, ...]
    prior_mean: Float[Array, " p"]
    prior_weight: Float[Array, " p"]
    robust: Float[Array, ""]

    def halves(self, z: Float[Array, " p"]) -> tuple[Float[Array, "2 row band"], ...]:
        """Residuals of both halves of the rays, per measurement."""
        scene = self.coordinates.scene(self.coordinates.values(z))
        return tuple(
            (o.predict_halves(scene) - o.measurement.value[None]) / o.measurement.standard_deviation[None]
            for o in self.observations
        )

    def prior(self, z: Float[Array, " p"]) -> Float[Array, " p"]:
        """Residuals of the priors, 0 where there is none."""
        return (self.coordinates.values(z) - self.prior_mean) * self.prior_weight

    def residual(self, z: Float[Array, " p"]) -> Float[Array, " row"]:
        """All residuals, priors last. Differentiable in both modes."""
        data = [half.mean(axis=0).reshape(-1) for half in self.halves(z)]
        return jnp.concatenate([*data, self.prior(z)])

    def approach(self, z: Float[Array, " p"]) -> Float[Array, " row"]:
        """Residuals on a logarithmic scale, equal to `residual` near the solution and far flatter away from it.

        Radiance rises with a high power of temperature, so ln(prediction / measured) * measured / deviation is nearly
        linear in the logarithms of temperature, depth and emissivity, and a solver that walks it finds the
        neighbourhood of the solution from far away. Values within 3 standard deviations of 0 and predictions that
        are not positive keep their ordinary residual.
        """
        data = []
        for half, o in zip(self.halves(z), self.observations, strict=True):
            r = half.mean(axis=0)
            value, deviation = o.measurement.value, o.measurement.standard_deviation
            ratio = 1 + r * deviation / jnp.where(value > 0, value, 1)
            usable = (value > 3 * deviation) & (ratio > 0)
            data.append(jnp.where(usable, jnp.log(jnp.where(usable, ratio, 1)) * value / deviation, r).reshape(-1))
        return jnp.concatenate([*data, self.prior(z)])

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

    def robustly(self, r: Float[Array, " row"]) -> Float[Array, " row"]:
        """Residuals whose squares are the loss: r sqrt(2 / (1 + sqrt(1 + (r / robust)^2))), pseudo-Huber."""
        return r * jnp.sqrt(2 / (1 + jnp.sqrt(1 + (r / self.robust) ** 2)))


def fit(
    scene: Scene,
    parameters: Sequence[AbstractParameter],
    measurements: Sequence[Measurement],
    *,
    priors: Mapping[str, tuple[float, float]] | None = None,
    solver: optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser | None = None,
    robust: float = np.inf,
    starts: Any = None,
    max_steps: int = 64,
    key: Key[Array, ""] | None = None,
) -> Fit:
    """Parameters of a scene from measurements.

    Args:
        scene: geometry, and values where nothing is fitted; its values of the parameters are the first start.
        parameters: what may change, see `jaxir.fit.parameter`.
        measurements: see `measured_intensity`, `measured_image`.
        priors: name of a parameter to (mean, standard deviation) in its unit: extra residuals.
        solver: of optimistix; Levenberg-Marquardt by default. `optimistix.BFGS` suits many parameters.
        robust: residual, in standard deviations, from which the loss grows linearly (pseudo-Huber).
        starts: further starts, physical values [start, p]; all run under one vmap, the best result counts.
        max_steps: of the solver.
        key: random key of the points in the pixels.

    Returns:
        The fit. A solver that fails is reported in it, with the best point kept; nothing is raised for that.

    Raises:
        ValueError: values out of range; starts outside bounds; fewer data than parameters; a parameter that changes
            no measurement, by name.
    """
    problem = prepare(scene, parameters, measurements, priors=priors, robust=robust, key=key)
    return solve(problem, solver=solver, starts=starts, max_steps=max_steps)


def solve(
    problem: Problem,
    *,
    solver: optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser | None = None,
    starts: Any = None,
    max_steps: int = 64,
) -> Fit:
    """Solve a prepared fit; `fit` is `prepare` then `solve`, with the same arguments, results and errors.

    Raises:
        ValueError: starts outside bounds; fewer data than parameters; a parameter that changes no measurement.
    """
    coordinates = problem.coordinates
    if _data(problem) < coordinates.count:
        raise ValueError(
            f"measurements: got {_data(problem)} measured numbers and priors for {coordinates.count} parameters, "
            f"expected at least as many; add views, bands or priors"
        )
    first = coordinates.origin()[None, :]
    if starts is not None:
        values = as_float(starts, "starts")
        if values.ndim != 2 or values.shape[1] != coordinates.count:
            raise ValueError(f"starts: got shape {values.shape}, expected (start, {coordinates.count})")
        for p, piece in zip(
            coordinates.parameters, np.split(values, np.cumsum(coordinates.sizes)[:-1], 1), strict=True
        ):
            if not ((piece > p.bounds.lower) & (piece < p.bounds.upper)).all():
                raise ValueError(f"starts: got {p.name} outside its bounds ({p.bounds.lower}, {p.bounds.upper})")
        first = jnp.concatenate([first, jax.vmap(lambda v: at_values(coordinates, v))(values)])
    size = _effect(problem, first[0])
    if solver is None:  # in units of one standard deviation: a tenth leads near, a hundredth is the answer
        solvers: tuple[Any, Any] = (
            optx.LevenbergMarquardt(rtol=1e-2, atol=1e-1),
            optx.LevenbergMarquardt(rtol=1e-6, atol=1e-2),
        )
    else:
        solvers = (solver, solver)
    ends, losses, steps, results = _solve(problem, first, size, solvers, max_steps)
    best = int(np.nanargmin(np.where(np.isfinite(losses), losses, np.inf)))
    z = ends[best]
    jacobian, halves = _linearised(problem, z)
    spread = uncertainty(coordinates.labels, coordinates.units, coordinates.values(z), coordinates.slope(z), jacobian)
    residual = tuple(half.mean(axis=0) for half in halves)
    prior = problem.prior(z)
    squares = jnp.sum(jnp.concatenate([r.reshape(-1) for r in (*residual, prior)]) ** 2)
    error = jnp.concatenate([*((h[0] - h[1]).reshape(-1) / 2 for h in halves), jnp.zeros_like(prior)])
    return Fit(
        scene=coordinates.scene(coordinates.values(z)),
        uncertainty=spread,
        residual=residual,
        chi_squared=squares,
        degrees_of_freedom=_data(problem) - coordinates.count,
        sampling_shift=-coordinates.slope(z) * _step(jacobian, error),
        sampling_chi_squared=jnp.sum(error * error),
        steps=int(steps[best]),
        starts=losses,
        solver_result=jax.tree.map(lambda leaf: leaf[best], results),
    )


def expected_uncertainty(
    scene: Scene,
    parameters: Sequence[AbstractParameter],
    measurements: Sequence[Measurement],
    *,
    priors: Mapping[str, tuple[float, float]] | None = None,
    key: Key[Array, ""] | None = None,
) -> Uncertainty:
    """Standard deviations to expect before measuring: the Fisher information of proposed measurements at a scene.

    Args:
        scene: the expected truth.
        parameters: what would be fitted.
        measurements: proposed ones; only their views, bands and standard deviations count, not their values.
        priors: as `fit`.
        key: as `fit`.

    Returns:
        The uncertainty that `fit` would report if the truth were `scene`.

    Raises:
        ValueError: as `fit`, but fewer data than parameters are allowed: the answer then says what is missing.
    """
    problem = prepare(scene, parameters, measurements, priors=priors, key=key)
    coordinates = problem.coordinates
    z = coordinates.origin()
    jacobian, _ = _linearised(problem, z)
    return uncertainty(coordinates.labels, coordinates.units, coordinates.values(z), coordinates.slope(z), jacobian)


def prepare(
    scene: Scene,
    parameters: Sequence[AbstractParameter],
    measurements: Sequence[Measurement],
    *,
    priors: Mapping[str, tuple[float, float]] | None = None,
    robust: float = np.inf,
    key: Key[Array, ""] | None = None,
) -> Problem:
    """Check a fit and trace its rays; arguments and errors as `fit`. Solve it as often as values change."""
    if not measurements:
        raise ValueError("measurements: got none, expected at least one")
    if not robust > 0:
        raise ValueError(f"robust: got {robust}, expected a residual > 0 in standard deviations")
    scene = enforce(scene, [*scene.checks(), *(c for m in measurements for c in m.checks())])
    coordinates = Coordinates(parameters, scene)
    mean, weight = _priors(coordinates, priors or {})
    base = jax.random.key(0) if key is None else key
    observed = tuple(observe(scene, m, jax.random.fold_in(base, i)) for i, m in enumerate(measurements))
    return Problem(coordinates, observed, as_float(mean), as_float(weight), as_float(robust))


def _priors(coordinates: Coordinates, priors: Mapping[str, tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    names = [p.name for p in coordinates.parameters]
    means, weights = [], []
    for name, (_, deviation) in priors.items():
        if name not in names:
            raise ValueError(f"priors: got {name!r}, expected names among {names}")
        if not deviation > 0:
            raise ValueError(f"priors: got standard deviation {deviation} for {name!r}, expected > 0")
    for name, size in zip(names, coordinates.sizes, strict=True):
        mean, deviation = priors.get(name, (0.0, np.inf))
        means += [mean] * size
        weights += [1 / deviation] * size
    return np.array(means), np.array(weights)


def _data(problem: Problem) -> int:
    rows = sum(o.measurement.value.size for o in problem.observations)
    return rows + int(np.count_nonzero(np.asarray(problem.prior_weight)))


def _effect(problem: Problem, z: Array) -> Float[Array, " p"]:
    """Norm of each column of the Jacobian at the start; a parameter without effect is named in an error."""
    jacobian, _ = _linearised(problem, z)
    size = jnp.sqrt(jnp.sum(jacobian * jacobian, axis=0))
    still = np.asarray(size) == 0
    if still.any():
        names = [label for label, idle in zip(problem.coordinates.labels, still, strict=True) if idle]
        shown = ", ".join(names[:5]) + (", ..." if len(names) > 5 else "")
        raise ValueError(
            f"parameters: {shown} changes nothing in the measured views and bands; remove it or add a prior"
        )
    return size


@eqx.filter_jit
def _solve(
    problem: Problem, first: Array, size: Array, solvers: Any, max_steps: int
) -> tuple[Array, Array, Array, optx.RESULTS]:
    """Solve from every start in w = (z - z_start) * size.

    A unit step of w moves the residuals by about one standard deviation whatever the parameter, so damping and
    tolerances mean the same for all of them. The logarithmic residuals lead near the solution, the ordinary ones to it.
    """

    def loss(z: Array) -> Array:
        return jnp.sum(problem.robustly(problem.residual(z)) ** 2)

    def one(z: Array) -> tuple[Array, Array, Array, optx.RESULTS]:
        def walk(residual: Any, solver: Any, begin: Array) -> optx.Solution:
            return optx.least_squares(
                lambda w, _: problem.robustly(residual(begin + w / size)),
                solver,
                jnp.zeros_like(z),
                max_steps=max_steps,
                throw=False,
            )

        near = walk(problem.approach, solvers[0], z)
        middle = z + near.value / size
        middle = jnp.where(loss(middle) < loss(z), middle, z)
        found = walk(problem.residual, solvers[1], middle)
        end = middle + found.value / size
        steps = near.stats["num_steps"] + found.stats["num_steps"]
        before, after = loss(z), loss(end)
        better = after <= before
        return jnp.where(better, end, z), jnp.where(better, after, before), steps, found.result

    if first.shape[0] == 1:
        return jax.tree.map(lambda leaf: leaf[None], one(first[0]))
    return jax.vmap(one)(first)


@eqx.filter_jit
def _linearised(problem: Problem, z: Array) -> tuple[Float[Array, "row p"], tuple[Array, ...]]:
    """Jacobian of the residuals, by the cheaper mode, and the residuals of both halves."""
    rows = sum(o.measurement.value.size for o in problem.observations) + z.shape[0]
    mode = jax.jacfwd if z.shape[0] <= rows else jax.jacrev
    return mode(problem.residual)(z), problem.halves(z)


def _step(jacobian: Array, error: Array) -> Array:
    """Gauss-Newton step J^+ error, in double precision on the host."""
    return as_float(np.linalg.lstsq(np.asarray(jacobian, np.float64), np.asarray(error, np.float64), rcond=1e-6)[0])


def sensitivity(
    scene: Scene, measurement: Measurement, band: str, *, key: Key[Array, ""] | None = None
) -> tuple[Float[Array, " face"], Float[Array, " face"]]:
    """Where to paint: derivatives of the summed prediction in every face's emissivity and temperature.

    Args:
        scene: with a `Lambert` skin.
        measurement: its views say what is summed; its values do not count.
        band: name of the band.
        key: random key of the points in the pixels.

    Returns:
        d(W/sr)/d(emissivity) [face] and d(W/sr)/dT [face] [K-1], by one reverse pass.

    Raises:
        ValueError: no skin, or a band that the measurement lacks.
    """
    names = measurement.nodes.names
    if scene.skin is None or band not in names:
        raise ValueError(
            f"sensitivity: got band {band!r}, skin {scene.skin is not None}; expected one of {names}, a skin"
        )
    observed = observe(scene, measurement, jax.random.key(0) if key is None else key)
    count = scene.skin.mesh.count
    brdf = scene.skin.brdf
    emissivity = jnp.broadcast_to(brdf.hemispherical_emissivity, (count, brdf.hemispherical_emissivity.shape[1]))  # type: ignore[attr-defined]

    @jax.jit
    def total(emissivity: Array, temperature: Array) -> Array:
        changed = eqx.tree_at(
            lambda s: (s.skin.brdf.hemispherical_emissivity, s.skin.temperature), scene, (emissivity, temperature)
        )
        return observed.predict_halves(changed).mean(axis=0)[:, names.index(band)].sum()

    by_emissivity, by_temperature = jax.grad(total, argnums=(0, 1))(emissivity, scene.skin.temperature)
    return by_emissivity.sum(axis=1), by_temperature
