"""Search of a tree by the rays of one projective map, a tile of neighbours at a time."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jax.custom_batching import sequential_vmap
from jaxtyping import Array, Bool, Float, Int

from jaxir._math import dot, matmul, on_platform
from jaxir.geometry import bits, greater, item, largest, lesser, lowest_bit, octant, row, smallest, varying
from jaxir.geometry.search._hits import DOUBT, NONE, Query
from jaxir.geometry.search._lockstep import side_by_side
from jaxir.geometry.search._single import settled
from jaxir.geometry.search._tree import FAR, WIDTH, Tree

TILE = 256  # rays tested together
BEYOND = 3e38  # a depth beyond everything; its negative marks an inactive ray
_EDGE = 4.0  # rounding of an edge function, in units of the last place, see `_set_up`
_GRAIN = 14.0  # rounding of screen points, in units of the last place of the distances that they stand for


class View(NamedTuple):
    """A projective map and its rays.

    A point with frame coordinates (X, Y, Z) about `target` is seen at (X s, Y s) with depth -Z s, where
    s = 1 / (1 - Z inverse_range): planes stay planes, and depth grows along every ray.

    Attributes:
        target: [3] [m].
        frame: rows u, v, w [3, 3]; w points to the eye.
        inverse_range: [m-1]; None for parallel rays, whose projection then compiles to nothing.
        start: frame coordinate along w at which rays start [m].
        screen: [ray, 2] [m].
        limit: projected depth before which hits lie [ray] [m]; -inf for an inactive ray. None for no limit.
    """

    target: Float[Array, " 3"]
    frame: Float[Array, "3 3"]
    inverse_range: Float[Array, ""] | None
    start: Float[Array, ""]
    screen: Float[Array, "ray 2"]
    limit: Float[Array, " ray"] | None


def search_bundle(tree: Tree, view: View, before: Bool[Array, ""], side: int) -> Int[Array, " ray"]:
    """The face that each ray meets first; -1 for none.

    Tiles are searched where the whole tree lies before the plane on which rays start, as told by `before`; there
    `side` is +1 to meet only faces seen from their front, -1 only those seen from their back, 0 for both. Otherwise
    rays are searched one by one, in double precision, for faces of both sides. Under `jax.vmap` views are searched
    one after another.
    """

    @sequential_vmap
    def search(tree: Tree, view: View, before: Array) -> Array:
        return _search(tree, view, before, side)

    return search(tree, view, before)


def project(depth: Float[Array, "..."], inverse_range: Float[Array, ""] | None) -> Float[Array, "..."]:
    """Projected depth of points `depth` [m] beyond the target plane, increasing; range itself at infinity."""
    depth = jnp.clip(depth, -FAR, FAR)
    return depth if inverse_range is None else depth / (1 + depth * inverse_range)


def _search(tree: Tree, view: View, before: Array, side: int) -> Int[Array, " ray"]:
    count = view.screen.shape[0]
    size = min(TILE, -(-count // 16) * 16)
    pad = -count % size
    limit = None
    if view.limit is not None:
        limit = jnp.pad(jnp.maximum(view.limit, -BEYOND), (0, pad), constant_values=-BEYOND).reshape(-1, size)
    screen = jnp.pad(view.screen, ((0, pad), (0, 0)), mode="edge").reshape(-1, size, 2)
    scene = see(tree, view.target, view.frame, view.inverse_range)

    def one(tile: tuple[Array, Array | None]) -> Array:
        screen, limit = tile
        limit = jnp.full(size, BEYOND, screen.dtype) if limit is None else limit
        return search_tile(scene, Tile(screen[:, 0], screen[:, 1], limit, None), side, any_hit=False)

    def by_tiles() -> Array:
        return lax.map(one, (screen, limit)).reshape(-1)[:count]

    def undecided() -> Array:
        active = jnp.ones(count, bool) if view.limit is None else view.limit > -BEYOND
        return varying(jnp.where(active, jnp.int32(DOUBT), jnp.int32(NONE)), view.screen)

    sign = jnp.where(before, -side, 0)
    rays = view.screen, None if view.limit is None else jnp.maximum(view.limit, -BEYOND)

    def ask(ray: tuple[Array, Array | None]) -> Query:
        return _ask(view, sign, *ray)

    face = on_platform(cpu=lambda: lax.cond(before, by_tiles, undecided), default=lambda: side_by_side(tree, rays, ask))
    return settled(tree, face, rays, ask)


def _ask(view: View, side: Array, screen: Array, limit: Array | None) -> Query:
    """One ray of a view in double precision, from its rows of `screen` and `limit`; `side` as in `Query`."""
    target, x, y = (value.astype(jnp.float64) for value in (view.target, screen[0], screen[1]))
    inverse = jnp.zeros_like(x) if view.inverse_range is None else view.inverse_range.astype(x.dtype)
    u, v, w = dual(view.frame)
    lateral = x * u + y * v
    direction = inverse * lateral - w
    length = jnp.sqrt(jnp.sum(direction * direction))
    near, far = -view.start.astype(x.dtype) * length, jnp.asarray(BEYOND, x.dtype)
    if limit is not None:
        depth = limit.astype(x.dtype)
        left = 1 - depth * inverse  # the map's inverse; at or beyond infinity there is no limit
        far = jnp.where((depth < BEYOND) & (left > 0), depth / jnp.where(left > 0, left, 1) * length, BEYOND)
    none = jnp.full((), -1, jnp.int32)
    return Query(target + lateral, direction / length, near, far, none, side.astype(x.dtype), jnp.asarray(False))


class SeenTree(NamedTuple):
    """The tree as one view sees it: boxes of each level are x0, x1, y0, y1 and nearest depth [node, 5 * 16]."""

    boxes: tuple[Array, ...]
    children: tuple[Array, ...]
    leaves: Array
    face: Array
    travel: Array
    shift: Array
    grains: Array
    inverse_range: Array | None


def dual(frame: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Rows u*, v*, w* with x u* + y v* + z w* the vector of frame coordinates (x, y, z), in double precision.

    They differ from the frame by its rounding; a frame that is orthonormal to e gives them to e squared.
    """
    rows = frame.astype(jnp.float64)
    return 2 * rows - matmul(matmul(rows, rows.T), rows)


def travel_of(frame: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Rows u, v and -w of a frame: right, up, and along the rays."""
    return jnp.concatenate([frame[:2], -frame[2:]])


def see(
    tree: Tree, target: Float[Array, " 3"], frame: Float[Array, "3 3"], inverse_range: Float[Array, ""] | None
) -> SeenTree:
    """The tree seen by a projective map; arguments as in `View`."""
    travel = travel_of(frame)
    shift = dot(travel, (tree.centre - target)[None])
    first = octant(travel[2])
    boxes, children = [], []
    for level_boxes, level_children in zip(tree.boxes, tree.children, strict=True):
        nodes = level_children.shape[0] // 8
        sorted_boxes = lax.dynamic_slice_in_dim(level_boxes, first * nodes, nodes, allow_negative_indices=False)
        boxes.append(project_boxes(sorted_boxes, travel, shift, inverse_range))
        own = lax.dynamic_slice_in_dim(level_children, first * nodes, nodes, allow_negative_indices=False)
        children.append(own)
    grains = 1 / _grain(tree, travel, shift, inverse_range)
    return SeenTree(tuple(boxes), tuple(children), tree.leaves, tree.face, travel, shift, grains, inverse_range)


def _grain(tree: Tree, travel: Array, shift: Array, inverse_range: Array | None) -> Array:
    """How far rounding may move a corner against a ray on the screen [m], see `_set_up`."""
    reach = jnp.sqrt(jnp.sum(tree.extent * tree.extent)) + jnp.sqrt(jnp.sum(shift * shift))
    grain = _GRAIN * jnp.finfo(reach.dtype).eps * reach
    if inverse_range is None:
        return grain
    # projection enlarges errors by s (1 + |x| / range), at most at the corners of the box
    size = dot(jnp.abs(travel), tree.extent[None])
    scale = 1 / jnp.maximum(1 + (shift[2] - size[2]) * inverse_range, jnp.finfo(reach.dtype).eps)
    widest = jnp.sum(jnp.abs(shift[:2]) + size[:2])
    return grain * scale * (1 + scale * widest * inverse_range)


class Tile(NamedTuple):
    """Screen points, depth limits and skipped faces of neighbouring rays."""

    x: Array
    y: Array
    limit: Array
    skip: Array | None


def extents(
    table: Float[Array, "node 96"], rows: Float[Array, "row 3"], shift: Float[Array, " row"]
) -> tuple[Float[Array, "node row 16"], Float[Array, "node row 16"], Bool[Array, "node 1 16"]]:
    """Least and greatest coordinates of boxes of the tree along vectors, from `shift` on; and which boxes are empty.

    Conservative: what rounding may move lies within.
    """
    # by rows of sixteen boxes: XLA's CPU loops over short axes are slow
    sides = table.reshape(-1, 2, 3, 1, WIDTH)
    low, high = sides[:, 0], sides[:, 1]
    empty = low[:, 0] >= FAR
    along = rows.T[None, :, :, None]
    eps = jnp.finfo(table.dtype).eps
    turned = along * jnp.where(empty[:, None], 0, (low + high) / 2)
    half = jnp.abs(along) * jnp.where(empty[:, None], 0, (high - low) / 2)
    middle = turned[:, 0] + turned[:, 1] + turned[:, 2] + shift[None, :, None]
    reach = (half[:, 0] + half[:, 1] + half[:, 2]) * (1 + 8 * eps)
    reach = reach + 8 * eps * (jnp.abs(middle) + jnp.max(jnp.abs(shift)))
    return middle - reach, middle + reach, empty


def project_boxes(
    table: Float[Array, "node 96"],
    travel: Float[Array, "3 3"],
    shift: Float[Array, " 3"],
    inverse_range: Float[Array, ""] | None,
) -> Float[Array, "node 80"]:
    """Screen rectangles and nearest depths of boxes [node, 5 * 16] of the tree [node, 6 * 16]; conservative."""
    low, high, empty = extents(table, travel, shift)
    near = low[:, 2:]
    if inverse_range is not None:
        eps = jnp.finfo(table.dtype).eps
        least, most = 1 / (1 + high[:, 2:] * inverse_range), 1 / (1 + near * inverse_range)
        low, high = jnp.minimum(low * least, low * most), jnp.maximum(high * least, high * most)
        grow = 4 * eps * (jnp.abs(low) + jnp.abs(high))
        low, high, near = low - grow, high + grow, near * most
        near = near - 4 * eps * jnp.abs(near)
    seen = jnp.concatenate([low[:, :1], high[:, :1], low[:, 1:2], high[:, 1:2], near], axis=1)
    return jnp.where(empty, FAR, seen).reshape(-1, 5 * WIDTH)


def search_tile(scene: SeenTree, tile: Tile, side: int, any_hit: bool) -> Array:
    """The face that each ray of one tile meets, `NONE` or `DOUBT` [ray]; see `search_bundle`."""
    active = tile.limit > -BEYOND
    x0, y0 = (smallest(jnp.where(active, lane, FAR)) for lane in (tile.x, tile.y))
    x1, y1 = (largest(jnp.where(active, lane, -FAR)) for lane in (tile.x, tile.y))
    some = x0 <= x1
    x0, x1, y0, y1 = (jnp.where(some, edge, 0) for edge in (x0, x1, y0, y1))
    eps = jnp.finfo(tile.x.dtype).eps
    xc, yc = (x0 + x1) / 2, (y0 + y1) / 2
    # the tile's half size, grown by what subtracting its centre may round
    xh = (x1 - x0) / 2 + 2 * eps * (jnp.abs(x0) + jnp.abs(x1))
    yh = (y1 - y0) / 2 + 2 * eps * (jnp.abs(y0) + jnp.abs(y1))
    x, y = tile.x - xc, tile.y - yc
    slot = scene.leaves.shape[1] // 15
    levels = len(scene.boxes)

    def meets_boxes(level: int, node: Array, deepest: Array) -> Array:
        b = row(scene.boxes[level], node)
        left, right, low, high, depth = (b[k * WIDTH : (k + 1) * WIDTH] for k in range(5))
        return bits((left <= x1) & (right >= x0) & (low <= y1) & (high >= y0) & (depth < deepest))

    def visit(level: int, node: Array, go: Array, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        if level == levels:
            return leaf(node, go, state)

        def body(carry: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
            mask, inner = carry[0], carry[1:]
            which = lowest_bit(mask)
            child = item(scene.children[level], node, which)
            # hits may have come nearer since the mask was made; a flag, not a branch, or XLA hoists the work below
            closer = item(scene.boxes[level], node, 4 * WIDTH + which) < inner[0]
            return (mask & (mask - 1), *visit(level + 1, child, closer, inner))

        mask = jnp.where(go, meets_boxes(level, node, state[0]), 0)
        return lax.while_loop(lambda carry: carry[0] != 0, body, (mask, *state))[1:]

    def leaf(number: Array, go: Array, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        _, depth, met = state
        face = _set_up(scene, row(scene.leaves, number), (xc, yc), (xh, yh), side)
        wanted = (face.wanted & go).astype(jnp.int32)

        def test(k: Array, state: tuple[Array, Array]) -> tuple[Array, Array]:
            depth, met = state
            at = [k + edge * slot for edge in range(3)]
            area = item(face.area, k)
            sign = jnp.where(area < 0, -1, 1).astype(area.dtype)
            z0, z1, z2 = (item(face.z, i) for i in at)
            error0, error1, error2 = (item(face.error, i) for i in at)
            e0, e1, e2 = (
                sign * item(face.a, i) * x + sign * item(face.b, i) * y + (sign * item(face.c, i) + item(face.error, i))
                for i in at
            )
            # seen edge-on, as far as rounding can tell: met as near as its nearest corner, and never surely
            error = greater(greater(error0, error1), error2)
            thin = jnp.abs(area) <= error
            rise1, rise2 = (jnp.where(thin, 0, item(face.rise, i)) for i in (at[0], at[2]))
            first = jnp.where(thin, lesser(lesser(z0, z1), z2), z0 - (rise1 * error1 - rise2 * error2))
            here = rise1 * e1 - rise2 * e2 + first
            inside = lesser(lesser(e0, e1), e2)
            own = item(scene.face, number, k)
            hit = (inside >= 0) & (here < depth)
            if tile.skip is not None:
                hit = hit & (tile.skip != own)
            sure = inside >= 2 * error
            code = jnp.where(sure, own, jnp.int32(DOUBT))
            if any_hit:
                return jnp.where(hit & sure, -BEYOND, depth), jnp.where(hit, jnp.maximum(code, met), met)
            return jnp.where(hit, here, depth), jnp.where(hit, code, met)

        def advance(k: Array) -> Array:
            """The next wanted face, coded as -1 - k, or `slot`."""
            return lax.while_loop(
                lambda k: (k >= 0) & (k < slot), lambda k: jnp.where(item(wanted, k) > 0, -1 - k, k + 1), k
            )

        def step(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            return advance(-carry[0]), *test(-1 - carry[0], carry[1:])

        first = advance(jnp.zeros_like(number))
        _, depth, met = lax.while_loop(lambda carry: carry[0] < 0, step, (first, depth, met))
        return largest(depth), depth, met

    state = (largest(tile.limit), tile.limit, jnp.full(x.shape, NONE, jnp.int32))
    return visit(0, jnp.zeros((), jnp.int32), some, varying(state, x))[2]


class _Faces(NamedTuple):
    """The faces of one leaf as a tile sees them.

    All but `wanted` are long rows, for which XLA writes SIMD code; what needs one number a face is left to its test.

    Attributes:
        a, b, c: edge functions e = sign(area) (a x + b y + c) + error [3 * slot]; none is negative where a ray may be
            inside, and all exceed twice the largest error where it surely is. The sign belongs to the test: computed
            in several rows it may differ between them by rounding.
        error: of the edge functions [3 * slot].
        area: twice the signed area on the screen, once for each edge [3 * slot].
        rise: depth = z0 + rise0 (e1 - error1) - rise2 (e2 - error2) [3 * slot].
        z: depths of the corners 0, 1, 2, 0, 1 [5 * slot].
        wanted: faces that a ray of the tile may meet [slot].
    """

    a: Array
    b: Array
    c: Array
    error: Array
    area: Array
    rise: Array
    z: Array
    wanted: Array


def _set_up(scene: SeenTree, leaf: Array, centre: tuple[Array, Array], half: tuple[Array, Array], side: int) -> _Faces:
    """Edge functions of the faces of one leaf about the centre of a tile, in flat rows long enough for SIMD.

    c is formed from the sum of an edge's ends, so that neighbours, who run through it in opposite directions, get
    the exactly negated function. As in `single_search`, a ray whose distance from three edges moved by rounding
    exceeds that motion is truly inside or outside. Screen coordinates of corners and rays err by up to 19 u of the
    distances that they stand for (turn 4, its shift 4, projection 4, tile 1, and 6 for a ray that was itself turned),
    in two directions 27 u = 13.4 eps, which is `grain`; an edge function errs by 7 u of its terms.
    """
    slot = leaf.shape[0] // 15
    p = [leaf[5 * k * slot : 5 * (k + 1) * slot] for k in range(3)]
    turn = scene.travel
    x, y, z = (turn[k, 0] * p[0] + turn[k, 1] * p[1] + turn[k, 2] * p[2] + scene.shift[k] for k in range(3))
    opposite, start, stop = slice(0, 3 * slot), slice(slot, 4 * slot), slice(2 * slot, 5 * slot)
    if scene.inverse_range is not None:
        scale = 1 / (1 + z * scene.inverse_range)
        x, y, z = x * scale, y * scale, z * scale
    x, y = x - centre[0], y - centre[1]
    a, b = y[start] - y[stop], x[stop] - x[start]
    sx, sy = (x[start] + x[stop]) / 2, (y[start] + y[stop]) / 2
    c = -(a * sx + b * sy)
    area = a * x[opposite] + b * y[opposite] + c
    # in grains: XLA computes what ends in a division once, all else anew for every use
    grains = _EDGE * jnp.finfo(x.dtype).eps * scene.grains
    width, height = 1 + grains * half[0], 1 + grains * half[1]
    error = (jnp.abs(a) * (width + grains * jnp.abs(sx)) + jnp.abs(b) * (height + grains * jnp.abs(sy))) / scene.grains
    reach = [size + 1 / scene.grains for size in half]
    overlap = (
        (lesser(lesser(x[opposite], x[start]), x[stop]) <= reach[0])
        & (greater(greater(x[opposite], x[start]), x[stop]) >= -reach[0])
        & (lesser(lesser(y[opposite], y[start]), y[stop]) <= reach[1])
        & (greater(greater(y[opposite], y[start]), y[stop]) >= -reach[1])
        & (error > 0)  # not where a face is missing
    )
    parts = [slice(k * slot, (k + 1) * slot) for k in range(3)]
    wanted = overlap[parts[0]] & overlap[parts[1]] & overlap[parts[2]]
    if side != 0:
        facing = area * side > -error
        wanted = wanted & (facing[parts[0]] | facing[parts[1]] | facing[parts[2]])
    size = jnp.abs(area)
    rise = (z[start] - z[opposite]) / jnp.where(size > error, size, 1)
    return _Faces(a, b, c, error, area, rise, z, wanted)
