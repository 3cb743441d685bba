import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir.geometry import Rays
from jaxir.io.spectra import GasState, slot_atmosphere, tabulate
from jaxir.optics.air import Profile, us_standard_1976
from jaxir.optics.gas import CorrelatedK, CrossSections
from jaxir.optics.spectrum import Band, band_radiance, resolved_nodes
from jaxir.scene import nodes_error
from jaxir.scene.air import StandardAtmosphere
from studies import co2_lines as truth

ATMOSPHERE = truth.ATMOSPHERE
BAND = Band("4.3", 1e4 / 2400, 1e4 / 2000)
NODES = resolved_nodes(BAND, width=25.0)
TEMPERATURES, PRESSURES = (250.0, 300.0, 400.0, 600.0, 900.0, 1300.0, 1650.0, 2000.0), (5e3, 15e3, 40e3, 1e5, 2.5e5)
AIR = {"level": StandardAtmosphere(10e3, 10e3, 5e3), "ground": StandardAtmosphere(0.0, 10e3, 11544.0)}
CO2_IN_AIR = 400e-6


@pytest.fixture(scope="module")
def raw_table():
    return tabulate(truth.SPECTRA, NODES, TEMPERATURES, PRESSURES, (0.0, 0.2), progress=False)[0]


def cast(tree):
    """The same numbers in the precision in force."""
    return jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf), jnp.result_type(float)), tree)


@pytest.fixture(scope="module")
def paths():
    """Cold CO2 in the air of each path, per slot, with the plume's hottest state at a temperature."""

    def path(name, temperature):
        hottest = GasState(temperature, 0.3 * ATMOSPHERE, {"CO2": 0.06})
        return slot_atmosphere(truth.SPECTRA, NODES, AIR[name], {"CO2": CO2_IN_AIR}, hottest, 8, progress=False)

    return path


def line_by_line(layers, air=None):
    """In-band radiance [W m-2 sr-1]."""
    spectrum = truth.radiance(layers, truth.air_depth(AIR[air], CO2_IN_AIR) if air else 0.0)
    return spectrum[(truth.GRID > 2000 - 1e-6) & (truth.GRID < 2400 - 1e-6)].mean() * 400


@jax.jit
def emitted(table, nodes, temperature, pressure, amount, thickness):
    """Radiance of layers [node] and their depths [layer, node]."""
    gas = CorrelatedK([table], pressure, {"CO2": amount})
    depth = thickness[:, None] * gas.absorption(nodes, temperature)
    before = jnp.exp(-jnp.concatenate([jnp.zeros_like(depth[:1]), jnp.cumsum(depth[:-1], axis=0)]))
    return jnp.sum(before * -jnp.expm1(-depth) * band_radiance(temperature, nodes), axis=0)


def correlated_k(table, layers):
    return emitted(cast(table), cast(NODES), *(jnp.asarray(column) for column in np.array(layers).T))


def bin_means(transmittance):
    """Mean over each bin [node] of a transmittance per node."""
    where = np.unique(NODES.lower, return_inverse=True)[1]
    return np.bincount(where, np.asarray(NODES.weight) * np.asarray(transmittance))[where]


PLUME = 0.3 * ATMOSPHERE


@pytest.mark.parametrize("temperature", [330.0, 640.0, 1000.0, 1500.0])
def test_one_temperature_is_line_by_line(raw_table, temperature):
    for thickness in (0.003, 0.1, 1.0, 10.0):
        layers = [(temperature, PLUME, 0.06, thickness)]
        got = float(NODES.in_band(correlated_k(raw_table, layers))[0])
        assert got == pytest.approx(line_by_line(layers), rel=0.013)


@pytest.mark.parametrize("air", list(AIR))
@pytest.mark.parametrize(
    ("temperature", "amount", "thickness", "product"),
    [(1500.0, 0.06, 0.05, 0.03), (1000.0, 0.06, 1.0, 0.025), (1000.0, 0.06, 0.01, 0.12), (650.0, 0.01, 0.1, 0.4)],
    ids=["1500 K", "1000 K", "dilute", "warm"],
)
def test_hot_gas_behind_cold_air(raw_table, paths, air, temperature, amount, thickness, product):
    """The slots keep lines together: 2 %, where the product with the bins' means errs by `product` and more."""
    layers = [(temperature, PLUME, amount, thickness)]
    path, radiance = paths(air, temperature), correlated_k(raw_table, layers)
    exact = line_by_line(layers, air)
    slots = path.on(NODES).transmittance
    assert float(NODES.in_band(radiance * slots)[0]) == pytest.approx(exact, rel=0.02)
    assert float(NODES.in_band(radiance * bin_means(slots))[0]) > (1 + product) * exact


@pytest.mark.parametrize(
    ("air", "thickness", "error"), [(None, 0.2, -0.014), (None, 0.02, -0.045), ("level", 0.2, -0.019)]
)
def test_layers_of_one_plume_lose_rank(raw_table, paths, air, thickness, error):
    """What the docstring says of hot gas behind colder gas of the same plume."""
    layers = [(t, PLUME, 0.06, thickness) for t in (400.0, 650.0, 1000.0, 1500.0, 1000.0, 650.0, 400.0)]
    slots = paths(air, 1500.0).on(NODES).transmittance if air else 1.0
    got = float(NODES.in_band(correlated_k(raw_table, layers) * slots)[0])
    assert got / line_by_line(layers, air) - 1 == pytest.approx(error, abs=0.004)


def test_air_at_the_temperature_of_a_furnace_adds_what_it_takes():
    level = us_standard_1976()
    warm = Profile(level.altitude, jnp.full_like(level.altitude, 260.0), level.pressure, level.h2o, level.o3)
    air, hottest = StandardAtmosphere(0.0, 10e3, 11544.0, warm), GasState(1000.0, PLUME, {"CO2": 0.06})
    path = slot_atmosphere(truth.SPECTRA, NODES, air, {"CO2": CO2_IN_AIR}, hottest, 3, progress=False)
    expected = (1 - path.on(NODES).transmittance) * band_radiance(jnp.asarray(260.0), NODES)
    assert np.allclose(path.on(NODES).path_radiance, expected, rtol=1e-4, atol=1e-9)


def test_a_scene_on_the_same_nodes(raw_table, paths):
    """A wall of gas along a ray: the same numbers as by hand."""
    layers = [(1500.0, PLUME, 0.06, 0.25), (900.0, 0.5 * PLUME, 0.02, 0.25)]
    kelvin, pressure, amount = (np.array(column)[::-1, None, None] for column in list(zip(*layers, strict=True))[:3])
    gas = jaxir.CorrelatedK([raw_table], pressure, {"CO2": amount})
    plume = jaxir.GridPlume(jaxir.Grid((-0.25, -1.0, -1.0), (0.25, 2.0, 2.0), (2, 1, 1)), kelvin, gas)
    scene = jaxir.Scene(plumes=plume, atmosphere=paths("level", 1500.0))
    rays = Rays(jnp.asarray([[5.0, 0.0, 0.0]]), jnp.asarray([[-1.0, 0.0, 0.0]]))
    seen = eqx.filter_jit(lambda s, n: jaxir.evaluate(s.on(n), jaxir.trace(s, rays)))(scene, NODES)
    path = paths("level", 1500.0)
    by_hand = correlated_k(raw_table, layers) * path.on(NODES).transmittance + path.on(NODES).path_radiance
    assert np.allclose(seen[0], by_hand, rtol=1e-4)
    assert nodes_error(scene, NODES) is None  # there are no finer tables to compare with


def test_line_by_line_has_the_same_interface():
    """Bins as narrow as the grid, one quantile, one level per axis: the spectrum itself."""
    nodes = resolved_nodes(Band("lines", 1e4 / 2301, 1e4 / 2300), width=truth.STEP, points=1)
    inside = (truth.GRID > 2300 - 1e-6) & (truth.GRID < 2301 - 1e-6)
    table = tabulate(truth.SPECTRA, nodes, [1000.0], [PLUME], [0.0], progress=False)
    got = CorrelatedK(table, PLUME, {"CO2": 0.06}).absorption(nodes, jnp.asarray(1000.0))
    assert nodes.count == 250
    assert np.allclose(got, truth.absorption(1000.0, PLUME, 0.06)[inside], rtol=2e-5)


def test_species_overlap_at_random_in_squares():
    """Two gases of equal distribution, in a bin with a square of quantiles: the product of their transmittances."""
    nodes = resolved_nodes(Band("4.3", 1e4 / 2350, 1e4 / 2300), pair_points=8, overlap=((2300.0, 2350.0),))
    both = truth.SPECTRA._replace(absorbers={"CO2": truth.cross_section, "H2O": truth.cross_section})
    tables = tabulate(both, nodes, [1000.0], [PLUME], [0.0], progress=False)

    def mean(amounts):
        kappa = CorrelatedK(tables, PLUME, amounts).absorption(nodes, jnp.asarray(1000.0))
        return float(jnp.exp(-0.3 * kappa) @ nodes.weight)

    assert mean({"CO2": 0.06, "H2O": 0.03}) == pytest.approx(mean({"CO2": 0.06}) * mean({"H2O": 0.03}), rel=1e-4)


@eqx.filter_jit
def absorption(table, nodes, temperature, pressure, amount):
    return CorrelatedK([table], pressure, {"CO2": amount}).absorption(nodes, temperature)


def test_fields_of_cells_and_scalars_agree(raw_table):
    table, nodes = raw_table, NODES
    hot = np.linspace(280.0, 2000.0, 6).reshape(2, 3)

    def found(*state):
        return np.asarray(absorption(table, nodes, *(jnp.asarray(x, np.float32) for x in state)))

    full = found(hot, np.full((2, 3), PLUME), np.full((2, 3), 0.06))
    assert full.shape == (2, 3, nodes.count) and full.dtype == np.float32
    for pressure, amount in ((PLUME, 0.06), (np.full((2, 3), PLUME), 0.06), (PLUME, np.full((2, 3), 0.06))):
        assert np.allclose(found(hot, pressure, amount), full, rtol=1e-4)
    assert np.allclose(found(hot[1, 1], PLUME, 0.06), full[1, 1], rtol=1e-4)


def test_single_precision_is_enough(raw_table):
    states = jnp.asarray([290.0, 1000.0, 2300.0]), jnp.asarray([8e3, 3e4, 2e5]), jnp.asarray([0.01, 0.05, 0.1])
    single = absorption(raw_table, NODES, *states)
    with jax.enable_x64(True):
        double = absorption(cast(raw_table), cast(NODES), *(jnp.asarray(np.asarray(x, np.float64)) for x in states))
        assert np.allclose(single, double, rtol=2e-5)


def test_gradients_match_differences_in_both_modes(raw_table, x64):
    table, nodes = cast(raw_table), cast(NODES)
    weight = band_radiance(jnp.asarray(1000.0), nodes)

    def value(p):
        gas = CorrelatedK([table], p[1] * 1e4, {"CO2": p[2]})
        return (-jnp.expm1(-0.1 * gas.absorption(nodes, p[0] * 100)) * weight).sum()

    every = jax.jit(lambda p: (*jax.value_and_grad(value)(p), jax.jacfwd(value)(p)))
    for temperature, pressure in ((220.0, 3.0), (600.0, 4.0), (777.0, 0.3), (1300.0, 3.0), (2600.0, 30.0)):
        at = np.array([temperature / 100, pressure, 0.06])
        _, reverse, forward = map(np.asarray, every(jnp.asarray(at)))
        assert np.allclose(reverse, forward, rtol=1e-10)
        for i, change in enumerate(np.diag(1e-5 * at)):
            after, before = (float(every(jnp.asarray(at + sign * change))[0]) for sign in (1, -1))
            assert float(reverse[i]) == pytest.approx((after - before) / (2e-5 * at[i]), rel=1e-5)


def test_no_step_in_value_or_slope_across_levels(raw_table, x64):
    """In temperature and in pressure, at the ends of the table too."""
    table = cast(raw_table)

    @jax.jit
    def both(temperature, pressure):
        def log_kappa(t, p):
            return jnp.log(table.at(t, p, jnp.asarray(0.06)))

        return [log_kappa(temperature, pressure)] + [
            jax.jvp(lambda s: log_kappa(temperature * s[0], pressure * s[1]), (jnp.ones(2),), (jnp.eye(2)[i],))[1]
            for i in range(2)
        ]

    pairs = [(level, 3e4, "temperature") for level in TEMPERATURES] + [(900.0, p, "pressure") for p in PRESSURES]
    for temperature, pressure, moved in pairs:
        below, above = (
            both(
                *(
                    jnp.asarray(x * (1 + e * (name == moved)))
                    for x, name in ((temperature, "temperature"), (pressure, "pressure"))
                )
            )
            for e in (-1e-7, 1e-7)
        )
        for left, right in zip(below, above, strict=True):
            assert np.allclose(left, right, rtol=1e-5, atol=1e-5)


def test_beyond_the_table_the_tangent_goes_on(raw_table, x64):
    table = cast(raw_table)

    def log_sigma(temperature, pressure, amount):
        return jnp.log(table.at(*(jnp.asarray(float(x)) for x in (temperature, pressure, amount))))

    for inverse in (1 / TEMPERATURES[0], 1 / TEMPERATURES[-1]):  # in 1/T
        start, near, far = (
            log_sigma(1 / (inverse * (1 + e * (1 if inverse > 1e-3 else -1))), 3e4, 0.06) for e in (0, 0.01, 0.2)
        )
        assert np.allclose(far - start, 20 * (near - start), rtol=1e-6, atol=1e-9)
        assert np.abs(far - start).max() < 6
    for end, out in ((5e3, 0.5), (2.5e5, 2.0)):  # in ln p
        start, near, far = (log_sigma(900.0, end * out**e, 0.06) for e in (0, 0.05, 1))
        assert np.allclose(far - start, 20 * (near - start), rtol=1e-6, atol=1e-9)
        assert np.abs(far - start).max() < 1
    start, near, far = (log_sigma(900.0, 3e4, 0.2 + e) for e in (0, 0.01, 0.2))
    assert np.allclose(far - start, 20 * (near - start), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("temperature", [1e-3, 1.0, 5000.0])
def test_cross_sections_of_any_temperature_are_finite(temperature):
    """Also of lines that grow weaker as a gas warms, which go on as exp(-E / k T) with E below 0."""
    levels = [300.0, 1000.0, 2500.0]
    sigma = np.array([1e-20, 1e-24, 1e-27])[:, None, None, None] * np.ones((3, 1, 1, NODES.count))
    table = CrossSections("CO2", NODES, levels, [1e5], [0.1], sigma)
    seen = jax.jit(jax.value_and_grad(lambda t: jnp.sum(table.at(t, jnp.asarray(1e5), jnp.asarray(0.1)))))
    assert np.all(np.isfinite(seen(jnp.asarray(temperature))))
    cold = [float(seen(jnp.asarray(200.0 + d))[1]) for d in (-0.01, 0.01)]
    assert cold[0] == pytest.approx(cold[1], rel=2e-2)


@pytest.mark.parametrize("temperature", [1.0, 300.0, 900.0, 4000.0])
def test_slopes_of_the_coefficient_are_finite_and_right(temperature, precision):
    """In temperature, where k T squared is beyond float32: -kappa / T if the cross-section is constant."""
    table = CrossSections("CO2", cast(NODES), [300.0, 2500.0], [1e5], [0.1], np.full((2, 1, 1, NODES.count), 1e-24))

    def kappa(t):
        return CorrelatedK((table,), 1e5, {"CO2": 0.1}).absorption(cast(NODES), t[None])[0]

    value, slope = jax.jvp(kappa, (jnp.asarray(temperature),), (jnp.asarray(temperature),))
    np.testing.assert_allclose(slope, -value, rtol=1e-5)


def test_gas_that_is_not_there_has_a_finite_gradient(raw_table, precision):
    table, nodes = cast(raw_table), cast(NODES)
    hot = jnp.asarray([255.0, 900.0])

    def value(x):
        return absorption(table, nodes, hot, jnp.asarray(3e4), x).sum()

    without, slope = jax.jit(jax.value_and_grad(value))(jnp.asarray(0.0))
    assert np.isfinite(slope) and float(slope) > 0 and float(without) == 0


def test_air_dilutes(raw_table):
    share = jnp.asarray([0.0, 0.5, 1.0])
    hot = jnp.full(3, 900.0)
    mixed = CorrelatedK([raw_table], 3e4, {"CO2": 0.1}).diluted(share, share)
    assert np.allclose(mixed.mole_fractions["CO2"], [0.0, 0.05, 0.1])
    alone = CorrelatedK([raw_table], 3e4, {"CO2": [0.0, 0.05, 0.1]}).absorption(NODES, hot)
    assert np.allclose(mixed.absorption(NODES, hot), alone)
    with pytest.raises(ValueError, match="expected scalars"):
        mixed.diluted(share, share)


def test_bad_input_is_refused(raw_table):
    gas = CorrelatedK([raw_table], 3e4, {"CO2": 0.06})
    with pytest.raises(ValueError, match=r"got \['SO2'\], expected some of \['CO2'\]"):
        CorrelatedK([raw_table], 3e4, {"CO2": 0.06, "SO2": 0.1})
    with pytest.raises(ValueError, match="no species"):
        CorrelatedK([raw_table], 3e4, {})
    with pytest.raises(ValueError, match="shapes"):
        CorrelatedK([raw_table], jnp.ones(2), {"CO2": jnp.ones(3)})
    with pytest.raises(ValueError, match="expected cells"):
        CorrelatedK([raw_table], 3e4, {"CO2": jnp.ones(3)}).absorption(NODES, jnp.asarray(900.0))
    with pytest.raises(ValueError, match="got 16 nodes, expected the table's 128"):
        gas.absorption(resolved_nodes(BAND, width=25.0, points=1), jnp.asarray(900.0))
    moved = resolved_nodes(Band("moved", 1e4 / 2500, 1e4 / 2100), width=25.0)
    with pytest.raises(ValueError, match="lower: got 2100.*the table was made for"):
        gas.absorption(moved, jnp.asarray(900.0))
    refused = [check for check in CorrelatedK([raw_table], -1.0, {"CO2": 1.1}).checks() if not check.doubt]
    failing = [check.field for check in refused if not bool(check.ok.all())]
    assert failing == [
        "CorrelatedK.pressure",
        "CorrelatedK.pressure",
        "CorrelatedK.mole_fractions.CO2",
        "CorrelatedK: sum of mole fractions",
    ]
    for change, what in (
        ({"temperature": [300.0, 300.0]}, "temperature.*increasing"),
        ({"temperature": [0.0, 300.0]}, "temperature.*> 0"),
        ({"pressure": [np.nan]}, "pressure.*> 0"),
        ({"cross_section": np.full((2, 1, 1, 128), -1.0)}, "negative"),
        ({"cross_section": np.ones((2, 1, 1, 5))}, r"got shape \(2, 1, 1, 5\), expected \(2, 1, 1, 128\)"),
    ):
        good = {"temperature": [300.0, 600.0], "pressure": [1e5], "cross_section": np.ones((2, 1, 1, 128))}
        with pytest.raises(ValueError, match=what):
            CrossSections("CO2", NODES, mole_fraction=[0.0], **{**good, **change})


def test_the_leaves_that_scale_with_the_amount_of_gas(raw_table):
    gas = CorrelatedK([raw_table], 1e5, {"CO2": 0.1})
    assert len(gas.amounts()) == 1 and gas.amounts()[0] is gas.mole_fractions["CO2"]
