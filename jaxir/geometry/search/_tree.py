"""A search tree over triangles: perfect, 16 children to a node, built once on the host and refitted on the device.

Faces are halved at the median of the coordinate, or size, that leaves the smallest boxes until a leaf holds about 16
of them, so that every leaf is full and every path has the same length: a search is a fixed nest of loops without a
stack. The boxes of a node's children lie side by side, to be tested together, and are stored eight times, sorted
from near to far for each octant of directions.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from numpy.typing import NDArray
from tqdm import tqdm

WIDTH = 16  # children of a node
LEAF = 16  # faces of a full leaf
FAR = 1e30  # an empty box is a far point: an inverted box would be met by every ray
JUDGED = 64  # faces of a segment on which the ways to divide it are judged
PROGRESS = 2_000_000  # faces beyond which building shows its progress


class Tree(eqx.Module):
    """The tree of one mesh; coordinates are relative to `centre`.

    Attributes:
        face: face in each place of each leaf [leaf, slot]; -1 where empty.
        children: for each level, from the root down, child numbers sorted near to far [octant * node, 16].
        boxes: for each level, lower x, y, z, then upper x, y, z of the children [octant * node, 6 * 16] [m].
        leaves: x, then y, then z of corners 0, 1, 2, 0, 1 [leaf, 15 * slot] [m]; zero where a face is missing or has
            two corners in one place.
        centre: a point from which the mesh's coordinates are measured without rounding [3] [m]: on each axis the
            middle of the mesh if it lies far from 0, otherwise 0.
        extent: largest size of a coordinate measured from it [3] [m].
    """

    face: Int[Array, "leaf slot"]
    children: tuple[Int[Array, "_ 16"], ...]
    boxes: tuple[Float[Array, "_ 96"], ...]
    leaves: Float[Array, "leaf _"]
    centre: Float[Array, " 3"]
    extent: Float[Array, " 3"]

    def outline(self, most: int) -> Float[Array, "row 96"]:
        """Boxes of the deepest level with at most `most` of them as an outline, see `jaxir.geometry.search`."""
        level = max([k for k, boxes in enumerate(self.boxes) if 2 * boxes.shape[0] <= most], default=0)
        sides = self.boxes[level][: self.boxes[level].shape[0] // 8].reshape(-1, 2, 3, WIDTH)
        return (sides + self.centre[None, None, :, None]).reshape(-1, 6 * WIDTH)

    def refit(self, vertices: Float[Array, "vertex 3"], faces: Int[Array, "face 3"]) -> Tree:
        """The same tree about moved vertices; runs under jit. The order of faces stays, so large motions cost speed."""
        return Tree(self.face, self.children, *_tables(jnp, vertices, faces, self.face, self.children))


def build(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> Tree:
    """The tree of faces `faces` [face, 3] over `vertices` [vertex, 3] [m], on the host.

    A mesh of at most one leaf has no levels.
    """
    faces = faces.astype(np.int32)
    face = _leaf_faces(vertices[faces])
    children = _children(vertices, faces, face)
    tables = _tables(np, vertices, faces, face, children)
    boxes, leaves, centre, extent = tables
    return Tree(
        jnp.asarray(face),
        tuple(jnp.asarray(c) for c in children),
        tuple(jnp.asarray(b) for b in boxes),
        jnp.asarray(leaves),
        jnp.asarray(centre),
        jnp.asarray(extent),
    )


def single_leaf(vertices: Float[Array, "vertex 3"], faces: Int[Array, "face 3"]) -> Tree:
    """A tree without levels that holds all faces in one leaf; runs under jit, for a handful of faces."""
    face = jnp.arange(faces.shape[0], dtype=jnp.int32)[None, :]
    return Tree(face, (), *_tables(jnp, vertices, faces, face, ()))


def _leaf_faces(corners: NDArray[np.floating]) -> NDArray[np.int32]:
    """Faces with `corners` [face, 3, 3] in leaf order [leaf, slot], -1 where empty: median splits."""
    count = len(corners)
    levels, below = 1, 1
    while count > LEAF * WIDTH * below:
        levels, below = levels + 1, below * WIDTH
    top = -(-count // (LEAF * below))
    size = -(-count // (4 * top * below)) * 4
    total = top * below * size
    # for the empty places repeat faces evenly over the mesh, so that all segments have one size; struck out at the end
    repeated = np.linspace(0, count, total - count, endpoint=False).astype(np.int64)
    place = np.concatenate([np.arange(count), repeated])
    number = np.where(np.arange(total) < count, place, -1).astype(np.int32)
    low, high = corners.min(axis=1)[place], corners.max(axis=1)[place]
    size_of = (high - low).max(axis=1, keepdims=True)
    keys = np.concatenate([corners.mean(axis=1, dtype=np.float64)[place], low, high, size_of], axis=1)

    def share(order: NDArray[np.int64], parts: int) -> list[NDArray[np.int64]]:
        if parts == 1:
            return [order]
        left = parts // 2
        at = len(order) // parts * left
        order = _divided(order[None], at, keys, low, high)[0]
        return share(order[:at], left) + share(order[at:], parts - left)

    order = np.stack(share(np.arange(total), top))
    for _ in tqdm(range(4 * (levels - 1)), desc="search tree", disable=count < PROGRESS):
        middle = order.shape[1] // 2
        order = _divided(order, middle, keys, low, high).reshape(-1, middle)
    return number[order]


def _divided(
    order: NDArray[np.int64],
    at: int,
    keys: NDArray[np.floating],
    low: NDArray[np.floating],
    high: NDArray[np.floating],
) -> NDArray[np.int64]:
    """Segments [segment, face] with the `at` faces of lowest key first, by the key that leaves the smallest boxes.

    Rays meet a box as often as its surface is large, so the sum of surface times faces foretells the cost of a
    division (MacDonald and Booth, "Heuristics for ray tracing using space subdivision", The Visual Computer 6, 1990);
    it is judged on a sample of each segment.
    """
    count = order.shape[1]
    some = order[:, :: max(1, count // JUDGED)]
    middle = max(1, round(at / count * some.shape[1]))
    costs = []
    for key in keys.T:
        trial = np.take_along_axis(some, np.argpartition(key[some], middle, axis=1), axis=1)
        surfaces = [
            _surface(low[half].min(axis=1), high[half].max(axis=1)) for half in np.split(trial, [middle], axis=1)
        ]
        costs.append(surfaces[0] * at + surfaces[1] * (count - at))
    best = np.argmin(costs, axis=0)
    return np.take_along_axis(order, np.argpartition(keys[order, best[:, None]], at, axis=1), axis=1)


def _surface(low: NDArray[np.floating], high: NDArray[np.floating]) -> NDArray[np.floating]:
    """Half the surface of boxes [box]."""
    x, y, z = (high - low).T
    return x * y + y * z + z * x


def _children(
    vertices: NDArray[np.floating], faces: NDArray[np.integer], face: NDArray[np.integer]
) -> tuple[NDArray[np.int32], ...]:
    """Child numbers of every node, near to far for each octant [octant * node, 16], for each level from the root."""
    if len(face) == 1:
        return ()
    corner = _corners(np, vertices, faces, face, vertices.mean(0))
    pyramid = _pyramid(np, *_leaf_boxes(np, *corner))
    signs = np.array([[-1.0 if octant >> axis & 1 else 1.0 for axis in range(3)] for octant in range(8)])
    out = []
    for low, high in pyramid:
        count = len(low)
        nodes = max(1, count // WIDTH)
        child = np.full((nodes, WIDTH), -1, np.int32)
        child[:, : count // nodes] = np.arange(count, dtype=np.int32).reshape(nodes, -1)
        key = np.where(low[:, :1] < FAR, (low + high) / 2, FAR)[child] @ signs.T
        key = np.where(child[:, :, None] >= 0, key, np.inf)
        order = np.argsort(key, axis=1, kind="stable").transpose(2, 0, 1)
        out.append(np.take_along_axis(child[None, :, :], order, axis=2).reshape(8 * nodes, WIDTH))
    return tuple(out)


def _tables(xp: ModuleType, vertices: Any, faces: Any, face: Any, children: tuple[Any, ...]) -> tuple[Any, ...]:
    """(boxes, leaves, centre, extent) of `Tree`, with numpy on the host or jax.numpy on the device."""
    used = vertices[faces].reshape(-1, 3)
    low, high = used.min(0), used.max(0)
    middle = (low + high) / 2
    # floats within a factor of two of each other are subtracted without rounding (Sterbenz)
    centre = xp.where(abs(middle) > 2.25 * (high - low) / 2, middle, xp.zeros_like(middle))
    extent = xp.maximum(high - centre, centre - low)
    corners, solid = _corners(xp, vertices, faces, face, centre)
    corners = xp.where(solid[:, :, None, None], corners, xp.zeros_like(corners))
    leaf, slot = face.shape
    five = xp.concatenate([corners, corners[:, :, :2]], axis=2)
    leaves = five.transpose(0, 3, 2, 1).reshape(leaf, 15 * slot)
    margin = 16 * np.finfo(corners.dtype).eps * xp.sqrt((extent * extent).sum())  # slab tests round, flat boxes exist
    boxes = []
    if children:
        pyramid = _pyramid(xp, *_leaf_boxes(xp, corners, solid))
        for (below, above), child in zip(pyramid, children, strict=True):
            valid = (child >= 0)[:, :, None]
            index = xp.maximum(child, 0)
            sides = (xp.where(valid, below[index], FAR) - margin, xp.where(valid, above[index], FAR) + margin)
            boxes.append(xp.concatenate([side.transpose(0, 2, 1).reshape(len(child), -1) for side in sides], axis=1))
    return tuple(boxes), leaves, centre, extent


def _corners(xp: ModuleType, vertices: Any, faces: Any, face: Any, centre: Any) -> tuple[Any, Any]:
    """Vertices of the faces in leaf order [leaf, slot, corner, 3] [m], and whether each is a face of three places."""
    corners = vertices[faces[xp.maximum(face, 0)]] - centre[None, None, None, :]
    apart = (corners != corners[:, :, xp.asarray([1, 2, 0])]).any(-1).all(-1)
    return corners, (face >= 0) & apart


def _leaf_boxes(xp: ModuleType, corners: Any, solid: Any) -> tuple[Any, Any]:
    """Lower and upper corner of every leaf [leaf, 3] [m]; a far point when the leaf is empty."""
    there = solid[:, :, None]
    low = xp.where(there, corners.min(2), FAR).min(1)
    high = xp.where(there, corners.max(2), -FAR).max(1)
    return low, xp.where(low < FAR, high, FAR)


def _pyramid(xp: ModuleType, low: Any, high: Any) -> list[tuple[Any, Any]]:
    """Boxes of all children for each level from the root down; the last are the leaves."""
    levels = [(low, high)]
    while len(levels[0][0]) > WIDTH:
        below, above = levels[0]
        below = below.reshape(-1, WIDTH, 3).min(1)
        above = xp.where(above < FAR, above, -FAR).reshape(-1, WIDTH, 3).max(1)
        levels.insert(0, (below, xp.where(below < FAR, above, FAR)))
    return levels
