"""From pixels to rays: for images, signatures and fits alike.

A pixel is cut into strata, and each stratum gets two random points, so that half their squared difference is an
unbiased estimate of its variance.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from jaxir._arrays import as_float
from jaxir.geometry._camera import TILE, Camera
from jaxir.geometry._ray import Bundle


def pixel_strata(samples: int) -> tuple[int, int]:
    """Columns and rows of strata in a pixel: samples / 2 of them, as square as its divisors allow."""
    if samples < 2 or samples % 2:
        raise ValueError(f"samples: got {samples}, expected an even number >= 2 (two points in each stratum)")
    half = samples // 2
    rows = max(d for d in range(1, math.isqrt(half) + 1) if half % d == 0)
    return half // rows, rows


def stratum_points(
    key: Key[Array, ""], index: Int[Array, " stratum"], tiles: int, strata: tuple[int, int] | Int[Array, "2"]
) -> Float[Array, "stratum 2 tile pixel 2"]:
    """The two random points of some strata, for all pixels of some tiles, as places in (0, 1) inside the pixels.

    One random word serves both coordinates: points lie in the middles of 65536 x 65536 cells of the stratum.
    """
    cells = as_float(strata)
    corner = jnp.stack([index % strata[0], index // strata[0]], axis=-1).astype(cells.dtype)
    shape = (*index.shape, 2, tiles, TILE * TILE)
    word = jax.random.bits(key, (math.prod(shape),), jnp.uint32).reshape(shape)  # more axes compile for a second
    halves = jnp.stack([word >> 16, word & 0xFFFF], axis=-1)
    jitter = (halves.astype(cells.dtype) + 0.5) / 65536
    return (corner[:, None, None, None] + jitter) / cells[(None,) * 4]


def pixel_samples(key: Key[Array, ""], tiles: int, samples: int) -> Float[Array, "stratum 2 tile pixel 2"]:
    """Places inside pixels in [0, 1): two independent points in each of samples / 2 strata."""
    strata = pixel_strata(samples)
    index = jnp.arange(strata[0] * strata[1], dtype=jnp.int32)
    return stratum_points(key, index, tiles, strata)


def tile_rays(
    camera: Camera,
    tile: Int[Array, " tile"],
    offset: Float[Array, "stratum 2 tile pixel 2"],
    start: Float[Array, ""],
) -> Bundle:
    """The rays through points of the pixels of some tiles.

    Args:
        camera: the eye.
        tile: index of each tile.
        offset: places inside the pixels, of `stratum_points` for some strata.
        start: height above the target plane at which they start [m].

    Returns:
        Rays in the order [tile, pixel, stratum, 2]: those of a pixel lie side by side, so that a bundle of them covers
        few faces.
    """
    screen = jax.vmap(jax.vmap(lambda place: camera.screen(tile, place)))(offset)
    return camera.bundle(screen.transpose(2, 3, 0, 1, 4).reshape(-1, 2), start)
