"""A fit is prepared: its arguments are checked and its rays traced."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from jaxir._arrays import as_float, enforce, key_or_default
from jaxir._fields import require_part
from jaxir._programs import program
from jaxir.fit._measurement import Measurement
from jaxir.fit._observation import Observation, observe, reframed
from jaxir.fit._parameter import AbstractParameter, Coordinates
from jaxir.fit._prior import AbstractPrior
from jaxir.fit._problem import Problem
from jaxir.fit._surrogate import Surrogate, thinned
from jaxir.scene import Scene

MEASURED = "made by jaxir.fit.measured_image or measured_intensity, which know camera, bands and errors"


def prepare(
    scene: Scene,
    parameters: Sequence[AbstractParameter],
    measurements: Sequence[Measurement],
    *,
    priors: Mapping[str, AbstractPrior] | None = None,
    robust: float = np.inf,
    key: Key[Array, ""] | None = None,
) -> Problem:
    """Check a fit and trace its rays; arguments and errors as `fit`. Solve it as often as values change."""
    if not isinstance(measurements, Sequence):
        raise ValueError(f"measurements: got a {type(measurements).__name__}, expected a list, each of them {MEASURED}")
    for index, measurement in enumerate(measurements):
        require_part(f"measurements[{index}]", measurement, eqx.Module, f"one {MEASURED}")
    if not measurements:
        raise ValueError("measurements: got none, expected at least one")
    if not robust > 0:
        raise ValueError(f"robust: got {robust}, expected a residual > 0 in standard deviations")
    measurements = [measurement.resolved(scene) for measurement in measurements]
    scene = enforce(scene, [c for m in measurements for c in (*scene.checks_on(m.nodes), *m.checks())])
    coordinates = Coordinates(parameters, scene)
    names = [p.name for p in coordinates.parameters]
    given = priors or {}
    for name, prior in given.items():
        if name not in names:
            raise ValueError(f"priors: got {name!r}, expected names among {names}")
        require_part(f"priors[{name!r}]", prior, AbstractPrior, "a prior, e.g. jaxir.fit.NormalPrior({}, 1)")
    known = tuple(given.get(name) for name in names)
    base = key_or_default(key)
    observed, surrogate = _observed(scene, coordinates, measurements, base)
    problem = Problem(coordinates, observed, known, as_float(robust), base, surrogate)
    assert problem.data  # counts the priors' residuals, which raises for one that does not suit its parameter
    return problem


def retraced(problem: Problem, scene: Scene, samples: Sequence[int] | None = None) -> Problem:
    """The same problem with the rays traced anew in another scene, in images made for it, with the same random key.

    Args:
        problem: what to solve.
        scene: what to trace.
        samples: rays per pixel of each measurement; as before by default.
    """
    coordinates, key = problem.coordinates, problem.key
    measured = [reframed(o.measurement, scene) for o in problem.observations]
    if samples is not None:
        measured = [dataclasses.replace(m, samples=n) for m, n in zip(measured, samples, strict=True)]
    observed, surrogate = _observed(scene, coordinates, measured, key)
    return Problem(coordinates, observed, problem.priors, problem.robust, key, surrogate)


def _observed(
    scene: Scene, coordinates: Coordinates, measurements: Sequence[Measurement], key: Array
) -> tuple[tuple[Observation, ...], Surrogate | None]:
    for_all, for_fewer = jax.random.split(key)
    moving = _outline_moves(coordinates)
    observed = tuple(observe(scene, m, jax.random.fold_in(for_all, i), moving) for i, m in enumerate(measurements))
    return observed, thinned(observed, for_fewer)


def _outline_moves(coordinates: Coordinates) -> bool:
    """Whether a parameter moves the outline of a plume."""
    return bool(coordinates.start.plumes) and bool(_moves(coordinates))


@program
def _moves(coordinates: Coordinates) -> Array:
    def outline(z: Array) -> Array:
        return jnp.concatenate([plume.extent() for plume in coordinates.scene(coordinates.values(z)).plumes])

    return (jax.jacfwd(outline)(coordinates.origin()) != 0).any()
