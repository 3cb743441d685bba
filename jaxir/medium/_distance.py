"""Where on a ray particles scatter it: a distance drawn from a typical extinction, the proposal.

With m(t) the proposal and U its depth to the end of the ray, a photon's free path has the density m exp(-depth). Forced
into the medium, it has m exp(-depth) / (1 - exp(-U)). The proposal is constant in every cell of a grid and in every
panel of a ray, so that both are drawn exactly; whatever it is, quantity / density has the right mean wherever the
proposal is positive.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxir.geometry import Grid, Rays
from jaxir.medium._segments import chunk_rays, fold, over_chunks


class Distance(NamedTuple):
    """A place on each ray.

    Attributes:
        t: distance from the origin [ray] [m].
        inverse_pdf: 1 / density [ray] [m]; 0 where the ray is not scattered.
        passing: 1 / chance to pass without being scattered [ray]; 0 where it is scattered.
    """

    t: Float[Array, " ray"]
    inverse_pdf: Float[Array, " ray"]
    passing: Float[Array, " ray"]


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


def _distance(drawn: _Drawn, whole: Array, t: Array, proposal: Array) -> Distance:
    good = drawn.scattered & (proposal > 0)
    inverse = jnp.where(good, drawn.chance * jnp.exp(drawn.depth) / jnp.where(good, proposal, 1), 0)
    return Distance(jnp.where(good, t, 0), inverse, jnp.where(good, 0, jnp.exp(jnp.where(good, 0, whole))))


def sample_in_panels(
    cuts: Float[Array, "ray cut"],
    proposal: Float[Array, "ray panel"],
    u: Float[Array, " ray"],
    forced: Bool[Array, " ray"],
) -> Distance:
    """The distance at which each ray is scattered, from panels with one proposal each.

    Args:
        cuts: ends of the panels, rising [ray, panel + 1] [m].
        proposal: extinction in each panel [ray, panel] [m-1].
        u: uniform numbers in [0, 1) [ray].
        forced: rays that are scattered for certain if the proposal has any depth; the others may pass [ray].
    """

    def one(cuts: Array, proposal: Array, u: Array, forced: Array) -> Distance:
        length = jnp.diff(cuts)
        depth = proposal * length
        upto = jnp.cumsum(depth)
        drawn = _drawn(upto[-1], u, forced)
        here = jnp.minimum(jnp.sum(upto <= drawn.depth, dtype=jnp.int32), depth.shape[0] - 1)
        own = proposal[here]
        rest = (drawn.depth - (upto[here] - depth[here])) / jnp.where(own > 0, own, 1)
        return _distance(drawn, upto[-1], cuts[here] + jnp.clip(rest, 0, length[here]), own)

    return jax.vmap(one)(cuts, proposal, u, forced)


def sample_in_cells(
    grid: Grid,
    proposal: Float[Array, "nx ny nz"],
    rays: Rays,
    t_max: Float[Array, " ray"],
    u: Float[Array, " ray"],
    forced: Bool[Array, " ray"],
) -> Distance:
    """As `sample_in_panels` for the cells that rays cross: one walk for the whole depth, one to the depth drawn."""
    cells = proposal.reshape(-1)

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

        begin = jax.vmap(grid.entry)(origin, direction)
        # A depth rounded past the whole ends in the last cell; one of 0 begins in the first that has particles.
        target = jnp.maximum(drawn.depth, jnp.finfo(u.dtype).tiny)
        t, _, last = fold(walk, follow, (begin, target, jnp.zeros_like(u)), near_to_far=True)
        return (), _distance(drawn, whole, t, last)

    geometry = (grid.origin, grid.spacing, rays.origin, rays.direction, t_max)
    per_ray = (rays.origin, rays.direction, u, forced)
    return Distance(*over_chunks(chunk, (), chunk_rays(rays.count, 1), geometry, per_ray, grid.shape)[1])
