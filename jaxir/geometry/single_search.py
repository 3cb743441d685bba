"""Search of a tree by unrelated rays, one at a time."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap, sequential_vmap
from jaxtyping import Array, Float, Int

from jaxir.geometry.loops import bits, item, lowest_bit, octant, row, smallest, varying
from jaxir.geometry.tree import WIDTH, Tree

_SLACK = 4.0  # units of the last place of an edge's moment within which a ray counts as inside
_BATCH = 256  # rays tested together against a handful of faces
_NONE = 3e38


class Query(NamedTuple):
    """What single rays ask; every field has one row a ray.

    Attributes:
        origin: [ray, 3] [m].
        direction: [ray, 3], unit.
        near: hits lie beyond this distance [ray] [m].
        far: and before this one [ray] [m]; a ray with far <= near is inactive.
        skip: place of a face in the tree that is not met, -1 for none [ray].
        side: +1 meets only faces whose normal looks along the ray, -1 only faces that look against it, 0 both [ray].
    """

    origin: Float[Array, "ray 3"]
    direction: Float[Array, "ray 3"]
    near: Float[Array, " ray"]
    far: Float[Array, " ray"]
    skip: Int[Array, " ray"]
    side: Float[Array, " ray"]


def search_single(tree: Tree, query: Query, any_hit: bool) -> Int[Array, " ray"]:
    """The face that each ray meets first, or with `any_hit` some face that it meets; -1 for none.

    Under `jax.vmap` over rays the batch becomes more rays; over trees it becomes a loop, because searches in
    lockstep wait for the slowest.
    """

    @custom_vmap
    def search(tree: Tree, query: Query) -> Array:
        return _search(tree, query, any_hit)

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


def _search(tree: Tree, query: Query, any_hit: bool) -> Int[Array, " ray"]:
    def one(ray: Query) -> Array:
        return search_ray(tree, ray, any_hit)

    if not tree.children:
        place = lax.map(one, query, batch_size=_BATCH)
    else:
        place = lax.platform_dependent(
            query, cpu=lambda query: lax.map(one, query), default=lambda query: jax.vmap(one)(query)
        )
    return jnp.where(place >= 0, tree.face.reshape(-1)[jnp.maximum(place, 0)], -1)


def search_ray(tree: Tree, ray: Query, any_hit: bool) -> Int[Array, ""]:
    """Place in the tree of the face that one ray meets, -1 for none; the fields of `ray` have no ray axis."""
    direction = ray.direction
    origin = ray.origin - tree.centre
    radius = jnp.sqrt(jnp.sum(tree.half * tree.half))
    # a distant ray starts its search near the mesh, where float32 has the grain of the mesh
    along = -jnp.sum(origin * direction)
    skipped = jnp.where(along > 3 * radius, along - 2 * radius, 0)
    origin = origin + skipped * direction
    near, far = ray.near - skipped, jnp.minimum(ray.far - skipped, _NONE)
    reach = radius + jnp.sqrt(jnp.sum(origin * origin))
    slack = _SLACK * jnp.finfo(origin.dtype).eps * reach
    inverse = 1 / jnp.where(jnp.abs(direction) > 1e-20, direction, 1e-20)
    shift = origin * inverse
    first = octant(direction)

    def meets_boxes(level: int, node: Array, best: Array) -> Array:
        b = row(tree.boxes[level], node)
        sides = [b[k * WIDTH : (k + 1) * WIDTH] * inverse[k % 3] - shift[k % 3] for k in range(6)]
        enter = [jnp.minimum(sides[k], sides[k + 3]) for k in range(3)]
        leave = [jnp.maximum(sides[k], sides[k + 3]) for k in range(3)]
        start = jnp.maximum(jnp.maximum(enter[0], enter[1]), jnp.maximum(enter[2], near))
        stop = jnp.minimum(jnp.minimum(leave[0], leave[1]), jnp.minimum(leave[2], best))
        return bits(start <= stop)

    def visit(level: int, node: Array, state: tuple[Array, Array]) -> tuple[Array, Array]:
        if level == len(tree.children):
            return leaf(node, state)
        place = first * (tree.children[level].shape[0] // 8) + node

        def body(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            mask, best, face = carry
            child = item(tree.children[level], place, lowest_bit(mask))
            best, face = visit(level + 1, child, (best, face))
            mask = mask & (mask - 1)
            if any_hit:
                mask = jnp.where(face >= 0, 0, mask)
            return mask, best, face

        mask = meets_boxes(level, place, state[0])
        return lax.while_loop(lambda carry: carry[0] != 0, body, (mask, *state))[1:]

    def leaf(number: Array, state: tuple[Array, Array]) -> tuple[Array, Array]:
        best, face = state
        places = number * tree.slots + jnp.arange(tree.slots, dtype=jnp.int32)
        t = face_distance(row(tree.leaves, number), origin, direction, slack, ray.side)
        t = jnp.where((t > near) & (places != ray.skip), t, _NONE)
        nearest = smallest(t)
        place = jnp.min(jnp.where(t == nearest, places, jnp.int32(2**31 - 1)))
        return jnp.minimum(nearest, best), jnp.where(nearest < best, place, face)

    state = varying((far, jnp.full((), -1, jnp.int32)), direction[0])
    return visit(0, jnp.zeros((), jnp.int32), state)[1]


def face_distance(
    leaf: Float[Array, " lane"],
    origin: Float[Array, " 3"],
    direction: Float[Array, " 3"],
    slack: Float[Array, ""],
    side: Float[Array, ""],
) -> Float[Array, " slot"]:
    """Distances of the faces of one leaf along a ray [slot] [m]; huge on a miss.

    With corners p, q of an edge relative to the ray's origin, the ray passes the edge on the side told by the sign of
    direction . ((p + q) x (q - p)), the ray's moment about the edge (Pluecker coordinates). Exchanging p and q
    negates every rounded intermediate, so two faces never disagree about a shared edge; the slack, of the size of the
    rounding, closes the gap that remains at shared vertices.

    Args:
        leaf: a row of `Tree.leaves`.
        origin: relative to the tree's centre [3] [m].
        direction: [3], unit.
        slack: distance from an edge, as a multiple of rounding, that still counts as inside [m].
        side: as in `Query`.
    """
    slot = leaf.shape[0] // 16
    corner = [leaf[5 * k * slot : 5 * (k + 1) * slot] - origin[k] for k in range(3)]
    start = [c[slot : 4 * slot] for c in corner]
    stop = [c[2 * slot :] for c in corner]
    sx, sy, sz = (p + q for p, q in zip(start, stop, strict=True))
    ex, ey, ez = (q - p for p, q in zip(start, stop, strict=True))
    dx, dy, dz = direction[0], direction[1], direction[2]
    moment = dx * (sy * ez - sz * ey) + dy * (sz * ex - sx * ez) + dz * (sx * ey - sy * ex)
    depth = dx * corner[0][: 3 * slot] + dy * corner[1][: 3 * slot] + dz * corner[2][: 3 * slot]
    weighted = moment * depth
    parts = [slice(k * slot, (k + 1) * slot) for k in range(3)]
    m0, m1, m2 = (moment[p] for p in parts)
    t0, t1, t2 = (depth[p] for p in parts)
    low, high = jnp.minimum(jnp.minimum(m0, m1), m2), jnp.maximum(jnp.maximum(m0, m1), m2)
    volume = m0 + m1 + m2
    tolerance = slack * leaf[15 * slot :]
    inside = ((low >= -tolerance) & (side >= 0) & (volume > 0)) | ((high <= tolerance) & (side <= 0) & (volume < 0))
    t = (weighted[parts[0]] + weighted[parts[1]] + weighted[parts[2]]) / jnp.where(volume != 0, volume, 1)
    # within the slack the weights may be negative; the hit still lies between the corners
    nearest, farthest = jnp.minimum(jnp.minimum(t0, t1), t2), jnp.maximum(jnp.maximum(t0, t1), t2)
    return jnp.where(inside, jnp.minimum(jnp.maximum(t, nearest), farthest), _NONE)
