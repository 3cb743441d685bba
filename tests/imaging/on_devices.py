"""What one of two processes of two devices each does: `python -m tests.imaging.on_devices OUT INDEX PORT`.

A signature and a sweep with the other one, on a device of each; then the first an image on its own two devices.
"""

import sys
from pathlib import Path

import jax
import numpy as np

import jaxir
from jaxir.io.result import sweep
from tests.scenes import plate

VIEWS = ((0.0, 0.0), (20.0, 10.0), (70.0, -3.0))


def camera():
    """Five chunks of two tiles."""
    return jaxir.orthographic_camera(30.0, 20.0, 0.05, (40, 34))


def scene(emissivity=0.5):
    """A warm plate; its edges are where random numbers matter."""
    return jaxir.Scene(plate(emissivity))


def image(devices=None, emissivity=0.5):
    """An image and its error."""
    seen = jaxir.render(scene(emissivity), camera(), jaxir.LWIR, samples=4, devices=devices)
    return [np.asarray(leaf) for leaf in (seen.radiance, seen.standard_error)]


def table(devices=None):
    """A signature and its error."""
    seen = jaxir.signature(scene(), VIEWS, jaxir.LWIR, shape=(24, 24), devices=devices)
    return [np.asarray(leaf) for leaf in (seen.intensity, seen.standard_error)]


def assert_compiled_once(mesh):
    """An image of other values on the same devices takes the programs of the first."""
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, seconds, **_: compiled.append(seconds) if event.endswith("backend_compile_duration") else None
    )
    brighter = image(mesh, 0.9)
    assert compiled == []
    assert brighter[0].sum() > image(mesh)[0].sum()


if __name__ == "__main__":
    out, index = Path(sys.argv[1]), int(sys.argv[2])
    jax.distributed.initialize(f"localhost:{sys.argv[3]}", 2, index)
    first, *_, last = jax.devices()
    assert (first.process_index, last.process_index) == (0, 1) and len(jax.local_devices()) == 2
    both = jax.sharding.Mesh(np.array([first, last]), ("devices",))
    np.savez(out / f"process_{index}.npz", *table(both))
    sweep(out / "sweep", scene(), VIEWS, jaxir.LWIR, shape=(24, 24), devices=both)
    if index == 0:
        own = jax.sharding.Mesh(np.array(jax.local_devices()), ("devices",))
        np.savez(out / "devices.npz", *image(own))
        assert_compiled_once(own)
