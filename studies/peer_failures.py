"""Where do jaxir, Mitsuba, Embree and the plain formula fail in single precision?

Each case has a known answer. Peers that are not installed (extra `peers`) leave no rows.

- A camera far away: two plates, radiances 1 and 3, the second 1 cm in front of half of the first, in 64 x 64 pixels
  that span 2 m at every range. Root mean square of pixel / truth - 1. Who puts the eye at its true place loses the
  step and then the plates; a bundle of rays relative to its target does not.
- Thin emission and thick transmission: a homogeneous gas 1 m deep. Relative error of 1 - exp(-depth) and exp(-depth).
  The plain formula is the one that codes of transmittances use. Mitsuba's media do not emit; by Kirchhoff's law a gas
  of one temperature emits what it takes from an environment of radiance 1 (`volpath`, its random error included).
- Seams: rays at edges and vertices of a sphere (`studies.ray_agreement`) whose centre lies away from the origin of its
  coordinates. Share of the rays that must meet it and miss.
- Slivers: 2000 needles side by side; rays at the middle of each, steep and slanting. Share of the rays that double
  precision says must meet one and miss.
"""

import argparse
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

import jaxir
from jaxir.geometry import Rays
from jaxir.geometry.search import closest_hit
from studies import mitsuba_peer
from studies._study import Run, study, subplots
from studies.ray_agreement import every_face, needles, seams
from studies.ray_throughput import embree, sphere

PIXELS, WIDTH, STEP = 64, 2.0, 0.01  # of the frame [m], and between the plates [m]
RANGES = 10.0 ** np.arange(1, 8)
DEPTHS = np.append(10.0 ** np.arange(-8, 2), 30.0)
PLACES = 10.0 ** np.arange(0, 5)
NEEDLES, SLIMNESS = 2000, 10.0 ** -np.arange(3.0, 9.0)
BAND = jaxir.Band("10 um", 9.9, 10.1)
SQUARE = np.array([[0.0, -2, -2], [0, 2, -2], [0, 2, 2], [0, -2, 2]])
Found = Iterator[tuple[str, float, str, float]]  # case, its parameter, code, error


def plates() -> tuple[np.ndarray, np.ndarray]:
    """Corners [8, 3] [m] and faces of both plates, which look along +x; the second has faces 2 and 3."""
    front = SQUARE * [1, 0.5, 1] + [STEP, 1, 0]
    return np.concatenate([SQUARE, front]), np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])


def seen_by_jaxir(distance: float) -> np.ndarray:
    """Radiance of the pixels in units of the first plate's."""
    dark = 300.0
    one = jaxir.band_radiance(dark, BAND)
    bright = float(jaxir.brightness_temperature(3 * one, BAND)[0])
    corners, faces = plates()
    skin = jaxir.Skin(jaxir.Mesh(corners, faces), np.array([dark, dark, bright, bright]), jaxir.Lambert(1.0))
    camera = jaxir.perspective_camera(0.0, 0.0, distance, WIDTH / PIXELS / distance, (PIXELS, PIXELS))
    image = jaxir.render(jaxir.Scene(skin), camera, jaxir.gray_nodes(BAND), samples=4)
    return np.asarray(image.radiance)[..., 0] / float(one[0])


def seen_by_mitsuba(mi: Any, distance: float) -> np.ndarray:
    """As `seen_by_jaxir`."""
    corners, faces = plates()
    black = {"type": "diffuse", "reflectance": 0.0}
    shapes = {
        f"plate{radiance:.0f}": mitsuba_peer.mesh(mi, corners, rows, black, {"type": "area", "radiance": radiance})
        for radiance, rows in ((1.0, faces[:2]), (3.0, faces[2:]))
    }
    side = mi.ScalarTransform4f().look_at(origin=[distance, 0, 0], target=[0, 0, 0], up=[0, 0, 1])
    angle = 2 * np.rad2deg(np.arctan(WIDTH / 2 / distance))
    sensor = {"type": "perspective", "to_world": side, "fov": float(angle), "near_clip": 0.1, "far_clip": 1e8}
    film = {"type": "hdrfilm", "width": PIXELS, "height": PIXELS, "pixel_format": "luminance"}
    sensor |= {"film": film | {"rfilter": {"type": "box"}}, "sampler": {"type": "independent", "sample_count": 16}}
    scene = {"type": "scene", "integrator": {"type": "path", "max_depth": 2}, "sensor": sensor, **shapes}
    return np.asarray(mi.render(mi.load_dict(scene), spp=16))[:, :, 0]


def far(mi: Any) -> Found:
    """The two plates from far away."""
    codes: dict[str, Callable[[float], np.ndarray]] = {"jaxir": seen_by_jaxir}
    if mi is not None:
        codes["Mitsuba"] = lambda distance: seen_by_mitsuba(mi, distance)
    right = np.asarray(jaxir.orthographic_camera(0.0, 0.0, 1.0, (1, 1)).frame)[0, 1]  # +y in the image
    true = np.where((np.arange(PIXELS) < PIXELS / 2) == (right < 0), 3.0, 1.0)
    for distance in RANGES:
        for code, run in codes.items():
            error = np.sqrt(np.mean((run(distance) / true - 1) ** 2))
            yield "camera far away", distance, code, float(error)


def gas_of_jaxir(depth: float) -> tuple[float, float]:
    """Emission in units of a blackbody's, and transmission, of a cube of gas seen along its middle."""
    kelvin = 1000.0
    black = float(jaxir.band_radiance(kelvin, BAND)[0])
    camera = jaxir.orthographic_camera(0.0, 0.0, 0.1, (1, 1))
    grid = jaxir.Grid((-0.5, -0.5, -0.5), (1.0, 1.0, 1.0), (1, 1, 1))

    def seen(temperature: float, behind: float) -> float:
        plume = jaxir.GridPlume(grid, temperature, jaxir.GrayGas(depth))
        scene = jaxir.Scene(plumes=plume, background=jaxir.UniformBackground(behind))
        image = jaxir.render(scene, camera, jaxir.gray_nodes(BAND), samples=4)
        return float(image.radiance[0, 0, 0])

    return seen(kelvin, 0.0) / black, seen(3.0, 1.0)


def gas_of_mitsuba(mi: Any, depth: float, count: int) -> tuple[float, float]:
    """As `gas_of_jaxir`, from `count` paths."""
    medium = {"type": "homogeneous", "albedo": 0.0, "sigma_t": depth}
    side = mi.ScalarTransform4f()
    view = side.look_at(origin=[2, 0, 0], target=[0, 0, 0], up=[0, 0, 1]) @ side.scale([0.05, 0.05, 1])
    film = {"type": "hdrfilm", "width": 1, "height": 1, "pixel_format": "luminance", "rfilter": {"type": "box"}}
    scene = {
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": 8},
        "sensor": {"type": "orthographic", "to_world": view, "film": film, "sampler": {"type": "independent"}},
        "gas": {"type": "cube", "to_world": side.scale([0.5] * 3), "bsdf": {"type": "null"}, "interior": medium},
        "sky": {"type": "constant", "radiance": 1.0},
    }
    passed = float(np.asarray(mi.render(mi.load_dict(scene), spp=count))[0, 0, 0])
    return 1 - passed, passed


def gases(mi: Any, count: int) -> Found:
    """Thin and thick gas."""
    for depth in DEPTHS:
        emitted, passed = -np.expm1(-depth), np.exp(-depth)
        through = np.exp(-np.float32(depth))
        found = {"jaxir": gas_of_jaxir(depth), "plain formula": (float(1 - through), float(through))}
        if mi is not None:
            found["Mitsuba"] = gas_of_mitsuba(mi, depth, count)
        for code, (emission, transmission) in found.items():
            yield "thin emission", depth, code, abs(emission / emitted - 1)
            if depth > 0.05:
                yield "thick transmission", depth, code, abs(transmission / passed - 1)


def searches(vertices: np.ndarray, faces: np.ndarray, mi: Any) -> dict[str, Callable[[Rays], np.ndarray]]:
    """By code, whether rays meet a mesh."""
    mesh = jaxir.Mesh(vertices, faces)
    raw = embree(np.asarray(mesh.vertices)[faces])

    def both(rays: Rays) -> tuple[np.ndarray, np.ndarray]:
        return np.asarray(rays.origin), np.asarray(rays.direction)

    codes: dict[str, Callable[[Rays], np.ndarray]] = {
        "jaxir": lambda rays: np.asarray(closest_hit(mesh, rays).face) >= 0
    }
    if raw is not None:
        codes["Embree"] = lambda rays: np.asarray(raw(*both(rays), "INTERSECT")) >= 0
    if mi is not None:
        scene = mi.load_dict({"type": "scene", "mesh": mitsuba_peer.mesh(mi, vertices, faces, {"type": "diffuse"})})

        def run(rays: Rays) -> np.ndarray:
            origin, direction = both(rays)
            return np.asarray(scene.ray_test(mi.Ray3f(mi.Point3f(origin.T), mi.Vector3f(direction.T))))

        codes["Mitsuba"] = run
    return codes


def seam_losses(mi: Any, count: int) -> Found:
    """A sphere whose edges and vertices are aimed at."""
    rng = np.random.default_rng(0)
    vertices, faces = sphere(4)
    for place in PLACES:
        body = np.asarray(vertices + place * np.array([1.0, 0.7, 0.4]), np.float32)
        at = seams(body.astype(np.float64), faces, count, rng)
        normal = at.normals[:, 0]
        side = np.cross(normal, rng.normal(size=normal.shape))
        cosine = np.exp(rng.uniform(np.log(1e-2), 0, (count, 1)))
        towards = cosine * normal + np.sqrt(1 - cosine**2) * side / np.linalg.norm(side, axis=1, keepdims=True)
        rays = Rays(jnp.asarray(at.point + 2.5 * towards, jnp.float32), jnp.asarray(-towards, jnp.float32))
        sure = at.clear(towards, 2.5 + 2 * place)
        for code, met in searches(body, faces, mi).items():
            yield "seams", place, code, float(np.mean(~met(rays)[sure]))


def sliver_losses(mi: Any) -> Found:
    """Needles whose middles are aimed at."""
    for slim in SLIMNESS:
        vertices, faces = needles(NEEDLES, slim)
        corners = np.asarray(vertices, np.float32).astype(np.float64)[faces]
        along = np.repeat([[0.0, 0, -1], [0.6, 0, -0.8]], NEEDLES, axis=0).astype(np.float32)
        start = (np.tile(corners.mean(axis=1), (2, 1)) - 2 * along).astype(np.float32)
        sure = np.array([every_face(corners, *ray)[0] for ray in zip(*map(np.float64, (start, along)), strict=True)])
        rays = Rays(jnp.asarray(start), jnp.asarray(along))
        for code, met in searches(vertices, faces, mi).items():
            yield "slivers", slim, code, float(np.mean(~met(rays)[sure]))


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--paths", type=int, default=2**20, help="of Mitsuba through the gas (%(default)s)")
    parser.add_argument("--seams", type=int, default=200_000, help="rays at edges and vertices (%(default)s)")


def main(run: Run) -> str:
    from matplotlib.lines import Line2D

    warnings.simplefilter("ignore", jaxir.PlausibilityWarning)  # gas of 3 K and cameras 10,000 km away are the point
    chosen, loaded = run.options, mitsuba_peer.load()
    mi = None if loaded is None else loaded[0]
    cases = (far(mi), gases(mi, chosen.paths), seam_losses(mi, chosen.seams), sliver_losses(mi))
    found = [row for case in cases for row in tqdm(case, leave=False)]
    rows = [dict(zip(("case", "parameter", "code", "error"), row, strict=True)) for row in found]
    run.table(rows)
    labels = {
        "camera far away": "range [m]",
        "thin emission": "optical depth",
        "thick transmission": "optical depth",
        "seams": "centre's distance / radius",
        "slivers": "width / length",
    }
    codes = list(dict.fromkeys(row["code"] for row in rows))
    figure, axes = subplots(1, len(labels), figsize=(16, 3.4), sharey=True)
    said = []
    for axis, (case, label) in zip(axes, labels.items(), strict=True):
        worst = {}
        for colour, code in enumerate(codes):
            own = [(row["parameter"], row["error"]) for row in rows if (row["case"], row["code"]) == (case, code)]
            if own:
                axis.loglog(*np.maximum(np.array(own).T, 1e-9), "o-", ms=4, color=f"C{colour}")
                worst[code] = max(error for _, error in own)
        axis.set(xlabel=label, title=case, ylim=(5e-10, 1e2))
        axis.axhline(1e-9, color="0.6", lw=0.8, zorder=0)
        said.append(f"{case}: " + ", ".join(f"{code} {error:.2g}" for code, error in worst.items()))
    axes[0].set_ylabel("error or share lost\n(at the line: below 1e-9)")
    figure.legend([Line2D([], [], color=f"C{colour}") for colour in range(len(codes))], codes, loc="outside right")
    run.chart(figure, dpi=80)
    return f"worst errors and shares lost, {'; '.join(said)}"


if __name__ == "__main__":
    study(main, options)
