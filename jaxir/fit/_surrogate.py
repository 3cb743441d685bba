"""Fewer rays that lead a jet's fit to the solution of all.

A jet's few parameters act on all of its rays, so a few of them stand for all on the way to a solution. The hook is
`lead`, which takes the place of `reach` where a problem `applies`; `thinned` chooses and traces the rays beforehand.

One walk on logarithmic residuals leads near the solution on the fewest rays. `_approach` goes on to the minimum z0 of
those that steer and evaluates all rays there; and `_settle` adds to their prediction p what they lack there,

    p(z) + P(z0) - p(z0),

with P of all rays, and goes on to the minimum of that: as multipoint or multifidelity methods correct a cheap model by
one value of the dear one (Alexandrov et al., "Approximation and model management in aerodynamic optimization with
variable-fidelity models", J. Aircraft 38(6), 2001). An error E of the slopes leaves its share of the way from z0, and
at the solution, where J^T r = 0, a distance of |E^T r| that is not seen: with residuals r of some standard deviations
and the slopes of the rays that steer, a tenth of one or less.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax import lax
from jaxtyping import Array, Float, Key

from jaxir._arrays import as_float, placed
from jaxir._concurrent import side_by_side
from jaxir._programs import program
from jaxir.fit._measurement import Measurement
from jaxir.fit._observation import Observation, RaySum, ViewRays, ray_sum
from jaxir.fit._problem import Problem
from jaxir.fit._walk import (
    THERE,
    Finish,
    Reached,
    Seen,
    Solution,
    best_way,
    linearised,
    look,
    newton_step,
    pick,
    stay,
    walk,
)
from jaxir.scene import Scene
from jaxir.transport import Paths, evaluate

LEADING = 32  # rays of each half of a row that lead a jet near the solution
STEERING = 448  # that tell the slopes there: standard deviations within 0.2 to 1.6 % of those of all, for eight keys
EVEN = 0.1  # share of those that lead spread evenly, the rest where the radiance is
EVEN_STEERING = 0.5  # of those that steer: a jet's length, say, acts where it is dim
MISLED = 0.3  # distance at which fewer rays have led to the wrong place
APPROACHED = 2.0  # distance from the minimum of the rays that steer at which to ask all rays
SETTLED = 0.1  # distance from the minimum of all rays that may be left
SLOPES = 0.03  # error of the slopes of the rays that steer, as a share of the way from where all were evaluated
LOOKS = 4  # evaluations of all rays at most
STEPS = 8  # towards the minimum of the rays that steer at most, each time


class Surrogate(eqx.Module):
    """Rays that stand for those on which a jet acts, per measurement; None where all are needed.

    Attributes:
        leading: few, that lead near a solution.
        steering: more, that tell its slopes.
    """

    leading: tuple[RaySum | None, ...]
    steering: tuple[RaySum | None, ...]


def thinned(observations: tuple[Observation, ...], key: Key[Array, ""]) -> Surrogate | None:
    """Choose and trace fewer rays.

    Args:
        observations: measurements with all of their rays.
        key: random key.

    Returns:
        The rays; None where no measurement has fewer.
    """
    pairs = []
    for i, observed in enumerate(observations):
        keys = jax.random.split(jax.random.fold_in(key, i))
        each = zip(_chosen(observed), keys, strict=True)
        pairs.append([ray_sum(observed.scene, observed.measurement, some, own) for some, own in each])
    leading, steering = (tuple(sums) for sums in zip(*pairs, strict=True))
    return None if all(rays is None for rays in leading) else Surrogate(leading, steering)


def applies(problem: Problem) -> bool:
    """Whether a problem has fewer rays that lead to its solution."""
    return problem.surrogate is not None


def lead(problem: Problem, starts: Array, max_steps: int) -> tuple[Reached, Finish]:
    """Walk from every start, by fewer rays; takes the place of `reach`.

    Args:
        problem: what to solve; the hook `applies`.
        starts: z of the starts [start, p].
        max_steps: of each walk.

    Returns:
        Where the best walk ended, about at the minimum of the rays that steer, and what tells the solution from there.
    """
    kept = problem.surrogate
    assert isinstance(kept, Surrogate)
    few, steering = predicted_by(problem, kept.leading), predicted_by(problem, kept.steering)
    near = best_way(few, steering, starts, None, None, max_steps, [True])
    asked, more = _approach(problem, steering, near)
    near = near._replace(z=asked.z, seen=asked.seen, steps=near.steps + more)

    def finish(drifted: bool) -> Solution:
        end = _settle(problem, steering, asked, near)
        arrived = bool(end.result == optx.RESULTS.successful) and end.distance <= MISLED
        return end if drifted or arrived else _walked_on(problem, end, max_steps)

    return near, finish


def _walked_on(problem: Problem, end: Solution, max_steps: int) -> Solution:
    """From where fewer rays have misled, by all of them."""
    walked = walk(problem, end.z[None], None, None, max_steps, jnp.array([True, False]), jnp.array(False))
    return stay(problem, walked.end[0], end.steps + int(walked.steps[0]), pick(walked.result, 0))


class _Asked(NamedTuple):
    """A point, what all rays and those that steer say of it, and the Jacobian of the residuals of the latter."""

    z: Array
    every: Seen
    seen: Seen
    jacobian: Array


def _ask(problem: Problem, fewer: Problem, z: Array) -> _Asked:
    """The value of all rays and the slopes of fewer, the two dearest parts of a solution, side by side."""
    every, (seen, jacobian) = side_by_side(lambda: look(problem, z), lambda: linearised(fewer, z))
    return _Asked(z, every, seen, jacobian)


def _approach(problem: Problem, fewer: Problem, near: Reached) -> tuple[_Asked, int]:
    """From near the solution to about the minimum of the rays that steer: Gauss-Newton steps that lower the loss.

    All rays are asked at every step, while the slopes of the fewer are found: mostly one step is enough, and then
    their value there is what `_settle` needs.

    Args:
        problem: what to solve.
        fewer: the same with the rays that steer.
        near: where the walk ended, seen by those.

    Returns:
        Where it ended, and steps taken.
    """
    asked, steps, z, seen = None, 0, near.z, near.seen
    step, distance = newton_step(seen, near.jacobian)
    while steps < STEPS and distance > APPROACHED:
        ahead = _ask(problem, fewer, z + as_float(step))
        if not ahead.seen.loss < seen.loss:
            break
        asked, z, seen, steps = ahead, ahead.z, ahead.seen, steps + 1
        step, distance = newton_step(seen, ahead.jacobian)
    return asked or _Asked(z, look(problem, z), seen, near.jacobian), steps


def _settle(problem: Problem, fewer: Problem, asked: _Asked, near: Reached) -> Solution:
    """From about the minimum of the rays that steer to that of all rays.

    Args:
        problem: what to solve.
        fewer: the same with the rays that steer.
        asked: about the minimum of those.
        near: the walk so far.

    Returns:
        Where it ended. Residuals are those of all rays at the last point where they were evaluated, and from there on
        change as those of the rays that steer.
    """
    z, total = asked.z, near.steps
    for turn in range(LOOKS):
        asked = _ask(problem, fewer, z) if turn else asked
        z, seen, left, steps = _descend(_completed(fewer, asked), asked)
        total += steps
        way = np.asarray(asked.jacobian, np.float64) @ np.asarray(z - asked.z, np.float64)
        distance = left + SLOPES * float(np.linalg.norm(way))
        if distance <= SETTLED:
            break
    return Solution(z, seen, asked.jacobian, distance, total, near.result)


def _descend(problem: Problem, asked: _Asked) -> tuple[Array, Seen, float, int]:
    """Gauss-Newton steps with slopes that stay, as long as they lower the loss.

    Returns:
        The point, what is seen there, the distance that is left, steps taken.
    """
    z, seen, steps = asked.z, asked.every, 0
    step, distance = newton_step(seen, asked.jacobian)
    while steps < STEPS and distance > THERE:
        trial = z + as_float(step)
        ahead = look(problem, trial)
        if not ahead.loss < seen.loss:
            break
        z, seen, steps = trial, ahead, steps + 1
        step, distance = newton_step(seen, asked.jacobian)
    return z, seen, distance, steps


class _Raised(eqx.Module):
    """An observation of fewer rays.

    Attributes:
        observation: with fewer rays in the place of all.
        lacking: what is added to the predictions of both halves in each block [block, 2, row, band].
    """

    observation: Observation
    lacking: Float[Array, "block 2 row band"]

    @property
    def measurement(self) -> Measurement:
        """What was measured."""
        return self.observation.measurement

    def predict_halves(self, scene: Scene) -> Float[Array, "block 2 row band"]:
        """As `Observation.predict_halves`, with what is lacking."""
        return self.observation.predict_halves(scene) + self.lacking


def predicted_by(problem: Problem, rays: tuple[RaySum | None, ...]) -> Problem:
    """The same problem, predicted by fewer rays where there are such."""

    def fewer(observed: Observation, own: RaySum | None) -> Observation | _Raised:
        if own is None:
            return observed
        value = observed.measurement.value
        some = eqx.tree_at(lambda o: o.through, observed, own)
        return _Raised(some, jnp.zeros((observed.blocks, 2, *value.shape), value.dtype))

    observations = tuple(fewer(*each) for each in zip(problem.observations, rays, strict=True))
    bare = eqx.tree_at(lambda p: p.surrogate, problem, None, is_leaf=lambda x: x is None)
    return eqx.tree_at(lambda p: p.observations, bare, observations)


def _completed(fewer: Problem, asked: _Asked) -> Problem:
    """The problem of fewer rays, whose predictions are raised by what all rays say above them at a point."""

    def raised(observed: Observation | _Raised, every: Array, own: Array) -> Observation | _Raised:
        if isinstance(observed, Observation):
            return observed
        more = observed.lacking + (every - own) * observed.measurement.standard_deviation[None, None]
        return _Raised(observed.observation, more)

    each = zip(fewer.observations, asked.every.halves, asked.seen.halves, strict=True)
    return eqx.tree_at(lambda p: p.observations, fewer, tuple(raised(*one) for one in each))


def _chosen(observed: Observation) -> tuple[ViewRays | None, ViewRays | None]:
    """About `LEADING` and `STEERING` rays of each half of a row that stand for all rays that meet a jet and no skin.

    Systematic sampling with a probability proportional to what a ray contributes now, averaged over bands, so that
    each ray kept stands for the same part of its row, along a curve that fills the image, so that it stands for its
    neighbours. A jet's few parameters act on all of its rays; parameters of the skin may act on a few rays only, so
    those that meet it stay. None where that leaves most.
    """
    through, plume = observed.through, observed.scene.plume
    if plume is None or not plume.parametric or through is None:
        return None, None
    parts = _parts(through, observed.scene, observed.measurement)
    weight, part = (np.asarray(x, np.float64) for x in (through.weight, parts))
    group = np.broadcast_to(np.asarray(through.group)[..., None], weight.shape).reshape(-1)
    weight, part = weight.reshape(-1), part.reshape(-1, part.shape[-1])
    segments = through.paths.segments  # [chunk, segment, place, ...], of which the first end at the eye
    face = np.full(weight.size, -1) if segments.vertex is None else np.asarray(segments.vertex.face)[:, 0].reshape(-1)
    free, on_skin = np.flatnonzero((face < 0) & (weight > 0)), np.flatnonzero((face >= 0) & (weight > 0))
    blocks, of_block, count = np.unique(group[free], return_inverse=True, return_counts=True)
    free = free[np.argsort(of_block, kind="stable")]
    # blocks are alike and each lies along the curve, so they are threaded by the share of a block that lies before
    of_block = np.sort(of_block)
    along = (np.arange(free.size) - (np.cumsum(count) - count)[of_block]) / count[of_block]
    halves = 2 * observed.measurement.value.shape[0]
    of = blocks[of_block] % halves
    thread = np.lexsort((along, of))
    free, (_, of) = free[thread], np.unique(of[thread], return_inverse=True)
    by_light, by_area = _share(part[free], of).mean(axis=1), _share(weight[free, None], of)[:, 0]

    def about(count: int, even: float) -> ViewRays | None:
        share = (1 - even) * by_light + even * by_area
        share = share / np.bincount(of, share)[of]
        above = np.cumsum(share) - of  # groups lie one behind the other and have a share of 1 each
        picks = np.floor(count * above + 0.5) - np.floor(count * (above - share) + 0.5)
        kept = np.flatnonzero(picks > 0)
        if 2 * kept.size > free.size:
            return None
        scaled = weight.copy()
        scaled[free[kept]] *= picks[kept] / (count * share[kept])
        index = np.concatenate([on_skin, free[kept]])
        rays = jax.tree.map(lambda leaf: placed(np.asarray(leaf)[:, 0].reshape(-1, 3)[index]), segments.rays)
        # all in the first block: only their sums count, and few blocks of few rays would be of another shape every time
        group_of, face_of = (x[index].astype(np.int32) for x in (group % halves, face))
        scaled_weight = scaled[index].astype(through.weight.dtype)
        return ViewRays(rays, *map(placed, (scaled_weight, group_of, face_of, np.ones(index.size, bool))))

    return about(LEADING, EVEN), about(STEERING, EVEN_STEERING)


@program
def _parts(rays: RaySum, scene: Scene, measurement: Measurement) -> Float[Array, "chunk slice place band"]:
    """Magnitude of what each ray adds to its row."""
    lit = measurement.lit(scene)

    def chunk(each: tuple[Paths, Array]) -> Array:
        paths, weight = each
        contrast = lit.nodes.in_band(evaluate(lit, paths) - lit.empty(paths.rays.direction))
        return jnp.abs(weight[..., None] * contrast.reshape((*weight.shape, -1)))

    return lax.map(chunk, (rays.paths, rays.weight))


def _share(part: np.ndarray, of: np.ndarray) -> np.ndarray:
    """Parts [ray, band] over their sum in the group `of` each ray; an even share where all are 0."""
    total = np.stack([np.bincount(of, column) for column in part.T], axis=1)[of]
    even = (1 / np.bincount(of))[of][:, None]
    return np.where(total > 0, part / np.where(total > 0, total, 1), even)
