"""How much pixels vary with their rays, and how many rays they get for it.

The variance of a pixel falls with its rays as c / n^a: a = 3/2 where edges cross it (`ErrorLaw`), more where it varies
as smoothly as the pixels about it (`varies_smoothly`), 1 where lights are sampled. The sum over pixels is least for a
number of rays where one more ray is worth the same in each,

    n_p = (a_p c_p / mu)^(1 / (1 + a_p)),    mu so that    sum_p c_p / n_p^a_p = what is allowed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

MARGIN = 0.9  # of the error asked for that is aimed at: what the pilot tells is itself uncertain
NOISE, EDGES, SMOOTH = (1.0, 1.0), (1.5, 0.8), (2.2, 0.6)  # a, and c of even points in that of two rays
_HALVINGS = 48
REACH = 2  # pixels as far as which one tells of others: of those beside it by its difference, of theirs by `around`
MIDDLE = 32  # rays at which laws of neighbours are added
LEAST = 1e-9  # of what was foretold


Window = tuple[slice, slice]  # rows and columns of an image


class Law(NamedTuple):
    """Share of the variance allowed that n rays in each pixel bring: c / n^a.

    Attributes:
        constant: c [row, column].
        power: a [row, column].
    """

    constant: Float[np.ndarray, "row column"]
    power: Float[np.ndarray, "row column"]

    def at(self, rays: np.ndarray | float) -> Float[np.ndarray, "row column"]:
        """The share that so many rays in each pixel bring."""
        return self.constant / rays**self.power

    def excess(self, strata: Int[np.ndarray, "row column"]) -> float:
        """Error, with so many strata of two rays in each pixel, over the error asked for."""
        return float(np.sqrt(self.at(2.0 * strata).sum()))

    def spread(self, shape: tuple[int, int], window: Window) -> Law:
        """The same in an image of which it is known in a `window` alone, beyond which nothing varies."""
        constant, power = np.zeros(shape), np.full(shape, self.power.max())
        constant[window], power[window] = self
        return Law(constant, power)

    def smoothed(self) -> Law:
        """`around` of laws: the law with the value and the slope that their sum has at `MIDDLE` rays."""
        each = self.at(MIDDLE)
        value = around(each)
        slope = around(self.power * each) / np.where(value > 0, value, 1)
        power = np.where(value > 0, slope, self.power)
        return Law(value * MIDDLE**power, power)

    def corrected(
        self, found: Float[np.ndarray, "row column"], strata: Int[np.ndarray, "row column"], few: int, noisy: bool
    ) -> Law:
        """With the share of the variance allowed that an image of so many strata found, beside what `few` rays told.

        Where it has far more rays than those few, what both found tells the power, too, which is least where lights are
        sampled.
        """
        least = (NOISE if noisy else EDGES)[0]
        rays, differences = 2.0 * strata, few - 1  # differences that tell; of a stratum one does
        foretold, found = self.at(rays), around(found)
        share = strata / (differences + strata)
        ratio = np.divide(found, foretold, out=np.ones_like(found), where=foretold > 0)
        falls = share * np.log(np.maximum(ratio, LEAST)) / np.log(np.maximum(rays / few, 2))
        falls = np.where(rays > 2 * few, falls, 0)
        power = np.clip(self.power - falls, np.minimum(self.power, least), SMOOTH[0])
        return Law(((1 - share) * foretold + share * found) * rays**power, power)

    def strata(self, most: int, rays: float = math.inf) -> Int[np.ndarray, "row column"]:
        """Strata of two rays in each pixel, in rows and columns nearly square; 1 for what two rays in the pixel do.

        Args:
            most: rays in a pixel at most.
            rays: of all pixels at most, beyond two in each.
        """
        bright = self.constant > 0
        varied, own = self.constant[bright], self.power[bright]
        if varied.size == 0:
            return np.ones(self.constant.shape, np.int64)
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
        count = np.ones(self.constant.shape, np.int64)
        count[bright] = strata(np.exp(low)) if beyond(found) else found
        return count


def window_of(radiance: Float[np.ndarray, "row column band"], error: Float[np.ndarray, "row column band"]) -> Window:
    """Where a law is looked for: all but margins that show what the first pixel does, without error."""
    other = ((radiance != radiance[:1, :1]) | (error > 0)).any(axis=-1)
    edges = []
    for axis in range(2):
        at = np.flatnonzero(other.any(axis=1 - axis))
        edges.append(slice(max(at[0] - REACH, 0), at[-1] + REACH + 1) if at.size else slice(0, 1))
    return edges[0], edges[1]


def law_of(
    mean: Float[np.ndarray, "row column band"],
    varied: Float[np.ndarray, "row column band"],
    weight: Float[np.ndarray, "row column band"],
    few: int,
    pilot: int,
    noisy: bool,
) -> Law:
    """What a pilot tells of its pixels: half each one's own, at least that of unseen edges, half of the nine around.

    Args:
        mean: what the pilot saw.
        varied: variance of the mean of a pass, by what it saw.
        weight: share of what is allowed that a variance of 1 takes.
        few: rays in a pixel of a pass.
        pilot: how many passes.
        noisy: whether lights are sampled.
    """
    laws = [NOISE, NOISE] if noisy else [SMOOTH, EDGES]
    power, even = (np.where(varies_smoothly(mean, varied * few), *values) for values in zip(*laws, strict=True))
    edges, factor = of_unseen_edges(mean, varied, few, pilot), power[..., None]
    constant = np.maximum(even[..., None] * varied * few**factor, edges * 2**factor)
    return Law((weight * constant).max(axis=-1), power).smoothed()


def of_unseen_edges(
    mean: Float[np.ndarray, "row column band"], varied: Float[np.ndarray, "row column band"], few: int, pilot: int
) -> Float[np.ndarray, "row column band"]:
    """Variance of the mean of two rays by edges that no ray of the pilot told.

    Where a pixel differs from one of the eight around it by d and neither of them varies, an edge lies in one of both
    beside all of its n = `pilot` few rays. In it rays vary by f (1 - f) d^2, f being the share on one side, to which
    f^n tells: by (n + 1) / ((n + 2) (n + 3)) d^2 in the mean, 9 / 110 where n is 8. If a ray of one of the two lay on
    the other side, its variance is more than d^2 / n, and the edge was seen.

    Args:
        mean: what the pilot saw.
        varied: variance of the mean of a pass, by what it saw.
        few: rays in a pixel of a pass.
        pilot: how many passes.
    """
    rays, unseen = pilot * few, np.zeros_like(mean)
    for other, theirs in zip(_nine(mean), _nine(varied), strict=True):
        unseen = np.maximum(unseen, (mean - other) ** 2 - few * rays * (varied + theirs))
    return unseen * (rays + 1) / ((rays + 2) * (rays + 3)) / 4  # of two rays, in one of both


def varies_smoothly(
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


def around(values: Float[np.ndarray, "row column"]) -> Float[np.ndarray, "row column"]:
    """Half each pixel's own, half the mean of the nine around it."""
    return values / 2 + sum(_nine(values)) / 18


def _nine(values: Float[np.ndarray, "row column *more"]) -> Iterator[Float[np.ndarray, "row column *more"]]:
    """What the pixel above to the left of each has, and so on to that below to the right; its own beyond the image."""
    rows, columns = values.shape[:2]
    padded = np.pad(values, ((1, 1), (1, 1), *((0, 0),) * (values.ndim - 2)), mode="edge")
    return (padded[i : i + rows, j : j + columns] for i, j in np.ndindex(3, 3))


def well_shaped_strata(wanted: np.ndarray) -> Int[np.ndarray, " pixel"]:
    """k^2 or k (k + 1), at most `wanted` but for less than half the step to the next, and at least 1."""
    side = np.floor(np.sqrt(np.maximum(wanted, 1)) + 1e-9).astype(np.int64)
    square = side * side
    return square + side * (wanted > square + side / 2) + (side + 1) * (wanted > square + (3 * side + 1) / 2)
