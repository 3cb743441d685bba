"""Nodes for the error that is asked for."""

import numpy as np
import pytest

import jaxir
from jaxir.imaging import Outcome
from jaxir.io.result import sweep
from jaxir.optics.spectrum import padded_nodes, with_error
from jaxir.scene import _optimal_nodes, nodes_within, scene_nodes
from tests.scenes import hot_layers

BANDS = (jaxir.MWIR, jaxir.LWIR)
RASTER = {"shape": (4, 4), "samples": 2}


def layers():
    return hot_layers(jaxir.StandardAtmosphere(0.0, 0.0, 5e3))


@pytest.mark.parametrize(("rtol", "error"), [(0.1, 0.01), (0.01, 1e-3), (1e-3, 1e-3)])
def test_they_err_by_a_tenth_of_it_or_at_most_by_it_and_are_few(rtol, error):
    scene, fine = layers(), jaxir.resolved_nodes(BANDS, 50.0, 12, 8)
    nodes = nodes_within(scene, BANDS, rtol)
    assert (np.asarray(nodes.error) <= error).all()
    assert nodes.count < scene_nodes(scene, BANDS).count / 3
    few, true = (
        jaxir.signature(scene, [[0.0, 0.0]], padded_nodes(own, fine.count), **RASTER).intensity for own in (nodes, fine)
    )
    np.testing.assert_allclose(few, true, rtol=error)


def test_all_are_taken_where_few_do_not_suffice(monkeypatch):
    monkeypatch.setattr(_optimal_nodes, "TOLERANCES", (0.3,))
    scene, rtol = layers(), 0.0123
    nodes = nodes_within(scene, BANDS, rtol)
    assert nodes.count == _optimal_nodes.finest_nodes((scene,), BANDS, rtol).count and not np.asarray(nodes.error).any()
    assert jaxir.optimal_nodes(scene, BANDS, 0.0124).count == nodes.count


def test_few_counts_occur_and_none_is_that_of_the_bands():
    scene = layers()
    counts = {nodes_within(scene, BANDS, rtol).count for rtol in np.geomspace(1e-3, 0.2, 12)}
    assert len(counts) < 7 and len(BANDS) not in counts


def test_an_image_is_computed_on_them_and_a_plan_says_so():
    scene, camera = layers(), jaxir.orthographic_camera(0.0, 0.0, 0.05, (8, 8))
    image = jaxir.render(scene, camera, BANDS, samples=8, rtol=0.02)
    assert image.outcome == Outcome.tolerance_met
    np.testing.assert_array_equal(image.asked.nodes.weight, nodes_within(scene, BANDS, 0.02).weight)
    first = jaxir.plan(scene, camera, BANDS, rtol=0.02).terms[0]
    assert first.name == "Spectrum" and "nodes, chosen for this scene, which err by at most 0.00" in first.sentence


def test_what_given_nodes_err_beyond_it_is_told():
    scene, camera = layers(), jaxir.orthographic_camera(0.0, 0.0, 0.05, (8, 8))
    rough = with_error(nodes_within(scene, BANDS, 0.02), np.array([0.0, 0.3]))
    assert jaxir.render(scene, camera, rough, samples=8, rtol=0.02).outcome == Outcome.left_out
    table = jaxir.signature(scene, [[0.0, 0.0]], rough, **RASTER)
    assert not table.meets(0.2).any() and table.meets(0.5).all()


def test_a_sweep_keeps_them(tmp_path, monkeypatch):
    """Another machine might choose others."""
    scene, asked = layers(), {**RASTER, "rtol": 0.02}
    first = sweep(tmp_path / "views", scene, [[0.0, 0.0]], BANDS, **asked)
    views = [[0.0, 0.0], [30.0, 0.0]]
    with monkeypatch.context() as patch:
        patch.setattr(_optimal_nodes, "_best", None)
        more = sweep(tmp_path / "views", scene, views, BANDS, **asked)
    np.testing.assert_array_equal(more.intensity[:1], first.intensity)
    np.testing.assert_array_equal(more.spectral, first.spectral)
    with pytest.raises(ValueError, match="begun with other values of bands"):
        sweep(tmp_path / "views", scene, views, BANDS[:1], **asked)
    kept = tmp_path / "views" / "nodes.npz"
    arrays = dict(np.load(kept))
    cut = [{name: arrays[name][:-1]} for name in ("weight", "lower", "edge", "names", "error")]
    for damaged in (*cut, {"edge": np.array(1.0)}, {"x": 1}):
        np.savez(kept, **{**arrays, **damaged})
        with pytest.raises(ValueError, match=r"nodes\.npz: got .*, expected nodes"):
            sweep(tmp_path / "views", scene, views, BANDS, **asked)
    kept.write_text("nothing")
    with pytest.raises(ValueError, match=r"nodes\.npz"):
        sweep(tmp_path / "views", scene, views, BANDS, **asked)
    kept.unlink()
    with pytest.raises(ValueError, match="views without nodes.npz"):
        sweep(tmp_path / "views", scene, views, BANDS, **asked)
