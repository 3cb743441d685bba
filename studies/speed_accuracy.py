"""What error does each way to compute the paper's experiments reach in what time, beside peers in the same run?

Six experiments of Yu et al. (10.3788/IRLA20200241): the emitting plate, the plate under a disc, a thick and a thin
box, the ramp medium, and an aircraft in the sun on 256, 512 and 1000 pixels a side. Each method at rising numbers of
rays, or at falling tolerances, gives a front of relative error against CPU seconds: medians of interleaved rounds on
one core, compilation apart, and as hollow marks the seconds to the first image, compilation included (with
JAXIR_CACHE=0: else programs of an earlier run are read). The error is the root mean square over pixels of the relative
error; of the aircraft that of all pixels that see it, in terms of their mean, as `pixel_rtol` asks for it; of the plate
that of its intensity.

Peers: Mitsuba 3 where it can do the case (it has no emission in media: an exact walk written in Dr.Jit stands for it in
the ramp), Embree with NumPy about it, scalar native code (numba) and NumPy in double precision.
"""

import argparse
import functools
import os
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

import jaxir
from jaxir.geometry import Rays, pixel_samples, tile_rays, view_frame
from studies import mitsuba_peer
from studies._study import Run, judge, study, subplots
from studies.aircraft import generic_aircraft
from studies.march_speed import native_walk
from studies.ray_throughput import embree

BAND = jaxir.MWIR
GIVEN = "jaxir, exact sum, optics given"  # as the walks of the peers, which take extinction and emission of each cell
ESTIMATORS = {
    "point": jaxir.PointIntegration(),
    "line": jaxir.LineIntegration(),
    "combined": jaxir.CombinedIntegration(),
}
SIDES = {256: 4050, 512: 1800, 1000: 882}  # pixels of the aircraft's images, and rays in each of their references
# Of each case the relative errors at which times are compared, and how many times faster than peers we mean to be.
GOALS: dict[str, dict[float, float]] = {
    "ramp": {1e-3: 0.9},
    "disc": {1e-2: 15.0},
    "aircraft 256": {1e-2: 1.0},
    "aircraft 512": {3e-3: 3.0, 1e-3: 5.0},
    "aircraft 1000": {3e-3: 3.0, 1e-3: 5.0},
}
EVEN = (2, 8, 18, 32, 72, 128, 288)  # rays per pixel
FEW = (2, 4, 8, 18, 32, 72)
SQUARES = (4, 16, 36, 64, 144, 256)  # which samplers of strata divide evenly
ASKED = (3e-2, 1e-2, 5e-3, 3e-3, 1e-3, 5e-4, 3e-4)


class Way(NamedTuple):
    """One method at one number of rays per pixel, or, where that is below 1, to one tolerance."""

    front: str
    rays: float
    run: Callable[[int], np.ndarray]
    error: Callable[[np.ndarray], float]


def rrmse(expected: np.ndarray, where: np.ndarray | slice = np.s_[:]) -> Callable[[np.ndarray], float]:
    def error(got: np.ndarray) -> float:
        got = np.asarray(got, np.float64)
        return float(np.sqrt(np.mean((got[where] / expected[where] - 1) ** 2)))

    return error


def share_of_mean(reference: jaxir.Image) -> Callable[[np.ndarray], float]:
    """Root mean square error of the pixels that see something in terms of their mean, less that of the reference."""
    expected, told = (np.asarray(x, np.float64)[..., 0] for x in (reference.radiance, reference.standard_error))
    seen = expected > 0
    mean, known = expected[seen].mean(), np.mean(told[seen] ** 2)

    def error(got: np.ndarray) -> float:
        square = np.mean((np.asarray(got, np.float64) - expected)[seen] ** 2)
        return float(np.sqrt(max(square - known, 0.0)) / mean)

    return error


def rendering(scene, camera, samples=None, method=None, **asked) -> Callable[[int], np.ndarray]:
    def run(seed: int) -> np.ndarray:
        image = jaxir.render(scene, camera, BAND, samples=samples, key=jax.random.key(seed), method=method, **asked)
        return np.asarray(image.radiance)[..., 0]

    return run


@eqx.filter_jit
def estimated(scene, camera, samples, estimator, key) -> jax.Array:
    """Image [row, column] of a plume: the radiance of each ray by an estimator, averaged over those of the pixel."""
    nodes, count = jaxir.gray_nodes((BAND,)), camera.tiles[0] * camera.tiles[1]
    of_rays, along = jax.random.split(key)
    places = pixel_samples(of_rays, count, samples)
    rays = tile_rays(camera, jnp.asarray(camera.tile_edges()), places, scene.start(camera))
    seen = nodes.in_band(jaxir.estimate(scene.on(nodes), jaxir.trace(scene, rays), estimator, along))
    return camera.untile(seen[:, 0].reshape(count, -1, samples).mean(axis=2))


def estimating(scene, camera, samples, estimator) -> Callable[[int], np.ndarray]:
    """As `rendering`, but each ray's radiance is one sample of an estimator."""
    return lambda seed: np.asarray(estimated(scene, camera, samples, estimator, jax.random.key(seed)))


def black(temperature: float) -> float:
    return float(jaxir.band_radiance(jnp.asarray(temperature), jaxir.gray_nodes((BAND,)))[0])


def square(temperature=400.0, emissivity=0.5) -> jaxir.Skin:
    corners = [[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]]
    return jaxir.Skin(jaxir.Mesh(corners, [[0, 1, 2], [0, 2, 3]]), temperature, jaxir.Lambert(emissivity))


def plate(peer) -> list[Way]:
    """An emitting plate seen at 40 degrees: relative error of its intensity."""
    scene, tilt, count = jaxir.Scene(square()), 50.0, 250
    camera = jaxir.orthographic_camera(0.0, tilt, 1.5 / count, (count, count))
    expected = 0.5 * black(400.0) * np.sin(np.deg2rad(tilt))

    def error(image: np.ndarray) -> float:
        total = float(np.sum(np.asarray(image, np.float64))) * ((1.5 / count) ** 2 if np.ndim(image) == 2 else 1.0)
        return abs(total / expected - 1)

    faces = jax.jit(lambda t: jaxir.unoccluded_intensity(jaxir.Scene(square(t)), 0.0, tilt, BAND))
    ways = [Way("jaxir, rays", n, rendering(scene, camera, n), error) for n in FEW]
    ways.append(Way("jaxir, sum over faces", 1, lambda seed: np.asarray(faces(400.0)), error))
    if peer:
        mi, dr = peer
        frame, glow = np.asarray(view_frame(0.0, tilt)), {"type": "area", "radiance": 0.5 * black(400.0)}
        for n in SQUARES:
            scene = {
                "type": "scene",
                "integrator": {"type": "direct"},
                "sensor": mitsuba_peer.sensor(mi, frame, np.zeros(3), 1.5, (count, count), "stratified", n),
                "plate": {
                    "type": "rectangle",
                    "to_world": mi.ScalarTransform4f().scale([0.5, 0.5, 1]),
                    "emitter": glow,
                },
            }
            ways.append(Way("Mitsuba, stratified", n, mitsuba_peer.renderer(mi, dr, scene, n), error))
    return ways


def disc(peer) -> list[Way]:
    """A plate of reflectance .5 under a disc of radius 1 m, 1.8 m above and 1.2 m aside both ways."""
    count, height, aside = 128, 1.8, 1.2
    lamp = jaxir.DiscSource([aside, aside, height], [0.0, 0.0, -1.0], 1.0, 100.0)
    scene = jaxir.Scene(square(3.0), sources=(lamp,))
    camera = jaxir.orthographic_camera(-90.0, 90.0, 1.0 / count, (count, count))
    place = ((np.arange(count * 8) + 0.5) / (count * 8)) - 0.5
    x, y = np.meshgrid(place, -place)
    a2 = (x - aside) ** 2 + (y - aside) ** 2
    factor = 0.5 * (1 - (a2 + height**2 - 1) / np.sqrt((a2 + height**2 + 1) ** 2 - 4 * a2))
    expected = 0.5 * 100.0 * factor.reshape(count, 8, count, 8).mean((1, 3))
    error = rrmse(expected)
    ways = []
    independent, sobol = jaxir.Independent(), jaxir.Sobol()
    few = (2, 4, 8, 16, 32, 64)
    tried = (
        ("jaxir, light, independent", lambda n: jaxir.DirectSampling(n, 0), independent, few),
        ("jaxir, light, Sobol", lambda n: jaxir.DirectSampling(n, 0), sobol, (4, 8, 16, 32, 64, 128)),
        ("jaxir, brdf, independent", lambda n: jaxir.DirectSampling(0, n), independent, few),
        (
            "jaxir, both, independent",
            lambda n: jaxir.DirectSampling(n // 2, n // 2),
            independent,
            (2, 4, 8, 16, 32, 64),
        ),
    )
    for name, sampling, sampler, counts in tried:
        for n in counts:
            method = jaxir.Method(sampling(n), sampler=sampler)
            ways.append(Way(name, 2 * n, rendering(scene, camera, 2, method), error))
    closed = jaxir.Method(jaxir.ClosedForm())
    ways += [Way("jaxir, closed form", n, rendering(scene, camera, n, closed), error) for n in FEW]
    if peer:
        mi, dr = peer
        frame = np.asarray(view_frame(-90.0, 90.0))
        transform = mi.ScalarTransform4f
        for sampler in ("independent", "stratified", "multijitter"):
            for n in SQUARES:
                world = {
                    "type": "scene",
                    "integrator": {"type": "direct", "hide_emitters": True},
                    "sensor": mitsuba_peer.sensor(mi, frame, np.zeros(3), 1.0, (count, count), sampler, n),
                    "plate": {
                        "type": "rectangle",
                        "to_world": transform().scale([0.5, 0.5, 1]),
                        "bsdf": {"type": "diffuse", "reflectance": 0.5},
                    },
                    "lamp": {
                        "type": "disk",
                        "to_world": transform().translate([aside, aside, height]).rotate([1, 0, 0], 180),
                        "emitter": {"type": "area", "radiance": 100.0},
                    },
                }
                ways.append(Way(f"Mitsuba, {sampler}", n, mitsuba_peer.renderer(mi, dr, world, n), error))
    return ways


def box(absorption: float, size, peer) -> list[Way]:
    """A homogeneous box of gas at 30 degrees, the image inside its outline."""
    grid = jaxir.Grid(-np.array(size) / 2, np.array(size) / 8, (8, 8, 8))
    scene = jaxir.Scene(plumes=jaxir.GridPlume(grid, 600.0, jaxir.GrayGas(absorption)))
    rows, columns, angle = 16, 128, np.deg2rad(30.0)
    pixel = 0.9 * size[2] / rows, 2.6 / columns
    camera = jaxir.orthographic_camera(30.0, 0.0, (pixel[1], pixel[0]), (rows, columns))

    def numpy_walk(points: int) -> np.ndarray:
        u = ((np.arange(columns * points) + 0.5) / points - columns / 2) * pixel[1]
        origin = u[:, None] * [-np.sin(angle), np.cos(angle)] + 9 * np.array([np.cos(angle), np.sin(angle)])
        toward = -np.array([np.cos(angle), np.sin(angle)])
        half = np.array(size[:2]) / 2
        edges = np.stack([(-half - origin) / toward, (half - origin) / toward])
        length = np.maximum(edges.max(0).min(-1) - edges.min(0).max(-1), 0)
        value = -black(600.0) * np.expm1(-absorption * length)
        return np.broadcast_to(value.reshape(columns, points).mean(-1), (rows, columns))

    expected = numpy_walk(512)
    error = rrmse(expected)
    ways = [Way("jaxir, exact sum", n, rendering(scene, camera, n), error) for n in FEW]
    for name, estimator in ESTIMATORS.items():
        ways += [Way(f"jaxir, {name}", n, estimating(scene, camera, n, estimator), error) for n in FEW]
    ways += [Way("NumPy, slab", n, lambda seed, n=n: numpy_walk(n), error) for n in (1, 2, 4, 8, 16, 32)]
    return ways


def thick(peer) -> list[Way]:
    return box(10.0, (2.0, 2.0, 2.0), peer)


def thin(peer) -> list[Way]:
    return box(0.01, (2.0, 2.0, 0.5), peer)


def ramp(peer) -> list[Way]:
    """The ramp medium broadside, 4 m wide: a column of 40 cells of 5 mm behind every pixel of 20 mm."""
    shape, rows, columns, side = (200, 16, 40), 16, 200, 0.02
    low, spacing = np.array([-2.0, -0.16, -0.1], np.float32), np.array([side, side, 0.005], np.float32)
    grid = jaxir.Grid(low, spacing, shape)
    absorption = np.broadcast_to((0.1 * side * (np.arange(columns) + 0.5))[:, None, None, None], (*shape, 1))
    scene = jaxir.Scene(
        plumes=jaxir.GridPlume(grid, 600.0, jaxir.GrayGas(np.ascontiguousarray(absorption, np.float32)))
    )
    camera = jaxir.orthographic_camera(-90.0, 90.0, side, (rows, columns))
    expected = np.broadcast_to(-black(600.0) * np.expm1(-0.2 * absorption[:, 0, 0, 0]), (rows, columns))
    error = rrmse(expected)
    x, y = np.meshgrid((np.arange(columns) + 0.5) * side - 2.0, (rows / 2 - np.arange(rows) - 0.5) * side)
    origin = np.stack([x.ravel(), y.ravel(), np.full(x.size, 1.0)], 1).astype(np.float32)
    direction = np.broadcast_to(np.array([0, 0, -1], np.float32), origin.shape).copy()
    origin, direction = np.repeat(origin, 2, 0), np.repeat(direction, 2, 0)  # two rays a pixel, as `render` takes
    rays, lit = Rays(jnp.asarray(origin), jnp.asarray(direction)), scene.on(jaxir.gray_nodes((BAND,)))
    given = eqx.filter_jit(lambda lit, rays: jaxir.evaluate(lit, jaxir.trace(lit.scene, rays))[:, 0])
    ways = [Way("jaxir, exact sum", 2, rendering(scene, camera, 2), error)]
    ways.append(Way(GIVEN, 2, lambda seed: np.asarray(given(lit, rays)).reshape(rows, columns, 2).mean(-1), error))
    for name, estimator in ESTIMATORS.items():
        ways += [Way(f"jaxir, {name}", n, estimating(scene, camera, n, estimator), error) for n in (2, 4, 6, 8, 16, 32)]
    extinction = np.ascontiguousarray(absorption[..., 0], np.float32)
    emission = extinction * np.float32(black(600.0))
    try:
        walk = native_walk()
    except ImportError:
        walk = None
    if walk:
        flat = extinction.ravel(), emission.ravel()

        def native(seed: int) -> np.ndarray:
            radiance = np.zeros(len(origin), np.float32)
            walk(low, spacing, np.array(shape), *flat, origin, direction, radiance)
            return radiance.reshape(rows, columns, 2).mean(-1)

        ways.append(Way("numba, exact walk", 2, native, error))
    if peer:
        run = mitsuba_peer.exact_walk(
            *peer, low.tolist(), spacing.tolist(), shape, extinction, emission, origin, direction
        )
        ways.append(Way("Dr.Jit, exact walk", 2, lambda s: run(s).reshape(rows, columns, 2).mean(-1), error))
    return ways


SUN, IRRADIANCE = (0.0, -0.6, -0.8), 20.0  # where its light travels, and W m-2


def aircraft_scene(emissivity=0.8):
    vertices, faces, _ = generic_aircraft()
    skin = jaxir.Skin(jaxir.Mesh(vertices, faces), 300.0, jaxir.Lambert(emissivity))
    return jaxir.Scene(skin, sources=(jaxir.ParallelSource(SUN, IRRADIANCE),)), vertices, faces


AIRCRAFT = (40.0, 30.0, 17.0)  # azimuth, elevation, width of the image [m]


def sight(side: int) -> jaxir.Camera:
    """The aircraft's camera of so many pixels a side."""
    azimuth, elevation, width = AIRCRAFT
    return jaxir.orthographic_camera(azimuth, elevation, width / side, (side, side))


def aircraft(side: int, peer) -> list[Way]:
    """The aircraft in the sun, one reflection, at one temperature: all pixels that see it."""
    azimuth, elevation, width = AIRCRAFT
    scene, vertices, faces = aircraft_scene()
    camera, glow = sight(side), 0.8 * black(300.0)
    error = share_of_mean(jaxir.render(scene, camera, BAND, samples=SIDES[side], key=jax.random.key(99)))
    ways = [Way("jaxir, even rays", n, rendering(scene, camera, n), error) for n in EVEN]
    once = jaxir.Method()
    ways += [
        Way("jaxir, to a tolerance", asked, rendering(scene, camera, method=once, pixel_rtol=asked), error)
        for asked in ASKED
    ]
    frame = np.asarray(view_frame(azimuth, elevation))
    search = embree(vertices[faces])
    if search:
        for n in SQUARES:
            ways.append(Way("Embree and NumPy, strata", n, embree_image(search, frame, side, n, glow), error))
    if peer:
        mi, dr = peer
        body = mitsuba_peer.mesh(
            mi,
            vertices,
            faces,
            {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 0.2}},
        )
        for n in (*SQUARES, 576):
            sensor = mitsuba_peer.sensor(mi, frame, np.zeros(3), width, (side, side), "multijitter", n)  # its best here
            sensor["film"]["pixel_format"] = "luminance_alpha"  # what its rays see of the body
            world = {
                "type": "scene",
                "integrator": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0},
                "sensor": sensor,
                "body": body,
                "sun": {"type": "directional", "direction": list(SUN), "irradiance": IRRADIANCE},
            }
            run = mitsuba_peer.renderer(mi, dr, world, n, channels=2)
            ways.append(Way("Mitsuba, multijitter", n, lambda s, run=run: run(s) @ [1.0, glow], error))
    return ways


def embree_image(search, frame, side, count, glow) -> Callable[[int], np.ndarray]:
    """The aircraft by closest hits and shadow rays of Embree, one ray in each of `count` squares of a pixel."""
    pixel, cells = np.float32(AIRCRAFT[2] / side), round(count**0.5)
    right, up, away = frame.astype(np.float32)
    to_sun = (-np.array(SUN) / np.linalg.norm(SUN)).astype(np.float32)
    toward = np.broadcast_to(-away, (side * side, 3)).copy()
    column, row = (x.ravel().astype(np.float32) for x in np.meshgrid(np.arange(side), np.arange(side)))

    def run(seed: int) -> np.ndarray:
        draw, total = np.random.default_rng(seed), np.zeros(side * side, np.float32)
        for place in np.ndindex(cells, cells):
            u, v = (draw.random((2, side * side), np.float32) + np.array(place, np.float32)[:, None]) / cells
            x, y = (column + u - side / 2) * pixel, (side / 2 - row - v) * pixel
            origin = x[:, None] * right + y[:, None] * up + 100 * away
            found = search(origin, toward, "INTERSECT", output=True)
            met = np.flatnonzero(found["primID"] >= 0)
            normal = found["Ng"][met]
            normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
            normal = np.where((normal @ away)[:, None] > 0, normal, -normal)
            cosine = normal @ to_sun
            lit = np.flatnonzero(cosine > 0)
            start = origin[met[lit]] - found["tfar"][met[lit], None] * away + 1e-4 * normal[lit]
            hidden = search(start, np.broadcast_to(to_sun, start.shape).copy(), "OCCLUDED") >= 0
            total[met] += glow
            total[met[lit]] += np.where(hidden, 0, 0.2 / np.pi * IRRADIANCE * cosine[lit])
        return (total / count).reshape(side, side)

    return run


CASES = {"plate": plate, "disc": disc, "thick": thick, "thin": thin, "ramp": ramp}
CASES |= {f"aircraft {side}": functools.partial(aircraft, side) for side in SIDES}


def measure(name: str, ways: list[Way], rounds: int) -> list[dict]:
    """One row per way."""
    first, errors, times = [], [[] for _ in ways], [[] for _ in ways]
    for way in tqdm(ways, desc=f"{name}: compile", leave=False):
        began = time.perf_counter()
        way.run(0)
        first.append(time.perf_counter() - began)
    for number in tqdm(range(1, rounds + 1), desc=name, leave=False):
        for place, way in enumerate(ways):
            began = time.process_time()
            image = way.run(number)
            times[place].append(time.process_time() - began)
            errors[place].append(way.error(image))
    return [
        {
            "case": name,
            "front": way.front,
            "rays": way.rays,
            "rrmse": float(np.median(error)),
            "seconds": float(np.median(spent)),
            "first_seconds": start,
        }
        for way, start, error, spent in zip(ways, first, errors, times, strict=True)
    ]


def seconds_at(points: list[dict], goal: float) -> float:
    """CPU seconds of a front at an error: by a power law between its points, and as errors^-2 beyond the last."""
    points = sorted(points, key=lambda row: row["seconds"])
    for before, row in zip([None, *points], points, strict=False):
        if row["rrmse"] <= goal:
            if before is None:
                return row["seconds"]
            at, found = np.log([goal, row["rrmse"]]), np.log([before["rrmse"], before["seconds"], row["seconds"]])
            return float(np.exp(found[1] + (found[2] - found[1]) * (at[0] - found[0]) / (at[1] - found[0])))
    last = min(points, key=lambda row: row["rrmse"])
    return last["seconds"] * (last["rrmse"] / goal) ** 2


def fastest(rows: list[dict], goal: float, front: Callable[[str], bool]) -> tuple[str, float] | None:
    """The front that reaches an error soonest, and its seconds."""
    names = [name for name in dict.fromkeys(row["front"] for row in rows) if front(name)]
    times = {name: seconds_at([row for row in rows if row["front"] == name], goal) for name in names}
    return min(times.items(), key=lambda pair: pair[1]) if times else None


def gradient_ratio(rounds: int) -> float:
    """Time of the gradient of a loss of the aircraft's image in all emissivities over that of the image."""
    scene, *_ = aircraft_scene()
    camera = sight(256)
    faces = jnp.full(scene.skin.mesh.count, 0.8)

    def image(emissivity):
        skin = jaxir.Skin(scene.skin.mesh, 300.0, jaxir.Lambert(emissivity))
        whole = jaxir.Scene(skin, sources=scene.sources)
        return jaxir.render(whole, camera, BAND, samples=8).radiance

    forward = jax.jit(image)
    backward = jax.jit(jax.value_and_grad(lambda e: jnp.sum(image(e) ** 2)))
    jax.block_until_ready((forward(faces), backward(faces)))
    ratios = []
    for _ in range(rounds):
        a = time.process_time()
        jax.block_until_ready(forward(faces))
        b = time.process_time()
        jax.block_until_ready(backward(faces))
        ratios.append((time.process_time() - b) / (b - a))
    return float(np.median(ratios))


def goals(rows: list[dict], rounds: int, cases: list[str]) -> list[str]:
    def sampled(front: str) -> bool:
        return front in [f"jaxir, {name}" for name in ESTIMATORS]

    def own(front: str) -> bool:
        return front.startswith("jaxir") and front != GIVEN

    asked = [
        ("ramp", sampled, lambda front: front == "jaxir, exact sum", 1e-3, 100.0, "the best sampled estimator"),
        ("ramp", lambda front: front.startswith("numba"), lambda front: front == GIVEN, 1e-3, 0.9, "a native walk"),
    ]
    for case, errors in GOALS.items():
        ours = (lambda front: front == GIVEN) if case == "ramp" else own
        for peer in ("Mitsuba", "Embree", "Dr.Jit"):
            asked += [(case, lambda f, p=peer: f.startswith(p), ours, *goal, peer) for goal in errors.items()]
    lines = []
    for case, theirs, mine, error, goal, label in asked:
        found = [row for row in rows if row["case"] == case]
        other, best = fastest(found, error, theirs), fastest(found, error, mine)
        if case in cases and other is not None and best is not None:
            what = f"{case} at {100 * error:g} %, time of {label} over jaxir's"
            ways = f" ({other[0]} {1e3 * other[1]:.2g} ms, {best[0]} {1e3 * best[1]:.2g} ms)"
            lines.append(judge(what, other[1] / best[1], goal) + ways)
    if "aircraft 256" in cases:
        lines.append(judge("aircraft, gradient in all emissivities over image", gradient_ratio(rounds), 3.0, False))
    return lines


def chart(rows: list[dict], cases: list[str]) -> Any:
    figure, axes = subplots(2, 4, figsize=(20, 9))
    for axis, case in zip(axes.ravel(), cases, strict=False):
        own = [row for row in rows if row["case"] == case]
        for front in dict.fromkeys(row["front"] for row in own):
            points = [row for row in own if row["front"] == front]
            style = "o-" if front.startswith("jaxir") else "s--"
            errors = [max(p["rrmse"], 1e-9) for p in points]
            (line,) = axis.loglog([p["seconds"] for p in points], errors, style, ms=4, label=front)
            first = [p["first_seconds"] for p in points]
            axis.loglog(first, errors, style[0], ms=4, mfc="none", alpha=0.5, color=line.get_color())
        for error in GOALS.get(case, ()):
            axis.axhline(error, color="0.7", lw=0.8)
        axis.set(title=case, xlabel="CPU seconds; hollow: to the first image", ylabel="relative error")
        axis.legend(fontsize=7)
    return figure


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--cases", default=",".join(CASES), help="some of %(default)s")
    parser.add_argument("--rounds", type=int, default=2)


def main(run: Run) -> str:
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})  # one core for all
    chosen = run.options
    cases, peer, rows = chosen.cases.split(","), mitsuba_peer.load(), []
    for case in cases:
        rows += measure(case, CASES[case](peer), chosen.rounds)
        run.table(rows)
    run.chart(chart(rows, cases), dpi=100)
    for row in rows:
        print(
            f"{row['case']:13s} {row['front']:32s} {row['rays']:7g} {100 * row['rrmse']:10.3g} % "
            f"{row['seconds']:8.3g} s, the first {row['first_seconds']:.2g} s"
        )
    return "; ".join(goals(rows, chosen.rounds, cases))


if __name__ == "__main__":
    study(main, options)
