"""Polygons of files, cut into triangles."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

_ROUNDING = 2.0**-22  # of coordinates in single precision, relative to the largest


def cut(
    vertices: np.ndarray,
    polygons: np.ndarray | Sequence[Sequence[int] | np.ndarray],
    place: Callable[[int], str],
    first: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """The triangles of polygons, in order.

    Each is cut into a fan from its first corner; where that would leave it, from the second, which does for whatever
    has four corners; or else ear by ear.

    Args:
        vertices: [vertex, 3].
        polygons: the corners of each, [polygon, corner] or of any numbers.
        place: what an error calls a polygon, given its index.
        first: what the file calls the first vertex.

    Returns:
        The corners of the triangles [face, 3], and the index of each triangle's polygon [face].

    Raises:
        ValueError: a polygon with fewer than three corners, with one that is no vertex, or that crosses itself.
    """
    if isinstance(polygons, np.ndarray):
        sides = np.full(len(polygons), polygons.shape[1])
    else:
        sides = np.array([len(corners) for corners in polygons], np.int64)
    if (sides < 3).any():
        few = int(np.argmax(sides < 3))
        raise ValueError(f"{place(few)}: got {sides[few]} corners, expected at least 3")
    owner = np.repeat(np.arange(len(sides)), sides - 2)
    faces = np.zeros((len(owner), 3), np.int64)
    for count in np.unique(sides):
        which = np.flatnonzero(sides == count)
        corners = np.array(polygons if len(which) == len(sides) else [polygons[i] for i in which.tolist()], np.int64)
        require_corners(corners, len(vertices), lambda row, which=which: place(which[row]), first)
        triangles = _fans(corners)
        left = _leaving(vertices[corners])
        turned = np.roll(corners[left], -1, axis=1)
        triangles[left] = _fans(turned)
        for row in left[_leaving(vertices[turned])]:
            ears = _ears(vertices[corners[row]])
            if ears is None:
                raise ValueError(f"{place(which[row])}: got a polygon that crosses itself, expected a simple one")
            triangles[row] = corners[row][ears]
        faces[sides[owner] == count] = triangles.reshape(-1, 3)
    return faces, owner


def require_corners(corners: np.ndarray, count: int, place: Callable[[int], str], first: int = 0) -> None:
    """Raise `ValueError` unless all corners of polygons [polygon, corner] are one of `count` vertices."""
    wrong = np.argwhere((corners < 0) | (corners >= count))
    if wrong.size:
        face, corner = wrong[0]
        got = corners[face, corner] + first
        raise ValueError(f"{place(face)}: got vertex {got}, expected one of {first} to {count - 1 + first}")


def _fans(corners: np.ndarray) -> np.ndarray:
    """Triangles [polygon, triangle, 3] of polygons [polygon, corner], each a fan from its first corner."""
    first = np.broadcast_to(corners[:, :1], (len(corners), corners.shape[1] - 2))
    return np.stack([first, corners[:, 1:-1], corners[:, 2:]], axis=-1)


def _leaving(points: np.ndarray) -> np.ndarray:
    """Indices of the polygons [polygon, corner, 3] whose fan has a triangle that turns against the whole."""
    if points.shape[1] == 3:
        return np.zeros(0, np.int64)
    with np.errstate(all="ignore"):  # coordinates that are not finite are refused elsewhere
        turn = _turns(points)
        whole = turn.sum(axis=1, keepdims=True)
        square = (whole**2).sum(axis=-1)
        against = ((turn * whole).sum(axis=-1) < -1e-6 * square).any(axis=1) | (square[:, 0] == 0)
    return np.flatnonzero(against)


def _turns(points: np.ndarray) -> np.ndarray:
    """Twice the area vectors of the fan's triangles [polygon, triangle, 3]; their sum is the polygon's."""
    edge = points[:, 1:] - points[:, :1]
    return np.cross(edge[:, :-1], edge[:, 1:])


def _ears(points: np.ndarray) -> np.ndarray | None:
    """Triangles [triangle, 3] of one polygon [corner, 3], cut off ear by ear; None where it crosses itself."""
    size = float(np.ptp(points, axis=0).max())
    slack = _ROUNDING * float(np.abs(points).max()) * size
    turn = _turns(points[None])[0]
    normal = turn.sum(axis=0)
    if np.linalg.norm(normal) <= slack:
        normal = turn[np.argmax((turn**2).sum(axis=1))]
    axis = int(np.argmax(np.abs(normal)))
    flat = (points - points[0])[:, [(axis + 1) % 3, (axis + 2) % 3]]
    flat = flat if normal[axis] >= 0 else flat[:, ::-1]
    left, ears = np.arange(len(flat)), []
    while len(left) >= 3:
        at = _next_ear(flat[left], slack)
        if at is None:
            return None
        ears.append(left[[at - 1, at, (at + 1) % len(left)]])
        left = np.delete(left, at)
    return np.array(ears)


def _next_ear(points: np.ndarray, slack: float) -> int | None:
    """The corner of a polygon [corner, 2] to cut off: by the shortest cut inside it, or else one without area."""
    before, after = np.roll(points, 1, axis=0), np.roll(points, -1, axis=0)
    area = _cross(points - before, after - points)
    tiny = 1e-12 * float(np.abs(area).max())
    length = ((after - before) ** 2).sum(axis=1)
    for at in np.argsort(length):
        ear = before[at], points[at], after[at]
        if area[at] > tiny and not _inside(points, ear, tiny).any():
            return int(at)
    straight = int(np.argmin(np.abs(area)))
    return straight if abs(area[straight]) <= slack else None


def _inside(points: np.ndarray, ear: tuple[np.ndarray, ...], tiny: float) -> np.ndarray:
    """Whether points [point, 2] lie in a triangle or on its edges, but not on its corners."""
    a, b, c = ear
    held = np.all([_cross(end - start, points - start) >= -tiny for start, end in ((a, b), (b, c), (c, a))], axis=0)
    return held & ~np.any([(points == corner).all(axis=1) for corner in ear], axis=0)


def _cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """The third component of the cross product of vectors in the plane."""
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
