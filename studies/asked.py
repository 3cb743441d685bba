"""Is the error that is asked for the error obtained, without bias, and how many rays does it save?

Every scene is imaged to several tolerances (`pixel_rtol`) with many keys and compared with two images of half the
tolerance and other keys, whose own error is taken off. Rays are those of pilot and image, against those of an image
with as many in every pixel and the same error. Intensities of five aspects are asked for in the same way
(`signature(rtol=)`), and compared with four signatures of half the tolerance. Bounces are as many as a tolerance needs,
so that what they leave out is among the errors, and z tells of it where it is more than samples leave unknown.
"""

import argparse
from collections.abc import Iterator

import jax
import numpy as np
from tqdm import tqdm

import jaxir
from studies import plan_choice
from studies._study import Run, study, subplots
from studies.speed_accuracy import AIRCRAFT, aircraft_scene

BAND = jaxir.LWIR
TOLERANCES = (3e-2, 1e-2, 3e-3)
OF_SUM = 0.1  # tolerance of an intensity over that of pixels
FINER = 2  # tolerance over that of the images that are compared with
MOST = 2**14  # rays in a pixel
PILOT, SCOUT = 8, 0.25  # rays per pixel that decide, and share of others that tell more before, at most
KINDS = ("pixels", "intensity", "views", "usual rule")
ASPECTS = ((0.0, 0.0), (40.0, 20.0), (90.0, 0.0), (135.0, -35.0), (180.0, 10.0))
RASTER = {"shape": (32, 64), "max_samples": 2**13}  # of a view
EVEN = (2, 8, 18, 32, 72, 128, 288, 512)


def scenes() -> Iterator[tuple[str, jaxir.Scene, jaxir.Camera]]:
    """Name, scene, eye."""
    for name, scene, _, pixel in plan_choice.scenes():
        yield name, scene, plan_choice.camera(pixel)
    azimuth, elevation, width = AIRCRAFT
    for count in (256, 512):
        eye = jaxir.orthographic_camera(azimuth, elevation, width / count, (count, count))
        yield f"aircraft, sun, {count}", aircraft_scene()[0], eye


def told(image: jaxir.Image) -> float:
    """Root mean square standard error over the pixels that see the scene, of their mean contrast."""
    contrast = np.abs(np.asarray(image.radiance - image.empty, np.float64))
    error = np.asarray(image.standard_error, np.float64)
    return float(np.sqrt((error**2)[contrast > 0].mean()) / contrast[contrast > 0].mean())


def even_rays(scene: jaxir.Scene, eye: jaxir.Camera, error: float, method: jaxir.Method) -> float:
    """Rays in every pixel that have this error, by its power of the rays between those tried, or of the last two."""
    tried: list[tuple[int, float]] = []
    for samples in EVEN:
        image = jaxir.render(scene, eye, BAND, samples=samples, key=jax.random.key(5), method=method)
        tried.append((samples, told(image)))
        if tried[-1][1] <= error:
            break
    (less, coarse), (more, fine) = (tried[0], *tried)[-2:]
    if coarse == fine:  # the first is enough
        return float(less)
    return float(less * (coarse / error) ** (np.log(more / less) / np.log(coarse / fine)))


def compare(name: str, scene: jaxir.Scene, eye: jaxir.Camera, tolerance: float, keys: int) -> dict:
    """One row."""

    def asked(tolerance: float, key: int) -> jaxir.Image:
        return jaxir.render(scene, eye, BAND, pixel_rtol=tolerance, key=jax.random.key(key), max_samples=MOST)

    finer = [asked(tolerance / FINER, 1000 + key) for key in range(2)]
    truth = np.mean([np.asarray(image.radiance, np.float64) for image in finer], axis=0)
    contrast = np.abs(truth - np.asarray(finer[0].empty, np.float64))
    images = [asked(tolerance, key) for key in range(keys)]
    apart = np.array([np.asarray(image.radiance, np.float64) - truth for image in images])
    known_error = np.mean([told(image) ** 2 for image in finer]) / len(finer)
    square = (apart**2)[:, contrast > 0].mean() / contrast[contrast > 0].mean() ** 2
    obtained = np.sqrt(max(square - known_error, 0.0))
    intensity = np.array([float(image.radiant_intensity()[0]) for image in images])
    known = np.mean([float(image.radiant_intensity()[0]) for image in finer])
    spread = np.hypot(intensity.std(ddof=1) / keys**0.5, np.hypot(*(float(i.intensity_error()[0]) for i in finer)) / 2)
    met = all(bool(image.outcome == jaxir.Outcome.tolerance_met) for image in images)
    rays = np.mean([int(image.samples) for image in images])
    if rays > PILOT or told(images[0]) > tolerance / 3:  # else the pilot is the image
        rays = (1 + SCOUT) * rays + PILOT
    return {
        "scene": name,
        "of": "pixels",
        "tolerance": tolerance,
        "met": met,
        "obtained_over_asked": obtained / tolerance,
        "told_over_asked": float(np.sqrt(np.mean([told(image) ** 2 for image in images]))) / tolerance,
        "z": (intensity.mean() - known) / spread if spread > 1e-6 * abs(known) else 0.0,
        "rays": rays,
        "even_rays": even_rays(scene, eye, float(obtained), images[0].asked.method) if obtained > 1e-6 else 2.0,
    }


def compare_views(name: str, scene: jaxir.Scene, tolerance: float, keys: int) -> dict:
    """One row: root mean square error over the views, and z of their mean relative error."""

    def asked(tolerance: float, key: int) -> jaxir.Signature:
        return jaxir.signature(scene, ASPECTS, BAND, rtol=tolerance, key=jax.random.key(key), **RASTER)

    finer = [asked(tolerance / FINER, 1000 + key) for key in range(4)]
    truth = np.mean([np.asarray(table.intensity, np.float64)[:, 0] for table in finer], axis=0)
    known = np.mean([np.asarray(table.standard_error, np.float64)[:, 0] ** 2 for table in finer], axis=0) / len(finer)
    tables = [asked(tolerance, key) for key in range(keys)]
    apart = np.array([np.asarray(table.intensity, np.float64)[:, 0] for table in tables]) - truth
    told = np.mean([np.asarray(table.standard_error, np.float64)[:, 0] ** 2 for table in tables], axis=0)
    square, shown = np.maximum((apart**2).mean(axis=0) - known, 0), truth > 0
    share = (apart[:, shown] / truth[shown]).mean(axis=1)
    unknown = np.sqrt((known[shown] / truth[shown] ** 2).sum()) / shown.sum()
    spread = np.hypot(share.std(ddof=1) / keys**0.5, unknown)
    return {
        "scene": name,
        "of": "views",
        "tolerance": tolerance,
        "met": all(bool(table.meets(tolerance).all()) for table in tables),
        "obtained_over_asked": float(np.sqrt(square[shown].mean() / (truth[shown] ** 2).mean())) / tolerance,
        "told_over_asked": float(np.sqrt(told[shown].mean() / (truth[shown] ** 2).mean())) / tolerance,
        "z": share.mean() / spread if spread > 1e-6 else 0.0,
        "rays": np.nan,
        "even_rays": np.nan,
    }


def usual(scene: jaxir.Scene, eye: jaxir.Camera, rtol: float, key: int, method: jaxir.Method) -> float:
    """Intensity [W sr-1] by the usual rule: two rays a pixel more until the error of their mean, as told, is met."""
    total = square = 0.0
    for number in range(MOST // 2):
        own = jax.random.fold_in(jax.random.key(key), number)
        image = jaxir.render(scene, eye, BAND, samples=2, key=own, method=method)
        total += float(image.radiant_intensity()[0])
        square += float(image.intensity_error()[0]) ** 2
        if square**0.5 <= rtol * abs(total):
            break
    return total / (number + 1)


def compare_intensity(name: str, scene: jaxir.Scene, eye: jaxir.Camera, tolerance: float, keys: int) -> Iterator[dict]:
    """A row of what was asked for, and to the largest tolerance, for which few looks do, one of the usual rule."""

    def asked(tolerance: float, key: int) -> jaxir.Image:
        return jaxir.render(scene, eye, BAND, rtol=tolerance, key=jax.random.key(key), max_samples=MOST)

    finer = [asked(tolerance / FINER, 1000 + key) for key in range(4)]
    known = np.mean([float(image.radiant_intensity()[0]) for image in finer])
    unknown = np.hypot.reduce([float(image.intensity_error()[0]) for image in finer]) / len(finer)
    images = [asked(tolerance, key) for key in range(keys)]
    told = float(np.sqrt(np.mean([float(image.intensity_error()[0]) ** 2 for image in images])))
    met = all(bool(image.outcome == jaxir.Outcome.tolerance_met) for image in images)
    ways = {"intensity": np.array([float(image.radiant_intensity()[0]) for image in images])}
    if tolerance == max(TOLERANCES) * OF_SUM:
        ways["usual rule"] = np.array(
            [usual(scene, eye, tolerance, key, images[0].asked.method) for key in range(keys)]
        )
    for way, found in ways.items():
        square = max(((found - known) ** 2).mean() - unknown**2, 0.0)
        spread = np.hypot(found.std(ddof=1) / keys**0.5, unknown)
        yield {
            "scene": name,
            "of": way,
            "tolerance": tolerance,
            "met": met,
            "obtained_over_asked": square**0.5 / (tolerance * abs(known)),
            "told_over_asked": told / (tolerance * abs(known)) if way == "intensity" else np.nan,
            "z": (found.mean() - known) / spread if spread > 1e-6 * abs(known) else 0.0,
            "rays": np.mean([int(image.samples) for image in images]) if way == "intensity" else np.nan,
            "even_rays": np.nan,
        }


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--keys", type=int, default=16, help="images of a scene and tolerance (%(default)s)")
    parser.add_argument("--quick", action="store_true", help="every sixth scene")


def main(run: Run) -> str:
    every, keys = list(scenes())[:: 6 if run.options.quick else 1], run.options.keys
    pairs = [(*scene, tolerance) for tolerance in TOLERANCES for scene in every]  # the dearest last
    rows = []
    for name, scene, eye, tolerance in tqdm(pairs, desc="scenes and tolerances"):
        rows.append(compare(name, scene, eye, tolerance, keys))
        rows += compare_intensity(name, scene, eye, tolerance * OF_SUM, keys)
        if not name.endswith((", far", ", 512")):  # the same scene seen from elsewhere
            rows.append(compare_views(name, scene, tolerance * OF_SUM, keys))
        run.table(rows)  # what there is, should it be ended early
    varied = [row for row in rows if row["obtained_over_asked"] > 1e-3]
    figure, axes = subplots(1, 2, figsize=(9, 3.6))
    said = []
    for number, kind in enumerate(KINDS):
        own = [row for row in varied if row["of"] == kind]
        ratio, z = np.array([r["obtained_over_asked"] for r in own]), np.array([r["z"] for r in own])
        axes[1].hist(ratio, bins=np.linspace(0, 1.5, 16), histtype="step", lw=1.5, color=f"C{number}", label=kind)
        inside = ((ratio > 0.6) & (ratio <= 1.0)).mean()
        said.append(
            f"{kind}: obtained / asked .6 to 1 in {inside:.0%} of {len(own)} pairs ({ratio.min():.2f} to "
            f"{ratio.max():.2f}), {sum(row['met'] for row in own)} met, z of intensities: rms "
            f"{np.sqrt((z**2).mean()):.2f}, largest {np.abs(z).max():.1f}"
        )
    for tolerance in TOLERANCES:
        own = [row for row in varied if row["of"] == "pixels" and row["tolerance"] == tolerance]
        saved = [row["even_rays"] / row["rays"] for row in own]
        axes[0].plot(saved, [r["obtained_over_asked"] for r in own], "o", ms=4, alpha=0.7, label=f"{tolerance:g}")
    axes[0].axhline(1, color="k", lw=0.6)
    axes[0].set(xscale="log", xlabel="rays of an even image over rays taken", ylabel="error obtained / asked")
    axes[0].legend(title="pixels, asked")
    axes[1].set(xlabel="error obtained / asked", ylabel="scenes and tolerances")
    axes[1].legend(title="asked of")
    run.chart(figure)
    saved = np.array([row["even_rays"] / row["rays"] for row in varied if row["of"] == "pixels"])
    finite = saved[np.isfinite(saved)]
    rays = f"rays saved {np.median(finite):.1f} times (median), {finite.min():.2f} to {finite.max():.0f}"
    return "; ".join([*said, rays])


if __name__ == "__main__":
    study(main, options)
