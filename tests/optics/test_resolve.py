import jax.numpy as jnp
import numpy as np
import pytest

from jaxir.optics.band import LWIR, MWIR, SWIR, Band, gray_nodes, sensor_band
from jaxir.optics.planck import band_radiance
from jaxir.optics.resolve import quantiles, resolved_nodes


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
