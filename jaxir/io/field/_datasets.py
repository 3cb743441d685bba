"""Computed data sets through pyvista (optional extra `cfd`), whole and consistent or refused."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from jaxir.io._files import largest_number, require_file
from jaxir.io.field._blocks import blocks
from jaxir.io.field._readers import open_reader

FARTHEST_POINT = 1e12  # coordinates in whatever unit the file has; 1e9 m, the farthest of a mesh, in mm
_READ = ".vtk, .vti, .vtr, .vts, .vtu, .vtp, .vtm, .pvd, .foam, .cgns, .case, .xdmf or another format of VTK"
# Points of a cell by its type in VTK; the types that are not here have as many as a cell likes.
_CORNERS = {1: 1, 3: 2, 5: 3, 8: 4, 9: 4, 10: 4, 11: 8, 12: 8, 13: 6, 14: 5, 15: 10, 16: 12}
_CORNERS |= {21: 3, 22: 6, 23: 8, 24: 10, 25: 20, 26: 15, 27: 13, 28: 9, 29: 27, 30: 6, 31: 12, 32: 18, 33: 24, 34: 7}


def require_pyvista() -> ModuleType:
    """pyvista, or the error that says how to install it."""
    try:
        import pyvista
    except ImportError as error:
        raise ImportError('reading computed fields needs pyvista: pip install "jaxir[cfd]"') from error
    return pyvista


def read_dataset(pyvista: ModuleType, file: Path, time: float | None) -> Any:
    """The data set in a file at a time; the last without one.

    Raises:
        ValueError: no such file or time, not readable, cells whose corners are no points, points that are not finite or
            too far; names the file.
    """
    require_file(file)
    if file.suffix == ".vtk":
        _require_version(file)
    with _named(pyvista, file):
        reader = open_reader(pyvista, file)
    if reader is None:
        raise ValueError(f"{file}: got a file {file.suffix or 'without extension'}, expected {_READ}")
    times = reader.times
    if time is not None and not any(math.isclose(time, known) for known in times):
        raise ValueError(f"{file}: time {time} not found, the file holds {times or 'no times'}")
    with _named(pyvista, file):
        last = times[-1] if times else None
        data = reader.read(last if time is None else min(times, key=lambda known: abs(known - time)))
    for block in blocks(pyvista, data):
        _require_consistent(pyvista, file, block)
    return data


def finite_scalar(file: Path, data: Any, name: str) -> np.ndarray:
    """A field with one finite number per cell or, if there is none of that name, per point.

    Raises:
        ValueError: no such field, one that is not scalar or not finite; names the file and the field.
    """
    found = {"point": list(data.point_data.keys()), "cell": list(data.cell_data.keys())}
    if name not in found["point"] and name not in found["cell"]:
        raise ValueError(
            f"{file}: field {name!r} not found, the file holds point data {found['point']} "
            f"and cell data {found['cell']}"
        )
    value = np.asarray(data.cell_data[name] if name in found["cell"] else data.point_data[name])
    if value.ndim != 1:
        raise ValueError(f"{file}: field {name!r} has {value.shape[1]} components, expected a scalar")
    if value.dtype.kind not in "biuf":
        raise ValueError(f"{file}: field {name!r} holds {value.dtype}, expected numbers")
    bad = np.flatnonzero(~(np.abs(value.astype(np.float64)) <= largest_number()))
    if bad.size:
        raise ValueError(f"{file}: field {name!r} is {value[bad[0]]} at entry {bad[0]}, expected finite values")
    return value


def _require_version(file: Path) -> None:
    """Raise `ValueError` for a legacy VTK file whose cells are not written as its version says: VTK would crash."""
    with file.open("rb") as stream:
        head = stream.readline(256).strip()
        version = re.fullmatch(rb"# vtk DataFile Version (\d)\.\d", head)
        offsets = any(line.startswith(b"OFFSETS ") for line in stream)
    if version is None or (offsets and version[1] < b"5"):
        raise ValueError(
            f"{file}:1: got {head[:60]!r}, expected the version of VTK's format in which the file is written"
        )


@contextmanager
def _named(pyvista: ModuleType, file: Path) -> Iterator[None]:
    """Every error of a block, those that VTK only logs included, as one that names the file, unless it does."""
    try:
        with (
            warnings.catch_warnings(),
            pyvista.vtk_verbosity("off"),
            pyvista.VtkErrorCatcher(raise_errors=True, send_to_logging=False),
        ):
            warnings.simplefilter("ignore")
            yield
    except Exception as error:  # readers raise whatever their parsers do
        if isinstance(error, ValueError) and str(error).startswith(f"{file}:"):
            raise
        said = " ".join(str(error).split())[:200]
        raise ValueError(f"{file}: not readable as a computed field ({type(error).__name__}: {said})") from error


def _require_consistent(pyvista: ModuleType, file: Path, data: Any) -> None:
    """Raise `ValueError` for points or cells on which VTK's filters would fail, by ending the process if need be."""
    points = np.asarray(data.points) if isinstance(data, pyvista.PointSet) else np.asarray(data.bounds)
    wrong = points[~(np.abs(points) < FARTHEST_POINT)]
    if wrong.size:
        raise ValueError(f"{file}: got a coordinate {wrong[0]}, expected finite ones below {FARTHEST_POINT:g}")
    if isinstance(data, pyvista.RectilinearGrid):
        for name, along in zip("xyz", (data.x, data.y, data.z), strict=True):
            if (np.diff(along) <= 0).any():
                raise ValueError(f"{file}: got coordinates along {name} that do not rise, expected each above the last")
    if isinstance(data, pyvista.UnstructuredGrid) and data.n_cells:
        corners = _require_corners(pyvista, file, data.GetCells(), data.n_points)
        kinds = np.asarray(data.celltypes)
        unknown = sorted(set(kinds.tolist()) - {int(kind) for kind in pyvista.CellType})
        if unknown:
            raise ValueError(f"{file}: got cells of type {unknown[0]}, expected types that VTK knows")
        wanted = np.array([_CORNERS.get(kind, -1) for kind in range(256)])[kinds]
        wrong = np.flatnonzero((wanted >= 0) & (wanted != corners)) if kinds.size == corners.size else np.array([0])
        if wrong.size:
            raise ValueError(f"{file}: cell {wrong[0]}: got corners of another number, expected those of its type")
    if isinstance(data, pyvista.PolyData):
        for cells in (data.GetVerts(), data.GetLines(), data.GetPolys(), data.GetStrips()):
            _require_corners(pyvista, file, cells, data.n_points)
    for held, count in ((data.point_data, data.n_points), (data.cell_data, data.n_cells)):
        for name in held.keys():
            if len(held[name]) != count:
                raise ValueError(f"{file}: field {name!r}: got {len(held[name])} values, expected {count}")


def _require_corners(pyvista: ModuleType, file: Path, cells: Any, count: int) -> np.ndarray:
    """Numbers of corners of the cells, all of which are points."""
    offset = np.asarray(pyvista.convert_array(cells.GetOffsetsArray()), np.int64)
    corner = np.asarray(pyvista.convert_array(cells.GetConnectivityArray()), np.int64)
    if offset.size == 0:
        return np.zeros(0, np.int64)
    each = np.diff(offset)
    if offset[0] != 0 or (each < 0).any() or offset[-1] != corner.size:
        raise ValueError(f"{file}: got cells that do not follow one another, expected offsets that rise from 0")
    wrong = np.flatnonzero((corner < 0) | (corner >= count))
    if wrong.size:
        cell = int(np.searchsorted(offset, wrong[0], side="right")) - 1
        raise ValueError(f"{file}: cell {cell}: got point {corner[wrong[0]]}, expected one of 0 to {count - 1}")
    return each
