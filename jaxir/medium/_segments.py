"""Chunks of rays carried through the cells they cross, which are walked on the way or were listed before.

The geometry of rays is a few arrays and, statically, the shape of their grid:

    grid's origin and spacing, rays' origin and direction, t_max; (nx, ny, nz)    walked
    cell and length [ray, crossing], as in `Crossings`; None                      listed
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array

from jaxir._math import INSIDE, on_cpu
from jaxir.geometry import Grid, Segments, Walk, slab_segments, start_walk

CHUNK = 128  # consecutive rays carried together: enough to fill the vector units, few enough to stay alike
CARD_CHUNK = 1 << 18  # on graphics cards, where a step of a loop takes as long whatever the rays
FEW = 4  # nodes that are carried for many rays at a time, and rays whose adjoint is carried whatever the nodes

Lists = tuple[Array, ...]
Shape = tuple[int, int, int] | None


class Listed(NamedTuple):
    """Lists of a chunk of rays [crossing, ray], a multiple of three long, and the length of the longest."""

    cell: Array
    length: Array
    longest: Array


def geometry_parts(shape: Shape) -> int:
    """How many arrays the geometry is."""
    return 2 if shape is None else 5


def chunk_rays(rays: int, nodes: int) -> int:
    """How many rays are carried together.

    Several nodes fill the vector units by themselves, and XLA reads the row of one cell twice as fast as rows of many.
    """
    if not on_cpu():
        return max(1, min(CARD_CHUNK, rays))
    return max(1, min(CHUNK, rays)) if nodes <= FEW else 1


def adjoint_rays(rays: int, nodes: int, cells: int) -> int:
    """The same for an adjoint, whose many steps cost more per ray than the rows they are scattered to."""
    if not on_cpu():
        return max(1, min(CARD_CHUNK, rays, _rays_of_a_sum(rays, cells)))
    return max(1, min(CHUNK, rays, max(FEW, 1024 // max(nodes, 1))))


def _chunked(array: Array, group: int, size: int) -> Array:
    """[ray, ...] to [group, chunk, size, ...], filled up with zeros: a ray of direction 0 misses everything."""
    count = -(-array.shape[0] // (group * size))
    padding = [(0, count * group * size - array.shape[0])] + [(0, 0)] * (array.ndim - 1)
    return jnp.pad(array, padding).reshape((count, group, size) + array.shape[1:])


def _chunks_together(state: Any, rays: int, size: int) -> int:
    """How many chunks are summed together before their sum is added to that of the others."""
    cells = max((leaf.shape[0] for leaf in jax.tree.leaves(state)), default=0)
    every = -(-rays // size)
    return min(every, max(1, -(-_rays_of_a_sum(rays, cells) // size))) if cells else max(every, 1)


def _rays_of_a_sum(rays: int, cells: int) -> int:
    """How many rays are summed before their sum is added to that of the others.

    One number to which a million rays add, one after the other, loses three digits of float32. Sums of about the square
    root of all rays, and as many of them, keep them; a field of many cells gets fewer sums, as it gets fewer rays for
    each cell, so that adding fields costs less than crossing them.
    """
    return max(math.isqrt(rays), cells)


def over_chunks(
    function: Callable, state: Any, size: int, geometry: Lists, per_ray: Lists, shape: Shape
) -> tuple[Any, Any]:
    """Call `function(state, route, *per_ray) -> (state, [ray, ...])` chunk after chunk of `size` rays.

    The state is a sum over rays that begins at 0, or nothing.
    """
    if shape is None:
        each_ray = tuple(jnp.pad(x, ((0, 0), (0, -x.shape[1] % 3))) for x in geometry)
    else:
        grid, each_ray = Grid(geometry[0], geometry[1], shape), geometry[2:]
    parts = len(each_ray)

    def step(state, chunk):
        ahead = chunk[:parts]
        route = _listed(*ahead) if shape is None else jax.vmap(start_walk, in_axes=(None, 0, 0, 0))(grid, *ahead)
        return function(state, route, *chunk[parts:])

    def group(total, chunks):
        part, out = lax.scan(step, state, chunks)
        return jax.tree.map(jnp.add, total, part), out

    rays = each_ray[0].shape[0]
    together = _chunks_together(state, rays, size)
    total, out = lax.scan(group, state, tuple(_chunked(array, together, size) for array in (*each_ray, *per_ray)))
    return total, jax.tree.map(lambda x: x.reshape((-1,) + x.shape[3:])[:rays], out)


def _listed(cell: Array, length: Array) -> Listed:
    place = jnp.arange(1, cell.shape[1] + 1, dtype=jnp.int32)[None]
    return Listed(cell.T, length.T, jnp.max(jnp.where(length > 0, place, 0), initial=0))


def fold(route: Walk | Listed, update: Callable, state: Any, near_to_far: bool) -> Any:
    """Carry `state` through the segments of a chunk of rays: `update(state, cell [ray], length [ray])`."""
    if isinstance(route, Listed):

        def cross(i, state):
            place = i if near_to_far else route.longest - 1 - i
            return update(state, route.cell[place], route.length[place])

        return lax.fori_loop(0, route.longest, cross, state)
    slabs = jnp.max(route.last - route.first)

    def body(i, state):
        slab = route.first + i if near_to_far else route.last - 1 - i
        on = (slab < route.last) & (slab >= route.first)
        segments: Segments = jax.vmap(slab_segments)(route, slab, on)
        for cell, length in segments if near_to_far else segments[::-1]:
            state = update(state, cell, length)
        return state

    return lax.fori_loop(0, slabs, body, state)


def fold_threes(route: Walk | Listed, update: Callable, state: Any) -> Any:
    """As `fold`, near to far, a slab or three at a time: `update(state, cell [3, ray], length [3, ray])`."""
    if isinstance(route, Listed):

        def cross(i, state):
            cell, length = (
                lax.dynamic_slice_in_dim(part, 3 * i, 3, allow_negative_indices=False) for part in route[:2]
            )
            return update(state, cell, length)

        return lax.fori_loop(0, (route.longest + 2) // 3, cross, state)

    def body(i, state):
        slab = route.first + i
        segments: Segments = jax.vmap(slab_segments)(route, slab, slab < route.last)
        cell, length = (jnp.stack(parts) for parts in zip(*segments, strict=True))
        return update(state, cell, length)

    return lax.fori_loop(0, jnp.max(route.last - route.first), body, state)


def beside(length: Array, like: Array) -> Array:
    """Lengths [..., ray] spread over the nodes of `like`, if it has any."""
    return jnp.broadcast_to(length.reshape(length.shape + (1,) * (like.ndim - length.ndim)), like.shape)


def rows(field: Array, cell: Array) -> Array:
    """Rows [ray, node] of `field` [cell, node]; neither walks nor lists leave the grid."""
    return field.at[cell].get(**INSIDE)


def alone(*arrays: Array) -> tuple[Array, ...]:
    """Drop a node axis of length 1: XLA makes faster loops of [ray] than of [ray, 1]."""
    return tuple(array[..., 0] if array.shape[-1] == 1 else array for array in arrays)
