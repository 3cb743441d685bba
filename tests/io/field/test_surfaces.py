"""Temperatures from a computed surface: a linear field comes through, another unit or field is named."""

import numpy as np
import pytest
import pyvista

import jaxir
from jaxir.io.field import load_surface_field


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A sphere of 1000 mm with a field linear in x, per point and per cell, and broken ones."""
    folder = tmp_path_factory.mktemp("surface")
    sphere = pyvista.Sphere(radius=1000.0, theta_resolution=60, phi_resolution=60)
    sphere.point_data["T"] = 300 + 0.05 * np.asarray(sphere.points)[:, 0]
    sphere.cell_data["T_cell"] = 300 + 0.05 * np.asarray(sphere.cell_centers().points)[:, 0]
    sphere.cell_data["flux"] = np.zeros((sphere.n_cells, 3))
    sphere.save(folder / "s.vtp")
    sphere.cast_to_unstructured_grid().save(folder / "s.vtu")
    edges = pyvista.PolyData(sphere.points, faces=sphere.faces, lines=[2, 0, 5, 3, 7, 8, 9], verts=[1, 4])
    edges.point_data["T"], edges.cell_data["T_cell"] = sphere.point_data["T"], np.r_[[9e3] * 3, sphere["T_cell"]]
    edges.save(folder / "edges.vtp")
    edges.cast_to_unstructured_grid().save(folder / "edges.vtu")
    pyvista.MultiBlock([sphere.clip("x"), sphere.clip("x", invert=False)]).save(folder / "s.vtm")
    sphere.point_data["T"][7] = np.nan
    sphere.save(folder / "nan.vtp")
    (folder / "cut.vtp").write_bytes((folder / "s.vtp").read_bytes()[:3000])
    return folder


@pytest.fixture(scope="module")
def mesh():
    coarse = pyvista.Sphere(radius=1.0, theta_resolution=20, phi_resolution=20)
    return jaxir.Mesh(np.asarray(coarse.points), coarse.faces.reshape(-1, 4)[:, 1:])


NAMES = [("s.vtp", "T"), ("s.vtu", "T"), ("s.vtm", "T"), ("s.vtp", "T_cell")]
NAMES += [(f"edges.{end}", field) for end in ("vtp", "vtu") for field in ("T", "T_cell")]  # with lines and points


@pytest.mark.parametrize(("name", "field"), NAMES)
def test_a_linear_field_comes_through(name, field, files, mesh):
    held = load_surface_field(files / name, mesh, field, unit="mm")
    x = np.asarray(mesh.corners()).mean(1)[:, 0]
    # nearest points of the sphere lie up to 1 / cos(9 degrees) = 1.2 % further out, and cells are 0.1 m wide
    assert np.abs(held.value - (300 + 50 * x)).max() < (0.7 if field == "T" else 3.0)
    assert held.report.mesh_mean == pytest.approx(300, abs=0.1) and held.report.surface_mean == pytest.approx(
        300, abs=0.1
    )
    assert held.report.largest < 0.015 and "mesh to surface: median 0.00" in held.describe()


def test_what_is_wrong_with_a_surface_is_named(files, mesh):
    for name, field, unit, message in (
        ("s.vtp", "T", "m", "s.vtp: the mesh lies .* expected the same body; is the unit 'm' right"),
        ("s.vtp", "T", "furlong", "unit: got 'furlong'"),
        ("s.vtp", "U", "mm", "s.vtp: field 'U' not found, the file holds point data"),
        ("s.vtp", "flux", "mm", "s.vtp: field 'flux' has 3 components, expected a scalar"),
        ("nan.vtp", "T", "mm", "nan.vtp: field 'T' is nan at entry 7"),
        ("none.vtp", "T", "mm", "none.vtp: no such file"),
        ("cut.vtp", "T", "mm", "cut.vtp: "),
    ):
        with pytest.raises(ValueError, match=message):
            load_surface_field(files / name, mesh, field, unit=unit)


def test_a_surface_that_lies_elsewhere_in_part_is_said(files, mesh):
    vertices = np.array(mesh.vertices)
    vertices[vertices[:, 2] > 0.9] *= 2
    moved = jaxir.Mesh(vertices, np.asarray(mesh.faces))
    with pytest.warns(UserWarning, match="s.vtp: a point of the mesh lies 0.9.* m from the surface, of a body"):
        load_surface_field(files / "s.vtp", moved, "T", unit="mm")
