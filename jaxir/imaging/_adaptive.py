"""Rays where the error is: an image to an error of its pixels, or of its intensity.

A pilot of few rays, which are not part of the answer, tells how much each pixel varies; an image that places its rays
by the samples that it averages is biased (Kirk and Arvo, "Unbiased sampling techniques for image synthesis", 1991). By
the laws of `jaxir.imaging._placement` it says how many rays each pixel gets.

Every pixel gets two rays, or strata of its own where n_p is more. What a pixel varies is told by its own pilot and by
those of the nine around it (`law_of`): all rays of a pilot may lie on one side of an edge, in pixel after pixel where
the edge lies along them. From 8 rays to hundreds such laws err by factors, so where many are needed an image of few
tells first (`SCOUT`), which is not part of the answer either.
"""

from __future__ import annotations

import dataclasses
import math
import time
from functools import cached_property, partial, reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.sharding import Mesh
from jaxtyping import Array, Float, Int

from jaxir._arrays import placed
from jaxir._concurrent import cores, each_of
from jaxir._programs import of_items, program
from jaxir.geometry import TILE, Camera, places_in
from jaxir.imaging._chunks import (
    Pass,
    as_number,
    estimate_chunk,
    every_pixel,
    image_of_pixels,
    see,
    whole_image,
)
from jaxir.imaging._devices import progress, stacked
from jaxir.imaging._estimate import Estimate, Seen, Varied, of_strata
from jaxir.imaging._image import Image, joined
from jaxir.imaging._pilot import well_shaped
from jaxir.imaging._placement import Law, Window, law_of, window_of
from jaxir.imaging._tolerance import FIRST, Goal, excess, shares_of

PILOT = 4  # passes of the pilot, of two rays per pixel each or more
ROUNDS = 5  # at most; each decides for the next
MANY = 4  # times the rays that the pilot took where it saw the scene, beyond which a scout goes first
CLOSER = 0.88  # of the error asked for, once a scout or a round that missed it told more: pixels differ
SCOUT = 3.0  # times the error asked for, of that image: by a quarter of the rays
OF_SPOTS = 2**32 - 2  # beside the numbers of passes, for the random numbers of pixels with strata of their own


@dataclasses.dataclass(frozen=True)
class Strata:
    """Pixels with strata of their own, those of a tile side by side.

    Attributes:
        row, column: of each pixel [pixel].
        name: number of each in the image [pixel].
        edges: of the column and of the row of each on the screen [pixel, 2, 2] [m].
        count: strata of each [pixel].
        columns: of its strata [pixel].
    """

    row: Int[np.ndarray, " pixel"]
    column: Int[np.ndarray, " pixel"]
    name: Int[np.ndarray, " pixel"]
    edges: Float[np.ndarray, "pixel 2 2"]
    count: Int[np.ndarray, " pixel"]
    columns: Int[np.ndarray, " pixel"]

    @cached_property
    def end(self) -> Int[np.ndarray, " pixel"]:
        """Where each pixel's strata end among those of all [pixel]."""
        return np.cumsum(self.count)

    def chunks(self, size: int) -> int:
        """Chunks of so many in which all of them are seen."""
        return -(-int(self.count.sum()) // size)

    def chunk(
        self, size: int, number: int
    ) -> tuple[np.ndarray, np.ndarray, Int[np.ndarray, "spot 4"], Float[np.ndarray, "spot 2 2"]]:
        """Pixels of a chunk [pixel], where each begins [pixel], and what `_seen_at` asks for; the last fills up."""
        end = self.end
        begin, last = number * size, min((number + 1) * size, int(end[-1]))
        pixel = np.arange(*np.searchsorted(end, (begin, last - 1), side="right") + (0, 1))
        count, columns = self.count[pixel], self.columns[pixel]
        first = end[pixel] - count
        place = np.maximum(first - begin, 0)
        each = np.stack([self.name[pixel], first, columns, count // columns], axis=1)
        own = np.repeat(np.arange(len(pixel)), np.diff(place, append=size))
        spots = each[own].astype(np.int32)
        spots[:, 1] = np.minimum(np.arange(begin, begin + size), last - 1) - spots[:, 1]
        return pixel, place, spots, self.edges[pixel][own]


class Look(NamedTuple):
    """What a pilot saw.

    Attributes:
        image: of `PILOT` passes of two rays in every pixel, or of more where the target is smaller than one.
        met: whether it is the answer.
        law: what so many rays in each pixel bring.
        seconds: that its rays took.
        taken: its rays in pixels that show the scene.
        each: seconds of a ray, were all of them those of pixels that show the scene.
    """

    image: Image
    met: bool
    law: Law
    seconds: float
    taken: int
    each: float

    @property
    def rays(self) -> int:
        """In every pixel."""
        return int(self.image.samples)

    @property
    def base(self) -> float:
        """Seconds of two rays in every pixel, at most."""
        return self.seconds / PILOT

    def ends(self, goal: Goal) -> bool:
        """Whether it is the answer: it meets the goal, or there is no time for as many other rays."""
        return self.met or goal.seconds < 2 * self.seconds

    def strata(self, most: int, seconds: float, scale: float = 1.0) -> Int[np.ndarray, "row column"]:
        """See `Law.strata`; in so many seconds, to `scale` times the error asked for."""
        law = self.law._replace(constant=self.law.constant / scale**2)
        return law.strata(most, (seconds - self.base) / self.each)

    def asks_scout(self, strata: Int[np.ndarray, "row column"], seconds: float) -> bool:
        """Whether so many are worth it, and leave time for it."""
        added = 2 * float((strata - 1).sum())
        return added > MANY * self.taken and self.each * added < seconds / 2


def even_image(taken: Pass, number: int, samples: int = 2, mesh: Mesh | None = None) -> Image:
    """An image of as many rays in every pixel.

    Args:
        taken: a pass of the image.
        number: of the pass, which decides its random numbers.
        samples: rays per pixel.
        mesh: devices that share it, of `shared_by`.
    """
    taken = taken._replace(number=as_number(number)).of(samples)
    return whole_image(taken, stacked(estimate_chunk, taken.of_chunks(), taken.chunks(), "render", mesh))


def looks(few: int) -> int:
    """Rays per pixel of a pilot: eight, or about the `few` that show a target that is smaller than a pixel."""
    return PILOT * well_shaped(few // PILOT)[-1]


def looked(first: Pass, goal: Goal, few: int, noisy: bool, mesh: Mesh | None = None) -> Look:
    """What a pilot of an image sees.

    Args:
        first: a pass of the image.
        goal: what is asked.
        few: `looks` of it are its rays per pixel.
        noisy: whether what lights that are sampled vary is more than what edges do.
        mesh: devices that share it, of `shared_by`.
    """
    few, passes, times = looks(few) // PILOT, [], []
    for number in range(PILOT):
        began = time.perf_counter()
        passes.append(even_image(first, number, few, mesh=mesh))
        times.append(time.perf_counter() - began)
    image = reduce(joined, passes)
    weight, mean, error = goal.weight(image), np.asarray(image.radiance), np.asarray(image.standard_error)
    met = excess(shares_of(weight, error)) <= FIRST
    window = window_of(mean, error)
    near = mean[window].astype(np.float64), _of_a_pass(passes, window), weight[window]
    law = law_of(*near, few, PILOT, noisy).spread(first.camera.shape, window)
    shown = max(1, int((mean != np.asarray(image.empty)).any(axis=-1).sum()))
    spent = min(times)  # the first compiles
    return Look(image, met, law, PILOT * spent, PILOT * few * shown, spent / (few * shown))


def adapted(first: Pass, goal: Goal, look: Look, mesh: Mesh | None = None) -> tuple[Image, bool]:
    """An image whose rays lie where its error is, and whether the goal is met.

    Args:
        first: a pass of the image.
        goal: what is asked.
        look: of its pilot.
        mesh: devices that share it, of `shared_by`.
    """
    if look.ends(goal):
        return look.image, look.met
    left, before, aim = goal.seconds - look.seconds, np.zeros(()), 1.0
    for number in range(PILOT, PILOT + ROUNDS):
        began, count = time.perf_counter(), look.strata(goal.most, left, aim)
        if np.array_equal(count, before):  # no more are allowed
            break
        scouts = number == PILOT and look.asks_scout(count, left)
        if scouts:
            count = look.strata(goal.most, left, SCOUT)
        before = count
        added = 2 * float((count - 1).sum())
        image = _image_with_strata(first, number, strata_of(count, first.camera), mesh)
        shares = shares_of(goal.weight(image), np.asarray(image.standard_error))
        missed = excess(shares)
        if missed <= 1:
            return image, True
        aim = min(aim, CLOSER)
        if not scouts:  # what is rare is seen in other pixels every time: a law that erred is aimed lower by as much
            aim /= missed
        spent = min(time.perf_counter() - began, look.base + added * look.each)  # the first compiles
        left -= spent
        if left < spent:  # no time for as many again
            break
        each = min(look.each, max(spent - look.base, spent / 10) / max(added, 1))  # timers are coarse
        look = look._replace(law=look.law.corrected(shares.max(axis=-1), count, look.rays, first.noisy), each=each)
    return image, False


def seconds_of(first: Pass, goal: Goal, look: Look) -> float:
    """Seconds of `adapted` if what the look tells is right: by some of its chunks, that are seen twice."""
    taken, left = first.of(2), goal.seconds - look.seconds
    count = look.strata(goal.most, left)
    strata, own, spent = strata_of(count, first.camera), of_items(_seen_at, taken.of_chunks()), 0.0
    size = taken.spots
    some = [strata.chunk(size, number)[2:] for number in range(min(cores(), strata.chunks(size)))]
    for compiled in (False, True):
        began = time.perf_counter()
        list(each_of(lambda spots: jax.block_until_ready(own((np.uint32(0), *spots))), some, compiled))
        spent = (time.perf_counter() - began) / max(len(some), 1)
    rounds = [count]
    if look.asks_scout(count, left):
        rounds.append(look.strata(goal.most, left, SCOUT))
    return sum(look.base + spent * strata_of(each, first.camera).chunks(size) for each in rounds)


def _image_with_strata(first: Pass, number: int, strata: Strata, mesh: Mesh | None) -> Image:
    """An image of two rays in every pixel, with strata of their own in some."""
    taken = first._replace(number=as_number(number)).of(2)
    pixels = every_pixel(taken, stacked(estimate_chunk, taken.of_chunks(), taken.chunks(), "render", mesh))
    mean = 2 + 2 * (strata.count - 1).sum() / math.prod(first.camera.shape)
    return image_of_pixels(taken, with_strata(taken, pixels, strata), placed(np.int32(round(mean))))


def _of_a_pass(passes: list[Image], window: Window) -> Float[np.ndarray, "row column band"]:
    """Variance of the mean of the rays of a pass, by those of all: both sets of points of one may agree by chance.

    With n passes, means m_i and standard errors e_i it is sum (e_i^2 + (m_i - mean)^2) / (2 n - 1).
    """
    mean = np.array([np.asarray(image.radiance)[window] for image in passes], np.float64)
    within = sum(np.asarray(image.standard_error)[window].astype(np.float64) ** 2 for image in passes)
    return (within + ((mean - mean.mean(axis=0)) ** 2).sum(axis=0)) / (2 * len(passes) - 1)


def strata_of(count: Int[np.ndarray, "row column"], camera: Camera) -> Strata:
    """The pixels with more than one stratum, tile by tile."""
    row, column = np.nonzero(count > 1)
    order = np.lexsort((column, row, column // TILE, row // TILE))
    row, column = row[order], column[order]
    each = count[row, column]
    ends = ((axis, at[:, None] + np.arange(2)) for axis, at in enumerate((column, row)))
    edges = np.stack([camera.edges(*each) for each in ends], axis=1)
    columns = np.ceil(np.sqrt(each) - 1e-9).astype(np.int64)
    return Strata(row, column, row * camera.shape[1] + column, edges, each, columns)


def with_strata(taken: Pass, base: Estimate, strata: Strata) -> Estimate:
    """Estimates of all pixels [row, column], with strata of their own in some in the place of `base`."""
    count, size = strata.count, taken.spots
    chunks = strata.chunks(size)
    if count.size == 0:
        return base
    sums: Any = None
    own = of_items(_seen_at, taken.of_chunks())

    def seen_at(number: int) -> tuple[np.ndarray, np.ndarray, tuple[Seen, Varied, Varied]]:
        """Pixels of a chunk of strata, of which the last fill up the last chunk, and where each begins in it."""
        pixel, place, *spots = strata.chunk(size, number)
        seen = jax.device_get(own((np.uint32(number), *spots)))
        mean, apart = jax.tree.map(lambda leaf: leaf[: strata.end[-1] - number * size], seen)
        return pixel, place, (mean, apart, jax.tree.map(lambda leaf: np.square(leaf, dtype=np.float64), apart))

    with progress("render", chunks) as done:
        for pixel, place, seen in each_of(seen_at, range(chunks)):
            if sums is None:
                sums = jax.tree.map(lambda leaf: np.zeros((count.size, *leaf.shape[1:])), seen)
            jax.tree.map(partial(_add_by_pixel, pixel, place), sums, seen)
            done(1)
    mean, apart, square = sums
    apart, divisor = jax.tree.map(np.square, apart), count**2.0 / of_strata(1 / count, taken.noisy)

    def replaced(image: Any, own: np.ndarray | None, divisor: np.ndarray) -> Any:
        if own is None:
            return image
        changed = np.array(image)
        changed[strata.row, strata.column] = own / divisor.reshape(-1, *(1,) * (own.ndim - 1))
        return placed(changed)

    return Estimate(
        replaced(base.mean, mean.radiance, count),
        replaced(base.variance, apart.radiance, count**2.0),
        replaced(base.within, square.radiance, divisor),
        replaced(base.empty, mean.empty, count),
        replaced(base.orders, mean.orders, count),
        replaced(base.parts, mean.parts, count),
        replaced(base.parts_variance, apart.parts, count**2.0),
        replaced(base.parts_within, square.parts, divisor),
    )


def _add_by_pixel(pixel: np.ndarray, place: np.ndarray, total: np.ndarray, leaf: np.ndarray) -> None:
    """Add strata to their pixels; those of a pixel lie side by side from its `place` on."""
    total[pixel] += np.add.reduceat(leaf, place, axis=0, dtype=float)


@program
def _seen_at(taken: Pass, chunk: tuple[Array, Int[Array, "spot 4"], Float[Array, "spot 2 2"]]) -> tuple[Seen, Varied]:
    """Mean of two rays in each stratum of a chunk with its number, and half their difference; of a pass `of_chunks`.

    Of each stratum are given the number of its pixel, its own in it, columns and rows of strata there, and the pixel's
    edges.
    """
    camera, (number, spots, edges) = taken.camera, chunk
    pixel, within, columns, rows = (spots[:, k] for k in range(4))
    corner = [place(within, columns)[:, None] for place in (lax.rem, lax.div)]
    key = jax.random.fold_in(jax.random.fold_in(taken.key, OF_SPOTS), taken.number)
    for_pixels, for_spots = jax.random.split(key)
    for_places, for_paths = jax.random.split(jax.random.fold_in(for_spots, number))
    of_pixel = jax.vmap(jax.random.fold_in, (None, 0))(for_pixels, pixel)
    turn = jax.vmap(lambda key: jax.random.bits(key, (2,), jnp.uint32))(of_pixel)
    word = jax.random.bits(for_places, turn.shape, jnp.uint32)
    place = places_in(corner, [columns[:, None], rows[:, None]], turn, word)
    begin, end = edges[:, None, :, 0], edges[:, None, :, 1]
    screen = begin + place * (end - begin)
    bundle = camera.bundle(screen.reshape(-1, 2), taken.lit.scene.start(camera))
    seen = jax.tree.map(lambda value: value.reshape((-1, 2, *value.shape[1:])), see(taken, bundle, for_paths))
    mean = jax.tree.map(lambda value: (value[:, 0] + value[:, 1]) / 2, seen)
    two = Varied(seen.radiance, seen.parts)
    return mean, jax.tree.map(lambda value: (value[:, 0] - value[:, 1]) / 2, two)
