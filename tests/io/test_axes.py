"""Any file lies where its axes say: meshes, flows and surfaces alike."""

import numpy as np
import pytest
import pyvista
import trimesh

from jaxir.io.field import load_flow, load_surface_field
from jaxir.io.mesh import Axes, load_mesh
from jaxir.io.scene_file import load_scene
from tests.scenes import box_mesh

# a file in mm with z to the nose, y up and hence x to the left wing
AXES = Axes(nose="+z", up="+y", offset=(10.0, 0.0, -1.0))


def in_body(point):
    x, y, z = np.moveaxis(1e-3 * np.asarray(point, float), -1, 0)
    return np.stack([z + 10.0, x, y - 1.0], axis=-1)


def saved_box(folder):
    mesh = box_mesh((1.0, 2.0, 3.0))
    trimesh.Trimesh(1000 * np.asarray(mesh.vertices), np.asarray(mesh.faces), process=False).export(folder / "box.ply")
    return folder / "box.ply"


def test_a_mesh_is_turned_scaled_and_moved(tmp_path):
    path = saved_box(tmp_path)
    file, body = load_mesh(path, unit=1.0).mesh, load_mesh(path, unit="mm", axes=AXES).mesh
    np.testing.assert_allclose(body.vertices, in_body(file.vertices), rtol=1e-6)
    np.testing.assert_array_equal(body.faces, file.faces)
    assert body.closed  # outward stays outward
    np.testing.assert_array_equal(load_mesh(path, unit=0.001, axes=AXES).mesh.vertices, body.vertices)


def test_directions_are_names_or_numbers_and_make_a_rotation():
    np.testing.assert_array_equal(Axes().rotation, np.eye(3))
    np.testing.assert_array_equal(Axes("-x", "z").rotation, np.diag([-1, -1, 1]))
    for nose, up in (("+y", "-z"), ("-z", "+x"), ((1.0, 2.0, -0.5), (0.0, 1.0, 3.0))):
        axes = Axes(nose, up, (1.0, 2.0, 3.0))
        np.testing.assert_allclose(axes.rotation @ axes.rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(axes.rotation) == pytest.approx(1)
        points = np.random.default_rng(0).normal(size=(5, 3))
        np.testing.assert_allclose(axes.to_file(axes.to_body(points, 0.3), 0.3), points, rtol=1e-12)
    pitched = Axes((np.cos(0.1), 0.0, np.sin(0.1)), "z")  # up is across the nose
    np.testing.assert_allclose(pitched.rotation[2], [-np.sin(0.1), 0, np.cos(0.1)], atol=1e-12)


def test_a_flow_and_a_surface_lie_as_the_mesh_does(tmp_path):
    data = pyvista.ImageData(dimensions=(5, 7, 9), spacing=(500.0, 250.0, 1000.0), origin=(-1000.0, 0.0, 0.0))

    def temperature(body):
        return 300 + 10 * body[..., 0] - 40 * body[..., 1] + 70 * body[..., 2]

    data.point_data["T"] = temperature(in_body(data.points))
    data.save(tmp_path / "flow.vti")
    flow = load_flow(tmp_path / "flow.vti", {"T": 300.0}, unit="mm", shape=(8, 4, 6), axes=AXES)
    np.testing.assert_allclose(flow.grid.origin, [10.0, -1.0, -1.0], atol=1e-6)
    np.testing.assert_allclose(flow.grid.spacing, [1.0, 0.5, 0.25], rtol=1e-6)
    np.testing.assert_allclose(flow.fields["T"], temperature(np.asarray(flow.grid.centres())), rtol=1e-5)
    assert flow.covered == 1 and flow.report["T"].rms < 1e-4 and abs(flow.report["T"].integral) < 1e-6
    path = saved_box(tmp_path)
    mesh = load_mesh(path, unit="mm", axes=AXES).mesh
    skin = pyvista.read(path).triangulate()
    skin.point_data["T"] = temperature(in_body(skin.points))
    skin.save(tmp_path / "skin.vtp")
    found = load_surface_field(tmp_path / "skin.vtp", mesh, "T", unit="mm", axes=AXES)
    np.testing.assert_allclose(found.value, temperature(np.asarray(mesh.corners()).mean(axis=1)), rtol=1e-5)


def test_a_scene_file_takes_axes_and_says_where_things_lie_and_how_large_they_are_seen(tmp_path):
    saved_box(tmp_path)
    text = """
bands = ["MWIR"]
[skin]
mesh = { path = "box.ply", unit = "mm", axes = { nose = "+z", up = [0, 2, 0], offset = [10, 0, -1] } }
temperature = 300
brdf = { type = "Lambert", emissivity = 0.8 }
[[skin.parts]]
name = "hot"
faces = [0]
temperature = 400
[camera]
type = "orthographic_camera"
azimuth = 90
elevation = 0
pixel = 0.05
shape = [40, 40]
"""
    (tmp_path / "scene.toml").write_text(text)
    read = load_scene(tmp_path / "scene.toml")
    mesh = load_mesh(tmp_path / "box.ply", unit="mm", axes=AXES).mesh
    np.testing.assert_allclose(read.scene.skin.mesh.vertices, mesh.vertices, rtol=1e-6)
    said = read.describe()
    assert "skin: 12 faces, 3 x 1 x 2 m, closed, x 8.5 to 11.5, y -0.5 to 0.5, z -2 to 0 m" in said
    assert "\n  skin: 40 x 60 pixels, beyond the frame\n" in said and "\n  part hot: " in said
    (tmp_path / "scene.toml").write_text(text.replace("+z", "ahead"))
    with pytest.raises(ValueError, match=r"skin.mesh.axes: nose: got 'ahead', expected \+x, -x"):
        load_scene(tmp_path / "scene.toml")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"nose": "w"}, "nose: got 'w', expected"),
        ({"up": (0.0, 0.0, 0.0)}, "up: got .* expected .* three numbers, not all 0"),
        ({"nose": "+z"}, r"up: got '\+z' along the nose, '\+z'"),
        ({"offset": 1.0}, "offset: got 1.0, expected three finite numbers in m"),
        ({"offset": (0.0, 0.0, np.nan)}, "offset: got .*nan"),
    ],
)
def test_wrong_axes_are_named(given, message):
    with pytest.raises(ValueError, match=message):
        Axes(**given)


@pytest.mark.parametrize("unit", ["parsec", 0.0, -1.0, np.inf, None, True])
def test_a_unit_is_a_name_or_metres(unit):
    with pytest.raises(ValueError, match="unit: got .* expected one of m, cm, .*, or the unit's metres"):
        load_mesh("any.stl", unit=unit)
