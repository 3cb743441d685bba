"""What the fitting studies share: the finite-difference baseline and their charts."""

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy.optimize

from jaxir.fit import Fit, solve
from jaxir.fit.problem import Problem


class Baseline(NamedTuple):
    """What scipy did: coordinates found [p], seconds, evaluations, and seconds and cost of each evaluation."""

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
