"""Where on a ray particles scatter it: a place drawn from a medium of typical extinction, the guide.

With m(t) the guide and U its depth to the end of the ray, a photon's free path has the density m exp(-depth). Forced
into the plume, it has m exp(-depth) / (1 - exp(-U)). The guide is constant in each cell of a grid and in each panel of
a jet, so that both are drawn exactly; whatever the guide is, quantity / density has the right mean wherever the guide
is positive.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxir._arrays import as_float
from jaxir.geometry import Grid, Rays
from jaxir.scene.jet import JetPlume
from jaxir.scene.plume import GridPlume
from jaxir.transport.jet import jet_panels
from jaxir.transport.segments import chunk_rays, fold, over_chunks


class FreePath(NamedTuple):
    """A place on each ray.

    Attributes:
        t: distance from the origin [ray] [m].
        factor: 1 / density [ray] [m]; 0 where the ray is not scattered.
        passing: 1 / chance to pass without being scattered [ray]; 0 where it is scattered.
    """

    t: Float[Array, " ray"]
    factor: Float[Array, " ray"]
    passing: Float[Array, " ray"]


def free_path(
    plume: GridPlume | JetPlume,
    rays: Rays,
    t_max: Float[Array, " ray"],
    u: Float[Array, " ray"],
    forced: Bool[Array, " ray"],
) -> FreePath:
    """Draw the place where each ray is scattered before `t_max`.

    Args:
        plume: with particles, without derivatives.
        rays: the rays.
        t_max: where they end [ray] [m]; inf allowed.
        u: uniform numbers in [0, 1) [ray].
        forced: rays that are scattered for certain if they cross particles; the others may pass [ray].

    Returns:
        `FreePath`.
    """
    assert plume.particles is not None
    guide = plume.particles.guide()[0]
    if isinstance(plume, GridPlume):
        return _in_grid(plume.grid, jnp.broadcast_to(guide, plume.grid.shape), rays, t_max, u, forced)

    def one(origin: Array, direction: Array, end: Array, u: Array, forced: Array) -> FreePath:
        begin, length, fraction = jet_panels(plume, origin, direction, end)
        density = plume.exit_temperature / plume.temperature(fraction)
        return _in_panels(begin, length, guide * fraction * density, u, forced)

    return jax.vmap(one)(rays.origin, rays.direction, t_max, u, forced)


class _Drawn(NamedTuple):
    """`depth` to go, 1 / `chance` not to pass, and whether the place lies before the end of the ray."""

    depth: Array
    chance: Array
    scattered: Array


def _drawn(whole: Array, u: Array, forced: Array) -> _Drawn:
    """The depth at which a ray of depth `whole` is scattered."""
    chance = jnp.where(forced, -jnp.expm1(-whole), 1)
    depth = -jnp.log1p(-u * chance)
    return _Drawn(depth, chance, (depth < whole) | (forced & (whole > 0)))


def _path(drawn: _Drawn, whole: Array, t: Array, guide: Array) -> FreePath:
    good = drawn.scattered & (guide > 0)
    factor = jnp.where(good, drawn.chance * jnp.exp(drawn.depth) / jnp.where(good, guide, 1), 0)
    return FreePath(jnp.where(good, t, 0), factor, jnp.where(good, 0, jnp.exp(jnp.where(good, 0, whole))))


def _in_panels(begin: Array, length: Array, guide: Array, u: Array, forced: Array) -> FreePath:
    """The place on one ray whose panels [panel] follow one another from `begin`."""
    depth = guide * length
    upto, end = jnp.cumsum(depth), jnp.cumsum(length)
    drawn = _drawn(upto[-1], u, forced)
    here = jnp.minimum(jnp.sum(upto <= drawn.depth, dtype=jnp.int32), depth.shape[0] - 1)
    rest = (drawn.depth - (upto[here] - depth[here])) / jnp.where(guide[here] > 0, guide[here], 1)
    t = begin + end[here] - length[here] + jnp.clip(rest, 0, length[here])
    return _path(drawn, upto[-1], t, guide[here])


def _in_grid(grid: Grid, guide: Array, rays: Rays, t_max: Array, u: Array, forced: Array) -> FreePath:
    """The place on rays through cells: one walk for the depth of the whole ray, one to the depth drawn."""
    cells = guide.reshape(-1)

    def chunk(_, walk, origin, direction, u, forced):
        def deepen(depth, cell, length):
            return depth + cells[cell] * length

        whole = fold(walk, deepen, jnp.zeros_like(u), near_to_far=True)
        drawn = _drawn(whole, u, forced)

        def follow(state, cell, length):
            t, rest, last = state
            own = cells[cell]
            on = rest > 0
            enough = on & (own * length >= rest)
            step = jnp.where(enough, rest / jnp.where(enough, own, 1), length)
            rest = jnp.where(enough, 0, rest - own * length)
            return (t + jnp.where(on, step, 0), jnp.where(on, rest, 0), jnp.where(on & (own > 0), own, last))

        begin = jax.vmap(_entry, in_axes=(None, 0, 0))(grid, origin, direction)
        # A depth rounded past the whole ends in the last cell; one of 0 begins in the first that has particles.
        target = jnp.maximum(drawn.depth, jnp.finfo(u.dtype).tiny)
        t, _, last = fold(walk, follow, (begin, target, jnp.zeros_like(u)), near_to_far=True)
        return (), _path(drawn, whole, t, last)

    geometry = (grid.origin, grid.spacing, rays.origin, rays.direction, t_max)
    per_ray = (rays.origin, rays.direction, u, forced)
    return FreePath(*over_chunks(chunk, (), chunk_rays(rays.count, 1), geometry, per_ray, grid.shape)[1])


def _entry(grid: Grid, origin: Array, direction: Array) -> Array:
    """Where a ray enters the box of a grid; 0 from inside [m]."""
    moving = direction != 0
    safe = jnp.where(moving, direction, 1)
    size = grid.spacing * as_float(jnp.asarray(grid.shape))
    near = jnp.minimum((grid.origin - origin) / safe, (grid.origin + size - origin) / safe)
    return jnp.max(jnp.where(moving, near, 0), initial=0)
