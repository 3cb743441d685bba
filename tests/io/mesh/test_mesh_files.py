"""Meshes of every format are read in order and in metres, and every damaged file is named."""

import numpy as np
import pytest
import trimesh

from jaxir.io.mesh import load_mesh
from tests.scenes import box_mesh

HEAD = b"""ply
format %s 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
"""
PLY = HEAD % b"ascii" + b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
BINARY_PLY = (
    HEAD % b"binary_big_endian"
    + np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], ">f4").tobytes()
    + b"\x03"
    + np.array([0, 1, 2], ">i4").tobytes()
)
CORNERS = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"
OFF = b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"


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


def test_vertices_that_no_face_uses_are_no_part_of_the_body(tmp_path):
    (tmp_path / "far.obj").write_bytes(b"v 800 0 300\n" + CORNERS + b"f 2 3 4\n")
    body = load_mesh(tmp_path / "far.obj", unit="m")
    np.testing.assert_array_equal(np.ptp(np.asarray(body.mesh.vertices), axis=0), [1, 1, 0])
    np.testing.assert_array_equal(body.mesh.faces, [[1, 2, 3]])


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


def test_objects_of_a_scene_stay_in_the_order_of_the_file(tmp_path):
    """As values by face do that were made for it."""
    names = ["zeta", "alpha", "mid", "beta"]
    scene = trimesh.Scene()
    for place, name in enumerate(names):
        moved = trimesh.transformations.translation_matrix([5.0 * place, 0.0, 0.0])
        scene.add_geometry(_trimesh(box_mesh()), node_name=f"at {name}", geom_name=name, transform=moved)
    scene.export(tmp_path / "four.glb")
    body = load_mesh(tmp_path / "four.glb", unit="m")
    assert list(body.part_names) == names
    np.testing.assert_allclose(np.asarray(body.mesh.corners()).mean(1).reshape(4, 12, 3).mean(1)[:, 0], [0, 5, 10, 15])


def test_an_object_in_a_place_that_another_carries_comes_after_it(tmp_path):
    scene = trimesh.Scene(geometry={"engine": _trimesh(box_mesh())})
    scene.graph.update(frame_to="first", geometry="engine", matrix=np.eye(4))
    for name, before, away in (("carried", "first", 20.0), ("next", "first", 10.0), ("last", "world", 30.0)):
        moved = trimesh.transformations.translation_matrix([away, 0.0, 0.0])
        scene.graph.update(frame_from=before, frame_to=name, geometry="engine", matrix=moved)
    scene.export(tmp_path / "tree.glb")
    corners = np.asarray(load_mesh(tmp_path / "tree.glb", unit="m").mesh.corners())
    middle = corners.mean(1).reshape(-1, 12, 3).mean(1)[:, 0]
    np.testing.assert_allclose(middle, [0, 0, 20, 10, 30], atol=1e-5)  # the first is where trimesh places it by itself


def _instances(path, transforms):
    """A GLB file of a body and of one engine in several places."""
    scene = trimesh.Scene(geometry={"body": _trimesh(box_mesh())})
    scene.geometry["engine"] = _trimesh(box_mesh())
    for place, transform in enumerate(transforms):
        scene.graph.update(frame_to=f"place {place}", geometry="engine", matrix=transform)
    scene.export(path)
    return load_mesh(path, unit="m")


def test_an_object_in_two_places_is_one_part(tmp_path):
    places = [trimesh.transformations.translation_matrix([0.0, y, 0.0]) for y in (-5.0, 5.0)]
    body = _instances(tmp_path / "engines.glb", places)
    assert sorted(body.part_names) == ["body", "engine"]
    middle = np.asarray(body.mesh.corners())[body.part == body.part_names.index("engine")].mean(axis=1)
    assert np.sum(middle[:, 1] < -4) == np.sum(middle[:, 1] > 4) == 12
    assert np.bincount(body.part).tolist() == sorted([12, 24], reverse=body.part_names[0] == "engine")


def test_a_mirrored_object_looks_outwards(tmp_path):
    mesh = _instances(tmp_path / "engines.glb", [np.diag([1.0, -1.0, 1.0, 1.0])]).mesh
    assert mesh.count == 24
    outward = np.sum(np.asarray(mesh.area_vectors()) * np.asarray(mesh.corners()).mean(axis=1), axis=1)
    assert (outward > 0).all()


def test_a_missing_package_is_named(tmp_path, monkeypatch):
    def load(*args, **options):
        raise ModuleNotFoundError("No module named 'networkx'")

    monkeypatch.setattr(trimesh, "load_scene", load)
    (tmp_path / "a.3mf").write_bytes(b"PK")
    with pytest.raises(ImportError, match=r"a.3mf: reading it needs .*'networkx'\): pip install \"trimesh\[easy\]\""):
        load_mesh(tmp_path / "a.3mf", unit="m")


@pytest.mark.parametrize(
    "content",
    [
        b"\xef\xbb\xbf" + CORNERS + b"f 1 2 3\n",
        b"f 1 2 3\n" + CORNERS,
        CORNERS + b"f 1 \\\n2 \\\r\n3\n",
        b"# of C:\\meshes\\\n" + CORNERS + b"f 1 2 3\n",
        CORNERS.replace(b"0\nv", b"0 # a corner\nv") + b"f 1 2 3 # the face\n",
        CORNERS.replace(b"0\nv", b"0 1\nv") + b"v 9 9 9\nf -4 -3 -2\nv 8 8 8\n",
    ],
    ids=["byte order mark", "vertices after", "continued", "comment", "comments behind", "weights"],
)
def test_a_triangle_however_obj_writes_it(content, tmp_path):
    (tmp_path / "a.obj").write_bytes(content)
    body = load_mesh(tmp_path / "a.obj", unit="m")
    np.testing.assert_array_equal(body.mesh.corners(), [[[0, 0, 0], [1, 0, 0], [0, 1, 0]]])


def test_lines_are_counted_as_the_file_has_them(tmp_path):
    (tmp_path / "a.obj").write_bytes(CORNERS + b"f 1 \\\n2 3\nf 1 2 \\\nx\n")
    with pytest.raises(ValueError, match=r"a.obj:6: got 'f 1 2  x'"):
        load_mesh(tmp_path / "a.obj", unit="m")


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
        ("points.obj", CORNERS, "points.obj: "),
        ("nan.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "nan.obj: vertex 0 is .* expected finite"),
        ("flat.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "flat.obj: all 1 faces have zero area"),
        ("what.xyz2", b"v", "what.xyz2: not readable"),
        ("beyond.ply", PLY.replace(b"3 0 1 2", b"3 0 1 3"), "beyond.ply: face 0: got vertex 3, expected one of 0 to 2"),
        ("below.ply", PLY.replace(b"3 0 1 2", b"3 0 1 -1"), "below.ply: face 0: got vertex -1, expected one of 0 to 2"),
        ("cut.ply", PLY[:-8], "cut.ply: got 3 lines, expected 3 of vertex and 1 of face as its header says"),
        ("half.ply", PLY[:-3], "half.ply: face 0: got '3 0 1', expected more numbers"),
        ("two.ply", PLY.replace(b"0 1 2", b"0 1 2 2"), "two.ply: face 0: got '3 0 1 2 2', expected fewer numbers"),
        ("binary.ply", BINARY_PLY[:-5], "binary.ply: face 0: got the end of the file, expected 1 rows"),
        ("more.ply", BINARY_PLY + b"abc", "more.ply: got 3 bytes after the last element, expected none"),
        ("beyond.off", OFF.replace(b"3 0 1 2", b"3 0 1 7"), "beyond.off: face 0: got vertex 7, expected one of 0 to 2"),
        ("cut.off", OFF[:-8], "cut.off: got 3 lines, expected 3 vertices and 1 faces"),
        ("less.stl", bytes(80) + b"\x01\x00\x00\x00" + bytes(100), "less.stl: got 184 bytes, expected 134"),
        ("gap.stl", b"solid a\nfacet normal 0 0 1\nouter loop\nendloop\n", "gap.stl:4: got 'endloop', expected vertex"),
        ("beyond.obj", CORNERS + b"f 1 2 4\n", "beyond.obj:4: got vertex 4, expected one of 1 to 3"),
        ("below.obj", CORNERS + b"f 1 2 -4\n", "below.obj:4: got 'f 1 2 -4', expected vertices 1 to .* or -3 to -1"),
        ("two.obj", CORNERS + b"f 1 2\n", "two.obj:4: got 2 corners, expected at least 3"),
        ("weight.obj", CORNERS + b"v 0 0 1 2\nf 1 2 3\n", "weight.obj:4: got 'v 0 0 1 2', expected a weight .* of 1"),
        ("word.obj", CORNERS + b"n 1 2 3\n", "word.obj:4: got 'n 1 2 3', expected a word of the OBJ"),
        ("half.obj", CORNERS + b"f 1/1 2/2 3\n", "half.obj:4: .* expected corners of one form"),
        ("far.obj", b"v 1e9 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "far.obj: vertex 0 is .* expected .* below 1e.09 m"),
        ("huge.obj", b"v 1e300 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "huge.obj: vertex 0 is .* expected .* below 1e.09 m"),
    ],
)
def test_damaged_meshes_are_named(name, content, message, tmp_path):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ValueError, match=message):
        load_mesh(path, unit="m")


@pytest.mark.parametrize(("name", "content"), [("a.ply", PLY), ("b.ply", BINARY_PLY), ("c.off", OFF)])
def test_a_triangle_in_every_layout(name, content, tmp_path):
    (tmp_path / name).write_bytes(content)
    body = load_mesh(tmp_path / name, unit="m")
    np.testing.assert_array_equal(body.mesh.corners(), [[[0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    assert body.part_names == (name,)


@pytest.mark.parametrize("layout", ["ascii", "binary_little_endian"])
def test_polygons_become_fans_in_the_order_of_the_file(layout, tmp_path):
    polygons = [[0, 1, 2, 3], [0, 1, 4], [0, 1, 2, 3, 4]]
    points = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0], [0, 0, 1]], "<f4")
    if layout == "ascii":
        rows = [*points.tolist(), *([len(corners), *corners] for corners in polygons)]
        body = "\n".join(" ".join(str(number) for number in row) for row in rows).encode() + b"\n"
    else:
        lists = (bytes([len(corners)]) + np.array(corners, "<i4").tobytes() for corners in polygons)
        body = points.tobytes() + b"".join(lists)
    head = HEAD.replace(b"vertex 3", b"vertex 5").replace(b"face 1", b"face 3") % layout.encode()
    (tmp_path / "polygons.ply").write_bytes(head + body)
    mesh = load_mesh(tmp_path / "polygons.ply", unit="m").mesh
    want = [[0, 1, 2], [0, 2, 3], [0, 1, 4], [0, 1, 2], [0, 2, 3], [0, 3, 4]]
    np.testing.assert_array_equal(mesh.faces, want)


def test_damaged_glb(tmp_path):
    path = tmp_path / "box.glb"
    _trimesh(box_mesh()).export(path)
    whole = path.read_bytes()
    indices = np.asarray(box_mesh().faces, "<u4").tobytes()
    assert whole.count(indices) == 1
    path.write_bytes(whole.replace(indices, indices[:-4] + b"\x63\x00\x00\x00"))
    with pytest.raises(ValueError, match="box.glb: face 11: got vertex 99, expected one of 0 to 7"):
        load_mesh(path, unit="m")
    path.write_bytes(whole.replace(b'"bufferView":0,"count":36', b'"count":36' + b"0" * 15))
    with pytest.raises(ValueError, match="box.glb: got 360+ numbers without bytes, expected at most"):
        load_mesh(path, unit="m")
    path.write_bytes(whole[:-12])
    with pytest.raises(ValueError, match=rf"box.glb: got {len(whole) - 12} bytes, expected {len(whole)}"):
        load_mesh(path, unit="m")


def test_the_unit_must_be_known(tmp_path):
    with pytest.raises(ValueError, match="unit: got 'parsec', expected one of m, cm, mm"):
        load_mesh(tmp_path / "any.stl", unit="parsec")
