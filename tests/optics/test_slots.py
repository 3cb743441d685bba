import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxir.optics import _slots
from jaxir.optics.air import path_air, path_transmittance, slot_path, us_standard_1976
from jaxir.optics.spectrum import MWIR, Band, band_radiance, resolved_nodes
from studies import co2_lines as lines
from studies import co2_tables

BAND = Band("4.3", 1e4 / 2400, 1e4 / 2000)
GROUND = (us_standard_1976(), jnp.asarray(0.0), jnp.asarray(10e3), jnp.asarray(11544.0))


def test_the_shipped_table_is_what_the_lines_say():
    """One bin at one state of the hot and one of the cold gas, made anew."""
    table, row = _slots.co2_slots(), 5
    inside = slice(*np.searchsorted(lines.GRID, table.edges[row : row + 2] - 1e-6))
    hot = lines.cross_section(table.hot_temperature[3], table.hot_pressure[2])[inside]
    np.testing.assert_allclose(table.hot[3, 2, row], co2_tables.quantiles(hot), atol=1e-3)
    rank = lines.cross_section(table.reference[1], co2_tables.REFERENCE_PRESSURE)[inside]
    first = lines.cross_section(*co2_tables.COLD_REFERENCE)[inside]
    made = co2_tables.cell_means(first, co2_tables.cells(rank, first))
    pressure = list(table.cold_pressure).index(co2_tables.COLD_REFERENCE[1])
    np.testing.assert_allclose(table.cold[1, 1, pressure, row].ravel(), made, atol=2e-3)
    assert all(np.isfinite(array).all() for array in table)


PATH = jax.jit(slot_path)


@pytest.mark.parametrize("width, points", [(50.0, 8), (200.0, 32), (25.0, 4)])
def test_a_node_stands_for_its_share_of_the_bin(width, points):
    nodes = resolved_nodes(BAND, width, points, 0)
    start, share = np.asarray(nodes.slot)[:, 0].T
    np.testing.assert_allclose(share, nodes.weight, atol=1e-6)
    assert np.all((start <= nodes.g[:, 0]) & (nodes.g[:, 0] <= start + share))
    np.testing.assert_array_equal(nodes.slot[:, 0], nodes.slot[:, 1])


def test_nodes_of_a_square_share_the_slots_of_their_first_quantile():
    nodes = resolved_nodes(BAND, 50.0, 8, 2, overlap=((2000.0, 2400.0),))
    for quantile, shared in ((0, 2), (1, 1)):  # the second quantile runs fastest
        start, share = np.asarray(nodes.slot)[:, quantile].reshape(8, 2, 2, 2).transpose(3, 0, 1, 2)
        np.testing.assert_allclose(start, np.broadcast_to(start.take([0], shared), start.shape))
        np.testing.assert_allclose(share.take(0, shared).sum(axis=1), 1, atol=1e-6)
        np.testing.assert_allclose(start.take(0, shared)[:, 0], 0)


@pytest.mark.parametrize("hottest", [300.0, 1000.0, 3000.0])
def test_slots_keep_the_mean_of_every_bin(hottest):
    nodes = resolved_nodes(MWIR, 50.0, 4, 3)
    air = path_air(*GROUND)
    passed, emitted = PATH(air, nodes, jnp.asarray(hottest))
    lower = np.asarray(nodes.lower)
    mean = np.array([np.sum(np.where(lower == x, nodes.weight * passed, 0)) for x in lower])
    np.testing.assert_allclose(mean, path_transmittance(air, nodes), atol=2e-6)
    assert float(passed.min()) >= 0 and float(passed.max()) <= 1 + 1e-6 and float(emitted.min()) > -1e-7
    strong = (lower >= 2200) & (lower < 2250)
    assert np.all(np.diff(np.asarray(passed)[strong]) < 0)  # the stronger hot lines are, the less passes


def test_a_furnace_of_air():
    standard, warm = us_standard_1976(), 270.0
    level = jnp.full_like(standard.altitude, warm)
    profile = type(standard)(standard.altitude, level, standard.pressure, standard.h2o, standard.o3)
    nodes = resolved_nodes(MWIR, 50.0, 4, 3)
    passed, emitted = PATH(path_air(profile, *GROUND[1:]), nodes, jnp.asarray(1100.0))
    np.testing.assert_allclose(emitted, (1 - passed) * band_radiance(jnp.asarray(warm), nodes), rtol=2e-3, atol=1e-7)
