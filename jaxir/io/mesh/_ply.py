"""PLY, binary and as text: vertices and faces in the order of the file, as many as its header says."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxir.io._files import to_number
from jaxir.io.mesh._file_mesh import FileMesh, one_part
from jaxir.io.mesh._polygons import cut

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_LONGEST_HEADER = 10_000  # lines
_CORNERS = ("vertex_indices", "vertex_index")
Columns = dict[str, Any]  # values [row] by property, those of a list as arrays


class _Property(NamedTuple):
    """One value of every row of an element, or a list of them with the type of its length."""

    name: str
    kind: str
    length: str | None


class _Element(NamedTuple):
    """Rows of one kind."""

    name: str
    rows: int
    properties: list[_Property]


def read_ply(file: Path) -> FileMesh:
    """Read a PLY file; only coordinates and the corners of faces are kept.

    Args:
        file: the file.

    Returns:
        The mesh, whose only part is called after the file.

    Raises:
        ValueError: a header that is none, fewer or more rows than it says, a value that is no number, a face with
            fewer than three corners, with one that is no vertex or that crosses itself; names the file and the place.
    """
    raw = file.read_bytes()
    order, elements, start = _header(file, raw)
    read = _from_text if order == "" else _from_bytes
    held = read(file, raw[start:], elements, order)
    for name, wanted in (("vertex", "xyz"), ("face", _CORNERS[:1])):
        missing = set(wanted) - set(held.get(name, {}))
        if missing:
            raise ValueError(f"{file}: got no {name} with {', '.join(sorted(missing))}, expected some in its header")
    vertices = np.stack([np.asarray(held["vertex"][axis], np.float64) for axis in "xyz"], axis=1)
    faces, _ = cut(vertices, held["face"][_CORNERS[0]], lambda face: f"{file}: face {face}")
    return one_part(file, vertices, faces)


def _header(file: Path, raw: bytes) -> tuple[str, list[_Element], int]:
    """Order of bytes (empty for text), elements, and where they start."""
    order, elements, start = None, list[_Element](), 0
    for line in range(1, _LONGEST_HEADER + 1):
        end = raw.find(b"\n", start)
        written = raw[start : end if end >= 0 else start + 200].decode("latin-1").strip()
        words = written.split()
        start = end + 1
        try:
            if end < 0:
                raise ValueError("expected a header that ends with end_header: the file is cut or no PLY")
            if line == 1 and words != ["ply"]:
                raise ValueError("expected ply")
            if line == 1 or not words or words[0] in ("comment", "obj_info"):
                continue
            if words == ["end_header"]:
                if order is None or not all(element.properties for element in elements):
                    raise ValueError("expected a format, and properties of every element, before")
                return order, elements, start
            if words[0] == "format" and len(words) == 3 and words[1] in _ORDERS and order is None:
                order = _ORDERS[words[1]]
            elif words[0] == "element" and len(words) == 3 and words[2].isdecimal():
                if words[1] in {element.name for element in elements}:
                    raise ValueError("expected each element once")
                elements.append(_Element(words[1], int(words[2]), []))
            elif words[0] == "property" and elements:
                elements[-1].properties.append(_property(words[1:], elements[-1].properties))
            else:
                raise ValueError("expected format, element, property, comment or end_header")
        except (ValueError, KeyError) as error:
            said = f"unknown type {error}" if isinstance(error, KeyError) else error
            raise ValueError(f"{file}:{line}: got {written[:60]!r}, {said}") from None
    raise ValueError(f"{file}: got a header of {_LONGEST_HEADER} lines, expected one that ends with end_header")


def _property(words: list[str], before: list[_Property]) -> _Property:
    if words[-1:] and words[-1] in {one.name for one in before}:
        raise ValueError("expected each property once")
    if words[:1] == ["list"] and len(words) == 4:
        name = _CORNERS[0] if words[3] in _CORNERS else words[3]
        length, kind = _TYPES[words[1]], _TYPES[words[2]]
        if length[0] == "f" or (name == _CORNERS[0] and kind[0] == "f"):
            raise ValueError("expected integers for lengths and corners")
        return _Property(name, kind, length)
    if len(words) != 2 or words[1] in _CORNERS:
        raise ValueError("expected a type and a name, or a list of corners")
    return _Property(words[1], _TYPES[words[0]], None)


def _from_text(file: Path, body: bytes, elements: list[_Element], order: str) -> dict[str, Columns]:
    rows = [words for words in (line.split() for line in body.decode("latin-1").splitlines()) if words]
    said = " and ".join(f"{element.rows} of {element.name}" for element in elements)
    if len(rows) != sum(element.rows for element in elements):
        raise ValueError(f"{file}: got {len(rows)} lines, expected {said} as its header says: cut or damaged")
    held, before = {}, 0
    for element in elements:
        columns: list[list] = [[] for _ in element.properties]
        for place, words in enumerate(rows[before : before + element.rows]):
            try:
                _split(words, element, columns)
            except (ValueError, OverflowError) as error:
                shown = " ".join(words)[:60]
                raise ValueError(f"{file}: {element.name} {place}: got {shown!r}, {error}") from None
        held[element.name] = {one.name: values for one, values in zip(element.properties, columns, strict=True)}
        before += element.rows
    return held


def _split(words: list[str], element: _Element, columns: list[list]) -> None:
    """Add the words of a row to the columns of its element."""
    place = 0
    for one, column in zip(element.properties, columns, strict=True):
        number = to_number if one.kind[0] == "f" else int
        length = 1 if one.length is None else int(words[place]) if place < len(words) else -1
        first = place + (one.length is not None)
        place = first + length
        if length < 0 or place > len(words):
            raise ValueError("expected more numbers")
        values = [number(word) for word in words[first:place]]
        column.append(values[0] if one.length is None else np.array(values, np.float64 if one.kind[0] == "f" else int))
    if place != len(words):
        raise ValueError("expected fewer numbers")


def _from_bytes(file: Path, body: bytes, elements: list[_Element], order: str) -> dict[str, Columns]:
    source = _Source(file, body, order)
    held = {element.name: source.rows(element) for element in elements}
    if source.start != len(body):
        raise ValueError(f"{file}: got {len(body) - source.start} bytes after the last element, expected none: damaged")
    return held


class _Source:
    """The bytes after a header, read element by element."""

    def __init__(self, file: Path, body: bytes, order: str):
        self.file, self.body, self.order, self.start = file, body, order, 0

    def rows(self, element: _Element) -> Columns:
        """The columns of an element: at once if all its lists are as long as those of the first row, else by row."""
        if element.rows == 0:
            return {one.name: [] for one in element.properties}
        begin, first = self.start, self._row(element, 0)
        layout: list[tuple] = []
        for one, value in zip(element.properties, first, strict=True):
            if one.length is not None:
                layout.append((f"length {one.name}", self.order + one.length))
            layout.append((one.name, self.order + one.kind, value.shape))
        kind = np.dtype(layout)
        if begin + element.rows * kind.itemsize <= len(self.body):
            table = np.frombuffer(self.body, kind, element.rows, begin)
            lists = [one.name for one in element.properties if one.length is not None]
            if all((table[f"length {name}"] == table[name].shape[1]).all() for name in lists):
                self.start = begin + element.rows * kind.itemsize
                return {one.name: table[one.name] for one in element.properties}
        every = [first, *(self._row(element, place) for place in range(1, element.rows))]
        return {one.name: [row[i] for row in every] for i, one in enumerate(element.properties)}

    def _row(self, element: _Element, place: int) -> list[Any]:
        """The values of one row, lists as arrays."""
        values = []
        for one in element.properties:
            if one.length is None:
                values.append(self._take(element, place, one.kind, 1)[0])
            else:
                values.append(self._take(element, place, one.kind, int(self._take(element, place, one.length, 1)[0])))
        return values

    def _take(self, element: _Element, place: int, kind: str, length: int) -> np.ndarray:
        end = self.start + length * int(kind[1])
        if length < 0 or end > len(self.body):
            raise ValueError(
                f"{self.file}: {element.name} {place}: got the end of the file, expected {element.rows} rows as its "
                "header says: cut or damaged"
            )
        found = np.frombuffer(self.body, self.order + kind, length, self.start)
        self.start = end
        return found
