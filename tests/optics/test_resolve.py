import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir.geometry import Rays
from jaxir.optics.spectrum import (
    LWIR,
    MWIR,
    RESOLUTIONS,
    SWIR,
    Band,
    Resolution,
    band_radiance,
    finer_nodes,
    gray_nodes,
    nodes_for,
    quantiles,
    resolved_nodes,
    sensor_band,
)
from tests.scenes import plate


def bins(nodes):
    return np.unique(np.stack([nodes.lower, nodes.upper], axis=1), axis=0)


@pytest.mark.parametrize("band", [SWIR, MWIR, LWIR])
@pytest.mark.parametrize("width", [25.0, 50.0, 130.0])
def test_bins_tile_the_band_and_weights_sum_to_one(band, width):
    nodes = resolved_nodes(band, width)
    edges = bins(nodes)
    assert edges[0, 0] == pytest.approx(1e4 / band.upper) and edges[-1, 1] == pytest.approx(1e4 / band.lower)
    assert np.allclose(edges[1:, 0], edges[:-1, 1])
    assert (np.diff(edges, axis=1) <= width * (1 + 1e-6)).all()
    total = np.bincount(np.unique(nodes.lower, return_inverse=True)[1], np.asarray(nodes.weight))
    assert np.allclose(total, 1, atol=1e-6)
    assert np.all(np.asarray(nodes.response) == 1)


RESPONSES = {
    "narrow": ([3.0, 3.425, 3.43, 3.44, 3.445, 5.0], [0, 0, 1, 1, 0, 0]),
    "saw": (np.linspace(3.9, 4.1, 9), [0, 1, 0, 1, 0, 1, 0, 1, 0]),
    "notch": ([3.0, 3.9, 4.0, 4.3, 4.4, 5.0], [1, 1, 0, 0, 1, 1]),
    "ramp": ([8.0, 12.0], [0.0, 1.0]),
}


@pytest.mark.parametrize("width", [50.0, 200.0])
@pytest.mark.parametrize("name", RESPONSES)
def test_a_response_is_resolved_where_it_varies_with_planck_s_law(name, width, x64):
    wavelength, response = RESPONSES[name]
    nodes = resolved_nodes(sensor_band(name, wavelength, response), width, 1, 0)
    assert np.asarray(nodes.response).min() > 0  # none where nothing is seen
    knots = [np.linspace(a, b, 2001) for a, b in zip(wavelength[:-1], wavelength[1:], strict=True)]
    at = np.unique(np.concatenate(knots))
    for temperature in (250.0, 300.0, 1000.0):
        each = np.interp(at, wavelength, response) / at**5 / np.expm1(14387.768775 / (at * temperature))
        expected = 1.1910429723971884e8 * np.trapezoid(each, at)
        got = nodes.in_band(band_radiance(jnp.asarray(temperature), nodes))[0]
        assert float(got) == pytest.approx(expected, rel=2e-3)


def test_bin_sum_of_planck_is_the_band(precision):
    nodes, gray = resolved_nodes([SWIR, MWIR, LWIR], points=3), gray_nodes([SWIR, MWIR, LWIR])
    temperature = np.asarray([255.0, 1000.0, 2000.0], precision)
    fine = nodes.in_band(band_radiance(jnp.asarray(temperature), nodes))
    assert np.allclose(fine, band_radiance(jnp.asarray(temperature), gray), rtol=2e-6)


def test_overlapping_bands_share_bins():
    both = resolved_nodes([Band("a", 3.0, 5.0), Band("b", 4.0, 4.5)])
    edges = bins(both)
    assert np.all(edges[1:, 0] == edges[:-1, 1])
    inside = (np.asarray(both.lower) >= 1e4 / 4.5 - 0.01) & (np.asarray(both.upper) <= 2500.01)
    assert np.array_equal(np.asarray(both.response[1]), inside.astype(np.float32))
    assert np.all(np.asarray(both.response[0]) == 1)


def test_gap_between_bands_has_no_nodes():
    nodes = resolved_nodes([MWIR, LWIR])
    assert not ((np.asarray(nodes.lower) > 1249.9) & (np.asarray(nodes.upper) < 2000.1)).any()


def test_edge_equal_to_a_multiple_makes_no_sliver():
    edges = bins(resolved_nodes(LWIR))
    assert (edges[:, 1] - edges[:, 0]).min() > 16  # 833.3-850; the last bin ends at 1250


def test_pairs_are_a_square_only_where_two_gases_overlap():
    nodes = resolved_nodes(LWIR, points=4, pair_points=3)
    lower, g = np.asarray(nodes.lower), np.asarray(nodes.g)
    assert (lower < 1150).sum() == 7 * 9 and (lower >= 1150).sum() == 2 * 4
    assert np.all(g[lower >= 1150, 0] == g[lower >= 1150, 1])
    assert len(np.unique(g[:9], axis=0)) == 9
    assert resolved_nodes(LWIR, points=4, pair_points=0).count == 9 * 4


@pytest.mark.parametrize("points", [1, 4, 8])
def test_quantiles_integrate_one(points):
    g, weight = quantiles(points)
    assert weight.sum() == pytest.approx(1) and np.all((g > 0) & (g < 1))


def test_sensor_response_weights_radiance():
    wavelength = np.linspace(3.0, 5.0, 41)
    flat = sensor_band("flat", wavelength, np.full(41, 0.5))
    assert np.allclose(resolved_nodes(flat).response, 0.5) and np.allclose(gray_nodes([flat]).response, 0.5)
    ramp = resolved_nodes(sensor_band("ramp", [3.0, 5.0], [0.0, 1.0]), width=10.0, points=1)
    centre = 2e4 / (np.asarray(ramp.lower) + np.asarray(ramp.upper))
    assert np.allclose(ramp.response[0], (centre - 3) / 2, atol=1e-4)


@pytest.mark.parametrize(
    ("wavelength", "response", "what"),
    [
        ([3.0, 3.0, 4.0], [1, 1, 1], "increasing"),
        ([3.0, 4.0], [1, -1], ">= 0"),
        ([3.0], [1], "two equal lengths"),
        ([3.0, 4.0], [1, 1, 1], "two equal lengths"),
    ],
)
def test_bad_response_is_refused(wavelength, response, what):
    with pytest.raises(ValueError, match=what):
        sensor_band("bad", wavelength, response)


@pytest.mark.parametrize(
    "arguments",
    [{"bands": ()}, {"width": 0.0}, {"width": np.inf}, {"points": 0}, {"pair_points": 99}],
)
def test_bad_arguments_are_refused(arguments):
    with pytest.raises(ValueError, match="got"):
        resolved_nodes(**{"bands": MWIR, **arguments})


def test_gray_scenes_need_one_node_per_band():
    nodes = nodes_for(lambda nodes: nodes.in_band(0.8 * band_radiance(jnp.asarray(400.0), nodes)), [MWIR, LWIR], 1e-4)
    assert nodes.count == 2


def test_coarsest_nodes_that_meet_the_tolerance():
    @jax.jit
    def gas_like(nodes):  # a spectrum of lines: k = exp(6 g), stronger at the band's red end
        depth = 0.01 * jnp.exp(6 * nodes.g[:, 0]) * (2500 / nodes.lower)
        return nodes.in_band(-jnp.expm1(-depth) * band_radiance(jnp.asarray(900.0), nodes))

    counts, ladder = [], [Resolution(100.0, n, 0) for n in (16, 1, 2, 4, 8)]
    reference = np.asarray(gas_like(resolved_nodes(MWIR, *ladder[0])))
    for rtol in (0.2, 0.01, 1e-4, 1e-9):
        nodes = nodes_for(gas_like, MWIR, rtol, ladder)
        assert np.all(np.abs(np.asarray(gas_like(nodes)) / reference - 1) <= rtol)
        counts.append(nodes.count)
    assert counts == sorted(counts) and counts[0] < counts[-1] == resolved_nodes(MWIR, *ladder[0]).count


def test_a_plume_behind_air_needs_more_than_one_node():
    """A ray through real gas and air: the first of the ladder that agrees with the finest, and not a node more."""
    grid = jaxir.Grid((-1.0, -0.5, -0.5), (1.0, 1.0, 1.0), (2, 1, 1))
    gas = jaxir.NarrowBandGas(3e4, h2o=0.0754, co2=0.063)
    air = jaxir.StandardAtmosphere(10e3, 10e3, 5e3)
    scene = jaxir.Scene(plumes=jaxir.GridPlume(grid, np.array([900.0, 1400.0])[:, None, None], gas), atmosphere=air)
    rays = Rays(jnp.asarray([[5.0, 0.0, 0.0]]), jnp.asarray([[-1.0, 0.0, 0.0]]))
    look = eqx.filter_jit(lambda scene, nodes: nodes.in_band(jaxir.evaluate(scene.on(nodes), jaxir.trace(scene, rays))))
    found = {}

    def radiance(nodes):
        return found.setdefault(nodes.count, look(scene, nodes))

    ladder = [Resolution(50.0, 4, 3), Resolution(50.0, 8, 5)]
    chosen = nodes_for(radiance, MWIR, 0.02, ladder)
    error = {count: abs(float(value[0, 0]) / float(found[max(found)][0, 0]) - 1) for count, value in found.items()}
    assert chosen.count == resolved_nodes(MWIR, *ladder[0]).count
    assert error[chosen.count] < 0.02
    assert all(value > 0.02 for count, value in error.items() if count < chosen.count)


def test_bad_searches_are_refused():
    for change, what in (({"rtol": 0.0}, "rtol"), ({"resolutions": ()}, "none"), ({"bands": ()}, "at least one")):
        with pytest.raises(ValueError, match=what):
            nodes_for(**{"radiance": lambda nodes: nodes.weight, "bands": MWIR, "rtol": 0.1, **change})
    with pytest.raises(ValueError, match="not finite"):
        nodes_for(lambda nodes: nodes.weight * jnp.nan, MWIR, 0.1)


@pytest.mark.parametrize(
    ("hot_strength", "cold_strength", "exact"), [(0.05, 0.05, 0.040379), (0.5, 0.5, 0.093672), (2.0, 2.0, 0.138059)]
)
def test_hot_line_through_the_same_cold_line(hot_strength, cold_strength, exact):
    """Lorentz lines s w / (nu^2 + w^2), w = 0.05, in a window of +-1: one quantile serves both."""
    g, weight = quantiles(24)
    offset = 1 - g  # the line is strongest at its centre
    depth = {s: s * 0.05 / (offset**2 + 0.05**2) for s in (hot_strength, cold_strength)}
    emitted, passed = -np.expm1(-depth[hot_strength]), np.exp(-depth[cold_strength])
    assert weight @ (emitted * passed) == pytest.approx(exact, rel=1e-3)
    assert (weight @ emitted) * (weight @ passed) > 1.3 * exact


def test_nodes_are_refined_to_the_finest_of_their_bands():
    bands = (MWIR, LWIR)
    finest = resolved_nodes(bands, *RESOLUTIONS[-1])
    for coarse in (gray_nodes(bands), resolved_nodes(bands, 200.0, 4, 3), resolved_nodes(bands)):
        found = finer_nodes(coarse)
        for name in ("lower", "upper", "g", "weight", "response"):
            np.testing.assert_allclose(getattr(found, name), getattr(finest, name), rtol=1e-6)


def test_values_for_bands_are_those_of_the_bands_where_each_has_one_node():
    """Ascending wavenumbers had them in the other order, and 5 and 50 W m-2 were exchanged."""
    bands = Band("a", 8.0, 10.0), Band("b", 10.0, 12.0)
    one, fine = (resolved_nodes(bands, width, 1, 0) for width in (2000.0, 100.0))
    assert one.count == 2
    given = jaxir.UniformBackground([3.0, 7.0])
    for nodes in (one, fine):
        lit = jaxir.Scene(plate(), background=given).on(nodes)
        seen = nodes.in_band(lit.background(jnp.asarray([0.0, 0.0, -1.0])))
        np.testing.assert_allclose(seen, [3.0, 7.0], rtol=1e-5)


def test_a_node_of_two_bands_is_not_taken_for_one_of_them():
    """With as many nodes as bands that overlap, one number for every band was twice that in the wider."""
    nodes = resolved_nodes((Band("a", 8.0, 10.0), Band("b", 8.0, 12.0)), 2000.0, 1, 0)
    assert nodes.count == 3 and float(nodes.weight[-1]) == 0
    scene = jaxir.Scene(plate(), background=jaxir.UniformBackground(3.0))
    with pytest.raises(ValueError, match="UniformBackground.radiance: bands of a node: got 2"):
        jaxir.render(scene, jaxir.orthographic_camera(0.0, 0.0, 1.0, (2, 2)), nodes)
