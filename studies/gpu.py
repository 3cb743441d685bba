"""How fast is the accelerator at hand, beside the CPU of the same machine?

Rays a second (closest hit of the generic aircraft in the sun, camera rays), cells crossed a second and nanoseconds per
cell and node (exact sum through a cube of gas), and what fraction of the memory bandwidth, itself measured by copying
an array, the crossings read at least: extinction and emission, 4 bytes each per cell and node. The same user code runs
on every backend; without an accelerator the CPU alone is measured, and the output says so.
"""

import time

import jax
import jax.numpy as jnp
import numpy as np

import jaxir
from jaxir.geometry import crossings, fitted_camera, tile_points
from studies._study import Run, study
from studies.scaling import SUN, bands, body, gas

PIXELS, ROUNDS, CELLS, NODES = 256, 5, 300_000, (1, 16)


def seconds(run) -> float:
    """Median without compilation."""
    jax.block_until_ready(run())
    times = []
    for _ in range(ROUNDS):
        began = time.perf_counter()
        jax.block_until_ready(run())
        times.append(time.perf_counter() - began)
    return float(np.median(times))


def bandwidth(megabytes: int = 256) -> float:
    """Bytes read and written a second by a scaled copy."""
    field = jnp.ones(megabytes * 250_000)
    copy = jax.jit(lambda x: 1.5 * x)
    return 2 * field.nbytes / seconds(lambda: copy(field))


def crossed(scene, camera) -> float:
    """Mean number of cells crossed by a camera ray, from one ray in 64."""
    edges = jnp.asarray(camera.tile_edges()[::64])
    screen = tile_points(edges, jnp.full((edges.shape[0], 256, 2), 0.5)).reshape(-1, 2)
    rays = camera.bundle(screen, scene.start(camera)).rays()
    lists = crossings(scene.plume.grid, rays, jnp.full(rays.count, jnp.inf))
    return float(jnp.mean(jnp.sum(lists.length > 0, axis=1)))


def measure(device) -> list[dict]:
    with jax.default_device(device):
        name = f"{device.platform}: {device.device_kind}"
        top = bandwidth()
        rows = [{"device": name, "what": "copy", "value": top / 1e9, "unit": "GB/s"}]
        scene = jaxir.Scene(body(1.0), sources=(SUN,))
        camera = fitted_camera(40.0, 20.0, scene.extent(), (PIXELS, PIXELS))
        spent = seconds(lambda: jaxir.render(scene, camera, jaxir.MWIR, samples=2).radiance)
        rate = 2 * PIXELS**2 / spent / 1e6
        rows.append({"device": name, "what": "camera rays, lit by the sun", "value": rate, "unit": "Mrays/s"})
        scene = jaxir.Scene(plumes=gas(CELLS))
        camera = fitted_camera(40.0, 20.0, scene.extent(), (PIXELS, PIXELS))
        work = 2 * PIXELS**2 * crossed(scene, camera)
        for count in NODES:
            nodes = bands(count)
            spent = seconds(lambda nodes=nodes: jaxir.render(scene, camera, nodes, samples=2).radiance)
            label = f"crossings, {count} nodes"
            rows.append({"device": name, "what": label, "value": work / spent / 1e6, "unit": "Mcrossings/s"})
            each = spent / work / count * 1e9
            rows.append({"device": name, "what": label, "value": each, "unit": "ns per cell and node"})
            share = 8 * work * count / spent / top
            rows.append({"device": name, "what": label, "value": share, "unit": "of the bandwidth"})
    return rows


def main(run: Run) -> str:
    devices = list({device.platform: device for device in (*jax.devices(), jax.devices("cpu")[0])}.values())
    rows = [row for device in devices for row in measure(device)]
    run.table(rows)
    for row in rows:
        print(f"{row['device']:24s} {row['what']:28s} {row['value']:10.4g} {row['unit']}")
    rates = [f"{row['device']} {row['value']:.3g} {row['unit']}" for row in rows if row["unit"].startswith("M")]
    return ", ".join(rates) + ("; no accelerator is present" if len(devices) == 1 else "")


if __name__ == "__main__":
    study(main, needs=())
