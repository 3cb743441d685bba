"""How fast is the exact march through a grid, against a scalar native walk on the same core?

Three grids, each seen by an orthographic camera whose rays come in tiles of 16 x 16 pixels: the paper's ramp medium
(800 x 200 x 40 cells), a plume (600 x 48 x 48) and a thick cube (400 x 400 x 400, 64 million cells). The reference is
a scalar cell-by-cell walk (Amanatides and Woo, Eurographics 1987) compiled on the spot by numba. All times are CPU
seconds, interleaved medians of one process on one core; the study runs once as it is and once with the process setting
XLA_FLAGS=--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=65536.

Then, in a plume of 150 x 24 x 24 cells, what many spectral nodes cost beside one (the march, the sum over lists that
were traced before, and the whole evaluation with its Planck functions), and, for the radiant intensity of a jet of
600 x 48 x 48 cells from six aspects, what parallel rays through its box save beside images of equal error.
"""

import argparse
import json
import math
import os
import resource
import subprocess
import sys
import time
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxir
from jaxir.geometry import fitted_camera, tile_points, view_frame
from jaxir.imaging import Pass, division, entering, estimate_chunk, whole_image
from jaxir.medium import march
from studies._study import Run, study

SETTING = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=65536"
GRIDS = {  # cells, size [m], aspect (azimuth, elevation) [deg], optical depth across the smallest side
    "ramp": ((800, 200, 40), (4.0, 1.0, 0.2), (60.0, 20.0), 0.05),
    "plume": ((600, 48, 48), (30.0, 1.2, 1.2), (110.0, 15.0), 0.5),
    "thick": ((400, 400, 400), (2.0, 2.0, 2.0), (35.0, 25.0), 20.0),
}
PIXELS, ROUNDS = 256, 7


def native_walk():
    """The reference, compiled: radiance of every ray, and the number of cells crossed."""
    from numba import njit

    @njit(fastmath=True)
    def walk(low, spacing, shape, extinction, emission, origin, direction, radiance):
        crossed = 0
        step, stride, at = np.zeros(3, np.int64), np.zeros(3, np.int64), np.zeros(3, np.int64)
        nxt, delta = np.zeros(3, np.float32), np.zeros(3, np.float32)
        for ray in range(origin.shape[0]):
            t, leave = np.float32(0), np.float32(np.inf)
            for a in range(3):
                p, v = origin[ray, a] - low[a], direction[ray, a]
                if v != 0:
                    t0, t1 = -p / v, (shape[a] * spacing[a] - p) / v
                    t, leave = max(t, min(t0, t1)), min(leave, max(t0, t1))
                elif p < 0 or p >= shape[a] * spacing[a]:
                    leave = np.float32(-1)
            total, passed = np.float32(0), np.float32(1)
            if t < leave:
                cell = 0
                for a in range(3):
                    p, v = origin[ray, a] - low[a], direction[ray, a]
                    at[a] = min(max(int(math.floor((p + t * v) / spacing[a])), 0), shape[a] - 1)
                    stride[a] = shape[1] * shape[2] if a == 0 else (shape[2] if a == 1 else 1)
                    cell += at[a] * stride[a]
                    step[a] = 1 if v > 0 else -1
                    delta[a] = abs(spacing[a] / v) if v != 0 else np.float32(np.inf)
                    nxt[a] = ((at[a] + (1 if v > 0 else 0)) * spacing[a] - p) / v if v != 0 else np.float32(np.inf)
                while True:
                    a = 0 if nxt[0] <= nxt[1] and nxt[0] <= nxt[2] else (1 if nxt[1] <= nxt[2] else 2)
                    length = max(min(nxt[a], leave) - t, np.float32(0))
                    mu, gone = extinction[cell], -math.expm1(-extinction[cell] * length)
                    total += passed * (emission[cell] / mu * gone if mu > 0 else emission[cell] * length)
                    passed -= passed * gone
                    crossed += 1
                    t = nxt[a]
                    at[a] += step[a]
                    if at[a] < 0 or at[a] >= shape[a] or t >= leave:
                        break
                    nxt[a] += delta[a]
                    cell += step[a] * stride[a]
            radiance[ray] = total
        return crossed

    return walk


def medium(name: str):
    """Grid, extinction and emission [nx, ny, nz, 1] of one case, and the rays of its camera."""
    shape, size, aspect, depth = GRIDS[name]
    low, spacing = -0.5 * np.array(size), np.array(size) / shape
    x, y, z = (low[a] + spacing[a] * (np.arange(shape[a], dtype=np.float32) + 0.5) for a in range(3))
    if name == "ramp":
        field = np.broadcast_to((x - low[0])[:, None, None], shape)
    elif name == "plume":
        field = np.exp(-(y[:, None] ** 2 + z[None, :] ** 2) / 0.1)[None] * (0.2 + np.exp(-(x + 15) / 8))[:, None, None]
    else:
        field = 1 + 0.5 * np.sin(7 * x)[:, None, None] * np.cos(5 * y)[None, :, None] * np.cos(6 * z)[None, None, :]
    extinction = (field * (depth / min(size) / field.mean())).astype(np.float32)[..., None]
    source = (1 + np.cos(3 * x) ** 2).astype(np.float32)[:, None, None, None]
    reach = math.sqrt(sum(s * s for s in size))
    grid = jaxir.Grid(low, spacing, shape)
    camera = fitted_camera(*aspect, grid.corners(), (PIXELS, PIXELS))
    edges = jnp.asarray(camera.tile_edges())
    centre = jnp.full((edges.shape[0], 256, 2), 0.5)
    rays = camera.bundle(tile_points(edges, centre).reshape(-1, 2), jnp.asarray(0.51 * reach)).rays()
    return grid, jnp.asarray(extinction), jnp.asarray(extinction * source), rays


def measure(names: list[str]) -> list[dict]:
    """One row per grid."""
    walk, rows = native_walk(), []
    for name in names:
        grid, extinction, emission, rays = medium(name)
        far, dark = jnp.full(rays.count, jnp.inf), jnp.zeros((rays.count, 1))
        value = jax.jit(lambda mu, j, grid=grid, rays=rays, far=far, dark=dark: march(grid, mu, j, rays, far, dark))
        pulled = jax.jit(
            jax.value_and_grad(
                lambda mu, j, grid=grid, rays=rays, far=far, dark=dark: march(grid, mu, j, rays, far, dark).sum(),
                (0, 1),
            )
        )
        host = [np.asarray(v) for v in (grid.origin, grid.spacing)]
        fields = [np.asarray(v).ravel() for v in (extinction, emission)]
        lines = [np.asarray(v) for v in (rays.origin, rays.direction)]
        native = np.zeros(rays.count, np.float32)

        def run_native(host=host, grid=grid, fields=fields, lines=lines, native=native):
            return walk(host[0], host[1], np.array(grid.shape), *fields, *lines, native)

        runs = {
            "native": run_native,
            "value": lambda value=value, a=extinction, b=emission: jax.block_until_ready(value(a, b)),
            "gradient": lambda pulled=pulled, a=extinction, b=emission: jax.block_until_ready(pulled(a, b)),
        }
        times: dict[str, list[float]] = {label: [] for label in runs}
        crossed = int(run_native())
        got = np.asarray(runs["value"]())[:, 0]
        error = float(np.abs(got - native).max() / native.max())
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        runs["gradient"]()
        for _ in range(ROUNDS):
            for label, run in runs.items():
                began = time.process_time()
                run()
                times[label].append(time.process_time() - began)
        median = {label: float(np.median(t)) for label, t in times.items()}
        rows.append(
            {
                "grid": name,
                "cells": "x".join(str(n) for n in grid.shape),
                "rays": rays.count,
                "crossings": crossed,
                "native_ns": 1e9 * median["native"] / crossed,
                "value_ns": 1e9 * median["value"] / crossed,
                "value_and_gradient_ns": 1e9 * median["gradient"] / crossed,
                "value_over_native": median["value"] / median["native"],
                "gradient_over_value": median["gradient"] / median["value"],
                "largest_difference": error,
                "memory_GB": memory,
            }
        )
        del grid, extinction, emission, rays, value, pulled, fields, runs
    return rows


NODES = (1, 16, 64, 256)


def medians(runs: dict) -> dict[str, float]:
    """CPU seconds of calls, each by itself: beside large ones the small pay for the memory that those give back."""
    spent = {}
    for label, call in runs.items():
        jax.block_until_ready(call())
        times = []
        for _ in range(ROUNDS):
            began = time.process_time()
            jax.block_until_ready(call())
            times.append(time.process_time() - began)
        spent[label] = float(np.median(times))
    return spent


def measure_nodes() -> list[dict]:
    """One row per number of nodes: ns per crossing of the sums, ms of the whole evaluation."""
    shape, size = (150, 24, 24), np.array((30.0, 1.2, 1.2))
    grid = jaxir.Grid(-size / 2, size / shape, shape)
    camera = fitted_camera(110.0, 15.0, grid.corners(), (64, 64))
    edges = jnp.asarray(camera.tile_edges())
    centre = jnp.full((edges.shape[0], 256, 2), 0.5)
    rays = camera.bundle(tile_points(edges, centre).reshape(-1, 2), jnp.asarray(16.0)).rays()
    temperature = np.random.default_rng(0).uniform(400, 1400, shape)
    scene = jaxir.Scene(plumes=jaxir.GridPlume(grid, temperature, jaxir.GrayGas(0.3)))
    paths = jaxir.store_route(scene, jaxir.trace(scene, rays))
    paths = eqx.tree_at(lambda p: p.route, paths, paths.route.trim(int(paths.route.longest())))
    crossed, far = int((paths.route.length > 0).sum()), jnp.full(rays.count, jnp.inf)
    runs = {}
    for count in NODES:
        edges = np.linspace(3.0, 5.0, count + 1)
        nodes = jaxir.gray_nodes([jaxir.Band(f"{k}", edges[k], edges[k + 1]) for k in range(count)])
        gas = jax.jit(lambda scene, nodes=nodes: scene.on(nodes))(scene).medium
        dark = jnp.zeros((rays.count, count))
        listed = jax.jit(lambda gas, dark, paths: gas.radiance(paths.rays, far, dark, paths.route))
        marched = jax.jit(lambda gas, dark: gas.radiance(rays, far, dark))
        whole = jax.jit(lambda scene, paths, nodes=nodes: jaxir.evaluate(scene.on(nodes), paths))
        runs[f"list {count}"] = lambda run=listed, gas=gas, dark=dark: run(gas, dark, paths)
        runs[f"march {count}"] = lambda run=marched, gas=gas, dark=dark: run(gas, dark)
        runs[f"evaluation {count}"] = lambda run=whole: run(scene, paths)
    spent, rows = medians(runs), []
    for count in NODES:
        row = {"nodes": count}
        for what in ("list", "march"):
            row[f"{what}_ns_per_crossing"] = 1e9 * spent[f"{what} {count}"] / crossed
        row["evaluation_ms"] = 1e3 * spent[f"evaluation {count}"]
        for what in ("list", "march", "evaluation"):
            row[f"{what}_over_one_node"] = spent[f"{what} {count}"] / spent[f"{what} 1"]
        rows.append(row)
    return rows


def jet() -> jaxir.Scene:
    """A jet that widens and cools."""
    shape, size = (600, 48, 48), np.array((30.0, 1.2, 1.2))
    low, spacing = -size / 2, size / shape
    x, y, z = (low[a] + spacing[a] * (np.arange(shape[a]) + 0.5) for a in range(3))
    width = 0.12 + 0.012 * (x - low[0])
    core = np.exp(-(y[:, None] ** 2 + z[None] ** 2)[None] / width[:, None, None] ** 2)
    core *= np.exp(-(x - low[0]) / 12)[:, None, None]
    grid = jaxir.Grid(low, spacing, shape)
    return jaxir.Scene(plumes=jaxir.GridPlume(grid, 300 + 900 * core, jaxir.GrayGas((0.8 * core)[..., None])))


def measure_views() -> list[dict]:
    """One row per route and number of rays: error over aspects, ms per aspect."""
    scene, views = jet(), ((90.0, 10.0), (110.0, 15.0), (135.0, -20.0), (160.0, 5.0), (20.0, 30.0), (60.0, -40.0))
    lit = jax.jit(lambda scene: scene.on(jaxir.gray_nodes((jaxir.MWIR,))))(scene)
    gas, corners, rows = lit.medium, scene.extent(), []
    low, high = corners.min(axis=0), corners.max(axis=0)

    @partial(jax.jit, static_argnums=0)
    def box(count, azimuth, elevation):
        rays, area = entering(low, high, view_frame(azimuth, elevation)[2], count)
        seen = gas.radiance(rays, jnp.full(rays.count, jnp.inf), jnp.zeros((rays.count, 1)))
        return jnp.sum(seen[:, 0]) * area

    def fitted(side, azimuth, elevation):
        return image(fitted_camera(azimuth, elevation, corners, (side, side)))

    def square(side, azimuth, elevation):
        camera = fitted_camera(azimuth, elevation, corners, (side, side))
        return image(eqx.tree_at(lambda c: c.pixel, camera, jnp.full(2, camera.pixel.max())))

    def image(camera):
        method = jaxir.Method().resolved(scene)
        taken = Pass(lit, camera, jax.random.key(0), jnp.uint32(0), division(2, known=False), method, 1)
        parts = jax.lax.map(lambda chunk: estimate_chunk(taken.of_chunks(), chunk), taken.chunks())
        return whole_image(taken, parts).radiant_intensity()[0]

    exact = np.array([float(box(1 << 20, *view)) for view in views])
    images = (64, 128, 256, 512)
    for route, call, counts in (
        ("rays through the box", box, (1024, 2048, 4096, 8192, 16384)),
        ("image of the outline", fitted, images),
        ("image of square pixels", square, images),
    ):
        for count in counts:
            spent, got = 0.0, []
            for view in views:
                got.append(float(call(count, *view)))
                times = []
                for _ in range(3):
                    began = time.process_time()
                    jax.block_until_ready(call(count, *view))
                    times.append(time.process_time() - began)
                spent += float(np.median(times)) / len(views)
            error = float(np.sqrt(np.mean((np.array(got) / exact - 1) ** 2)))
            rows.append({"route": route, "rays_or_side": count, "error": error, "ms": 1e3 * spent})
    return rows


def saved(rows: list[dict]) -> tuple[dict, list[float]]:
    """The cheapest rays within 1.1e-3, and how much longer images of their error take by their own power laws."""
    routes = list(dict.fromkeys(row["route"] for row in rows))
    near = [row for row in rows if row["route"] == routes[0] and row["error"] < 1.1e-3]
    best, longer = min(near, key=lambda row: row["ms"]), []
    for route in routes[1:]:
        own = [(math.log(row["error"]), math.log(row["ms"])) for row in rows if row["route"] == route]
        slope, level = np.polyfit(*np.transpose(own), 1)
        longer.append(math.exp(level + slope * math.log(best["error"])) / best["ms"])
    return best, longer


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--grids", nargs="+", choices=list(GRIDS), default=list(GRIDS))


def main(run: Run) -> str:
    chosen = run.options
    rows = []
    for setting in ("", SETTING):
        environment = {**os.environ, "XLA_FLAGS": setting}
        code = f"import json; from studies.march_speed import measure; print(json.dumps(measure({chosen.grids!r})))"
        if hasattr(os, "sched_setaffinity"):
            code = f"import os; os.sched_setaffinity(0, {{{max(os.sched_getaffinity(0))}}}); {code}"
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
        if done.returncode:
            raise ValueError(done.stderr.strip().splitlines()[-1])
        name = "65536" if setting else "default"
        rows += [{"loop_threshold": name, **row} for row in json.loads(done.stdout.splitlines()[-1])]
    run.table(rows)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    nodes, views = measure_nodes(), measure_views()
    run.table(nodes, "march_nodes")
    run.table(views, "march_views")
    print("| loop threshold | grid | native | value | value + gradient | value / native | (value + gradient) / value |")
    print("|---|---|---|---|---|---|---|")
    for row in rows:
        print(
            f"| {row['loop_threshold']} | {row['cells']} | {row['native_ns']:.1f} | {row['value_ns']:.1f} | "
            f"{row['value_and_gradient_ns']:.1f} | {row['value_over_native']:.2f} | {row['gradient_over_value']:.1f} |"
        )
    for row in nodes:
        print(
            f"{row['nodes']} nodes: list {row['list_ns_per_crossing']:.0f}, march {row['march_ns_per_crossing']:.0f} "
            f"ns per crossing, evaluation {row['evaluation_ms']:.1f} ms; over one node "
            f"{row['list_over_one_node']:.1f}, {row['march_over_one_node']:.1f}, {row['evaluation_over_one_node']:.1f}"
        )
    for row in views:
        print(f"{row['route']} {row['rays_or_side']}: error {row['error']:.1e}, {row['ms']:.2f} ms an aspect")
    worst = [max(row[key] for row in rows) for key in ("value_over_native", "gradient_over_value")]
    best, longer = saved(views)
    return (
        f"ns per cell crossed on one core: the march takes at most {worst[0]:.2f} x a native walk, with the gradient "
        f"to all cells at most {worst[1]:.1f} x that; {nodes[-1]['nodes']} nodes cost "
        f"{nodes[-1]['list_over_one_node']:.0f} x one (lists), {nodes[-1]['march_over_one_node']:.0f} x (march); "
        f"a jet's intensity to {best['error']:.1e} takes {best['ms']:.1f} ms by rays through its box, "
        f"{longer[0]:.0f} x less than the image of its outline, {longer[1]:.0f} x less than one of square pixels"
    )


if __name__ == "__main__":
    study(main, options, needs=("numba",))
