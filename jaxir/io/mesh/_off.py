"""OFF: vertices and faces in the order of the file, as many as its header says."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from jaxir.io._files import read_text, to_number
from jaxir.io.mesh._file_mesh import FileMesh, one_part
from jaxir.io.mesh._polygons import cut

_WORDS = ("OFF", "COFF")


def read_off(file: Path) -> FileMesh:
    """Read an OFF or COFF file; colours are ignored.

    Args:
        file: the file.

    Returns:
        The mesh, whose only part is called after the file.

    Raises:
        ValueError: another first word, fewer or more lines than its header says, a vertex or face that is not one,
            a polygon that crosses itself; names file and place.
    """
    lines = [(n, line.split("#")[0].split()) for n, line in enumerate(read_text(file, "latin-1").splitlines(), 1)]
    lines = [(n, words) for n, words in lines if words]
    if not lines or lines[0][1][0] not in _WORDS:
        raise ValueError(f"{file}: got {' '.join(lines[0][1])[:60] if lines else ''!r}, expected OFF at its start")
    number, words = (lines[0][0], lines[0][1][1:]) if len(lines[0][1]) > 1 else (lines[1:2] or [(2, [])])[0]
    body = lines[1 if len(lines[0][1]) > 1 else 2 :]
    if len(words) not in (2, 3) or not all(word.isdecimal() for word in words):
        raise ValueError(f"{file}:{number}: got {' '.join(words)[:60]!r}, expected numbers of vertices, faces, edges")
    count, faces = int(words[0]), int(words[1])
    if len(body) != count + faces:
        raise ValueError(f"{file}: got {len(body)} lines, expected {count} vertices and {faces} faces: cut or damaged")
    colour = lines[0][1][0] == "COFF"
    vertices, polygons = [], []
    for place, (line, words) in enumerate(body):
        try:
            if place < count:
                if len(words) not in ((6, 7) if colour else (3,)):
                    raise ValueError(f"expected three coordinates{' and a colour' if colour else ''}")
                vertices.append([to_number(word) for word in words[:3]])
            else:
                sides = int(words[0])
                if not 3 <= sides < len(words):
                    raise ValueError("expected a number of corners >= 3 and those corners")
                polygons.append(np.array([int(word) for word in words[1 : sides + 1]], np.int64))
        except (ValueError, OverflowError) as error:
            raise ValueError(f"{file}:{line}: got {' '.join(words)[:60]!r}, {error}") from None
    points = np.array(vertices, np.float64).reshape(-1, 3)
    return one_part(file, points, cut(points, polygons, lambda face: f"{file}: face {face}")[0])
