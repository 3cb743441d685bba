"""From starts to the solution of a prepared fit.

A first walk of the solver on logarithmic residuals leads near the solution, a second on the ordinary ones to it. Where
fewer rays lead, see `Observation`, there is only the first, on the fewest; `approach` goes on to the minimum z0 of
those that steer and evaluates all rays there; and `settle` adds to their prediction p what they lack there,

    p(z) + P(z0) - p(z0),

with P of all rays, and goes on to the minimum of that: as multipoint or multifidelity methods correct a cheap model by
one value of the dear one (Alexandrov et al., "Approximation and model management in aerodynamic optimization with
variable-fidelity models", J. Aircraft 38(6), 2001). An error E of the slopes leaves its share of the way from z0, and
at the solution, where J^T r = 0, a distance of |E^T r| that is not seen: with residuals r of some standard deviations
and the slopes of the rays that steer, a tenth of one or less.
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
from jaxir._concurrent import side_by_side
from jaxir.fit._descent import LevenbergMarquardt
from jaxir.fit._problem import Problem, value_and_jacobian, with_jacobian

NEAR, THERE = 3.0, 0.03  # distance from the solution at which walks end [standard deviations]
MISLED = 0.3  # distance at which fewer rays have led to the wrong place
APPROACHED = 2.0  # distance from the minimum of the rays that steer at which to ask all rays
SETTLED = 0.1  # distance from the minimum of all rays that may be left
SLOPES = 0.03  # error of the slopes of the rays that steer, as a share of the way from where all were evaluated
LOOKS = 4  # evaluations of all rays at most
STEPS = 8  # towards the minimum of the rays that steer at most, each time
DETERMINED = 1.0  # standard deviation in natural steps up to which these move a combination of parameters


class Walked(NamedTuple):
    """Where walks from all starts ended.

    Attributes:
        end: z [start, p].
        steps: [start].
        result: codes [start].
        jacobian: of the residuals walked, there [start, row, p]; None where another solver walked.
        size: norms of the columns of the first Jacobian, or those given [start, p].
    """

    end: Array
    steps: Array
    result: optx.RESULTS
    jacobian: Array | None
    size: Array


class Seen(NamedTuple):
    """Residuals at a point.

    Attributes:
        halves: of both halves of the rays, per measurement.
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


class Asked(NamedTuple):
    """A point, what all rays and those that steer say of it, and the Jacobian of the residuals of the latter."""

    z: Array
    every: Seen
    seen: Seen
    jacobian: Array


class Settled(NamedTuple):
    """A point, residuals and Jacobian there, the distance of the solution [standard deviations], steps taken."""

    z: Array
    seen: Seen
    jacobian: Array
    distance: float
    steps: int


@eqx.filter_jit
def walk(
    problem: Problem, starts: Array, size: Array | None, solver: Any, max_steps: int, flat: Bool[Array, " walk"]
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
    """

    def one_walk(begin: Array, near: Array) -> tuple[Array, Walked]:
        unit = jnp.ones_like(begin) if size is None else size

        def residual(w: Array) -> Array:
            r = problem.residual(begin + w / unit)
            return problem.robustly(jnp.where(near, problem.logarithmic(r), r))

        function, chosen = with_jacobian(residual) if solver is None else residual, solver
        if solver is None:
            rounding = jnp.sqrt(8 * jnp.finfo(begin.dtype).eps).astype(begin.dtype)
            chosen = LevenbergMarquardt(as_float(jnp.where(near, NEAR, THERE)), rounding)
        found: optx.Solution = optx.least_squares(
            lambda w, _: function(w), chosen, jnp.zeros_like(begin), max_steps=max_steps, throw=False
        )
        end = begin + found.value / unit
        end = jnp.where(jnp.isfinite(end).all(), end, begin)
        jacobian, sizes = (found.state.jacobian, found.state.size) if solver is None else (None, unit)
        return end, Walked(end, found.stats["num_steps"], found.result, jacobian, sizes)

    def one(start: Array) -> Walked:
        walks = lax.scan(one_walk, start, flat)[1]
        last = jax.tree.map(lambda leaf: leaf[-1], walks)
        return last._replace(steps=jnp.sum(walks.steps), size=walks.size[0])

    if starts.shape[0] == 1:
        return jax.tree.map(lambda leaf: leaf[None], one(starts[0]))
    return jax.vmap(one)(starts)


@eqx.filter_jit
def look(problem: Problem, z: Array) -> Seen:
    """What the rays of a problem say of a point."""
    return _seen(problem, z)


@eqx.filter_jit
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


def _ask(problem: Problem, fewer: Problem, z: Array) -> Asked:
    """The value of all rays and the slopes of fewer, the two dearest parts of a solution, side by side."""
    every, (seen, jacobian) = side_by_side(lambda: look(problem, z), lambda: linearised(fewer, z))
    return Asked(z, every, seen, jacobian)


def approach(problem: Problem, fewer: Problem, z: Array, seen: Seen, jacobian: Array) -> tuple[Asked, int]:
    """From near the solution to about the minimum of the rays that steer: Gauss-Newton steps that lower the loss.

    All rays are asked at every step, while the slopes of the fewer are found: mostly one step is enough, and then
    their value there is what `settle` needs.

    Args:
        problem: what to solve.
        fewer: the same with the rays that steer.
        z: near the solution [p].
        seen: of the rays that steer, at z.
        jacobian: of those that lead, at z.

    Returns:
        Where it ended, and steps taken.
    """
    asked, steps = None, 0
    step, distance = _step(seen, jacobian)
    while steps < STEPS and distance > APPROACHED:
        ahead = _ask(problem, fewer, z + as_float(step))
        if not ahead.seen.loss < seen.loss:
            break
        asked, z, seen, steps = ahead, ahead.z, ahead.seen, steps + 1
        step, distance = _step(seen, ahead.jacobian)
    return asked or _ask(problem, fewer, z), steps


def settle(problem: Problem, fewer: Problem, asked: Asked) -> Settled:
    """From about the minimum of the rays that steer to that of all rays.

    Args:
        problem: what to solve.
        fewer: the same with the rays that steer.
        asked: about the minimum of those.

    Returns:
        Where it ended. Residuals are those of all rays at the last point where they were evaluated, and from there on
        change as those of the rays that steer.
    """
    z, total = asked.z, 0
    for turn in range(LOOKS):
        asked = _ask(problem, fewer, z) if turn else asked
        completed = fewer.completed(asked.every.halves, asked.seen.halves)
        z, seen, left, steps = _descend(completed, asked.z, asked.every, asked.jacobian)
        total += steps
        way = np.asarray(asked.jacobian, np.float64) @ np.asarray(z - asked.z, np.float64)
        distance = left + SLOPES * float(np.linalg.norm(way))
        if distance <= SETTLED:
            break
    return Settled(z, seen, asked.jacobian, distance, total)


def _descend(problem: Problem, z: Array, seen: Seen, jacobian: Array) -> tuple[Array, Seen, float, int]:
    """Gauss-Newton steps with slopes that stay, as long as they lower the loss; on the host, in double precision.

    Combinations of parameters that the data do not determine stay where they are.

    Returns:
        The point, what is seen there, the distance that is left, steps taken.
    """
    steps = 0
    step, distance = _step(seen, jacobian)
    while steps < STEPS and distance > THERE:
        trial = z + as_float(step)
        ahead = look(problem, trial)
        if not ahead.loss < seen.loss:
            break
        z, seen, steps = trial, ahead, steps + 1
        step, distance = _step(seen, jacobian)
    return z, seen, distance, steps


def stay(problem: Problem, z: Array) -> Settled:
    """A point, with the slopes of all rays there."""
    seen, jacobian = linearised(problem, z)
    return Settled(z, seen, jacobian, _step(seen, jacobian)[1], 0)


def _step(seen: Seen, jacobian: Array) -> tuple[np.ndarray, float]:
    """The step to the solution of the linearised problem, and its distance."""
    scaled = np.asarray(seen.bend, np.float64)[:, None] * np.asarray(jacobian, np.float64)
    left, singular, right = np.linalg.svd(scaled, full_matrices=False)
    known = singular * DETERMINED > 1
    along = (left.T @ np.asarray(seen.robust, np.float64))[known]
    return -(along / singular[known]) @ right[known], float(np.linalg.norm(along))
