"""Values of faces as coloured PLY."""

import numpy as np
import pytest
import trimesh

from jaxir.io.result import save_face_values
from tests.scenes import box_mesh


def test_values_of_faces_are_read_back_with_their_colours(tmp_path):
    mesh, path = box_mesh((1.0, 2.0, 3.0)), tmp_path / "map.ply"
    value = np.linspace(-2.0, 4.0, 12)
    save_face_values(path, mesh, value, name="dI/d(emissivity)", unit="W/sr")
    assert b"comment value: dI/d(emissivity) [W/sr]" in path.read_bytes()
    assert b"blue -4, white 0, red 4 W/sr" in path.read_bytes()
    read = trimesh.load(path, process=False)
    np.testing.assert_array_equal(read.faces, mesh.faces)
    np.testing.assert_allclose(read.vertices, mesh.vertices, rtol=1e-6)
    stored = read.metadata["_ply_raw"]["face"]["data"]
    np.testing.assert_allclose(np.ravel(stored["value"]), value, rtol=1e-6)
    np.testing.assert_array_equal(read.visual.face_colors[-1, :3], [178, 24, 43])  # red where largest
    assert read.visual.face_colors[0, 2] > read.visual.face_colors[0, 0]  # blue where negative


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("map.stl", np.ones(12), "map.stl: expected a file name that ends in .ply"),
        ("map.ply", np.ones(11), r"value: got shape \(11,\), expected 12 finite numbers"),
        ("map.ply", np.full(12, np.nan), "expected 12 finite numbers"),
        ("no/map.ply", np.ones(12), "does not exist"),
    ],
)
def test_values_of_faces_that_cannot_be_written_are_named(name, value, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        save_face_values(tmp_path / name, box_mesh(), value, name="x", unit="1")
    assert not list(tmp_path.iterdir())
