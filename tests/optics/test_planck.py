"""Blackbody radiance against 30-digit quadrature (table O1) over the whole range of temperatures."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir._arrays import as_float
from jaxir.optics.spectrum import (
    SECOND_RADIATION,
    band_radiance,
    blackbody_fraction,
    brightness_temperature,
    gray_nodes,
    spectral_radiance,
    spectral_radiance_on_host,
    spectral_radiance_wavelength,
    wavelength_to_wavenumber,
)

BANDS = (jaxir.SWIR, jaxir.MWIR, jaxir.LWIR)
# T [K]: SWIR, MWIR, LWIR [W m-2 sr-1]; mpmath quadrature with CODATA 2018 constants
RADIANCE = {
    255.0: (6.251927069e-4, 0.2788820392, 16.31005753),
    300.0: (0.01272334878, 1.865956208, 38.50042393),
    400.0: (0.9861399928, 29.84734149, 133.7408796),
    1000.0: (4925.82423, 6506.733979, 1602.829863),
    2000.0: (193795.1309, 50933.14994, 5042.851299),
}
SLOPE = {300.0: (7.28773198e-4, 0.0676983442, 0.629704347), 1000.0: (31.8879853, 25.1380943, 3.12158301)}
FRACTION = {1000.0: 3.20769784e-4, 2897.77: 0.250054103, 5000.0: 0.633725872, 50000.0: 0.998903877}
PRINTED = 5e-10  # the tables print ten digits; slopes and fractions nine
TOLERANCE = {"float32": 1e-6, "float64": PRINTED}


def test_bands_stand_for_their_gray_nodes():
    nodes = gray_nodes(jaxir.MWIR)
    np.testing.assert_array_equal(band_radiance(300.0, jaxir.MWIR), band_radiance(300.0, nodes))
    np.testing.assert_array_equal(band_radiance(300.0, (jaxir.MWIR,)), band_radiance(300.0, nodes))
    np.testing.assert_allclose(brightness_temperature(band_radiance(300.0, nodes), jaxir.MWIR), 300.0, rtol=1e-5)


@pytest.mark.parametrize("temperature", RADIANCE)
def test_band_radiance_is_that_of_the_table(temperature, precision):
    got = jax.jit(band_radiance)(as_float(temperature), gray_nodes(BANDS))
    np.testing.assert_allclose(np.asarray(got, np.float64), RADIANCE[temperature], rtol=TOLERANCE[precision])


MODES = {mode: jax.jit(mode(band_radiance)) for mode in (jax.jacfwd, jax.jacrev)}


@pytest.mark.parametrize("temperature", SLOPE)
@pytest.mark.parametrize("mode", MODES)
def test_slope_is_that_of_the_table(temperature, mode, precision):
    got = MODES[mode](as_float(temperature), gray_nodes(BANDS))
    rtol = {"float32": 1e-6, "float64": 5e-9}[precision]
    np.testing.assert_allclose(np.asarray(got, np.float64), SLOPE[temperature], rtol=rtol)


def test_second_derivative_is_that_of_the_slope(x64):
    nodes = gray_nodes(BANDS)
    curved = jax.jit(jax.jacfwd(jax.jacrev(band_radiance)))(as_float(500.0), nodes)
    below, above = (np.asarray(MODES[jax.jacfwd](as_float(500.0 + by), nodes)) for by in (-1e-2, 1e-2))
    np.testing.assert_allclose(curved, (above - below) / 2e-2, rtol=1e-7)


def test_derivatives_along_edges_are_radiances_per_wavenumber(x64):
    nodes = gray_nodes(jaxir.MWIR)

    def radiance(moved):
        return band_radiance(700.0, eqx.tree_at(lambda n: n.edge, nodes, nodes.edge.at[:, :, 0].add(moved[None])))[0]

    @jax.jit
    def slopes(moved):
        there = spectral_radiance(wavelength_to_wavenumber(as_float([5.0, 3.0])), as_float([700.0, 700.0]))
        return there / SECOND_RADIATION, jax.jacfwd(radiance)(moved), jax.jacrev(radiance)(moved)

    there, *modes = map(np.asarray, slopes(as_float([0.0, 0.0])))
    for found in modes:
        np.testing.assert_allclose(found, [-there[0], there[1]], rtol=1e-9)


every = jax.jit(band_radiance)


@jax.jit
def with_slope(temperature, nodes):
    return jax.jvp(lambda t: band_radiance(t, nodes), (temperature,), (jnp.ones_like(temperature),))


@pytest.mark.parametrize("shape", [(511,), (512,), (513,), (3, 400)])
def test_many_temperatures_are_as_one_by_one(shape, precision):
    temperature, nodes = np.random.default_rng(0).uniform(200, 2000, shape), gray_nodes(BANDS)
    radiance, slope = map(np.asarray, with_slope(as_float(temperature), nodes))
    assert radiance.shape == (*shape, 3)
    for at in ((0,) * len(shape), tuple(n - 1 for n in shape)):
        alone = with_slope(as_float(temperature[at]), nodes)
        np.testing.assert_allclose((radiance[at], slope[at]), alone, rtol=1e-6 if precision == "float32" else 1e-13)
    assert every(as_float(temperature[:0]), nodes).shape == (0, *shape[1:], 3)


@pytest.mark.parametrize("product", FRACTION)
def test_blackbody_fraction(product, precision):
    rtol = {"float32": 2e-6, "float64": 5e-9}[precision]
    np.testing.assert_allclose(float(blackbody_fraction(as_float(product))), FRACTION[product], rtol=rtol)


slope_of_each = jax.jit(jax.vmap(jax.jacfwd(band_radiance), (0, None)))


def _against_double(bands, temperatures):
    """Relative errors of value and slope in float32 against float64 where float32 can hold the result."""
    errors = []
    for function in (every, slope_of_each):
        with jax.enable_x64(False):
            single = np.asarray(function(as_float(temperatures), gray_nodes(bands)), np.float64)
        with jax.enable_x64(True):
            double = np.asarray(function(as_float(temperatures), gray_nodes(bands)))
        assert np.isfinite(single).all()
        held = double > 1e-35
        assert held.any()
        errors.append(np.abs(single[held] / double[held] - 1).max())
        assert np.abs(single[~held]).max(initial=0.0) < 1e-34
    return errors


def test_single_precision_from_3_to_6000_kelvin():
    temperatures = np.geomspace(3, 6000, 500).astype(np.float32)
    value, slope = _against_double(BANDS, temperatures)
    assert value < 1e-6
    assert slope < 1.5e-6


def test_narrow_bins_keep_their_digits():
    edges = 1e4 / np.array([820.0, 870.0, 2200.0, 2200.5, 9250.0, 9300.0])
    bands = [jaxir.Band(str(i), edges[2 * i + 1], edges[2 * i]) for i in range(3)]
    value, slope = _against_double(bands, np.geomspace(200, 4000, 500).astype(np.float32))
    assert value < 2e-6  # half a wavenumber in float32: the width itself is the difference of two edges
    assert slope < 3e-6


def test_bins_add_up_to_their_band(x64):
    edges = np.linspace(3.0, 5.0, 9)
    parts = [jaxir.Band(str(i), a, b) for i, (a, b) in enumerate(zip(edges[:-1], edges[1:], strict=True))]
    temperature = as_float([200.0, 500.0, 1500.0])
    whole = band_radiance(temperature, gray_nodes((jaxir.MWIR,)))[:, 0]
    np.testing.assert_allclose(band_radiance(temperature, gray_nodes(parts)).sum(axis=-1), whole, rtol=1e-13)


def test_all_bands_together_obey_stefan_boltzmann(x64):
    everything = gray_nodes((jaxir.Band("all", 0.05, 1e6),))
    got = band_radiance(as_float([300.0, 3000.0]), everything)[:, 0]
    np.testing.assert_allclose(got, 5.670374419e-8 / np.pi * np.array([300.0, 3000.0]) ** 4, rtol=1e-8)


def test_spectral_radiance_integrates_to_band_radiance(x64):
    nu = np.linspace(2000.0, 1e4 / 3, 20001)
    values = np.asarray(spectral_radiance(as_float(nu), as_float(np.full_like(nu, 500.0))))
    whole = float(band_radiance(as_float(500.0), gray_nodes((jaxir.MWIR,)))[0])
    assert np.trapezoid(values, nu) == pytest.approx(whole, rel=1e-8)
    wavelength = as_float([4.0])
    per_micron = spectral_radiance_wavelength(wavelength, as_float([500.0]))
    nu_4 = wavelength_to_wavenumber(wavelength)
    np.testing.assert_allclose(per_micron, spectral_radiance(nu_4, as_float([500.0])) * nu_4 / 4.0, rtol=1e-12)


def test_spectral_radiance_keeps_its_slope_when_cold():
    slope = jax.grad(lambda t: spectral_radiance(jnp.float32(3333.0), t))(jnp.float32(80.0))
    x = 1.4387768775 * 3333.0 / 80.0
    assert float(slope) == pytest.approx(1.1910429724e-8 * 3333.0**3 * np.exp(-x) * x / 80.0, rel=2e-5)


def test_brightness_temperature_inverts(precision):
    nodes = gray_nodes(BANDS)
    temperature = as_float([150.0, 255.0, 700.0, 2500.0, 3200.0, 6000.0, 1e6])
    got = brightness_temperature(nodes.in_band(band_radiance(temperature, nodes)), nodes)
    rtol = {"float32": 1e-6, "float64": 1e-10}[precision]
    np.testing.assert_allclose(got, np.repeat(np.asarray(temperature)[:, None], 3, 1), rtol=rtol)


def test_brightness_temperature_of_little_and_of_nothing():
    """A pixel that sees nothing was NaN, and so were slopes of faint ones."""
    radiance = jnp.asarray([0.0, 1e-20, 1e-3, 5.0], jnp.float32)[:, None]

    def kelvin(x):
        return brightness_temperature(x, jaxir.MWIR)

    found, slope = jax.jvp(kelvin, (radiance,), (jnp.ones_like(radiance),))
    assert found[0] == 0 and slope[0] == 0
    assert (np.diff(found[:, 0]) > 0).all()
    near = np.asarray(kelvin(1.01 * radiance)) - np.asarray(kelvin(0.99 * radiance))
    np.testing.assert_allclose(slope[1:] * radiance[1:], near[1:] / 0.02, rtol=2e-3)
    (back,) = jax.vjp(kelvin, radiance)[1](jnp.ones_like(radiance))
    np.testing.assert_allclose(back, slope, rtol=1e-5)


def test_what_has_no_temperature_and_no_radiance_is_refused():
    with pytest.raises(
        ValueError, match=r"brightness_temperature: radiance: got -1.0 at index \[1, 0\], expected .* >= 0"
    ):
        brightness_temperature(jnp.asarray([[1.0], [-1.0]]), jaxir.MWIR)
    with pytest.raises(ValueError, match=r"band_radiance: temperature: got 0.0, expected .* > 0"):
        band_radiance(jnp.zeros(()), jaxir.MWIR)


@pytest.mark.parametrize("edges", [(5.0, 3.0), (3.0, 3.0), (0.0, 3.0), (-1.0, 2.0), (1.0, float("inf"))])
def test_bands_with_wrong_edges_are_refused(edges):
    with pytest.raises(ValueError, match=r"Band 'x': got edges .* expected 0 < lower < upper"):
        jaxir.Band("x", *edges)


def test_no_band_is_refused():
    with pytest.raises(ValueError, match="bands: got"):
        gray_nodes(())


def test_the_temperature_that_a_filter_shows_is_that_behind_it():
    """The radiance that passes it, by the trapezoidal rule in double precision; of a band it is a part."""
    wavelength, passes = [3.0, 3.5, 4.0, 4.2, 5.0], [0.0, 1.0, 0.2, 1.0, 0.0]
    micron = np.linspace(3.0, 5.0, 200_001)
    kelvin, nu = [220.0, 300.0, 1500.0], 1e4 / micron
    spectral = np.stack([spectral_radiance_on_host(nu, each) for each in kelvin]) * nu**2 / 1e4
    seen = np.trapezoid(np.interp(micron, wavelength, passes) * spectral, micron, axis=1)[:, None]
    found = brightness_temperature(seen, jaxir.sensor_band("filter", wavelength, passes))
    np.testing.assert_allclose(found[:, 0], kelvin, rtol=2e-4)
