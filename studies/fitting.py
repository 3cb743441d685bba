"""What the fitting studies share: the baselines and their charts."""

import time
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize

from jaxir.fit import Fit, Problem, retraced, solve, value_and_jacobian


class Baseline(NamedTuple):
    """What another solver did: coordinates found [p], seconds, evaluations, and seconds and cost of each of them."""

    z: np.ndarray
    seconds: float
    calls: int
    at: np.ndarray
    cost: np.ndarray


def finite_differences(residual: Callable[[np.ndarray], np.ndarray], start: np.ndarray) -> Baseline:
    """scipy.optimize.least_squares with finite differences on given residuals; compilation apart.

    It moves 1 + z - start, because its steps are relative and some coordinates start at 0.
    """
    z = np.asarray(start)
    log: list[tuple[float, float]] = []

    def call(at: np.ndarray) -> np.ndarray:
        r = np.asarray(residual((at - 1 + z).astype(z.dtype)), np.float64)
        log.append((time.perf_counter(), float(r @ r)))
        return r

    call(np.ones(z.shape))
    log.clear()
    began = time.perf_counter()
    found = scipy.optimize.least_squares(call, np.ones(z.shape), diff_step=1e-3, xtol=1e-6, ftol=1e-6)
    at, cost = np.array(log).T
    return Baseline((found.x - 1 + z).astype(z.dtype), time.perf_counter() - began, len(log), at - began, cost)


def tracing_every_step(problem: Problem, steps: int) -> Baseline:
    """Gauss and Newton's steps, with rays traced anew at every point and a Jacobian of all of them; compilation apart.

    Steps are on logarithmic residuals, at most one natural step long, until the solution is within a standard
    deviation; then on ordinary ones until it is within a tenth.
    """
    coordinates = problem.coordinates

    @eqx.filter_jit
    def linearised(traced: Problem, z: jax.Array) -> tuple[tuple[jax.Array, jax.Array], ...]:
        (value, _), jacobian = value_and_jacobian(lambda z: (traced.residual(z), None), z)
        return (value, jacobian), jax.vmap(
            lambda t: jax.jvp(traced.logarithmic, (value,), (t,)), in_axes=1, out_axes=(None, 1)
        )(jacobian)

    def run() -> Baseline:
        began, log, near = time.perf_counter(), [], False
        z = coordinates.origin()
        for _ in range(steps):
            traced = retraced(problem, coordinates.scene(coordinates.values(z)))
            plain, logarithmic = linearised(traced, z)
            log.append((time.perf_counter() - began, float(plain[0] @ plain[0])))
            residual, jacobian = (np.asarray(x, np.float64) for x in (plain if near else logarithmic))
            step = -np.linalg.lstsq(jacobian, residual, rcond=None)[0]
            distance = np.linalg.norm(jacobian @ step)
            if near and distance < 0.1:
                break
            near = near or distance < 1
            z = z + jnp.asarray(step / max(1, np.abs(step).max()), z.dtype)
        seconds, cost = np.array(log).T
        return Baseline(np.asarray(z), time.perf_counter() - began, len(log), seconds, cost)

    run()
    return run()


def timed_solve(problem: Problem, **settings) -> tuple[Fit, float, float]:
    """The fit, its first seconds (compilation included) and the median of its seconds once compiled."""
    began = time.perf_counter()
    solve(problem, **settings)
    first = time.perf_counter() - began
    seconds = []
    for _ in range(5):
        began = time.perf_counter()
        found = solve(problem, **settings)
        seconds.append(time.perf_counter() - began)
    return found, first, float(np.median(seconds))


def error_bars(axis, labels, truth: np.ndarray, found: Fit) -> None:
    """Truth against fit with one-sigma bars, relative to the truth."""
    value, spread = np.asarray(found.uncertainty.value), np.asarray(found.uncertainty.standard_deviation)
    place = np.arange(len(truth))
    axis.axhline(0, color="k", lw=0.8)
    axis.errorbar(place, 100 * (value / truth - 1), 100 * spread / truth, fmt="o", capsize=3)
    axis.set_xticks(place, labels, rotation=20, ha="right")
    axis.set_ylabel("fit / truth − 1 [%]")
