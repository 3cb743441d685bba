"""The walk of a ray through a grid: which cells it crosses, and for how long.

A ray is followed slab by slab along its dominant axis, the one on which it advances most cells per metre. Inside one
slab it meets at most one cell face of each other axis, so a slab is at most three segments. Positions are computed
from the slab's index by one multiplication and one addition: nothing accumulates, and any slab can be asked for
without the ones before it, in either order. The grid and the ray are traced once and carry no derivative.

A ray that runs inside a face between two cells belongs to the cell on the side of larger coordinates; a ray inside
the outermost face of largest coordinate is outside.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxir._arrays import require_shape
from jaxir._math import at_once
from jaxir.geometry._grid import Grid
from jaxir.geometry._loops import greater, lesser, within
from jaxir.geometry._ray import Rays

FLAT = 1e-30  # a sideways drift of fewer cells per slab than this never reaches a face: its inverse is not needed
LIST_CHUNK = 256  # rays whose slabs are unrolled at a time


Pair = tuple[Float[Array, ""], Float[Array, ""]]


class Walk(eqx.Module):
    """Constants of one ray's walk. Slab coordinate s grows along the ray by 1 per slab; lengths across are in cells.

    What exists once for each of the two other axes is a pair, so that a batch of walks reads each of them in a row.

    Attributes:
        across: the two other coordinates at s = 0.
        drift: their change per slab, at most 1 in size.
        inverse: 1 / drift, 0 where there is none.
        top: largest cell index on the two other axes.
        step: length of the ray per slab [m].
        enter: s where the walk begins.
        leave: s where it ends; `leave` <= `enter` for a ray that misses.
        first: index of the slab with `enter`.
        last: one past the index of the slab with `leave`; equals `first` on a miss.
        base: flat index of the cell (0, 0) of slab 0.
        stride: change of the flat index from a slab to the next.
        across_stride: and along the two other axes.
    """

    across: Pair
    drift: Pair
    inverse: Pair
    top: Pair
    step: Float[Array, ""]
    enter: Float[Array, ""]
    leave: Float[Array, ""]
    first: Int[Array, ""]
    last: Int[Array, ""]
    base: Int[Array, ""]
    stride: Int[Array, ""]
    across_stride: tuple[Int[Array, ""], Int[Array, ""]]


def _pick(axis: Int[Array, ""], triple: Array) -> tuple[Array, Array, Array]:
    """`triple` turned so that `axis` comes first; selections, because a gather per ray is slow."""
    x, y, z = triple[0], triple[1], triple[2]
    return tuple(  # type: ignore[return-value]
        jnp.where(axis == 0, a, jnp.where(axis == 1, b, c)) for a, b, c in ((x, y, z), (y, z, x), (z, x, y))
    )


def _inside(across: Array, drift: Array, count: Array) -> tuple[Array, Array]:
    """Slab coordinates between which 0 <= across + s drift <= count; empty (inf, -inf) when there are none."""
    flat = drift == 0
    safe = jnp.where(flat, 1, drift)
    at_low, at_high = -across / safe, (count - across) / safe
    held = (across >= 0) & (across < count)
    low = jnp.where(flat, jnp.where(held, -jnp.inf, jnp.inf), jnp.minimum(at_low, at_high))
    high = jnp.where(flat, jnp.where(held, jnp.inf, -jnp.inf), jnp.maximum(at_low, at_high))
    return low, high


def _inverse(drift: Array) -> Array:
    """1 / drift, 0 where there is none."""
    return jnp.where(drift == 0, 0, 1 / jnp.where(drift == 0, 1, drift))


def start_walk(grid: Grid, origin: Float[Array, " 3"], direction: Float[Array, " 3"], t_max: Float[Array, ""]) -> Walk:
    """Constants of the walk of one ray from its origin to `t_max`.

    Args:
        grid: the grid.
        origin: [3] [m]; may lie inside the grid.
        direction: unit vector [3]; the zero vector is a miss.
        t_max: distance at which the ray ends [m]; inf allowed, <= 0 is a miss.

    Returns:
        `Walk`.

    Not differentiable.
    """
    position = (origin - grid.origin) / grid.spacing
    speed = direction / grid.spacing
    size = jnp.abs(speed)
    axis = jnp.where((size[0] >= size[1]) & (size[0] >= size[2]), 0, jnp.where(size[1] >= size[2], 1, 2)).astype(
        jnp.int32
    )
    along, first_across, second_across = _pick(axis, position)
    pace, *paces = _pick(axis, speed)
    shape = jnp.asarray(grid.shape, jnp.int32)
    count, *counts = _pick(axis, shape)
    strides = jnp.asarray((grid.shape[1] * grid.shape[2], grid.shape[2], 1), jnp.int32)
    stride, *across_strides = _pick(axis, strides)

    moving, forward = pace != 0, pace > 0
    rate = jnp.where(moving, jnp.abs(pace), 1)
    cells = count.astype(position.dtype)
    here = jnp.where(forward, along, cells - along)  # slab coordinate of the ray's origin
    across, drift, low, high = [], [], [], []
    for coordinate, pace_across, count_across in zip((first_across, second_across), paces, counts, strict=True):
        per_slab = pace_across / rate
        per_slab = jnp.where(jnp.abs(per_slab) < FLAT, 0, per_slab)
        at_zero = coordinate - here * per_slab
        bounds = _inside(at_zero, per_slab, count_across.astype(position.dtype))
        across.append(at_zero)
        drift.append(per_slab)
        low.append(bounds[0])
        high.append(bounds[1])
    enter = jnp.maximum(jnp.maximum(here, 0), jnp.maximum(low[0], low[1]))
    leave = jnp.minimum(jnp.minimum(here + t_max * rate, cells), jnp.minimum(high[0], high[1]))
    hit = moving & (leave > enter)
    enter, leave = jnp.where(hit, enter, 0), jnp.where(hit, leave, 0)
    return Walk(
        across=(across[0], across[1]),
        drift=(drift[0], drift[1]),
        inverse=(_inverse(drift[0]), _inverse(drift[1])),
        top=(counts[0].astype(position.dtype) - 1, counts[1].astype(position.dtype) - 1),
        step=1 / rate,
        enter=enter,
        leave=leave,
        first=jnp.floor(enter).astype(jnp.int32),
        last=jnp.ceil(leave).astype(jnp.int32),
        base=jnp.where(forward, 0, (count - 1) * stride),
        stride=jnp.where(forward, stride, -stride),
        across_stride=(across_strides[0], across_strides[1]),
    )


Segments = tuple[tuple[Array, Array], tuple[Array, Array], tuple[Array, Array]]


def slab_segments(walk: Walk, slab: Int[Array, ""], on: Bool[Array, ""]) -> Segments:
    """The three segments (flat C-order cell index, length [m]) of one ray in one slab, near to far.

    Args:
        walk: constants of the ray.
        slab: index of the slab.
        on: whether the ray crosses that slab at all; if not, cells are valid and lengths are zero.

    Returns:
        ((cell, length), (cell, length), (cell, length)); lengths >= 0, zero where there is no such segment.

    Not differentiable.
    """
    slab = jnp.where(on, slab, walk.first)
    s = slab.astype(walk.step.dtype)
    before, after, cut = [], [], []
    for a in range(2):
        near = walk.across[a] + s * walk.drift[a]
        far = walk.across[a] + (s + 1) * walk.drift[a]
        # Rounding may carry a coordinate over a face by its last digit. Outside the grid the segment has no length;
        # and a drift of at most one cell never changes the index by two.
        cell_near = within(jnp.floor(near), 0, walk.top[a])
        cell_far = within(jnp.floor(far), greater(cell_near - 1, 0), lesser(cell_near + 1, walk.top[a]))
        face = greater(cell_near, cell_far)
        cut.append(jnp.where(cell_near == cell_far, 1, (face - near) * walk.inverse[a]))
        before.append(cell_near.astype(jnp.int32) * walk.across_stride[a])
        after.append(cell_far.astype(jnp.int32) * walk.across_stride[a])
    begin = within(walk.enter - s, 0, 1)
    end = jnp.where(on, within(walk.leave - s, 0, 1), begin)
    first = within(lesser(cut[0], cut[1]), begin, end)
    second = within(greater(cut[0], cut[1]), begin, end)
    base = walk.base + slab * walk.stride
    between = jnp.where(cut[0] < cut[1], after[0] + before[1], before[0] + after[1])
    return (
        (base + (before[0] + before[1]), (first - begin) * walk.step),
        (base + between, (second - first) * walk.step),
        (base + (after[0] + after[1]), (end - second) * walk.step),
    )


class Crossings(eqx.Module):
    """The cells that rays cross, near to far.

    Attributes:
        cell: flat C-order cell index [ray, crossing]; 0 where `length` is 0.
        length: length of the ray inside the cell [ray, crossing] [m]; the list is padded with zeros.
    """

    cell: Int[Array, "ray crossing"]
    length: Float[Array, "ray crossing"]

    @property
    def bound(self) -> int:
        """Length of the lists."""
        return self.cell.shape[1]

    def trim(self, bound: int) -> Crossings:
        """The same lists cut to `bound` crossings, for a caller who knows that none is longer."""
        return Crossings(self.cell[:, :bound], self.length[:, :bound])

    def longest(self) -> Int[Array, ""]:
        """Number of cells on the ray that crosses most."""
        return jnp.max(jnp.sum(self.length > 0, axis=1, dtype=jnp.int32), initial=0)


def crossing_bound(shape: tuple[int, int, int]) -> int:
    """Most cells that one ray can cross: each step changes one index by one, and never back.

    Two more than the exact nx + ny + nz - 2, because rounding may put the first and the last cell beside the ray.
    """
    return sum(shape)


def _ray_crossings(
    grid: Grid, origin: Float[Array, " 3"], direction: Float[Array, " 3"], t_max: Float[Array, ""]
) -> tuple[Int[Array, " crossing"], Float[Array, " crossing"]]:
    """Cells and lengths of one ray."""
    walk = start_walk(grid, origin, direction, t_max)
    slabs = walk.first + jnp.arange(max(grid.shape), dtype=jnp.int32)
    segments = jax.vmap(lambda slab: slab_segments(walk, slab, slab < walk.last))(slabs)
    cell = jnp.stack([segment[0] for segment in segments], axis=1).reshape(-1)
    length = jnp.stack([segment[1] for segment in segments], axis=1).reshape(-1)
    bound = crossing_bound(grid.shape)
    kept = length > 0
    place = jnp.where(kept, jnp.cumsum(kept, dtype=jnp.int32) - 1, bound)
    return (
        jnp.zeros(bound, jnp.int32).at[place].set(cell, mode="drop"),
        jnp.zeros(bound, length.dtype).at[place].set(length, mode="drop"),
    )


@jax.jit
def _lists(grid: Grid, rays: Rays, t_max: Array) -> tuple[Array, Array]:
    """Lists of all rays, `LIST_CHUNK` rays at a time."""
    every_ray = (rays.origin, rays.direction, t_max)
    return lax.map(lambda ray: _ray_crossings(grid, *ray), every_ray, batch_size=at_once(LIST_CHUNK))


def crossings(grid: Grid, rays: Rays, t_max: Float[Array, " ray"]) -> Crossings:
    """The cells that each ray crosses between its origin and `t_max`, near to far.

    Args:
        grid: the grid.
        rays: start anywhere, also inside the grid; in float32 they should start near it (a coordinate keeps 7 digits).
        t_max: where each ray ends [ray] [m]; inf allowed.

    Returns:
        `Crossings` with `crossing_bound(grid.shape)` places per ray.

    Raises:
        ValueError: `t_max` is not one number per ray.

    Not differentiable: geometry is traced.
    """
    require_shape("t_max", t_max, (rays.count,))
    return Crossings(*_lists(*lax.stop_gradient((grid, rays, t_max))))
