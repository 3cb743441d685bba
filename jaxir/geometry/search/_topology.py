"""What a list of faces says about the body it bounds; on the host, once per mesh."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


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
    no back is seen, but that of a plane. Looks at every face and the vertices of the convex hull alone.

    Args:
        vertices: [vertex, 3] [m].
        faces: [face, 3].
    """
    from scipy.spatial import ConvexHull, QhullError

    points = vertices.astype(np.float64)[np.unique(faces)]
    p = vertices.astype(np.float64)[faces]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    size = np.linalg.norm(normal, axis=1)
    solid = size > 0
    normal = normal[solid] / size[solid][:, None]
    try:
        points = points[ConvexHull(points).vertices]
    except QhullError:  # flat: few points suffice
        extremes = [f(points @ axis) for axis in np.vstack([np.eye(3), normal[:8]]) for f in (np.argmin, np.argmax)]
        points = points[np.unique(extremes)]
    own = np.einsum("fk,fk->f", normal, p[solid][:, 0])
    grain = 64 * np.finfo(vertices.dtype).eps * np.abs(points).max()
    height = [normal @ some.T - own[:, None] for some in np.array_split(points, -(-len(points) // 256))]
    highest, lowest = max(part.max() for part in height), min(part.min() for part in height)
    return bool(highest <= grain and (lowest >= -grain or is_closed(vertices, faces)))


def _merge(vertices: NDArray[np.floating]) -> NDArray[np.integer]:
    """A label for each vertex, equal where all coordinates are equal."""
    order = np.lexsort(vertices.T)
    new = np.any(vertices[order[1:]] != vertices[order[:-1]], axis=1)
    label = np.empty(len(vertices), np.int64)
    label[order] = np.concatenate([[0], np.cumsum(new)])
    return label
