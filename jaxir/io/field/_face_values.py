"""Arrays from NPZ, NPY and CSV: values per face of a mesh, and whole fields."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jaxir.io._array_files import array_names, load_arrays
from jaxir.io._files import csv_rows, largest_number, to_number

_NUMBER = "id|idx|index|no|nr|num|number"
_MAY_BE_FACE = re.compile(  # letters of names, none where a table begins with numbers of its rows
    rf"({_NUMBER}|i|n)?(face|cell|elem|element|tri|triangle|facet|panel|polygon|poly|node|row)s?({_NUMBER})?"
    rf"|{_NUMBER}|i|n|unnamed|"
)


def load_array(path: str | os.PathLike, array: str | None = None) -> np.ndarray:
    """An array of finite numbers from NPY, or from NPZ by name.

    Args:
        path: the file.
        array: its name in an NPZ file; may be absent where the file holds one array.

    Returns:
        The array in double precision.

    Raises:
        ValueError: no such file, not readable (cut, or not NPZ or NPY), no such array, values that are not numbers
            or not finite; names file and place.
    """
    file = Path(path)
    held = array_names(file)
    name = array if array is not None else (held[0] if len(held) == 1 else None)
    if name is None or name not in held:
        raise ValueError(f"{file}: got array {array!r}, expected one of {', '.join(held) or 'none'}")
    value = load_arrays(file, [name])[name]
    if not np.issubdtype(value.dtype, np.number) or np.issubdtype(value.dtype, np.complexfloating):
        raise ValueError(f"{file}: {name} holds {value.dtype}, expected numbers")
    value = value.astype(np.float64)
    bad = np.argwhere(~(np.abs(value) <= largest_number()))
    if bad.size:
        place = tuple(int(i) for i in bad[0])
        raise ValueError(f"{file}: {name} is {value[place]} at {list(place)}, expected finite numbers")
    return value


def load_face_values(path: str | os.PathLike, count: int, column: str = "temperature") -> np.ndarray:
    """One number for each face of a mesh from CSV, NPZ or NPY.

    A CSV file is a list of numbers, one a line, or a table whose first line names its columns: `column`, and `face`,
    the index of each line's face from 0, where lines are not in the order of the faces. Empty lines and lines that
    start with # are skipped. An NPZ file holds an array of the name `column`, and of the name `face` likewise. Names
    that seem to mean `face`, as face_id does, are refused.

    Args:
        path: the file.
        count: faces of the mesh.
        column: name of the values.

    Returns:
        The values [face].

    Raises:
        ValueError: another number of values than faces, a face twice, a column or array that is missing, a cell that
            is no finite number, another ending; names file and line or place.
    """
    file = Path(path)
    suffix = file.suffix.lower()
    if suffix == ".csv":
        return _from_csv(file, count, column)
    if suffix not in (".npz", ".npy"):
        raise ValueError(f"{file}: expected a file name that ends in .csv, .npz or .npy")
    value = load_array(file, column if suffix == ".npz" else None)
    if suffix == ".npz":
        held = array_names(file)
        _require_no_other(str(file), held)
        if "face" in held:
            return _by_face(file, load_array(file, "face"), value, count)
    if value.shape != (count,):
        raise ValueError(f"{file}: {column} has shape {value.shape}, expected ({count},), one value per face")
    return value


def _by_face(file: Path, face: np.ndarray, value: np.ndarray, count: int) -> np.ndarray:
    """Values sorted by the face they belong to."""
    if face.shape != value.shape or face.ndim != 1:
        raise ValueError(f"{file}: face has shape {face.shape}, expected that of the values, {value.shape}")
    wrong = np.flatnonzero((face != np.floor(face)) | (face < 0) | (face >= count))
    if wrong.size:
        raise ValueError(f"{file}: face {face[wrong[0]]:g} at [{wrong[0]}], expected integers 0 to {count - 1}")
    times = np.bincount(face.astype(np.int64), minlength=count)
    if (times != 1).any():
        first = int(np.flatnonzero(times != 1)[0])
        raise ValueError(f"{file}: face {first} has {times[first]} values, expected one for each of {count} faces")
    sorted_value = np.empty(count)
    sorted_value[face.astype(np.int64)] = value
    return sorted_value


def _from_csv(file: Path, count: int, column: str) -> np.ndarray:
    rows = csv_rows(file)
    if not rows:
        raise ValueError(f"{file}: holds no values, expected {count}, one per face")
    header = [cell.strip() for cell in rows[0][1]]
    if len(header) == 1 and _is_number(header[0]):
        header, rows = [column], [rows[0], *rows]
    if column not in header or len(set(header)) < len(header):
        raise ValueError(f"{file}:{rows[0][0]}: got columns {', '.join(header)}, expected {column}, each once")
    _require_no_other(f"{file}:{rows[0][0]}", header)
    faces: list[float] = []
    values: list[float] = []
    for line, cells in rows[1:]:
        if len(cells) != len(header):
            raise ValueError(f"{file}:{line}: got {len(cells)} columns, expected {len(header)}")
        if len(values) == count:
            raise ValueError(f"{file}:{line}: got more than {count} values, expected one per face")
        values.append(_number(file, line, cells[header.index(column)]))
        if "face" in header:
            faces.append(_number(file, line, cells[header.index("face")]))
    if len(values) != count:
        raise ValueError(f"{file}: got {len(values)} values, expected {count}, one per face")
    return _by_face(file, np.array(faces), np.array(values), count) if faces else np.array(values)


def _require_no_other(where: str, names: Sequence[str]) -> None:
    """No name that may mean the index of a face and would not be read."""
    for name in names:
        if "face" not in names and _MAY_BE_FACE.fullmatch(re.sub("[^a-z]", "", name.lower())):
            raise ValueError(f"{where}: got {name!r}, expected 'face' where it is the index of a face from 0")


def _is_number(text: str) -> bool:
    try:
        to_number(text)
    except ValueError:
        return False
    return True


def _number(file: Path, line: int, text: str) -> float:
    if not _is_number(text) or not abs(to_number(text)) <= largest_number():
        raise ValueError(f"{file}:{line}: got {text.strip()[:60]!r}, expected a finite number")
    return to_number(text)
