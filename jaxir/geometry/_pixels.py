"""From pixels to rays: for images, signatures and fits alike.

A pixel is cut into strata, and each stratum gets two random points, one of each of two sets. Points of one set keep
apart also along both axes: with c columns and r rows of strata, column i is cut into r parts of which row j has one,
and row j into c parts of which column i has one,

    x = (i + (p(j) + u) / r) / c,      y = (j + (q(i) + v) / c) / r,

p and q being random permutations of a pixel and a set, u and v random numbers of a point (Kensler, "Correlated
multi-jittered sampling", Pixar Technical Memo 13-01, 2013). Every point is uniform in its stratum, and the two sets are
independent. So a quarter of the squared difference of their means is an unbiased estimate of the variance of the mean
of all, which is .6 to .75 of that of independent points in all strata across a straight edge, at its worst as much, and
.2 to .35 of it in a smooth field.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int, Key, UInt32

from jaxir._arrays import as_float
from jaxir.geometry._camera import TILE, Camera, tile_points
from jaxir.geometry._loops import varying
from jaxir.geometry._ray import Bundle


def pixel_strata(samples: int) -> tuple[int, int]:
    """Columns and rows of strata in a pixel: samples / 2 of them, as square as its divisors allow."""
    if not isinstance(samples, int | np.integer) or samples < 2 or samples % 2:
        raise ValueError(f"samples: got {samples!r}, expected an even number >= 2 (two points in each stratum)")
    half = samples // 2
    rows = max(d for d in range(1, math.isqrt(half) + 1) if half % d == 0)
    return half // rows, rows


def stratum_points(
    key: Key[Array, ""],
    turn: UInt32[Array, "2 tile pixel"],
    index: Int[Array, " stratum"],
    strata: tuple[int, int] | Int[Array, "2"],
) -> Float[Array, "stratum 2 tile pixel 2"]:
    """The two random points of some strata, for all pixels of some tiles, as places in (0, 1) inside the pixels.

    Args:
        key: of these strata.
        turn: random words, the same for all strata of a pixel.
        index: which strata, row by row.
        strata: columns and rows.
    """
    cells = [jnp.asarray(number, index.dtype) for number in strata]
    shape = (*index.shape, *turn.shape)
    word = jax.random.bits(key, (math.prod(shape),), jnp.uint32).reshape(shape)  # more axes compile for a second
    corner = [place(index, cells[0])[:, None, None, None] for place in (lax.rem, lax.div)]
    return places_in(corner, cells, turn[None], word)


def places_in(
    corner: Sequence[Int[Array, "*#point"]],
    cells: Sequence[Int[Array, "*#point"]],
    turn: UInt32[Array, "*#point"],
    word: UInt32[Array, "*point"],
) -> Float[Array, "*point 2"]:
    """Points in strata, as places in (0, 1) inside their pixels.

    One random word serves both coordinates: points lie in the middles of 65536 x 65536 cells of their parts.

    Args:
        corner: column and row of the stratum.
        cells: columns and rows.
        turn: random, the same for all points of one set in one pixel.
        word: random, of each point.
    """
    (column, row), (columns, rows) = corner, cells
    # an item's place in a permutation is that of its hash among those of all
    seeds = turn, turn ^ np.uint32(0x68E31DA4)
    own = _hash(seeds[0], row), _hash(seeds[1], column)

    def count(k: Array, parts: tuple[Array, Array]) -> tuple[Array, Array]:
        before = [_hash(seed, k) < mine for seed, mine in zip(seeds, own, strict=True)]
        x, y = (((k < n) & less).astype(jnp.int32) for n, less in zip((rows, columns), before, strict=True))
        return parts[0] + x, parts[1] + y

    none = varying(jnp.zeros(jnp.broadcast_shapes(own[0].shape, own[1].shape), jnp.int32), turn)
    most = jnp.maximum(jnp.max(columns), jnp.max(rows))
    parts = lax.fori_loop(jnp.zeros_like(most), most, count, (none, none))
    dtype = as_float(0.0).dtype

    def place(own: Array, count: Array, part: Array, parts: Array, low: Array) -> Array:
        within = (part.astype(dtype) + (low.astype(dtype) + 0.5) / 65536) / parts.astype(dtype)
        return (own.astype(dtype) + within) / count.astype(dtype)

    x = place(column, columns, parts[0], rows, word >> 16)
    y = place(row, rows, parts[1], columns, word & 0xFFFF)
    return jnp.stack([x, y], axis=-1)


def _hash(seed: UInt32[Array, "*#point"], number: Int[Array, "*#point"]) -> UInt32[Array, "*point"]:
    """Words that are random for each seed, no two alike: numbers stirred by multiplications."""
    value = seed ^ (number.astype(jnp.uint32) * np.uint32(0x9E3779B9))
    for shift, factor in ((16, 0x7FEB352D), (15, 0x846CA68B)):
        value = (value ^ (value >> shift)) * np.uint32(factor)
    return value ^ (value >> 16)


def pixel_samples(key: Key[Array, ""], tiles: int, samples: int) -> Float[Array, "stratum 2 tile pixel 2"]:
    """Places inside pixels in [0, 1): two independent sets with a point in each of samples / 2 strata."""
    of_pixels, of_points = jax.random.split(key)
    strata = pixel_strata(samples)
    index = jnp.arange(strata[0] * strata[1], dtype=jnp.int32)
    return stratum_points(of_points, turns(of_pixels, tiles), index, strata)


def turns(key: Key[Array, ""], tiles: int) -> UInt32[Array, "2 tile pixel"]:
    """Random words of both sets of points in every pixel of some tiles."""
    return jax.random.bits(key, (2 * tiles * TILE * TILE,), jnp.uint32).reshape(2, tiles, -1)


def tile_rays(
    camera: Camera,
    edges: Float[Array, "tile 2 17"],
    offset: Float[Array, "stratum 2 tile pixel 2"],
    start: Float[Array, ""],
) -> Bundle:
    """The rays through points of the pixels of some tiles.

    Args:
        camera: the eye.
        edges: of the tiles, of `Camera.tile_edges`.
        offset: places inside the pixels, of `stratum_points` for some strata.
        start: height above the target plane at which they start [m].

    Returns:
        Rays in the order [tile, pixel, stratum, 2]: those of a pixel lie side by side, so that a bundle of them covers
        few faces.
    """
    screen = jax.vmap(jax.vmap(lambda place: tile_points(edges, place)))(offset)
    return camera.bundle(screen.transpose(2, 3, 0, 1, 4).reshape(-1, 2), start)
