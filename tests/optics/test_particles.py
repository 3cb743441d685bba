import functools
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import simpson

from jaxir import _cache
from jaxir._arrays import enforce
from jaxir.optics.particle import GrayParticles, Isotropic, Particles, ParticleTable, mie_table, number_density
from jaxir.optics.spectrum import LWIR, MWIR, Band, gray_nodes, resolved_nodes
from studies.fit_plume import soot_index

miepython = pytest.importorskip("miepython")


def efficiencies(diameter, table):
    area = np.pi / 4 * (diameter * 1e-6) ** 2
    return np.asarray(table.extinction)[::-1] / area, np.asarray(table.scattering)[::-1] / area


def mean_cosine(table):
    angle = np.linspace(np.pi, 0, table.cosine.shape[0])
    phase = np.asarray(table.phase)[::-1] * np.sin(angle)
    return simpson(phase * np.cos(angle), x=angle) / simpson(phase, x=angle)


@pytest.mark.parametrize(
    ("index", "size", "extinction", "scattering", "asymmetry"),
    # Wiscombe, NCAR/TN-140+STR (1979)
    [(1.5 - 1j, 1.0, 2.336321, 0.663454, 0.192136), (1.33 - 1e-5j, 100.0, 2.101321, 2.096594, 0.868959)],
)
def test_wiscombe(index, size, extinction, scattering, asymmetry, x64):
    table = mie_table(size / np.pi, index, [1.0, 2.0], angles=2881)
    got = [e[0] for e in efficiencies(size / np.pi, table)]
    assert got == pytest.approx([extinction, scattering], abs=6e-7)
    assert mean_cosine(table)[0] == pytest.approx(asymmetry, abs=2e-6)


def test_particle_of_ten_micrometres(x64):
    table = mie_table(10.0, 2 - 5e-5j, [2.0, 4.0, 10.0], angles=1441)
    extinction, scattering = efficiencies(10.0, table)
    assert extinction == pytest.approx([2.416612, 2.461754, 2.460063], abs=6e-7)
    assert extinction - scattering == pytest.approx([5.787e-3, 2.266e-3, 1.126e-3], abs=6e-7)
    assert scattering / extinction == pytest.approx([0.99760, 0.99908, 0.99954], abs=6e-6)
    assert mean_cosine(table) == pytest.approx([0.605924, 0.572659, 0.247805], abs=2e-6)


def test_soot_of_the_plume_study_is_that_measured():
    # Chang and Charalampopoulos, Proc. R. Soc. Lond. A 430 (1990), table of soot at one height of the flame,
    # transcribed; the tolerances are how far the paper's polynomials, over all heights, are from it
    wavelength, n, k = np.array([(1.0, 1.65, 0.50), (2.16, 1.83, 0.75), (3.89, 2.10, 1.11), (6.24, 2.33, 1.41)]).T
    index = soot_index(wavelength)
    assert index.real == pytest.approx(n, rel=0.10) and -index.imag == pytest.approx(k, rel=0.17)


@pytest.fixture(scope="module")
def table():
    return mie_table(2.0, 1.6 - 0.01j, np.geomspace(2.9, 12.5, 30), spread=0.3, angles=91, sizes=8)


@pytest.mark.parametrize(("density", "depth"), [(1000.0, 5.1), (2200.0, 2.3), (4000.0, 1.3)])
def test_optical_depth_of_a_stream(density, depth):
    # 2 kg/s at 300 m/s through a circle of 0.6 m, spheres of 10 um, at 2 um
    volume, section = np.pi / 6 * 1e-15, np.pi / 4 * 1e-10 * 2.416612
    count = number_density(2.0, density, 300.0, np.pi * 0.09, volume)
    assert float(count) * section * 0.6 == pytest.approx(depth, abs=0.06)


def test_mean_volume_is_that_of_the_distribution(table):
    assert float(table.volume) == pytest.approx(np.pi / 6 * 8e-18 * np.exp(4.5 * 0.3**2), rel=1e-5)


def test_nodes_take_means_over_their_bins(table):
    nodes = resolved_nodes([MWIR, LWIR], width=400.0, points=1, pair_points=0)
    seen = Particles(np.full((2, 3), 1e9), table).optics(nodes)
    assert seen.extinction.shape == (2, 3, nodes.count) and seen.albedo.shape == (nodes.count,)
    nu, section = np.asarray(table.wavenumber, np.float64), np.asarray(table.extinction, np.float64)
    for i in range(nodes.count):
        fine = np.linspace(float(nodes.lower[i]), float(nodes.upper[i]), 4001)
        assert float(seen.extinction[1, 2, i]) == pytest.approx(1e9 * np.interp(fine, nu, section).mean(), rel=1e-4)
    assert np.all((np.asarray(seen.albedo) > 0) & (np.asarray(seen.albedo) < 1))
    enforce(jnp.zeros(1), [*Particles(1e9, table).checks(), *seen.phase.checks()])
    assert seen.phase.eval(jnp.asarray(0.3)).shape == (nodes.count,)


def test_gradients_reach_number_density_and_table(table):
    nodes = gray_nodes([MWIR])

    def depth(n, section):
        changed = ParticleTable(table.wavenumber, section, table.scattering, table.volume, table.cosine, table.phase)
        return Particles(n, changed).optics(nodes).extinction.sum()

    by_count, by_section = jax.jit(jax.grad(depth, argnums=(0, 1)))(jnp.asarray(1e9), table.extinction)
    whole = depth(jnp.asarray(1e9), table.extinction)
    assert float(by_count) == pytest.approx(float(whole) / 1e9, rel=1e-5)
    assert float(by_section @ table.extinction) == pytest.approx(float(whole), rel=1e-5)


@pytest.mark.parametrize(("diameter", "spread", "index"), [(5.0, 0.4, 1.6 - 0.01j), (2.0, 0.7, 1.8 - 0.01j)])
def test_means_over_sizes_that_ripple(diameter, spread, index):
    """Against 1601 sizes of miepython, by number weighted, over nine spreads."""
    wavelength = np.array([4.0, 10.0])
    z = 2 * spread + np.linspace(-4.5, 4.5, 1601)
    share = np.exp(-z * z / 2) * (z[1] - z[0]) / np.sqrt(2 * np.pi)
    extinction, scattering, forward = np.zeros((3, 2))
    for d, part in zip(diameter * np.exp(spread * z), share * np.pi / 4e12, strict=True):
        whole, sent, _, cosine = miepython.efficiencies_mx(np.full(2, index), np.pi * d / wavelength)
        extinction += part * d**2 * whole
        scattering += part * d**2 * sent
        forward += part * d**2 * sent * cosine
    table = mie_table(diameter, index, wavelength, spread, angles=181)
    np.testing.assert_allclose(table.extinction[::-1], extinction, rtol=2e-3)
    np.testing.assert_allclose(table.scattering[::-1], scattering, rtol=2e-3)
    cosine = 2 * np.pi * np.trapezoid(np.asarray(table.phase) * np.asarray(table.cosine), table.cosine, axis=1)
    np.testing.assert_allclose(cosine[::-1], forward / scattering, atol=0.01)


def test_gray_particles():
    nodes = gray_nodes([MWIR, LWIR])
    seen = GrayParticles(0.5, [0.9, 0.5], Isotropic()).optics(nodes)
    assert np.allclose(seen.extinction, [0.5, 0.5]) and np.allclose(seen.albedo, [0.9, 0.5])
    with pytest.raises(ValueError, match="got 3 nodes"):
        GrayParticles(0.5, [0.9, 0.5, 0.1], Isotropic()).optics(nodes)
    with pytest.raises(ValueError, match="albedo"):
        enforce(jnp.zeros(1), GrayParticles(0.5, 1.2, Isotropic()).checks())


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"diameter": 0.0}, "diameter"),
        ({"spread": -1.0}, "spread"),
        ({"index": 1.5 + 0.1j}, "n - ik"),
        ({"index": [1.5, 1.5, 1.5]}, "shape"),
        ({"wavelength": [2.0, 1.0]}, "increasing"),
        ({"angles": 2}, "angles"),
    ],
)
def test_bad_spheres_are_refused(change, what):
    with pytest.raises(ValueError, match=what):
        mie_table(**{"diameter": 1.0, "index": 1.5 - 0.1j, "wavelength": [1.0, 2.0], **change})


def test_bad_tables_are_refused(table):
    def with_(**change):
        names = ("wavenumber", "extinction", "scattering", "volume", "cosine", "phase")
        return ParticleTable(**{**{name: getattr(table, name) for name in names}, **change})

    with pytest.raises(ValueError, match="got shape"):
        with_(extinction=np.ones(3))
    for change, what in (
        ({"wavenumber": table.wavenumber[::-1]}, "increasing"),
        ({"scattering": table.extinction * 2}, "at most"),
        ({"phase": -table.phase}, ">= 0"),
    ):
        with pytest.raises(ValueError, match=what):
            enforce(jnp.zeros(1), with_(**change).checks())
    with pytest.raises(ValueError, match="inside the table"):
        Particles(1.0, table).optics(gray_nodes([Band("outside", 1.0, 2.0)]))


def test_what_was_computed_once_is_kept(monkeypatch, tmp_path):
    monkeypatch.setattr(_cache, "_FOLDERS", [_cache._Folder(tmp_path)])
    table = functools.partial(mie_table, index=1.5 - 0.1j, wavelength=[1.0, 2.0], spread=0.3, angles=5, sizes=1)
    first = table(1.0)
    monkeypatch.setattr(miepython, "efficiencies_mx", None)
    jax.tree.map(np.testing.assert_array_equal, table(1.0), first)
    with pytest.raises(TypeError):
        table(1.1)


def test_missing_miepython_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "miepython", None)
    with pytest.raises(ImportError, match=r"pip install 'jaxir\[mie\]'"):
        mie_table(1.0, 1.5)


def test_the_leaf_that_scales_with_the_number_of_particles(table):
    particles, gray = Particles(1e9, table), GrayParticles(0.5, 0.9, Isotropic())
    assert particles.amount is particles.number_density and gray.amount is gray.extinction
