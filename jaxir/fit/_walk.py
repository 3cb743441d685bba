"""From starts to the solution: walks of the solver, and where the best of them ended.

A first walk on logarithmic residuals leads near the solution, a second on the ordinary ones to it. Where that ends at
what does not explain the data, ordinary residuals alone are tried, and even steps, see `_descent`: of a cube of six
temperatures and as many emissivities, from 250 to 1500 K, one of the three arrives where the others lose a cold side.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxir._arrays import as_float
from jaxir._programs import program
from jaxir.fit._descent import LevenbergMarquardt
from jaxir.fit._problem import Problem, value_and_jacobian, with_jacobian

NEAR, THERE = 3.0, 0.03  # distance from the solution at which walks end [standard deviations]
BEYOND = 4.0  # standard deviations of chi-squared above its expectation up to which it is one of noise
DETERMINED = 1.0  # standard deviation in natural steps up to which these move a combination of parameters


class Walked(NamedTuple):
    """Where walks from all starts ended.

    Attributes:
        end: z [start, p].
        steps: [start].
        result: codes [start].
        size: norms of the columns of the first Jacobian, or those given [start, p].
    """

    end: Array
    steps: Array
    result: optx.RESULTS
    size: Array


class Seen(NamedTuple):
    """Residuals at a point.

    Attributes:
        halves: of both halves of the rays in each block, per measurement.
        residual: all of them, priors last.
        robust: those whose squares are the loss.
        bend: their derivatives by `residual`.
        loss: sum of the squares.
    """

    halves: tuple[Array, ...]
    residual: Array
    robust: Array
    bend: Array
    loss: Array


class Solution(NamedTuple):
    """Where a fit ends.

    Attributes:
        z: the point [p].
        seen: residuals there.
        jacobian: their slopes [row, p].
        distance: from the minimum of the loss [standard deviations].
        steps: taken, of the best start.
        result: code of the solver.
    """

    z: Array
    seen: Seen
    jacobian: Array
    distance: float
    steps: int
    result: optx.RESULTS


class Reached(NamedTuple):
    """Where the best of several walks ended.

    Attributes:
        z: the point, or the start where the walk failed and gained nothing [p].
        seen: residuals there.
        jacobian: their slopes [row, p].
        begin: z where this walk began [p].
        size: norms of the columns of the first Jacobian of the first walk [p].
        losses: where each walk ended [start].
        steps: of this walk.
        result: code of the solver.
    """

    z: Array
    seen: Seen
    jacobian: Array
    begin: Array
    size: Array
    losses: np.ndarray
    steps: int
    result: optx.RESULTS


Finish = Callable[[bool], Solution]  # from where a walk ended, given whether the rays suit that place badly


def reach(problem: Problem, starts: Array, size: Array | None, solver: Any, max_steps: int) -> tuple[Reached, Finish]:
    """Walk from every start; arguments as `walk`.

    Returns:
        Where the best walk ended, and what tells the solution from there.
    """
    near = best_way(problem, problem, starts, size, solver, max_steps, [True, False])
    return near, lambda drifted: solution(near.z, (near.seen, near.jacobian), near.steps, near.result)


def best_way(
    problem: Problem, judge: Problem, starts: Array, size: Array | None, solver: Any, max_steps: int, flat: list[bool]
) -> Reached:
    """Where the best walk ended: of those asked for, and of others where these end at what noise does not explain.

    Where outliers count less, those on ordinary residuals are walked anyway: on a logarithmic scale what was measured
    far too high draws more than it does in the loss.

    Args:
        problem: what to solve.
        judge: the same with the rays that tell which is best.
        starts: as of `walk`.
        size: likewise.
        solver: likewise.
        max_steps: likewise.
        flat: likewise.
    """
    ways = [(flat, False), ([False] * len(flat), False), *([(flat, True)] if solver is None else [])]
    least = 1 if np.isinf(float(problem.robust)) else 2
    every: list[Reached] = []
    for each, even in ways:
        walked = walk(problem, starts, size, solver, max_steps, jnp.array(each), jnp.array(even))
        every.append(best(judge, starts, walked))
        if len(every) >= least and any(explains(judge, float(reached.seen.loss)) for reached in every):
            break
    first = int(np.argmin([np.nan_to_num(float(reached.seen.loss), nan=np.inf) for reached in every]))
    return every[first]._replace(losses=np.fmin.reduce(np.stack([reached.losses for reached in every])))


def explains(problem: Problem, loss: float) -> bool:
    """Whether noise of the data may have made a loss."""
    freedom = max(problem.data - problem.coordinates.count, 1)
    return loss <= freedom + BEYOND * (2 * freedom) ** 0.5


def best(problem: Problem, starts: Array, walked: Walked) -> Reached:
    """The walk that ended with the least loss by the rays of a problem, with what these say there."""
    ends = [linearised(problem, z) for z in walked.end]
    losses = np.array([float(seen.loss) if np.isfinite(jacobian).all() else np.nan for seen, jacobian in ends])
    least = int(np.argmin(np.where(np.isfinite(losses), losses, np.inf)))
    begin, steps, result = starts[least], int(walked.steps[least]), pick(walked.result, least)
    z, there, lost = walked.end[least], ends[least], not np.isfinite(losses[least])
    if lost or not bool(result == optx.RESULTS.successful):  # the best point is kept
        before = linearised(problem, begin)
        if lost or not there[0].loss < before[0].loss:
            z, there = begin, before
    result = optx.RESULTS.where(jnp.asarray(lost), optx.RESULTS.nonlinear_divergence, result)
    return Reached(z, *there, begin, walked.size[0], losses, steps, result)


@program
def walk(
    problem: Problem,
    starts: Array,
    size: Array | None,
    solver: Any,
    max_steps: int,
    flat: Bool[Array, " walk"],
    even: Bool[Array, ""],
) -> Walked:
    """Solve from every start.

    Another solver moves w = (z - z_begin) * size: a unit step moves the residuals by about one standard deviation
    whatever the parameter, so damping and tolerances mean the same for all of them. All walks are one compiled loop.

    Args:
        problem: what to solve.
        starts: z of the starts [start, p].
        size: norm of each column of the Jacobian at a start [p]; None where our own solver finds it.
        solver: of optimistix; `LevenbergMarquardt` for None.
        max_steps: of each walk.
        flat: one walk after the other, whether on logarithmic residuals [walk].
        even: whether by even steps, of our own solver.
    """

    def one_walk(begin: Array, near: Array) -> tuple[Array, Walked]:
        unit = jnp.ones_like(begin) if size is None else size

        def residual(w: Array) -> Array:
            r = problem.residual(begin + w / unit)
            return problem.robustly(jnp.where(near, problem.logarithmic(r), r))

        function, chosen = with_jacobian(residual) if solver is None else residual, solver
        if solver is None:
            rounding = jnp.sqrt(8 * jnp.finfo(begin.dtype).eps).astype(begin.dtype)
            chosen = LevenbergMarquardt(as_float(jnp.where(near, NEAR, THERE)), rounding, even=even)
        found: optx.Solution = optx.least_squares(
            lambda w, _: function(w), chosen, jnp.zeros_like(begin), max_steps=max_steps, throw=False
        )
        end = begin + found.value / unit
        end = jnp.where(jnp.isfinite(end).all(), end, begin)
        return end, Walked(end, found.stats["num_steps"], found.result, found.state.size if solver is None else unit)

    def one(start: Array) -> Walked:
        walks = lax.scan(one_walk, start, flat)[1]
        last = jax.tree.map(lambda leaf: leaf[-1], walks)
        return last._replace(steps=jnp.sum(walks.steps), size=walks.size[0])

    if starts.shape[0] == 1:
        return jax.tree.map(lambda leaf: leaf[None], one(starts[0]))
    return jax.vmap(one)(starts)


@program
def look(problem: Problem, z: Array) -> Seen:
    """What the rays of a problem say of a point."""
    return _seen(problem, z)


@program
def linearised(problem: Problem, z: Array) -> tuple[Seen, Float[Array, "row p"]]:
    """What the rays of a problem say of a point, and the Jacobian of the residuals there."""

    def residual(z: Array) -> tuple[Array, Seen]:
        seen = _seen(problem, z)
        return seen.residual, seen

    (_, seen), jacobian = value_and_jacobian(residual, z)
    return seen, jacobian


def _seen(problem: Problem, z: Array) -> Seen:
    halves = problem.halves(z)
    residual = problem.stacked(halves, problem.prior(z))
    robust, bend = jax.jvp(problem.robustly, (residual,), (jnp.ones_like(residual),))
    return Seen(halves, residual, robust, bend, jnp.sum(robust * robust))


def stay(problem: Problem, z: Array, steps: int = 0, result: Any = optx.RESULTS.successful) -> Solution:
    """A point as the solution, with the slopes of all rays there."""
    return solution(z, linearised(problem, z), steps, result)


def solution(z: Array, there: tuple[Seen, Array], steps: int, result: Any) -> Solution:
    """A point as the solution, with what `linearised` says of it."""
    return Solution(z, *there, newton_step(*there)[1], steps, result)


def newton_step(seen: Seen, jacobian: Array) -> tuple[np.ndarray, float]:
    """The step to the solution of the linearised problem, and its distance; in double precision on the host.

    Combinations of parameters that the data do not determine stay where they are.
    """
    scaled = np.asarray(seen.bend, np.float64)[:, None] * np.asarray(jacobian, np.float64)
    left, singular, right = np.linalg.svd(scaled, full_matrices=False)
    known = singular * DETERMINED > 1
    along = (left.T @ np.asarray(seen.robust, np.float64))[known]
    return -(along / singular[known]) @ right[known], float(np.linalg.norm(along))


def pick(results: optx.RESULTS, start: int) -> optx.RESULTS:
    """The code of one walk."""
    return jax.tree.map(lambda leaf: leaf[start], results)
