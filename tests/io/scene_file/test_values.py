"""Values of scene files are read as their parameters ask."""

import datetime
from pathlib import Path

import pytest

from jaxir.io.field import load_flow, load_surface_field
from jaxir.io.scene_file import Entry, load_scene
from jaxir.io.scene_file._entries import arguments
from jaxir.io.scene_file._vocabulary import READERS
from jaxir.io.spectra import load_tape7
from jaxir.scene.light import sun_at
from tests.io.scene_file.scene_text import TEXT, write_scene


def test_a_time_is_that_of_its_parameter():
    """Of a file in seconds, of the Sun a date."""
    flow = Entry(Path(__file__), "flow", {"path": Path(__file__).name, "unit": "m", "time": 0.5})
    assert arguments(flow, load_surface_field, READERS, ("mesh", "field"))["time"] == 0.5
    whole = flow._replace(value=flow.value | {"shape": [2, 2, 2], "fields": {"T": 0.0}})
    assert arguments(whole, load_flow, READERS)["time"] == 0.5
    noon = datetime.datetime(2026, 6, 21, 12, tzinfo=datetime.UTC)
    sun = Entry(Path("a.toml"), "sun", {"time": noon, "latitude": 0.0, "longitude": 0.0})
    assert arguments(sun, sun_at, READERS)["time"] == noon
    with pytest.raises(ValueError, match="sun.time: got 0.5, expected date and time with a zone"):
        arguments(sun._replace(value=sun.value | {"time": 0.5}), sun_at, READERS)
    with pytest.raises(ValueError, match=r"flow.shape: got \[8, 8\], expected 3 integers >= 1"):
        arguments(whole._replace(value=whole.value | {"shape": [8, 8]}), load_flow, READERS)


def test_several_files_are_read_where_they_may_be():
    here = Path(__file__).name
    given = Entry(Path(__file__), "atmosphere", {"path": [here, here]})
    assert arguments(given, load_tape7, READERS)["path"] == [Path(__file__)] * 2
    with pytest.raises(ValueError, match=r"flow.path: got \['test_values.py'\], expected a string"):
        arguments(
            given._replace(key="flow", value={"path": [here]}), load_surface_field, READERS, ("mesh", "field", "unit")
        )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("shape = [16, 16]", "shape = [16]", r"camera.shape: got \[16\], expected 2 integers >= 1"),
        ("temperature = 300.0", f"temperature = {'[' * 70}300.0{']' * 70}", "expected at most 8 arrays in one another"),
        ("[render]", "[render]\ndevices = 1", "render.devices: unknown key, expected one of (?!.*devices)"),
        ("[signature]", "[signature]\ndevices = 1", "signature.devices: unknown key, expected one of (?!.*devices)"),
        ('type = "Mesh"', "path = ['a.stl']\nunit = 'm'", r"skin.mesh.path: got \['a.stl'\], expected a string"),
    ],
)
def test_what_a_parameter_cannot_be_is_refused(old, new, message, tmp_path):
    text = TEXT.replace(old, new, 1)
    if "path" in new:
        text = "".join(line for line in text.splitlines(True) if not line.startswith(("vertices", "faces")))
    with pytest.raises(ValueError, match=message):
        load_scene(write_scene(tmp_path, text))


def test_a_file_may_begin_with_a_byte_order_mark(tmp_path):
    (tmp_path / "scene.toml").write_text(TEXT, encoding="utf-8-sig")
    assert load_scene(tmp_path / "scene.toml").names == ("MWIR", "LWIR")
