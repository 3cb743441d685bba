"""How far parameters can go where the data do not hold them.

That is along the directions that the data leave open, as far as the fit stays good.
Linearised uncertainty speaks of the point where a solver stopped. One that ran far along a direction without effect
stops where other parameters look well determined because nothing there depends on the one that ran away.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Array, Float

from jaxir._arrays import as_float
from jaxir.fit._problem import Problem
from jaxir.fit._walk import linearised

STEPS = (1.0, 2.0, 4.0, 8.0)  # natural steps along a direction
RISE = 1.0  # of chi-squared by which a fit counts as good as the best
_ROUNDS = 12  # Gauss-Newton steps of the others at most
_LONGEST = 1.0  # natural steps of the others at once


def reach_of_open_directions(problem: Problem, z: Float[Array, " p"], open_directions: np.ndarray) -> np.ndarray:
    """The lowest and the highest value of every parameter [2, p] among fits as good as the one at z.

    From z, both ways along every open direction by `STEPS`, the other parameters are fitted anew; points whose
    chi-squared exceeds that at z by `RISE` or more end the search.

    Args:
        problem: the fit.
        z: the solution.
        open_directions: rows of `Uncertainty.combinations` that the data do not determine [direction, p].
    """
    begin = np.asarray(z, np.float64)
    best = _loss(problem, begin)
    values = [np.asarray(problem.coordinates.values(z), np.float64)]
    for direction in open_directions:
        for sign in (-1, 1):
            point = begin
            for step, before in zip(STEPS, (0.0, *STEPS), strict=False):
                point = _refitted(problem, point + sign * (step - before) * direction, direction, best + RISE)
                if not _loss(problem, point) < best + RISE:
                    break
                values.append(np.asarray(problem.coordinates.values(as_float(point)), np.float64))
    return np.stack([np.min(values, axis=0), np.max(values, axis=0)])


def _refitted(problem: Problem, point: np.ndarray, held: np.ndarray, enough: float) -> np.ndarray:
    """The point with everything but its place along `held` fitted anew."""
    across = np.eye(len(point)) - np.outer(held, held)
    for _ in range(_ROUNDS):
        seen, jacobian = linearised(problem, as_float(point))
        residual, slope = np.asarray(seen.residual, np.float64), np.asarray(jacobian, np.float64) @ across
        known = np.isfinite(residual).all() and np.isfinite(slope).all()
        if not known or residual @ residual < enough - RISE / 2:
            break
        move = -across @ (np.linalg.pinv(slope, rcond=1e-6) @ residual)
        point = point + move / max(1.0, np.abs(move).max() / _LONGEST)
        if np.abs(move).max() < 1e-4:
            break
    return point


def _loss(problem: Problem, point: np.ndarray) -> float:
    residual = np.asarray(linearised(problem, as_float(point))[0].residual, np.float64)
    return float(residual @ residual) if np.isfinite(residual).all() else np.inf
