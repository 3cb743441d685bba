"""What is found of pixels: what they see, and how much that varies."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

FEW = 6.0  # pixels, of which as much is told by their strata as by themselves


class Seen(NamedTuple):
    """What rays see [ray, band] or pixels [tile, pixel, band]: all, without the scene, two orders, components."""

    radiance: Array
    empty: Array | None
    orders: Array | None
    parts: Array | None


class Varied(NamedTuple):
    """Variance of radiance, and of that by component, where it was asked for; shapes as `Seen`."""

    radiance: Array
    parts: Array | None


class Estimate(NamedTuple):
    """Mean radiance in pixels and its variance [tile, pixel, band] or [row, column, band].

    Attributes:
        mean: radiance.
        variance: of it by the squared difference of a pixel's two sets of points, without bias.
        within: of it by those of the strata, surer, but only about right, see `of_strata`.
        empty: what would be seen without the scene; one value [1, 1, band] where the background is uniform.
        orders: what the last two orders of scattering brought [tile, pixel, 2, band]; None without particles.
        parts: the mean by component [tile, pixel, component, band]; None where they were not asked for.
        parts_variance, parts_within: of them.
    """

    mean: Array
    variance: Array
    within: Array
    empty: Array
    orders: Array | None
    parts: Array | None
    parts_variance: Array | None
    parts_within: Array | None

    def surer(self) -> tuple[Array, Array | None]:
        """Variance of all pixels and that by component, as sure as they can be told.

        Of a pixel one difference tells, whose square is small by chance: the intensity of a target in one pixel, of 72
        rays, was off by more than three standard errors in a quarter of all images. So of few pixels most of the
        variance is that of their strata, see `by_strata`; then it never was, and told were up to 1.9 times as much.
        """
        parts = self.parts_variance
        if parts is not None:
            assert self.parts_within is not None
            parts = _surer(parts, self.parts_within)
        return _surer(self.variance, self.within), parts


def of_strata(share: Any, noisy: bool) -> Any:
    """What the variance of a pixel is of that by its strata alone, as if they did not vary together.

    All of it where something is sampled along rays, and of one stratum. Edges across many vary less, for points keep
    apart: images of skin, sun and plumes have .4 to .7 of it with 4 to 144 strata, targets as small as a stratum all.

    Args:
        share: 1 / number of strata.
        noisy: whether anything is sampled along rays.
    """
    return 1.0 if noisy else (3 + share) / 4


def by_strata(alike: Any, among: Any) -> Any:
    """What is told by strata: F^2 / (F^2 + n^2), F being `FEW`, of n pixels that vary alike, or of more that do not.

    Args:
        alike: sum of `Estimate.within` over pixels.
        among: and of their squares; 0 where nothing varies.
    """
    nothing = float(np.finfo(among.dtype).tiny)  # of what does not vary
    few, number = (FEW * among) ** 2, alike**4
    return few / (few + number + nothing)


def _surer(variance: Float[Array, "row column *more"], within: Float[Array, "row column *more"]) -> Array:
    most = jnp.max(within, axis=(0, 1), keepdims=True)
    each = lax.stop_gradient(within / jnp.where(most > 0, most, 1))
    share = by_strata(*(jnp.sum(power, axis=(0, 1), keepdims=True) for power in (each, each**2)))
    return (1 - share) * variance + share * within
