"""Are the W/sr of an emitting and of a sunlit plate right at every angle? Figs. 6 and 7 of Yu et al. (2021).

A plate of 1 m2: at 400 K with emissivity .5 (3-5 um), I = eps A B cos(theta); cold with reflectance .5 under a parallel
source of irradiance 100 W m-2, I = rho E cos(theta_i) cos(theta_o) A / pi. The paper's errors are .048 % and .023 %.
"""

import numpy as np
import scipy.constants as si
from scipy.integrate import quad

import jaxir
from studies._study import Run, study, subplots

ANGLES = np.arange(0.0, 86.0, 5.0)
COLUMNS = ("case", "angle_deg", "closed_form_W_per_sr", "by_rays_W_per_sr", "by_faces_W_per_sr")
PAPER = {"emitting plate": 4.8e-4, "plate under a parallel source": 2.3e-4}


def plate(emissivity: float, temperature: float) -> jaxir.Skin:
    corners = [[0.0, -0.5, -0.5], [0.0, 0.5, -0.5], [0.0, 0.5, 0.5], [0.0, -0.5, 0.5]]
    return jaxir.Skin(jaxir.Mesh(corners, [[0, 1, 2], [0, 2, 3]]), temperature, jaxir.Lambert(emissivity))


def planck(temperature: float, band: jaxir.Band) -> float:
    """In-band radiance by quadrature in wavelength, double precision."""
    c1, c2 = 2 * si.h * si.c**2, si.h * si.c / si.k

    def spectral(wavelength: float) -> float:
        return c1 / wavelength**5 / np.expm1(c2 / (wavelength * temperature))

    return quad(spectral, band.lower * 1e-6, band.upper * 1e-6, epsrel=1e-12)[0]


def cases() -> dict[str, tuple[jaxir.Scene, np.ndarray]]:
    cos = np.cos(np.deg2rad(ANGLES))
    sun = jaxir.ParallelSource((-1.0, 0.0, 0.0), 100.0)
    return {
        "emitting plate": (jaxir.Scene(plate(0.5, 400.0)), 0.5 * planck(400.0, jaxir.MWIR) * cos),
        "plate under a parallel source": (jaxir.Scene(plate(0.5, 3.0), sources=(sun,)), 0.5 * 100.0 / np.pi * cos),
    }


def main(run: Run) -> str:
    figure, axes = subplots(1, 2, figsize=(11, 4.4))
    rows, said = [], []
    for axis, (name, (scene, expected)) in zip(axes, cases().items(), strict=True):
        views = np.stack([ANGLES, np.zeros_like(ANGLES)], axis=1)
        traced = np.asarray(jaxir.signature(scene, views, jaxir.MWIR, shape=(512, 512), samples=8).intensity, float)[
            :, 0
        ]
        summed = np.array([float(jaxir.unoccluded_intensity(scene, a, 0.0, jaxir.MWIR)[0]) for a in ANGLES])
        errors = {"by rays": np.abs(traced / expected - 1), "by faces": np.abs(summed / expected - 1)}
        for label, error in errors.items():
            axis.semilogy(ANGLES, np.maximum(error, 1e-9), "o-", ms=4, label=label)
        axis.axhline(PAPER[name], color="0.4", ls="--", label="paper")
        axis.set(title=name, xlabel="angle of view [deg]", ylabel="relative error of the intensity")
        axis.grid(alpha=0.3, which="both")
        axis.legend()
        for angle, want, a, b in zip(ANGLES, expected, traced, summed, strict=True):
            rows.append(dict(zip(COLUMNS, (name, angle, want, a, b), strict=True)))
        worst = {label: error.max() for label, error in errors.items()}
        said.append(
            f"{name} {worst['by rays']:.1e} by rays, {worst['by faces']:.1e} by faces (paper {PAPER[name]:.1e})"
        )
    run.chart(figure, dpi=90)
    run.table(rows, digits=9)
    return f"largest relative error from 0 to 85 deg: {'; '.join(said)}"


if __name__ == "__main__":
    study(main)
