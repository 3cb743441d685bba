"""How good is the plan's choice? Its time against the best choice by hand, over a grid of scenes."""

import dataclasses
import statistics
import time

import jax
import numpy as np
from tqdm import tqdm

import jaxir
from studies._study import Run, study, subplots

SAMPLES = (2, 4, 8, 18, 32, 72, 128, 288)
REPEATS = 5
WITHIN = 1.2  # times the best choice by hand, the goal
TOLERANCES = (1e-2, 2e-3, 7e-4)
PATHS = (3e-2, 1e-2)  # of scenes in which paths are sampled from scattering to scattering
WAYS = {
    "light": jaxir.Method(jaxir.DirectSampling(1, 0)),
    "mis": jaxir.Method(jaxir.DirectSampling(1, 1)),
    "light 16": jaxir.Method(jaxir.DirectSampling(16, 0), sampler=jaxir.Sobol()),
    "mis 8 + 8": jaxir.Method(jaxir.DirectSampling(8, 8), sampler=jaxir.Sobol()),
}


def box(size, centre):
    unit = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)]) - 0.5
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return jaxir.Mesh(unit * np.array(size) + np.array(centre), np.array(faces))


BODY = box((2.0, 0.8, 0.6), (1.0, 0.0, 0.0))
SQUARE = jaxir.Mesh([[0.0, -0.5, -0.5], [0.0, 0.5, -0.5], [0.0, 0.5, 0.5], [0.0, -0.5, 0.5]], [[0, 1, 2], [0, 2, 3]])
GRID = jaxir.Grid((-4.0, -0.5, -0.5), (0.25, 0.25, 0.25), (16, 4, 4))
SUN = jaxir.ParallelSource((-0.6, -0.8, 0.0), 20.0)


def plume(absorption):
    x = GRID.centres()[..., 0]
    return jaxir.GridPlume(GRID, 1200.0 + 150.0 * x, jaxir.GrayGas(absorption))


def skin(mesh, temperature, emissivity=0.7):
    return jaxir.Skin(mesh, temperature, jaxir.Lambert(emissivity))


def scenes():
    """Name, scene, ways to find reflected light, pixel [m]."""
    none = {"": None}
    wide, far = 0.075, 0.5  # the scene fills the image, or a few pixels
    for pixel, name in ((wide, "wide"), (far, "far")):
        yield f"skin, {name}", jaxir.Scene(skin(BODY, 320.0)), none, pixel
        yield f"skin, sun, {name}", jaxir.Scene(skin(BODY, 280.0), sources=(SUN,)), none, pixel
        for absorption in (1e-3, 0.3, 30.0):
            yield f"plume {absorption}, {name}", jaxir.Scene(plumes=plume(absorption)), none, pixel
        for absorption in (1e-3, 3.0):
            whole = jaxir.Scene(skin(BODY, 320.0), plume(absorption), (SUN,))
            yield f"skin, plume {absorption}, sun, {name}", whole, none, pixel
        soot = jaxir.GrayParticles(0.3, 0.6, jaxir.HenyeyGreenstein(0.5))
        sooty = jaxir.GridPlume(GRID, 1200.0, jaxir.GrayGas(0.05), soot)
        yield f"particles, sun, {name}", jaxir.Scene(plumes=sooty, sources=(SUN,)), none, pixel
    for radius, temperature in ((0.2, 3.0), (1.5, 3.0), (0.5, 300.0)):
        lamp = jaxir.SphereSource((4.0, 3.0, 0.0), radius, 100.0)
        yield f"lamp {radius}, {temperature} K", jaxir.Scene(skin(BODY, temperature), sources=(lamp,)), WAYS, wide
    disc = jaxir.DiscSource((3.0, 0.0, 0.0), (-1.0, 0.0, 0.0), 1.0, 100.0)
    forms = {"closed form": jaxir.Method(jaxir.ClosedForm()), "light": WAYS["light"]}
    for temperature in (3.0, 330.0):
        scene = jaxir.Scene(skin(SQUARE, temperature), sources=(disc,))
        yield f"disc, {temperature} K", scene, forms, 0.03


def camera(pixel):
    return jaxir.orthographic_camera(40.0, 15.0, pixel, (96, 96), target=(-1.0, 0.0, 0.0))


def look(scene, eye, samples, method, key=0):
    return jax.block_until_ready(
        jaxir.render(scene, eye, jaxir.LWIR, samples=samples, method=method, key=jax.random.key(key))
    )


def relative_error(image):
    return float(image.intensity_error()[0] / np.abs(image.radiant_intensity()[0]))


def by_hand(scene, eye, ways, rtol):
    """The fewest samples of each way that meet the tolerance in two of three draws: (way, samples)."""
    for name, method in ways.items():
        for samples in SAMPLES:
            errors = [relative_error(look(scene, eye, samples, method, key)) for key in range(3)]
            if statistics.median(errors) <= rtol:
                yield name, samples
                break


def planned(scene, eye, rtol):
    """What the plan computes: (method, samples) of the pass, and of another one if the first did not do.

    Where it places rays samples are None: that is a call of `render` by its method, with the look that decides where.
    """
    found = jaxir.plan(scene, eye, jaxir.LWIR, rtol, key=jax.random.fold_in(jax.random.key(0), 0))  # that of render
    if "where the others are needed" in found.terms[-1].sentence:
        return found, [(found.method, None)]
    passes = [(found.method, found.samples)]
    reached = relative_error(look(scene, eye, found.samples, found.method))
    if reached > rtol:
        image = jaxir.render(scene, eye, jaxir.LWIR, rtol=rtol)
        passes.append((found.method, max(2, int(image.samples) - found.samples)))
    return found, passes


def with_bounces_of(found, method):
    """A method by hand that leaves out as little as the one found."""
    return dataclasses.replace(jaxir.Method() if method is None else method, bounces=found.bounces)


def seconds(scene, eye, passes, rtol):
    """CPU seconds and seconds."""
    start = time.process_time(), time.perf_counter()
    for number, (method, samples) in enumerate(passes):
        if samples is None:
            jax.block_until_ready(jaxir.render(scene, eye, jaxir.LWIR, rtol=rtol, method=method).radiance)
        else:
            look(scene, eye, samples, method, number)
    return time.process_time() - start[0], time.perf_counter() - start[1]


def compare(name, scene, ways, pixel, rtol):
    """One row: the plan against the best by hand, medians of interleaved repeats."""
    eye = camera(pixel)
    found, passes = planned(scene, eye, rtol)
    ways = {way: with_bounces_of(found.method, method) for way, method in ways.items()}
    hands = list(by_hand(scene, eye, ways, rtol))
    if not hands:
        return None
    runs = [passes] + [[(ways[way], samples)] for way, samples in hands]
    for run in runs:
        seconds(scene, eye, run, rtol)
    both = np.array([[seconds(scene, eye, run, rtol) for run in runs] for _ in range(REPEATS)])
    times, wall = both[..., 0], np.median(both[:, 0, 1])
    medians = np.median(times, axis=0)
    best = int(np.argmin(medians[1:]))
    return {
        "scene": name,
        "rtol": rtol,
        "planned_samples": "+".join("placed" if samples is None else str(samples) for _, samples in passes),
        "planned_seconds": medians[0],
        "predicted_over_elapsed": found.seconds / wall,
        "hand": f"{hands[best][0]} {hands[best][1]}".strip(),
        "hand_seconds": medians[1 + best],
        "ratio": statistics.median(times[:, 0] / times[:, 1 + best]),
    }


def main(run: Run) -> str:
    grid = [(scene, rtol) for scene in scenes() for rtol in (PATHS if "particles" in scene[0] else TOLERANCES)]
    rows = []
    for scene, rtol in tqdm(grid):
        row = compare(*scene, rtol)
        jax.clear_caches()  # hundreds of compiled programs would exhaust what one process may map
        if row is not None:
            rows.append(row)
            run.table(rows)  # a run that is killed keeps its rows
    ratios = np.sort([row["ratio"] for row in rows])
    predicted = np.array([row["predicted_over_elapsed"] for row in rows])
    good, near = np.mean(ratios <= WITHIN), np.mean(np.abs(np.log(predicted)) <= np.log(1.5))
    figure, axis = subplots(figsize=(6, 4))
    axis.step(ratios, np.arange(1, len(ratios) + 1) / len(ratios), where="post")
    axis.axvline(WITHIN, color="0.6", linestyle="--")
    axis.set(
        xscale="log",
        xlabel="CPU time of the planned method / best by hand",
        ylabel="share of scenes",
        title=f"{len(rows)} scenes: {100 * good:.0f} % within {WITHIN}",
    )
    run.chart(figure, dpi=110)
    low, middle, high = np.quantile(predicted, (0.1, 0.5, 0.9))
    return (
        f"{len(rows)} scenes: within {WITHIN} times the best choice by hand on {100 * good:.0f} %, median "
        f"{np.median(ratios):.2f}, worst {ratios[-1]:.2f}; predicted over measured seconds {middle:.2f} "
        f"({low:.2f} to {high:.2f} for 80 %), within a factor 1.5 on {100 * near:.0f} %"
    )


if __name__ == "__main__":
    study(main)
