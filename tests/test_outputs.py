"""What the command line computes is what the file says of each state, and all of it is written."""

import re
import tempfile
from functools import wraps
from pathlib import Path
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir.command_line import _commands as commands
from jaxir.command_line import main
from jaxir.command_line._formats import FILM_FORMATS, Format, write
from jaxir.io._files import written_whole
from jaxir.io.scene_file import load_scene
from tests.io.scene_file.scene_text import TEXT, write_scene

SOURCE = ["-q", "source"]


@pytest.fixture
def asked(monkeypatch):
    """Folders of sweeps with what they are asked; none is computed."""
    seen = {}

    def sweep(folder, scene, *, views, bands, **given):
        seen[Path(folder)] = given
        aspect, one = jnp.asarray(views, "f4"), jnp.ones((len(views), len(bands)))
        return jaxir.Signature(*aspect.T, one, 0.5 * one, tuple(band.name for band in bands), 0 * one)

    monkeypatch.setattr(commands, "sweep", sweep)
    return seen


OVER = """
[over.d]
values = [5, 2000]
keys = ["signature.distance"]
tables = { "method" = [{ bounces = 1 }, { bounces = 2 }], "signature.samples" = [2, 4], "signature.rtol" = [0.9, 0.1] }
"""


def test_a_state_is_asked_what_the_file_says_of_it(asked, tmp_path, capsys):
    scene = str(write_scene(tmp_path, TEXT + "[method]\n" + OVER))
    assert main(["signature", scene, *SOURCE, "-o", str(tmp_path / "t.csv")]) == 0
    found = [(own["distance"], own["method"].bounces, own["samples"], own["rtol"]) for own in asked.values()]
    assert found == [(5.0, 1, 2, 0.9), (2000.0, 2, 4, 0.1)]
    said = capsys.readouterr().err
    assert "signature.rtol was not met in 10 of 10 views of d=2000" in said and "d=5" not in said


@pytest.mark.parametrize(
    ("key", "values"),
    [
        ("bands", "[['MWIR'], ['LWIR']]"),
        ("signature.views", "[[[0, 0]], [[1, 0]]]"),
        ("signature.components", "[1, 2]"),
    ],
)
def test_what_one_table_cannot_hold_may_not_vary(key, values, asked, tmp_path, capsys):
    text = TEXT + f'components = "parts"\n[over.d]\nvalues = [1, 2]\ntables = {{ "{key}" = {values} }}'
    scene = str(write_scene(tmp_path, text))
    for command in (["show"], ["signature", *SOURCE]):
        assert main([command[0], scene, *command[1:]]) == 1
        assert f"scene.toml: over.d: got the key '{key}', expected others: bands, views" in capsys.readouterr().err
    assert not asked


@pytest.mark.parametrize("name", [".", "..", "kept"])
def test_any_folder_may_keep_views(name, asked, tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    assert main(["signature", str(write_scene(tmp_path)), *SOURCE, "--folder", name, "-o", "t.csv"]) == 0
    assert list(asked) == [(tmp_path / "here" / name).resolve()]


@pytest.mark.parametrize("asked", [("render", "--picture", "temperature"), ("signature", "--scale", "dB")])
def test_what_is_asked_of_a_picture_needs_one(asked, tmp_path, capsys):
    command, option, value = asked
    assert main([command, str(write_scene(tmp_path)), option, value]) == 1
    assert f"{option}: got {value} without a picture, expected -o FILE.png with it" in capsys.readouterr().err


def test_every_state_is_a_frame_of_its_camera(tmp_path, monkeypatch):
    films = {}
    kept = Format("", None, lambda path, images: films.update({path.name: list(images)}))
    image = SimpleNamespace(error_budget=lambda look: None)
    monkeypatch.setattr(commands, "render", wraps(jaxir.render)(lambda *given, **asked: image))
    monkeypatch.setattr(commands, "warn_of_image", lambda *given: None)
    monkeypatch.setitem(FILM_FORMATS, ".gif", kept)
    over = "[over.n]\nvalues = [1000001, 1000002]\ntables = { 'camera[0].name' = ['a', 'b'] }"
    text = TEXT.replace("[camera]", "[[camera]]\nname = 'a'") + over
    assert main(["film", str(write_scene(tmp_path, text)), "-o", str(tmp_path / "f.gif")]) == 0
    assert films == {"f_a.gif": ["n 1000001"], "f_b.gif": ["n 1000002"]}
    text = TEXT + "[over.n]\nvalues = [1000001, 1000002]\nkeys = ['camera.azimuth']"
    assert main(["film", str(write_scene(tmp_path, text)), "-o", str(tmp_path / "f.gif")]) == 0
    assert films["f.gif"] == ["n 1000001", "n 1000002"]


@pytest.mark.parametrize(
    ("command", "name", "message"),
    [
        ("render", ".npz", "^.npz: expected a file name that ends in .npz"),
        ("render", "folder.npz", "^-o folder.npz: got a folder, expected a file$"),
        ("render", "a" * 252 + ".npz", "^-o a*.npz: File name too long$"),
        ("signature", "my table.txt", "^-o my table.txt: name: got 'my table', expected letters, digits"),
        ("show", "folder.png", "^-o folder.png: got a folder, expected a file$"),
        ("report", "folder.html", "^-o folder.html: got a folder, expected a file$"),
        ("film", "folder.gif", "^-o folder.gif: got a folder, expected a file$"),
    ],
)
def test_a_file_that_cannot_be_written_is_said_before_anything_is_computed(
    command, name, message, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    for suffix in (".npz", ".png", ".html", ".gif"):
        (tmp_path / f"folder{suffix}").mkdir()
    write_scene(tmp_path, TEXT + "[over.n]\nvalues = [1]\nkeys = ['camera.azimuth']")
    words = SOURCE if command == "signature" else []
    assert main([command, "scene.toml", *words, "-o", name]) == 1
    said = capsys.readouterr()
    assert re.search(message, said.err.removeprefix("jaxir: ").strip()) and not said.out


@pytest.mark.parametrize(
    ("command", "names", "message"),
    [
        ("render", ["-o", "hot.npz"], "^-o hot.npz: got a file that scene.toml is read from, expected another name"),
        ("render", ["-o", "hotter.npz"], "^-o hotter.npz: got a file that scene.toml is read from"),
        ("signature", ["-q", "source", "-o", "a.csv", "-o", "./a.csv"], "^-o a.csv: got it twice"),
    ],
)
def test_nothing_is_written_over_what_a_scene_is_read_from(command, names, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for file in ("hot.npz", "hotter.npz"):
        np.savez(file, temperature=np.full(2, 310.0))
    held = Path("hot.npz").read_bytes(), Path("hotter.npz").read_bytes()
    over = "[over.n]\nvalues = [1, 2]\ntables = { 'skin.temperature.path' = ['hot.npz', 'hotter.npz'] }"
    write_scene(tmp_path, TEXT.replace("temperature = 300.0", 'temperature = { path = "hot.npz" }', 1) + over)
    assert main([command, "scene.toml", *names]) == 1
    said = capsys.readouterr()
    assert re.search(message, said.err.removeprefix("jaxir: ").strip()) and not said.out
    assert (Path("hot.npz").read_bytes(), Path("hotter.npz").read_bytes()) == held


def test_a_folder_that_may_not_be_written_is_said_at_once(tmp_path, capsys, monkeypatch):
    """Root may write where the mode of a folder forbids it."""

    def refused(dir):
        raise PermissionError(13, "Permission denied", str(dir))

    monkeypatch.setattr(tempfile, "TemporaryFile", refused)
    assert main(["render", str(write_scene(tmp_path)), "-o", str(tmp_path / "a.npz")]) == 1
    assert f"a.npz: the folder {tmp_path} may not be written" in capsys.readouterr().err


def test_all_files_are_tried_before_the_first_error_is_raised(tmp_path, capsys):
    def fail(path, text):
        raise OSError(f"no room for {path.name}")

    formats = {".a": Format("", None, fail), ".b": Format("", None, lambda path, text: path.write_text(text))}
    with pytest.raises(OSError, match="no room for x.a"):
        write(formats, [tmp_path / "x.a", tmp_path / "x.b", tmp_path / "y.a"], "text")
    assert (tmp_path / "x.b").read_text() == "text" and capsys.readouterr().out.count("wrote") == 1


def test_the_longest_name_is_written(tmp_path):
    path = tmp_path / ("ü" * 125 + ".csv")
    with written_whole(path) as part:
        part.touch()
    assert path.is_file() and len(list(tmp_path.iterdir())) == 1


def test_an_error_of_a_state_names_the_file_once(tmp_path):
    read = load_scene(write_scene(tmp_path))

    def fail():
        raise ValueError(f"t=1: {read.file}: skin.temperature: got -1")

    with pytest.raises(ValueError, match=f"^{read.file}: t=1: skin.temperature: got -1$"):
        commands.naming(read, fail)


def test_of_a_scene_beside_the_frame_a_warning_tells(tmp_path, capsys):
    scene = write_scene(tmp_path, TEXT.replace("[camera]", "[camera]\ntarget = [0, 50, 0]"))
    assert main(["render", str(scene), *SOURCE, "-o", str(tmp_path / "beside.npz")]) == 0
    assert "scene.toml: the frame leaves out more than can be told" in capsys.readouterr().err
