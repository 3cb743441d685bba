"""Sun, clear sky and earth: where the Sun stands, what the air leaves of it, and a sky in equilibrium."""

import datetime

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir._arrays import enforce
from jaxir.optics.air import EARTH_RADIUS, Profile, horizon, to_ground, to_sky
from jaxir.optics.spectrum import band_radiance
from jaxir.scene.light import sun_position, sunlight
from tests.scenes import plate

BANDS = (jaxir.MWIR, jaxir.LWIR)
NODES = jaxir.resolved_nodes(BANDS, width=200.0, points=1)
AIR = jaxir.StandardAtmosphere(0.0, 10e3, 12e3)


def test_the_sun_stands_where_the_national_renewable_energy_laboratory_has_it():
    """Worked example of Reda and Andreas (2004): refraction of .0163 degrees taken off the elevation."""
    mountain = datetime.timezone(datetime.timedelta(hours=-7))
    time = datetime.datetime(2003, 10, 17, 12, 30, 30, tzinfo=mountain)
    elevation, azimuth, distance = sun_position(time, 39.742476, -105.1786)
    assert elevation == pytest.approx(39.888378 - 0.016332, abs=0.01)
    assert azimuth == pytest.approx(194.340241, abs=0.01)
    assert distance == pytest.approx(0.996542, abs=1e-4)


def test_azimuth_turns_from_north_eastwards_to_from_the_nose_leftwards():
    noon = datetime.datetime(2026, 3, 20, 12, 7, tzinfo=datetime.UTC)  # over Greenwich, at the equinox: south
    sun = jaxir.sun_at(noon, 51.5, 0.0, heading=90.0)  # the nose to the east, the right wing to the south
    assert float(sun.azimuth) == pytest.approx(-90, abs=0.5) and float(sun.elevation) == pytest.approx(38.5, abs=0.5)
    np.testing.assert_allclose(sun.direction, [0, np.cos(np.deg2rad(38.5)), -np.sin(np.deg2rad(38.5))], atol=0.01)
    above = sun.irradiance
    assert float(above.factor) == pytest.approx(float(sunlight().factor) / sun_position(noon, 51.5, 0.0)[2] ** 2)
    total = float(above.factor / sunlight().factor * 5.670374e-8 * 5772.0**4 / np.pi * sunlight().factor)
    assert total == pytest.approx(1361 / 0.9959**2, rel=2e-3)  # W m-2, twelve weeks after the perihelion


def test_lines_of_sight_over_the_round_earth(x64):
    profile, height = jaxir.us_standard_1976(), jnp.asarray(10e3)
    dip = float(horizon(height))
    assert dip == pytest.approx(-np.rad2deg(np.arccos(EARTH_RADIUS / (EARTH_RADIUS + 10e3))), rel=1e-12)
    assert float(to_sky(profile, height, jnp.asarray(90.0)).distance) == pytest.approx(15e3)
    tangent = np.sqrt(2 * EARTH_RADIUS * 10e3 + 10e3**2), np.sqrt(2 * EARTH_RADIUS * 25e3 + 25e3**2)
    assert float(to_ground(height, jnp.asarray(dip)).distance) == pytest.approx(tangent[0], rel=1e-6)
    assert float(to_sky(profile, height, jnp.asarray(dip)).distance) == pytest.approx(sum(tangent), rel=1e-9)
    assert float(to_ground(height, jnp.asarray(-90.0)).distance) == pytest.approx(10e3)
    ground = [bool(to_sky(profile, height, jnp.asarray(e)).ground) for e in (dip - 0.01, dip + 0.01, 5.0)]
    assert ground == [True, False, False]


def test_an_isothermal_world_is_a_furnace(x64):
    """Ground and air of one temperature: a black body towards the ground, 1 - transmittance of one towards the sky."""
    standard, level = jaxir.us_standard_1976(), jaxir.us_standard_1976().altitude
    warm = Profile(level, jnp.full_like(level, 270.0), standard.pressure, standard.h2o, standard.o3)
    nodes = jaxir.resolved_nodes(BANDS, width=200.0, points=1)
    table = jax.jit(lambda: jaxir.ClearSky(3e3, ground_emissivity=1.0, profile=warm).on(nodes))()
    black = band_radiance(jnp.asarray(270.0), nodes)
    half = table.elevation.size // 2
    assert (
        float(table.elevation[half])
        == float(table.elevation[half - 1])
        == pytest.approx(float(horizon(jnp.asarray(3e3))))
    )
    np.testing.assert_allclose(table.radiance[:half] / black[None], 1, rtol=1e-10)
    passed = jax.jit(lambda: jaxir.PathToSpace(3e3, 90.0, warm).on(nodes))()
    np.testing.assert_allclose(table.radiance[-1] / black, 1 - passed.transmittance, rtol=1e-10)
    assert np.all(np.diff(np.asarray(jax.vmap(nodes.in_band)(table.radiance[half:]))[:, 1]) < 0)  # dimmer upwards


def test_the_ground_reflects_sky_and_sun():
    def ground(emissivity, sun):
        sky = jaxir.ClearSky(10.0, 290.0, emissivity, sun)
        return NODES.in_band(sky.on(NODES).radiance[0])  # straight down through 10 m of air

    def both(elevation):
        sun = jaxir.Sun(elevation, 0.0, air=jaxir.PathToSpace(0.0, elevation))
        return ground(0.0, None), ground(0.0, sun), ground(1.0, sun), NODES.in_band(sun.on(NODES).irradiance)

    dark, lit, black, irradiance = jax.jit(both)(30.0)
    np.testing.assert_allclose(lit - dark, irradiance * 0.5 / np.pi, rtol=0.03)  # .03 lost in 10 m of air at 4.3 um
    np.testing.assert_allclose(black, NODES.in_band(band_radiance(jnp.asarray(290.0), NODES)), rtol=0.01)
    assert np.all(dark > 0) and np.all(dark < black)


def test_a_scene_tells_sun_and_sky_where_they_are():
    scene = jaxir.Scene(plate(), sources=jaxir.Sun(40.0, 90.0), background=jaxir.ClearSky(), atmosphere=AIR)
    for one in (scene, jaxir.at_target(scene), jaxir.alone(jaxir.at_target(scene))):
        sun = one.sources[0]
        assert float(sun.air.altitude) == 10e3 and float(sun.air.elevation) == 40
        sky = one.background if one.background is not None else one.sources[1]
        assert float(sky.altitude) == 10e3 and float(sky.sun.elevation) == 40
    assert scene.has_spectrum
    lit = jax.jit(lambda s: s.on(NODES))(scene)
    passed = NODES.in_band(lit.scene.sources[0].irradiance) / NODES.in_band(sunlight().on(NODES))
    assert np.all((passed > 0.8) & (passed < 0.95))
    assert jaxir.Scene(plate(), sources=jaxir.Sun(40.0, 90.0)).sources[0].air is None
    given = jaxir.Scene(plate(), sources=jaxir.Sun(40.0, 0.0, 5.0, jaxir.FixedPath(1.0)), atmosphere=AIR).sources[0]
    np.testing.assert_allclose(given.on(jaxir.gray_nodes(BANDS)).irradiance, 5)


def test_bands_take_nodes_for_sunlight_through_air():
    """A mean transmittance times the mean sunlight is not the mean of the product, in SWIR above all."""
    scene = jaxir.Scene(plate(temperature=300.0), sources=jaxir.Sun(40.0, 90.0, air=jaxir.PathToSpace(0.0, 40.0)))
    nodes = jaxir.scene_nodes(scene, jaxir.SWIR)
    fine = jaxir.resolved_nodes(jaxir.SWIR, width=50.0, points=1)
    got, want, gray = (
        n.in_band(scene.sources[0].on(n).irradiance) for n in (nodes, fine, jaxir.gray_nodes((jaxir.SWIR,)))
    )
    np.testing.assert_allclose(got, want, rtol=0.02)
    assert abs(float(gray[0] / want[0]) - 1) > 0.05


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: jaxir.Scene(plate(), sources=jaxir.Sun(40.0, 0.0), atmosphere=jaxir.FixedPath(0.5)),
            "Sun.air: got none in a scene with FixedPath, which tells no altitude; expected the path to the Sun",
        ),
        (lambda: jaxir.ClearSky().on(NODES), "ClearSky.altitude: got none, expected the target's"),
        (lambda: jaxir.PathToSpace(0.0, 40.0).on(jaxir.gray_nodes((jaxir.Band("far", 13.0, 14.0),))), "PathToSpace"),
        (lambda: enforce(0, jaxir.PathToSpace(30e3, 40.0).checks()), "PathToSpace.altitude: got 30000.0, expected an"),
        (lambda: sun_position(datetime.datetime(2026, 1, 1), 0.0, 0.0), "time: got 2026-01-01 .* with a zone"),
        (
            lambda: sun_position(datetime.datetime.now(datetime.UTC), 91.0, 0.0),
            "latitude: got 91.0, expected -90 to 90",
        ),
    ],
)
def test_what_a_sky_lacks_is_said(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_a_sun_by_night_is_doubted():
    with pytest.warns(jaxir.PlausibilityWarning, match="Sun.elevation: got -30.0, expected above the horizon"):
        enforce(0, jaxir.Sun(-30.0, 0.0).checks())
    assert float(jaxir.Sun(-30.0, 0.0, air=jaxir.PathToSpace(0.0, -30.0)).on(NODES).irradiance.max()) == 0


@pytest.mark.parametrize("elevation", [-8.0, -90.0])
def test_the_ground_is_dark_by_night(elevation):
    """Paths from the ground to a Sun far below the horizon lead through the earth."""
    lit = jaxir.ClearSky(1e3, sun=jaxir.Sun(elevation, 0.0)).on(NODES).radiance
    np.testing.assert_array_equal(lit, jaxir.ClearSky(1e3).on(NODES).radiance)


@pytest.mark.parametrize("elevation", [40.0, -40.0])
def test_gradients_of_sun_and_sky_are_finite(elevation):
    def total(values):
        sun = jaxir.Sun(values[1], 0.0, air=jaxir.PathToSpace(0.0, values[1]))
        return jaxir.ClearSky(values[0] * 1e3, sun=sun).on(NODES).radiance.sum()

    slope = np.asarray(jax.jit(jax.grad(total))(jnp.asarray([10.0, elevation])))
    assert np.isfinite(slope).all() and slope[0] != 0 and (slope[1] != 0) == (elevation > 0)


def test_the_order_of_sun_and_sky_does_not_matter():
    """The ground of a sky before the Sun stayed dark."""
    sun, sky = jaxir.Sun(35.0, 40.0), jaxir.ClearSky(ground_emissivity=0.5)
    first, last = (jaxir.Scene(plate(), sources=lights, atmosphere=AIR).sources for lights in ((sun, sky), (sky, sun)))
    for one, other in zip(jax.tree.leaves(first), jax.tree.leaves(last[::-1]), strict=True):
        np.testing.assert_array_equal(one, other)
    assert last[0].sun is not None
