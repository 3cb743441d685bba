"""Wavefront OBJ: vertices and faces in the order of the file, with the names that the file gives its faces."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import takewhile
from pathlib import Path

import numpy as np

from jaxir.io._files import to_number
from jaxir.io.mesh._file_mesh import FileMesh, indices
from jaxir.io.mesh._polygons import cut

_IGNORED = frozenset(
    (
        "vt vn vp p l s mg lod bevel c_interp d_interp shadow_obj trace_obj mtllib usemap maplib call csh cstype deg "
        "bmat step curv curv2 surf parm trim hole scrv sp end con stech ctech res bzp bsp cdc cdp"
    ).split()
)  # words of the format that tell nothing of triangles
_LAST = 2**31 - 1  # vertex


def read_obj(file: Path) -> FileMesh:
    """Read an OBJ file.

    A face belongs to the object (`o`) or group (`g`) named last; in a file that names neither, to its material
    (`usemtl`). Materials are kept beside the parts. Vertices may come after the faces that use them.

    Args:
        file: the file.

    Returns:
        The mesh; without any name its only part is called after the file.

    Raises:
        ValueError: a vertex or face that is not one, a polygon that crosses itself, a line that OBJ does not know;
            names file and line.
    """
    vertices: list[list[float]] = []
    polygons: list[list[int]] = []
    lines: list[int] = []
    objects: list[str] = []
    materials: list[str] = []
    current, material = "", ""
    with file.open(encoding="utf-8-sig", errors="replace") as stream:
        for line, written in _joined(stream):
            words = written.split()
            if not words:
                continue
            rest = list(takewhile(lambda word: not word.startswith("#"), words[1:]))  # a comment may follow
            try:
                if words[0] == "v":
                    vertices.append(_vertex(rest))
                elif words[0] == "f":
                    polygons.append([_index(word, len(vertices)) for word in rest])
                    if len({"/" in word for word in rest}) > 1:
                        raise ValueError("expected corners of one form")
                    lines.append(line)
                    objects.append(current)
                    materials.append(material)
                elif words[0] in ("o", "g"):
                    current = " ".join(words[1:])
                elif words[0] == "usemtl":
                    material = " ".join(words[1:])
                elif not words[0].startswith("#") and words[0] not in _IGNORED:
                    raise ValueError("expected a word of the OBJ format, as v or f")
            except ValueError as error:
                raise ValueError(f"{file}:{line}: got {written.strip()[:60]!r}, {error}") from None
    points = np.array(vertices, np.float64).reshape(-1, 3)
    faces, polygon = cut(points, polygons, lambda face: f"{file}:{lines[face]}", first=1)
    part, names = indices(objects if any(objects) else materials)
    kind, kinds = indices(materials)
    return FileMesh(
        points,
        faces,
        part[polygon],
        tuple(name or file.stem for name in names),
        *((kind[polygon], kinds) if any(materials) else ()),
    )


def _joined(stream: Iterable[str]) -> Iterator[tuple[int, str]]:
    """Number and text of every line, with those that it continues after a backslash at its end."""
    begun, number = "", 0
    for line, written in enumerate(stream, 1):
        number = number if begun else line
        whole = begun + written
        cut_off = whole.rstrip()
        if cut_off.endswith("\\") and not cut_off.lstrip().startswith("#"):
            begun = cut_off[:-1] + " "
        else:
            begun = ""
            yield number, whole
    if begun:
        yield number, begun


def _vertex(words: list[str]) -> list[float]:
    """Coordinates of `x y z`, which a weight of 1 or a colour may follow."""
    if len(words) < 3:
        raise ValueError("fewer than three coordinates")
    if len(words) == 4 and to_number(words[3]) != 1:
        raise ValueError("expected a weight (the fourth number) of 1")
    return [to_number(word) for word in words[:3]]


def _index(word: str, count: int) -> int:
    """Index from 0 of a corner `v/vt/vn`; negative numbers count back from the last vertex so far."""
    written = int(word.split("/")[0])
    if not (0 < written <= _LAST or -count <= written < 0):
        raise ValueError(f"expected vertices 1 to {_LAST}, or {-count} to -1 of those before")
    return written - 1 if written > 0 else count + written
