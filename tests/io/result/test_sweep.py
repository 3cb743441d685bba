"""A sweep goes on where it was killed: nothing lost, nothing computed twice, nothing mixed."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir.imaging import _repeated as repeated
from jaxir.io.result import save_afsim, save_netcdf, save_signature, sweep, sweep_states
from tests.io.result.sweeping import SHAPE, asked
from tests.scenes import plate

ROOT = Path(__file__).parents[3]


@pytest.fixture
def computed(monkeypatch):
    """Numbers of the views that are computed."""
    seen = []

    def watched(function, inputs, items, *rest):
        for index, result in item_by_item(function, inputs, items, *rest):
            seen.extend(items.view[index].tolist())
            yield index, result

    item_by_item = repeated.item_by_item
    monkeypatch.setattr(repeated, "item_by_item", watched)
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
    views = views[: len(kept) + 20]
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


def test_a_sweep_goes_on_for_longer(tmp_path, computed):
    """What took so long decides nothing of the numbers; what is asked of them does."""
    told = {"shape": SHAPE, "samples": 2, "method": jaxir.Method()}
    sweep(tmp_path / "sweep", *asked(count=1), **told, rtol=0.5, max_seconds=100.0)
    for longer, new in ((None, {1}), (200.0, set())):
        del computed[:]
        sweep(tmp_path / "sweep", *asked(count=2), **told, rtol=0.5, max_seconds=longer)
        assert set(computed) == new
    with pytest.raises(ValueError, match="begun"):
        sweep(tmp_path / "sweep", *asked(count=2), **told, rtol=0.4, max_seconds=100.0)


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
    with pytest.raises(ValueError, match="got traced values"):
        jax.jit(lambda t: sweep(folder, asked(temperature=t)[0], views, bands).intensity)(300.0)
    (folder / "view_000001.npz").write_bytes(b"half")
    with pytest.raises(ValueError, match="view_000001.npz: got a damaged file"):
        sweep(folder, scene, views, bands, shape=SHAPE)
    (folder / "conditions.json").unlink()
    with pytest.raises(ValueError, match="got views without conditions.json"):
        sweep(folder, scene, views, bands, shape=SHAPE)
    with pytest.raises(ValueError, match="does not exist"):
        sweep(tmp_path / "no" / "sweep", scene, views, bands, shape=SHAPE)


def flight(mach, altitude, throttle):
    """A plate as hot as the air makes it, with an engine's heat on top."""
    return jaxir.Scene(plate(temperature=jaxir.air_temperature(altitude, mach) + 100 * throttle))


OVER = {"mach": [0.6, 0.9], "altitude": [3000.0, 9000.0], "throttle": [0.5, 1.0]}
VIEWS = [(azimuth, elevation) for azimuth in (-60.0, 60.0) for elevation in (0.0, 30.0)]


@pytest.fixture(scope="module")
def five_axes(tmp_path_factory):
    folder = tmp_path_factory.mktemp("five") / "sweep"
    asked = {"over": OVER, "shape": SHAPE, "components": "sources"}
    return sweep(folder, flight, VIEWS, jaxir.LWIR, **asked), folder, asked


def test_five_axes_are_one_table(five_axes, computed):
    table, folder, asked = five_axes
    assert table.intensity.shape == (32, 1) and table.axes == ("mach", "altitude", "throttle")
    states = np.array([(m, a, t) for m in (0.6, 0.9) for a in (3000, 9000) for t in (0.5, 1.0) for _ in VIEWS])
    np.testing.assert_allclose(table.state, states, rtol=1e-6)
    lone = jaxir.signature(flight(0.9, 3000.0, 1.0), VIEWS, jaxir.LWIR, shape=SHAPE, components="sources")
    np.testing.assert_allclose(table.intensity[20:24], lone.intensity, rtol=1e-6)
    np.testing.assert_allclose(table.parts[20:24], lone.parts, rtol=1e-6)
    np.testing.assert_allclose(table.parts_error[20:24, 0], lone.standard_error, rtol=1e-5)  # of skin alone
    del computed[:]
    more = {**asked, "over": {**OVER, "throttle": [0.5, 0.75, 1.0]}}
    assert sweep(folder, flight, VIEWS, jaxir.LWIR, **more).intensity.shape == (48, 1)
    assert len(computed) == 4 * len(VIEWS)  # of the new states alone
    budget = table.error_budget()
    assert budget.bounces is None and float(budget.spectral.max()) == 0


def test_five_axes_come_back_from_files(five_axes, tmp_path):
    table = five_axes[0]
    save_signature(tmp_path / "t.csv", table)
    save_afsim(tmp_path / "t.txt", table, "t")
    header, *rows = (tmp_path / "t.csv").read_text().splitlines()
    assert header.split(",")[:5] == ["mach", "altitude", "throttle", "azimuth_deg", "elevation_deg"]
    assert header.split(",")[-2:] == ["LWIR_skin_W_per_sr", "LWIR_skin_standard_error_W_per_sr"]
    held = np.array([[float(cell) for cell in row.split(",")] for row in rows])
    np.testing.assert_allclose(held[:, :3], table.state, rtol=1e-6)
    np.testing.assert_allclose(held[:, [5, 6]], np.stack([table.intensity, table.standard_error])[..., 0].T, rtol=1e-6)
    xarray = pytest.importorskip("xarray")
    save_netcdf(tmp_path / "t.nc", table)
    with xarray.open_dataset(tmp_path / "t.nc", engine="scipy") as data:
        for index, name in enumerate(table.axes):
            assert data.coords[name].dims == ("view",)
            np.testing.assert_array_equal(data[name], table.state[:, index])
        np.testing.assert_array_equal(data.component_intensity, table.parts)
        np.testing.assert_array_equal(data.component_error, table.parts_error)
        one = data.isel(view=(data.mach == data.mach.max()) & (data.throttle == 1.0))  # as a reader selects
        assert one.intensity.shape == (8, 1) and float(one.altitude.min()) == 3000.0
    states = re.split(r"   state (\S+)\n", (tmp_path / "t.txt").read_text())
    tables = dict(zip(states[1::2], states[2::2], strict=True))
    assert list(tables)[:3] == ["default", "mach_0.6_altitude_3000_throttle_0.5", "mach_0.6_altitude_3000_throttle_1"]
    assert len(tables) == 9 and tables["default"] == tables["mach_0.6_altitude_3000_throttle_0.5"]
    rows = tables["mach_0.9_altitude_3000_throttle_1"].splitlines()[3:5]  # of -60 and 60, to the right wing
    found = np.array([[float(word) for word in row.split()] for row in rows])
    np.testing.assert_allclose(found[:, 1:], np.asarray(table.intensity)[20:24, 0].reshape(2, 2)[::-1], rtol=1e-6)


def test_axes_that_are_none_are_refused(tmp_path):
    views = [(0.0, 0.0)]
    for scene, over, message in (
        (flight, {"mach": []}, r"over: got 'mach' of shape \(0,\), expected a name with a list of values"),
        (flight, {"azimuth": [1.0]}, "over: got 'azimuth', expected a name that tables do not have"),
        (flight(0.5, 0.0, 0.0), {"mach": [1.0]}, "over: got mach with a Scene, expected a function of the axes"),
        (flight, {}, "over: got no axis, expected axes by name"),
        (
            flight,
            {"mach": [1e8, 1e8 + 1]},
            "over: got 'mach' with a value twice, expected values that differ in float32",
        ),
        (lambda altitude: flight(0.5, altitude, 0.0), {"altitude": [3e4]}, "altitude=30000: altitude: got 30000"),
    ):
        with pytest.raises(ValueError, match=message):
            sweep(tmp_path / "s", scene, views, jaxir.LWIR, over=over, shape=SHAPE)


def test_states_have_names_that_tell_them_apart(tmp_path):
    """In folders and files; those of ordinary values are short."""
    one = jnp.ones((1, 1))
    lone = jaxir.Signature(one[0], one[0], one, 0 * one, ("LWIR",), 0 * one)
    folders = []

    def table_of(folder, state):
        folders.append(folder.name)
        return lone

    over = {"mach": [0.1 + 0.2, 0.9], "range": [16777214.0, 16777213.0, 1e10]}
    table = sweep_states(tmp_path / "kept", over, table_of)
    assert folders[:3] == ["mach=0.3,range=16777214", "mach=0.3,range=16777213", "mach=0.3,range=1e+10"]
    save_signature(tmp_path / "t.csv", table)
    rows = [line.split(",")[:2] for line in (tmp_path / "t.csv").read_text().splitlines()[1:]]
    assert rows[:2] == [["0.3", "16777214"], ["0.3", "16777213"]] and len({tuple(row) for row in rows}) == 6
    (tmp_path / "file").touch()
    with pytest.raises(ValueError, match="file: got a file, expected a folder"):
        sweep_states(tmp_path / "file", over, table_of)
