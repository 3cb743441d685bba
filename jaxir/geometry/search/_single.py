"""Search of a tree by unrelated rays, one at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap, sequential_vmap
from jaxtyping import Array, Bool, Float, Int

from jaxir._math import on_platform
from jaxir.geometry import bits, dot, greater, in_blocks, item, lesser, lowest_bit, octant, row, varying, where_some
from jaxir.geometry.search._tree import WIDTH, Tree

NONE = -2  # no face
DOUBT = -1  # rounding leaves open whether a face is met that would come first
TESTS = 1 << 24  # of a ray and a face that `side_by_side` makes at once: bounds memory
_FAR = 3e38
_ROUNDING = 11.0  # bound of the rounding of an edge's moment, in units of the last place, see `_leaf_hits`


class Query(NamedTuple):
    """What single rays ask; every field has one row a ray.

    Attributes:
        origin: [ray, 3] [m].
        direction: [ray, 3], unit.
        near: hits lie beyond this distance [ray] [m].
        far: and before this one [ray] [m]; a ray with far <= near is inactive.
        skip: a face that is not met, -1 for none [ray].
        side: +1 meets only faces whose normal looks along the ray, -1 only faces that look against it, 0 both [ray].
        some: whether any face that is met will do, in place of the first [ray].
    """

    origin: Float[Array, "*ray 3"]
    direction: Float[Array, "*ray 3"]
    near: Float[Array, "*ray"]
    far: Float[Array, "*ray"]
    skip: Int[Array, "*ray"]
    side: Float[Array, "*ray"]
    some: Bool[Array, "*ray"]


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
                return _search_ray(tree, _approach(tree, ray, tree.leaves.dtype), settle=False)

        return lax.map(one, query)

    face = on_platform(query, cpu=one_by_one, default=lambda query: side_by_side(tree, query, lambda ray: ray))
    return settled(tree, face, query, lambda ray: ray)


def side_by_side(tree: Tree, rays: Any, ask: Callable[[Any], Query]) -> Int[Array, " ray"]:
    """The face that each ray meets, `NONE` or `DOUBT`, by a test of every face: for graphics cards.

    On these a step of a loop costs as much as a hundred million tests of a face, and rays in lockstep take all steps of
    all of them. Time and memory grow with the number of faces; see `settled` for `rays` and `ask`.
    """

    def one(rays: Any) -> Array:
        with jax.enable_x64(True):
            return _try_all(tree, _approach(tree, ask(rays), tree.leaves.dtype), settle=False)

    count = jax.tree.leaves(rays)[0].shape[0]
    size = min(_most(tree), max(count, 1))
    blocks = jax.tree.map(lambda x: in_blocks(x, size), rays)
    return lax.map(jax.vmap(one), blocks).reshape(-1)[:count]


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
            ray = _approach(tree, ask(rays), jnp.dtype("float64"))
            return on_platform(tree, ray, cpu=partial(_search_ray, settle=True), default=partial(_try_all, settle=True))

    return jnp.maximum(where_some(again, face == DOUBT, face, rays, _most(tree)), -1)


def _most(tree: Tree) -> int:
    """Rays of which every face is tested at once."""
    return max(TESTS // tree.face.size, 1)


def _approach(tree: Tree, ray: Query, dtype: Any) -> Query:
    """A ray as `_search_ray` takes it: measured from the tree's centre, in `dtype`, rounded once.

    A distant ray starts its search near the mesh, where a float has the grain of the mesh.
    """
    double = jnp.float64
    origin = ray.origin.astype(double) - tree.centre.astype(double)
    direction = ray.direction.astype(double)
    radius = _radius(tree).astype(double)
    along = -jnp.sum(origin * direction)
    skipped = jnp.where(along > 3 * radius, along - 2 * radius, 0)
    origin = origin + skipped * direction
    near, far = (jnp.clip(t.astype(double) - skipped, -_FAR, _FAR).astype(dtype) for t in (ray.near, ray.far))
    turned = direction.astype(dtype)
    return ray._replace(origin=origin.astype(dtype), direction=turned, near=near, far=far, side=ray.side.astype(dtype))


def _radius(tree: Tree) -> Float[Array, ""]:
    """Distance from the tree's centre within which the mesh lies [m]."""
    return jnp.sqrt(jnp.sum(tree.extent * tree.extent))


def _search_ray(tree: Tree, ray: Query, settle: bool) -> Int[Array, ""]:
    """The face that one ray meets, `NONE` or, unless told to settle, `DOUBT`.

    The fields of `ray` have no ray axis; its dtype is that of the arithmetic.
    """
    origin, direction, near, far = ray.origin, ray.direction, ray.near, ray.far
    dtype = origin.dtype
    bound = _bound(tree, ray)
    inverse = 1 / jnp.where(jnp.abs(direction) > 1e-20, direction, 1e-20)
    shift = origin * inverse
    first = octant(direction)

    def meets_boxes(level: int, node: Array, best: Array) -> Array:
        b = row(tree.boxes[level], node).astype(dtype)
        sides = [b[k * WIDTH : (k + 1) * WIDTH] * inverse[k % 3] - shift[k % 3] for k in range(6)]
        enter = [lesser(sides[k], sides[k + 3]) for k in range(3)]
        leave = [greater(sides[k], sides[k + 3]) for k in range(3)]
        start = greater(greater(enter[0], enter[1]), greater(enter[2], near))
        stop = lesser(lesser(leave[0], leave[1]), lesser(leave[2], best))
        return bits(start <= stop)

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
    return _answer(ray, found, doubt != 0, settle)


def _answer(ray: Query, found: Int[Array, ""], doubt: Bool[Array, ""], settle: bool) -> Int[Array, ""]:
    """The face `found`; or `DOUBT`, unless told to settle or where any face will do and one was met."""
    return found if settle else jnp.where(ray.some & (found >= 0) | ~doubt, found, jnp.int32(DOUBT))


def _bound(tree: Tree, ray: Query) -> Float[Array, ""]:
    """11 eps r of `_leaf_hits` [m]."""
    reach = _radius(tree).astype(ray.origin.dtype) + jnp.sqrt(jnp.sum(ray.origin * ray.origin))
    return _ROUNDING * float(jnp.finfo(ray.origin.dtype).eps) * reach


def _try_all(tree: Tree, ray: Query, settle: bool) -> Int[Array, ""]:
    """As `_search_ray`, by a test of every face, in one reduction."""
    dtype, bound = ray.origin.dtype, _bound(tree, ray)
    # no parts of arrays: XLA would write all that is computed of every ray and face to memory, of these only moments
    table = tree.leaves.astype(dtype).reshape(tree.face.shape[0], 3, 5, -1)
    corner = [[table[:, k, i] - ray.origin[k] for k in range(3)] for i in range(3)]
    edges = [_moments(corner[(i + 1) % 3], corner[(i + 2) % 3], ray.direction, bound) for i in range(3)]
    along = [ray.direction[k] for k in range(3)]
    depth = [dot(along, p) for p in corner]
    moment, error = zip(*edges, strict=True)
    t, unsure = _verdict(_Edges(moment, error, depth), ray, tree.face, ray.far, settle)

    def nearer(one: tuple[Array, ...], other: tuple[Array, ...]) -> tuple[Array, ...]:
        # of two as near the same whatever the order
        first = (one[0] < other[0]) | (one[0] == other[0]) & (one[1] <= other[1])
        return *(jnp.where(first, a, b) for a, b in zip(one[:2], other[:2], strict=True)), one[2] | other[2]

    every = t, tree.face, unsure
    none = jnp.asarray(_FAR, dtype), jnp.int32(-1), jnp.asarray(False)
    best, face, doubt = lax.reduce(every, none, nearer, (0, 1))
    return _answer(ray, jnp.where(best < ray.far, face, jnp.int32(NONE)), doubt, settle)


def _leaf_hits(
    leaf: Float[Array, " lane"],
    ray: Query,
    faces: Int[Array, " slot"],
    best: Float[Array, ""],
    bound: Float[Array, ""],
    settle: bool,
) -> tuple[Float[Array, " slot"], Bool[Array, " slot"]]:
    """Where a ray surely meets the faces of one leaf, and which others it may meet.

    With corners p, q of an edge relative to the ray's origin, the ray passes the edge on the side told by the sign of
    direction . ((p + q) x (q - p)), the ray's moment about the edge (Pluecker coordinates). What is computed is the
    moment about an edge whose ends were moved by rounding, plus the rounding of the products. A ray that keeps from
    the three moved edges a distance larger than both is truly inside or truly outside, because no edge crossed it on
    its way. With u = eps / 2, r the largest distance of a corner from the ray's origin and |e| the edge's length,
    moving an edge changes the moment by 4 u r |e| (corners 2 u r, each against the origin) and its products err by
    16.2 u r |e| (7 roundings of terms that sum up to 2 r |e| 2 / sqrt(3)), so by 11 eps r |e| together. Exchanging p
    and q negates every rounded intermediate, so two faces never disagree about the moment of a shared edge.

    Args:
        leaf: a row of `Tree.leaves`.
        ray: one ray, as in `_search_ray`.
        faces: those of the leaf; -1 where one is missing.
        best: distance before which faces are asked for [m].
        bound: 11 eps r [m].
        settle: a ray within the bound of an edge meets it, and a face that the bound cannot tell from one seen
            edge-on is not met, because its neighbours are.

    Returns:
        t: distances of faces that are met beyond `near`, whatever rounding did [m]; huge for the others.
        unsure: faces of which rounding leaves open whether they are met between `near` and `best`.
    """
    slot = leaf.shape[0] // 15
    corner = [leaf[5 * k * slot : 5 * (k + 1) * slot] - ray.origin[k] for k in range(3)]
    moment, error = _moments(
        [c[slot : 4 * slot] for c in corner], [c[2 * slot :] for c in corner], ray.direction, bound
    )
    depth = dot([ray.direction[k] for k in range(3)], [c[: 3 * slot] for c in corner])

    def by_edge(lanes: Array) -> list[Array]:
        return [lanes[k * slot : (k + 1) * slot] for k in range(3)]

    edges = _Edges(*(by_edge(lanes) for lanes in (moment, error, depth)))
    return _verdict(edges, ray, faces, best, settle)


class _Edges(NamedTuple):
    """Of the three edges of faces, see `_leaf_hits`.

    Attributes:
        moment: the ray's about each, in units of its error.
        error: of the moments [m2].
        depth: along the ray of the corner opposite to each [m].
    """

    moment: Sequence[Array]
    error: Sequence[Array]
    depth: Sequence[Array]


def _moments(start: list[Array], stop: list[Array], direction: Array, bound: Array) -> tuple[Array, Array]:
    """Moments of a ray about edges from `start` to `stop`, relative to its origin, in units of their errors; these."""
    sx, sy, sz = (p + q for p, q in zip(start, stop, strict=True))
    ex, ey, ez = (q - p for p, q in zip(start, stop, strict=True))
    dx, dy, dz = direction[0], direction[1], direction[2]
    moment = dx * (sy * ez - sz * ey) + dy * (sz * ex - sx * ez) + dz * (sx * ey - sy * ex)
    error = bound * (jnp.abs(ex) + jnp.abs(ey) + jnp.abs(ez))
    # the division also keeps XLA from computing the moment anew for all that follows
    return moment / jnp.where(error > 0, error, 1), error


def _verdict(
    edges: _Edges, ray: Query, faces: Int[Array, "..."], best: Float[Array, ""], settle: bool
) -> tuple[Float[Array, "..."], Bool[Array, "..."]]:
    """Where a ray surely meets faces, and which others it may meet; as `_leaf_hits`."""

    def fold(operation: Callable[..., Array], parts: Sequence[Array]) -> Array:
        return operation(operation(parts[0], parts[1]), parts[2])

    low, high = fold(lesser, edges.moment), fold(greater, edges.moment)
    weight = [moment * error for moment, error in zip(edges.moment, edges.error, strict=True)]
    volume = fold(jnp.add, weight)  # four times the face's area across the ray
    along, against = ray.side >= 0, ray.side <= 0
    first, last = fold(lesser, edges.depth), fold(greater, edges.depth)
    other = faces != ray.skip
    if settle:
        blur = fold(jnp.add, edges.error)
        met = (low >= -1) & along & (volume > blur) | (high <= 1) & against & (volume < -blur)
    else:
        met = (low >= 1) & along | (high <= -1) & against
    possible = ((low >= -1) & along | (high <= 1) & against) & (edges.error[0] > 0) & ~met
    unsure = possible & other & (last > ray.near) & (first < best)
    weighted = fold(jnp.add, [w * depth for w, depth in zip(weight, edges.depth, strict=True)])
    # a hit at or before `near` is none: weighted / volume > near, without a division
    met = met & other & (weighted * jnp.sign(volume) > ray.near * jnp.abs(volume))
    # a division comes last, or XLA computes all this anew for every use of t
    return jnp.where(met, weighted, _FAR) / jnp.where(met, volume, 1), unsure
