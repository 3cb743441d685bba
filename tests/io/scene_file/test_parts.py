"""Parts of a scene file chosen by selections, to which paint, temperature and names are given."""

import numpy as np
import pytest
import trimesh

from jaxir import OfMaterial, OfPart
from jaxir.io.mesh import load_mesh
from jaxir.io.scene_file import load_scene
from tests.io.scene_file.scene_text import write_obj, write_scene

TEXT = """
bands = ["MWIR"]
[skin]
mesh = { path = "body.obj", unit = "m" }
temperature = 300
brdf = { type = "Lambert", emissivity = 0.8 }
[[skin.parts]]
name = "aft"
faces = FACES
temperature = 400
"""


OUTER = [0, 1, 4, 5]


def skin(folder, faces, parts=("wing", "tail", "fin")):
    """The skin of unit squares in the planes x = 0, -1 and -2, with faces of a part of their own."""
    if not (folder / "body.obj").exists():
        write_obj(folder / "body.obj", parts)
    return load_scene(write_scene(folder, TEXT.replace("FACES", faces))).scene.skin


@pytest.mark.parametrize(
    ("faces", "hot"),
    [
        ('{ type = "InBox", x = [-3, -0.5] }', [2, 3, 4, 5]),
        ('{ type = "InCylinder", start = [-1.5, 0, 0], end = [-0.5, 0, 0], radius = 1 }', [2, 3]),
        ('{ type = "AbovePlane", point = [-1.5, 0, 0], normal = [-1, 0, 0] }', [4, 5]),
        ('[{ type = "Facing", direction = [1, 0, 0] }, { type = "OfPart", parts = ["tail", "fin"] }]', [2, 3, 4, 5]),
        ('{ type = "Connected", point = [-1, 0, 0] }', [2, 3]),
        ('{ type = "Union", of = [{ type = "OfPart", parts = "wing" }, { type = "OfPart", parts = "fin" }] }', OUTER),
        ('{ type = "Complement", of = { type = "OfPart", parts = ["wing"] } }', [2, 3, 4, 5]),
        ("[1]", [1]),
    ],
)  # fmt: skip
def test_a_selection_is_a_part(faces, hot, tmp_path):
    found = skin(tmp_path, faces)
    assert found.part_names == ("wing", "tail", "fin", "aft")
    assert np.flatnonzero(np.asarray(found.part) == 3).tolist() == hot
    np.testing.assert_array_equal(found.temperature, np.where(np.isin(np.arange(6), hot), 400, 300))


@pytest.mark.parametrize(
    ("faces", "message"),
    [
        ('{ type = "InBox", x = [5, 6] }', r"InBox\(x=\(5.0, 6.0\), y=None, z=None\): catches no face of 6"),
        ('{ type = "Facing", direction = [1, 0, 0] }', "catches every face of 6, which span x -2 to 0"),
        (
            '{ type = "OfPart", parts = ["rudder"] }',
            r"OfPart.parts: got \['rudder'\], expected some of wing, tail, fin",
        ),
        ('{ type = "OfMaterial", materials = ["glass"] }', "OfMaterial: got a mesh without materials"),
        ("[1, 2, 1]", "expected every face once"),
        ('{ type = "InBix" }', r"type: got 'InBix', expected one of .* \(did you mean InBox\?\)"),
        ('{ type = "InBox", X = [0, 1] }', "X: unknown key"),
        ('{ type = "Facing", direction = [0, 0, 0] }', "expected a direction, not all 0"),
    ],
)
def test_what_catches_nothing_or_everything_is_one_line(faces, message, tmp_path):
    with pytest.raises(ValueError, match=rf"scene.toml: skin.parts\[0\].faces.*{message}") as found:
        skin(tmp_path, faces)
    assert "\n" not in str(found.value)


def more_parts(folder, *parts):
    """The scene with a part `aft` of two faces at 400 K and others after it."""
    skin(folder, "[2, 3]")
    text = TEXT.replace("FACES", "[2, 3]") + "".join(f"[[skin.parts]]\n{part}\n" for part in parts)
    return load_scene(write_scene(folder, text))


def test_faces_that_a_later_part_takes_are_told(tmp_path):
    found = more_parts(tmp_path, "name = 'low'\nfaces = [3, 4]\ntemperature = 500")
    np.testing.assert_array_equal(found.scene.skin.temperature, [300, 300, 400, 500, 500, 300])
    assert "skin.parts[1]: takes 1 of the 2 faces of part 'aft' of skin.parts[0]" in found.notes
    split = more_parts(tmp_path, "name = 'aft'\nbrdf = { type = 'Lambert', emissivity = 0.2 }")
    assert split.notes == ()


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (
            "name = 'all'\nfaces = { type = 'OfPart', parts = 'aft' }\ntemperature = 500",
            r"skin.parts\[1\].faces: got .*, expected faces that leave some to part 'aft' of skin.parts\[0\]",
        ),
        (
            "name = 'aft'\ntemperature = 500",
            r"skin.parts\[1\].name: got 'aft', expected another part: skin.parts\[0\] has its temperature",
        ),
    ],
)
def test_no_part_is_lost_to_a_later_one(part, message, tmp_path):
    """Its temperature and brdf would be read and mean nothing."""
    with pytest.raises(ValueError, match=f"scene.toml: {message}") as found:
        more_parts(tmp_path, part)
    assert "\n" not in str(found.value)


def test_temperatures_in_celsius_are_refused_where_they_are_read(tmp_path):
    np.save(tmp_path / "hot.npy", np.array([21.0, -3.5]))
    text = TEXT.replace("FACES", "[2, 3]").replace("temperature = 400", "temperature = { path = 'hot.npy' }")
    skin(tmp_path, "[2, 3]")
    message = r"skin.parts\[0\].temperature: got -3.5, expected temperatures > 0 K \(are they in Celsius\?\)"
    with pytest.raises(ValueError, match=f"scene.toml: {message}"):
        load_scene(write_scene(tmp_path, text))


def test_a_name_is_every_place_of_an_object(tmp_path):
    scene = trimesh.Scene(geometry={"engine": trimesh.creation.box(), "wing": trimesh.creation.box()})
    scene.graph.update(
        frame_to="other", geometry="engine", matrix=trimesh.transformations.translation_matrix([0, 3, 0])
    )
    scene.export(tmp_path / "body.glb")
    text = TEXT.replace("body.obj", "body.glb").replace('"aft"', '"engine"').replace("faces = FACES\n", "")
    found = load_scene(write_scene(tmp_path, text)).scene.skin
    assert sorted(found.part_names) == ["engine", "wing"]
    assert np.bincount(np.asarray(found.temperature).astype(int))[[300, 400]].tolist() == [12, 24]


@pytest.mark.parametrize(
    ("faces", "message"),
    [
        ("[[0, 1, 2.9]]", r"skin.mesh.faces: got \[\[0, 1, 2.9\]\], expected integers >= 0"),
        ("[[0, 1, 3e9]]", "skin.mesh.faces: got .* expected integers >= 0 of 32 bits"),
        ("[[0, 1, 3], [1, 1, 2]]", "skin.mesh: all 2 faces have zero area"),
    ],
)
def test_faces_in_the_file_are_triangles(faces, message, tmp_path):
    mesh = f'{{ type = "Mesh", vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0]], faces = {faces} }}'
    text = TEXT.replace('{ path = "body.obj", unit = "m" }', mesh).split("[[skin.parts]]")[0]
    with pytest.raises(ValueError, match=message):
        load_scene(write_scene(tmp_path, text))


def test_materials_are_kept_beside_the_objects(tmp_path):
    write_obj(tmp_path / "body.obj", ("wing", "tail", "fin"))
    lines = (
        (tmp_path / "body.obj").read_text().replace("o tail", "usemtl glass\no tail").replace("o fin", "usemtl\no fin")
    )
    (tmp_path / "body.obj").write_text(lines)
    found = skin(tmp_path, '{ type = "OfMaterial", materials = ["glass"] }')
    assert np.flatnonzero(np.asarray(found.part) == 3).tolist() == [2, 3]

    scene = trimesh.Scene()
    for name, colour in (("a", "red"), ("b", "blue")):
        box = trimesh.creation.box()
        box.visual = trimesh.visual.TextureVisuals(material=trimesh.visual.material.PBRMaterial(name=colour))
        scene.add_geometry(box, node_name=name, geom_name=name)
    scene.export(tmp_path / "two.glb")
    body = load_mesh(tmp_path / "two.glb", unit="m")
    assert body.select(OfMaterial("blue")).tolist() == body.select(OfPart("b")).tolist()
    assert np.bincount(body.material).tolist() == [12, 12]
