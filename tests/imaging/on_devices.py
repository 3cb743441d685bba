"""What one process of a computation on many devices does: `python -m tests.imaging.on_devices OUT [INDEX PORT]`.

An image on two devices of one process, or a signature and a sweep as one of two processes.
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


def scene(irradiance=100.0):
    """A plate in the sun; its edges are where random numbers matter."""
    return jaxir.Scene(plate(), sources=(jaxir.ParallelSource((-1.0, 0.0, 0.0), irradiance),))


def image(devices=None, irradiance=100.0):
    """An image and its error."""
    seen = jaxir.render(scene(irradiance), camera(), jaxir.LWIR, samples=4, devices=devices)
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
    brighter = image(mesh, 300.0)
    assert compiled == []
    assert brighter[0].sum() > image(mesh)[0].sum()


if __name__ == "__main__":
    if len(sys.argv) > 2:
        jax.distributed.initialize(f"localhost:{sys.argv[3]}", 2, int(sys.argv[2]))
    mesh = jax.sharding.Mesh(np.array(jax.devices()), ("devices",))
    assert mesh.size == 2
    np.savez(sys.argv[1], *(image(mesh) if len(sys.argv) == 2 else table(mesh)))
    if len(sys.argv) > 2:
        folder = Path(sys.argv[1]).parent / "sweep"
        sweep(folder, scene(), VIEWS, jaxir.LWIR, shape=(24, 24), devices=mesh)
    else:
        assert_compiled_once(mesh)
