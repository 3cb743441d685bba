"""Computed flow fields from files, through pyvista (optional extra `cfd`), resampled to a regular grid."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from jaxir.geometry import Grid
from jaxir.io._axes import Axes, metres
from jaxir.io.field._blocks import blocks, joined, present
from jaxir.io.field._datasets import finite_scalar, read_dataset, require_pyvista
from jaxir.io.field._fractions import mole_fractions
from jaxir.io.field._revolution import Revolution, revolution

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
    unit: Any,
    shape: tuple[int, int, int],
    box: Any = None,
    time: float | None = None,
    samples: int = 2,
    axes: Axes | None = None,
    axisymmetric: str | None = None,
    molar_masses: Mapping[str, float] | None = None,
) -> FlowField:
    """Read a flow field and resample it to a grid.

    Point data are interpolated in their cells, cell data are constant in them. A grid cell holds the mean of
    samples^3 evenly spaced points. Cells that VTK's marks hide, or tell to be another block's, are left out. An
    axisymmetric solution, a half plane or a wedge, is spread around its axis; of a wedge its middle plane counts.

    Args:
        path: VTK file (.vtk, .vti, .vtr, .vts, .vtu, .vtm), the .foam file of an OpenFOAM case, or any other volume
            format that pyvista reads.
        fields: names of the scalar fields to read, each with the value it takes beyond the data; of a species that is
            a mole fraction.
        unit: length unit of the coordinates: m, cm, mm, km, in, ft, or its metres. There is no default: files do not
            say.
        shape: cells of the grid along x, y, z of the body axes.
        box: two opposite corners of the grid in the body axes [2, 3] [m]; the bounds of the data by default.
        time: of an OpenFOAM case or another file with several; the last by default.
        samples: per cell and axis.
        axes: where the body axes are in the file; those of the file by default.
        axisymmetric: "x", "y" or "z": the axis of the file, through its origin, around which the solution is spread.
        molar_masses: of all species, where the file holds their mass fractions; in any one unit. Those of `fields`
            become mole fractions. A species that the file does not hold is the rest: {"H2O": 18, "CO2": 44, "N2": 28}.

    Returns:
        The fields with their grid and the report of the resampling error.

    Raises:
        ImportError: pyvista is not installed.
        ValueError: an unknown unit, no such file or time, an unreadable file, no volume cells, two blocks with the same
            cells, a field that is missing, of another kind by block, not scalar or not finite, a box without volume or
            beside the data, an axisymmetric solution on both sides of its axis, mass fractions whose sum is not 1; the
            message names the file.
    """
    pyvista = require_pyvista()
    file = Path(path)
    length, placed = metres(unit), axes or Axes()
    if not fields:
        raise ValueError(f"{file}: got no fields to read, expected names with the values beyond the data")
    if samples < 1:
        raise ValueError(f"samples: got {samples}, expected an integer >= 1")
    names = [*fields, *(molar_masses or ())]
    data = _cells(pyvista, file, read_dataset(pyvista, file, time), names, flat=axisymmetric is not None)
    source = _with_fields(file, data, fields, molar_masses)
    around = None if axisymmetric is None else revolution(file, np.asarray(data.points, float), axisymmetric)
    ends = np.asarray(source.bounds, float).reshape(3, 2)
    held = np.stack(np.meshgrid(*ends), axis=-1).reshape(-1, 3) if around is None else around.bounds(source.points)
    outline = placed.to_body(held, length)
    bounds = np.stack([outline.min(axis=0), outline.max(axis=0)])
    corners = bounds if box is None else np.asarray(box, float)
    if corners.shape != (2, 3) or not np.isfinite(corners).all():
        raise ValueError(f"box: got {box!r}, expected two corners of three finite coordinates")
    low, high = corners.min(axis=0), corners.max(axis=0)
    if (high <= low).any():
        raise ValueError(f"{file}: the box from {low} m to {high} m has no volume")
    if (bounds[1] < low).any() or (bounds[0] > high).any():
        raise ValueError(f"{file}: the box from {low} m to {high} m is beside the data, {bounds[0]} m to {bounds[1]} m")
    grid = Grid(low, (high - low) / np.maximum(shape, 1), shape)  # refuses a shape below 1

    def in_file(points: np.ndarray) -> np.ndarray:
        own = placed.to_file(points, length)
        return own if around is None else around.folded(own)

    sampled, covered = _resample(pyvista, source, dict(fields), in_file, low, high, grid.shape, samples)
    if covered == 0:
        raise ValueError(f"{file}: no cell of the data holds a point of the grid from {low} m to {high} m")
    volume, centre = _rings(source, around)
    cells = length**3 * volume, placed.to_body(centre, length), low, high
    report = {name: _report(_of_cells(source, name), beyond, sampled[name], *cells) for name, beyond in fields.items()}
    return FlowField(grid, sampled, report, covered)


def _with_fields(file: Path, data: Any, fields: Mapping[str, float], molar_masses: Mapping[str, float] | None) -> Any:
    """The cells with the fields asked for and nothing else, mass fractions as mole fractions.

    Where both point and cell data have a name, VTK's probe would mix them: cell data win.
    """
    held = {*data.point_data.keys(), *data.cell_data.keys()}
    species = [name for name in molar_masses or () if name in held]
    value = {name: finite_scalar(file, data, name).astype(float) for name in dict.fromkeys([*fields, *species])}
    if molar_masses is not None:
        if len({value[name].size for name in species}) > 1:
            raise ValueError(f"{file}: {', '.join(species)} are point and cell data, expected one kind")
        value |= mole_fractions(file, {name: value[name] for name in species}, molar_masses)
    thin = data.copy(deep=False)
    thin.clear_data()
    for name in fields:
        (thin.cell_data if name in data.cell_data else thin.point_data)[name] = value[name]
    return thin


def _cells(pyvista: ModuleType, file: Path, data: Any, names: Iterable[str], flat: bool) -> Any:
    """The volume cells of a data set, or the flat ones of a plane if there are none and `flat`.

    Of an OpenFOAM case its internal mesh, of blocks all that have such cells; hidden and duplicate cells are none.
    """
    inner = data["internalMesh"] if isinstance(data, pyvista.MultiBlock) and "internalMesh" in data.keys() else data
    held = [present(block) for block in blocks(pyvista, inner) if block.n_cells]
    for size in ("Volume", "Area")[: 1 + flat]:
        if parts := [block for block in held if block.n_cells and (_sizes(block, size) > 0).any()]:
            return joined(pyvista, file, parts, names)
    flat_cells = sum(block.n_cells for block in held)
    what = f"{type(data).__name__} with {flat_cells} flat cells" if flat_cells else "nothing"
    raise ValueError(f"{file}: holds no volume cells, found {what}")


def _sizes(data: Any, size: str) -> np.ndarray:
    """The size of every cell, its `Volume` or its `Area`."""
    every = data.compute_cell_sizes(length=False, area=size == "Area", volume=size == "Volume")
    return np.abs(np.asarray(every.cell_data[size]))


def _rings(source: Any, around: Revolution | None) -> tuple[np.ndarray, np.ndarray]:
    """Volumes for which cells stand [cell] and their centres [cell, 3], in the file's unit."""
    centre = np.asarray(source.cell_centers().points, float)
    if around is None:
        return _sizes(source, "Volume"), centre
    return around.volumes(_sizes(source, "Volume" if around.angle else "Area"), centre), centre


def _resample(
    pyvista: ModuleType,
    source: Any,
    fields: dict[str, float],
    in_file: Callable[[np.ndarray], np.ndarray],
    low: np.ndarray,
    high: np.ndarray,
    shape: tuple[int, int, int],
    samples: int,
) -> tuple[dict[str, np.ndarray], float]:
    """Mean of each field over every grid cell, and the share of samples inside the source."""
    fine = tuple(n * samples for n in shape)
    axes = [low[a] + (np.arange(fine[a]) + 0.5) * (high[a] - low[a]) / fine[a] for a in range(3)]
    result = {name: np.empty(shape) for name in fields}
    inside = 0
    for first, last in _slabs(shape, samples):
        part = axes[0][first * samples : last * samples]
        points = np.stack(np.meshgrid(part, axes[1], axes[2], indexing="ij"), axis=-1)
        probed = pyvista.PolyData(in_file(points.reshape(-1, 3))).sample(source)
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


def _of_cells(source: Any, name: str) -> np.ndarray:
    """A field's values at the centres of the cells."""
    held = source if name in source.cell_data else source.point_data_to_cell_data()
    return np.asarray(held.cell_data[name], float)


def _report(
    truth: np.ndarray,
    beyond: float,
    value: np.ndarray,
    volume: np.ndarray,
    centre: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> FieldReport:
    """Compare grid and source at the centres of the source's cells."""
    if (solid := volume > 0).any():  # faces may lie among the cells
        truth, volume, centre = truth[solid], volume[solid], centre[solid]
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
