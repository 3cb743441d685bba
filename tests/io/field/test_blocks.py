"""Cells that are hidden or another block's are left out, and blocks that do not fit are named."""

import numpy as np
import pytest
import pyvista

import jaxir
from jaxir.io.field import load_flow, load_surface_field


def row(low, high, marks=None, hidden=()):
    """A row of unit cubes along x at 500, those that are marked and the points that are hidden at 9000."""
    block = pyvista.ImageData(dimensions=(high - low + 1, 2, 2), origin=(low, 0, 0)).cast_to_structured_grid()
    block.cell_data["T"] = np.full(block.n_cells, 500.0)
    block.point_data["p"] = np.full(block.n_points, 500.0)
    if marks is not None:
        block.cell_data["vtkGhostType"] = np.array(marks, np.uint8)
        block.cell_data["T"][np.array(marks) > 0] = 9000.0
    if hidden:
        mark = np.isin(np.asarray(block.points)[:, 0], hidden)
        block.point_data["vtkGhostType"] = np.where(mark, 2, 0).astype(np.uint8)
        block.point_data["p"][mark] = np.nan
    return block


@pytest.mark.parametrize("unstructured", [False, True])
@pytest.mark.parametrize(("more", "field"), [({"marks": [0, 0, 32, 32]}, "T"), ({"hidden": [3, 4]}, "p")])
def test_hidden_cells_and_points_hold_no_flow(tmp_path, more, field, unstructured):
    block = row(0, 4, **more)
    path = tmp_path / ("flow.vtu" if unstructured else "flow.vts")
    (block.cast_to_unstructured_grid() if unstructured else block).save(path)
    flow = load_flow(path, {field: 300.0}, unit="m", shape=(4, 1, 1), box=[[0, 0, 0], [4, 1, 1]])
    np.testing.assert_allclose(flow.fields[field][:, 0, 0], [500, 500, 300, 300])
    assert flow.covered == 0.5 and flow.report[field].integral == pytest.approx(0, abs=1e-9)


def test_a_cell_that_two_blocks_hold_counts_once(tmp_path):
    pyvista.MultiBlock([row(0, 3, [0, 0, 1]), row(2, 4)]).save(tmp_path / "flow.vtm")
    flow = load_flow(tmp_path / "flow.vtm", {"T": 300.0}, unit="m", shape=(4, 1, 1))
    np.testing.assert_allclose(flow.fields["T"][:, 0, 0], 500)
    assert flow.report["T"].integral == pytest.approx(0, abs=1e-9)


def test_hidden_faces_are_no_surface(tmp_path):
    sheet = pyvista.Plane(i_resolution=2, j_resolution=1).triangulate()
    sheet.cell_data["T"] = np.where(sheet.cell_centers().points[:, 0] < 0, 500.0, 9000.0)
    sheet.cell_data["vtkGhostType"] = np.where(sheet["T"] > 500, 32, 0).astype(np.uint8)
    sheet.save(tmp_path / "skin.vtp")
    mesh = jaxir.Mesh(np.asarray(sheet.points), sheet.faces.reshape(-1, 4)[:, 1:])
    with pytest.warns(UserWarning, match="a point of the mesh lies 0.4.* m from the surface"):
        value = load_surface_field(tmp_path / "skin.vtp", mesh, "T", unit="m").value
    np.testing.assert_allclose(value, 500)


def test_blocks_that_do_not_fit_are_named(tmp_path):
    other, same = row(2, 4), row(0, 2)
    other.point_data["T"] = np.full(other.n_points, 500.0)
    del other.cell_data["T"]
    same.cell_data["T"][:] = 600.0
    for second, message in (
        (other, "flow.vtm: field 'T': got cell, point data by block, expected one kind in all"),
        (same, "flow.vtm: got the same cells in blocks 0 and 1, expected them once"),
    ):
        pyvista.MultiBlock([row(0, 2), second]).save(tmp_path / "flow.vtm")
        with pytest.raises(ValueError, match=message):
            load_flow(tmp_path / "flow.vtm", {"T": 300.0}, unit="m", shape=(4, 1, 1))
