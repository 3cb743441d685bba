"""A sweep goes on where it was killed: nothing lost, nothing computed twice, nothing mixed."""

import os
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np
import pytest

import jaxir
from jaxir.io.result import _sweep as sweep_module
from jaxir.io.result import sweep
from tests.io.result.sweeping import SHAPE, asked

ROOT = Path(__file__).parents[3]


@pytest.fixture
def computed(monkeypatch):
    """Numbers of the views that are computed."""
    seen = []

    def watched(function, inputs, items, *rest):
        for index, result in item_by_item(function, inputs, items, *rest):
            seen.extend(index.tolist())
            yield index, result

    item_by_item = sweep_module.item_by_item
    monkeypatch.setattr(sweep_module, "item_by_item", watched)
    return seen


def _killed(folder, finished):
    """Start a sweep in another process and kill it once some views are there."""
    environment = {**os.environ, "JAX_PLATFORMS": "cpu", "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.io.result.sweeping", str(folder)], cwd=ROOT, env=environment
    )
    try:
        end = time.monotonic() + 300
        while len(list(folder.glob("view_*.npz"))) < finished:
            assert process.poll() is None and time.monotonic() < end
            time.sleep(0.002)
    finally:
        process.kill()
        process.wait()
    return {file.name: file.stat().st_mtime_ns for file in folder.glob("view_*.npz")}


def test_a_killed_sweep_goes_on(tmp_path, computed):
    folder = tmp_path / "sweep"
    kept = _killed(folder, 3)
    scene, views, bands = asked()
    assert 3 <= len(kept) < len(views)
    table = sweep(folder, scene, views, bands, shape=SHAPE)
    assert len(computed) == len(views) - len(kept)
    assert not {f"view_{index:06d}.npz" for index in computed} & set(kept)
    assert kept.items() <= {file.name: file.stat().st_mtime_ns for file in folder.glob("view_*.npz")}.items()
    once = jaxir.signature(scene, views, bands, shape=SHAPE)
    np.testing.assert_allclose(table.intensity, once.intensity, rtol=1e-6)
    np.testing.assert_allclose(table.standard_error, once.standard_error, rtol=1e-5, atol=1e-9)
    del computed[:]
    assert (sweep(folder, scene, views, bands, shape=SHAPE).intensity == table.intensity).all()
    assert computed == []


def test_views_may_be_added_at_the_end(tmp_path, computed):
    few = sweep(tmp_path / "sweep", *asked(count=3), shape=SHAPE)
    more = sweep(tmp_path / "sweep", *asked(count=5), shape=SHAPE)
    assert computed == [0, 1, 2, 3, 4]
    assert (few.intensity == more.intensity[:3]).all()


def test_what_does_not_fit_is_refused(tmp_path):
    folder = tmp_path / "sweep"
    scene, views, bands = asked(count=2)
    sweep(folder, scene, views, bands, shape=SHAPE)
    with pytest.raises(ValueError, match=r"got a sweep begun with other values of scene.skin.temperature, expected"):
        sweep(folder, asked(temperature=401.0)[0], views, bands, shape=SHAPE)
    with pytest.raises(ValueError, match="other values of bands"):
        sweep(folder, scene, views, jaxir.MWIR, shape=SHAPE)
    with pytest.raises(ValueError, match="other values of pixels"):
        sweep(folder, scene, views, bands, shape=SHAPE, samples=4)
    with pytest.raises(ValueError, match="other values of key"):
        sweep(folder, scene, views, bands, shape=SHAPE, key=jax.random.key(1))
    with pytest.raises(ValueError, match=r"view_000000.npz: got the view from .* views may be added at the end only"):
        sweep(folder, scene, views[::-1], bands, shape=SHAPE)
    with pytest.raises(ValueError, match="known only inside jit"):
        jax.jit(lambda t: sweep(folder, asked(temperature=t)[0], views, bands).intensity)(300.0)
    (folder / "view_000001.npz").write_bytes(b"half")
    with pytest.raises(ValueError, match="view_000001.npz: got a damaged file"):
        sweep(folder, scene, views, bands, shape=SHAPE)
    (folder / "conditions.json").unlink()
    with pytest.raises(ValueError, match="got views without conditions.json"):
        sweep(folder, scene, views, bands, shape=SHAPE)
    with pytest.raises(ValueError, match="does not exist"):
        sweep(tmp_path / "no" / "sweep", scene, views, bands, shape=SHAPE)
