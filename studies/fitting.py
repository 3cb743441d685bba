"""What the fitting studies share: the finite-difference baseline and their charts."""

import time

import equinox as eqx
import numpy as np
import scipy.optimize

from jaxir.fit import Fit, solve
from jaxir.fit.problem import Problem


def finite_differences(problem: Problem) -> tuple[np.ndarray, float, float, int]:
    """scipy.optimize.least_squares with finite differences on the same residuals, from the same start.

    Returns values [p], chi-squared, seconds (compilation apart), evaluations of the residuals.
    """
    residual = eqx.filter_jit(lambda p, z: p.residual(z))
    z = np.asarray(problem.coordinates.origin())
    calls = [0]

    def call(at: np.ndarray) -> np.ndarray:
        calls[0] += 1
        return np.asarray(residual(problem, at.astype(z.dtype)), np.float64)

    call(z)
    began = time.perf_counter()
    found = scipy.optimize.least_squares(call, z.astype(np.float64), diff_step=1e-3, xtol=1e-6, ftol=1e-6)
    seconds = time.perf_counter() - began
    values = np.asarray(problem.coordinates.values(found.x.astype(z.dtype)))
    return values, 2 * float(found.cost), seconds, calls[0] - 1


def timed_solve(problem: Problem, **settings) -> tuple[Fit, float, float]:
    """The fit, its first seconds (compilation included) and its seconds once compiled."""
    began = time.perf_counter()
    solve(problem, **settings)
    first = time.perf_counter() - began
    began = time.perf_counter()
    found = solve(problem, **settings)
    return found, first, time.perf_counter() - began


def error_bars(axis, labels, truth: np.ndarray, found: Fit) -> None:
    """Truth against fit with one-sigma bars, relative to the truth."""
    value, spread = np.asarray(found.uncertainty.value), np.asarray(found.uncertainty.standard_deviation)
    place = np.arange(len(truth))
    axis.axhline(0, color="k", lw=0.8)
    axis.errorbar(place, 100 * (value / truth - 1), 100 * spread / truth, fmt="o", capsize=3)
    axis.set_xticks(place, labels, rotation=20, ha="right")
    axis.set_ylabel("fit / truth − 1 [%]")
