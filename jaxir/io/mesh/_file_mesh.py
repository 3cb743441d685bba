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
        faces: triangles [face, 3], those of a polygon one after the other.
        part: index of each face's name [face].
        part_names: the names, each once, in the order in which faces take them.
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


def indices(named: Sequence[str]) -> tuple[np.ndarray, tuple[str, ...]]:
    """Index of each name, and the names, each once, in the order in which they come."""
    names = tuple(dict.fromkeys(named))
    place = {name: i for i, name in enumerate(names)}
    return np.array([place[name] for name in named], np.int32), names
