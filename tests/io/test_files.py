"""Meshes in, results out: every format read back, every damaged file named, nothing half written."""

import numpy as np
import pytest
import trimesh

import jaxir
from jaxir.io.mesh import load_mesh
from jaxir.io.result import save_face_values, save_image, save_signature, save_tiff
from tests.scenes import box_mesh, plate


def _trimesh(mesh):
    return trimesh.Trimesh(np.asarray(mesh.vertices), np.asarray(mesh.faces), process=False)


@pytest.fixture(scope="module")
def image():
    scene = jaxir.Scene(plate())
    return jaxir.render(scene, jaxir.orthographic_camera(0.0, 0.0, 0.1, (12, 16)), (jaxir.MWIR, jaxir.LWIR), samples=2)


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "glb"])
@pytest.mark.parametrize(("unit", "scale"), [("m", 1.0), ("mm", 1e-3), ("in", 0.0254)])
def test_mesh_files_keep_their_faces_in_order(suffix, unit, scale, tmp_path):
    mesh = box_mesh((1.0, 2.0, 3.0))
    path = tmp_path / f"box.{suffix}"
    _trimesh(mesh).export(path)
    body = load_mesh(path, unit=unit)
    assert body.mesh.count == 12
    np.testing.assert_allclose(body.mesh.corners(), np.asarray(mesh.corners()) * scale, rtol=1e-6)
    assert (body.part == 0).all() and len(body.part_names) == 1


def test_objects_of_a_scene_become_parts(tmp_path):
    path = tmp_path / "two.glb"
    scene = trimesh.Scene()
    scene.add_geometry(_trimesh(box_mesh()), node_name="body", geom_name="body")
    moved = np.eye(4)
    moved[0, 3] = 5.0
    scene.add_geometry(_trimesh(box_mesh()), node_name="tail", geom_name="tail", transform=moved)
    scene.export(path)
    body = load_mesh(path, unit="m")
    assert body.mesh.count == 24 and set(body.part_names) == {"body", "tail"}
    tail = np.asarray(body.mesh.corners())[body.part == body.part_names.index("tail")]
    np.testing.assert_allclose(tail.mean((0, 1)), [5.0, 0.0, 0.0], atol=1e-6)


def test_zero_area_faces_are_named(tmp_path):
    mesh = trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0]], [[0, 1, 2], [0, 1, 3], [1, 1, 2]], process=False
    )
    path = tmp_path / "flat.ply"
    mesh.export(path)
    with pytest.warns(UserWarning, match=r"flat.ply: 2 faces have zero area and are never hit: 1, 2"):
        assert load_mesh(path, unit="m").mesh.count == 3


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("none.stl", None, "none.stl: no such file"),
        ("empty.obj", b"", "empty.obj: "),
        ("noise.ply", b"ply\nformat ascii 1.0\nelement vertex 3\n", "noise.ply: "),
        ("noise.glb", bytes(range(40)), "noise.glb: not readable as a mesh"),
        ("cut.stl", bytes(80) + b"\x05\x00\x00\x00" + bytes(50), "cut.stl: got 134 bytes, expected 334 .* is cut"),
        ("text.stl", b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n", "text.stl: got no endsolid"),
        ("points.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "points.obj: "),
        ("nan.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "nan.obj: vertex 0 is .* expected finite"),
        ("flat.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "flat.obj: all 1 faces have zero area"),
        ("what.xyz2", b"v", "what.xyz2: not readable"),
    ],
)
def test_damaged_meshes_are_named(name, content, message, tmp_path):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ValueError, match=message):
        load_mesh(path, unit="m")


def test_the_unit_must_be_known(tmp_path):
    with pytest.raises(ValueError, match="unit: got 'parsec', expected one of m, cm, mm"):
        load_mesh(tmp_path / "any.stl", unit="parsec")


def test_npz_holds_image_and_conditions(image, tmp_path):
    save_image(tmp_path / "image.npz", image)
    with np.load(tmp_path / "image.npz") as held:
        np.testing.assert_array_equal(held["radiance"], image.radiance)
        np.testing.assert_array_equal(held["standard_error"], image.standard_error)
        assert list(held["bands"]) == ["MWIR", "LWIR"] and str(held["unit"]) == "W m-2 sr-1"


def test_tiff_holds_one_page_per_band(image, tmp_path):
    import tifffile

    save_tiff(tmp_path / "image.tif", image)
    with tifffile.TiffFile(tmp_path / "image.tif") as held:
        assert [page.description for page in held.pages] == [f"{b} radiance, W m-2 sr-1" for b in image.bands]
        for index, page in enumerate(held.pages):
            assert page.dtype == np.float32
            np.testing.assert_array_equal(page.asarray(), image.radiance[:, :, index])


def test_signature_table(tmp_path):
    table = jaxir.signature(jaxir.Scene(plate()), [(0.0, 0.0), (30.0, -10.0)], jaxir.LWIR, shape=(16, 16))
    save_signature(tmp_path / "table.csv", table)
    header, *rows = (tmp_path / "table.csv").read_text().splitlines()
    assert header == "azimuth_deg,elevation_deg,LWIR_W_per_sr,LWIR_standard_error_W_per_sr"
    held = np.array([[float(cell) for cell in row.split(",")] for row in rows])
    np.testing.assert_allclose(held[:, 2], table.intensity[:, 0], rtol=1e-6)
    np.testing.assert_allclose(held[:, :2], [(0.0, 0.0), (30.0, -10.0)], rtol=1e-6)


@pytest.mark.parametrize("save", [save_image, save_tiff])
def test_nothing_is_left_of_a_failed_write(save, image, tmp_path):
    with pytest.raises(ValueError, match="expected a file name that ends in"):
        save(tmp_path / "image.png", image)
    with pytest.raises(ValueError, match="does not exist"):
        save(tmp_path / "absent" / ("image.npz" if save is save_image else "image.tif"), image)
    assert not list(tmp_path.iterdir())


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


def test_faces_seen_by_a_camera():
    camera = jaxir.orthographic_camera(0.0, 0.0, 0.25, (6, 8))
    face = np.asarray(jaxir.visible_faces(box_mesh(), camera))
    front = np.asarray(box_mesh().area_vectors())[:, 0] > 0.4  # the two triangles that look along +x
    assert front[face[1:5, 2:6]].all()
    seen = face >= 0
    assert seen[1:5, 2:6].all() and seen.sum() == 16
