"""Wavefront OBJ: vertices and faces in the order of the file, with the names that the file gives its faces."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np


class ObjMesh(NamedTuple):
    """What an OBJ file holds.

    Attributes:
        vertices: [vertex, 3], in the file's unit.
        faces: triangles [face, 3]; a polygon is cut into a fan from its first corner.
        part: index of each face's name [face].
        part_names: the names, in the order in which faces take them.
    """

    vertices: np.ndarray
    faces: np.ndarray
    part: np.ndarray
    part_names: tuple[str, ...]


def read_obj(file: Path) -> ObjMesh:
    """Read an OBJ file.

    A face belongs to the object (`o`) or group (`g`) named last; in a file that names neither, to its material
    (`usemtl`).

    Args:
        file: the file.

    Returns:
        The mesh; without any name its only part is called after the file.

    Raises:
        ValueError: a vertex or face that is not one; names file and line.
    """
    vertices: list[list[float]] = []
    faces: list[list[int]] = []
    objects: list[str] = []
    materials: list[str] = []
    current, material = "", ""
    with file.open(encoding="utf-8", errors="replace") as stream:
        for line, written in enumerate(stream, 1):
            words = written.split()
            if not words:
                continue
            try:
                if words[0] == "v":
                    vertices.append([float(word) for word in words[1:4]])
                    if len(vertices[-1]) != 3:
                        raise ValueError("fewer than three coordinates")
                elif words[0] == "f":
                    corner = [_index(word, len(vertices)) for word in words[1:]]
                    if len(corner) < 3:
                        raise ValueError("fewer than three corners")
                    fan = [[corner[0], corner[i], corner[i + 1]] for i in range(1, len(corner) - 1)]
                    faces += fan
                    objects += [current] * len(fan)
                    materials += [material] * len(fan)
            except ValueError as error:
                raise ValueError(f"{file}:{line}: got {written.strip()[:60]!r}, {error}") from None
            if words[0] in ("o", "g"):
                current = " ".join(words[1:])
            elif words[0] == "usemtl":
                material = " ".join(words[1:])
    named = objects if any(objects) else materials
    names = tuple(dict.fromkeys(named))
    place = {name: i for i, name in enumerate(names)}
    return ObjMesh(
        np.array(vertices, np.float64).reshape(-1, 3),
        np.array(faces, np.int64).reshape(-1, 3),
        np.array([place[name] for name in named], np.int32),
        tuple(name or file.stem for name in names),
    )


def _index(word: str, count: int) -> int:
    """Index from 0 of a corner `v/vt/vn`; negative numbers count back from the last vertex."""
    written = int(word.split("/")[0])
    index = written - 1 if written > 0 else count + written
    if written == 0 or not 0 <= index < count:
        raise ValueError(f"expected vertices 1 to {count}")
    return index
