"""The whole way from a list in HITRAN's format, written here from published constants, through the real RADIS."""

import functools
import sys

import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir.io.spectra import (
    GasState,
    KTables,
    check_line_file,
    line_spectra,
    load_k_tables,
    save_k_tables,
    slot_atmosphere,
    tabulate,
)
from jaxir.io.spectra import _lines as lines_module
from jaxir.optics.spectrum import band_radiance, resolved_nodes
from studies import co2_lines as truth
from studies.co2_levels import partition

HOTTEST, FAINTEST = 1000.0, 1e-5  # leaves out 0.1 % of the absorption at 1000 K
NODES = resolved_nodes(jaxir.Band("4.3", 1e4 / 2380, 1e4 / 2280), width=25.0)
PRESSURE = 0.3 * truth.ATMOSPHERE


def record(line, strength, energy, quanta):
    """One line of 160 characters."""
    v1, v2, angular, v3, j, step = quanta
    width = truth.WIDTH * (273 / 296) ** 0.5
    numbers = f" 21{line:12.6f}{strength:10.3E}{1.0:10.3E}{width:5.3f}{width:5.3f}{energy:10.4f}{0.5:4.2f}{0.0:8.6f}"
    vibration = f"{v1:8d}{v2:2d}{angular:2d}{v3 + 1:2d}1{v1:8d}{v2:2d}{angular:2d}{v3:2d}1"
    rotation = " " * 15 + f"     {'PQR'[step + 1]}{j:3d}e     "
    return f"{numbers}{vibration}{rotation}465545 5 4 5 5 5 5 {2 * j + 1:7.1f}{2 * (j + step) + 1:7.1f}"


@functools.cache
def records():
    """All lines that matter up to `HOTTEST`, with strengths at 296 K."""
    hot, cold = truth.nu3_lines(HOTTEST, FAINTEST), 296.0
    boltzmann = np.exp(-truth.C2 * hot.energy * (1 / cold - 1 / HOTTEST))
    emission = np.expm1(-truth.C2 * hot.wavenumber / cold) / np.expm1(-truth.C2 * hot.wavenumber / HOTTEST)
    states = partition(HOTTEST) / partition(cold)
    strength = hot.strength * boltzmann * emission * states
    order = np.argsort(hot.wavenumber)
    return [record(hot.wavenumber[i], strength[i], hot.energy[i], hot.quanta[:, i]) for i in order]


@pytest.fixture(scope="module")
def listed(tmp_path_factory):
    file = tmp_path_factory.mktemp("list") / "02_co2.par"
    file.write_text("\n".join(records()) + "\n")
    return file


@pytest.fixture(scope="module")
def spectra(listed, tmp_path_factory):
    """With wings as long as the band is wide, because those of the truth do not end."""
    return line_spectra(listed, NODES, truncation=100.0, cache=tmp_path_factory.mktemp("cache"), progress=False)


def test_the_list_is_what_it_says(listed):
    found = check_line_file(listed, progress=False)
    assert (found.species, found.isotopes) == ("CO2", (1,)) and found.lines == len(records())


@pytest.mark.parametrize("temperature", [296.0, 500.0, 700.0, 1000.0])
def test_radis_gives_the_spectrum_of_its_lines(spectra, temperature):
    """RADIS divides by the partition function of TIPS, which that of the truth's levels is."""
    got = spectra.absorbers["CO2"](temperature, PRESSURE, 0.06)
    exact = np.interp(spectra.wavenumber, truth.GRID, truth.cross_section(temperature, PRESSURE))
    for start in range(0, 10000, 2500):
        own, true = got[start : start + 2500], exact[start : start + 2500]
        assert own.mean() == pytest.approx(true.mean(), rel=1e-3)
        depth = 1 / true.mean()  # thin and thick: the shape of the distribution, too
        for path in (0.3, 3.0):
            passed = np.exp(-path * depth * np.stack([own, true])).mean(axis=1)
            assert passed[0] == pytest.approx(passed[1], abs=3e-3)


def test_from_a_list_to_a_gas_behind_air(spectra, tmp_path):
    """List, tables, air, file, radiance: within 2 % of line by line."""
    path, hottest = jaxir.StandardAtmosphere(10e3, 10e3, 5e3), GasState(650.0, PRESSURE, {"CO2": 0.06})
    tables = tabulate(spectra, NODES, [296.0, 400.0, 550.0, 750.0], [PRESSURE], [0.0], progress=False)
    air = slot_atmosphere(spectra, NODES, path, {"CO2": 4e-4}, hottest, segments=2, progress=False)
    save_k_tables(tmp_path / "co2.npz", KTables(NODES, tables, air, spectra.provenance))
    read = load_k_tables(tmp_path / "co2.npz")
    assert "02_co2.par" in read.provenance and "SHA-256" in read.provenance
    hot, inside = jnp.asarray(650.0), (truth.GRID > 2280 - 1e-6) & (truth.GRID < 2380 - 1e-6)
    cold = truth.air_depth(path, 4e-4, segments=2)
    for thickness in (0.03, 0.3, 1.0):
        kappa = jaxir.CorrelatedK(read.tables, PRESSURE, {"CO2": 0.06}).absorption(read.nodes, hot)
        emitted = -jnp.expm1(-thickness * kappa) * band_radiance(hot, read.nodes)
        for passed, depth in ((1.0, 0.0), (read.air.on(read.nodes).transmittance, cold)):
            exact = truth.radiance([(650.0, PRESSURE, 0.06, thickness)], depth)[inside].mean() * 100
            got = float(read.nodes.in_band(emitted * passed)[0])
            assert got == pytest.approx(exact, rel=0.02)


def test_spectra_are_kept_and_the_list_s_folder_is_left_alone(spectra, listed, monkeypatch):
    first = spectra.absorbers["CO2"](296.0, PRESSURE, 0.06)
    monkeypatch.setattr(lines_module._Absorber, "_factory", lambda *_: pytest.fail("computed again"))
    again = line_spectra(listed, NODES, truncation=100.0, cache=spectra.absorbers["CO2"].cache, progress=False)
    assert np.array_equal(again.absorbers["CO2"](296.0, PRESSURE, 0.06), first)
    assert [file.name for file in listed.parent.iterdir()] == ["02_co2.par"]


def test_a_damaged_file_of_the_cache_is_named(listed, tmp_path, monkeypatch):
    absorber = line_spectra(listed, NODES, cache=tmp_path, progress=False).absorbers["CO2"]
    monkeypatch.setattr(lines_module._Absorber, "_factory", lambda *_: None)
    assert (absorber(296.0, PRESSURE, 0.06) == 0).all()
    (kept,) = tmp_path.glob("*.npy")
    whole = kept.read_bytes()
    kept.write_bytes(whole[:-4])
    with pytest.raises(ValueError, match=rf"{kept.name}: not readable .* .array: got {len(whole) - 4} bytes"):
        absorber(296.0, PRESSURE, 0.06)
    np.save(kept, np.zeros(3, np.float32))
    with pytest.raises(ValueError, match=rf"{kept.name}: got float32 of shape .3,., expected a spectrum of \d+ finite"):
        absorber(296.0, PRESSURE, 0.06)


def test_two_intervals_and_one_without_lines(listed, tmp_path):
    bands = [jaxir.Band("near", 1e4 / 3100, 1e4 / 3050), jaxir.Band("4.3", 1e4 / 2350, 1e4 / 2325)]
    nodes = resolved_nodes(bands, width=25.0, points=2)
    spectra = line_spectra([listed], nodes, cache=tmp_path, progress=False)
    got = spectra.absorbers["CO2"](296.0, 1e5, 0.0)
    assert got.shape == spectra.wavenumber.shape == (7500,)
    assert np.all(got[spectra.wavenumber > 3000] == 0) and got[spectra.wavenumber < 3000].min() > 0


def test_the_cache_is_in_the_user_s_cache_folder(listed, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert line_spectra(listed, NODES, progress=False).absorbers["CO2"].cache == tmp_path / "jaxir" / "lines"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert line_spectra(listed, NODES, progress=False).absorbers["CO2"].cache == tmp_path / ".cache/jaxir/lines"


def test_a_coarse_step_is_refused(listed, tmp_path):
    spectra = line_spectra(listed, NODES, step=0.5, cache=tmp_path, progress=False)
    with pytest.raises(ValueError, match="step: got 0.5 cm-1, expected less for lines at 296 K and 30000 Pa"):
        spectra.absorbers["CO2"](296.0, 3e4, 0.06)


def test_without_radis(listed, monkeypatch):
    monkeypatch.setitem(sys.modules, "radis", None)
    with pytest.raises(ImportError, match=r'need RADIS: pip install "jaxir\[lines\]"'):
        line_spectra(listed, NODES, progress=False)


GOOD = record(2349.0, 1e-18, 100.0, (0, 0, 0, 0, 2, 1))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "x.par: got no lines"),
        (f"{GOOD}\n{GOOD}\n{GOOD[:97]}", "x.par:3: got 97 characters and no line end: the file is cut, expected 160"),
        (f"{GOOD}\n{GOOD}", "x.par:2: got 160 characters and no line end"),
        (f"{GOOD}\n\n{GOOD}\n", "x.par:2: got 0 characters, expected 160"),
        (f"{GOOD}\n{GOOD} \n", "x.par:2: got 161 characters"),
        (f"{GOOD}\n 1{GOOD[2:]}\n", r"x.par:2: got molecule ' 1', expected 2 \(CO2\) all over"),
        (f"99{GOOD[2:]}\n", "x.par:1: got molecule '99', expected 1 ... 28"),
        (f"{GOOD}\n{GOOD[:2]}x{GOOD[3:]}\n", "x.par:2: got isotopologue 'x'"),
        (
            f"{GOOD}\n{GOOD[:15]} 1.0E-1x {GOOD[24:]}\n",
            "x.par:2: got ' 1.0E-1x .' for the intensity, expected a number",
        ),
        (f"{GOOD}\n{GOOD[:15]}-1.000E-19{GOOD[25:]}\n", "x.par:2: got '-1.000E-19' for the intensity"),
        (f"{GOOD}\n{GOOD[:45]}          {GOOD[55:]}\n", "x.par:2: got '          ' for the lower-state energy"),
        (f"{GOOD}\n{GOOD[:3]}         nan{GOOD[15:]}\n", "x.par:2: got '         nan' for the wavenumber"),
    ],
)
def test_a_wrong_line_is_named(tmp_path, text, message):
    file = tmp_path / "x.par"
    file.write_bytes(text.encode())
    with pytest.raises(ValueError, match=message):
        check_line_file(file, progress=False)


def test_other_line_ends_and_isotopologues_pass(tmp_path):
    file = tmp_path / "x.par"
    file.write_bytes(f"{GOOD}\r\n{GOOD[:2]}A{GOOD[3:]}\r\n".encode())
    assert check_line_file(file, progress=False).isotopes == (1, 11)
    file.write_bytes(f"{GOOD}\r\n{GOOD}\n".encode())
    with pytest.raises(ValueError, match="x.par:2"):
        check_line_file(file, progress=False)


def test_wrong_arguments_are_refused(listed, tmp_path):
    with pytest.raises(ValueError, match="nothing.par: no such file"):
        line_spectra(tmp_path / "nothing.par", NODES, progress=False)
    with pytest.raises(ValueError, match="files: got none"):
        line_spectra([], NODES, progress=False)
    for change in ({"step": 0.0}, {"truncation": np.nan}):
        with pytest.raises(ValueError, match=f"{next(iter(change))}: got"):
            line_spectra(listed, NODES, progress=False, **change)
