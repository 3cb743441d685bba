"""Rays where the error is: an image to an error of its pixels, or of its intensity.

A pilot of few rays, which are not part of the answer, tells how much each pixel varies; an image that places its rays
by the samples that it averages is biased (Kirk and Arvo, "Unbiased sampling techniques for image synthesis", 1991). The
variance of a pixel falls with its rays as c / n^a: a = 3/2 where edges cross it (`ErrorLaw`), more where it varies as
smoothly as the pixels about it (`_smooth`), 1 where lights are sampled. The sum over pixels is least for a number of
rays where one more ray is worth the same in each,

    n_p = (a_p c_p / mu)^(1 / (1 + a_p)),    mu so that    sum_p c_p / n_p^a_p = what is allowed.

Every pixel gets two rays, or strata of its own where n_p is more. What a pixel varies is half its own pilot's, at least
what edges may do that no ray of it told (`_of_unseen_edges`), and half that of the nine around it: all rays of a pilot
may lie on one side of an edge, in pixel after pixel where the edge lies along them.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Iterator
from functools import partial, reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Bool, Float, Int

from jaxir._arrays import placed
from jaxir._concurrent import each_of
from jaxir._programs import of_items, program
from jaxir.geometry import TILE, Camera, places_in
from jaxir.imaging._chunks import (
    Estimate,
    Pass,
    Seen,
    Varied,
    as_number,
    estimate_chunk,
    every_pixel,
    image_of_pixels,
    see,
    whole_image,
)
from jaxir.imaging._devices import over_items, progress
from jaxir.imaging._image import Image, joined
from jaxir.imaging._tolerance import FIRST, Goal

PILOT = 4  # passes of the pilot, of two rays per pixel each
LOOKED = 2 * PILOT  # its rays per pixel
MARGIN = 0.9  # of the error asked for that is aimed at: what the pilot tells is itself uncertain
ROUNDS = 3  # at most; each decides for the next
OF_SPOTS = 2**32 - 2  # beside the numbers of passes, for the random numbers of pixels with strata of their own
NOISE, EDGES, SMOOTH = (1.0, 1.0), (1.5, 0.8), (2.2, 0.6)  # a, and c of even points in that of two rays
_HALVINGS = 48


@dataclasses.dataclass(frozen=True)
class Strata:
    """Pixels with strata of their own, those of a tile side by side.

    Attributes:
        row, column: of each pixel [pixel].
        cells: columns and rows of its strata [pixel, 2].
    """

    row: Int[np.ndarray, " pixel"]
    column: Int[np.ndarray, " pixel"]
    cells: Int[np.ndarray, "pixel 2"]

    @property
    def count(self) -> Int[np.ndarray, " pixel"]:
        """Strata of each pixel."""
        return self.cells[:, 0] * self.cells[:, 1]


class Look(NamedTuple):
    """What a pilot saw.

    Attributes:
        image: of `PILOT` passes of two rays in every pixel, or of more where the target is smaller than one.
        met: whether it is the answer.
        constant: c of c / n^power, the share of the variance allowed that n rays in each pixel bring [row, column].
        power: a [row, column].
        seconds: that its rays took.
        each: seconds of a ray, were all of them those of pixels that show the scene.
    """

    image: Image
    met: bool
    constant: Float[np.ndarray, "row column"]
    power: Float[np.ndarray, "row column"]
    seconds: float
    each: float

    @property
    def base(self) -> float:
        """Seconds of two rays in every pixel."""
        return self.seconds / PILOT

    def ends(self, goal: Goal) -> bool:
        """Whether it is the answer: it meets the goal, or there is no time for as many other rays."""
        return self.met or goal.seconds < 2 * self.seconds

    def excess(self, strata: Int[np.ndarray, "row column"]) -> float:
        """Error, with so many in each pixel, over the error asked for."""
        return float(np.sqrt((self.constant / (2.0 * strata) ** self.power).sum()))

    def strata(self, most: int, seconds: float) -> Int[np.ndarray, "row column"]:
        """See `placement`; in so many seconds."""
        return placement(self.constant, self.power, most, (seconds - self.base) / self.each)


def even_image(taken: Pass, number: int, samples: int = 2, mesh: Mesh | None = None, alone: bool = False) -> Image:
    """An image of as many rays in every pixel.

    Args:
        taken: a pass of the image.
        number: of the pass, which decides its random numbers.
        samples: rays per pixel.
        mesh: devices that share it, of `shared_by`.
        alone: whether no other image is made of its chunks' program: if it is small, one program makes all of it.
    """
    taken = taken._replace(number=as_number(number)).of(samples)
    return over_items(estimate_chunk, whole_image, taken, taken.chunks(), "render", mesh, alone and taken.quick)


def looked(first: Pass, goal: Goal, mesh: Mesh | None = None, few: int = 2) -> Look:
    """What a pilot of an image sees, of `few` rays per pixel in each pass; other arguments of `adapted`."""
    passes, times = [], []
    for number in range(PILOT):
        began = time.perf_counter()
        passes.append(even_image(first, number, few, mesh=mesh))
        times.append(time.perf_counter() - began)
    image = reduce(joined, passes)
    met = goal.excess(image) <= FIRST
    varied, mean = _of_a_pass(passes), np.asarray(image.radiance, np.float64)
    noisy = first.method.needs_key(first.lit.scene)
    laws = [NOISE, NOISE] if noisy else [SMOOTH, EDGES]
    smooth = _smooth(mean, varied * few)
    power, even = (np.where(smooth, *values) for values in zip(*laws, strict=True))
    edges, factor = _of_unseen_edges(mean, varied, few), power[..., None]
    constant = np.maximum(even[..., None] * varied * few**factor, edges * 2**factor)
    constant = _around((goal.weight(image) * constant).max(axis=-1))
    shown = max(1, int((mean != np.asarray(image.empty, np.float64)).any(axis=-1).sum()))
    spent = min(times)  # the first compiles
    return Look(image, met, constant, power, PILOT * spent, spent / (few * shown))


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
    left = goal.seconds - look.seconds
    for number in range(PILOT, PILOT + ROUNDS):
        began, count = time.perf_counter(), look.strata(goal.most, left)
        image = _image_with_strata(first, number, strata_of(count, first.camera), mesh)
        if goal.excess(image) <= 1:
            return image, True
        added = 2 * float((count - 1).sum())
        spent = min(time.perf_counter() - began, look.base + added * look.each)  # the first compiles
        left -= spent
        if left < spent:  # no time for as many again
            break
        each = min(look.each, max(spent - look.base, spent / 10) / max(added, 1))  # timers are coarse
        variance = np.asarray(image.standard_error, np.float64) ** 2
        found = (goal.weight(image) * variance).max(axis=-1) * (2.0 * count) ** look.power
        look = look._replace(constant=np.maximum(look.constant, _around(found)), each=each)
    return image, False


def _image_with_strata(first: Pass, number: int, strata: Strata, mesh: Mesh | None) -> Image:
    """An image of two rays in every pixel, with strata of their own in some."""
    taken = first._replace(number=as_number(number)).of(2)
    pixels = over_items(estimate_chunk, every_pixel, taken, taken.chunks(), "render", mesh)
    mean = 2 + 2 * (strata.count - 1).sum() / math.prod(first.camera.shape)
    return image_of_pixels(taken, with_strata(taken, pixels, strata), placed(np.int32(round(mean))))


def _of_a_pass(passes: list[Image]) -> Float[np.ndarray, "row column band"]:
    """Variance of the mean of the rays of a pass, by those of all: both sets of points of one may agree by chance.

    With n passes, means m_i and standard errors e_i it is sum (e_i^2 + (m_i - mean)^2) / (2 n - 1).
    """
    mean = np.array([np.asarray(image.radiance, np.float64) for image in passes])
    within = sum(np.asarray(image.standard_error, np.float64) ** 2 for image in passes)
    return (within + ((mean - mean.mean(axis=0)) ** 2).sum(axis=0)) / (2 * len(passes) - 1)


def _of_unseen_edges(
    mean: Float[np.ndarray, "row column band"], varied: Float[np.ndarray, "row column band"], few: int
) -> Float[np.ndarray, "row column band"]:
    """Variance of the mean of two rays by edges that no ray of the pilot told.

    Where a pixel differs from one of the eight around it by d and neither of them varies, an edge lies in one of both
    beside all of its n = `PILOT` few rays. In it rays vary by f (1 - f) d^2, f being the share on one side, to which
    f^n tells: by (n + 1) / ((n + 2) (n + 3)) d^2 in the mean, 9 / 110 where n is 8. If a ray of one of the two lay on
    the other side, its variance is more than d^2 / n, and the edge was seen.

    Args:
        mean: what the pilot saw.
        varied: variance of the mean of a pass, by what it saw.
        few: rays in a pixel of a pass.
    """
    rays, unseen = PILOT * few, np.zeros_like(mean)
    for other, theirs in zip(_nine(mean), _nine(varied), strict=True):
        unseen = np.maximum(unseen, (mean - other) ** 2 - few * rays * (varied + theirs))
    return unseen * (rays + 1) / ((rays + 2) * (rays + 3)) / 4  # of two rays, in one of both


def _smooth(
    mean: Float[np.ndarray, "row column band"], varied: Float[np.ndarray, "row column band"]
) -> Bool[np.ndarray, "row column"]:
    """Where rays vary no more, in any band, than twice what the slope does that the pixels on both sides tell.

    A slope of g in each pixel makes g^2 / 12. An edge makes f (1 - f) d^2 where they tell d / 2, twelve times as much
    at its worst, and no more than twice as much only where it leaves less than a twentieth f of the pixel.

    Args:
        mean: what a pilot saw.
        varied: variance of a ray, by what it saw.
    """
    padded = np.pad(mean, ((1, 1), (1, 1), (0, 0)), mode="edge")
    down, along = (padded[2:, 1:-1] - padded[:-2, 1:-1]) / 2, (padded[1:-1, 2:] - padded[1:-1, :-2]) / 2
    return np.all(varied <= (down**2 + along**2) / 6, axis=-1)


def _around(constant: Float[np.ndarray, "row column"]) -> Float[np.ndarray, "row column"]:
    """Half each pixel's own, half the mean of the nine around it."""
    return constant / 2 + sum(_nine(constant)) / 18


def _nine(values: Float[np.ndarray, "row column *more"]) -> Iterator[Float[np.ndarray, "row column *more"]]:
    """What the pixel above to the left of each has, and so on to that below to the right; its own beyond the image."""
    rows, columns = values.shape[:2]
    padded = np.pad(values, ((1, 1), (1, 1), *((0, 0),) * (values.ndim - 2)), mode="edge")
    return (padded[i : i + rows, j : j + columns] for i, j in np.ndindex(3, 3))


def placement(
    constant: Float[np.ndarray, "row column"], power: Float[np.ndarray, "row column"], most: int, rays: float = math.inf
) -> Int[np.ndarray, "row column"]:
    """Strata of two rays in each pixel, in rows and columns nearly square; 1 for what two rays in the pixel do.

    Args:
        constant: c of c / n^power, the share of the variance allowed that n rays bring.
        power: a.
        most: rays in a pixel at most.
        rays: of all pixels at most, beyond two in each.
    """
    varied, own = constant[constant > 0], power[constant > 0]
    if varied.size == 0:
        return np.ones(constant.shape, np.int64)
    worth = own * varied

    def strata(scale: float) -> np.ndarray:
        return well_shaped_strata(np.minimum((scale * worth) ** (1 / (1 + own)) / 2, most / 2))

    def beyond(count: np.ndarray) -> bool:
        return bool(2 * (count - 1).sum() > rays)

    low, high = (np.log(2.0 ** (1 + own) / worth).min(), np.log(float(most) ** (1 + own) / worth).max())
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        tried = strata(np.exp(middle))
        enough = (varied / (2.0 * tried) ** own).sum() <= MARGIN**2 or beyond(tried)
        low, high = (low, middle) if enough else (middle, high)
        if high - low < 1e-3:
            break
    found = strata(np.exp(high))
    count = np.ones(constant.shape, np.int64)
    count[constant > 0] = strata(np.exp(low)) if beyond(found) else found
    return count


def well_shaped_strata(wanted: np.ndarray) -> Int[np.ndarray, " pixel"]:
    """k^2 or k (k + 1), at most `wanted` but for less than half the step to the next, and at least 1."""
    side = np.floor(np.sqrt(np.maximum(wanted, 1)) + 1e-9).astype(np.int64)
    steps = np.stack([side * side, side * (side + 1), (side + 1) ** 2])
    return np.take_along_axis(steps, np.abs(steps - wanted[None]).argmin(axis=0)[None], axis=0)[0]


def strata_of(count: Int[np.ndarray, "row column"], camera: Camera) -> Strata:
    """The pixels with more than one stratum, tile by tile."""
    row, column = np.nonzero(count > 1)
    order = np.lexsort((column, row, column // TILE, row // TILE))
    row, column = row[order], column[order]
    columns = np.ceil(np.sqrt(count[row, column]) - 1e-9).astype(np.int64)
    return Strata(row, column, np.stack([columns, count[row, column] // columns], axis=-1))


class Spots(NamedTuple):
    """Strata of pixels, two rays in each.

    Attributes:
        row, column: of the pixel [spot].
        corner: column and row of the stratum in it [spot, 2].
        cells: columns and rows of strata in it [spot, 2].
    """

    row: Array
    column: Array
    corner: Array
    cells: Array


def with_strata(taken: Pass, base: Estimate, strata: Strata) -> Estimate:
    """Estimates of all pixels [row, column], with strata of their own in some in the place of `base`."""
    size = taken.spots
    count, end = strata.count, np.cumsum(strata.count)
    sums: Any = None
    own = of_items(_seen_at, taken)

    def seen_at(chunk: tuple[np.ndarray, Spots, Array]) -> tuple[np.ndarray, tuple[Seen, Varied]]:
        return chunk[0], jax.device_get(own(chunk[1:]))

    with progress("render", -(-int(end[-1] if end.size else 0) // size)) as done:
        for pixel, seen in each_of(seen_at, _in_chunks(strata, end, size)):
            if sums is None:
                sums = jax.tree.map(lambda leaf: np.zeros((count.size, *leaf.shape[1:])), seen)
            jax.tree.map(partial(_add_by_pixel, pixel), sums, seen)
            done(1)
    if sums is None:
        return base
    seen, apart = sums
    apart = jax.tree.map(np.square, apart)

    def mixed(image: Any, own: np.ndarray | None, divisor: np.ndarray) -> Any:
        if own is None:
            return image
        changed = np.array(image)
        changed[strata.row, strata.column] = own / divisor.reshape(-1, *(1,) * (own.ndim - 1))
        return placed(changed)

    return Estimate(
        mixed(base.mean, seen.radiance, count),
        mixed(base.variance, apart.radiance, count**2.0),
        mixed(base.empty, seen.empty, count),
        mixed(base.orders, seen.orders, count),
        mixed(base.parts, seen.parts, count),
        mixed(base.parts_variance, apart.parts, count**2.0),
    )


def _add_by_pixel(pixel: np.ndarray, total: np.ndarray, leaf: np.ndarray) -> None:
    """Add spots to their pixels; those of a pixel lie side by side."""
    starts = np.flatnonzero(np.diff(pixel, prepend=-1))
    total[pixel[starts]] += np.add.reduceat(leaf[: pixel.size], starts, axis=0, dtype=float)


def _in_chunks(strata: Strata, end: np.ndarray, size: int) -> Iterator[tuple[np.ndarray, Spots, Array]]:
    """Pixel of each spot, the spots, of which the last fill up the last chunk, and the chunk's number."""
    total = int(end[-1]) if end.size else 0
    for number, start in enumerate(range(0, total, size)):
        index = np.arange(start, start + size)
        pixel = np.searchsorted(end, np.minimum(index, total - 1), side="right")
        within = np.minimum(index, total - 1) - (end - strata.count)[pixel]
        cells = strata.cells[pixel]
        corner = np.stack([within % cells[:, 0], within // cells[:, 0]], axis=-1)
        spots = (strata.row[pixel], strata.column[pixel], corner, cells)
        every = Spots(*(placed(part.astype(np.int32)) for part in spots))
        yield pixel[: min(size, total - start)], every, placed(np.uint32(number))


@program
def _seen_at(taken: Pass, chunk: tuple[Spots, Array]) -> tuple[Seen, Varied]:
    """Mean of two rays in each stratum of a chunk with its number, and half their difference."""
    camera, (spots, number) = taken.camera, chunk
    own = jax.random.fold_in(jax.random.fold_in(taken.key, OF_SPOTS), taken.number)
    for_pixels, for_spots = jax.random.split(own)
    for_places, for_paths = jax.random.split(jax.random.fold_in(for_spots, number))
    of_pixel = jax.vmap(jax.random.fold_in, (None, 0))(for_pixels, spots.row * camera.shape[1] + spots.column)
    turn = jax.vmap(lambda key: jax.random.bits(key, (2,), jnp.uint32))(of_pixel)
    word = jax.random.bits(for_places, turn.shape, jnp.uint32)
    corner, cells = ([part[:, k, None] for k in range(part.shape[1])] for part in (spots.corner, spots.cells))
    place = places_in(corner, cells, turn, word)
    screen = camera.points(spots.row[:, None], spots.column[:, None], place)
    bundle = camera.bundle(screen.reshape(-1, 2), taken.lit.scene.start(camera))
    seen = jax.tree.map(lambda value: value.reshape((-1, 2, *value.shape[1:])), see(taken, bundle, for_paths))
    mean = jax.tree.map(lambda value: (value[:, 0] + value[:, 1]) / 2, seen)
    two = Varied(seen.radiance, seen.parts)
    return mean, jax.tree.map(lambda value: (value[:, 0] - value[:, 1]) / 2, two)
