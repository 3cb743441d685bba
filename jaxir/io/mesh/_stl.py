"""STL, binary and as text: every triangle in the order of the file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from trimesh.util import unique_name

from jaxir.io._files import read_text, to_number
from jaxir.io.mesh._file_mesh import FileMesh, one_part

_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("attribute", "<u2")])
_HEAD = 84  # bytes before the first triangle of a binary file
_FACET = ("facet", "outer", "vertex", "vertex", "vertex", "endloop", "endfacet")


def read_stl(file: Path) -> FileMesh:
    """Read an STL file.

    Args:
        file: the file.

    Returns:
        The mesh, three vertices a face; of a text the solids are its parts, else its only part is called after the
        file.

    Raises:
        ValueError: a binary file of another size than its header says, a text with a line out of place or without its
            end; names the file, and of a text the line.
    """
    size = file.stat().st_size
    with file.open("rb") as stream:
        head = stream.read(_HEAD)
        whole = _HEAD + _TRIANGLE.itemsize * int.from_bytes(head[80:], "little")
        if len(head) == _HEAD and size == whole:
            corners = np.fromfile(stream, _TRIANGLE)["corner"].reshape(-1, 3).astype(np.float64)
            return one_part(file, corners, np.arange(len(corners)).reshape(-1, 3))
    if head.lstrip()[:5].lower() != b"solid":
        cut = ": the file is cut" if size < whole or len(head) < _HEAD else ""
        raise ValueError(f"{file}: got {size} bytes, expected {whole} as its header says{cut}")
    return _from_text(file)


def _from_text(file: Path) -> FileMesh:
    corners: list[list[float]] = []
    part: list[int] = []
    names: list[str] = []
    inside, step = False, 0
    for line, written in enumerate(read_text(file, "latin-1").splitlines(), 1):
        words = written.split()
        if not words:
            continue
        key = words[0].lower()
        try:
            if step == 0 and key == ("endsolid" if inside else "solid"):
                inside = not inside
                if inside:
                    names.append(unique_name(" ".join(words[1:]), names))
                continue
            wanted = _FACET[step] if inside else "solid"
            if key != wanted:
                raise ValueError(f"expected {wanted}{' or endsolid' if inside and step == 0 else ''}")
            if key == "vertex":
                if len(words) != 4:
                    raise ValueError("expected three coordinates")
                corners.append([to_number(word) for word in words[1:]])
            if key == "endfacet":
                part.append(len(names) - 1)
        except ValueError as error:
            raise ValueError(f"{file}:{line}: got {written.strip()[:60]!r}, {error}") from None
        step = (step + 1) % len(_FACET)
    if inside:
        raise ValueError(f"{file}: got no endsolid at its end, expected one: the file is cut")
    vertices = np.array(corners, np.float64).reshape(-1, 3)
    return FileMesh(vertices, np.arange(len(vertices)).reshape(-1, 3), np.array(part, np.int32), tuple(names))
