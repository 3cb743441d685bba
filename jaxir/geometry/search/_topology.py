"""What a list of faces says about the body it bounds; on the host, once per mesh."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jaxir._arrays import fingerprint, remembered

KEPT = 32  # answers


def is_closed(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> bool:
    """Whether the faces bound a solid and all look outwards.

    True when, with coincident vertices merged, every edge is run through as often in one direction as in the other,
    every connected part encloses a positive volume, and no two faces lie back to back. Then a ray from outside
    enters before it leaves: only faces turned against a ray can be its first hit, and only faces turned away from a
    lamp can cast a shadow on what is outside, both without any epsilon.

    Args:
        vertices: [vertex, 3] [m].
        faces: [face, 3].

    Returns:
        False is always safe: it only costs speed and an offset.
    """
    from scipy.sparse import coo_array  # takes as long to import as all of jaxir
    from scipy.sparse.csgraph import connected_components

    merged = _merge(vertices)[faces].astype(np.int64)
    count = np.int64(merged.max()) + 1
    start, stop = merged.ravel(), np.roll(merged, -1, axis=1).ravel()
    forward, backward = np.sort(start * count + stop), np.sort(stop * count + start)
    if not np.array_equal(forward, backward):
        return False
    flat = (merged[:, 0] == merged[:, 1]) | (merged[:, 1] == merged[:, 2]) | (merged[:, 2] == merged[:, 0])
    corner = np.sort(merged[~flat], axis=1)
    triple = corner[np.lexsort(corner.T)]
    if np.any(np.all(triple[1:] == triple[:-1], axis=1)):
        return False
    edges = coo_array((np.ones(start.size, np.int8), (start, stop)), shape=(count, count))
    parts, part = connected_components(edges, directed=False)
    points = vertices.astype(np.float64)
    p = (points - (points.min(0) + points.max(0)) / 2)[faces]
    volume = np.einsum("fi,fi->f", p[:, 0], np.cross(p[:, 1], p[:, 2])) / 6
    area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1) / 2
    of_face = part[merged[:, 0]]
    part_volume = np.bincount(of_face, volume, parts)
    part_area = np.bincount(of_face, area, parts)
    used = np.bincount(of_face, minlength=parts) > 0
    return bool(np.all(part_volume[used] > 1e-6 * part_area[used] ** 1.5))


def is_convex(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> bool:
    """Whether faces bound a convex body or lie in one plane.

    No vertex rises over the plane of any face, but by rounding. Then no face hides or shades the front of another, and
    no back is seen, but that of a plane. Of all points of a convex hull a corner is the highest over a plane where none
    of its neighbours is higher, so that of most faces these are looked at alone. The last `KEPT` answers are kept: that
    of a million faces takes seconds.

    Args:
        vertices: [vertex, 3] [m].
        faces: [face, 3].
    """
    return remembered(_answers, fingerprint((vertices, faces)), lambda: _bounds_convex(vertices, faces), KEPT)


_answers: dict[bytes, bool] = {}


def _bounds_convex(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> bool:
    """`is_convex`, computed."""
    from scipy.spatial import ConvexHull, QhullError

    _, place, corner = np.unique(_merge(vertices)[faces], return_index=True, return_inverse=True)
    points, corner = vertices.astype(np.float64)[faces.ravel()[place]], corner.reshape(faces.shape)
    p = points[corner]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    size = np.linalg.norm(normal, axis=1)
    solid = size > 0
    if not solid.any():
        return False
    normal, corner = normal[solid] / size[solid][:, None], corner[solid]
    own = np.einsum("fk,fk->f", normal, points[corner[:, 0]])
    grain = 64 * np.finfo(vertices.dtype).eps * np.abs(points).max()
    largest = np.argmax(size[solid])
    if (np.abs(points @ normal[largest] - own[largest]) <= grain).all():
        return True
    few = slice(None, None, len(own) // 64 + 1)
    if _rises(points, normal[few], own[few], grain) or not is_closed(vertices, faces):
        return False
    try:
        hull = ConvexHull(points)
    except QhullError:  # too flat for it
        return False
    at = np.isin(corner, hull.vertices)
    near = at.any(axis=1)
    first = corner[near, np.argmax(at[near], axis=1)]
    ends = np.concatenate([hull.simplices[:, [i, j]] for i in range(3) for j in range(3) if i != j])
    ends = ends[np.argsort(ends[:, 0], kind="stable")]
    count = np.bincount(ends[:, 0], minlength=len(points))
    begin, each = np.cumsum(count) - count, count[first]
    place = np.arange(each.sum()) - np.repeat(np.cumsum(each) - each - begin[first], each)
    face = np.repeat(np.flatnonzero(near), each)
    over = np.einsum("nk,nk->n", normal[face], points[ends[place, 1]]) - own[face]
    return bool((over <= grain).all()) and not _rises(points[hull.vertices], normal[~near], own[~near], grain)


def _rises(points: NDArray, normal: NDArray, own: NDArray, grain: float) -> bool:
    """Whether a point rises over one of the planes normal . x = own by more than a grain."""
    parts = max(-(-len(points) * len(normal) // 2**22), 1)  # bounds memory
    both = zip(np.array_split(normal, parts), np.array_split(own, parts), strict=True)
    return any((some @ points.T - level[:, None]).max(initial=-np.inf) > grain for some, level in both)


def _merge(vertices: NDArray[np.floating]) -> NDArray[np.integer]:
    """A label for each vertex, equal where all coordinates are equal."""
    order = np.lexsort(vertices.T)
    new = np.any(vertices[order[1:]] != vertices[order[:-1]], axis=1)
    label = np.empty(len(vertices), np.int64)
    label[order] = np.concatenate([[0], np.cumsum(new)])
    return label
