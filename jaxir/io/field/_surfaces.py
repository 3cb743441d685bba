"""Values per face from computed surfaces (optional extra `cfd`), transferred to the mesh by area."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from jaxir.geometry.search import Mesh
from jaxir.io._axes import Axes, metres
from jaxir.io.field._blocks import blocks, joined, present
from jaxir.io.field._datasets import finite_scalar, read_dataset, require_pyvista

FARTHEST = 0.1  # of the mesh's size, as a distance: a surface whose median is farther is that of another body or unit
_CORNERS = np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4], [2, 2, 2]]) / 6  # centroids of the four quarters of a triangle


class TransferReport(NamedTuple):
    """How the surface and the mesh lie to one another, and what the transfer did to the field.

    Attributes:
        median: distance from the mesh's points to the surface [m].
        largest: likewise [m].
        surface_mean: mean of the field over the surface's area.
        mesh_mean: mean of the field over the mesh's area.
    """

    median: float
    largest: float
    surface_mean: float
    mesh_mean: float


class SurfaceField(NamedTuple):
    """A field on the faces of a mesh.

    Attributes:
        value: mean over each face [face].
        report: what the transfer did.
    """

    value: np.ndarray
    report: TransferReport

    def describe(self) -> str:
        """The report as text."""
        r = self.report
        return (
            f"mesh to surface: median {r.median:.3g} m, largest {r.largest:.3g} m; "
            f"mean over the area {r.surface_mean:.6g} on the surface, {r.mesh_mean:.6g} on the mesh"
        )


def load_surface_field(
    path: str | os.PathLike,
    mesh: Mesh,
    field: str,
    *,
    unit: Any,
    time: float | None = None,
    axes: Axes | None = None,
) -> SurfaceField:
    """Read a field of a computed surface and transfer it to the faces of a mesh.

    Every face is cut into four of equal area; each takes the value at the point of the surface that is nearest to its
    centroid, point data linear between the corners of a triangle, cell data constant in it. The face's value is the
    mean of its four. This neither smooths nor conserves the integral: the report tells both means. Where a point of the
    mesh is far from the surface, by a tenth of the mesh's size, that is warned of.

    Args:
        path: VTK file (.vtp, .vtu, .vtk, .vtm), the .foam file of an OpenFOAM case (its walls), or any other format
            that pyvista reads.
        mesh: the faces.
        field: name of the scalar field.
        unit: length unit of the file's coordinates: m, cm, mm, km, in, ft, or its metres.
        time: of a file with several; the last by default.
        axes: where the body axes, those of the mesh, are in the file; those of the file by default.

    Returns:
        The field on the faces, with the report.

    Raises:
        ImportError: pyvista is not installed.
        ValueError: an unknown unit, no such file or time, an unreadable file, no faces, two blocks with the same, a
            field that is missing, of another kind by block, not scalar or not finite, a surface that is not that of the
            mesh; the message names the file.
    """
    pyvista = require_pyvista()
    file = Path(path)
    length, placed = metres(unit), axes or Axes()
    surface = _triangles(pyvista, file, read_dataset(pyvista, file, time), field)
    surface.points = placed.to_body(np.asarray(surface.points, np.float64), length)
    corners = np.asarray(mesh.corners(), np.float64)
    points = np.einsum("qc,fcx->fqx", _CORNERS, corners)
    value, distance = _nearest(surface, field, points.reshape(-1, 3))
    size = float(np.linalg.norm(np.ptp(corners.reshape(-1, 3), axis=0)))
    if not np.median(distance) <= FARTHEST * size:
        raise ValueError(
            f"{file}: the mesh lies {np.median(distance):.3g} m (median) from the surface and is {size:.3g} m large, "
            f"expected the same body; is the unit {unit!r} right?"
        )
    if distance.max() > FARTHEST * size:
        warnings.warn(
            f"{file}: a point of the mesh lies {distance.max():.3g} m from the surface, of a body {size:.3g} m large; "
            "is a part missing, or the surface turned or shifted?",
            stacklevel=2,
        )
    per_face = value.reshape(len(corners), -1).mean(axis=1)
    area = np.linalg.norm(np.asarray(mesh.area_vectors(), np.float64), axis=1)
    report = TransferReport(
        float(np.median(distance)),
        float(distance.max()),
        _surface_mean(surface, field),
        np.average(per_face, weights=area),
    )
    return SurfaceField(per_face, report)


def _triangles(pyvista: ModuleType, file: Path, data: Any, field: str) -> Any:
    """The faces of a data set as triangles that carry the field; of an OpenFOAM case its boundary."""
    if isinstance(data, pyvista.MultiBlock):
        if "boundary" in data.keys() and data["boundary"] is not None:
            data = data["boundary"]
    surfaces = [_surface(pyvista, block) for block in blocks(pyvista, data) if block.n_cells]
    parts = [part for part in map(present, surfaces) if part.n_cells]
    if not parts:
        raise ValueError(f"{file}: holds no faces")
    data = _surface(pyvista, joined(pyvista, file, parts, [field]))
    if first := data.n_verts + data.n_lines:  # cells of these come before the faces
        faces = data.extract_cells(np.arange(first, data.n_cells))
        data = _surface(pyvista, faces)
    if data.n_cells == 0:
        raise ValueError(f"{file}: holds no faces")
    value = finite_scalar(file, data, field)
    where = "cell_data" if field in data.cell_data else "point_data"
    thin = data.copy(deep=True)
    thin.clear_data()
    getattr(thin, where)[field] = value.astype(np.float64)
    triangles = thin.triangulate()
    if triangles.n_cells == 0:
        raise ValueError(f"{file}: holds no faces")
    return triangles


def _surface(pyvista: ModuleType, data: Any) -> Any:
    return data if isinstance(data, pyvista.PolyData) else data.extract_surface(algorithm="dataset_surface")


def _nearest(surface: Any, field: str, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Value and distance of the surface's point nearest to each of `points`."""
    cell, near = surface.find_closest_cell(points, return_closest_point=True)
    distance = np.linalg.norm(near - points, axis=1)
    if field in surface.cell_data:
        return np.asarray(surface.cell_data[field])[cell], distance
    corner = surface.faces.reshape(-1, 4)[cell, 1:]
    a, b, c = np.moveaxis(np.asarray(surface.points)[corner], 1, 0)
    weights = _barycentric(near, a, b, c)
    return np.sum(weights * np.asarray(surface.point_data[field])[corner], axis=1), distance


def _barycentric(point: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Weights of the corners at points of triangles [point, 3]; a third each in a triangle without area."""
    normal = np.cross(b - a, c - a)
    square = np.sum(normal * normal, axis=1)
    flat = square <= 0
    safe = np.where(flat, 1, square)
    of_b = np.sum(np.cross(point - a, c - a) * normal, axis=1) / safe
    of_c = np.sum(np.cross(b - a, point - a) * normal, axis=1) / safe
    weights = np.clip(np.stack([1 - of_b - of_c, of_b, of_c], axis=1), 0, 1)
    weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1e-300)
    return np.where(flat[:, None], 1 / 3, weights)


def _surface_mean(surface: Any, field: str) -> float:
    area = np.abs(np.asarray(surface.compute_cell_sizes(length=False, volume=False).cell_data["Area"]))
    if field in surface.cell_data:
        value = np.asarray(surface.cell_data[field])
    else:
        value = np.asarray(surface.point_data[field])[surface.faces.reshape(-1, 4)[:, 1:]].mean(axis=1)
    return float(np.average(value, weights=area))
