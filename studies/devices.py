"""How much faster is a signature on two cores, shared among the devices of a mesh?

The aircraft in the sun from 32 aspects, in small views and in larger ones, on 1 and on 2 virtual devices of this CPU,
each of which runs on a core of its own, while one device alone has helpers on the other: elapsed seconds, medians of
interleaved rounds without compilation.
"""

import os
import time

COUNT = int(os.environ.setdefault("JAXIR_STUDY_DEVICES", "2"))
os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={COUNT}".strip()

import jax  # noqa: E402
import numpy as np  # noqa: E402

import jaxir  # noqa: E402
from studies._study import Run, study, subplots  # noqa: E402
from studies.aircraft import generic_aircraft  # noqa: E402

VIEWS, ROUNDS = 32, 7
SIZES = ((128, 2), (256, 8))  # rows and columns, rays per pixel


def main(run: Run) -> str:
    vertices, faces, _ = generic_aircraft()
    skin = jaxir.Skin(jaxir.Mesh(vertices, faces), 300.0, jaxir.Lambert(0.7))
    scene = jaxir.Scene(skin, sources=(jaxir.ParallelSource((0.0, 0.0, -1.0), 100.0),))
    views = np.stack([np.linspace(0, 180, VIEWS), np.zeros(VIEWS)], 1)
    meshes = {n: jax.sharding.Mesh(np.array(jax.devices()[:n]), ("devices",)) for n in range(1, COUNT + 1)}

    def seen(count: int, size: int, samples: int) -> jaxir.Signature:
        raster = {"shape": (size, size), "samples": samples}
        return jax.block_until_ready(jaxir.signature(scene, views, jaxir.MWIR, devices=meshes[count], **raster))

    cases = [(count, *size) for size in SIZES for count in meshes]
    tables = {case: seen(*case) for case in cases}
    apart = max(float(abs(t.intensity / tables[1, *case[1:]].intensity - 1).max()) for case, t in tables.items())
    times, busy = ({case: [] for case in cases} for _ in range(2))
    for _ in range(ROUNDS):
        for case in cases:
            began, spent = time.perf_counter(), time.process_time()
            seen(*case)
            times[case].append(time.perf_counter() - began)
            busy[case].append((time.process_time() - spent) / times[case][-1])
    figure, axis = subplots(figsize=(4.5, 4))
    counts = np.array(list(meshes))
    rows, said = [], []
    for size, samples in SIZES:
        medians = np.array([np.median(times[count, size, samples]) for count in meshes])
        speed = medians[0] / medians
        cores = [np.median(busy[count, size, samples]) for count in meshes]
        columns = zip(counts, medians, speed, cores, strict=True)
        names = ("devices", "pixels", "rays", "seconds", "speedup", "cores_busy")
        rows += [dict(zip(names, (n, size, samples, t, s, c), strict=True)) for n, t, s, c in columns]
        said.append(
            f"{speed[-1]:.2f} times ({1e3 * medians[0] / VIEWS:.0f} ms a view, {cores[0]:.2f} cores busy with one)"
        )
        axis.plot(counts, speed, "o-", label=f"{size} x {size} pixels, {samples} rays")
    run.table(rows)
    axis.plot(counts, counts, "--", color="0.6", label="linear")
    axis.set(xlabel="devices", ylabel="speed-up", xticks=counts)
    axis.legend()
    run.chart(figure, dpi=90)
    return (
        f"{COUNT} devices are {' and '.join(said)} as fast as one and agree to {apart:.1e}; load of the machine "
        f"before: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
    )


if __name__ == "__main__":
    study(main)
