"""How many rays per second does jaxir search, beside Embree?

Mrays/s against triangles for a camera, a jittered camera, the sun's shadow on what the camera sees, and incoherent rays
(closest and any hit), on a sphere and on an aircraft. One core, CPU seconds, medians of interleaved repetitions. Peak
memory and the gain of a second core are measured in processes of their own. Writes a CSV and a chart.
"""

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxir
from jaxir.geometry import Bundle, Rays, tile_points
from jaxir.geometry.search import any_hit, closest_hit, occluded
from studies import mitsuba_peer
from studies._study import Run, study, subplots
from studies.aircraft import generic_aircraft

SUN = np.array([0.3, 0.4, 0.8]) / np.linalg.norm([0.3, 0.4, 0.8])
DISTANCE = 5000.0  # of the camera [m]


class Case(NamedTuple):
    """One kind of question: how many rays it asks, and who can answer it."""

    rays: int
    compiles: Callable[[], Any]
    answers: dict[str, Callable[[], Any]]


def sphere(subdivisions: int) -> tuple[np.ndarray, np.ndarray]:
    """An icosphere of radius 1 m and 20 * 4^subdivisions faces."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    return np.asarray(ball.vertices), np.asarray(ball.faces)


def aircraft(faces: float) -> tuple[np.ndarray, np.ndarray]:
    """The generic aircraft with about this many faces."""
    return generic_aircraft(faces / 10_720)[:2]


def picture(width: float, pixels: int, reach: float, samples: int = 1) -> Bundle:
    """Rays of a camera that sees `width` [m]; several samples lie at random places of each pixel."""
    camera = jaxir.perspective_camera(60.0, 25.0, DISTANCE, width / pixels / DISTANCE, (pixels, pixels))
    edges = jnp.repeat(jnp.asarray(camera.tile_edges()), samples, axis=0)
    shape = (edges.shape[0], 256, 2)
    offset = np.full(shape, 0.5) if samples == 1 else np.random.default_rng(0).random(shape)
    screen = tile_points(edges, jnp.asarray(offset, jnp.float32)).reshape(-1, 2)
    return camera.bundle(screen, jnp.asarray(2 * reach, jnp.float32))


def embree(corners: np.ndarray) -> Callable[..., Any] | None:
    """Raw Embree through embreex: run(origins, directions, query, output=None); None where it is not installed."""
    try:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except ImportError:
        return None
    scene = EmbreeScene()
    TriangleMesh(scene, np.ascontiguousarray(corners, np.float32))
    return lambda origin, direction, query, **more: scene.run(origin, direction, query=query, **more)


def trimesh_embree(vertices: np.ndarray, faces: np.ndarray) -> Any:
    """Embree through trimesh; None where embreex is not installed."""
    try:
        import trimesh
        from trimesh.ray.ray_pyembree import RayMeshIntersector
    except ImportError:
        return None
    return RayMeshIntersector(trimesh.Trimesh(vertices, faces, process=False))


def mitsuba(vertices: np.ndarray, faces: np.ndarray) -> Callable[[np.ndarray, np.ndarray, bool], Any] | None:
    """Mitsuba's LLVM backend (Embree packets): run(origins, directions, any_hit); None where it cannot run."""
    why = mitsuba_peer.trouble()
    if why:
        print(f"Mitsuba is not measured: {why}", file=sys.stderr)
        return None
    try:
        import drjit
        import mitsuba as mi

        mi.set_variant("llvm_ad_rgb")
        shape = mi.Mesh("mesh", vertex_count=len(vertices), face_count=len(faces))
        fields = mi.traverse(shape)
        fields["vertex_positions"] = np.ravel(vertices).astype(np.float32)
        fields["faces"] = np.ravel(faces).astype(np.uint32)
        fields.update()
        scene = mi.load_dict({"type": "scene", "mesh": shape})
        drjit.eval(mi.Float(0.0) + 1)
    except Exception as reason:  # noqa: BLE001 - whatever keeps it from running keeps it out of the comparison
        print(f"ray_throughput: without Mitsuba ({type(reason).__name__})", file=sys.stderr)
        return None

    def run(origin: np.ndarray, direction: np.ndarray, any_hit: bool) -> Any:
        ray = mi.Ray3f(mi.Point3f(origin.T), mi.Vector3f(direction.T))
        found = scene.ray_test(ray) if any_hit else scene.ray_intersect_preliminary(ray, coherent=True)
        drjit.eval(found)
        drjit.sync_thread()
        return found

    return run


def cases(vertices: np.ndarray, faces: np.ndarray, width: float, pixels: int, loose: int, peers: bool):
    """All questions about one mesh: {name: Case}."""
    mesh = jaxir.Mesh(vertices, faces)
    raw = embree(np.asarray(mesh.vertices)[faces]) if peers else None
    wrapped = trimesh_embree(vertices, faces) if peers else None
    packets = mitsuba(vertices, faces) if peers else None
    reach = float(np.abs(vertices).max())
    rng = np.random.default_rng(1)
    first = jax.jit(lambda mesh, rays: closest_hit(mesh, rays).face)
    some = jax.jit(any_hit)

    def case(rays: Rays | Bundle, any_hit: bool) -> Case:
        search = some if any_hit else first
        single = rays.rays() if isinstance(rays, Bundle) else rays
        o, d = np.asarray(single.origin), np.asarray(single.direction)
        answers = {"jaxir": lambda: search(mesh, rays)}
        if raw is not None:
            answers["Embree"] = lambda: raw(o, d, "OCCLUDED" if any_hit else "INTERSECT")
        if wrapped is not None:
            answers["trimesh"] = lambda: (wrapped.intersects_any if any_hit else wrapped.intersects_first)(o, d)
        if packets is not None:
            answers["Mitsuba"] = lambda: packets(o, d, any_hit)
        return Case(rays.count, lambda: search.lower(mesh, rays).compile(), answers)

    def shadow(view: Bundle) -> Case:
        hit = closest_hit(mesh, view)
        seen = np.flatnonzero(np.asarray(hit.face) >= 0)
        sun = jnp.asarray(SUN, jnp.float32)
        search = jax.jit(lambda mesh, point, face: occluded(mesh, point, face, sun, face >= 0))
        answers: dict[str, Callable[[], Any]] = {"jaxir": lambda: search(mesh, hit.point, hit.face)}
        origin = np.asarray(hit.point + 1e-5 * reach * hit.normal)[seen]
        direction = np.tile(SUN.astype(np.float32), (len(seen), 1))
        if raw is not None:
            answers["Embree"] = lambda: raw(origin, direction, "OCCLUDED")
        if wrapped is not None:
            answers["trimesh"] = lambda: wrapped.intersects_any(origin, direction)
        if packets is not None:
            answers["Mitsuba"] = lambda: packets(origin, direction, True)
        return Case(len(seen), lambda: search.lower(mesh, hit.point, hit.face).compile(), answers)

    low, high = vertices.min(0), vertices.max(0)
    direction = rng.normal(size=(loose, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    strewn = Rays(*(jnp.asarray(x, jnp.float32) for x in (rng.uniform(low, high, (loose, 3)), direction)))
    view = picture(width, pixels, reach)
    return {
        "camera": case(view, False),
        "jittered camera": case(picture(width, pixels // 2, reach, samples=4), False),
        "sun shadow": shadow(view),
        "sun shadow of a filled frame": shadow(picture(0.18 * width, pixels, reach)),
        "incoherent closest": case(strewn, False),
        "incoherent any": case(strewn, True),
    }


def medians(answers: dict[str, Callable[[], Any]], repeat: int) -> dict[str, float]:
    """CPU seconds of each answer, measured in turns."""
    spent: dict[str, list[float]] = {name: [] for name in answers}
    for turn in range(repeat + 1):
        for name, answer in answers.items():
            began = time.process_time()
            jax.block_until_ready(answer())
            if turn:
                spent[name].append(time.process_time() - began)
    return {name: float(np.median(seconds)) for name, seconds in spent.items()}


def table(bodies: list, pixels: int, loose: int, repeat: int, peers: bool) -> list[dict[str, Any]]:
    """One row for each body, question and tracer."""
    rows: list[dict[str, Any]] = []
    for body, (vertices, faces), width in bodies:
        began = time.process_time()
        jaxir.Mesh(vertices, faces)
        build = time.process_time() - began
        for question, case in cases(vertices, faces, width, pixels, loose, peers).items():
            began = time.process_time()
            case.compiles()
            compiling = time.process_time() - began
            seconds = medians(case.answers, repeat)
            for tracer, spent in seconds.items():
                rows.append(
                    {
                        "body": body,
                        "faces": len(faces),
                        "question": question,
                        "tracer": tracer,
                        "rays": case.rays,
                        "Mrays/s": round(case.rays / spent / 1e6, 3),
                        "of Embree": round(seconds["Embree"] / spent, 3) if "Embree" in seconds else "",
                        "compile [s]": round(compiling, 2) if tracer == "jaxir" else "",
                        "build [s]": round(build, 3) if tracer == "jaxir" else "",
                    }
                )
            said = ", ".join(f"{tracer} {case.rays / spent / 1e6:.1f}" for tracer, spent in seconds.items())
            print(f"{body} {len(faces)} {question}: {said} Mrays/s", file=sys.stderr)
    return rows


def chart(rows: list[dict[str, Any]]) -> Any:
    questions = list(dict.fromkeys(row["question"] for row in rows))
    bodies = list(dict.fromkeys(row["body"] for row in rows))
    tracers = list(dict.fromkeys(row["tracer"] for row in rows))
    figure, axes = subplots(2, 3, figsize=(10, 6), sharex=True)
    for axis, question in zip(axes.ravel(), questions, strict=False):
        for tracer in tracers:
            for body, style in zip(bodies, ("-", "--"), strict=False):
                line = [r for r in rows if (r["question"], r["tracer"], r["body"]) == (question, tracer, body)]
                colour = f"C{tracers.index(tracer)}"
                x, y = [r["faces"] for r in line], [r["Mrays/s"] for r in line]
                axis.loglog(x, y, style, color=colour, marker=".", label=f"{tracer}, {body}")
        axis.set_title(question)
        axis.grid(alpha=0.3)
    for axis in axes[-1]:
        axis.set_xlabel("triangles")
    for axis in axes[:, 0]:
        axis.set_ylabel("Mrays/s, one core")
    axes[0, 0].legend(fontsize=7)
    return figure


def peak_memory(faces: float, pixels: int) -> None:
    """Print the bytes that a search of a picture adds to those of an idle process, and the process's peak."""
    import resource

    jax.block_until_ready(jnp.zeros(8) + 1)
    idle = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    vertices, triangles = aircraft(faces)
    mesh = jaxir.Mesh(vertices, triangles)
    view = picture(17.0, pixels, float(np.abs(vertices).max()))
    hit = closest_hit(mesh, view)
    jax.block_until_ready(occluded(mesh, hit.point, hit.face, jnp.asarray(SUN, jnp.float32), hit.face >= 0))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    print(len(triangles), view.count, peak - idle, peak)


def two_cores(faces: float, pixels: int, repeat: int) -> None:
    """Print the wall seconds of a picture on one device and shared among two, best of interleaved runs."""
    spec, whole = jax.sharding.PartitionSpec("ray"), jax.sharding.PartitionSpec()
    vertices, triangles = aircraft(faces)
    mesh = jaxir.Mesh(vertices, triangles)
    view = picture(6.0, pixels, float(np.abs(vertices).max()))
    # tiles in turn to either device, so that both see as much of the aircraft
    tiles = view.screen.reshape(-1, 256, 2)[: view.count // 512 * 2]
    screen = jnp.concatenate([tiles[0::2], tiles[1::2]]).reshape(-1, 2)

    def search(mesh: Any, screen: Any) -> Any:
        return closest_hit(mesh, Bundle(view.target, view.frame, view.inverse_range, view.start, screen)).face

    runs = []
    for count in (1, 2):
        devices = jax.make_mesh((count,), ("ray",), axis_types=(jax.sharding.AxisType.Auto,))
        put = jax.device_put(screen, jax.sharding.NamedSharding(devices, spec))
        mesh_put = jax.device_put(mesh, jax.sharding.NamedSharding(devices, whole))
        run = jax.jit(jax.shard_map(search, mesh=devices, in_specs=(whole, spec), out_specs=spec))
        jax.block_until_ready(run(mesh_put, put))
        runs.append((run, mesh_put, put, []))
    for _ in range(repeat):
        for run, mesh_put, put, spent in runs:
            began = time.perf_counter()
            jax.block_until_ready(run(mesh_put, put))
            spent.append(time.perf_counter() - began)
    print(*(min(spent) for *_, spent in runs))


def aside(call: str, **variables: str) -> list[float]:
    """The numbers that a function of this study prints in a process of its own."""
    code = f"from studies import ray_throughput as r; r.{call}"
    environment = {k: v for k, v in os.environ.items() if k != "XLA_FLAGS"} | variables
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    return [float(word) for word in done.stdout.split()]


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--quick", action="store_true", help="small meshes and pictures, a minute or less")
    parser.add_argument("--no-peers", action="store_true", help="measure jaxir alone")
    parser.add_argument("--repeat", type=int, default=5, help="repetitions of which the median counts (%(default)s)")


def main(run: Run) -> str:
    chosen = run.options
    pixels, loose = (250, 20_000) if chosen.quick else (1000, 200_000)
    memory_faces, memory_pixels = (2e4, 250) if chosen.quick else (1e6, 1000)
    count, rays, added, _ = aside(f"peak_memory({memory_faces}, {memory_pixels})")
    one, two = aside(f"two_cores(2e4, {pixels}, 9)", XLA_FLAGS="--xla_force_host_platform_device_count=2")
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})  # one core for all
    sizes = (1e3, 1e4) if chosen.quick else (1e2, 1e3, 1e4, 1e5, 1e6)
    levels = (3, 5) if chosen.quick else (1, 3, 5, 7)
    bodies = [("aircraft", aircraft(size), 17.0) for size in sizes]
    bodies += [("sphere", sphere(level), 2.2) for level in levels]
    rows = table(bodies, pixels, loose, chosen.repeat, not chosen.no_peers)
    run.table(rows, digits=None)
    run.chart(chart(rows), dpi=75)
    size = min((row["faces"] for row in rows), key=lambda faces: abs(faces - 10_000))
    mine = [row for row in rows if row["tracer"] == "jaxir" and row["body"] == "aircraft" and row["faces"] == size]
    mine = mine or [row for row in rows if row["tracer"] == "jaxir" and row["faces"] == size]
    said = ", ".join(
        f"{row['question']} {row['Mrays/s']:.3g}" + (f" ({row['of Embree']:.2g} x Embree)" if row["of Embree"] else "")
        for row in mine
    )
    return (
        f"{size} faces [Mrays/s]: {said}; two cores {one / two:.2g} x one; "
        f"{count:.0f} faces and {rays:.0f} rays add {added / 1e9:.2f} GB; {jaxir.compiler_options()}"
    )


if __name__ == "__main__":
    study(main, options)
