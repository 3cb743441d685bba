"""Where on an aircraft does paint change its signature most?

The derivative of the radiant intensity, summed over twelve aspects, in the emissivity of every face: as images from
above and from behind, and as coloured PLY files that carry the numbers.
"""

import numpy as np

import jaxir
from jaxir.fit import measured_intensity, sensitivity
from jaxir.io.result import save_face_values
from studies import aircraft
from studies._study import Run, study, subplots

VIEWS = [(30.0 * k, (-10.0, 10.0, 25.0)[k % 3]) for k in range(12)]
BAND = jaxir.LWIR
COLUMNS = ("part", "faces", "area_m2", "dI_d_emissivity_W_sr", "share_percent", "dI_d_temperature_W_sr_K")


def main(run: Run) -> str:
    out = run.bulk()
    vertices, faces, part = aircraft.generic_aircraft()
    mesh = jaxir.Mesh(vertices, faces)
    skin = jaxir.Skin(mesh, aircraft.skin_temperature(vertices, faces), jaxir.Lambert(0.7), part, aircraft.PARTS)
    scene = jaxir.Scene(skin)
    wanted = measured_intensity(scene, VIEWS, BAND, np.ones((12, 1)), 1.0, shape=(192, 192), samples=2)
    by_emissivity, by_temperature = (np.asarray(x, np.float64) / len(VIEWS) for x in sensitivity(scene, wanted, "LWIR"))
    area = np.linalg.norm(np.asarray(mesh.area_vectors(), np.float64), axis=1)
    per_area = by_emissivity / area
    save_face_values(out / "emissivity.ply", mesh, per_area, name="mean dI/d(emissivity) per area", unit="W/sr/m2")
    save_face_values(out / "temperature.ply", mesh, by_temperature / area, name="mean dI/dT per area", unit="W/sr/K/m2")
    figure, axes = subplots(1, 2, figsize=(10, 4))
    limit = np.percentile(per_area, 96)
    for axis, (name, azimuth, elevation) in zip(axes, (("above", 90, 89.9), ("rear quarter", 150, 20)), strict=True):
        face = np.asarray(jaxir.visible_faces(mesh, jaxir.orthographic_camera(azimuth, elevation, 0.06, (200, 290))))
        shown = np.where(face >= 0, per_area[np.maximum(face, 0)], np.nan)
        drawn = axis.imshow(shown, cmap="viridis", vmin=0, vmax=limit, extent=(-8.7, 8.7, -6, 6))
        axis.set(title=name, xlabel="m")
    figure.colorbar(drawn, ax=axes, label="mean dI/dε per area [W sr$^{-1}$ m$^{-2}$]")
    run.chart(figure, dpi=100)
    total = by_emissivity.sum()
    of_part = 100 * np.bincount(part, by_emissivity) / total
    counts, *sums = (np.bincount(part, x) for x in (None, area, by_emissivity, by_temperature))
    rows = zip(aircraft.PARTS, counts, sums[0], sums[1], of_part, sums[2], strict=True)
    run.table([dict(zip(COLUMNS, row, strict=True)) for row in rows], digits=6)
    shares = ", ".join(f"{name} {share:.0f} %" for name, share in zip(aircraft.PARTS, of_part, strict=True))
    order = np.argsort(-per_area)
    best = order[np.cumsum(area[order]) < 0.1 * area.sum()]
    return (
        f"dI/d(emissivity) {total:.0f} W/sr in LWIR, mean of 12 aspects: {shares}; the best tenth of the area holds "
        f"{100 * by_emissivity[best].sum() / total:.0f} %; {mesh.count} faces"
    )


if __name__ == "__main__":
    study(main)
