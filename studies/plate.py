"""Are the W/sr of an emitting and of a sunlit plate right at every angle? Figs. 6 and 7 of Yu et al. (2021).

A plate of 1 m2: at 400 K with emissivity .5 and .9 in three bands, I = eps A B cos(theta); cold with reflectance .5 and
1 under a parallel source of irradiance 100 W m-2 at 0, 30 and 60 deg, I = rho E cos(theta_i) cos(theta_o) A / pi. The
paper's errors are .048 % and .023 %.
"""

from typing import Any

import numpy as np
import scipy.constants as si
from scipy.integrate import quad

import jaxir
from studies._study import Run, study, subplots

ANGLES = np.arange(0.0, 86.0, 5.0)
BANDS = (jaxir.SWIR, jaxir.MWIR, jaxir.LWIR)
TEMPERATURE, IRRADIANCE = 400.0, 100.0
COLUMNS = ("figure", "case", "angle_deg", "closed_form_W_per_sr", "by_rays_W_per_sr", "by_faces_W_per_sr")
PAPER = {"Fig. 6, emitting plate": 4.8e-4, "Fig. 7, plate under a parallel source": 2.3e-4}


def plate(emissivity: float, temperature: float) -> jaxir.Skin:
    corners = [[0.0, -0.5, -0.5], [0.0, 0.5, -0.5], [0.0, 0.5, 0.5], [0.0, -0.5, 0.5]]
    return jaxir.Skin(jaxir.Mesh(corners, [[0, 1, 2], [0, 2, 3]]), temperature, jaxir.Lambert(emissivity))


def planck(temperature: float, band: jaxir.Band) -> float:
    """In-band radiance by quadrature in wavelength, double precision."""
    c1, c2 = 2 * si.h * si.c**2, si.h * si.c / si.k

    def spectral(wavelength: float) -> float:
        return c1 / wavelength**5 / np.expm1(c2 / (wavelength * temperature))

    return quad(spectral, band.lower * 1e-6, band.upper * 1e-6, epsrel=1e-12)[0]


def cases() -> dict[str, list[tuple[jaxir.Scene, dict[str, np.ndarray]]]]:
    """By figure, every scene and its curves: the name and the intensity at each angle in closed form, by band."""
    cos = np.cos(np.deg2rad(ANGLES))
    warm, lit = [], []
    for emissivity in (0.5, 0.9):
        curves = {
            f"{band.name}, emissivity {emissivity}": emissivity * planck(TEMPERATURE, band) * cos for band in BANDS
        }
        warm.append((jaxir.Scene(plate(emissivity, TEMPERATURE)), curves))
    for reflectance in (0.5, 1.0):
        for incidence in (0.0, 30.0, 60.0):
            c, s = np.cos(np.deg2rad(incidence)), np.sin(np.deg2rad(incidence))
            scene = jaxir.Scene(plate(1 - reflectance, 100.0), sources=jaxir.ParallelSource((-c, 0.0, -s), IRRADIANCE))
            name = f"reflectance {reflectance}, from {incidence:.0f} deg"
            lit.append((scene, {name: reflectance * IRRADIANCE * c / np.pi * cos}))
    return dict(zip(PAPER, (warm, lit), strict=True))


def measure() -> list[dict[str, Any]]:
    """One row per curve and angle."""
    views = np.stack([ANGLES, np.zeros_like(ANGLES)], axis=1)
    rows = []
    for figure, scenes in cases().items():
        for scene, curves in scenes:
            bands = BANDS[: len(curves)]
            traced = np.asarray(jaxir.signature(scene, views, bands, shape=(512, 512), samples=8).intensity, float)
            summed = np.array([jaxir.unoccluded_intensity(scene, a, 0.0, bands) for a in ANGLES], float)
            for k, (name, expected) in enumerate(curves.items()):
                rows += [
                    dict(zip(COLUMNS, (figure, name, *values), strict=True))
                    for values in zip(ANGLES, expected, traced[:, k], summed[:, k], strict=True)
                ]
    return rows


def chart(rows: list[dict[str, Any]]) -> Any:
    figure, axes = subplots(2, 2, figsize=(12, 8.5), sharex=True)
    for column, name in enumerate(PAPER):
        own = [row for row in rows if row["figure"] == name]
        above, below = axes[:, column]
        for k, case in enumerate(dict.fromkeys(row["case"] for row in own)):
            curve = [row for row in own if row["case"] == case]
            expected = np.array([row["closed_form_W_per_sr"] for row in curve])
            traced = np.array([row["by_rays_W_per_sr"] for row in curve])
            above.plot(ANGLES, expected, "-", color=f"C{k}", label=case)
            above.plot(ANGLES, traced, "o", ms=4, color=f"C{k}")
            below.semilogy(ANGLES, np.maximum(np.abs(traced / expected - 1), 1e-9), "o-", ms=3, color=f"C{k}")
        below.axhline(PAPER[name], color="0.4", ls="--", label="paper, largest")
        above.set(title=name, ylabel="radiant intensity [W/sr]; lines closed form, dots rays")
        below.set(xlabel="angle of view [deg]", ylabel="relative error by rays")
        above.set_yscale("log" if column == 0 else "linear")
        for axis in (above, below):
            axis.grid(alpha=0.3)
            axis.legend(fontsize=8)
    return figure


def main(run: Run) -> str:
    rows = measure()
    run.table(rows, digits=9)
    run.chart(chart(rows), dpi=90)
    said = []
    for figure, paper in PAPER.items():
        own = [row for row in rows if row["figure"] == figure]
        rays, faces = (
            max(abs(row[by] / row["closed_form_W_per_sr"] - 1) for row in own)
            for by in ("by_rays_W_per_sr", "by_faces_W_per_sr")
        )
        said.append(f"{figure} {rays:.1e} by rays, {faces:.1e} by faces (paper {paper:.1e})")
    return f"largest relative error from 0 to 85 deg: {'; '.join(said)}"


if __name__ == "__main__":
    study(main)
