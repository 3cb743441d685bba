"""What a mesh file holds, whatever its format."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

NO_MATERIAL = np.zeros(0, np.int32)


class FileMesh(NamedTuple):
    """What a mesh file holds.

    Attributes:
        vertices: [vertex, 3], in the file's unit.
        faces: triangles [face, 3]; a polygon is cut into a fan from its first corner.
        part: index of each face's name [face].
        part_names: the names, in the order in which faces take them.
        material: index of each face's material [face]; empty where the file names none.
        material_names: the names of the materials.
    """

    vertices: np.ndarray
    faces: np.ndarray
    part: np.ndarray
    part_names: tuple[str, ...]
    material: np.ndarray = NO_MATERIAL
    material_names: tuple[str, ...] = ()


def one_part(file: Path, vertices: np.ndarray, faces: np.ndarray) -> FileMesh:
    """The mesh of a format without objects, whose only part is called after the file."""
    return FileMesh(vertices, faces, np.zeros(len(faces), np.int32), (file.name,))


def fan(corners: np.ndarray) -> np.ndarray:
    """The triangles of polygons [polygon, corner], each a fan from its first corner, in order [face, 3]."""
    first = np.broadcast_to(corners[:, :1], (len(corners), corners.shape[1] - 2))
    return np.stack([first, corners[:, 1:-1], corners[:, 2:]], axis=-1).reshape(-1, 3).astype(np.int64)


def fans(file: Path, polygons: np.ndarray | Sequence[np.ndarray], count: int) -> np.ndarray:
    """The triangles of polygons of any numbers of corners, in order [face, 3].

    Raises:
        ValueError: a polygon of fewer than three corners, or with one that is none of `count` vertices.
    """
    if not isinstance(polygons, np.ndarray) and len({len(corners) for corners in polygons}) == 1:
        polygons = np.stack(polygons)
    alike = [polygons] if isinstance(polygons, np.ndarray) else [corners[None] for corners in polygons]
    before = 0
    for corners in alike:
        require_corners(file, corners, count, before)
        before += len(corners)
    return np.concatenate([np.zeros((0, 3), np.int64), *(fan(corners) for corners in alike)])


def require_corners(file: Path, corners: np.ndarray, count: int, before: int = 0) -> None:
    """Raise `ValueError` unless polygons [polygon, corner] have three corners or more, all of `count` vertices."""
    if corners.shape[1] < 3:
        raise ValueError(f"{file}: face {before}: got {corners.shape[1]} corners, expected at least 3")
    wrong = np.argwhere((corners < 0) | (corners >= count))
    if wrong.size:
        face, corner = wrong[0]
        raise ValueError(
            f"{file}: face {before + face}: got vertex {corners[face, corner]}, expected one of 0 to {count - 1}"
        )
