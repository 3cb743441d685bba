import numpy as np
import pytest

from jaxir.optics.gas import at_quantiles, bins_of, slot_means
from jaxir.optics.spectrum import Band, quantile_index, quantiles, resolved_nodes

BAND = Band("4.3", 1e4 / 2100, 1e4 / 2000)
GRID = 2000 + 0.01 * np.arange(10000)


def in_bins(seed):
    rng = np.random.default_rng(seed)
    return np.concatenate([rng.permutation((np.arange(2500) + 0.5) / 2500) for _ in range(4)])


def test_co2_takes_the_first_quantile():
    assert [quantile_index(species) for species in ("CO2", "H2O", "CO")] == [0, 1, 1]


def test_bins_share_the_grid():
    nodes = resolved_nodes(BAND, width=25.0, points=3)
    found = list(bins_of(nodes, GRID))
    assert [each.samples for each in found] == [slice(i, i + 2500) for i in (0, 2500, 5000, 7500)]
    assert np.array_equal(np.concatenate([each.nodes for each in found]), np.arange(12))


def test_quantiles_of_a_uniform_distribution_are_themselves():
    nodes = resolved_nodes(BAND, width=25.0, points=8)
    got = at_quantiles(nodes, 0, GRID, in_bins(1))
    assert np.allclose(got, np.asarray(nodes.g)[:, 0], rtol=1e-4, atol=2e-4)


def test_slots_of_the_ranking_spectrum_itself_hold_its_own_quantiles():
    """A transmittance that falls with rank has, in each slot, the mean over the slot of the quantile."""
    nodes = resolved_nodes(BAND, width=25.0, points=8)
    k = in_bins(2)
    got = slot_means(nodes, GRID, np.stack([k, 0 * k]), np.stack([3 * k, 0 * k]))[:8]
    edge = np.concatenate([[0], np.cumsum(quantiles(8)[1])])
    assert np.allclose(got, (np.exp(-3 * edge[:-1]) - np.exp(-3 * edge[1:])) / 3 / np.diff(edge), atol=1e-3)
    assert np.all(np.diff(got) < 0)


@pytest.mark.parametrize("overlap", [(), ((2000.0, 2100.0),)], ids=["equal quantiles", "square"])
def test_slots_keep_the_mean_of_the_bin(overlap):
    """In a square the mean is that of the product of two independent gases."""
    nodes = resolved_nodes(BAND, width=50.0, points=8, pair_points=4, overlap=overlap)
    first, second = in_bins(3), in_bins(4)
    got = slot_means(nodes, GRID, np.stack([first, second]), np.stack([first, 2 * second]))
    mean = np.bincount(np.unique(nodes.lower, return_inverse=True)[1], np.asarray(nodes.weight) * got)
    apart = [np.exp(-x).reshape(2, -1).mean(axis=1) for x in (first, 2 * second)]
    together = np.exp(-first - 2 * second).reshape(2, -1).mean(axis=1)
    assert np.allclose(mean, apart[0] * apart[1] if overlap else together, rtol=2e-6)


def test_a_grid_that_leaves_a_bin_uncovered_is_refused():
    nodes = resolved_nodes(BAND, width=25.0, points=2)
    for grid in (GRID[:-100], GRID[100:], GRID + 0.5, GRID[::2500] + 25):
        with pytest.raises(ValueError, match="all over it"):
            at_quantiles(nodes, 0, grid, np.ones_like(grid))
