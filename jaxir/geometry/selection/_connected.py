"""Faces that hang together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxir.geometry.selection._place import require_number, vector
from jaxir.geometry.selection._selection import AbstractSelection, LabelledFaces


@dataclass(frozen=True)
class Connected(AbstractSelection):
    """The connected region about a point: the face nearest to it, and all that is reached from there over edges.

    Corners in one place are one, whether the file shares them or not. With a `crease` edges at which the surface
    bends by more are not passed, so that a nozzle, a canopy or a wing is found in a mesh that is one piece.

    Attributes:
        point: on or near the region [3] [m].
        crease: largest bend, the angle between the normals of two faces beside an edge [deg]; 180 passes every edge.
    """

    point: Any
    crease: float = 180.0

    def __post_init__(self) -> None:
        """Check both."""
        object.__setattr__(self, "point", vector("Connected.point", self.point))
        require_number("Connected.crease", self.crease, 0, 180, "degrees above 0, at most 180")

    def holds(self, faces: LabelledFaces) -> np.ndarray:
        """See `AbstractSelection.holds`."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components
        from trimesh.triangles import closest_point

        point, count = np.asarray(self.point), len(faces.corners)
        nearest = closest_point(faces.corners, np.broadcast_to(point, (count, 3)))
        seed = int(np.argmin(np.sum((nearest - point) ** 2, axis=1)))
        first, second, bend = neighbours(faces)
        passed = bend <= self.crease + 1e-9
        links = (np.ones(np.count_nonzero(passed), np.int8), (first[passed], second[passed]))
        region = connected_components(coo_array(links, shape=(count, count)), directed=False)[1]
        return region == region[seed]


def neighbours(faces: LabelledFaces) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of faces that share an edge, and how much the surface bends there [pair] [deg].

    Where more than two faces meet in an edge each is paired with the next. Two faces that run along their edge in one
    direction, of which one is inside out, bend as if it were not. A face without area bends nowhere.
    """
    corner = np.unique(faces.corners.reshape(-1, 3), axis=0, return_inverse=True)[1].reshape(-1, 3)
    start, stop = corner.ravel(), np.roll(corner, -1, axis=1).ravel()
    owner = np.repeat(np.arange(len(corner)), 3)
    edge = np.stack([np.minimum(start, stop), np.maximum(start, stop)], axis=1)
    order = np.lexsort(edge.T)
    same = (edge[order[1:]] == edge[order[:-1]]).all(axis=1)
    one, other = order[:-1][same], order[1:][same]
    first, second = owner[one], owner[other]
    normal = faces.normal
    cosine = np.sum(normal[first] * normal[second], axis=1)
    cosine = np.where(start[one] == start[other], -cosine, cosine)
    flat = ~(normal[first].any(axis=1) & normal[second].any(axis=1))
    return first, second, np.where(flat, 0.0, np.rad2deg(np.arccos(np.clip(cosine, -1, 1))))
