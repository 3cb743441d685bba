"""Is the error that a budget tells the error that is found? From skin alone to a jet with particles through air.

Every scene is computed as a user might, with few rays and the default method, for several random keys. Found is the
root mean square of the differences from a reference: the finest nodes, bounces and orders until nothing is left, a
frame that holds all, four times as many panels in a jet, many rays. Told is the total of `error_budget()`, mean over
the keys.
"""

import argparse
import dataclasses
import math
from collections.abc import Iterator
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from tqdm import tqdm

import jaxir
from jaxir import plot
from jaxir.io.scene_file import load_scene
from studies._study import HERE, Run, study, subplots

BANDS = (jaxir.MWIR, jaxir.LWIR)
FINEST = (50.0, 12, 8)
NOISE = 3.0  # standard errors of the reference from which on a difference is found
GRAIN = 3e-6  # of float32, in the intensity
PARTS = ("sampling", "spectral", "quadrature", "truncation", "bounces", "outside")
DRAWN = (
    "corner, .5, one bounce",
    "corner, disc",
    "cloud 1, sun, 2 orders",
    "jet through 2 km",
    "body and jet, air",
    "cut jet",
)


class Case(NamedTuple):
    """One computation: what of, whence, how finely, and how."""

    name: str
    scene: jaxir.Scene
    aspect: tuple[float, float] = (40.0, 25.0)
    shape: tuple[int, int] = (24, 24)
    camera: jaxir.Camera | None = None  # None: one that holds the scene
    nodes: object = BANDS
    method: jaxir.Method = jaxir.Method()
    samples: int = 2
    table: bool = False  # a signature of one view instead of an image
    reference: tuple[int, int] = (128, 4)  # pixels along a side, rays in each


def boxes(*parts):
    """A mesh of closed boxes, (size, centre) each."""
    unit = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)]) - 0.5
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    vertices = [unit * np.array(size) + np.array(centre) for size, centre in parts]
    return jaxir.Mesh(np.concatenate(vertices), np.concatenate([faces + 8 * k for k in range(len(parts))]))


BOX = boxes(((2.0, 0.8, 0.6), (0.0, 0.0, 0.0)))
BODY = boxes(((2.0, 0.8, 0.6), (0.0, 0.0, 0.0)), ((0.6, 0.1, 0.8), (-0.6, 0.0, 0.8)))  # with a fin
CORNER = jaxir.Mesh(
    [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, 0, 1], [0, 1, 1]],
    [[0, 1, 4], [0, 4, 2], [0, 2, 6], [0, 6, 3], [0, 3, 5], [0, 5, 1]],
)
GRID = jaxir.Grid((-3.5, -0.4, -0.4), (0.25, 0.2, 0.2), (10, 4, 4))
SUN = jaxir.ParallelSource((-0.6, -0.64, -0.48), 20.0)
DISC = jaxir.DiscSource((3.0, 2.0, 2.0), (-0.710669, -0.497468, -0.497468), 0.5, 200.0)
LAMP = jaxir.SphereSource((3.0, 3.0, 1.0), 0.4, 300.0)
SKY = jaxir.UniformBackground(12.0)
HOT_GAS = jaxir.NarrowBandGas(pressure=101325.0, h2o=0.1, co2=0.1)


def skin(mesh, emissivity, hot=300.0):
    """Skin at 300 K but for its last two faces."""
    temperature = np.full(mesh.count, 300.0)
    temperature[-2:] = hot
    return jaxir.Skin(mesh, temperature, jaxir.Lambert(emissivity))


def plume(absorption, hot=1200.0, particles=None, gas=None):
    x = GRID.centres()[..., 0]
    return jaxir.GridPlume(GRID, hot + 150.0 * x, jaxir.GrayGas(absorption) if gas is None else gas, particles)


def jet(hot=900.0, particles=None):
    exhaust = jaxir.NarrowBandGas(pressure=101325.0, h2o=0.12, co2=0.11)
    return jaxir.JetPlume(
        (-1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), 0.4, hot, 288.0, exhaust, length=20.0, particles=particles
    )


def gray_jet(depth):
    """A jet of an optical depth across the nozzle."""
    return jaxir.JetPlume((-1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), 0.4, 1000.0, 288.0, jaxir.GrayGas(depth / 0.4))


def soot(depth, albedo):
    """Particles of an optical depth across the plume's .8 m."""
    return jaxir.GrayParticles(depth / 0.8, albedo, jaxir.HenyeyGreenstein(0.5))


def air(distance):
    return jaxir.StandardAtmosphere(1000.0, 1000.0, distance)


def cut(scene, share, aspect=(90.0, 0.0), shape=(24, 64)):
    """A camera that leaves out the tail of the scene beyond a share of its length."""
    extent = np.asarray(scene.extent(), np.float64)
    low, high = extent.min(axis=0), extent.max(axis=0)
    length, height = (high[0] - low[0]) * 1.02, (high[2] - low[2]) * 1.3
    middle = np.array([high[0] - share * length / 2, 0.0, (high[2] + low[2]) / 2])
    return jaxir.orthographic_camera(*aspect, (share * length / shape[1], height / shape[0]), shape, tuple(middle))


def cases() -> Iterator[Case]:
    """Neighbours share compiled programs."""
    Scene, Method = jaxir.Scene, jaxir.Method
    yield Case("box, few rays", Scene(skin(BOX, 0.8)), shape=(8, 8))
    yield Case("box, hot end", Scene(skin(BOX, 0.8, 500.0)), (160.0, 10.0), samples=8)
    yield Case("box, table", Scene(skin(BOX, 0.8, 500.0)), (200.0, -15.0), (16, 16), table=True)
    for emissivity in (0.9, 0.6, 0.2):
        yield Case(f"corner, {emissivity}", Scene(skin(CORNER, emissivity)))
    yield Case("corner, .6, hot wall", Scene(skin(CORNER, 0.6, 500.0)))
    yield Case("corner, .5, one bounce", Scene(skin(CORNER, 0.5, 400.0)), method=Method(bounces=1), samples=32)
    yield Case("corner, .2, three bounces", Scene(skin(CORNER, 0.2, 400.0)), method=Method(bounces=3), samples=32)
    yield Case("body and fin", Scene(skin(BODY, 0.8, 450.0)), samples=8)
    yield Case("body and bright fin", Scene(skin(BODY, 0.3, 600.0)), (-60.0, 40.0), table=True)
    yield Case("box, sun", Scene(skin(BOX, 0.8), sources=(SUN,)))
    yield Case("corner, sun", Scene(skin(CORNER, 0.5), sources=(SUN,)))
    yield Case("box, disc", Scene(skin(BOX, 0.6), sources=(DISC,)), samples=8)
    yield Case("corner, disc", Scene(skin(CORNER, 0.6), sources=(DISC,)), samples=8)
    yield Case("box, lamp", Scene(skin(BOX, 0.6), sources=(LAMP,)), samples=8)
    yield Case("box, sky", Scene(skin(BOX, 0.6), background=SKY), samples=8)
    yield Case("corner, sky", Scene(skin(CORNER, 0.6), background=SKY), samples=8)
    for absorption, said in ((0.01, "thin"), (1.0, "gray"), (30.0, "thick")):
        yield Case(f"{said} plume", Scene(plumes=plume(absorption)))
    yield Case("cut plume", Scene(plumes=plume(1.0)), (90.0, 0.0), camera=cut(Scene(plumes=plume(1.0)), 0.6))
    yield Case("two plumes", Scene(plumes=(plume(1.0), plume(0.3, 1500.0))))
    yield Case("box and plume", Scene(skin(BOX, 0.3), plume(3.0)), (140.0, 20.0))
    yield Case("body and plume", Scene(skin(BODY, 0.3), plume(3.0)), (20.0, 40.0))
    yield Case("body and plume, sun", Scene(skin(BODY, 0.5), plume(1.0), (SUN,)), (110.0, 30.0))
    whole = Scene(skin(BOX, 0.8, 500.0))
    yield Case("cut box", whole, (90.0, 0.0), camera=cut(whole, 0.7))
    whole = Scene(skin(BODY, 0.8), plume(1.0))
    yield Case("cut body and plume", whole, (90.0, 0.0), camera=cut(whole, 0.75))
    whole = Scene(skin(BOX, 0.8), plume(1.0), background=jaxir.BlackbodyBackground(300.0))
    yield Case("as warm a sky, plume cut off", whole, (90.0, 0.0), camera=cut(whole, 0.5))
    for depth, albedo, orders in ((1.0, 0.8, 10), (1.0, 0.8, 2), (4.0, 0.9, 4)):
        cloud = Scene(plumes=plume(0.05, 800.0, soot(depth, albedo)), sources=(SUN,))
        name = f"cloud {depth:g}, sun, {orders} orders"
        yield Case(name, cloud, method=Method(orders=orders), samples=8, reference=(64, 16))
    cloud = Scene(plumes=plume(0.05, 900.0, soot(2.0, 0.9)), background=SKY)
    yield Case("cloud, sky", cloud, samples=8, reference=(64, 16))
    cloud = Scene(skin(BOX, 0.5), plume(0.05, 800.0, soot(1.0, 0.7)))
    yield Case("box and cloud", cloud, (120.0, 10.0), samples=8, reference=(64, 16))
    few = {"shape": (16, 16), "samples": 16, "reference": (48, 8)}
    for name, scene in (
        ("hot slab", Scene(plumes=plume(0, 1200.0, gas=HOT_GAS))),
        ("warm slab", Scene(plumes=plume(0, 900.0, gas=HOT_GAS))),
    ):
        yield Case(name, scene, **few)
    yield Case("slab, gray nodes", scene, nodes=jaxir.gray_nodes(BANDS), **few)
    yield Case("slab, given nodes", scene, nodes=jaxir.resolved_nodes(BANDS, 200.0, 4, 3), **few)
    yield Case("slab through 5 km", Scene(plumes=plume(0, 1200.0, gas=HOT_GAS), atmosphere=air(5e3)), **few)
    yield Case("jet", Scene(plumes=jet()), (90.0, 0.0), **few)
    yield Case("jet from behind", Scene(plumes=jet(1500.0)), (170.0, 5.0), **few)
    for km in (2, 20):
        yield Case(f"jet through {km} km", Scene(plumes=jet(), atmosphere=air(1e3 * km)), (120.0, 10.0), **few)
    for depth in (3.0, 30.0):
        thick = Scene(plumes=gray_jet(depth))
        yield Case(f"gray jet {depth:g}, tail-on", thick, (179.0, 0.0), samples=32, reference=(96, 8))
        yield Case(f"gray jet {depth:g}, head-on", thick, (2.0, 0.0), samples=32, reference=(96, 8))
    yield Case("cut jet", Scene(plumes=jet()), (90.0, 0.0), camera=cut(Scene(plumes=jet()), 0.5, shape=(16, 32)), **few)
    yield Case("box through 5 km", Scene(skin(BOX, 0.9, 500.0), atmosphere=air(5e3)))
    yield Case("body and jet, air", Scene(skin(BODY, 0.6, 600.0), jet(), atmosphere=air(3e3)), (130.0, 20.0), **few)
    sooty = Scene(plumes=jet(900.0, jaxir.GrayParticles(0.1, 0.6, jaxir.HenyeyGreenstein(0.5))), atmosphere=air(2e3))
    yield Case(
        "jet with soot, air", sooty, (100.0, 10.0), (16, 16), samples=8, method=Method(orders=3), reference=(24, 8)
    )
    triangle = jaxir.sensor_band("triangle", [3.0, 4.0, 5.0], [0.0, 1.0, 0.0])
    yield Case("box, response", Scene(skin(BOX, 0.8, 500.0)), nodes=(triangle, jaxir.LWIR))
    examples = HERE.parent / "examples"
    for name, rays in (("box", (256, 4)), ("aircraft", (96, 2))):
        read = load_scene(examples / f"{name}.toml")
        camera = next(iter(read.cameras.values()))
        yield Case(f"{name}.toml", read.scene, camera=camera, nodes=read.bands, reference=rays)


def eye(case, wide=False):
    """The camera of a case, or the one of its reference, which holds the scene."""
    camera = case.camera or jaxir.fitted_camera(*case.aspect, case.scene.extent(), case.shape)
    if not wide:
        return camera
    half = np.abs(np.asarray(camera.project(case.scene.extent()), np.float64)).max(axis=0) * 1.01
    side = case.reference[0]
    return dataclasses.replace(camera, pixel=jax.numpy.asarray(2 * half / side, camera.pixel.dtype), shape=(side, side))


def reference(case):
    """The intensity and its standard error [band]."""
    scene = case.scene
    jets = [place for place, one in enumerate(scene.plumes) if isinstance(one, jaxir.JetPlume)]
    for place in jets:
        finer = scene.plumes[place].with_panels(4 * scene.plumes[place].panels)
        scene = eqx.tree_at(lambda s, place=place: s.plumes[place], scene, finer)
    lit_by_skin = scene.skin is not None and (scene.plumes or scene.skin.mesh is not BOX)
    further = {"bounces": 4 if jets else 10, "orders": 10 if jets else 30}
    sampled = dataclasses.replace(case.method, **further) if lit_by_skin or scene.scatters else case.method
    spectral = scene.has_spectrum or any(band.response for band in _bands(case))
    nodes = jaxir.resolved_nodes(_bands(case), *FINEST) if spectral else _bands(case)
    image = jaxir.render(
        scene, eye(case, wide=True), nodes, samples=case.reference[1], method=sampled, key=jax.random.key(999)
    )
    return np.asarray(image.radiant_intensity(), np.float64), np.asarray(image.intensity_error(), np.float64)


def _bands(case):
    return BANDS if isinstance(case.nodes, jaxir.Nodes) else tuple(case.nodes)


def told(case, key):
    """Intensity and budget of one computation."""
    own = {"samples": case.samples, "method": case.method, "key": jax.random.key(key)}
    if case.table:
        result = jaxir.signature(case.scene, [case.aspect], case.nodes, shape=case.shape, **own)
    else:
        result = jaxir.render(case.scene, eye(case), case.nodes, **own)
    return result.error_budget()


def compare(case, keys):
    """A row for each band, and a budget; `keys` are random keys."""
    true, noise = reference(case)
    budgets = [told(case, key) for key in keys]
    values = {
        name: np.array([np.reshape(np.asarray(getattr(one, name), np.float64), true.shape) for one in budgets])
        for name in ("intensity", "total", *PARTS)
        if getattr(budgets[0], name) is not None
    }
    square = np.mean((values["intensity"] - true) ** 2, axis=0) - noise**2  # that of the reference is in each of them
    found = np.sqrt(np.maximum(square, 0))
    limit = NOISE * noise + GRAIN * np.abs(true)
    for band, name in enumerate(budgets[0].bands):
        row = {"scene": case.name, "band": name, "intensity": true[band], "noise": limit[band], "found": found[band]}
        row["told"] = float(np.mean(values["total"][:, band]))
        for part in PARTS:
            row[part] = float(np.mean(values[part][:, band])) if part in values else "not known"
        row["is_found"] = int(found[band] > limit[band])
        row["covered"] = int(row["told"] >= found[band] - (0 if row["is_found"] else limit[band]))
        row["told_over_found"] = row["told"] / found[band] if found[band] > 0 else math.nan
        yield row, budgets[0]


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--keys", type=int, default=3, help="random keys of each scene (%(default)s)")
    parser.add_argument("--quick", action="store_true", help="every fourth scene alone")


def main(run: Run) -> str:
    count = run.options.keys
    chosen = list(enumerate(cases()))[:: 4 if run.options.quick else 1]
    rows, drawn = [], {}
    for number, case in tqdm(chosen):
        for row, budget in compare(case, range(count * number, count * (number + 1))):
            rows.append(row)
            drawn.update({case.name: budget} if case.name in DRAWN else {})
        run.table(rows)  # a run that is killed keeps its rows
        if len(rows) % 20 == 0:
            jax.clear_caches()  # hundreds of compiled programs would exhaust what one process may map
    return report(run, rows, drawn)


def report(run: Run, rows: list[dict], drawn: dict[str, jaxir.ErrorBudget]) -> str:
    """Charts and answer."""
    seen = [row for row in rows if row["is_found"]]
    ratio = np.array([row["told_over_found"] for row in seen])
    covered = np.mean([row["covered"] for row in rows])
    figure, axis = subplots(figsize=(5.5, 5))
    for band in dict.fromkeys(row["band"] for row in seen):
        own = [row for row in seen if row["band"] == band]
        share = np.array([[row["found"], row["told"]] for row in own]) / np.array([[row["intensity"]] for row in own])
        axis.plot(*np.abs(share).T, "o", ms=4, label=band)
    ends = np.array(axis.get_xlim())
    axis.plot(ends, ends, "0.4", lw=1, label="equal")
    axis.plot(ends, 3 * ends, "0.4", lw=1, ls="--", label="three times")
    axis.set(xscale="log", yscale="log", xlabel="error found / intensity", ylabel="error told / intensity")
    axis.legend()
    run.chart(figure, dpi=110)
    if drawn:
        run.chart(plot.error_bars(drawn), f"{run.name}_parts", dpi=110)
    low, middle, high = np.quantile(ratio, (0.1, 0.5, 0.9))
    return (
        f"told is at least found in {100 * covered:.0f} % of {len(rows)} scene-bands, and {middle:.2f} times it in the "
        f"median of {len(seen)} where it is found ({low:.2f} to {high:.2f} for 80 %)"
    )


if __name__ == "__main__":
    study(main, options)
