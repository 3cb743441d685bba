"""Values of a scene file that vary."""

import re
from pathlib import Path

import pytest

import jaxir
from jaxir.io.scene_file import Entry, States, load_scene
from jaxir.io.scene_file._states import Axis
from tests.io.scene_file.scene_text import TEXT, write_scene

OVER = """
[over.mach]
values = [0.6, 0.9]
keys = ["skin.temperature.mach"]

[over.level]
values = [1, 2]
tables = { "sources[0].irradiance" = [[2.0, 0.1], [4.0, 0.2]], "camera.azimuth" = [0.0, 45.0] }
"""
HEATED = TEXT.replace("temperature = 300.0", 'temperature = { type = "air_temperature", altitude = 0.0, mach = 0.0 }')


def test_a_state_has_the_values_of_its_axes(tmp_path):
    read = load_scene(write_scene(tmp_path, HEATED + OVER))
    assert read.states.over == {"mach": (0.6, 0.9), "level": (1.0, 2.0)}
    assert read.states.every[1] == {"mach": 0.6, "level": 2.0} and "over mach 0.6 0.9, level 1 2: 4 states" in str(
        read.describe()
    )
    assert float(read.scene.skin.temperature[0]) == pytest.approx(288.15, abs=0.01)  # the file as it is
    own = read.at(mach=0.9, level=2)
    assert float(own.scene.skin.temperature[0]) == pytest.approx(288.15 * (1 + 0.89 * 0.2 * 0.81), abs=0.01)
    assert own.scene.sources[0].irradiance.tolist() == pytest.approx([4.0, 0.2]) and own.states is None
    assert float(own.cameras[""].frame[2, 1]) == pytest.approx(0.5**0.5)
    with pytest.raises(ValueError, match="over: got mach, expected mach, level"):
        read.at(mach=0.9)
    with pytest.raises(ValueError, match="over.mach: got 0.7, expected one of"):
        read.at(mach=0.7, level=1)


TWICE = "[over.a]\nvalues = [300]\nkeys = ['skin.temperature']\n[over.b]\nvalues = [1, 2]\nkeys = ['KEY']"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[over.mach]\nvalues = [1, 1]\nkeys = ['x']", r"over.mach.values: got \[1, 1\], expected different numbers"),
        ("[over.mach]\nvalues = [1]", "over.mach: got .* expected keys or tables"),
        ("[over.azimuth_deg]\nvalues = [1]\nkeys = ['x']", "expected a name of letters, .* got 'azimuth_deg'"),
        ("[over.MWIR_W_per_sr]\nvalues = [1]\nkeys = ['x']", "expected a name of letters, .* got 'MWIR_W_per_sr'"),
        ("[over.azimuth]\nvalues = [1]\nkeys = ['x']", "expected a name of letters, .* got 'azimuth'"),
        ("[over.t]\nvalues = [1, 2]\ntables = { 'skin.temperature' = [300.0] }", "expected 2 values, one for each of"),
        ("[over.t]\nvalues = [1]\nkeys = ['sources[3].irradiance']", r"got the key 'sources\[3\].irradiance', .* no 3"),
        ("[over.t]\nvalues = [1]\nkeys = ['skin.parts.a']", "it has no 'parts' there"),
        ("[over]", "over: got .* expected at least one table, as over.mach"),
        ("[over.t]\nvalues = [1]\nkeys = ['.']", "over.t: got the key '.', expected one as sources"),
        ("[over.t]\nvalues = [1]\nkeys = ['[]']", r"over.t: got the key '\[\]', expected one as sources"),
        ("[over.t]\nvalues = [300]\nkeys = ['skin..temperature']", "got the key 'skin..temperature', expected one as"),
        ("[over.t]\nvalues = [300]\nkeys = ['skin.temprature']", "skin.temprature: unknown key, .*mean temperature"),
        (TWICE.replace("KEY", "skin.temperature"), "over.b: got the key 'skin.temperature', expected one apart from"),
        (TWICE.replace("KEY", "skin"), "over.b: got the key 'skin', expected one apart from 'skin.temperature'"),
        (
            "[over.t]\nvalues = [9]\nkeys = ['skin.temperature']\ntables = { 'skin.temperature' = [9] }",
            "over.t.tables.skin.temperature: got .* expected no values: 'skin.temperature' is among over.t.keys",
        ),
    ],
)
def test_what_varies_nothing_is_refused(tmp_path, text, message):
    with pytest.raises(ValueError, match=message):
        load_scene(write_scene(tmp_path, TEXT + text))


def test_a_value_that_does_not_fit_names_its_key(tmp_path):
    read = load_scene(write_scene(tmp_path, TEXT + "[over.t]\nvalues = [300, -1]\nkeys = ['skin.temperature']"))
    with pytest.raises(ValueError, match=r"skin.temperature: got -1, expected temperatures > 0 K"):
        read.at(t=-1)
    with pytest.raises(ValueError, match="got no section over, expected it for t"):
        load_scene(write_scene(tmp_path)).at(t=1)


def test_integers_stay_integers_and_an_axis_may_have_any_name(tmp_path):
    read = load_scene(write_scene(tmp_path, TEXT + "[over.self]\nvalues = [2, 4]\nkeys = ['signature.samples']"))
    assert [read.at(**state).signature["samples"] for state in read.states.every] == [2, 4]


@pytest.mark.parametrize("key", ["bands", "bands[0].lower", "signature", "signature.views", "signature.views.azimuth"])
def test_what_may_not_vary_is_refused_at_in_and_around_its_key(key):
    states = States(Entry(Path("a.toml"), "", {}), {"t": Axis((1.0,), {"skin.temperature": [1], key: [1]})})
    with pytest.raises(ValueError, match=rf"a.toml: over.t: got the key '{re.escape(key)}', expected others: why"):
        states.refuse(("bands", "signature.views"), "why")
    states.refuse(("method", "signature.samples") if key != "signature" else ("method",), "why")


def test_the_example_s_states_are_scenes():
    read = load_scene(Path(jaxir.__file__).parents[1] / "examples" / "envelope.toml")
    own = read.at(mach=0.9, altitude=9000, throttle=1).scene
    held = {name: float(own.skin.temperature[own.skin.part == i][0]) for i, name in enumerate(own.skin.part_names)}
    assert held["nozzle"] == 700 and held["wings"] == pytest.approx(float(jaxir.air_temperature(9000.0, 0.9)))
    assert float(own.plume.exit_temperature) == 900 and float(own.atmosphere.target_altitude) == 9000
    assert len(read.states.every) == 8
