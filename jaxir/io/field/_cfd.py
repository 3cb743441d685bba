"""Computed flow fields from files, through pyvista (optional extra `cfd`), resampled to a regular grid."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from jaxir.geometry import Grid
from jaxir.io.field._datasets import finite_scalar, read_dataset, require_pyvista
from jaxir.io.mesh import METRES

POINTS_AT_ONCE = 2_000_000


class FieldReport(NamedTuple):
    """What resampling did to one field, over the source's cells whose centres lie in the grid.

    Attributes:
        rms: root of the mean, weighted by volume, of the squared difference between source and grid.
        largest: largest difference.
        span: largest minus smallest value of the source; the two above are to be seen against it.
        integral: relative change of the integral of (field - value beyond the data) over the volume.
    """

    rms: float
    largest: float
    span: float
    integral: float


class FlowField(NamedTuple):
    """Fields on a grid.

    Attributes:
        grid: the cells [m].
        fields: each field [nx, ny, nz], mean over the samples of a cell.
        report: what resampling did to each field.
        covered: share of the samples that lie inside the source's cells.
    """

    grid: Grid
    fields: dict[str, np.ndarray]
    report: dict[str, FieldReport]
    covered: float

    def describe(self) -> str:
        """The report as text, one line per field."""
        lines = [f"{self.covered:.1%} of the grid lies inside the data"]
        for name, r in self.report.items():
            share = r.rms / r.span if r.span > 0 else 0.0
            rms = f"rms {r.rms:.3g} ({share:.2%} of its span)"
            lines.append(f"{name}: {rms}, largest {r.largest:.3g}, integral {r.integral:+.2%}")
        return "\n".join(lines)


def load_flow(
    path: str | os.PathLike,
    fields: Mapping[str, float],
    *,
    unit: str,
    shape: tuple[int, int, int],
    box: Any = None,
    time: float | None = None,
    samples: int = 2,
) -> FlowField:
    """Read a flow field and resample it to a grid.

    Point data are interpolated in their cells, cell data are constant in them. A grid cell holds the mean of
    samples^3 evenly spaced points.

    Args:
        path: VTK file (.vtk, .vti, .vtr, .vts, .vtu, .vtm), the .foam file of an OpenFOAM case, or any other volume
            format that pyvista reads.
        fields: names of the scalar fields to read, each with the value it takes beyond the data.
        unit: length unit of the coordinates: m, cm, mm, km, in or ft. There is no default: files do not say.
        shape: cells of the grid along x, y, z.
        box: two opposite corners of the grid [2, 3] [m]; the bounds of the data by default.
        time: of an OpenFOAM case or another file with several; the last by default.
        samples: per cell and axis.

    Returns:
        The fields with their grid and the report of the resampling error.

    Raises:
        ImportError: pyvista is not installed.
        ValueError: an unknown unit, no such file or time, an unreadable file, no volume cells, a field that is
            missing, not scalar or not finite, a box without volume or beside the data; the message names the file.
    """
    pyvista = require_pyvista()
    file = Path(path)
    if unit not in METRES:
        raise ValueError(f"unit: got {unit!r}, expected one of {', '.join(METRES)}")
    if not fields:
        raise ValueError(f"{file}: got no fields to read, expected names with the values beyond the data")
    if samples < 1:
        raise ValueError(f"samples: got {samples}, expected an integer >= 1")
    source = _volume(pyvista, file, read_dataset(pyvista, file, time))
    for name in fields:
        finite_scalar(file, source, name)
    metres = METRES[unit]
    bounds = np.asarray(source.bounds, float).reshape(3, 2).T * metres
    corners = bounds if box is None else np.asarray(box, float)
    if corners.shape != (2, 3) or not np.isfinite(corners).all():
        raise ValueError(f"box: got {box!r}, expected two corners of three finite coordinates")
    low, high = corners.min(axis=0), corners.max(axis=0)
    if (high <= low).any():
        raise ValueError(f"{file}: the box from {low} m to {high} m has no volume")
    if (bounds[1] < low).any() or (bounds[0] > high).any():
        raise ValueError(f"{file}: the box from {low} m to {high} m is beside the data, {bounds[0]} m to {bounds[1]} m")
    grid = Grid(low, (high - low) / np.maximum(shape, 1), shape)  # refuses a shape below 1
    sampled, covered = _resample(pyvista, source, dict(fields), low / metres, high / metres, grid.shape, samples)
    report = {
        name: _report(source, name, beyond, sampled[name], low / metres, high / metres)
        for name, beyond in fields.items()
    }
    return FlowField(grid, sampled, report, covered)


def _volume(pyvista: ModuleType, file: Path, data: Any) -> Any:
    """The volume cells of a data set: of an OpenFOAM case its internal mesh, of blocks all that are volumes."""
    if isinstance(data, pyvista.MultiBlock):
        if "internalMesh" in data.keys():
            data = data["internalMesh"]
        else:
            parts = [block for block in data.recursive_iterator(skip_none=True) if _has_volume(pyvista, block)]
            data = pyvista.MultiBlock(parts).combine() if parts else None
    if data is None or not _has_volume(pyvista, data):
        what = (
            "nothing" if data is None or data.n_cells == 0 else f"{type(data).__name__} with {data.n_cells} flat cells"
        )
        raise ValueError(f"{file}: holds no volume cells, found {what}")
    return data


def _has_volume(pyvista: ModuleType, data: Any) -> bool:
    if not isinstance(data, pyvista.DataSet) or isinstance(data, pyvista.PolyData) or data.n_cells == 0:
        return False
    return bool(np.abs(_cell_volumes(data)).sum() > 0)


def _cell_volumes(data: Any) -> np.ndarray:
    return np.abs(np.asarray(data.compute_cell_sizes(length=False, area=False, volume=True).cell_data["Volume"]))


def _resample(
    pyvista: ModuleType,
    source: Any,
    fields: dict[str, float],
    low: np.ndarray,
    high: np.ndarray,
    shape: tuple[int, int, int],
    samples: int,
) -> tuple[dict[str, np.ndarray], float]:
    """Mean of each field over every grid cell, and the share of samples inside the source; lengths in its unit."""
    # Where both point and cell data have a name, VTK's probe would mix them: cell data win.
    thin = source.copy(deep=False)
    thin.clear_data()
    for name in fields:
        where = "cell_data" if name in source.cell_data else "point_data"
        getattr(thin, where)[name] = np.asarray(getattr(source, where)[name], float)
    fine = tuple(n * samples for n in shape)
    axes = [low[a] + (np.arange(fine[a]) + 0.5) * (high[a] - low[a]) / fine[a] for a in range(3)]
    result = {name: np.empty(shape) for name in fields}
    inside = 0
    for first, last in _slabs(shape, samples):
        part = axes[0][first * samples : last * samples]
        points = np.stack(np.meshgrid(part, axes[1], axes[2], indexing="ij"), axis=-1)
        probed = pyvista.PolyData(points.reshape(-1, 3)).sample(thin)
        valid = np.asarray(probed["vtkValidPointMask"]) > 0
        inside += int(valid.sum())
        for name, beyond in fields.items():
            value = np.where(valid, np.asarray(probed[name]), beyond)
            blocks = value.reshape(last - first, samples, shape[1], samples, shape[2], samples)
            result[name][first:last] = blocks.mean(axis=(1, 3, 5))
    return result, inside / math.prod(fine)


def _slabs(shape: tuple[int, int, int], samples: int) -> Iterator[tuple[int, int]]:
    """Ranges of cells along x whose samples are probed at once."""
    step = max(1, POINTS_AT_ONCE // (shape[1] * shape[2] * samples**3))
    for first in range(0, shape[0], step):
        yield first, min(first + step, shape[0])


def _report(source: Any, name: str, beyond: float, value: np.ndarray, low: np.ndarray, high: np.ndarray) -> FieldReport:
    """Compare grid and source at the centres of the source's cells."""
    if name in source.cell_data:
        truth = np.asarray(source.cell_data[name], float)
    else:
        truth = np.asarray(source.point_data_to_cell_data().cell_data[name], float)
    volume, centre = _cell_volumes(source), np.asarray(source.cell_centers().points)
    spacing = (high - low) / value.shape
    index = np.floor((centre - low) / spacing).astype(int)
    within = ((index >= 0) & (index < value.shape)).all(axis=1)
    difference = value[tuple(index[within].T)] - truth[within]
    weight = volume[within]
    total = float(np.sum(weight * (truth[within] - beyond)))
    on_grid = float(np.sum(value - beyond) * np.prod(spacing))
    return FieldReport(
        rms=float(np.sqrt(np.sum(weight * difference**2) / np.sum(weight))) if weight.size else 0.0,
        largest=float(np.abs(difference).max(initial=0.0)),
        span=float(truth.max() - truth.min()),
        integral=(on_grid - total) / abs(total) if total != 0 else 0.0,
    )
