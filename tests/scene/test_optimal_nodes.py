"""Few nodes that stand for many."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir import _cache
from jaxir.scene import _optimal_nodes
from tests.scene.spectra import side_by_side
from tests.scenes import hot_layers, plate

BANDS = (jaxir.SWIR, jaxir.MWIR, jaxir.LWIR)
GAS = jaxir.NarrowBandGas(pressure=5e4, h2o=0.1, co2=0.1)
AIR = jaxir.StandardAtmosphere(0.0, 0.0, 5e3)


def fine():
    return jaxir.resolved_nodes(BANDS, 50.0, 12, 8)


def seen(scene, nodes):
    """From both sides, and from aside, where the plate is not seen."""
    cameras = [jaxir.orthographic_camera(*aspect, 0.05, (4, 4)) for aspect in ((0.0, 0.0), (180.0, 0.0), (60.0, 20.0))]
    images = [jaxir.render(scene, camera, nodes, samples=2) for camera in cameras]
    for image in images:
        np.testing.assert_array_equal(image.spectral, nodes.error)
    return np.stack([image.radiance for image in images])


def test_a_twentieth_of_the_nodes_shows_the_same_in_vacuum_and_through_air():
    scenes = hot_layers(), hot_layers(AIR)
    nodes = jaxir.optimal_nodes(scenes, BANDS, rtol=0.01)
    assert nodes.count < fine().count / 20
    assert (np.asarray(nodes.error) <= 0.01).all() and (np.asarray(nodes.error) > 0).all()
    for scene in scenes:
        found = seen(scene, side_by_side(nodes, fine(), jaxir.gray_nodes(BANDS)))
        few, true, gray = np.split(found, 3, axis=-1)
        np.testing.assert_allclose(few, true, rtol=0.01)
        assert (np.abs(gray / true - 1).max(axis=(0, 1, 2)) > 0.1).all()


def test_light_given_for_bands_is_the_same_on_them():
    """Weights sum to the widths of bands, so that a number for a band is divided as before."""
    nodes = jaxir.optimal_nodes(hot_layers(), BANDS)
    width = np.asarray(nodes.response) @ (np.asarray(nodes.weight) * np.asarray(nodes.upper - nodes.lower))
    np.testing.assert_allclose(width, [1e4 / band.lower - 1e4 / band.upper for band in BANDS], rtol=1e-2)
    lit = jaxir.Scene(hot_layers().skin, sources=(jaxir.ParallelSource((-1.0, 0.0, 0.0), 2 * [5.0, 7.0, 9.0]),))
    camera = jaxir.orthographic_camera(0.0, 0.0, 0.05, (2, 2))
    image = jaxir.render(lit, camera, side_by_side(nodes, jaxir.gray_nodes(BANDS)), samples=2)
    few, gray = np.split(np.asarray(image.radiance)[0, 0], 2)
    np.testing.assert_allclose(few, gray, rtol=5e-3)


@pytest.mark.parametrize("aspect", [(90.0, 0.0), (178.0, 0.0), (0.0, 0.0)])
def test_the_hot_core_of_a_jet_is_seen_from_all_sides(aspect):
    jet = jaxir.JetPlume((0.0, 0.0, 0.0), (-1.0, 0.0, 0.0), 0.5, 1600.0, 230.0, GAS, length=20.0)
    scene = jaxir.Scene(plumes=jet, atmosphere=AIR)
    nodes = jaxir.optimal_nodes(scene, jaxir.MWIR)
    reference = jaxir.resolved_nodes(jaxir.MWIR, 50.0, 12, 8)
    assert nodes.count < reference.count / 6
    few, true = jaxir.plume_intensity(scene, *aspect, side_by_side(nodes, reference), rays=1024)
    np.testing.assert_allclose(few, true, rtol=0.01)


def test_choices_are_repeated_kept_and_read_again(tmp_path, monkeypatch):
    monkeypatch.setattr(_cache, "_FOLDERS", [_cache._Folder(tmp_path)])
    calls, spectra = [], _optimal_nodes._spectra
    monkeypatch.setattr(_optimal_nodes, "_spectra", lambda *given: calls.append(0) or spectra(*given))

    def chosen(hot):
        monkeypatch.setattr(_optimal_nodes, "_held", {})  # as in another process
        return jaxir.optimal_nodes(hot_layers(hot=hot), BANDS)

    first, again = chosen(1100.0), chosen(1100.0)
    assert len(calls) == 1
    assert all(np.array_equal(a, b) for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(again), strict=True))
    chosen(1000.0)
    assert len(calls) == 2


def test_gray_scenes_take_gray_nodes():
    grid = jaxir.Grid((0.0, -0.5, -0.5), (0.4, 1.0, 1.0), (2, 1, 1))
    gray = jaxir.Scene(plumes=jaxir.GridPlume(grid, 900.0, jaxir.GrayGas(1.0)))
    assert jaxir.optimal_nodes(gray, BANDS).count == 3


def test_what_cannot_be_chosen_is_refused():
    with pytest.raises(ValueError, match="optimal_nodes: got rtol 0.0, expected a number > 0"):
        jaxir.optimal_nodes(hot_layers(), BANDS, 0.0)
    with pytest.raises(ValueError, match=r"optimal_nodes: got \(\), expected one Scene or several"):
        jaxir.optimal_nodes((), BANDS)
    with pytest.raises(ValueError, match="optimal_nodes: got values that are not known yet"):
        jax.jit(lambda e: jaxir.optimal_nodes(jaxir.Scene(plate(e), hot_layers().plumes), BANDS).weight)(
            jnp.asarray(0.5)
        )
