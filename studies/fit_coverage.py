"""Do fits miss the truth as far as they say, with rays of their own and noise in the data?

Fits of three scenes to exact intensities with 1 % noise, every one with its own noise and its own rays: the temperature
and the emissivity of two parts of a box under a lamp of some extent, the temperature and the mole fractions of a jet's
exhaust, and its temperature and the number of its particles, whose scattered light is solved on a lattice. Rays are as
few as to err about as much as the data do. The share of fits whose truth lies within the standard deviation that they
print, of the noise alone and in total, with its binomial interval.
"""

import argparse
import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
import scipy.stats
from tqdm import tqdm

import jaxir
from jaxir.fit import (
    Fit,
    Measurement,
    jet_parameter,
    measured_intensity,
    mole_fraction_scale,
    part_emissivity,
    part_temperature,
    particle_loading,
    prepare,
    solve,
)
from studies._study import Run, study, subplots

AIM = np.array([-1.5, -1.0, -2.0]) / np.sqrt(7.25)
NOISE = 0.01
GOAL = (0.63, 0.73)  # within one standard deviation
BANDS = (jaxir.MWIR, jaxir.LWIR)
NODES = jaxir.resolved_nodes(BANDS, 400.0, 1, 0)  # of the jet; the same for truth and fit
AROUND = [(45.0 * k, (10.0, 40.0, -20.0)[k % 3]) for k in range(8)]


class Case(NamedTuple):
    """A scene as a function of its parameters, their truth and start, what fits know of them, bands and rasters."""

    scene: Callable[[np.ndarray], jaxir.Scene]
    truth: np.ndarray
    start: np.ndarray
    parameters: list
    bands: object
    shape: tuple[int, int]
    max_samples: int
    method: jaxir.Method | None = None
    one_in: int = 1  # of so many fits is made, where one takes long

    def exact(self) -> np.ndarray:
        """Intensities from rays enough."""
        fine = {"shape": (128, 128), "samples": 16, "key": jax.random.key(99), "method": self.method}
        return np.asarray(jaxir.signature(self.scene(self.truth), AROUND, self.bands, **fine).intensity)

    def measured(self, value: np.ndarray, deviation: np.ndarray) -> Measurement:
        """Them as measured."""
        start = self.scene(self.start)
        how = {"shape": self.shape, "method": self.method}
        return measured_intensity(start, AROUND, self.bands, value, deviation, **how)


def box(values: np.ndarray) -> jaxir.Scene:
    """A metre's cube with a warm top of some temperature and sides of some emissivity, under a lamp."""
    corners = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    quads = [(1, 5, 7, 3), (0, 2, 6, 4), (0, 4, 5, 1), (2, 3, 7, 6), (0, 1, 3, 2), (4, 6, 7, 5)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    part = np.repeat([0, 1, 1, 1, 1, 1], 2)
    temperature, emissivity = np.array([values[0], 320.0])[part], np.where(part == 0, 0.8, values[1])
    lamp = jaxir.DiscSource((1.5, 1.0, 2.0), AIM, 0.5, 400.0)
    skin = jaxir.Skin(jaxir.Mesh(corners, faces), temperature, jaxir.Lambert(emissivity), part, ("top", "sides"))
    return jaxir.Scene(skin, sources=(lamp,))


def jet(values: np.ndarray) -> jaxir.Scene:
    gas = jaxir.NarrowBandGas(26_500.0, 0.1 * values[1], 0.08 * values[1])
    return jaxir.Scene(plumes=jaxir.JetPlume((0, 0, 0), (-1, 0, 0), 0.5, values[0], 218.0, gas, length=12.0, panels=2))


def clouded(values: np.ndarray) -> jaxir.Scene:
    """The jet with so many times 3.2e9 spheres of 10 um a cubic metre, which scatter nearly all they take."""
    table = jaxir.mie_table(10.0, 2 - 5e-5j, np.geomspace(1.0, 12.5, 41), 0.1, angles=91, sizes=9)
    (plume,) = jet(np.array([values[0], 1.0])).plumes
    return jaxir.Scene(plumes=dataclasses.replace(plume, particles=jaxir.Particles(3.2e9 * values[1], table)))


CASES = {
    "skin under a lamp": Case(
        box,
        np.array([400.0, 0.6]),
        np.array([370.0, 0.75]),
        [part_temperature("top"), part_emissivity("sides")],
        BANDS,
        (20, 20),
        2,
    ),
    "jet": Case(
        jet,
        np.array([1200.0, 1.0]),
        np.array([1000.0, 1.0]),
        [jet_parameter("exit_temperature"), mole_fraction_scale()],
        NODES,
        (20, 20),
        2,
    ),
    "jet with particles": Case(
        clouded,
        np.array([1200.0, 0.625]),
        np.array([1000.0, 1.0]),
        [jet_parameter("exit_temperature"), particle_loading()],
        NODES,
        (20, 20),
        2,
        jaxir.Method(scattering=jaxir.DiscreteOrdinates(13, 5, 2)),
        10,
    ),
}
CASES["skin, more rays"] = CASES["skin under a lamp"]._replace(shape=(12, 12), max_samples=16)


def fits(case: Case, count: int) -> list[Fit]:
    """Fits to the same exact values, each with noise and rays of its own."""
    exact = case.exact()
    rng, found = np.random.default_rng(5), []
    for draw in tqdm(range(count), leave=False):
        noisy = exact * (1 + NOISE * rng.normal(size=exact.shape))
        measured = case.measured(noisy, NOISE * exact)
        problem = prepare(case.scene(case.start), case.parameters, [measured], key=jax.random.key(draw))
        found.append(solve(problem, max_samples=case.max_samples))
    return found


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--fits", type=int, default=600, help="of each scene (%(default)s)")


def main(run: Run) -> str:
    figure, axes = subplots(1, len(CASES), figsize=(4.5 * len(CASES), 3.4), sharey=True)
    rows = []
    for axis, (name, case) in zip(axes, CASES.items(), strict=True):
        found = fits(case, max(run.options.fits // case.one_in, 1))
        off = np.array([np.asarray(f.uncertainty.value) for f in found]) - case.truth
        noise = np.array([np.asarray(f.uncertainty.standard_deviation) for f in found])
        total = np.array([f.standard_deviation for f in found])
        of_rays = np.array([np.asarray(f.sampling_error) for f in found])
        for i, label in enumerate(found[0].uncertainty.labels):
            inside = np.abs(off[:, i]) < total[:, i]
            interval = scipy.stats.binomtest(int(inside.sum()), inside.size, 0.683).proportion_ci(method="wilson")
            rows.append(
                {
                    "scene": name,
                    "fits": len(found),
                    "parameter": label,
                    "rays_to_noise": float(np.median(of_rays[:, i] / noise[:, i])),
                    "mean_miss_in_total": float(np.mean(off[:, i] / total[:, i])),
                    "within_noise_alone": float(np.mean(np.abs(off[:, i]) < noise[:, i])),
                    "within_total": float(inside.mean()),
                    "interval_from": interval.low,
                    "interval_to": interval.high,
                    "explained": float(np.mean([f.probability > 0.01 for f in found])),
                }
            )
            pull = np.sort(off[:, i] / total[:, i])
            axis.step(pull, (np.arange(pull.size) + 0.5) / pull.size, label=label)
        at = np.linspace(-3, 3, 101)
        axis.plot(at, scipy.stats.norm.cdf(at), "k:", label="normal")
        axis.set(title=name, xlabel="(fit − truth) / standard deviation", xlim=(-3, 3))
        axis.legend(fontsize="small")
    axes[0].set_ylabel("share of the fits")
    run.table(rows)
    run.chart(figure)
    shares = [row["within_total"] for row in rows]
    alone = [row["within_noise_alone"] for row in rows]
    spread = 1.96 * np.sqrt(0.683 * 0.317 / run.options.fits)
    good = all(row["interval_from"] <= GOAL[1] and row["interval_to"] >= GOAL[0] for row in rows)
    return (
        f"{100 * min(shares):.1f} to {100 * max(shares):.1f} % of {run.options.fits} fits (a tenth for particles) lie "
        f"within the total standard deviation, {100 * min(alone):.0f} to {100 * max(alone):.0f} % within that of "
        f"the noise alone; goal 63 to 73 % {'met' if good else 'MISSED'} "
        f"(68.3 % ± {100 * spread:.1f} % for 95 of 100 such counts)"
    )


if __name__ == "__main__":
    study(main, options)
