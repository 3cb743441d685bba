"""Lights: samplers against densities, densities against hits, closed forms, bad input."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from chi_square import p_value

import jaxir
from jaxir._arrays import enforce
from jaxir.geometry import disc_vector, polygon_form_factor
from jaxir.optics.spectrum import LWIR, MWIR, Band, gray_nodes, resolved_nodes
from jaxir.scene.light import DiscSource, ElevationTable, PointSource, PolygonSource, SphereSource
from tests.scene.spectra import side_by_side

POINT = np.array([0.2, -0.1, 0.3])
DOWN = np.array([0.0, 0.0, -1.0])
# clockwise from above, so it shines down; unequal triangles in the fan, one corner on an edge
PENTAGON = np.array([[-0.5, -0.4, 1.2], [-0.6, 0.1, 1.2], [-0.7, 0.6, 1.2], [0.5, 1.0, 1.2], [0.9, -0.6, 1.2]])
LIGHTS = {
    "polygon": PolygonSource(PENTAGON, 100.0),
    "polygon tilted": PolygonSource([[0.9, -2.0, 2.0], [0.9, 2.0, 2.0], [1.8, 0.0, -2.0]], [1.0, 2.0]),
    "disc": DiscSource([0.5, 0.5, 1.8], DOWN, 1.0, 100.0),
    "disc tilted": DiscSource([2.0, 0.0, 0.0], [-0.8, 0.0, 0.6], 1.5, [1.0, 2.0]),
    "sphere": SphereSource([1.0, 1.0, 1.0], 0.5, 3.0),
    "sphere around": SphereSource([0.0, 0.0, 0.0], 5.0, 3.0),
}


@pytest.fixture(params=LIGHTS)
def light(request):
    return LIGHTS[request.param]


def test_density_is_that_of_the_samples(light):
    point, normal = jnp.asarray(POINT), jnp.asarray(-DOWN)
    p, total = p_value(
        lambda u: light.sample(u, point, normal).omega_i,
        lambda w: light.meet(w, point, normal).pdf,
        jnp.eye(3),
        jax.random.key(3),
    )
    assert p > 1e-3
    assert total == pytest.approx(1, abs=0.02)


def test_samples_meet_the_light(light, x64):
    light = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), light)
    point, normal = jnp.asarray(POINT), jnp.asarray(-DOWN)
    u = jax.random.uniform(jax.random.key(4), (500, 2))

    @jax.jit
    def both(light):
        drawn = jax.vmap(lambda u: light.sample(u, point, normal))(u)
        return drawn, jax.vmap(lambda w: light.meet(w, point, normal))(drawn.omega_i)

    drawn, met = both(light)
    np.testing.assert_allclose(np.linalg.norm(drawn.omega_i, axis=-1), 1, rtol=1e-12)
    np.testing.assert_allclose(met.distance, drawn.distance, rtol=1e-6)
    np.testing.assert_allclose(met.pdf, drawn.pdf, rtol=1e-6)


def test_irradiance_from_a_disc_is_its_form_factor(x64):
    """O3 by sampling the light: mean of cos / pdf within 4 standard errors of pi V."""
    disc = DiscSource([0.5, 0.5, 1.8], DOWN, 1.0, 100.0)
    point, normal = jnp.asarray(POINT), jnp.asarray(-DOWN)
    u = jax.random.uniform(jax.random.key(5), (40000, 2))
    drawn = jax.jit(jax.vmap(lambda u: disc.sample(u, point, normal)))(u)
    value = np.asarray(drawn.omega_i) / np.asarray(drawn.pdf)[:, None]
    error = value.std(axis=0) / np.sqrt(len(u))
    want = np.pi * np.asarray(disc_vector(point, disc.centre, disc.normal, disc.radius))
    assert np.all(np.abs(value.mean(axis=0) - want) < 4 * error)
    assert np.all(error < 0.01 * np.linalg.norm(want))


def test_irradiance_from_a_polygon_is_its_form_factor(x64):
    """By sampling the light: mean of cos / pdf within 4 standard errors of pi F, also where the horizon cuts it."""
    polygon, point, normal = PolygonSource(PENTAGON, 100.0), jnp.asarray(POINT), jnp.asarray(-DOWN)
    u = jax.random.uniform(jax.random.key(6), (40000, 2))
    drawn = jax.jit(jax.vmap(lambda u: polygon.sample(u, point, normal)))(u)
    for receiver in (np.array([0.0, 0.0, 1.0]), np.array([0.96, 0.0, 0.28])):
        cos = np.asarray(drawn.omega_i) @ receiver
        value = np.maximum(cos, 0) / np.asarray(drawn.pdf)
        error = value.std() / np.sqrt(len(u))
        want = np.pi * float(polygon_form_factor(point, jnp.asarray(receiver), polygon.corners))
        assert (cos < 0).any() == (receiver[2] < 1)
        assert abs(value.mean() - want) < 4 * error
        assert error < 0.01 * want


def test_point_source_falls_with_the_square(precision):
    lamp = PointSource([0.0, 0.0, 2.0], [8.0, 4.0])
    np.testing.assert_allclose(lamp.on(gray_nodes((MWIR, LWIR))).beam(jnp.zeros(3)), [2.0, 1.0], rtol=1e-6)
    omega_i, distance = lamp.toward(jnp.zeros(3))
    np.testing.assert_allclose(omega_i, [0, 0, 1])
    assert distance == 2


@jax.jit
@partial(jax.value_and_grad, argnums=(0, 1, 2, 3, 4))
def awkward(lamp, disc, ball, plate, point):
    """A sum of all that lights tell of a point."""
    nodes, normal, u = gray_nodes((MWIR,)), jnp.asarray(-DOWN), jnp.asarray([0.3, 0.6])
    total = jnp.sum(lamp.on(nodes).beam(point)) + jnp.sum(lamp.toward(point)[0])
    for source in (disc, ball, plate):
        drawn = source.sample(u, point, normal)
        met = source.meet(jnp.asarray([0.0, 0.6, 0.8]), point, normal)
        total = total + drawn.pdf + met.pdf + jnp.sum(drawn.omega_i) + drawn.distance
        total = total + jnp.where(jnp.isfinite(met.distance), met.distance, 0)
    return total


@pytest.mark.parametrize("where", ["at", "inside", "behind", "edge-on"])
def test_awkward_points_give_no_light_and_finite_gradients(where, precision):
    """At the light itself, inside a ball, behind a disc, in a disc's plane."""
    lamp, disc, ball, plate = (
        PointSource([0.0, 0, 1], 1.0),
        DiscSource([0.0, 0, 1], DOWN, 1.0, 1.0),
        SphereSource([0.0, 0, 1], 0.5, 1.0),
        PolygonSource([[0.0, 0, 1], [0, 1, 1], [1, 0, 1]], 1.0),
    )
    point = jnp.asarray(
        {"at": [0, 0, 1.0], "inside": [0.1, 0, 1.1], "behind": [0, 0, 2.0], "edge-on": [3.0, 0, 1]}[where]
    )

    normal = jnp.asarray(-DOWN)
    value, gradient = awkward(lamp, disc, ball, plate, point)
    assert np.isfinite(value)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(gradient))
    if where in ("behind", "edge-on", "at"):
        assert disc.sample(jnp.asarray([0.3, 0.6]), point, normal).pdf == 0
        assert plate.sample(jnp.asarray([0.3, 0.6]), point, normal).pdf == 0
    if where == "at":
        assert np.all(np.asarray(lamp.on(gray_nodes((MWIR,))).beam(point)) == 0)


def test_bad_lights_are_refused():
    zero = jnp.zeros(1)
    with pytest.raises(ValueError, match="DiscSource.radius"):
        enforce(zero, DiscSource(POINT, DOWN, 0.0, 1.0).checks())
    with pytest.raises(ValueError, match="length 1"):
        enforce(zero, DiscSource(POINT, [0.0, 0.0, 2.0], 1.0, 1.0).checks())
    with pytest.raises(ValueError, match="SphereSource.radius"):
        enforce(zero, SphereSource(POINT, -1.0, 1.0).checks())
    with pytest.raises(ValueError, match="PolygonSource.corners: got 2 corners"):
        PolygonSource([[0.0, 0, 0], [1, 0, 0]], 1.0)
    square = np.array([[0.0, 0, 1], [0, 1, 1], [1, 1, 1], [1, 0, 1]])
    for corners, wrong in [
        (square + [[0, 0, 0], [0, 0, 0.01], [0, 0, 0], [0, 0, 0]], "in one plane"),
        (square * [1.0, 0.0, 1.0], "span an area"),
        (square[[0, 2, 1, 3]], "span an area"),
        (np.array([[0.0, 0, 1], [0, 1, 1], [0.1, 0.1, 1], [1, 0, 1]]), "a convex polygon"),
    ]:
        with pytest.raises(ValueError, match=wrong):
            enforce(zero, PolygonSource(corners, 1.0).checks())
    enforce(zero, PolygonSource(PENTAGON + [[1e3, 0, 0]], 1.0).checks())
    with pytest.raises(ValueError, match="PolygonSource.radiance"):
        enforce(zero, PolygonSource(square, -1.0).checks())
    with pytest.raises(ValueError, match="intensity"):
        enforce(zero, PointSource(POINT, [1.0, -1.0]).checks())
    with pytest.raises(ValueError, match="PointSource.position"):
        PointSource([0.0, 1.0], 1.0)
    with pytest.raises(ValueError, match=r"SphereSource.radiance: got shape \(2, 2\), expected \(node,\)"):
        SphereSource(POINT, 1.0, np.ones((2, 2)))


def test_sky_and_earth_by_elevation(precision):
    sky = ElevationTable([-90.0, 0.0, 0.0, 90.0], [[4.0], [4.0], [2.0], [1.0]]).on(gray_nodes((MWIR,)))
    look = lambda e: jnp.asarray([np.cos(np.deg2rad(e)), 0.0, np.sin(np.deg2rad(e))])  # noqa: E731
    arriving = jax.jit(jax.value_and_grad(lambda w: sky.arriving(w)[0]))
    for elevation, radiance in [(-90, 4.0), (-1, 4.0), (1, 2 - 1 / 90), (45, 1.5), (90, 1.0)]:
        found, slope = arriving(look(elevation))
        np.testing.assert_allclose(found, radiance, rtol=1e-5)
        assert np.all(np.isfinite(slope))
    with pytest.raises(ValueError, match="do not decrease"):
        enforce(jnp.zeros(1), ElevationTable([10.0, 0.0], [1.0, 1.0]).checks())
    with pytest.raises(ValueError, match=r"ElevationTable.radiance: got shape \(1, 1\), expected \(2, node\)"):
        ElevationTable([0.0, 1.0], [1.0])


BOTH = [Band("wide", 3.0, 5.0), Band("long", 8.0, 12.0)]


def sun():
    """Its factor is the solid angle of a disc of .266 degrees radius."""
    return jaxir.BlackbodySpectrum(5772.0, 6.794e-5)


@pytest.mark.parametrize(
    "light",
    [
        lambda spectrum: jaxir.ParallelSource(DOWN, spectrum),
        lambda spectrum: PointSource(POINT, spectrum),
        lambda spectrum: DiscSource(POINT, DOWN, 1.0, spectrum),
        lambda spectrum: PolygonSource(PENTAGON, spectrum),
        lambda spectrum: SphereSource(POINT, 1.0, spectrum),
        jaxir.UniformBackground,
    ],
)
def test_a_spectrum_is_the_same_light_on_any_nodes(light, precision):
    """The sum over the bins of a band is Planck's integral over the band, and the integral under a straight line."""
    line = jaxir.TabulatedSpectrum([1.0, 4.0, 13.0], [10.0, 40.0, 130.0])
    expected = {
        "blackbody": 6.794e-5 * np.asarray(jaxir.band_radiance(jnp.asarray(5772.0), gray_nodes(BOTH))),
        "line": np.array([(25 - 9) * 5.0, (144 - 64) * 5.0]),
    }
    for name, spectrum in (("blackbody", sun()), ("line", line)):
        for nodes in (gray_nodes(BOTH), resolved_nodes(BOTH, 50.0, 2, 2), resolved_nodes(BOTH, 3.0, 1, 0)):
            own = light(spectrum)
            enforce(jnp.zeros(1), [*own.checks(), *own.node_checks(nodes)])
            lit = own.on(nodes)
            found = next(
                getattr(lit, field) for field in ("irradiance", "intensity", "radiance") if hasattr(lit, field)
            )
            assert found.shape == (nodes.count,)
            in_bands = np.asarray(nodes.response) @ (np.asarray(nodes.weight) * np.asarray(found))
            np.testing.assert_allclose(in_bands, expected[name], rtol=1e-5 if precision == "float32" else 1e-9)


def test_sunlight_as_a_spectrum_has_the_solar_constant():
    everything = gray_nodes([Band("all", 0.15, 90.0)])
    assert float(sun().on(everything)[0]) == pytest.approx(1361, rel=2e-3)


def test_a_spectrum_lights_skin_through_gas_as_its_bins_do(x64):
    """The light of every bin is dimmed by its own absorption: the exact sum, and slopes in temperature and factor."""
    grid = jaxir.Grid((-2.0, -2.0, 0.5), (4.0, 4.0, 1.0), (1, 1, 1))
    gas = jaxir.NarrowBandGas(1e5, co2=1e-3)
    nodes = resolved_nodes([Band("red", 4.0, 4.8)], 100.0, 1, 0)
    camera = jaxir.orthographic_camera(0, 0, 0.05, (1, 1))
    plate = jaxir.Skin(
        jaxir.Mesh([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]], [[0, 1, 2], [0, 2, 3]]), 1.0, jaxir.Lambert(0.5)
    )
    slant = np.array([-0.6, 0.0, -0.8])

    @jax.jit
    @partial(jax.value_and_grad, argnums=(0, 1))
    def seen(temperature, factor):
        sun = jaxir.ParallelSource(slant, jaxir.BlackbodySpectrum(temperature, factor))
        scene = jaxir.Scene(plate, jaxir.GridPlume(grid, 300.0, gas), sun)
        return jaxir.render(scene, camera, nodes, samples=2).radiance[0, 0, 0]

    extinction = jax.jit(lambda: jaxir.GridPlume(grid, 300.0, gas).medium(nodes).extinction)()
    bins = 1e-4 * jaxir.band_radiance(jnp.asarray(3000.0), nodes)
    passed = np.exp(-np.asarray(extinction).reshape(-1) * 1.0 / 0.8)
    expected = float(nodes.in_band(bins * passed)[0]) * 0.6 * 0.5 / np.pi
    assert expected > 100 * float(seen(1.0, 0.0)[0])  # the gas's own glow, which skin does not reflect
    value, slopes = seen(3000.0, 1e-4)
    assert passed.min() < 0.5 < 0.9 < passed.max()
    np.testing.assert_allclose(value, expected, rtol=1e-6)
    np.testing.assert_allclose(slopes[1], expected / 1e-4, rtol=1e-6)
    difference = (seen(3001.0, 1e-4)[0] - seen(2999.0, 1e-4)[0]) / 2
    np.testing.assert_allclose(slopes[0], difference, rtol=1e-5)


def test_a_sky_of_spectra(precision):
    nodes = gray_nodes(BOTH)
    kelvin = np.array([290.0, 280.0, 230.0])
    table = ElevationTable([-90.0, 0.0, 90.0], jaxir.BlackbodySpectrum(kelvin, [0.95, 1.0, 1.0]))

    @jax.jit
    def arriving(table):
        sky = table.on(nodes)
        return sky.arriving(jnp.asarray(DOWN)), sky.arriving(jnp.asarray(-DOWN))

    down, up = arriving(table)
    black = np.asarray(jaxir.band_radiance(jnp.asarray(kelvin), nodes))
    np.testing.assert_allclose(down, 0.95 * black[0], rtol=1e-5)
    np.testing.assert_allclose(up, black[2], rtol=1e-5)


@pytest.mark.parametrize("given", [5.0, [5.0, 2.0], jaxir.BlackbodySpectrum(400.0)], ids=["number", "bands", "Planck"])
def test_light_that_stands_in_is_light_in_a_band_too(given):
    """Ambient light and the radiance of a path: of the band, in however many bins it is resolved."""
    plate = jaxir.Skin(
        jaxir.Mesh([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]], [[0, 1, 2], [0, 2, 3]]), 1.0, jaxir.Lambert(0.75)
    )
    scene = jaxir.Scene(plate, atmosphere=jaxir.FixedPath(0.5, given))
    camera, bands = jaxir.orthographic_camera(0, 0, 0.05, (1, 1)), [Band("a", 3.0, 5.0), Band("b", 8.0, 12.0)]
    black = np.asarray(jaxir.band_radiance(jnp.asarray(400.0), gray_nodes(bands)))
    light = black if isinstance(given, jaxir.BlackbodySpectrum) else np.broadcast_to(np.asarray(given), 2)
    both = gray_nodes(bands), resolved_nodes(bands, 400.0, 1, 0)
    for nodes in both if isinstance(given, list) else (side_by_side(*both),):
        image = jaxir.render(scene, camera, nodes, samples=2, method=jaxir.Method(ambient=given))
        for found in np.split(np.asarray(image.radiance)[0, 0], len(nodes.names) // 2):
            np.testing.assert_allclose(found, light * (1 + 0.25 * 0.5), rtol=1e-5)


def test_bad_spectra_are_refused():
    short = jaxir.UniformBackground(jaxir.TabulatedSpectrum([3.0, 4.0], [1.0, 1.0]))
    with pytest.raises(
        ValueError, match=r"inside the table of TabulatedSpectrum, .*3 to 4 um\); asked were .*3 to 5 um"
    ):
        short.on(gray_nodes(BOTH[:1]))
    with pytest.raises(ValueError, match=r"ElevationTable.radiance: got shape \(1,\), expected"):
        ElevationTable([-90.0, 90.0], jaxir.BlackbodySpectrum(300.0))
    with pytest.raises(ValueError, match=r"ParallelSource.irradiance: got shape \(2, 1\), expected"):
        jaxir.ParallelSource(DOWN, jaxir.BlackbodySpectrum([300.0, 400.0]))
    for spectrum, field in (
        (jaxir.BlackbodySpectrum(-1.0), "BlackbodySpectrum.temperature: got -1.0"),
        (jaxir.TabulatedSpectrum([4.0, 3.0], [1.0, 1.0]), "TabulatedSpectrum.wavelength"),
        (jaxir.TabulatedSpectrum([3.0, 4.0], [1.0, -1.0]), "TabulatedSpectrum.value: got -1.0"),
    ):
        with pytest.raises(ValueError, match=field):
            enforce(jnp.zeros(1), jaxir.UniformBackground(spectrum).checks())
