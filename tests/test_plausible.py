"""Values that are legal and hardly meant get one warning with field, value and likely unit; the usual ones get none."""

import importlib
import re
import subprocess
import sys
import warnings
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir._arrays import enforce
from jaxir._plausible import doubt, usual
from jaxir.command_line import main
from jaxir.fit import measured_intensity
from jaxir.io.scene_file import load_scene
from jaxir.optics.air import Profile
from jaxir.optics.gas import CrossSections
from jaxir.optics.particle import ParticleTable
from jaxir.scene.air import TableAtmosphere
from tests.io.scene_file.scene_text import TEXT, write_scene

ROOT = Path(jaxir.__file__).parents[1]
NODES = jaxir.gray_nodes((jaxir.MWIR,))
GRID = jaxir.Grid((-3.0, -0.5, -0.5), (0.5, 0.5, 0.5), (2, 2, 2))
HEIGHT, DEEP = np.linspace(0.0, 25e3, 5), np.geomspace(1e5, 2.5e3, 5)


def skin(temperature=300.0):
    return jaxir.Skin(jaxir.Mesh(np.eye(3), [[0, 1, 2]]), temperature, jaxir.Lambert(0.8))


def cloud(temperature=900.0, gas=None, particles=None):
    return jaxir.GridPlume(GRID, temperature, jaxir.GrayGas(1.0) if gas is None else gas, particles)


def burnt(pressure=26500.0, h2o=0.06, co2=0.06, extrapolate=False):
    return jaxir.NarrowBandGas(pressure, h2o=h2o, co2=co2, extrapolate=extrapolate)


def jet(leaving=900.0, still=223.0, diameter=0.5, gas=None):
    gas = jaxir.GrayGas(1.0) if gas is None else gas
    return jaxir.JetPlume((0.0, 0.0, 0.0), (-1.0, 0.0, 0.0), diameter, leaving, still, gas)


def tabulated(pressure=3e4, temperature=(300.0, 1500.0), extrapolate=False):
    table = CrossSections("CO2", NODES, temperature, [1e4, 1e5], [0.1], np.full((2, 2, 1, 1), 1e-24))
    return jaxir.CorrelatedK([table], pressure, {"CO2": 0.1}, extrapolate=extrapolate)


def soot(number):
    optics = ParticleTable([1000.0, 4000.0], [2e-12] * 2, [1e-12] * 2, 5e-19, [-1.0, 1.0], np.full((2, 2), 0.08))
    return jaxir.Particles(number, optics)


def profile(height=HEIGHT, pressure=DEEP, temperature=250.0):
    return Profile(height, np.full(5, temperature), pressure, np.full(5, 1e-4), np.full(5, 1e-6))


def said_of(build):
    """The doubts of a computation, those of what it is built from included."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        built = build()
        if hasattr(built, "checks"):
            enforce(jnp.zeros(1), built.checks())
    assert all(one.category is jaxir.PlausibilityWarning for one in caught)
    return [str(one.message) for one in caught]


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: skin(27.0), r"Skin.temperature: got 27.0 at .*, expected 100 to 6000 K .* degrees Celsius\?"),
        (lambda: cloud(600e3), "GridPlume.temperature: got 600000.0 .* 100 to 6000 K as a rule .8 such values.$"),
        (lambda: jaxir.BlackbodyBackground(15.0), "BlackbodyBackground.temperature: got 15.0, .* degrees Celsius"),
        (lambda: jaxir.Band("MWIR", 3000, 5000), "Band 'MWIR': got 3000.0, expected 0.1 to 100 um .* nm or cm-1"),
        (lambda: jaxir.Band("MWIR", 3e-6, 5e-6), "Band 'MWIR': got 5e-06, expected 0.1 to 100 um .* in m"),
        (lambda: jaxir.StandardAtmosphere(10e3, 10e3, 5.0), "StandardAtmosphere.distance: got 5.0, .* in km"),
        (lambda: jaxir.StandardAtmosphere(20.0, 20.0, 5e3), "StandardAtmosphere.target_altitude: got 20.0, .* in km"),
        (lambda: jaxir.UniformAtmosphere(1e-4, 5.0), "UniformAtmosphere.distance: got 5.0, .* is it in km"),
        (lambda: jaxir.UniformAtmosphere(1e-4, 5e3, 15.0), "UniformAtmosphere.temperature: got 15.0, .* Celsius"),
        (lambda: TableAtmosphere([3.0, 5.0], [0.5, 0.5]), "TableAtmosphere.wavenumber: got 3.0 .* is it in um"),
        (lambda: TableAtmosphere([990.0, 1010.0], [0.5] * 2, [3.0, 3.0]), "path_radiance: got 3.0.* is it per um"),
        (lambda: profile(height=HEIGHT / 1e3), "Profile: highest altitude: got 25.0, .* is it in km"),
        (lambda: profile(pressure=DEEP / 1e2), "Profile: highest pressure: got 1000.0, .* is it in hPa"),
        (lambda: profile(temperature=15.0), "Profile.temperature: got 15.0 .* degrees Celsius.*5 such values"),
        (lambda: cloud(gas=burnt(0.265)), "NarrowBandGas.pressure: got 0.265, expected 2000 to 5e.06 Pa .* bar or atm"),
        (lambda: cloud(gas=burnt(1013.0)), "NarrowBandGas.pressure: got 1013.0, .* is it in hPa"),
        (lambda: cloud(gas=burnt(h2o=0.05, co2=0.127)), "NarrowBandGas.h2o: got 0.05, .* are these mass fractions"),
        (lambda: jet(223.0, 900.0), "JetPlume.exit_temperature: got 223.0, .* at least ambient_temp.* swapped"),
        (lambda: jet(diameter=500.0), "JetPlume.diameter: got 500.0, .* is it in mm"),
        (lambda: cloud(particles=soot(100.0)), "Particles.number_density: got 100.0, .* is it in cm-3"),
        (lambda: cloud(particles=soot(1e19)), "Particles.number_density: got 1e.19, .* 1 % of the volume"),
        (lambda: jaxir.ParallelSource((0.0, 0.0, -1.0), 1e5), "ParallelSource.irradiance: got 100000.0 .* Sun gives"),
        (lambda: jaxir.ElevationTable([-90.0, 180.0], [1.0, 1.0]), "ElevationTable.elevation: got 180.0 .* azimuth"),
        (lambda: jaxir.orthographic_camera(0, 180, 0.1, (4, 4)), "elevation: got 180.0, expected -90 to 90 deg"),
        (lambda: jaxir.perspective_camera(0, 0, 5e3, 0.5, (4, 4)), "angular_resolution: got 0.5, .* in degrees"),
        (lambda: jaxir.Mesh(1e4 * np.eye(3), [[0, 1, 2]]) and None, "Mesh: longest side: got 10000.0, .* in mm"),
        (lambda: jaxir.Mesh(1e-2 * np.eye(3), [[0, 1, 2]]) and None, "Mesh: longest side: got 0.01, .* in km"),
        (lambda: jaxir.Grid((0.0, 0.0, 0.0), (100.0, 1.0, 1.0), (50, 2, 2)), "Grid: longest side: got 5000.0, .* mm"),
    ],
)
def test_what_is_hardly_meant_is_said_once(build, message):
    said = said_of(build)
    assert len(said) == 1 and re.search(message, said[0]), said


def air(*path, extrapolate):
    return jaxir.StandardAtmosphere(*path, extrapolate=extrapolate)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (
            lambda told: cloud(3000.0, burnt(extrapolate=told)),
            "GridPlume.temperature: got 3000.0 .* 200 to 2500 K, for which NarrowBandGas was made",
        ),
        (
            lambda told: jet(900.0, 150.0, gas=burnt(extrapolate=told)),
            "JetPlume.ambient_temperature: got 150.0, expected 200 to 2500 K",
        ),
        (
            lambda told: cloud(1800.0, tabulated(extrapolate=told)),
            "GridPlume.temperature: got 1800.0 .* 200 to 1500 K, for which the table of CO2 was made",
        ),
        (
            lambda told: cloud(gas=tabulated(5e3, extrapolate=told)),
            "CorrelatedK.pressure: got 5000.0, expected 10000 to 100000 Pa",
        ),
        (
            lambda told: air(20e3, 10e3, 50e3, extrapolate=told),
            "StandardAtmosphere.sensor_altitude: got 20000.0, expected at most 12000 m, for which the fit",
        ),
        (
            lambda told: air(9e3, 9e3, 90e3, extrapolate=told),
            "StandardAtmosphere.distance: got 90000.0, expected at most 60000 m",
        ),
    ],
)
def test_a_model_beyond_what_it_was_made_for_refuses_unless_told_to_extrapolate(build, message):
    with pytest.raises(ValueError, match=f"{message}.*; extrapolate=True goes on beyond"):
        enforce(jnp.zeros(1), build(False).checks())
    said = said_of(lambda: build(True))
    assert len(said) == 1 and re.search(message, said[0]) and "extrapolate" not in said[0]


def test_iterates_inside_jit_may_pass_beyond_a_table():
    assert all(jax.jit(lambda t: [check.ok for check in cloud(t, burnt()).doubts()])(3000.0))


@pytest.mark.parametrize(
    "build",
    [
        skin,
        lambda: cloud(600.0, burnt(np.full((2, 2, 2), 101325.0))),
        lambda: cloud(gas=burnt(h2o=0.0, co2=0.0)),
        lambda: cloud(gas=burnt(h2o=0.001, co2=0.0025)),  # traces may have any ratio
        lambda: cloud(
            gas=jaxir.NarrowBandGas(
                2.6e4, h2o=np.full((2, 2, 2), 0.02), co2=np.linspace(0.02, 0.05, 8).reshape(2, 2, 2)
            )
        ),
        lambda: cloud(1500.0, tabulated(1e4)),
        lambda: cloud(particles=soot(np.linspace(0.0, 1e10, 8).reshape(2, 2, 2))),
        lambda: cloud(particles=soot(0.0)),
        jet,
        lambda: jet(223.0, 223.0, gas=burnt()),
        lambda: jaxir.StandardAtmosphere(0.0, 10e3, 12e3),
        lambda: jaxir.StandardAtmosphere(2.0, 0.0, 500.0, profile()),
        lambda: jaxir.UniformAtmosphere(1e-4, 0.0),
        lambda: jaxir.Band("everything", 0.05, 2e4),
        lambda: jaxir.orthographic_camera(540.0, -90.0, 0.1, (4, 4)),
        lambda: jaxir.ParallelSource((0.0, 0.0, -1.0), [0.0, 1361.0]),
    ],
)
def test_the_usual_is_not_doubted(build):
    assert said_of(build) == []


def test_every_entry_says_it_and_an_error_comes_first():
    scene, camera = jaxir.Scene(skin(27.0)), jaxir.orthographic_camera(0.0, 0.0, 0.5, (4, 4))
    for entry in (
        lambda: jaxir.render(scene, camera, jaxir.MWIR, samples=2),
        lambda: jaxir.unoccluded_intensity(scene, 0.0, 0.0, jaxir.MWIR),
        lambda: jaxir.signature(scene, [[0.0, 0.0]] * 2, jaxir.MWIR, shape=(4, 4)),
        lambda: measured_intensity(scene, [[0.0, 0.0]], jaxir.MWIR, [[1.0]], 0.1, shape=(4, 4)),
        lambda: jax.grad(lambda t: jaxir.unoccluded_intensity(jaxir.Scene(skin(t)), 0.0, 0.0, jaxir.MWIR)[0])(27.0),
    ):
        assert [text[:26] for text in said_of(entry)] == ["Skin.temperature: got 27.0"]
    views = [[0.0, 0.0], [180.0, 180.0]]
    said = said_of(lambda: jaxir.signature(jaxir.Scene(skin()), views, jaxir.MWIR, shape=(4, 4)))
    assert len(said) == 1 and said[0].startswith("views: elevation: got 180.0 at index [1]")
    with warnings.catch_warnings(), pytest.raises(ValueError, match="GrayGas.coefficient: got -1.0"):
        warnings.simplefilter("error")
        jaxir.render(jaxir.Scene(skin(27.0), cloud(gas=jaxir.GrayGas(-1.0))), camera, jaxir.MWIR)


def test_jit_says_nothing_of_what_it_does_not_know():
    @eqx.filter_jit
    def intensity(temperature):
        return jaxir.unoccluded_intensity(jaxir.Scene(skin(temperature)), 0.0, 0.0, jaxir.MWIR)

    def primitives(temperature):
        return [str(e.primitive) for e in jax.make_jaxpr(lambda t: usual(1, 2, "m")("x", t).value)(temperature).eqns]

    assert said_of(lambda: intensity(jnp.asarray(27.0))) == []
    assert primitives(jnp.asarray(27.0)) == []
    assert doubt("x", np.less, "", jnp.asarray(2.0), jnp.asarray(1.0)).ok == False  # noqa: E712


def test_who_asks_may_refuse_it():
    with warnings.catch_warnings(), pytest.raises(jaxir.PlausibilityWarning, match="Skin.temperature: got 27.0"):
        warnings.simplefilter("error", jaxir.PlausibilityWarning)
        jaxir.unoccluded_intensity(jaxir.Scene(skin(27.0)), 0.0, 0.0, jaxir.MWIR)


def test_examples_are_not_doubted():
    paths = sorted((ROOT / "examples").glob("*.toml"))
    assert len(paths) == 5
    for path in paths:
        assert said_of(lambda path=path: load_scene(path).scene) == [], path


BY_HAND = """
import numpy as np
import jaxir
from jaxir.fit import fit
mesh = jaxir.Mesh(np.eye(3), [[0, 1, 2]])
cold = jaxir.Scene(jaxir.Skin(mesh, 27.0, jaxir.Lambert(0.8)))
for _ in range(2):
    jaxir.unoccluded_intensity(cold, 0.0, 0.0, jaxir.MWIR)
for wrong in (
    lambda: jaxir.Skin(mesh, 300.0, 0.8),
    lambda: jaxir.Skin(mesh, 300.0, np.ones(3)),
    lambda: jaxir.Skin("a.stl", 300.0, jaxir.Lambert(0.8)),
    lambda: jaxir.GridPlume(jaxir.Grid((0, 0, 0), (1, 1, 1), (1, 1, 1)), 900.0, 0.5),
    lambda: jaxir.JetPlume((0, 0, 0), (-1, 0, 0), 0.5, 900.0, 223.0, 0.5),
    lambda: fit(cold, [], np.ones((1, 1))),
    lambda: fit(cold, [], [np.ones((1, 1))]),
):
    try:
        wrong()
    except ValueError as error:
        print(error)
"""


def test_errors_of_kind_are_clear_and_a_warning_is_once_at_the_line_of_its_user(tmp_path):
    """In a process of its own: here the type checker of the tests would come first."""
    script = tmp_path / "by_hand.py"
    script.write_text(BY_HAND)
    ran = subprocess.run([sys.executable, script], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    warned = [line for line in ran.stderr.splitlines() if "PlausibilityWarning" in line]
    assert len(warned) == 1 and warned[0].startswith(f"{script}:8: PlausibilityWarning: Skin.temperature: got 27.0")
    expected = [
        "Skin.brdf: got 0.8, expected a brdf, e.g. jaxir.Lambert(0.8)",
        "Skin.brdf: got a ndarray, expected a brdf, e.g. jaxir.Lambert(...)",
        "Skin.mesh: got 'a.stl', expected a mesh",
        "GridPlume.gas: got 0.5, expected a gas, e.g. jaxir.GrayGas(0.5)",
        "JetPlume.gas: got 0.5, expected a gas, e.g. jaxir.GrayGas(0.5)",
        "measurements: got a ndarray, expected a list, each of them made by jaxir.fit.measured_image",
        "measurements[0]: got a ndarray, expected one made by jaxir.fit.measured_image",
    ]
    said = ran.stdout.splitlines()
    assert len(said) == len(expected)
    assert [one[: len(want)] for one, want in zip(said, expected, strict=True)] == expected


def test_the_command_says_it_on_one_line_once(tmp_path, capsys):
    scene = write_scene(tmp_path, TEXT.replace("temperature = 250", "temperature = 15"))
    assert main(["render", str(scene), "-q", "apparent", "-q", "source", "-o", str(tmp_path / "image.npz")]) == 0
    said = [line for line in capsys.readouterr().err.splitlines() if "warning" in line]
    assert len(said) == 1 and said[0].startswith("jaxir: warning: BlackbodyBackground.temperature: got 15.0, expected")


NEAR = TEXT.replace("orthographic", "perspective").replace("pixel =", "distance = 0.5\nangular_resolution =")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (NEAR, r"Camera: \(radius of the scene about the target\) / distance: got"),
        (TEXT + "distance = 0.5", r"Camera: \(radius of the scene about the target\) / distance: got"),
        (TEXT.replace("elevation = [-30, 30]", "elevation = []"), r"views: got shape \(0, 2\)"),
        (TEXT.replace("samples = 2", "samples = 3"), "samples: got 3, expected an even number"),
        (TEXT.replace("samples = 2", "rtol = -1.0"), "rtol: got -1.0, expected > 0"),
        (TEXT.replace("[2.0, 0.1]", "[2.0, 0.1, 1.0]"), "ParallelSource.irradiance: got 3 spectral values"),
        (TEXT[: TEXT.index("[camera]")].replace("[2.0, 0.1]", "[2.0, 0.1, 1.0]"), "irradiance: got 3 spectral values"),
        (TEXT[: TEXT.index("[camera]")].replace("0.8", "1.8"), "Lambert.emissivity: got 1.8"),
        (
            TEXT + '\n[over.size]\nvalues = [10, -10]\nkeys = ["camera.pixel"]\n',
            "size=-10: .*pixel: got -10.0, expected finite values > 0",
        ),
    ],
)
def test_show_refuses_what_render_and_signature_would(text, message, tmp_path, capsys):
    assert main(["show", str(write_scene(tmp_path, text))]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and re.search(f"^jaxir: .*scene.toml: .*{message}", said), said


def test_show_looks_at_the_file_that_render_takes_beside_its_states(tmp_path, capsys):
    text = (
        TEXT.replace("temperature = 300.0", "temperature = 1e30")
        + "[over.t]\nvalues = [300]\nkeys = ['skin.temperature']"
    )
    assert "1e30" in text
    assert main(["show", str(write_scene(tmp_path, text))]) == 1
    assert "Skin.temperature: got 1e+30" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("part", "covers"),
    [
        (lambda: jaxir.StandardAtmosphere(0.0, 10e3, 12e3), "StandardAtmosphere, 800 to 10000 cm-1 .1 to 12.5 um."),
        (lambda: TableAtmosphere([2000.0, 2500.0], [0.5, 0.5]), "TableAtmosphere, 2000 to 2500 cm-1 .4 to 5 um."),
        (lambda: soot(1e9), "Particles, 1000 to 4000 cm-1 .2.5 to 10 um."),
        (burnt, "NarrowBandGas, 800 to 9300 cm-1 .1.075 to 12.5 um. or above"),
    ],
)
def test_a_bin_beyond_a_table_is_told_what_it_covers_and_what_was_asked(part, covers):
    asked = r"; asked were 714.29 to 769.23 cm-1 \(13 to 14 um\)"
    with pytest.raises(ValueError, match=f"expected bins inside the table of {covers}{asked}"):
        enforce(jnp.zeros(1), part().node_checks(jaxir.gray_nodes((jaxir.Band("far", 13.0, 14.0),))))


class ComputedError(Exception):
    """What there is to say was said before."""


@pytest.fixture
def uncomputed(monkeypatch):
    """Images and signatures raise `ComputedError` in the place of their first ray."""

    def computed(*_args, **_kwargs):
        raise ComputedError

    monkeypatch.setattr(importlib.import_module("jaxir.imaging._passes"), "even_image", computed)
    monkeypatch.setattr(importlib.import_module("jaxir.imaging._views"), "until_met", computed)


@pytest.mark.usefixtures("uncomputed")
@pytest.mark.parametrize("air", [jaxir.StandardAtmosphere(0.0, 1e3, 5e3), jaxir.UniformAtmosphere(1e-4, 5e3)])
def test_a_path_of_another_length_than_the_way_to_the_eye_is_doubted(air):
    """Before anything is computed."""
    scene = jaxir.Scene(skin(), atmosphere=air)

    def looks(distance):
        yield lambda: jaxir.render(scene, jaxir.perspective_camera(0, 0, distance, 1e-4, (2, 2)), jaxir.LWIR)
        yield lambda: jaxir.signature(scene, [[0.0, 0.0]], jaxir.LWIR, distance=distance)

    for look in looks(2e3):
        with pytest.warns(
            jaxir.PlausibilityWarning, match=f"{type(air).__name__}.distance: got 5000.0, expected about"
        ):
            with pytest.raises(ComputedError):
                look()
    far = jaxir.orthographic_camera(0, 0, 0.5, (2, 2))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for look in (*looks(5.2e3), lambda: jaxir.render(scene, far, jaxir.LWIR)):
            with pytest.raises(ComputedError):
                look()


@pytest.mark.usefixtures("uncomputed")
@pytest.mark.parametrize("parts", [{"skin": skin()}, {"plumes": (cloud(),)}, {"skin": skin(), "plumes": (cloud(),)}])
def test_pixels_in_which_few_rays_may_meet_the_target_are_doubted(parts):
    """Where none does, the image is nothing without an error. A plume beside a small skin is a target, too."""
    scene = jaxir.Scene(**parts)

    def look(pixel, samples):
        with pytest.raises(ComputedError):
            jaxir.render(scene, jaxir.orthographic_camera(-90, 0, pixel, (2, 2)), NODES, samples=samples)

    with pytest.warns(jaxir.PlausibilityWarning, match="samples: got 8, expected at least [1-9].* or rtol"):
        look(100.0, 8)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        look(1.0, 8)
        look(100.0, 2**18)
