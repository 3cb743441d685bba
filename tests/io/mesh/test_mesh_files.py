"""Meshes of every format are read in order and in metres, and every damaged file is named."""

import numpy as np
import pytest
import trimesh

from jaxir.io.mesh import load_mesh
from tests.scenes import box_mesh


def _trimesh(mesh):
    return trimesh.Trimesh(np.asarray(mesh.vertices), np.asarray(mesh.faces), process=False)


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
        ("noise.ply", b"ply\nformat ascii 1.0\nelement vertex 3\n", "noise.ply:4: got .*, expected a header that ends"),
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
