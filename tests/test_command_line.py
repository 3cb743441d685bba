"""The command line: files written whole and labelled, one line and a status for whatever is wrong."""

import functools
import hashlib
import importlib
import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

import jaxir
from jaxir.command_line import main, run
from jaxir.command_line._html import Page
from jaxir.command_line._report import hashes, write_signature
from jaxir.io.scene_file import load_scene
from tests.io.scene_file.scene_text import TEXT, write_obj, write_scene
from tests.scenes import box_mesh

EXAMPLES = Path(jaxir.__file__).parents[1] / "examples"


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    """Outputs of one scene in every quantity and format."""
    folder = tmp_path_factory.mktemp("out")
    scene = str(write_scene(folder))
    quantities = ["-q", "apparent", "-q", "source"]
    files = [word for suffix in (".npz", ".tif", ".nc", ".png") for word in ("-o", str(folder / f"image{suffix}"))]
    assert main(["render", scene, *quantities, *files]) == 0
    table = ["-o", str(folder / "table.csv"), "-o", str(folder / "table.txt"), "-o", str(folder / "table.png")]
    assert main(["signature", scene, "-q", "source", *table, "-o", str(folder / "table.nc")]) == 0
    return folder


def test_quantities_are_labelled_and_differ_as_they_should(rendered):
    held = {q: np.load(rendered / f"image_{q}.npz") for q in ("apparent", "source")}
    for quantity, file in held.items():
        conditions = json.loads(str(file["conditions"]))
        assert conditions["quantity"].startswith(f"{quantity}: ") and conditions["scene"] == "scene.toml"
    intensity = {q: ((f["radiance"] - f["empty"]) * f["pixel"].prod()).sum((0, 1)) for q, f in held.items()}
    black = [jaxir.band_radiance(jnp.asarray(t), jaxir.gray_nodes((jaxir.MWIR, jaxir.LWIR))) for t in (300.0, 250.0)]
    skin = 0.8 * np.asarray(black[0]) + 0.2 * np.asarray(black[1]) + 0.2 / np.pi * np.array([2.0, 0.1])  # of 1 m2
    np.testing.assert_allclose(intensity["source"], skin, rtol=1e-5)
    np.testing.assert_allclose(intensity["apparent"], 0.5 * (skin - np.asarray(black[1])), rtol=1e-5)


def test_netcdf_has_units_and_conditions(rendered):
    xarray = pytest.importorskip("xarray")
    with xarray.open_dataset(rendered / "image_apparent.nc", engine="scipy") as data:
        assert data.radiance.attrs["units"] == "W m-2 sr-1" and list(data.band.values) == ["MWIR", "LWIR"]
        np.testing.assert_array_equal(data.radiance, np.load(rendered / "image_apparent.npz")["radiance"])
        assert data.attrs["quantity"].startswith("apparent") and data.x.attrs["units"] == "m"
        assert float(data.x[0]) == -0.9375 and float(data.y[0]) == 0.9375
    with xarray.open_dataset(rendered / "table.nc", engine="scipy") as data:
        assert data.intensity.attrs["units"] == "W sr-1" and data.intensity.shape == (10, 2)


def test_tiff_and_pictures_are_there(rendered):
    tifffile = pytest.importorskip("tifffile")
    with tifffile.TiffFile(rendered / "image_source.tif") as held:
        assert held.pages[1].description.startswith("LWIR radiance, W m-2 sr-1; scene: scene.toml; quantity: source")
    for name in ("image_apparent.png", "table.png"):
        assert (rendered / name).read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert not [path for path in rendered.iterdir() if path.name.startswith(".")]


OVER = """
[over.level]
values = [1, 2]
tables = { "sources[0].irradiance" = [[2.0, 0.1], [4.0, 0.2]] }
"""


def test_states_are_one_table_and_one_film(rendered, tmp_path, capsys):
    scene = str(write_scene(tmp_path, TEXT + OVER))
    asked = ["-q", "source", "-o", str(tmp_path / "t.csv"), "--folder", str(tmp_path / "kept")]
    assert main(["signature", scene, *asked]) == 0
    rows = [line.split(",") for line in (tmp_path / "t.csv").read_text().splitlines() if line[0] != "#"]
    assert len(rows) == 21 and rows[0][:3] == ["level", "azimuth_deg", "elevation_deg"]
    lone = [line.split(",") for line in (rendered / "table.csv").read_text().splitlines() if line[0] != "#"]
    first, alone = (np.array(part, float) for part in (rows[1:11], lone[1:]))
    np.testing.assert_allclose(first[:, 1:5], alone[:, :4], rtol=1e-5)  # the first state is the file as it is
    kept = sorted(path.name for path in (tmp_path / "kept").iterdir())
    assert kept == ["level=1", "level=2"]
    assert main(["film", scene, "-q", "apparent", "-o", str(tmp_path / "f.gif"), "-o", str(tmp_path / "f.png")]) == 0
    assert (tmp_path / "f.gif").read_bytes()[:4] == b"GIF8"
    assert main(["film", str(write_scene(tmp_path, TEXT, "one.toml"))]) == 1
    assert "got no section over or no camera, expected both for film" in capsys.readouterr().err
    grows = '[over.rows]\nvalues = [16, 8]\ntables = { "camera.shape" = [[16, 16], [8, 16]] }\n'
    assert main(["film", str(write_scene(tmp_path, TEXT + grows, "grows.toml")), "-q", "apparent"]) == 1
    assert "over: got other bands or shape at rows 8, expected equal ones" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["signature", "film"])
def test_a_state_that_is_wrong_is_named_before_another_is_computed(command, tmp_path, capsys, monkeypatch):
    def unused(entry):
        @functools.wraps(entry)
        def computed(*_args, **_kwargs):
            raise AssertionError("computed before all states were looked at")

        return computed

    commands = importlib.import_module("jaxir.command_line._commands")
    for name in ("render", "sweep"):
        monkeypatch.setattr(commands, name, unused(getattr(commands, name)))
    wrong = '[over.level]\nvalues = [1, -5]\nkeys = ["sources[0].irradiance"]\n'
    assert main([command, str(write_scene(tmp_path, TEXT + wrong)), "-o", str(tmp_path / "out.png")]) == 1
    said = capsys.readouterr().err
    assert "scene.toml: level=-5: sources[0]: ParallelSource.irradiance: got -5.0" in said and said.count("\n") == 1


def test_a_scale_of_lines_by_component_is_refused(tmp_path, capsys):
    scene = str(write_scene(tmp_path))
    assert main(["signature", scene, "--components", "parts", "--scale", "dB", "-o", str(tmp_path / "t.png")]) == 1
    assert "--scale: got dB, expected none: lines by component have a scale of their own" in capsys.readouterr().err


BARE = TEXT[: TEXT.index("[background]")] + TEXT[TEXT.index("[camera]") : TEXT.index("[signature]")]


def test_a_report_holds_pictures_components_assumptions_and_hashes(tmp_path, capsys):
    """One page, nothing outside it; its components add up to the intensity of its budget."""
    scene = write_scene(tmp_path, BARE)
    assert main(["report", str(scene), "-o", str(tmp_path / "r.html")]) == 0
    page = (tmp_path / "r.html").read_text()
    assert page.count("<img ") == page.count("data:image/png;base64,") == 7 and "http" not in page
    said = (
        "What was assumed",
        "SHA-256",
        "ParallelSource",
        "no air",
        "Error budget",
        "jax ",
        "There is nothing around",
    )
    assert [words for words in said if words not in page] == []
    assert hashlib.sha256(scene.read_bytes()).hexdigest() in page
    table = re.search(r"<tr><th>component</th>.*?</table>", page)[0]
    rows = [[float(x) for x in re.findall(r"<td>([-.e\d+]+)</td>", row)][::2] for row in table.split("<tr>")[2:]]
    np.testing.assert_allclose(np.sum(rows[:-1], axis=0), rows[-1], rtol=1e-3)
    empty = write_scene(tmp_path, TEXT[: TEXT.index("[camera]")], "empty.toml")
    assert main(["report", str(empty)]) == 1
    assert "got neither camera nor signature.views, expected one of them" in capsys.readouterr().err


def test_a_signature_in_a_report_is_a_row_for_each_view(tmp_path):
    read = load_scene(write_scene(tmp_path, BARE))
    angle, value = jnp.arange(0.0, 450.0), jnp.ones((450, 1))
    parts = jnp.stack([0.75 * value, 0.25 * value], axis=1)
    table = jaxir.Signature(angle, 0 * angle, value, 0 * value, ("A<B",), 0 * value, None, None, ("skin", "Sun"), parts)
    page = Page("a table")
    write_signature(page, read, table)
    assert str(page).count("<tr>") == 401 and "The first 400 of 450 views" in str(page)
    assert "<th>A&lt;B, skin</th>" in str(page) and "<td>0.75</td><td>0.25</td>" in str(page)


def test_hashes_are_those_of_every_file_that_is_named(tmp_path):
    write_obj(tmp_path / "b.obj", ("a",))
    write_scene(
        tmp_path, 'bands = ["MWIR"]\n[skin]\nmesh = { path = "b.obj", unit = "m" }\n[x]\npath = ["b.obj", "no"]\n'
    )
    found = hashes(tmp_path / "scene.toml")
    assert list(found) == ["scene.toml", "b.obj", "no"] and found["no"] == "a folder or missing"
    assert found["b.obj"] == hashlib.sha256((tmp_path / "b.obj").read_bytes()).hexdigest()


def test_afsim_s_table_is_that_of_the_source_with_azimuth_to_the_right(rendered):
    lines = (rendered / "table.txt").read_text().splitlines()
    assert lines[0] == "# scene: scene.toml" and lines[-1] == "end_infrared_signature"
    words = " ".join(line for line in lines if not line.startswith("#")).split()
    assert words[:5] == ["infrared_signature", "table", "state", "default", "band"]
    start = words.index("inline_table")
    assert words[start - 1] == "medium" and words[start + 1 : start + 4] == ["w/sr", "5", "2"]
    rows = np.array([float(w) for w in words[start + 6 : start + 6 + 15]]).reshape(5, 3)
    np.testing.assert_array_equal(rows[:, 0], [-180, -90, 0, 90, 180])
    table = np.loadtxt(rendered / "table.csv", delimiter=",", comments=("#", "azimuth"))
    for azimuth, elevation, mwir in table[:, :3]:
        row, column = rows[rows[:, 0] == -azimuth][0], 1 if elevation < 0 else 2
        np.testing.assert_allclose(row[column], mwir, rtol=1e-6)


def test_a_table_that_is_not_full_or_not_of_the_source_is_refused(tmp_path, capsys):
    scene = str(write_scene(tmp_path))
    assert main(["signature", scene, "-o", str(tmp_path / "a.txt")]) == 1
    assert "an AFSIM table holds the source, expected --quantity source" in capsys.readouterr().err
    scene = str(write_scene(tmp_path, TEXT.replace("elevation = [-30, 30]", "elevation = [0]")))
    assert main(["signature", scene, "-q", "source", "-o", str(tmp_path / "a.txt")]) == 1
    assert "views: got 4 aspects of 4 azimuths and 1 elevations" in capsys.readouterr().err


def test_show_says_what_a_scene_holds(capsys):
    assert main(["show", str(EXAMPLES / "plate.toml")]) == 0
    said = capsys.readouterr().out
    assert "skin: 2 faces, 2 x 2 x 0 m, not closed" in said and "background: ElevationTable" in said
    assert "bands: SWIR, MWIR, LWIR on 3 nodes" in said and "camera sunny_side: 48 x 48 pixels of 0.05 x 0.05 m" in said


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["render", "none.toml"], "none.toml: no such file"),
        (["render", "scene.toml", "-o", "image.jpg"], "image.jpg: expected a file name that ends in .npz or .tif"),
        (["render", "scene.toml", "-o", "no/image.npz"], "no/image.npz: the folder no does not exist"),
        (["render", "bare.toml"], "bare.toml: got no key camera, expected one for render"),
        (["signature", "bare.toml"], "bare.toml: got no key signature.views"),
        (["render", "short.toml"], "short.toml: ParallelSource.irradiance: got 3 spectral values, expected 1 or 2"),
        (["render", "odd.toml"], "odd.toml: samples: got 3, expected an even number"),
        (["signature", "near.toml"], "near.toml: Camera: (radius of the scene about the target) / distance: got"),
        (["show", "bad.toml"], "bad.toml: skin.brdf.emisivity: unknown key"),
    ],
)
def test_what_is_wrong_is_one_line_and_leaves_no_file(words, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_scene(tmp_path)
    write_scene(tmp_path, TEXT[: TEXT.index("[camera]")], "bare.toml")
    write_scene(tmp_path, TEXT.replace("[2.0, 0.1]", "[2.0, 0.1, 1.0]"), "short.toml")
    write_scene(tmp_path, TEXT.replace("samples = 2", "samples = 3"), "odd.toml")
    write_scene(tmp_path, TEXT + "distance = 0.5", "near.toml")
    write_scene(tmp_path, TEXT.replace("emissivity", "emisivity"), "bad.toml")
    before = set(tmp_path.iterdir())
    assert main(words) == 1
    err = capsys.readouterr().err
    assert err.startswith(f"jaxir: {message}") and err.count("\n") == 1
    assert set(tmp_path.iterdir()) == before


def test_missing_packages_are_said_before_anything_is_computed(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert main(["render", "none.toml", "-o", str(tmp_path / "image.nc")]) == 1
    assert 'needs xarray: pip install "jaxir[netcdf]"' in capsys.readouterr().err


def test_the_process_ends_with_a_status_and_without_traceback(tmp_path):
    scene = write_scene(tmp_path, "bands = [")
    environment = {**os.environ, "PYTHONPATH": str(EXAMPLES.parent)}
    ran = subprocess.run(
        [sys.executable, "-m", "jaxir", "render", str(scene)], capture_output=True, text=True, env=environment
    )
    assert ran.returncode == 1 and ran.stderr.count("\n") == 1 and "scene.toml: not readable as TOML" in ran.stderr


@pytest.mark.parametrize("command", ["render", "signature", "show", "report"])
def test_help_names_the_formats(command, capsys):
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    said = capsys.readouterr().out
    assert ended.value.code == 0 and "formats, by the ending of FILE" in said
    assert (".html" if command == "report" else ".png") in said


SCANNED = """
bands = ["LWIR"]
[skin]
mesh = { path = "MESH", unit = "mm" }
temperature = 300
brdf = { type = "Lambert", emissivity = 1.0 }
[camera]
type = "orthographic_camera"
azimuth = 0
elevation = 0
pixel = 0.25
shape = [16, 16]
[render]
samples = 2
"""


def _in_millimetres(mesh):
    return trimesh.Trimesh(np.asarray(mesh.vertices) * 1e3, np.asarray(mesh.faces), process=False)


def _holey(path):
    """A scan: a box with a face missing and coincident vertices that are not shared."""
    box = _in_millimetres(box_mesh((1.0, 2.0, 2.0)))
    torn = box.triangles[1:]
    trimesh.Trimesh(torn.reshape(-1, 3), np.arange(torn.size // 3).reshape(-1, 3), process=False).export(path)


def _bodies(path):
    """Two boxes side by side in one nameless file."""
    boxes = [_in_millimetres(box_mesh((1.0, 1.0, 1.0), (0.0, y, 0.0))) for y in (-1.0, 1.0)]
    trimesh.util.concatenate(boxes).export(path)


def _degenerate(path):
    """A box, one face of it twice and two faces without area."""
    box = _in_millimetres(box_mesh((1.0, 2.0, 2.0)))
    faces = np.concatenate([box.faces, box.faces[:1], [[0, 1, 1], [2, 2, 2]]])
    trimesh.Trimesh(box.vertices, faces, process=False).export(path)


@pytest.mark.parametrize(("make", "name"), [(_holey, "scan.stl"), (_degenerate, "messy.ply")])
def test_meshes_as_they_come(make, name, tmp_path, capsys, monkeypatch):
    """Not watertight, duplicate and flat faces: a black body's intensity is that of its outline."""
    monkeypatch.chdir(tmp_path)
    make(tmp_path / name)
    assert main(["render", str(write_scene(tmp_path, SCANNED.replace("MESH", name)))]) == 0
    said = capsys.readouterr()
    with np.load(tmp_path / "scene.npz") as held:
        intensity = held["radiance"].sum() * held["pixel"].prod()
    want = 4.0 * float(jaxir.band_radiance(jnp.asarray(300.0), jaxir.gray_nodes((jaxir.LWIR,)))[0])
    assert intensity == pytest.approx(want, rel=1e-5)
    assert ("2 faces have zero area" in said.err) == (make is _degenerate)


def test_bodies_of_a_file_without_names_become_parts(tmp_path, capsys):
    _bodies(tmp_path / "two.stl")
    text = SCANNED.replace('path = "MESH"', 'type = "split_bodies", path = "two.stl"')
    text = text.replace("[camera]", '[[skin.parts]]\nname = "body_1"\ntemperature = 400\n[camera]')
    assert main(["show", str(write_scene(tmp_path, text))]) == 0
    said = capsys.readouterr().out
    assert "skin: 24 faces, 1 x 3 x 1 m, closed" in said
    assert "part body_0: 12 faces, 300 to 300 K" in said and "part body_1: 12 faces, 400 to 400 K" in said


def test_parts_of_an_obj_file_are_its_objects(tmp_path):
    from jaxir.io.mesh import load_mesh

    body = load_mesh(write_obj(tmp_path / "b.obj", ("nose", "wing", "nose")), unit="m")
    assert body.part_names == ("nose", "wing") and body.part.tolist() == [0, 0, 1, 1, 0, 0]
    (tmp_path / "m.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nusemtl a\nf 1/1 2/2 3//3\nusemtl b\nf -1 -3 -2\n"
    )
    assert load_mesh(tmp_path / "m.obj", unit="m").part_names == ("a", "b")
    for line, message in (
        ("f 1 2 9", "got vertex 9, expected one of 1 to 4"),
        ("f 1 x 2", "got 'f 1 x 2'"),
        ("v 0 0", "fewer than th"),
    ):
        (tmp_path / "w.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\n" + line)
        with pytest.raises(ValueError, match=f"w.obj:6: .*{message}"):
            load_mesh(tmp_path / "w.obj", unit="m")


def test_the_command_ends_with_the_status_of_main(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["jaxir", "show", "no_scene.toml"])
    with pytest.raises(SystemExit, match="^1$"):
        run()
    assert "no_scene.toml" in capsys.readouterr().err
    project = tomllib.loads((EXAMPLES.parent / "pyproject.toml").read_text())["project"]
    module, _, name = project["scripts"]["jaxir"].partition(":")
    assert getattr(importlib.import_module(module), name) is run
