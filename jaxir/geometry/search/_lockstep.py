"""Search of a tree by many rays side by side: for graphics cards."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxir.geometry import dot, in_blocks, lowest_bit, octant
from jaxir.geometry.search._hits import (
    NEVER,
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
from jaxir.geometry.search._tree import WIDTH, Tree

TESTS = 1 << 24  # of a ray and a face or box that are made at once: bounds memory
FEW = 512  # faces up to which to test all of them takes less time than to walk a tree


def side_by_side(tree: Tree, rays: Any, ask: Callable[[Any], Query]) -> Int[Array, " ray"]:
    """The face that each ray meets, `NONE` or `DOUBT`; see `settled` for `rays` and `ask`.

    A step of a loop costs a card as much as millions of tests, and rays in lockstep take as many as the slowest: of
    few faces each is tested, and of many a tree is walked in one loop rather than in a nest of them.
    """
    many = bool(tree.children) and tree.face.size > FEW
    links = _links(tree) if many else None

    def one(rays: Any) -> Array:
        with jax.enable_x64(True):
            ray = approach(tree, ask(rays), tree.leaves.dtype)
            return try_all(tree, ray, settle=False) if links is None else _walk(tree, links, ray)

    count = jax.tree.leaves(rays)[0].shape[0]
    size = min(TESTS // (2 * WIDTH) if many else most_at_once(tree), max(count, 1))
    blocks = jax.tree.map(lambda x: in_blocks(x, size), rays)
    return lax.map(jax.vmap(one), blocks).reshape(-1)[:count]


def most_at_once(tree: Tree) -> int:
    """Rays of which every face is tested at once."""
    return max(TESTS // tree.face.size, 1)


def try_all(tree: Tree, ray: Query, settle: bool) -> Int[Array, ""]:
    """The face that one ray meets, `NONE` or, unless told to settle, `DOUBT`: by a test of every face.

    The fields of `ray` have no ray axis; its dtype is that of the arithmetic.
    """
    # no parts of arrays: XLA would write all that is computed of every ray and face to memory, of these only moments
    table = _by_corner(tree)
    corner = [[table[:, k, i].astype(ray.origin.dtype) for k in range(3)] for i in range(3)]
    best, face, doubt = _nearest(corner, tree.face, ray, ray.far, rounding_bound(tree, ray), settle)
    return answer(ray, jnp.where(best < ray.far, face, jnp.int32(NONE)), doubt, settle)


def _by_corner(tree: Tree) -> Float[Array, "leaf 3 5 slot"]:
    """`Tree.leaves` by axis and corner."""
    return tree.leaves.reshape(tree.face.shape[0], 3, 5, -1)


def _nearest(
    corner: list[list[Array]], faces: Int[Array, "..."], ray: Query, best: Array, bound: Array, settle: bool
) -> tuple[Float[Array, ""], Int[Array, ""], Bool[Array, ""]]:
    """Of faces with `corner` [corner][axis] [m] the distance and number of the nearest, and whether any is in doubt."""
    corner = [[place[k] - ray.origin[k] for k in range(3)] for place in corner]
    edges = [moments(corner[(i + 1) % 3], corner[(i + 2) % 3], ray.direction, bound) for i in range(3)]
    along = [ray.direction[k] for k in range(3)]
    moment, error = zip(*edges, strict=True)
    t, unsure = verdict(Edges(moment, error, [dot(along, p) for p in corner]), ray, faces, best, settle)

    def nearer(one: tuple[Array, ...], other: tuple[Array, ...]) -> tuple[Array, ...]:
        # of two as near the same whatever the order
        first = (one[0] < other[0]) | (one[0] == other[0]) & (one[1] <= other[1])
        return *(jnp.where(first, a, b) for a, b in zip(one[:2], other[:2], strict=True)), one[2] | other[2]

    none = jnp.asarray(NEVER, t.dtype), jnp.int32(-1), jnp.asarray(False)
    return lax.reduce((t, faces, unsure), none, nearer, tuple(range(t.ndim)))


def _links(tree: Tree) -> Int[Array, "row 16"]:
    """Children of the nodes of all levels, one level after another: rows of this table, on the last level leaves."""
    start = np.cumsum([len(level) for level in tree.children])
    links: list[Array] = []
    for level, below in zip(tree.children[:-1], tree.children[1:], strict=True):
        octants = jnp.arange(8, dtype=jnp.int32)[:, None, None] * (len(below) // 8)
        at = level.reshape(8, -1, WIDTH) + octants + np.int32(start[len(links)])
        links.append(at.reshape(-1, WIDTH))  # where there is no child there is no box that would be met
    return jnp.concatenate([*links, tree.children[-1]])


def _walk(tree: Tree, links: Int[Array, "row 16"], ray: Query) -> Int[Array, ""]:
    """As `try_all`, unsettled, by the steps of a walk from box to box; `links` as `_links` gives them.

    A step looks into one box: of an inner one which of the boxes within are met, of a leaf which faces. What is still
    to be looked into are bits on every level; the next is the nearest on the deepest of these.
    """
    near, dtype, last = ray.near, ray.origin.dtype, len(tree.children) - 1
    lines = slopes(ray)
    bound, table = rounding_bound(tree, ray), _by_corner(tree)
    boxes = jnp.concatenate(tree.boxes).reshape(-1, 6, WIDTH)
    levels = jnp.arange(last + 1, dtype=jnp.int32)

    def inside(node: Array, best: Array) -> Array:
        return boxes_met([boxes[node, k].astype(dtype) for k in range(6)], lines, near, best)

    def step(carry: Any) -> Any:
        level, nodes, masks, best, found, doubt = carry
        here = levels == level
        mask = jnp.max(jnp.where(here, masks, 0))
        child = links[jnp.max(jnp.where(here, nodes, 0)), lowest_bit(mask)]
        masks = jnp.where(here, mask & (mask - 1), masks)
        leaf = level == last
        number = jnp.where(leaf, child, 0)
        corner = [[table[number, k, i].astype(dtype) for k in range(3)] for i in range(3)]
        t, face, unsure = _nearest(corner, tree.face[number], ray, best, bound, settle=False)
        closer = leaf & (t < best)
        node = jnp.where(leaf, 0, child)
        below = ~leaf & (levels == level + 1)
        masks, nodes = jnp.where(below, inside(node, best), masks), jnp.where(below, node, nodes)
        best, found, doubt = jnp.where(closer, t, best), jnp.where(closer, face, found), doubt | leaf & unsure
        masks = jnp.where(ray.some & (found >= 0), 0, masks)
        return jnp.max(jnp.where(masks != 0, levels, -1)), nodes, masks, best, found, doubt

    root = octant(ray.direction) * (len(tree.children[0]) // 8)
    nodes = jnp.where(levels == 0, root, 0)
    masks = jnp.where(levels == 0, inside(root, ray.far), 0)
    start = jnp.where(jnp.max(masks) != 0, 0, -1).astype(jnp.int32)
    state = start, nodes, masks, ray.far, jnp.int32(NONE), jnp.asarray(False)
    _, _, _, _, found, doubt = lax.while_loop(lambda carry: carry[0] >= 0, step, state)
    return answer(ray, found, doubt, settle=False)
