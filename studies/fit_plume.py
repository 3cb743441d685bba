"""Can the state of an exhaust jet be read off its signature, and how fast?

Exit temperature, scale of the mole fractions and core length of a round jet of combustion products from three bands
and twelve aspects with 1 % noise; truth against fit with error bars, and cost against seconds beside scipy with finite
differences: on the traced residuals, and on `jaxir.signature`, which traces every time.
"""

import csv
import time

import equinox as eqx
import matplotlib
import numpy as np

import jaxir
from jaxir.fit import Bounds, Factor, Leaf, measured_intensity, prepare
from studies.charts import out_folder
from studies.fitting import error_bars, finite_differences, timed_solve

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

BANDS = (jaxir.SWIR, jaxir.MWIR, jaxir.LWIR)
VIEWS = [(30.0 * k, (10.0, 25.0, 50.0)[k % 3]) for k in range(12)]
NOISE = 0.01
TRUTH = np.array([1800.0, 1.0, 5.0])  # K, scale of the mole fractions, diameters
START = np.array([1200.0, 0.5, 8.0])
RASTER = {"shape": (64, 64), "samples": 2}
PRESSURE = 26_500.0  # Pa, at 10 km
EXHAUST = jaxir.combustion_products(12, 23, 0.8)
NODES = jaxir.resolved_nodes(BANDS, 200.0, 1, 0)  # the same for truth and fit, so what they leave out does not matter
PARAMETERS = [
    Leaf("exit temperature", lambda s: s.plume.exit_temperature, Bounds(0.0), "K"),
    Factor("mole fractions", lambda s: (s.plume.gas.h2o, s.plume.gas.co2)),
    Leaf("core length", lambda s: s.plume.core_length, Bounds(0.0), "diameters"),
]


def scene(temperature: float, scale: float, core: float) -> jaxir.Scene:
    gas = jaxir.NarrowBandGas(PRESSURE, EXHAUST.h2o * scale, EXHAUST.co2 * scale, None, EXHAUST.o2)
    jet = jaxir.JetPlume((0, 0, 0), (-1, 0, 0), 0.5, temperature, 218.0, gas, core_length=core, length=20.0, panels=2)
    return jaxir.Scene(plume=jet)


def main() -> None:
    out = out_folder("fit_plume")
    exact = np.asarray(jaxir.signature(scene(*TRUTH), VIEWS, NODES, shape=(192, 192), samples=2).intensity)
    spread = NOISE * exact
    noisy = exact + spread * np.random.default_rng(0).normal(size=exact.shape)
    start = scene(*START)
    began = time.perf_counter()
    problem = prepare(start, PARAMETERS, [measured_intensity(start, VIEWS, NODES, noisy, spread, **RASTER)])
    prepared = time.perf_counter() - began
    found, first, seconds = timed_solve(problem)

    def traced_anew(z: np.ndarray) -> np.ndarray:
        here = problem.coordinates.scene(problem.coordinates.values(z))
        return (np.asarray(jaxir.signature(here, VIEWS, NODES, **RASTER).intensity) - noisy).ravel() / spread.ravel()

    residual = eqx.filter_jit(lambda p, z: p.residual(z))
    origin = problem.coordinates.origin()
    baselines = {
        "scipy, rays kept": finite_differences(lambda z: residual(problem, z), origin),
        "scipy, rays traced anew": finite_differences(traced_anew, origin),
    }

    truth = TRUTH / np.array([1.0, START[1], 1.0])  # the factor is relative to the start
    value, deviation = np.asarray(found.uncertainty.value), np.asarray(found.uncertainty.standard_deviation)
    with (out / "fit_plume.csv").open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["parameter", "truth", "fit", "standard_deviation", "sampling_error"])
        rows = zip(found.uncertainty.labels, truth, value, deviation, np.asarray(found.sampling_error), strict=True)
        writer.writerows(rows)
        writer.writerow([])
        writer.writerow(["solver", "seconds", "evaluations", "chi_squared"])
        writer.writerow(["jaxir.fit", seconds, found.steps, float(found.chi_squared)])
        writer.writerows([name, b.seconds, b.calls, b.cost.min()] for name, b in baselines.items())
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.5, 3.6), layout="constrained")
    error_bars(left, found.uncertainty.labels, truth, found)
    left.set_title("12 aspects, 3 bands, 1 % noise")
    for name, baseline in baselines.items():
        right.loglog(baseline.at, np.minimum.accumulate(baseline.cost), drawstyle="steps-post", label=name)
    right.loglog([seconds], [float(found.chi_squared)], "o", label="jaxir.fit")
    right.set(xlabel="seconds, compilation apart", ylabel="chi-squared of the best point")
    right.legend()
    figure.savefig(out / "fit_plume.png", dpi=100)
    print(found)
    said = "; ".join(
        f"{name} {b.seconds:.1f} s = {b.seconds / seconds:.1f} times, {b.calls} evaluations, "
        f"chi-squared {b.cost.min():.1f}"
        for name, b in baselines.items()
    )
    print(
        f"worst deviation {np.abs((value - truth) / deviation).max():.1f} sigma; {seconds:.2f} s ({first:.1f} s with "
        f"compilation, {prepared:.1f} s to trace); {said}; see {out}/"
    )


if __name__ == "__main__":
    main()
