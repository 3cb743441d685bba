"""What does an aircraft with its plume look like in the infrared, and how many W/sr does it send where?

Writes radiance images (PNG, NPZ, TIFF) and the radiant intensity over aspects (CSV, PNG) of a generic aircraft of the
paper's dimensions, or of your own mesh (`--mesh FILE --unit m`).
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

import jaxir
from jaxir.io.meshes import METRES, load_mesh
from jaxir.io.results import save_image, save_signature, save_tiff
from studies import aircraft
from studies.charts import polar_signature, radiance_panels

BANDS = (jaxir.SWIR, jaxir.MWIR, jaxir.LWIR)
CORE_ABSORPTION = (0.25, 0.5, 0.01)  # gray stand-in of the gas at full exhaust fraction, by band [m-1]
SUN = (10.0, 1.0, 0.05)  # irradiance at the aircraft by band [W m-2]
AIR_PATH = (0.880, 0.813, 0.971)  # transmittance of 5 km at 10 km altitude (LOWTRAN 7, no haze)
AIR_GLOW = (8.7e-6, 0.010, 0.196)  # path radiance of the same path [W m-2 sr-1]


def build_scene(mesh: jaxir.Mesh, temperature: np.ndarray, emissivity: float, plume: jaxir.GridPlume) -> jaxir.Scene:
    return jaxir.Scene(
        skin=jaxir.Skin(mesh, temperature, jaxir.Lambert(emissivity)),
        plume=plume,
        sources=(jaxir.ParallelSource((0.0, 0.0, -1.0), SUN),),
        atmosphere=jaxir.FixedPath(AIR_PATH, AIR_GLOW),
    )


def gray_plume() -> jaxir.GridPlume:
    grid, temperature, fraction = aircraft.round_jet()
    absorption = fraction[..., None] * np.array(CORE_ABSORPTION)
    return jaxir.GridPlume(grid, temperature, jaxir.GrayGas(absorption))


def arguments(argv: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m studies.stealth_aircraft", description=__doc__.split("\n")[0])
    parser.add_argument("--mesh", help="your own mesh (STL, OBJ, PLY, GLB), nose along +x, z up")
    parser.add_argument("--unit", choices=list(METRES), help="length unit of --mesh (required with it)")
    parser.add_argument("--temperature", type=float, default=255.0, help="skin temperature of --mesh [K] (%(default)s)")
    parser.add_argument("--emissivity", type=float, default=0.8, help="of the skin (%(default)s)")
    parser.add_argument("--pixels", type=int, default=500, help="columns of the images, twice the rows (%(default)s)")
    parser.add_argument("--samples", type=int, default=8, help="rays per pixel, even (%(default)s)")
    parser.add_argument("--out", type=Path, default=Path("studies/out/stealth_aircraft"), help="folder (%(default)s)")
    chosen = parser.parse_args(argv)
    if (chosen.mesh is None) != (chosen.unit is None):
        parser.error("--mesh and --unit go together: files do not say their unit")
    return chosen


def main(argv: list[str]) -> None:
    chosen = arguments(argv)
    chosen.out.mkdir(parents=True, exist_ok=True)
    began = time.perf_counter()
    if chosen.mesh is None:
        vertices, faces, _ = aircraft.generic_aircraft()
        mesh, temperature = jaxir.Mesh(vertices, faces), aircraft.skin_temperature(vertices, faces)
    else:
        mesh = load_mesh(chosen.mesh, unit=chosen.unit).mesh
        temperature = np.full(mesh.count, chosen.temperature)
    scene = build_scene(mesh, temperature, chosen.emissivity, gray_plume())

    size = (chosen.pixels // 2, chosen.pixels)
    pixel = 48.0 / chosen.pixels / 5000.0  # 48 m across: aircraft and plume
    images = {}
    for name, azimuth, elevation in (("side", 90.0, 0.0), ("above", 90.0, 60.0), ("rear quarter", 140.0, 20.0)):
        camera = jaxir.perspective_camera(azimuth, elevation, 5000.0, pixel, size, target=(-15.0, 0.0, 0.0))
        images[name] = jaxir.render(scene, camera, BANDS, samples=chosen.samples)
        stem = chosen.out / name.replace(" ", "_")
        save_image(stem.with_suffix(".npz"), images[name])
        save_tiff(stem.with_suffix(".tif"), images[name])
    radiance_panels(chosen.out / "images.png", images)
    seconds = time.perf_counter() - began

    around = np.arange(0.0, 360.0, 10.0)
    table = jaxir.signature(scene, np.stack([around, np.zeros_like(around)], 1), BANDS, distance=5000.0)
    save_signature(chosen.out / "intensity.csv", table)
    polar_signature(chosen.out / "intensity.png", table)

    side = images["side"]
    intensity, error = np.asarray(side.radiant_intensity()), np.asarray(side.intensity_error())
    said = ", ".join(f"{b} {i:.4g} ± {e:.1g}" for b, i, e in zip(side.bands, intensity, error, strict=True))
    total = time.perf_counter() - began
    print(
        f"broadside at 5 km [W/sr]: {said}; {seconds:.1f} s for three images, {total:.1f} s in all; see {chosen.out}/"
    )


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except ValueError as error:
        sys.exit(f"stealth_aircraft: {error}")
