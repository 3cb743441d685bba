"""Entry: `fit`, `solve` and `expected_uncertainty`.

Rays are traced once, before the solver starts; every step only evaluates them. Where the solution has moved what the
traced rays suit, they are traced again from there and the solver starts anew; so they are, once and with more of them,
where their noise exceeds that of the data.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, Key

from jaxir._arrays import as_float
from jaxir._fields import require_count
from jaxir._programs import program
from jaxir.fit._measurement import Measurement
from jaxir.fit._parameter import AbstractParameter, Coordinates, at_bounds, at_values
from jaxir.fit._prepare import prepare, retraced
from jaxir.fit._prior import AbstractPrior
from jaxir.fit._problem import Problem
from jaxir.fit._profile import reach_of_open_directions
from jaxir.fit._result import Fit, Uncertainty, column_norms, uncertainty
from jaxir.fit._surrogate import applies, lead
from jaxir.fit._walk import explains, linearised, reach
from jaxir.scene import Scene

LEAP = 1.0  # natural steps from where rays were traced beyond which they are not asked where to trace next
LEAST_SHARE = 0.5  # effective share of sampled directions below which they are drawn anew
LOUD = 1.0  # standard deviations of the data's noise that rays may put into a value before more of them are traced
QUIET = 0.5  # that they shall put in then: the total is 12 % above that of the data's noise


def fit(
    scene: Scene,
    parameters: Sequence[AbstractParameter],
    measurements: Sequence[Measurement],
    *,
    priors: Mapping[str, AbstractPrior] | None = None,
    solver: optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser | None = None,
    robust: float = np.inf,
    starts: Any = None,
    max_steps: int = 64,
    rounds: int = 4,
    max_samples: int = 16,
    key: Key[Array, ""] | None = None,
) -> Fit:
    """Parameters of a scene from measurements.

    Args:
        scene: geometry, and values where nothing is fitted; its values of the parameters are the first start.
        parameters: what may change, see `jaxir.fit`.
        measurements: see `measured_intensity`, `measured_image`.
        priors: what is known of a parameter, by its name: extra residuals, see `jaxir.fit`.
        solver: of optimistix; `LevenbergMarquardt` by default. `optimistix.LBFGS` suits thousands of parameters.
        robust: residual, in standard deviations, from which the loss grows linearly (pseudo-Huber). Outliers
            widen the standard deviations by what they let the values vary, see `Problem.widening`; where most are too
            high, or too low, they also shift the values, which no standard deviation tells.
        starts: further starts, physical values [start, p]; all run under one vmap, the best result counts.
        max_steps: of the solver, for each of its walks.
        rounds: how often rays may be traced. They are traced again where the solution has outgrown the images or
            fills less than half of them, or where sampled directions suit its brdf so badly that fewer than half of
            them count, or where they are too few.
        max_samples: rays per pixel at most. Where the rays put more into a value than the data's noise does, by the
            halves of the rays at the solution, they are traced once more: as many as shall put in half of it; so they
            are where nothing explains the data and predictions vary by as much. Memory and time grow with them; a
            measurement that asks for as many itself gets no more.
        key: random key of the points in the pixels and of sampled light.

    Returns:
        The fit. A solver that fails is reported in it, with the best point kept; nothing is raised for that. Residuals
        are of all rays. Where a jet has so many that fewer lead, the solution is about a tenth of a standard deviation
        or less from that of all, residuals change as those of the fewer over the last steps, and standard deviations
        are of some hundred rays in each row, up to 2 standard deviations before the solution: on a jet with four
        parameters, for eight keys, 1 to 4 % off those of all rays at the solution.

    Raises:
        ValueError: values out of range; starts outside bounds; fewer data than parameters; a parameter that changes
            no measurement, by name.
    """
    problem = prepare(scene, parameters, measurements, priors=priors, robust=robust, key=key)
    return solve(problem, solver=solver, starts=starts, max_steps=max_steps, rounds=rounds, max_samples=max_samples)


def solve(
    problem: Problem,
    *,
    solver: optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser | None = None,
    starts: Any = None,
    max_steps: int = 64,
    rounds: int = 4,
    max_samples: int = 16,
) -> Fit:
    """Solve a prepared fit; `fit` is `prepare` then `solve`, with the same arguments, results and errors.

    Raises:
        ValueError: starts outside bounds; fewer data than parameters; a parameter that changes no measurement.
    """
    coordinates = problem.coordinates
    if problem.data < coordinates.count:
        raise ValueError(
            f"measurements: got {problem.data} measured numbers and priors for {coordinates.count} parameters, "
            f"expected at least as many; add views, bands or priors"
        )
    for name, count, least in (("max_steps", max_steps, 1), ("rounds", rounds, 1), ("max_samples", max_samples, 2)):
        require_count(name, count, least)
    begin = first = _starts(coordinates, starts)
    size = None if solver is None else _effect(problem, begin[0])
    losses = np.zeros(0)
    asked = given = _samples(problem)
    for traced in range(1, rounds + 1):
        if solver is None and applies(problem):
            near, finish = lead(problem, begin, max_steps)
        else:
            near, finish = reach(problem, begin, size, solver, max_steps)
        if traced == 1:
            _require_effect(coordinates, near.size)
            losses = near.losses
        scene = _placed(coordinates, near.z)[0]
        share = effective_share(problem, scene)
        drifted = bool(share < LEAST_SHARE) or not all(o.holds(scene) for o in problem.observations)
        if drifted and traced < rounds - 1:  # the last rays may have to be more
            move = near.z - near.begin
            begin = (near.begin + move / jnp.maximum(1, jnp.max(jnp.abs(move)) / LEAP))[None]
            problem = retraced(problem, _placed(coordinates, begin[0])[0], asked)
            continue
        end = finish(drifted)
        scene, values, slope = _placed(coordinates, end.z)
        telling = end.jacobian / problem.widening(end.seen.residual)
        known = uncertainty(coordinates.labels, coordinates.units, values, slope, telling)
        error = tuple((half[:, 0] - half[:, 1]) / (2 * half.shape[0]) for half in end.seen.halves)
        of_rays = np.abs(np.asarray(slope, np.float64)) * _propagated(end.jacobian, error)
        explained = explains(problem, float(end.seen.loss))
        if asked == given:  # more rays at most once
            asked = _more(given, of_rays, known, max_samples)
        if asked == given and not explained:  # whose slopes may tell little
            asked = _surer(given, error, max_samples)
        if traced == rounds or asked == _samples(problem) and not drifted:
            break
        begin, problem = end.z[None], retraced(problem, scene, asked)
        if not explained:  # fewer rays may have led to another minimum
            begin = jnp.concatenate([begin, first])
    seen = end.seen
    loose = known.open_directions()
    reach_ = reach_of_open_directions(problem, end.z, loose) if len(loose) else np.stack([np.asarray(values)] * 2)
    return Fit(
        scene=scene,
        uncertainty=known,
        reach=as_float(reach_),
        at_bounds=at_bounds(coordinates, values),
        bands=tuple(o.measurement.nodes.names for o in problem.observations),
        robust=float(problem.robust),
        residual=tuple(half.mean(axis=(0, 1)) for half in seen.halves),
        prior_residual=problem.of_priors(end.z),
        chi_squared=jnp.sum(seen.residual * seen.residual),
        degrees_of_freedom=problem.data - coordinates.count,
        sampling_error=as_float(np.sqrt(np.sum(of_rays**2, axis=0))),
        sampling_residual=error,
        steps=end.steps,
        starts=as_float(losses),
        rounds=traced,
        samples=tuple(zip(given, _samples(problem), strict=True)),
        effective_share=share,
        drifted=drifted,
        solver_result=end.result,
    )


def expected_uncertainty(
    scene: Scene,
    parameters: Sequence[AbstractParameter],
    measurements: Sequence[Measurement],
    *,
    priors: Mapping[str, AbstractPrior] | None = None,
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
    jacobian = linearised(problem, z)[1]
    return uncertainty(coordinates.labels, coordinates.units, coordinates.values(z), coordinates.slope(z), jacobian)


@program
def _placed(coordinates: Coordinates, z: Array) -> tuple[Scene, Array, Array]:
    """The scene at z, the physical values there and their slopes dx/dz."""
    values = coordinates.values(z)
    return coordinates.scene(values), values, coordinates.slope(z)


def effective_share(problem: Problem, scene: Scene) -> Float[Array, ""]:
    """The least effective share of sampled directions among the observations."""
    return jnp.min(jnp.stack([o.effective_share(scene) for o in problem.observations]))


def _starts(coordinates: Coordinates, starts: Any) -> Float[Array, "start p"]:
    """z of the scene's own values and of further starts."""
    first = coordinates.origin()[None, :]
    if starts is None:
        return first
    values = as_float(starts, "starts")
    if values.ndim != 2 or values.shape[1] != coordinates.count:
        raise ValueError(f"starts: got shape {values.shape}, expected (start, {coordinates.count})")
    for p, piece in zip(coordinates.parameters, np.split(values, np.cumsum(coordinates.sizes)[:-1], 1), strict=True):
        if not ((piece > p.bounds.lower) & (piece < p.bounds.upper)).all():
            raise ValueError(f"starts: got {p.name} outside its bounds ({p.bounds.lower}, {p.bounds.upper})")
    return jnp.concatenate([first, jax.vmap(lambda v: at_values(coordinates, v))(values)])


def _effect(problem: Problem, z: Array) -> Float[Array, " p"]:
    """Norm of each column of the Jacobian at the start, none of them 0."""
    jacobian = linearised(problem, z)[1]
    size = jnp.sqrt(jnp.sum(jacobian * jacobian, axis=0))
    _require_effect(problem.coordinates, size)
    return size


def _require_effect(coordinates: Coordinates, size: Array) -> None:
    """Raise `ValueError` that names the parameters whose columns of the Jacobian have no size."""
    still = np.asarray(size) == 0
    if still.any():
        names = [label for label, idle in zip(coordinates.labels, still, strict=True) if idle]
        shown = ", ".join(names[:5]) + (", ..." if len(names) > 5 else "")
        raise ValueError(
            f"parameters: {shown} changes nothing in the measured views and bands; remove it or add a prior"
        )


def _samples(problem: Problem) -> tuple[int, ...]:
    """Rays per pixel of each measurement."""
    return tuple(o.measurement.samples for o in problem.observations)


def _more(given: tuple[int, ...], of_rays: np.ndarray, known: Uncertainty, most: int) -> tuple[int, ...]:
    """Rays per pixel of each measurement that put `QUIET` deviations into a value where those given put `LOUD`.

    Variances fall with the number of rays or faster. Measurements whose rays put in little stay as they are. Numbers
    are powers of two times those given, so that fits of one kind share their programs.
    """
    spread = np.asarray(known.standard_deviation, np.float64)
    some = np.isfinite(spread) & (spread > 0)
    square = (of_rays[:, some] / spread[some]) ** 2
    loudest = float(np.sum(square, axis=0).max(initial=0.0))
    if not LOUD**2 < loudest < np.inf:
        return given
    factor = _times(loudest)
    own = square.max(axis=1) * len(given)
    most -= most % 2
    return tuple(max(n, min(n * factor, most)) if part > QUIET**2 else n for n, part in zip(given, own, strict=True))


def _surer(given: tuple[int, ...], errors: tuple[Array, ...], most: int) -> tuple[int, ...]:
    """Rays per pixel of each measurement whose own noise is `QUIET` deviations of its data where it was more."""
    square = [float(np.mean(np.sum(np.asarray(error, np.float64) ** 2, axis=0))) for error in errors]
    factor = [_times(own) if QUIET**2 < own < np.inf else 1 for own in square]
    return tuple(max(n, min(n * own, most - most % 2)) for n, own in zip(given, factor, strict=True))


def _times(square: float) -> int:
    """How many times as many rays, a power of two, bring a variance down to that of `QUIET`."""
    return 2 ** math.ceil(math.log2(square / QUIET**2))


def _propagated(jacobian: Array, errors: tuple[Array, ...]) -> np.ndarray:
    """Standard error of z from independent errors of blocks and rows [block, row, band], [measurement, p].

    An error moves the solution by J^+ e, its bands together because they share rays. In double precision on the host.
    """
    own = np.asarray(jacobian, np.float64)
    size = column_norms(own)
    inverse = np.linalg.pinv(own / size, rcond=1e-6) / size[:, None]
    squares, begin = [], 0
    for error in errors:
        rows, bands = error.shape[1:]
        part = inverse[:, begin : begin + rows * bands].reshape(-1, rows, bands)
        squares.append((np.einsum("prb,krb->pkr", part, np.asarray(error, np.float64)) ** 2).sum(axis=(1, 2)))
        begin += rows * bands
    return np.sqrt(squares)
