"""Is the error of pixels that is asked for the error obtained, without bias, and how many rays does it save?

Every scene is imaged to several tolerances (`pixel_rtol`) with many keys and compared with two images of a third of the
tolerance and other keys, whose own error is taken off. Rays are those of pilot and image, against those of an image
with as many in every pixel and the same error.
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
FINER = 3  # tolerance over that of the images that are compared with
MOST = 2**14  # rays in a pixel
PILOT = 8  # rays per pixel that decide
EVEN = (2, 8, 18, 32, 72, 128, 288, 512, 1152, 2048, 4050)


def scenes() -> Iterator[tuple[str, jaxir.Scene, jaxir.Camera]]:
    """Name, scene, eye."""
    for name, scene, _, pixel in plan_choice.scenes():
        yield name, scene, plan_choice.camera(pixel)
    azimuth, elevation, width, _ = AIRCRAFT
    for count in (256, 512):
        eye = jaxir.orthographic_camera(azimuth, elevation, width / count, (count, count))
        yield f"aircraft, sun, {count}", aircraft_scene()[0], eye


def told(image: jaxir.Image) -> float:
    """Root mean square standard error over the pixels that see the scene, of their mean contrast."""
    contrast = np.abs(np.asarray(image.radiance - image.empty, np.float64))
    error = np.asarray(image.standard_error, np.float64)
    return float(np.sqrt((error**2)[contrast > 0].mean()) / contrast[contrast > 0].mean())


def even_rays(scene: jaxir.Scene, eye: jaxir.Camera, error: float) -> float:
    """Rays in every pixel that have this error, between those tried by its power of the rays; inf beyond the last."""
    before = None
    for samples in EVEN:
        now = samples, told(jaxir.render(scene, eye, BAND, samples=samples, key=jax.random.key(5)))
        if now[1] <= error:
            if before is None or now[1] == 0:
                return float(samples)
            power = np.log(before[1] / now[1]) / np.log(now[0] / before[0])
            return float(before[0] * (before[1] / error) ** (1 / power))
        before = now
    return np.inf


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
    rays = rays + PILOT if rays > PILOT or told(images[0]) > tolerance / 3 else rays  # or the pilot is the image
    return {
        "scene": name,
        "tolerance": tolerance,
        "met": met,
        "obtained_over_asked": obtained / tolerance,
        "told_over_asked": float(np.sqrt(np.mean([told(image) ** 2 for image in images]))) / tolerance,
        "z": (intensity.mean() - known) / spread if spread > 1e-6 * abs(known) else 0.0,
        "rays": rays,
        "even_rays": even_rays(scene, eye, float(obtained)) if obtained > 1e-6 else 2.0,
    }


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--keys", type=int, default=16, help="images of a scene and tolerance (%(default)s)")
    parser.add_argument("--quick", action="store_true", help="every sixth scene")


def main(run: Run) -> str:
    every = list(scenes())[:: 6 if run.options.quick else 1]
    pairs = [(*scene, tolerance) for scene in every for tolerance in TOLERANCES]
    rows = [compare(*pair, run.options.keys) for pair in tqdm(pairs, desc="scenes and tolerances")]
    run.table(rows)
    varied = [row for row in rows if row["obtained_over_asked"] > 1e-3]
    ratio, z = np.array([r["obtained_over_asked"] for r in varied]), np.array([r["z"] for r in varied])
    saved = np.array([row["even_rays"] / row["rays"] for row in varied])
    figure, axes = subplots(1, 2, figsize=(9, 3.6))
    for tolerance in TOLERANCES:
        own = np.array([row["tolerance"] == tolerance for row in varied])
        axes[0].plot(saved[own], ratio[own], "o", ms=4, alpha=0.7, label=f"{tolerance:g}")
    axes[0].axhline(1, color="k", lw=0.6)
    axes[0].set(xscale="log", xlabel="rays of an even image over rays taken", ylabel="error obtained / asked")
    axes[0].legend(title="asked")
    axes[1].hist(z, bins=np.linspace(-4, 4, 17))
    axes[1].set(xlabel="mean intensity beside the fine image's [standard errors]", ylabel="scenes and tolerances")
    run.chart(figure)
    inside, finite = ((ratio > 0.6) & (ratio <= 1.0)).mean(), saved[np.isfinite(saved)]
    return (
        f"obtained / asked .6 to 1 in {inside:.0%} of {len(varied)} pairs ({ratio.min():.2f} to {ratio.max():.2f}), "
        f"all met: {all(row['met'] for row in rows)}; z of the intensities: rms {np.sqrt((z**2).mean()):.2f}, largest "
        f"{np.abs(z).max():.1f}; rays saved {np.median(finite):.1f} times (median), {finite.min():.2f} to "
        f"{finite.max():.0f}"
    )


if __name__ == "__main__":
    study(main, options)
