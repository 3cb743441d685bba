"""How do time and memory grow with the work? Triangles, cells, spectral nodes, bounces, rays per pixel, views.

One pass over a 256 x 256 image: CPU seconds, medians without compilation, and the temporary memory of one compiled
chunk, which bounds a render whatever the image (64 tiles of 256 rays). Exponents are slopes between the last two
points of each curve. `--full` goes to 1e6 triangles and 6e7 cells.
"""

import argparse
import time
from typing import Any

import equinox as eqx
import jax
import numpy as np
from tqdm import tqdm

import jaxir
from jaxir.geometry import fitted_camera
from jaxir.imaging import estimate_chunk, first_pass
from studies._study import Run, study, subplots
from studies.aircraft import generic_aircraft

PIXELS, ROUNDS = 256, 3
SUN = jaxir.ParallelSource((0.0, 0.0, -1.0), 100.0)


def body(detail: float) -> jaxir.Skin:
    vertices, faces, _ = generic_aircraft(detail)
    return jaxir.Skin(jaxir.Mesh(vertices, faces), 300.0, jaxir.Lambert(0.7))


def gas(cells: int) -> jaxir.GridPlume:
    """A cube of gas of about `cells` cells."""
    side = round(cells ** (1 / 3))
    grid = jaxir.Grid((-2.0, -2.0, -2.0), (4 / side,) * 3, (side,) * 3)
    temperature = np.linspace(600.0, 1200.0, side, dtype=np.float32)[:, None, None] * np.ones((1, side, side), "f4")
    return jaxir.GridPlume(grid, temperature, jaxir.GrayGas(0.3))


def bands(count: int) -> jaxir.Nodes:
    edges = np.linspace(3.0, 5.0, count + 1)
    return jaxir.gray_nodes([jaxir.Band(f"{k}", edges[k], edges[k + 1]) for k in range(count)])


def one_pass(scene, nodes, samples=2, bounces=0) -> tuple[float, float]:
    """Seconds of all chunks, and the temporary memory of one [MB]."""
    camera = fitted_camera(40.0, 20.0, scene.extent(), (PIXELS, PIXELS))
    method = jaxir.Method(jaxir.DirectSampling(1, 0), bounces).resolved(scene)
    whole = first_pass(scene, camera, nodes, jax.random.key(0), samples, method)
    chunks = whole.chunks().each()
    whole = whole.of_chunks()
    compiled = eqx.filter_jit(estimate_chunk.__wrapped__).lower(whole, chunks[0]).compile()
    memory = compiled.compiled.memory_analysis().temp_size_in_bytes / 1e6
    jax.block_until_ready(compiled(whole, chunks[0]))
    times = []
    for _ in range(ROUNDS):
        began = time.process_time()
        for chunk in chunks:
            jax.block_until_ready(compiled(whole, chunk))
        times.append(time.process_time() - began)
    return float(np.median(times)), memory


def sweep(views: int) -> tuple[float, float]:
    scene, asked = SHARED["body"], np.stack([np.linspace(0, 90, views), np.zeros(views)], 1)
    jaxir.signature(scene, asked, jaxir.MWIR, shape=(64, 64))
    times = []
    for _ in range(ROUNDS):
        began = time.process_time()
        jax.block_until_ready(jaxir.signature(scene, asked, jaxir.MWIR, shape=(64, 64)).intensity)
        times.append(time.process_time() - began)
    return float(np.median(times)), np.nan


SHARED: dict[str, jaxir.Scene] = {}


def axes(full: bool):
    """Name, values, and what is measured at a value."""
    gray = bands(1)
    details = (0.01, 0.1, 1.0, 10.0) + ((100.0,) if full else ())
    sizes = (10_000, 100_000, 1_000_000) + ((8_000_000, 60_000_000) if full else ())

    def triangles(detail):
        scene = jaxir.Scene(body(detail), sources=(SUN,))
        return scene.skin.mesh.count, *one_pass(scene, gray)

    def bounces(count):
        return count + 1, *one_pass(SHARED["body"], gray, bounces=count)

    yield "triangles", details, triangles
    yield "cells", sizes, lambda n: (round(n ** (1 / 3)) ** 3, *one_pass(jaxir.Scene(plumes=gas(n)), gray))
    yield "nodes", (1, 4, 16, 64, *((256,) if full else ())), lambda n: (n, *one_pass(SHARED["gas"], bands(n)))
    yield "legs (bounces + 1)", (0, 1, 3), bounces
    yield "rays per pixel", (2, 8, 32), lambda n: (n, *one_pass(SHARED["body"], gray, n))
    yield "views", (2, 8, 32), lambda n: (n, *sweep(n))


def chart(rows: list[dict]) -> tuple[Any, list[str]]:
    """Time and memory along every axis, with the exponents between the last two steps."""
    names = list(dict.fromkeys(row["axis"] for row in rows))
    figure, panels = subplots(2, 3, figsize=(13, 7))
    said = []
    for panel, name in zip(panels.ravel(), names, strict=True):
        own = [row for row in rows if row["axis"] == name]
        work, seconds, memory = (
            np.array([row[k] for row in own], float) for k in ("work", "seconds", "chunk_megabytes")
        )
        slope = np.log(seconds[-1] / seconds[-2]) / np.log(work[-1] / work[-2])
        said.append(f"{name} {slope:.2f}")
        panel.loglog(work, seconds, "o-", label=f"CPU seconds, exponent {slope:.2f}")
        if np.isfinite(memory).all():
            growth = np.log(memory[-1] / memory[-2]) / np.log(work[-1] / work[-2])
            panel.loglog(work, memory / 1e3, "s--", label=f"GB of a chunk, exponent {growth:.2f}")
            said[-1] += f" (memory {growth:.2f})"
        panel.set(xlabel=name)
        if work[-1] < 1000:  # too few decades for ticks at powers of ten
            panel.set_xticks(work, [f"{w:.0f}" for w in work])
            panel.xaxis.minorticks_off()
        panel.legend()
    return figure, said


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--full", action="store_true", help="1e6 triangles, 6e7 cells, 256 nodes too")


def main(run: Run) -> str:
    chosen = run.options
    SHARED["body"] = jaxir.Scene(body(1.0), sources=(SUN,))
    SHARED["gas"] = jaxir.Scene(plumes=gas(30_000))
    rows = []
    for name, values, measured in axes(chosen.full):
        for value in tqdm(values, desc=name, leave=False):
            work, seconds, memory = measured(value)
            rows.append({"axis": name, "work": work, "seconds": seconds, "chunk_megabytes": memory})
            jax.clear_caches()
    run.table(rows)
    figure, said = chart(rows)
    run.chart(figure, dpi=90)
    most = max(row["chunk_megabytes"] for row in rows if np.isfinite(row["chunk_megabytes"]))
    return f"time grows with the power of {', '.join(said)}; a chunk needs {most:.0f} MB at most"


if __name__ == "__main__":
    study(main, options, published="--full")
