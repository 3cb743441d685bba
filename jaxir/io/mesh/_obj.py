"""Wavefront OBJ: vertices and faces in the order of the file, with the names that the file gives its faces."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from jaxir.io._files import to_number
from jaxir.io.mesh._file_mesh import FileMesh

_IGNORED = frozenset(
    (
        "vt vn vp p l s mg lod bevel c_interp d_interp shadow_obj trace_obj mtllib usemap maplib call csh cstype deg "
        "bmat step curv curv2 surf parm trim hole scrv sp end con stech ctech res bzp bsp cdc cdp"
    ).split()
)  # words of the format that tell nothing of triangles


def read_obj(file: Path) -> FileMesh:
    """Read an OBJ file.

    A face belongs to the object (`o`) or group (`g`) named last; in a file that names neither, to its material
    (`usemtl`). Materials are kept beside the parts.

    Args:
        file: the file.

    Returns:
        The mesh; without any name its only part is called after the file.

    Raises:
        ValueError: a vertex or face that is not one, a line that OBJ does not know; names file and line.
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
                    vertices.append([to_number(word) for word in words[1:4]])
                    if len(vertices[-1]) != 3:
                        raise ValueError("fewer than three coordinates")
                elif words[0] == "f":
                    corner = [_index(word, len(vertices)) for word in words[1:]]
                    if len({"/" in word for word in words[1:]}) > 1:
                        raise ValueError("expected corners of one form")
                    if len(corner) < 3:
                        raise ValueError("fewer than three corners")
                    fan = [[corner[0], corner[i], corner[i + 1]] for i in range(1, len(corner) - 1)]
                    faces += fan
                    objects += [current] * len(fan)
                    materials += [material] * len(fan)
                elif words[0] in ("o", "g"):
                    current = " ".join(words[1:])
                elif words[0] == "usemtl":
                    material = " ".join(words[1:])
                elif not words[0].startswith("#") and words[0] not in _IGNORED:
                    raise ValueError("expected a word of the OBJ format, as v or f")
            except ValueError as error:
                raise ValueError(f"{file}:{line}: got {written.strip()[:60]!r}, {error}") from None
    part, names = _indices(objects if any(objects) else materials)
    return FileMesh(
        np.array(vertices, np.float64).reshape(-1, 3),
        np.array(faces, np.int64).reshape(-1, 3),
        part,
        tuple(name or file.stem for name in names),
        *(_indices(materials) if any(materials) else ()),
    )


def _indices(named: list[str]) -> tuple[np.ndarray, tuple[str, ...]]:
    """Index of each name, and the names in the order in which they come."""
    names = tuple(dict.fromkeys(named))
    place = {name: i for i, name in enumerate(names)}
    return np.array([place[name] for name in named], np.int32), names


def _index(word: str, count: int) -> int:
    """Index from 0 of a corner `v/vt/vn`; negative numbers count back from the last vertex."""
    written = int(word.split("/")[0])
    index = written - 1 if written > 0 else count + written
    if written == 0 or not 0 <= index < count:
        raise ValueError(f"expected vertices 1 to {count}")
    return index
