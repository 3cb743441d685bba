"""What is read of a table on the way of rays, summed: a loop over rays, with derivatives in both modes.

    out[ray] = sum_s passed[ray, s] sum_h lobe[ray, h] sum_kj share[ray, s, k, j] table[place[ray, s, k] + j, h]

with j of 0 and 1: rows are read in pairs that follow one another. As operations of arrays each of its numbers is
fetched by an index of its own; row by row they are read as they lie, several times faster, and steps without shares
cost nothing; graphics cards take a step of all rays at a time. Linear in the table; along the other factors the same
sum in ordinary operations is differentiated.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from jaxir._math import einsum, on_platform
from jaxir.medium import register_linear, streaming_primitive


def collected(
    place: Int[Array, "ray step pair"],
    share: Float[Array, "ray step pair 2"],
    passed: Float[Array, "ray step node"],
    lobe: Float[Array, "ray harmonic"],
    table: Float[Array, "read harmonic node"],
) -> Float[Array, "ray node"]:
    """The sum at this module's head. Differentiable in all but `place`, in both modes."""
    return collected_p.bind(place, share, passed, lobe, table, rows=table.shape[0])[0]


def _pair(rows: Array, first: Array) -> Array:
    """Two rows that follow one another."""
    return lax.dynamic_slice_in_dim(rows, first, 2, allow_negative_indices=False)


def _over_steps(share: Array, one: Callable[[Array, Array, Array], Array], begin: Array, ray: Array) -> Array:
    """`one(ray, step, carried)` for all steps of a ray that have shares."""

    def step(s: Array, carried: Array) -> Array:
        return lax.cond(jnp.any(share[ray, s] != 0), lambda held: one(ray, s, held), lambda held: held, carried)

    return lax.fori_loop(0, share.shape[1], step, begin)


def _sum(*operands: Array, rows: int) -> list:
    return on_platform(*operands, cpu=partial(_ray_by_ray, rows=rows), default=partial(_step_by_step, rows=rows))


def _spread(*operands: Array, rows: int) -> list:
    """The transpose: what each ray hands to the rows that it read."""
    return on_platform(*operands, cpu=partial(_spread_by_ray, rows=rows), default=partial(_spread_by_step, rows=rows))


def _step_by_step(place: Array, share: Array, passed: Array, lobe: Array, table: Array, *, rows: int) -> list:
    """For graphics cards: a step of all rays at a time."""

    def step(s: Array, total: Array) -> Array:
        for k in range(share.shape[2]):
            pair = (table[place[:, s, k] + j] * share[:, s, k, j, None, None] for j in range(2))
            total = total + einsum("rhn,rh->rn", sum(pair), lobe) * passed[:, s]
        return total

    return [lax.fori_loop(0, share.shape[1], step, jnp.zeros((place.shape[0], table.shape[2]), table.dtype))]


def _spread_by_step(place: Array, share: Array, passed: Array, lobe: Array, out: Array, *, rows: int) -> list:
    def step(s: Array, table: Array) -> Array:
        given = lobe[:, :, None] * (out * passed[:, s])[:, None]
        for k in range(share.shape[2]):
            for j in range(2):
                table = table.at[place[:, s, k] + j].add(given * share[:, s, k, j, None, None])
        return table

    return [lax.fori_loop(0, share.shape[1], step, jnp.zeros((rows, lobe.shape[1], out.shape[1]), out.dtype))]


def _ray_by_ray(place: Array, share: Array, passed: Array, lobe: Array, table: Array, *, rows: int) -> list:
    harmonics, nodes = table.shape[1:]
    flat = table.reshape(rows, -1)

    def add(i: Array, s: Array, total: Array) -> Array:
        pairs = [(share[i, s, k], _pair(flat, place[i, s, k])) for k in range(share.shape[2])]
        near = [both[0] * rows[0] + both[1] * rows[1] for both, rows in pairs]
        row = lax.optimization_barrier(sum(near[1:], near[0]))  # else all pairs are read anew for every harmonic
        each = [lobe[i, h] * row[h * nodes : (h + 1) * nodes] for h in range(harmonics)]
        return total + sum(each[1:], each[0]) * passed[i, s]

    def ray(i: Array, out: Array) -> Array:
        return lax.dynamic_update_index_in_dim(out, _over_steps(share, add, jnp.zeros_like(out[0]), i), i, 0)

    return [lax.fori_loop(0, place.shape[0], ray, jnp.zeros((place.shape[0], nodes), table.dtype))]


def _spread_by_ray(place: Array, share: Array, passed: Array, lobe: Array, out: Array, *, rows: int) -> list:
    def hand(i: Array, s: Array, table: Array) -> Array:
        given = lax.optimization_barrier((lobe[i][:, None] * (out[i] * passed[i, s])[None]).reshape(-1))
        for k in range(share.shape[2]):
            at = place[i, s, k]
            held = _pair(table, at) + share[i, s, k][:, None] * given[None]
            table = lax.dynamic_update_slice_in_dim(table, held, at, 0, allow_negative_indices=False)
        return table

    none = jnp.zeros((rows, lobe.shape[1] * out.shape[1]), out.dtype)
    table = lax.fori_loop(0, place.shape[0], lambda i, table: _over_steps(share, hand, table, i), none)
    return [table.reshape(rows, lobe.shape[1], -1)]


def _plain(place: Array, share: Array, passed: Array, lobe: Array, table: Array, *, rows: int) -> list:
    seen = einsum("rskjhn,rh->rskjn", table[_rows(place)], lobe)
    return [jnp.sum(jnp.sum(share[..., None] * seen, axis=(2, 3)) * passed, axis=1)]


def _plainly_spread(place: Array, share: Array, passed: Array, lobe: Array, out: Array, *, rows: int) -> list:
    given = (out[:, None] * passed)[:, :, None, None, None] * lobe[:, None, None, None, :, None]
    none = jnp.zeros((rows, lobe.shape[1], out.shape[1]), out.dtype)
    return [none.at[_rows(place)].add(given * share[..., None, None])]


def _rows(place: Array) -> Array:
    """Both rows of each pair [ray, step, pair, 2]."""
    return jnp.stack([place, place + 1], axis=-1)


def _like_rays(place: Any, share: Any, passed: Any, lobe: Any, table: Any, *, rows: int) -> list:
    return [table.update(shape=(place.shape[0], table.shape[2]))]


def _like_table(place: Any, share: Any, passed: Any, lobe: Any, out: Any, *, rows: int) -> list:
    return [out.update(shape=(rows, lobe.shape[1], out.shape[1]))]


collected_p = streaming_primitive("collected", _sum, _like_rays)
spread_p = streaming_primitive("spread", _spread, _like_table)
register_linear(collected_p, spread_p, 4, _plain)
register_linear(spread_p, collected_p, 4, _plainly_spread)
