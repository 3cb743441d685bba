import csv
from importlib import resources

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxir.optics.air import (
    EARTH_RADIUS,
    Profile,
    air_pressure,
    air_temperature,
    altitude_along,
    slant_range,
    us_standard_1976,
)
from jaxir.optics.spectrum import LWIR, MWIR, SWIR, Band, band_radiance, gray_nodes, resolved_nodes
from jaxir.scene.air import PathToSpace, StandardAtmosphere, TableAtmosphere, UniformAtmosphere

BANDS = (SWIR, MWIR, LWIR)
GROUND = (0.0, 10e3, 11544.0)  # sensor on the ground, target at 10 km, 30 degrees off the zenith
AIR = (10e3, 10e3, 5e3)  # both at 10 km, 5 km apart


@pytest.fixture
def nodes():
    return resolved_nodes(BANDS, points=1, pair_points=0)


@pytest.fixture(scope="module")
def lowtran():
    text = resources.files("jaxir").joinpath("data", "lowtran7_paper_paths_20cm.csv").read_text()
    return np.array([[float(x) for x in row] for row in csv.reader(text.splitlines()) if row[0][0].isdigit()])


def wavelength_means(nodes, value):
    width = np.asarray(1e4 / nodes.lower - 1e4 / nodes.upper) * np.asarray(nodes.response)
    return width @ np.asarray(value) / width.sum(axis=1)


@pytest.mark.parametrize(
    ("path", "expected"), [(GROUND, (0.503, 0.472, 0.795)), (AIR, (0.880, 0.813, 0.971))], ids=["ground", "air"]
)
def test_band_means_of_lowtran_7(path, expected, precision):
    nodes = resolved_nodes(BANDS, points=1, pair_points=0)
    air = StandardAtmosphere(*path)
    assert np.allclose(wavelength_means(nodes, air.on(nodes).transmittance), expected, atol=0.003)


@pytest.mark.parametrize(("path", "column"), [(GROUND, 2), (AIR, 4)], ids=["ground", "air"])
def test_every_bin_of_lowtran_7(path, column, nodes, lowtran):
    got = np.asarray(StandardAtmosphere(*path).on(nodes).transmittance)
    table = TableAtmosphere(lowtran[:, :2].mean(axis=1), lowtran[:, column])
    inside = resolved_nodes([MWIR], points=1, pair_points=0)
    fit = np.asarray(StandardAtmosphere(*path).on(inside).transmittance)
    error = fit - np.asarray(table.on(inside).transmittance)
    assert np.sqrt(np.mean(error**2)) < 0.012 and np.abs(error).max() < 0.04
    assert got.min() >= 0 and got.max() <= 1


def test_path_emission_of_lowtran_7(nodes):
    level = StandardAtmosphere(*AIR)
    assert np.asarray(nodes.in_band(level.on(nodes).path_radiance)) == pytest.approx([8.7e-6, 0.0103, 0.196], rel=0.025)
    # LOWTRAN's lowest layer is at the mean temperature of its kilometre, 285.2 K. Opaque bins show it.
    ground = np.asarray(nodes.in_band(StandardAtmosphere(*GROUND).on(nodes).path_radiance))
    warmer = [
        float(band_radiance(jnp.asarray(288.0), n)[0] / band_radiance(jnp.asarray(285.2), n)[0])
        for n in (gray_nodes([Band("S", 2.5, 3.0)]), gray_nodes([MWIR]), gray_nodes([LWIR]))
    ]
    assert np.all(ground > 0.99 * np.array([0.0043, 0.548, 5.24]))
    assert np.all(ground < 1.01 * np.array([0.0043, 0.548, 5.24]) * warmer)


def test_isothermal_opaque_and_furnace():
    # air at one temperature: emission = (1 - transmittance) B whatever the path
    nodes = resolved_nodes([MWIR], points=1)
    standard = us_standard_1976()
    level = standard.altitude
    warm = Profile(level, jnp.full_like(level, 270.0), standard.pressure, standard.h2o, standard.o3)
    air = StandardAtmosphere(*GROUND, profile=warm)
    expected = (1 - air.on(nodes).transmittance) * band_radiance(jnp.asarray(270.0), nodes)
    assert np.allclose(air.on(nodes).path_radiance, expected, rtol=1e-4)


def test_profile_at_levels_between_and_above(precision):
    air = us_standard_1976()
    state = air.at(air.altitude)
    assert np.allclose(state.temperature, air.temperature) and np.allclose(state.h2o, air.h2o, rtol=1e-4)
    middle = air.at(jnp.asarray(5500.0))
    assert float(middle.pressure) == pytest.approx(50540, rel=2e-3)
    assert float(middle.temperature) == pytest.approx(252.4, abs=0.1)


def test_round_earth(x64):
    reach = slant_range(jnp.asarray(0.0), jnp.asarray(10e3), jnp.asarray(30.0))
    assert float(reach) == pytest.approx(11544, abs=1)
    assert float(slant_range(jnp.asarray(2e3), jnp.asarray(5e3), jnp.asarray(0.0))) == pytest.approx(3e3)
    # zenith angle 90: tangent, h = s^2 / 2R
    assert float(slant_range(jnp.asarray(0.0), jnp.asarray(1e3), jnp.asarray(90.0))) == pytest.approx(112.9e3, rel=1e-3)
    along = altitude_along(jnp.asarray(10e3), jnp.asarray(10e3), jnp.asarray(100e3), jnp.asarray([0.0, 0.5, 1.0]))
    assert np.allclose(along, [10e3, 10e3 - 50e3**2 / 2 / 6.381e6, 10e3], atol=0.1)


def test_a_sensor_that_looks_down_meets_what_is_below(x64):
    for above, below, zenith in ((3e3, 0.0, 95.0), (12e3, 3e3, 120.0), (3e3, 0.0, 180.0)):
        reach = slant_range(above, below, zenith)
        cosine = np.cos(np.deg2rad(zenith))
        height = np.sqrt((EARTH_RADIUS + above) ** 2 + reach**2 + 2 * (EARTH_RADIUS + above) * reach * cosine)
        assert float(height) - EARTH_RADIUS == pytest.approx(below, abs=1e-3)
        assert reach < (EARTH_RADIUS + above) * abs(cosine) * (1 + 1e-9)  # the nearer of two points
    for above, below, zenith in ((0.0, 1e3, 120.0), (3e3, 0.0, 80.0), (1e4, 0.0, 90.5)):
        with pytest.raises(ValueError, match=f"zenith: got {zenith}, expected an angle at which the line meets"):
            slant_range(above, below, zenith)


def test_standard_atmosphere_gradients(x64):
    nodes = resolved_nodes([MWIR], width=200.0, points=1)
    air = us_standard_1976()

    def total(p):
        humid = Profile(air.altitude, air.temperature + p[4], air.pressure, air.h2o * p[3], air.o3)
        path = StandardAtmosphere(p[0] * 1e3, p[1] * 1e3, p[2] * 1e3, humid)
        return path.on(nodes).transmittance.sum() + path.on(nodes).path_radiance.sum()

    at = np.array([1.3, 9.2, 15.0, 1.0, 0.0])
    every = jax.jit(lambda p: (*jax.value_and_grad(total)(p), jax.jacfwd(total)(p)))
    _, reverse, forward = map(np.asarray, every(jnp.asarray(at)))
    assert np.allclose(reverse, forward, rtol=1e-9)
    for slope, step in zip(reverse, 1e-5 * np.eye(5), strict=True):
        after, before = (float(every(jnp.asarray(at + sign * step))[0]) for sign in (1, -1))
        assert float(slope) == pytest.approx((after - before) / 2e-5, rel=1e-5)


@pytest.mark.parametrize("altitude, distance", [(0.0, 5e3), (3e3, 5e3), (10e3, 20e3), (12e3, 1.0)])
def test_slopes_before_hot_gas_are_the_same_in_both_modes(altitude, distance):
    """In single precision, where some slots let nothing through, or all."""
    nodes = resolved_nodes(MWIR, points=2, pair_points=0)

    def passed(values):
        return jnp.sum(
            StandardAtmosphere(values[0], values[0], values[1]).in_front_of(nodes, jnp.asarray(900.0)).transmittance
        )

    at = jnp.asarray([altitude, distance])
    forward, reverse = jax.jit(lambda at: (jax.jacfwd(passed)(at), jax.grad(passed)(at)))(at)
    assert np.isfinite(forward).all() and np.any(np.asarray(forward) != 0)
    np.testing.assert_allclose(reverse, forward, rtol=1e-3, atol=1e-6 * np.abs(forward).max())


@pytest.mark.parametrize("elevation", [-8.0, -90.0])
def test_through_the_earth_nothing_comes_and_nothing_changes(elevation):
    nodes = resolved_nodes(MWIR, width=200.0, points=1)
    at = jnp.asarray([3000.0, elevation])
    passed = jax.jit(jax.value_and_grad(lambda at: jnp.sum(PathToSpace(at[0], at[1]).on(nodes).transmittance)))
    np.testing.assert_array_equal(np.hstack(passed(at)), np.zeros(3))


def test_table_is_averaged_over_bins(precision):
    nodes = resolved_nodes([MWIR], width=100.0, points=1)
    wavenumber = np.linspace(1900.0, 3500.0, 1601)
    ramp = TableAtmosphere(wavenumber, (wavenumber - 1900) / 1600, wavenumber * 1e-3)
    centre = np.asarray(nodes.lower + nodes.upper) / 2
    assert np.allclose(ramp.on(nodes).transmittance, (centre - 1900) / 1600, atol=1e-5)
    assert np.allclose(ramp.on(nodes).path_radiance, centre * 1e-3 * np.asarray(nodes.upper - nodes.lower), rtol=1e-5)
    coarse = TableAtmosphere([1900.0, 2100.0, 3500.0], [0.0, 1.0, 0.0])
    one = resolved_nodes(Band("x", 1e4 / 2150, 1e4 / 2050), width=100.0, points=1)
    exact = np.trapezoid(np.interp(np.linspace(2050, 2150, 100001), [1900, 2100, 3500], [0, 1, 0]), dx=1e-5)
    got = float((coarse.on(one).transmittance * (one.upper - one.lower)).sum() / 100)
    assert got == pytest.approx(exact, rel=1e-4)


def test_uniform_air():
    nodes = gray_nodes(BANDS)
    air = UniformAtmosphere([1e-4, 2e-4, 0.0], 5e3, 280.0)
    assert np.allclose(air.on(nodes).transmittance, np.exp([-0.5, -1.0, 0.0]))
    expected = (1 - np.exp([-0.5, -1.0, 0.0])) * np.asarray(band_radiance(jnp.asarray(280.0), nodes))
    assert np.allclose(air.on(nodes).path_radiance, expected, rtol=1e-5)
    assert np.all(np.asarray(UniformAtmosphere(1e-4, 5e3).on(nodes).path_radiance) == 0)
    slope = jax.grad(lambda k: UniformAtmosphere(k, 5e3, 280.0).on(nodes).transmittance[0])(1e-4)
    assert float(slope) == pytest.approx(-5e3 * np.exp(-0.5), rel=1e-5)


def failing(checks):
    return {check.field for check in checks if not (check.doubt or bool(check.ok.all()))}


def test_bad_input_is_refused(nodes):
    assert failing(StandardAtmosphere(*GROUND).checks()) == set()
    assert failing(StandardAtmosphere(0.0, 10e3, 9e3).checks()) == {"StandardAtmosphere.distance"}
    assert failing(StandardAtmosphere(0.0, 0.0, 50e3).checks()) == {"StandardAtmosphere: altitude along the path"}
    assert failing(StandardAtmosphere(0.0, 40e3, 50e3, extrapolate=True).checks()) == {
        "StandardAtmosphere: altitude along the path"
    }
    gap = us_standard_1976()
    broken = Profile(gap.altitude, gap.temperature.at[3].set(jnp.nan), gap.pressure, gap.h2o, gap.o3)
    assert failing(broken.checks()) == {"Profile.temperature"}
    assert failing(TableAtmosphere([1.0, 2.0], [0.5, 1.5]).checks()) == {"TableAtmosphere.transmittance"}
    assert failing(TableAtmosphere([2.0, 1.0], [0.5, 0.5]).checks()) == {"TableAtmosphere.wavenumber"}
    assert failing(UniformAtmosphere(-1.0, 1.0).checks()) == {"UniformAtmosphere.extinction"}
    with pytest.raises(ValueError, match="expected"):
        TableAtmosphere([1.0, 2.0], [0.5])
    with pytest.raises(ValueError, match="inside the table"):
        TableAtmosphere([900.0, 1000.0], [0.5, 0.5]).on(nodes)
    with pytest.raises(ValueError, match="inside the table"):
        StandardAtmosphere(*AIR).on(resolved_nodes(Band("far", 13.0, 14.0)))
    with pytest.raises(ValueError, match="Profile.pressure"):
        Profile(gap.altitude, gap.temperature, gap.pressure[:5], gap.h2o, gap.o3)


def test_air_is_heated_by_flight():
    """US Standard Atmosphere 1976: 288.15 K and 101325 Pa at the ground, 223.25 K and 26500 Pa at 10 km."""
    assert float(air_temperature(0.0)) == pytest.approx(288.15, abs=0.1)
    np.testing.assert_allclose(air_temperature(10e3, [0.0, 1.0], 1.0), [223.25, 1.2 * 223.25], rtol=1e-3)
    assert float(air_pressure(10e3)) == pytest.approx(26500, rel=2e-3)
    slope = jax.grad(lambda mach: air_temperature(10e3, mach))(0.9)
    assert float(slope) == pytest.approx(223.25 * 0.89 * 0.4 * 0.9, rel=1e-3)
    for call, message in (
        (lambda: air_temperature(30e3), "altitude: got 30000.0, expected 0 to 25000 m"),
        (lambda: air_temperature(0.0, -1.0), "mach: got -1.0"),
        (lambda: air_pressure(-5.0), "altitude: got -5.0"),
    ):
        with pytest.raises(ValueError, match=message):
            call()
