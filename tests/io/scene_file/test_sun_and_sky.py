"""Sun and clear sky of a scene file."""

import pytest

import jaxir
from jaxir.io.scene_file import load_scene
from tests.io.scene_file.scene_text import TEXT, write_scene

START, END = TEXT.index("[[sources]]"), TEXT.index("[camera]")
AIR = """
[atmosphere]
type = "StandardAtmosphere"
sensor_altitude = 0.0
target_altitude = 9000.0
distance = 20000.0
"""
SKY = """
[[sources]]
type = "sun_at"
time = 2003-10-17T12:30:30-07:00
latitude = 39.742476
longitude = -105.1786
heading = 104.34

[background]
type = "ClearSky"
ground_temperature = 295.0
ground_emissivity = [0.95, 0.97]
"""


def read(folder, text):
    """The scene of a file with other lights, background and air."""
    return load_scene(write_scene(folder, TEXT[:START] + text + TEXT[END:])).scene


def test_sun_and_sky_take_altitude_and_air_from_the_scene(tmp_path):
    scene = read(tmp_path, SKY + AIR)
    sun, sky = scene.sources[0], scene.background
    assert (float(sun.azimuth), float(sun.elevation)) == pytest.approx((-90.0, 39.87), abs=0.02)
    assert float(sun.air.altitude) == float(sky.altitude) == 9000 and sky.sun is not None
    assert sky.ground_emissivity.tolist() == pytest.approx([0.95, 0.97])
    given = '[[sources]]\ntype = "Sun"\nelevation = 30\nazimuth = 10\nirradiance = [5, 0.5]\n'
    given += 'air = { type = "FixedPath", transmittance = 1 }\n'
    own = '[background]\ntype = "ClearSky"\naltitude = 100\nsun = { elevation = 30, azimuth = 0 }\n'
    scene = read(tmp_path, given + own)
    assert isinstance(scene.sources[0].air, jaxir.FixedPath) and float(scene.background.sun.elevation) == 30


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (SKY.replace("-07:00", ""), r"sources\[0\].time: got .* expected date and time with a zone"),
        (SKY.replace("39.742476", "139.7"), r"sources\[0\]: latitude: got 139.7, expected -90 to 90 degrees"),
        (SKY.replace("latitude", "latitute"), r"sources\[0\].latitute: unknown key, .*did you mean latitude"),
        (SKY + '[atmosphere]\ntype = "FixedPath"\ntransmittance = 1\n', "Sun.air: got none in a scene with FixedPath"),
    ],
)
def test_what_is_wrong_with_the_sun_is_one_line(text, message, tmp_path):
    with pytest.raises(ValueError, match=f"scene.toml: {message}") as found:
        read(tmp_path, text)
    assert "\n" not in str(found.value)
