"""Many devices and many processes compute what one does."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

import jaxir
from tests.imaging.on_devices import VIEWS, camera, image, scene, table

ROOT = Path(__file__).parents[2]


def _start(*arguments):
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=2"  # compiled as here
    environment = {**os.environ, "XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "tests.imaging.on_devices", *map(str, arguments)]
    return subprocess.Popen(command, cwd=ROOT, env=environment, stderr=subprocess.PIPE, text=True)


def _free_port():
    with socket.socket() as server:
        server.bind(("localhost", 0))
        return server.getsockname()[1]


def _finish(process):
    try:
        _, errors = process.communicate(timeout=300)
    finally:
        process.kill()
    assert process.returncode == 0, errors


def _assert_same(path, expected):
    with np.load(path) as found:
        for name, want in zip(found.files, expected, strict=True):
            np.testing.assert_allclose(found[name], want, rtol=1e-6, atol=1e-6 * np.abs(want).max())


def test_two_devices_and_two_processes_agree_with_one_device(tmp_path):
    port = _free_port()
    running = [_start(tmp_path, index, port) for index in range(2)]
    expected = {"devices": image(), "process_0": table()}
    expected["process_1"] = expected["process_0"]
    for process in running:
        _finish(process)
    for name, values in expected.items():
        assert all((value > 0).any() for value in values)
        _assert_same(tmp_path / f"{name}.npz", values)
    swept = [tmp_path / "sweep" / f"view_{index:06d}.npz" for index in range(len(VIEWS))]
    for file, intensity in zip(swept, expected["process_0"][0], strict=True):
        np.testing.assert_allclose(np.load(file)["intensity"], intensity, rtol=1e-6)


def _mesh(count, names):
    """A mesh of one device `count` times: enough to be refused."""
    shape = (count,) + (1,) * (len(names) - 1)
    return jax.sharding.Mesh(np.array(jax.devices()[:1] * count).reshape(shape), names)


@pytest.mark.parametrize("names", [("rays",), ("devices", "model")])
def test_a_mesh_with_the_wrong_axis_is_refused(names):
    with pytest.raises(ValueError, match=r"devices: got a mesh with the axes .*, expected the one axis .'devices',."):
        jaxir.render(scene(), camera(), jaxir.LWIR, devices=_mesh(1, names))
    with pytest.raises(ValueError, match="devices: got a mesh with the axes"):
        jaxir.signature(scene(), VIEWS, jaxir.LWIR, devices=_mesh(1, names))


def test_more_devices_than_work_are_refused():
    small = jaxir.orthographic_camera(30.0, 20.0, 0.1, (16, 32))
    with pytest.raises(ValueError, match="devices: got 3 devices for 2 tiles of 16 x 16 pixels, expected at most one"):
        jaxir.render(scene(), small, jaxir.LWIR, devices=_mesh(3, ("devices",)))
    with pytest.raises(ValueError, match="devices: got 4 devices for 3 views"):
        jaxir.signature(scene(), VIEWS, jaxir.LWIR, devices=_mesh(4, ("devices",)))


def test_a_shared_image_is_differentiable():
    devices = _mesh(1, ("devices",))

    def intensity(emissivity):
        return jaxir.render(scene(emissivity), camera(), jaxir.LWIR, samples=4, devices=devices).radiant_intensity()[0]

    slope = jax.grad(intensity)(0.5)
    black = float(jaxir.band_radiance(np.float32(400.0), jaxir.gray_nodes((jaxir.LWIR,)))[0])
    expected = black * np.cos(np.deg2rad(30.0)) * np.cos(np.deg2rad(20.0))
    np.testing.assert_allclose(slope, expected, rtol=0.02)
