"""From starts to the solution of a prepared fit.

A first walk of the solver on logarithmic residuals leads near the solution, a second on the ordinary ones to it. Where
fewer rays lead, see `Observation`, there is only the first, on those alone, and `settle` goes the rest with residuals
of all rays and slopes of fewer: a step costs one evaluation of all rays. An error E of the slopes leaves its share of
the distance, and at the solution, where J^T r = 0, a distance of |E^T r| that is not seen: with residuals r of some
standard deviations and the slopes of the rays that steer, some hundredths of one.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxir._arrays import as_float
from jaxir.fit.descent import LevenbergMarquardt
from jaxir.fit.problem import Problem, value_and_jacobian, with_jacobian

NEAR, THERE = 1.0, 0.03  # distance from the solution at which walks end [standard deviations]
MISLED = 0.3  # distance at which fewer rays have led to the wrong place
NEXT = 1.0  # distance up to which the slopes of the rays that lead are good enough
SETTLING = 8  # steps of `settle` at most
DETERMINED = 1.0  # standard deviation in natural steps up to which `settle` moves a combination of parameters


class Walked(NamedTuple):
    """Where walks from all starts ended [start, p], their steps and result codes [start]."""

    end: Array
    steps: Array
    result: optx.RESULTS


class Seen(NamedTuple):
    """Residuals of all rays at a point: of both halves per measurement and of the priors; and their loss."""

    halves: tuple[Array, ...]
    prior: Array
    residual: Array
    loss: Array


class Settled(NamedTuple):
    """A point, residuals and Jacobian there, the distance of the solution [standard deviations], steps taken."""

    z: Array
    seen: Seen
    jacobian: Array
    distance: float
    steps: int


@eqx.filter_jit
def walk(
    problem: Problem, starts: Array, size: Array, solver: Any, max_steps: int, flat: Bool[Array, " walk"]
) -> Walked:
    """Solve from every start.

    The solver moves w = (z - z_begin) * size: a unit step moves the residuals by about one standard deviation
    whatever the parameter, so damping and tolerances mean the same for all of them. All walks are one compiled loop.

    Args:
        problem: what to solve.
        starts: z of the starts [start, p].
        size: norm of each column of the Jacobian at a start [p].
        solver: of optimistix; `LevenbergMarquardt` for None.
        max_steps: of each walk.
        flat: one walk after the other, whether on logarithmic residuals [walk].
    """

    def one_walk(begin: Array, near: Array) -> tuple[Array, Walked]:
        def residual(w: Array) -> Array:
            r = problem.residual(begin + w / size)
            return problem.robustly(jnp.where(near, problem.logarithmic(r), r))

        function, chosen = with_jacobian(residual) if solver is None else residual, solver
        if solver is None:
            rounding = jnp.sqrt(8 * jnp.finfo(begin.dtype).eps).astype(begin.dtype)
            chosen = LevenbergMarquardt(as_float(jnp.where(near, NEAR, THERE)), rounding)
        found: optx.Solution = optx.least_squares(
            lambda w, _: function(w), chosen, jnp.zeros_like(begin), max_steps=max_steps, throw=False
        )
        end = begin + found.value / size
        end = jnp.where(jnp.isfinite(end).all(), end, begin)
        return end, Walked(end, found.stats["num_steps"], found.result)

    def one(start: Array) -> Walked:
        walks = lax.scan(one_walk, start, flat)[1]
        last = jax.tree.map(lambda leaf: leaf[-1], walks)
        return last._replace(steps=jnp.sum(walks.steps))

    if starts.shape[0] == 1:
        return jax.tree.map(lambda leaf: leaf[None], one(starts[0]))
    return jax.vmap(one)(starts)


@eqx.filter_jit
def linearised(problem: Problem, z: Array) -> Float[Array, "row p"]:
    """The Jacobian of the residuals."""
    return value_and_jacobian(problem.residual, z)[1]


@eqx.filter_jit
def look(problem: Problem, z: Array) -> Seen:
    """What all rays say of a point."""
    halves, prior = problem.halves(z), problem.prior(z)
    residual = problem.stacked(halves, prior)
    return Seen(halves, prior, residual, jnp.sum(problem.robustly(residual) ** 2))


def settle(problem: Problem, z: Array, seen: Seen) -> Settled:
    """Gauss-Newton steps with the slopes of fewer rays, as long as they lower the loss of all.

    Combinations of parameters that the data do not determine stay where they are. On the host, in double precision.

    Args:
        problem: what to solve.
        z: near the solution [p].
        seen: at z.
    """
    steps = 0
    for fewer, enough in ((problem.leading(), NEXT), (problem.steering(), THERE)):
        jacobian = linearised(fewer, z)
        step, distance = _step(problem, seen.residual, jacobian)
        while steps < SETTLING and distance > enough:
            trial = z + as_float(step)
            ahead = look(problem, trial)
            if not ahead.loss < seen.loss:
                break
            z, seen, steps = trial, ahead, steps + 1
            step, distance = _step(problem, seen.residual, jacobian)
    return Settled(z, seen, jacobian, distance, steps)


def stay(problem: Problem, z: Array, seen: Seen) -> Settled:
    """As `settle`, with the slopes of all rays and without a step."""
    jacobian = linearised(problem, z)
    return Settled(z, seen, jacobian, _step(problem, seen.residual, jacobian)[1], 0)


def _step(problem: Problem, residual: Array, jacobian: Array) -> tuple[np.ndarray, float]:
    """The step to the solution of the linearised problem, and its distance."""
    robust, slope = jax.jvp(problem.robustly, (residual,), (jnp.ones_like(residual),))
    scaled = np.asarray(slope, np.float64)[:, None] * np.asarray(jacobian, np.float64)
    left, singular, right = np.linalg.svd(scaled, full_matrices=False)
    known = singular * DETERMINED > 1
    along = (left.T @ np.asarray(robust, np.float64))[known]
    return -(along / singular[known]) @ right[known], float(np.linalg.norm(along))
