import jax
import jax.numpy as jnp
import numpy as np

import jaxir
from jaxir._arrays import as_float
from jaxir.medium._jet_layers import KNOTS


def jet(**changed):
    given = dict(nozzle=(1.0, 0.0, 0.0), axis=(-3.0, 0.0, 0.0), diameter=0.8, exit_temperature=900.0)
    given = {**given, "gas": jaxir.GrayGas([0.5, 2.0]), **changed}
    return jaxir.JetPlume(**given, ambient_temperature=300.0)


def test_core_decay_edge_and_ends(precision):
    z = np.array([1e-6, 1.0, 3.9, 4.0, 8.0, 16.0, 39.9, 40.1, -0.1])
    on_axis = as_float(np.stack([1 - z, 0 * z, 0 * z], axis=-1))
    temperature, fraction = jet().state(on_axis)
    want = np.where((z > 0) & (z < 40), np.minimum(1, 4 / np.maximum(z, 1e-9)), 0)
    np.testing.assert_allclose(fraction, want, rtol=1e-6)
    np.testing.assert_allclose(temperature, 300 + 600 * want, rtol=1e-6)
    off_axis = [[1 - 2.0, 0.2 * s, 0.0] for s in (0.99, 1.0, 1.01)] + [[1 - 8.0, 0.0, r] for r in (2.15, 2.17)]
    inner, lip, outer, before, beyond = jet().state(as_float(off_axis))[1]
    assert inner == 1 and lip == 1 and outer < 1 and before > 0 and beyond == 0
    half = 2.16 * 0.5 ** (2 / 3)  # where eta^1.5 = 1/2
    np.testing.assert_allclose(jet().state(as_float([1 - 8.0, half, 0.0]))[1], 0.25, rtol=1e-5)


def test_its_extent_holds_the_jet():
    rng = np.random.default_rng(0)
    tilted = jet(axis=(-1.0, 0.5, -0.3))
    points = as_float(rng.uniform(-45, 45, (20000, 3)))
    corners, (_, fraction) = jax.jit(lambda jet: (jet.extent(), jet.state(points)))(tilted)
    corners, inside = np.asarray(corners), np.asarray(fraction) > 0
    assert inside.sum() > 100
    assert (np.asarray(points)[inside] >= corners.min(axis=0)).all()
    assert (np.asarray(points)[inside] <= corners.max(axis=0)).all()


def test_gray_absorption_follows_the_number_of_absorbers(precision):
    gas = jet().mixture(as_float([0.0, 0.5, 1.0]))
    np.testing.assert_allclose(
        gas.coefficient, np.array([0.0, 0.5 * 900 / 600, 1.0])[:, None] * [[0.5, 2.0]], rtol=1e-6
    )


def test_its_grid_holds_the_state_at_centres():
    grid = jaxir.Grid((-9.0, -1.0, -1.0), (1.0, 0.5, 0.4), (10, 4, 5))
    twin = jet().to_grid(grid)
    temperature, fraction = jet().state(grid.centres())
    np.testing.assert_array_equal(twin.temperature, temperature)
    np.testing.assert_array_equal(twin.gas.coefficient, jet().mixture(fraction).coefficient)
    assert jnp.unique(fraction).size > 10


def test_combustion_gas_is_diluted_by_air():
    kerosene = jaxir.combustion_products(12.0, 23.0, 1.0)
    gas = jaxir.NarrowBandGas(101325.0, kerosene.h2o, kerosene.co2)
    mixed = gas.diluted(as_float([0.0, 0.4, 1.0]), as_float([3.0, 1.0, 1.0]))
    want = jaxir.combustion_products(12.0, 23.0, 1.0)
    np.testing.assert_allclose(mixed.co2, np.array([0.0, 0.4, 1.0]) * float(want.co2), rtol=1e-6)
    np.testing.assert_allclose(mixed.o2, 0.20948 * np.array([1.0, 0.6, 0.0]), rtol=1e-4)
    nodes = jaxir.resolved_nodes([jaxir.Band("narrow", 4.2, 4.5)])

    @jax.jit
    def both(exhaust):
        fraction = as_float([0.25, 0.75])
        direct = exhaust.mixture(fraction).absorption(nodes, exhaust.temperature(fraction))
        return exhaust.medium(nodes).extinction, direct

    table, direct = map(np.asarray, both(jet(gas=gas)))
    np.testing.assert_allclose(table[[KNOTS // 4, 3 * KNOTS // 4]], direct, rtol=1e-5)
    assert (direct > 0).any()
