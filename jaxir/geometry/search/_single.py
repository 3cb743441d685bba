"""Search of a tree by unrelated rays, one at a time."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap, sequential_vmap
from jaxtyping import Array, Bool, Float, Int

from jaxir._math import on_platform
from jaxir.geometry import bits, dot, item, lowest_bit, octant, row, varying, where_some
from jaxir.geometry.search._hits import (
    DOUBT,
    NONE,
    Edges,
    Query,
    answer,
    approach,
    boxes_met,
    moments,
    rounding_bound,
    slopes,
    verdict,
)
from jaxir.geometry.search._lockstep import most_at_once, side_by_side, try_all
from jaxir.geometry.search._tree import WIDTH, Tree


def search_single(tree: Tree, query: Query) -> Int[Array, " ray"]:
    """The face that each ray meets first, or some face that it meets where that will do; -1 for none.

    Under `jax.vmap` over rays the batch becomes more rays; over trees it becomes a loop, because searches in
    lockstep wait for the slowest.
    """

    @custom_vmap
    def search(tree: Tree, query: Query) -> Array:
        return _search(tree, query)

    @search.def_vmap
    def rule(size: int, batched: Any, tree: Any, query: Any) -> tuple[Array, bool]:
        if any(jax.tree.leaves(batched[0])):
            looped = sequential_vmap(lambda tree, query: search(tree, query))
            axes = jax.tree.map(lambda flag: 0 if flag else None, batched, is_leaf=lambda x: isinstance(x, bool))
            return jax.vmap(looped, in_axes=axes)(tree, query), True
        flat = [
            (value if flag else jnp.broadcast_to(value[None], (size, *value.shape))).reshape(
                -1, *value.shape[1 + flag :]
            )
            for value, flag in zip(query, batched[1], strict=True)
        ]
        return search(tree, Query(*flat)).reshape(size, -1), True

    return search(tree, query)


def _search(tree: Tree, query: Query) -> Int[Array, " ray"]:
    def one_by_one(query: Query) -> Array:
        def one(ray: Query) -> Array:
            with jax.enable_x64(True):
                return _search_ray(tree, approach(tree, ray, tree.leaves.dtype), settle=False)

        return lax.map(one, query)

    face = on_platform(query, cpu=one_by_one, default=lambda query: side_by_side(tree, query, lambda ray: ray))
    return settled(tree, face, query, lambda ray: ray)


def settled(tree: Tree, face: Int[Array, " ray"], rays: Any, ask: Callable[[Any], Query]) -> Int[Array, " ray"]:
    """Faces that rays meet, -1 for none, with rays in `DOUBT` searched again in double precision.

    Args:
        tree: the tree.
        face: what a search found [ray].
        rays: arrays with one row a ray.
        ask: the query of one ray from its rows of `rays`, traced with 64-bit types enabled.
    """

    def again(rays: Any) -> Array:
        with jax.enable_x64(True):
            ray = approach(tree, ask(rays), jnp.dtype("float64"))
            return on_platform(tree, ray, cpu=partial(_search_ray, settle=True), default=partial(try_all, settle=True))

    return jnp.maximum(where_some(again, face == DOUBT, face, rays, most_at_once(tree)), -1)


def _search_ray(tree: Tree, ray: Query, settle: bool) -> Int[Array, ""]:
    """The face that one ray meets, `NONE` or, unless told to settle, `DOUBT`.

    The fields of `ray` have no ray axis; its dtype is that of the arithmetic.
    """
    direction, near, far, dtype = ray.direction, ray.near, ray.far, ray.origin.dtype
    bound = rounding_bound(tree, ray)
    lines = slopes(ray)
    first = octant(direction)

    def meets_boxes(level: int, node: Array, best: Array) -> Array:
        table = row(tree.boxes[level], node).astype(dtype)
        return boxes_met([table[k * WIDTH : (k + 1) * WIDTH] for k in range(6)], lines, near, best)

    def visit(level: int, node: Array, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        if level == len(tree.children):
            return leaf(node, state)
        place = first * (tree.children[level].shape[0] // 8) + node

        def body(carry: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
            mask = carry[0]
            child = item(tree.children[level], place, lowest_bit(mask))
            best, found, doubt = visit(level + 1, child, carry[1:])
            mask = jnp.where(ray.some & (found >= 0), 0, mask & (mask - 1))
            return mask, best, found, doubt

        mask = meets_boxes(level, place, state[0])
        return lax.while_loop(lambda carry: carry[0] != 0, body, (mask, *state))[1:]

    def leaf(number: Array, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        best, found, doubt = state
        faces = row(tree.face, number)
        t, unsure = _leaf_hits(row(tree.leaves, number).astype(dtype), ray, faces, best, bound, settle)

        def nearer(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            mask, best, found = carry
            which = lowest_bit(mask)
            distance = item(t, which)
            closer = distance < best
            return mask & (mask - 1), jnp.where(closer, distance, best), jnp.where(closer, item(faces, which), found)

        # few faces are met: to look at those costs less than the smallest of all
        _, best, found = lax.while_loop(lambda carry: carry[0] != 0, nearer, (bits(t < best), best, found))
        return best, found, doubt | jnp.max(unsure.astype(jnp.int32))

    state = varying((far, jnp.full((), NONE, jnp.int32), jnp.zeros((), jnp.int32)), direction[0])
    _, found, doubt = visit(0, jnp.zeros((), jnp.int32), state)
    return answer(ray, found, doubt != 0, settle)


def _leaf_hits(
    leaf: Float[Array, " lane"],
    ray: Query,
    faces: Int[Array, " slot"],
    best: Float[Array, ""],
    bound: Float[Array, ""],
    settle: bool,
) -> tuple[Float[Array, " slot"], Bool[Array, " slot"]]:
    """`verdict` of the faces of one leaf.

    Args:
        leaf: a row of `Tree.leaves`.
        ray: one ray, as in `_search_ray`.
        faces: those of the leaf; -1 where one is missing.
        best: distance before which faces are asked for [m].
        bound: 11 eps r [m].
        settle: as in `verdict`.
    """
    slot = leaf.shape[0] // 15
    corner = [leaf[5 * k * slot : 5 * (k + 1) * slot] - ray.origin[k] for k in range(3)]
    moment, error = moments([c[slot : 4 * slot] for c in corner], [c[2 * slot :] for c in corner], ray.direction, bound)
    depth = dot([ray.direction[k] for k in range(3)], [c[: 3 * slot] for c in corner])

    def by_edge(lanes: Array) -> list[Array]:
        return [lanes[k * slot : (k + 1) * slot] for k in range(3)]

    edges = Edges(*(by_edge(lanes) for lanes in (moment, error, depth)))
    return verdict(edges, ray, faces, best, settle)
