"""A scene file says what the Python objects say; whatever is wrong with it is one line with file, key and cure."""

import inspect

import jax
import numpy as np
import pytest

import jaxir
from jaxir.io.field import load_flow
from jaxir.io.mesh import load_mesh
from jaxir.io.scene_file import Entry, combustion_gas, load_scene
from jaxir.io.scene_file import _vocabulary as vocabulary
from jaxir.io.spectra import KTables, save_k_tables
from jaxir.optics.gas import CrossSections
from tests.io.scene_file.scene_text import TEXT, write_npz, write_obj, write_scene

PARTS = """
bands = ["MWIR"]
[skin]
mesh = { path = "body.obj", unit = "mm" }
temperature = 300
brdf = { type = "Lambert", emissivity = 0.8 }
[[skin.parts]]
name = "wing"
temperature = { path = "wing.csv" }
[[skin.parts]]
name = "tail"
brdf = { type = "Lambert", emissivity = [[0.3]] }
[[skin.parts]]
name = "nozzle"
faces = [0]
brdf = { type = "RoughConductor", index = 3, extinction = 8, roughness = 0.3 }
"""


def test_a_file_makes_the_scene_that_python_makes(tmp_path):
    read = load_scene(write_scene(tmp_path))
    vertices = [[0, -0.5, -0.5], [0, 0.5, -0.5], [0, 0.5, 0.5], [0, -0.5, 0.5]]
    scene = jaxir.Scene(
        skin=jaxir.Skin(jaxir.Mesh(vertices, [[0, 1, 2], [0, 2, 3]]), 300.0, jaxir.Lambert(0.8)),
        sources=(jaxir.ParallelSource((-1, 0, 0), (2.0, 0.1)),),
        background=jaxir.BlackbodyBackground(250),
        atmosphere=jaxir.FixedPath(0.5, 0.1),
    )
    assert jax.tree.structure(read.scene) == jax.tree.structure(scene)
    for held, wanted in zip(jax.tree.leaves(read.scene), jax.tree.leaves(scene), strict=True):
        np.testing.assert_array_equal(held, wanted)
    camera = jaxir.orthographic_camera(0, 0, 0.125, (16, 16))
    np.testing.assert_array_equal(read.cameras[""].frame, camera.frame)
    assert read.names == ("MWIR", "LWIR") and read.render == {"samples": 2}
    assert read.signature["views"].shape == (10, 2) and read.signature["shape"] == (16, 16)
    assert "skin: 2 faces, 0 x 1 x 1 m, not closed" in read.describe()


def test_parts_have_materials_and_temperatures_of_their_own(tmp_path):
    write_obj(tmp_path / "body.obj", ("wing", "tail", "wing 2"))
    (tmp_path / "wing.csv").write_text("face,temperature\n1,420\n0,410\n")
    skin = load_scene(write_scene(tmp_path, PARTS)).scene.skin
    assert skin.part_names == ("wing", "tail", "wing 2", "nozzle")
    np.testing.assert_array_equal(skin.part, [3, 0, 1, 1, 2, 2])
    np.testing.assert_array_equal(skin.temperature, [410, 420, 300, 300, 300, 300])
    np.testing.assert_allclose(skin.mesh.vertices[4], [-1e-3, -0.5e-3, -0.5e-3], rtol=1e-6)
    # the two kinds of Lambert skin became one with an emissivity per face
    assert [type(kind) for kind in skin.brdf.kinds] == [jaxir.Lambert, jaxir.RoughConductor]
    lambert = skin.brdf.kinds[0]
    np.testing.assert_allclose(lambert.emissivity[1:, 0], [0.8, 0.3, 0.3, 0.8, 0.8], rtol=1e-6)


def test_every_reader_is_of_a_parameter_that_exists():
    """A misspelt reader would never be used, and its values be read as numbers."""
    skip = ("READERS", "RENDER_READERS")
    tables = {n: v for n, v in vars(vocabulary).items() if n.isupper() and isinstance(v, dict) and n not in skip}
    made = [one for table in tables.values() for one in table.values() if callable(one)]
    made += [jaxir.render, jaxir.signature, jaxir.Method, jaxir.resolved_nodes, jaxir.Grid]
    made += [jaxir.DiscreteOrdinates, jaxir.Skin, jaxir.sensor_band, jaxir.JetPlume, load_mesh, load_flow]
    names = {name for one in made for name in inspect.signature(one).parameters}
    assert set(vocabulary.RENDER_READERS) <= names


JET = """
[plumes]
type = "JetPlume"
nozzle = [-1, 0, 0]
axis = [-1, 0, 0]
diameter = 0.5
exit_temperature = 1000
ambient_temperature = 250
gas = { type = "combustion_gas", pressure = 26500, carbon = 12, hydrogen = 23, equivalence_ratio = 0.4 }
"""
GRID = """
[plumes]
type = "GridPlume"
grid = { origin = [-3, -0.5, -0.5], spacing = [0.5, 0.5, 0.5], shape = [2, 2, 2] }
temperature = { path = "flow.npz", array = "T" }
gas = { type = "GrayGas", coefficient = { path = "flow.npz", array = "kappa" } }
"""


def test_plumes_from_parameters_and_from_arrays(tmp_path):
    jet = load_scene(write_scene(tmp_path, TEXT + JET)).scene.plume
    same = combustion_gas(26500, 12, 23, 0.4)
    assert jet.panels == 4
    np.testing.assert_allclose(jax.tree.leaves(jet.gas), jax.tree.leaves(same), rtol=1e-6)
    field = np.arange(8.0).reshape(2, 2, 2)
    write_npz(tmp_path / "flow.npz", T=500 + field, kappa=field)
    grid = load_scene(write_scene(tmp_path, TEXT + GRID)).scene.plume
    np.testing.assert_allclose(grid.temperature, 500 + field)
    np.testing.assert_allclose(grid.gas.coefficient, field[..., None])


def test_several_plumes_are_tables_of_one_name(tmp_path, monkeypatch):
    resolve = "jaxir.io.scene_file._scene_files.resolve_jet"  # has its own tests
    far = jaxir.JetPlume((9, 9, 9), (1, 0, 0), 1, 900, 250, jaxir.GrayGas(1))
    monkeypatch.setattr(resolve, lambda jet, bands, tolerance: far)
    write_npz(tmp_path / "flow.npz", T=np.full((2, 2, 2), 500.0), kappa=np.ones((2, 2, 2)))
    both = (TEXT + JET + GRID).replace("[plumes]", "[[plumes]]")
    read = load_scene(write_scene(tmp_path, both))
    jet, grid = read.scene.plumes
    assert isinstance(jet, jaxir.JetPlume) and isinstance(grid, jaxir.GridPlume)
    np.testing.assert_array_equal(jet.nozzle, [-1, 0, 0])
    np.testing.assert_array_equal(grid.temperature, np.full((2, 2, 2), 500.0))
    described = read.describe()
    assert "plume: JetPlume of NarrowBandGas" in described and "plume: GridPlume of GrayGas" in described
    fine, same = load_scene(write_scene(tmp_path, both + "[resolve_jet]\ntolerance = 1e-2")).scene.plumes
    np.testing.assert_array_equal(fine.nozzle, [9, 9, 9])  # jets alone are resolved
    np.testing.assert_array_equal(same.temperature, grid.temperature)
    with pytest.raises(ValueError, match=r"plumes\[1\].temperature.path: got 'no.npz', expected a file"):
        load_scene(write_scene(tmp_path, both.replace('"flow.npz", array = "T"', '"no.npz", array = "T"')))


METHOD = """
[[sources]]
type = "UniformBackground"
radiance = [3.0, 4.0]
[method]
direct = { lights = 2, brdfs = 0 }
bounces = 1
sampler = { type = "Sobol" }
ambient = [0.5, 0.25]
skin_light = { exponent = 8.0 }
plume_light = {}
"""


def test_how_light_is_found_is_one_table(tmp_path):
    read = load_scene(write_scene(tmp_path, TEXT.replace("[background]", METHOD + "[background]")))
    wanted = jaxir.Method(
        jaxir.DirectSampling(2, 0), 1, 10, jaxir.Sobol(), (0.5, 0.25), jaxir.SkinLight(8.0), jaxir.PlumeLight()
    )
    assert jax.tree.structure(read.method) == jax.tree.structure(wanted)
    for held, value in zip(jax.tree.leaves(read.method), jax.tree.leaves(wanted), strict=True):
        np.testing.assert_array_equal(held, value)
    assert [type(source) for source in read.scene.sources] == [jaxir.ParallelSource, jaxir.UniformBackground]
    assert load_scene(write_scene(tmp_path)).method is None
    assert load_scene(write_scene(tmp_path, TEXT + '[method]\ndirect = "none"')).method == jaxir.Method(None)
    closed = load_scene(write_scene(tmp_path, TEXT + '[method]\ndirect = { type = "ClosedForm" }')).method
    assert closed.direct == jaxir.ClosedForm()


LIGHTS = """
[[sources]]
type = "ParallelSource"
direction = [0, 0, -1]
irradiance = { type = "BlackbodySpectrum", temperature = 5772, factor = 6.794e-5 }
[[sources]]
type = "PointSource"
position = [0, 0, 9]
intensity = { type = "TabulatedSpectrum", wavelength = [1, 20], value = [3, 3] }
[[sources]]
type = "ElevationTable"
elevation = [-90, 90]
radiance = { type = "BlackbodySpectrum", temperature = [290, 230] }
"""


def test_light_by_its_spectrum(tmp_path):
    """Where numbers stand for light, a table with a type says how it goes with the wavelength."""
    text = TEXT.replace("[background]", LIGHTS + "[background]")
    nodes = jaxir.gray_nodes((jaxir.MWIR,))
    sources = load_scene(write_scene(tmp_path, text)).scene.sources
    sun, lamp, sky = (light.on(nodes) for light in sources[1:])
    black = [jaxir.band_radiance(jax.numpy.asarray(t), nodes) for t in (5772.0, 290.0, 230.0)]
    np.testing.assert_allclose(sun.irradiance, 6.794e-5 * black[0], rtol=1e-6)
    np.testing.assert_allclose(lamp.intensity, [6.0], rtol=1e-6)
    np.testing.assert_allclose(sky.radiance, black[1:], rtol=1e-6)
    wrong = text.replace("factor", "solid_angle")
    with pytest.raises(ValueError, match=r"sources\[1\].irradiance.solid_angle: unknown key, expected .*factor"):
        load_scene(write_scene(tmp_path, wrong))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (JET.replace("plumes", "plume"), r"plume: got \{'type': 'JetPlume'.*expected the key plumes, "),
        ("[reflection]\nbounces = 1", r"reflection: got \{'bounces': 1\}, expected the key method, "),
        (
            "[scattering]\norders = 3",
            r"scattering: got \{'orders': 3\}, expected the key method, with its key orders, ",
        ),
    ],
    ids=["plume", "reflection", "scattering"],
)
def test_a_key_of_the_first_version_names_the_one_that_took_its_place(old, new, tmp_path):
    with pytest.raises(ValueError, match=r"scene.toml: " + new + "which took its place in version 0.2$") as caught:
        load_scene(write_scene(tmp_path, TEXT + old))
    assert "\n" not in str(caught.value)


PARTICLES = """
[plumes.particles]
type = "Particles"
number_density = 1e9
table = { type = "mie_table", diameter = 2.0, index = { n = 2.0, k = 5e-5 }, wavelength = [2.5, 5.5, 13], angles = 19 }
[method]
orders = 3
"""


def test_particles_and_how_often_they_scatter(tmp_path):
    pytest.importorskip("miepython")
    read = load_scene(write_scene(tmp_path, TEXT + JET + PARTICLES))
    table = jaxir.mie_table(2.0, 2.0 - 5e-5j, [2.5, 5.5, 13], angles=19)
    np.testing.assert_allclose(read.scene.plume.particles.table.scattering, table.scattering, rtol=1e-6)
    assert read.method.orders == 3 and "JetPlume of NarrowBandGas with Particles" in read.describe()
    gray = (
        PARTICLES[: PARTICLES.index("type")]
        + """
type = "GrayParticles"
extinction = 0.5
albedo = 0.9
phase = { type = "HenyeyGreenstein", asymmetry = 1.5 }
"""
    )
    with pytest.raises(ValueError, match=r"plumes.particles.phase: HenyeyGreenstein.asymmetry: got 1.5"):
        load_scene(write_scene(tmp_path, TEXT + JET + gray))


K_GAS = """
bands = { type = "k_nodes", path = "k.npz" }
[plumes]
type = "GridPlume"
grid = { origin = [0, 0, 0], spacing = [1, 1, 1], shape = [1, 1, 1] }
temperature = 900
gas = { type = "CorrelatedK", tables = { path = "k.npz" }, pressure = 1e5, mole_fractions = { CO2 = 0.1 } }
"""


FEW = """
bands = { type = "optimal_nodes", bands = ["MWIR"], rtol = 0.05 }
[plumes]
type = "GridPlume"
grid = { origin = [0, -0.5, -0.5], spacing = [0.4, 1, 1], shape = [1, 1, 1] }
temperature = 900
gas = { type = "NarrowBandGas", pressure = 5e4, h2o = 0.1, co2 = 0.1 }
[atmosphere]
type = "StandardAtmosphere"
sensor_altitude = 0
target_altitude = 0
distance = 5e3
"""


def test_few_nodes_are_chosen_for_the_scene_of_the_file(tmp_path):
    read = load_scene(write_scene(tmp_path, FEW))
    nodes = jaxir.optimal_nodes(read.scene, jaxir.MWIR, 0.05)
    for held, wanted in zip(jax.tree.leaves(read.bands), jax.tree.leaves(nodes), strict=True):
        np.testing.assert_array_equal(held, wanted)
    assert f"bands: MWIR on {nodes.count} nodes" in read.describe() and nodes.count < 60
    for wrong, message in (
        (FEW.replace("0.05 }", "0 }"), "bands: optimal_nodes: got rtol 0.0, expected a number > 0"),
        (FEW + '[over]\n"plumes.temperature" = [800, 900]\n', "bands: got .* expected bands, or nodes .* beside over"),
    ):
        with pytest.raises(ValueError, match=message):
            load_scene(write_scene(tmp_path, wrong))


def test_gas_from_tables_of_cross_sections(tmp_path):
    nodes = jaxir.resolved_nodes(jaxir.Band("b", 4.2, 4.4), width=100.0, points=2, pair_points=0)
    sigma = np.full((2, 1, 1, nodes.count), 1e-22)
    table = CrossSections("CO2", nodes, [300.0, 1500.0], [1e5], [0.1], sigma)
    save_k_tables(tmp_path / "k.npz", KTables(nodes, (table,), None, "made up"))
    read = load_scene(write_scene(tmp_path, K_GAS))
    assert read.bands.count == nodes.count and isinstance(read.scene.plume.gas, jaxir.CorrelatedK)
    for text, message in (
        (
            K_GAS.replace("CO2 =", "CO ="),
            "plumes.gas: CorrelatedK.mole_fractions: got .'CO'., expected some of .'CO2'.",
        ),
        (K_GAS + '[atmosphere]\ntype = "k_air"\npath = "k.npz"', "atmosphere: .*k.npz: holds no air"),
        (
            K_GAS.replace('tables = { path = "k.npz" }', 'tables = { path = "cut.npz" }'),
            "cut.npz: not readable",
        ),
    ):
        (tmp_path / "cut.npz").write_bytes((tmp_path / "k.npz").read_bytes()[:300])
        with pytest.raises(ValueError, match=message):
            load_scene(write_scene(tmp_path, text))


def test_a_plume_from_a_flow_field(tmp_path):
    pyvista = pytest.importorskip("pyvista")
    data = pyvista.ImageData(dimensions=(3, 3, 3), spacing=(0.5, 0.5, 0.5))
    data.cell_data["T"] = np.linspace(400, 800, 8)
    data.save(tmp_path / "flow.vti")
    flow = """
[plumes]
type = "GridPlume"
flow = { path = "flow.vti", unit = "m", shape = [2, 2, 2], fields = { T = 300.0 } }
temperature = { field = "T" }
gas = { type = "GrayGas", coefficient = 0.5 }
"""
    read = load_scene(write_scene(tmp_path, TEXT + flow))
    assert sorted(np.unique(read.scene.plume.temperature)) == pytest.approx(np.linspace(400, 800, 8))
    assert any("plumes.flow: T: rms" in note for note in read.notes)
    wrong = flow.replace('field = "T"', 'field = "TT"')
    with pytest.raises(ValueError, match=r"plumes.temperature.field: got .TT., expected one of T \(did you mean T\?\)"):
        load_scene(write_scene(tmp_path, TEXT + wrong))


def _but(old, new):
    assert old in TEXT
    return TEXT.replace(old, new, 1)


HUGE = "shape = [100000, 100000]"
PATH = 'type = "FixedPath"\ntransmittance = 0.5\npath_radiance = 0.1'
FAR = 'type = "StandardAtmosphere"\nsensor_altitude = 0\ntarget_altitude = 9e3\ndistance = 90e3'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("bands = [\n", r"scene.toml: not readable as TOML \(.*at end of document|line"),
        (TEXT[: TEXT.index("[atmosphere]") + 30], "scene.toml: not readable as TOML"),
        ("", "scene.toml: got no key bands"),
        ('bands = ["MWIR"]', "scene.toml: Scene: got neither skin nor plume"),
        (
            TEXT + "[atmosfere]\n",
            r"scene.toml: atmosfere: unknown key, expected one of .*\(did you mean atmosphere\?\)",
        ),
        (
            _but("emissivity", "emisivity"),
            r"skin.brdf.emisivity: unknown key, expected .*\(did you mean emissivity\?\)",
        ),
        (_but('"Lambert"', '"Lambertian"'), r"skin.brdf.type: got 'Lambertian', .*\(did you mean Lambert\?\)"),
        (_but('type = "Lambert", ', ""), "skin.brdf: got no key type, expected one of Lambert, Sand"),
        (_but("temperature = 300.0", ""), "skin: got no temperature for face 0, of part 'skin'"),
        (_but("temperature = 300.0", "temperature = nan"), "skin.temperature: got nan, expected a finite number"),
        (_but("temperature = 300.0", "temperature = '300 K'"), "skin.temperature: got '300 K', expected a finite num"),
        (_but("temperature = 300.0", "temperature = -20"), "skin.temperature: got -20, expected temperatures > 0 K"),
        (
            _but("temperature = 300.0", "temperature = [300, 301, 302]"),
            r"skin.temperature: .* expected one number or 2",
        ),
        (
            _but("temperature = 300.0", "temperature = { path = 'no.csv' }"),
            "temperature.path: got 'no.csv', expected a f",
        ),
        (_but("= 0.8", "= 1.8"), r"scene.toml: skin.brdf: Lambert.emissivity: got 1.8 .*expected values in \[0, 1\]"),
        (_but("[2.0, 0.1]", "[2.0, true]"), r"sources\[0\].irradiance\[1\]: got True, expected a finite number"),
        (_but("[2.0, 0.1]", "[2.0, [0.1]]"), r"sources\[0\].irradiance\[1\]: got \[0.1\], expected as many numbers"),
        (_but("[-1, 0, 0]", "[-1, 0]"), r"sources\[0\]: ParallelSource.direction: got shape \(2,\), expected \(3,\)"),
        (_but("[-1, 0, 0]", "[-2, 0, 0]"), r"sources\[0\]: ParallelSource.direction: .*length 1"),
        (_but("[[sources]]", "[sources]"), r"sources: got \{.*expected an array"),
        (_but("[[0, 1, 2], [0, 2, 3]]", "[[0, 1, 2], [0, 2, 9]]"), "skin.mesh: Mesh.faces: got indices 0 to 9"),
        (_but("shape = [16, 16]", HUGE), r"camera.shape: got \[100000, 100000\], expected 2 integers >= 1 whose"),
        (_but("shape = [16, 16]", "shape = [16.0, 16]"), r"camera.shape\[0\]: got 16.0, expected an integer"),
        (_but(PATH, FAR), "atmosphere: StandardAtmosphere.distance: got 90000.0, expected at most 60000 m"),
        (_but(PATH, FAR + "\nextrapolate = 1"), "atmosphere.extrapolate: got 1, expected true or false"),
        (_but("azimuth = 0", ""), "camera: got no key azimuth, which it needs"),
        (_but("samples = 2", "sample = 2"), r"render.sample: unknown key, expected .*\(did you mean samples\?\)"),
        (_but("step = 90", "step = 0"), "signature.views.azimuth: got .* expected start <= stop and step > 0"),
        (_but('"LWIR"]', '"LWIR", { name = "x", lower = 4.0, upper = 3.0 }]'), r"bands\[2\]: Band 'x': got edges 4.0"),
        (_but('"LWIR"]', '{ name = "x", lower = [4.0], upper = 5.0 }]'), r"bands\[1\].lower: got \[4.0\], expected a"),
        (
            _but("temperature = 250", "temperature = 1e300"),
            "background.temperature: got 1e.300, expected a finite",
        ),
        (
            _but("temperature = 250", f"temperature = 1{'0' * 400}"),
            "background.temperature: got 10+.*, expected a",
        ),
        (_but("temperature = 250", f"temperature = 1{'0' * 5000}"), "scene.toml: not readable as TOML"),
        (_but('"LWIR"]', '"lwir"]'), r"bands\[1\]: got 'lwir', expected one of SWIR, MWIR, LWIR \(did"),
        (_but("temperature = 250", "temperature = 0"), "background: BlackbodyBackground.temperature: got 0.0"),
        (TEXT + JET.replace("12", "-12"), "plumes.gas: carbon, hydrogen: got -12"),
        (TEXT + JET + "[resolve_jet]\ntolerence = 1", r"resolve_jet.tolerence: unknown key, .*mean tolerance"),
        (TEXT + "[resolve_jet]\ntolerance = 1", "resolve_jet: .* expected it only beside a plume of type JetPlume"),
        (TEXT + "[method]\nbounces = -1", "method: Method.bounces: got -1, expected an integer >= 0"),
        (TEXT + "[method]\norders = -1", "method: Method.orders: got -1, expected an integer >= 0"),
        (TEXT + "[method.direct]\nbrdfs = -1", "method.direct: DirectSampling.brdfs: got -1, expected an integer >= 0"),
        (TEXT + "[method]\ndirect = 'none'\nskin_light = {}", "method: Method.skin_light: got SkinLight with direct ="),
        (TEXT + GRID, "plumes.temperature.path: got 'flow.npz', expected a file: there is no"),
        (TEXT + "[[skin.parts]]\nname = 'wing'", "scene.toml: "),
        (PARTS, "skin.mesh.path: got 'body.obj', expected a file"),
    ],
)
def test_what_is_wrong_is_named_with_file_key_and_cure(text, message, tmp_path):
    with pytest.raises(ValueError, match=message) as caught:
        load_scene(write_scene(tmp_path, text))
    assert str(caught.value).startswith(str(tmp_path / "scene.toml")) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('unit = "mm"', 'unit = "furlong"'), "skin.mesh.unit: got 'furlong', expected one of m, cm"),
        (('name = "wing"', 'name = "wng"'), r"skin.parts\[0\].name: got 'wng', expected .*\(did you mean wing\?\)"),
        (('name = "nozzle"', 'name = "tail"'), r"skin.parts\[2\].name: got 'tail', expected a new name"),
        (("faces = [0]", "faces = [6]"), r"skin.parts\[2\].faces: got \[6\], expected faces 0 to 5"),
        (("[[0.3]]", "[0.3, 0.4]"), r"skin.parts\[1\].brdf: .* expected parameters of one face"),
    ],
)
def test_wrong_parts_are_named(change, message, tmp_path):
    write_obj(tmp_path / "body.obj", ("wing", "tail", "wing 2"))
    (tmp_path / "wing.csv").write_text("410\n420\n")
    assert change[0] in PARTS
    with pytest.raises(ValueError, match=message):
        load_scene(write_scene(tmp_path, PARTS.replace(*change)))


def test_a_file_that_is_no_text_or_too_large(tmp_path, monkeypatch):
    path = tmp_path / "scene.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match="scene.toml:1: got the byte 0xff, expected UTF-8"):
        load_scene(path)
    monkeypatch.setattr("jaxir.io.scene_file._entries.LARGEST_FILE", 2)
    with pytest.raises(ValueError, match="scene.toml: got 3 bytes, expected a scene file of at most 2"):
        load_scene(path)
    with pytest.raises(ValueError, match="none.toml: no such file"):
        load_scene(tmp_path / "none.toml")


def test_an_error_names_the_file_once(tmp_path):
    entry = Entry(tmp_path / "a.toml", "plume.gas", {})
    once = entry.failed(ValueError("one\n  two"))
    assert str(once) == f"{tmp_path / 'a.toml'}: plume.gas: one two" and str(entry.failed(once)) == str(once)
