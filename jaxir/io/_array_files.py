"""Arrays from NPZ and NPY: their headers are read first, so that no file takes more memory than is allowed."""

from __future__ import annotations

import io
import math
import warnings
import zipfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxir.io._files import require_file

LARGEST_ARRAYS = 2**30  # bytes of the arrays read from one file, with 8 bytes or more for each number
SINGLE = "array"  # name of the array of an NPY file
_LONGEST_HEADER = 10_000  # characters, as numpy's own limit


class _Header(NamedTuple):
    """What the first bytes of an array say."""

    shape: tuple[int, ...]
    fortran: bool
    dtype: np.dtype
    length: int

    @property
    def size(self) -> int:
        return math.prod(self.shape)

    @property
    def memory(self) -> int:
        return self.size * max(self.dtype.itemsize, 8)


def array_names(path: Path) -> list[str]:
    """Names of the arrays in a file; that of an NPY file is `SINGLE`.

    Raises:
        ValueError: as `load_arrays`.
    """
    with _named(path):
        if not _is_zip(path):
            return [SINGLE]
        with zipfile.ZipFile(path) as archive:
            return list(_members(archive))


def load_arrays(path: Path, names: Collection[str] | None = None) -> dict[str, np.ndarray]:
    """Arrays of an NPZ or NPY file by name.

    Args:
        path: the file.
        names: those to read; all by default.

    Returns:
        The arrays, of any type but objects.

    Raises:
        ValueError: no such file, not readable (cut, or not NPZ or NPY), objects, arrays larger than `LARGEST_ARRAYS`
            together; names file and array.
    """
    with _named(path):
        if not _is_zip(path):
            with path.open("rb") as stream:
                header = _header(SINGLE, stream, path.stat().st_size)
                _require_small([header])
                return {SINGLE: _data(stream, header)}
        with zipfile.ZipFile(path) as archive:
            members = _members(archive)
            wanted = {name: info for name, info in members.items() if names is None or name in names}
            found, headers = {}, []
            for name, info in members.items():  # all of them, which also compares the two places of each name
                with archive.open(info) as member:
                    header = _header(name, member, info.file_size)
                    if name in wanted:
                        headers.append(header)
            _require_small(headers)
            for name, info in wanted.items():
                with archive.open(info) as member:
                    found[name] = _data(member, _header(name, member, info.file_size))
            return found


@contextmanager
def _named(file: Path) -> Iterator[None]:
    """Every error of a block as one that names the file."""
    require_file(file)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # numpy warns of headers that it had to mend
            yield
    except Exception as error:  # zipfile's and numpy's readers raise whatever their parsers do
        said = str(error) if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"
        raise ValueError(f"{file}: not readable as NPZ or NPY ({said})") from error


def _is_zip(file: Path) -> bool:
    with file.open("rb") as stream:
        return stream.read(2) == b"PK"


def _members(archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    members: dict[str, zipfile.ZipInfo] = {}
    for info in archive.infolist():
        name = info.filename.removesuffix(".npy")
        if name == info.filename or name in members:
            raise ValueError(f"{info.filename}: got a member that is no array of its own, expected arrays")
        members[name] = info
    return members


def _header(name: str, stream: Any, size: int) -> _Header:
    """What an array's first bytes say, once it is sure that its other bytes are there and may be read."""
    start = stream.read(8)
    version = tuple(start[6:8])
    if start[:6] != b"\x93NUMPY" or version not in ((1, 0), (2, 0)):
        raise ValueError(f"{name}: got the first bytes {start!r}, expected those of an NPY array")
    start += stream.read(2 * version[0])
    length = int.from_bytes(start[8:], "little")
    if length > _LONGEST_HEADER:
        raise ValueError(f"{name}: got a header of {length} characters, expected at most {_LONGEST_HEADER}")
    start += stream.read(length)
    rest = io.BytesIO(start[8:])
    read = np.lib.format.read_array_header_1_0 if version[0] == 1 else np.lib.format.read_array_header_2_0
    header = _Header(*read(rest), len(start))
    if header.dtype.hasobject or header.dtype.itemsize == 0 or min(header.shape, default=1) < 0:
        raise ValueError(f"{name}: got {header.dtype} of shape {header.shape}, expected numbers or text")
    whole = header.length + header.size * header.dtype.itemsize
    if whole != size:
        raise ValueError(f"{name}: got {size} bytes, expected {whole} as its header says: the file is cut")
    return header


def _require_small(headers: list[_Header]) -> None:
    memory = sum(header.memory for header in headers)
    if memory > LARGEST_ARRAYS:
        raise ValueError(f"got arrays of {memory} bytes in memory, expected at most {LARGEST_ARRAYS}")


def _data(stream: Any, header: _Header) -> np.ndarray:
    raw = stream.read(header.size * header.dtype.itemsize)
    value = np.frombuffer(raw, header.dtype, header.size) if header.size else np.empty(0, header.dtype)
    return value.reshape(header.shape, order="F" if header.fortran else "C")
