import numpy as np
import pytest

import jaxir
from jaxir.io.spectra import GasState, KTables, Spectra, load_k_tables, save_k_tables, slot_atmosphere, tabulate
from jaxir.optics.spectrum import bin_edges, resolved_nodes

BAND = jaxir.Band("4.3", 1e4 / 2400, 1e4 / 2300)
NODES = resolved_nodes(BAND, points=3, pair_points=2, overlap=((2350.0, 2400.0),))
GRID = 2300 + 0.05 * np.arange(2000)
AIR = jaxir.StandardAtmosphere(0.0, 10e3, 11544.0)


def absorber(strength, phase):
    """Cosines with a Boltzmann factor and a mild broadening."""

    def cross_section(temperature, pressure, mole_fraction):
        contrast = 6 / (1 + pressure / 1e5 + mole_fraction)
        return strength * np.exp(contrast * np.cos(GRID * phase) - 600 / temperature)

    return cross_section


SPECTRA = Spectra(GRID, {"CO2": absorber(1e-26, 2.0), "H2O": absorber(1e-27, 3.7)}, "made up")


@pytest.fixture(scope="module")
def content():
    tables = tabulate(SPECTRA, NODES, [300.0, 900.0, 2000.0], [2e4, 1e5], [0.0, 0.3], progress=False)
    hottest = GasState(1500.0, 1e5, {"CO2": 0.06, "H2O": 0.07})
    air = slot_atmosphere(SPECTRA, NODES, AIR, {"CO2": 4e-4}, hottest, 3, progress=False)
    return KTables(NODES, tables, air, SPECTRA.provenance)


def test_round_trip(content, tmp_path, precision):
    file = tmp_path / "gas.npz"
    save_k_tables(file, content)
    read = load_k_tables(file)
    assert read.provenance == "made up" and read.nodes.names == ("4.3",)
    assert np.allclose(bin_edges(read.nodes), bin_edges(NODES), rtol=1e-12)
    for name in ("lower", "upper", "g", "weight", "response"):
        assert np.allclose(getattr(read.nodes, name), getattr(NODES, name), rtol=1e-6), name
    for old, new in zip(content.tables, read.tables, strict=True):
        assert old.species == new.species
        assert new.log_cross_section.dtype == np.dtype(precision)
        assert np.allclose(old.log_cross_section, new.log_cross_section, rtol=1e-6)
        for field, levels in new.levels().items():
            assert np.allclose(levels, old.levels()[field], rtol=1e-6)
    assert np.allclose(read.air.transmittance, content.air.transmittance)
    assert np.allclose(read.air.path_radiance, content.air.path_radiance)


def test_tables_know_their_levels(content):
    levels = content.tables[0].levels()
    assert np.allclose(levels["temperature"], [300.0, 900.0, 2000.0], rtol=1e-6)
    assert np.allclose(levels["pressure"], [2e4, 1e5], rtol=1e-6) and np.allclose(levels["mole_fraction"], [0.0, 0.3])


def test_without_air(content, tmp_path):
    save_k_tables(tmp_path / "gas.npz", content._replace(air=None))
    assert load_k_tables(tmp_path / "gas.npz").air is None


def test_more_air_passes_less(content):
    half = jaxir.StandardAtmosphere(5e3, 10e3, 5773.0)
    hottest = GasState(1500.0, 1e5, {"CO2": 0.06, "H2O": 0.07})
    less = slot_atmosphere(SPECTRA, NODES, half, {"CO2": 4e-4}, hottest, 3, progress=False)
    assert np.all(np.asarray(less.transmittance) > np.asarray(content.air.transmittance))
    assert np.all(np.asarray(content.air.path_radiance) > 0)


def test_wrong_files_are_refused(content, tmp_path):
    file = tmp_path / "gas.npz"
    with pytest.raises(ValueError, match="gas.npz: no such file"):
        load_k_tables(file)
    file.write_text("not a zip")
    with pytest.raises(ValueError, match="gas.npz: not readable"):
        load_k_tables(file)
    np.savez(file, something=1)
    with pytest.raises(ValueError, match="gas.npz: got arrays .'something'., expected tables"):
        load_k_tables(file)
    save_k_tables(file, content)
    arrays = dict(np.load(file))
    np.savez(file, **{name: value for name, value in arrays.items() if name != "H2O.pressure"})
    with pytest.raises(ValueError, match="gas.npz: got no array 'H2O.pressure'"):
        load_k_tables(file)
    np.savez(file, **{**arrays, "H2O.pressure": np.array([2.0, 1.0])})
    with pytest.raises(ValueError, match="gas.npz: CrossSections 'H2O'.pressure: got"):
        load_k_tables(file)
    file.write_bytes(file.read_bytes()[:500])
    with pytest.raises(ValueError, match="gas.npz: not readable"):
        load_k_tables(file)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("lower", lambda v: v * np.nan, r"lower: got nan at \[0\], expected > 0"),
        ("upper", lambda v: v[::-1] - 1000, r"upper: got 1.* at \[0\], expected > 2300"),
        ("g", lambda v: v + 1, r"g: got .* at \[0, 0\], expected >= 0 and <= 1"),
        ("weight", lambda v: v[:-1], r"weight: got float32 of shape \(6,\), expected numbers of shape \(7,\)"),
        ("response", lambda v: -1 - v, r"response: got .* expected >= 0"),
        ("names", lambda v: np.array(["a", "a"]), "names: got <U1 .* expected different names"),
        ("air.transmittance", lambda v: v * 0 + 2, r"air.transmittance: got 2.0 at \[0\], expected >= 0 and <= 1"),
        ("air.path_radiance", lambda v: v * np.nan, "air.path_radiance: got nan"),
        ("CO2.cross_section", lambda v: v * np.nan, "CO2.cross_section: got nan"),
        ("CO2.temperature", lambda v: v * np.nan, "CO2.temperature: got nan"),
        ("species", lambda v: v.astype("S"), "species: got .S3 of shape .2,., expected different names"),
        ("format", lambda v: np.array([1, 1]), "got arrays .* expected tables of cross-sections, format 1"),
    ],
)
def test_values_out_of_range_are_refused(content, name, change, message, tmp_path):
    file = tmp_path / "gas.npz"
    save_k_tables(file, content)
    with np.load(file) as found:
        arrays = dict(found)
    np.savez(file, **{**arrays, name: change(arrays[name])})
    with pytest.raises(ValueError, match=rf"gas.npz: {message}"):
        load_k_tables(file)


def test_wrong_arguments_are_refused():
    hottest = GasState(1500.0, 1e5, {"CO2": 0.06})
    with pytest.raises(ValueError, match=r"amounts: got none for \['CO2'\]"):
        slot_atmosphere(SPECTRA, NODES, AIR, {}, hottest, progress=False)
    with pytest.raises(ValueError, match="hottest.mole_fractions: got ..SO2"):
        slot_atmosphere(SPECTRA, NODES, AIR, {"CO2": 4e-4}, GasState(1e3, 1e5, {"SO2": 0.1}), progress=False)
    with pytest.raises(ValueError, match=r"absorber of CO2: got \(2000,\) values, expected \(1000,\)"):
        tabulate(SPECTRA._replace(wavenumber=GRID[:1000]), NODES, [300.0], [1e5], [0.0], progress=False)
