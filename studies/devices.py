"""How much faster is a signature on two cores, shared among the devices of a mesh?

The aircraft in the sun from 32 aspects, 128 x 128 pixels, on 1 and on 2 virtual devices of this CPU, each of which
runs on a core of its own: elapsed seconds, medians of interleaved rounds without compilation.
"""

import argparse
import csv
import os
import sys
import time
from pathlib import Path

COUNT = int(os.environ.setdefault("JAXIR_STUDY_DEVICES", "2"))
os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={COUNT}".strip()

import jax  # noqa: E402
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402

import jaxir  # noqa: E402
from studies.aircraft import generic_aircraft  # noqa: E402
from studies.charts import out_folder  # noqa: E402

VIEWS, ROUNDS = 32, 5


def main(argv: list[str]) -> None:
    parser = argparse.ArgumentParser(prog="python -m studies.devices", description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=out_folder("devices"), help="folder (%(default)s)")
    chosen = parser.parse_args(argv)
    vertices, faces, _ = generic_aircraft()
    skin = jaxir.Skin(jaxir.Mesh(vertices, faces), 300.0, jaxir.Lambert(0.7))
    scene = jaxir.Scene(skin, sources=(jaxir.ParallelSource((0.0, 0.0, -1.0), 100.0),))
    views = np.stack([np.linspace(0, 180, VIEWS), np.zeros(VIEWS)], 1)
    meshes = {n: jax.sharding.Mesh(np.array(jax.devices()[:n]), ("devices",)) for n in range(1, COUNT + 1)}

    def run(count: int) -> jaxir.Signature:
        return jax.block_until_ready(jaxir.signature(scene, views, jaxir.MWIR, devices=meshes[count]))

    tables = {count: run(count) for count in meshes}
    apart = max(float(abs(t.intensity / tables[1].intensity - 1).max()) for t in tables.values())
    times = {count: [] for count in meshes}
    for _ in range(ROUNDS):
        for count in meshes:
            began = time.perf_counter()
            run(count)
            times[count].append(time.perf_counter() - began)
    counts = np.array(list(meshes))
    medians = np.array([np.median(times[count]) for count in meshes])
    speed = medians[0] / medians
    with open(chosen.out / "devices.csv", "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["devices", "seconds", "speedup"])
        writer.writerows([n, f"{t:.4g}", f"{s:.3g}"] for n, t, s in zip(counts, medians, speed, strict=True))
    figure, axis = plt.subplots(figsize=(4.5, 4), layout="constrained")
    axis.plot(counts, speed, "o-", label="measured")
    axis.plot(counts, counts, "--", color="0.6", label="linear")
    axis.set(xlabel="devices", ylabel="speed-up", xticks=counts)
    axis.legend()
    figure.savefig(chosen.out / "devices.png", dpi=90)
    plt.close(figure)
    print(
        f"{COUNT} devices are {speed[-1]:.2f} times as fast as one and agree to {apart:.1e}; load of the machine "
        f"before: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
    )


if __name__ == "__main__":
    main(sys.argv[1:])
