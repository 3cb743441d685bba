"""Can the emissivities of an aircraft's parts be read off its signature?

Four parts, three bands, twelve aspects, 1 % noise; truth against fit with error bars, one-sigma coverage over noise
draws, and the same fit by scipy with finite differences.
"""

import equinox as eqx
import numpy as np
from tqdm import tqdm

import jaxir
from jaxir.fit import measured_intensity, part_emissivity, prepare, solve
from studies import aircraft
from studies._study import Run, study, subplots
from studies.fitting import error_bars, finite_differences, timed_solve

PARTS = ("nose", "fuselage", "wings", "tails")
TRUTH = np.array([0.85, 0.7, 0.4, 0.55])
BANDS = (jaxir.SWIR, jaxir.MWIR, jaxir.LWIR)
VIEWS = [(30.0 * k, (10.0, 25.0, 50.0)[k % 3]) for k in range(12)]
NOISE = 0.01
DRAWS = 1000  # of noise, for coverage
FINE = {"shape": (96, 96), "samples": 8}  # rays enough that their error stays below the noise
COARSE = {"shape": (32, 32), "samples": 2}  # for coverage, where truth and fit share their rays


def scene(emissivity: np.ndarray) -> jaxir.Scene:
    vertices, faces, part = aircraft.generic_aircraft(0.3)
    per_face = np.append(emissivity, 0.9)[part]  # the nozzle's is known
    skin = jaxir.Skin(
        jaxir.Mesh(vertices, faces),
        aircraft.skin_temperature(vertices, faces),
        jaxir.Lambert(per_face),
        part,
        aircraft.PARTS,
    )
    return jaxir.Scene(skin, sources=(jaxir.ParallelSource((0.0, 0.0, -1.0), (10.0, 1.0, 0.05)),))


def main(run: Run) -> str:
    start = scene(np.full(4, 0.6))
    signature = jaxir.signature(scene(TRUTH), VIEWS, BANDS, shape=(256, 256), samples=8)
    exact = np.asarray(signature.intensity)
    spread = NOISE * exact
    rng = np.random.default_rng(0)
    noisy = exact + spread * rng.normal(size=exact.shape)
    parameters = [part_emissivity(part) for part in PARTS]
    problem = prepare(start, parameters, [measured_intensity(start, VIEWS, BANDS, noisy, spread, **FINE)])
    found, first, seconds = timed_solve(problem)
    residual = eqx.filter_jit(lambda p, z: p.residual(z))
    baseline = finite_differences(lambda z: residual(problem, z), problem.coordinates.origin())

    quick = prepare(start, parameters, [measured_intensity(start, VIEWS, BANDS, noisy, spread, **COARSE)])
    reference = np.asarray(quick.observations[0].predict_halves(scene(TRUTH)).mean(axis=(0, 1)))
    inside = []
    for _ in tqdm(range(DRAWS), desc="coverage", leave=False):
        drawn = quick.with_values([reference + spread * rng.normal(size=exact.shape)])
        got = solve(drawn, max_samples=COARSE["samples"]).uncertainty  # more rays would not be those of the truth
        inside.append(np.abs(np.asarray(got.value) - TRUTH) < np.asarray(got.standard_deviation))
    coverage = np.mean(inside, axis=0)

    value, deviation = np.asarray(found.uncertainty.value), np.asarray(found.uncertainty.standard_deviation)
    columns = ("part", "truth", "fit", "standard_deviation", "coverage")
    rows = zip(PARTS, TRUTH, value, deviation, coverage, strict=True)
    run.table([dict(zip(columns, row, strict=True)) for row in rows], digits=6)
    figure, axis = subplots(figsize=(5, 3.4))
    error_bars(axis, PARTS, TRUTH, found)
    axis.set_title("emissivity from 12 aspects, 3 bands, 1 % noise")
    run.chart(figure, dpi=100)
    print(found)
    coverage_said = f"{100 * coverage.min():.1f} to {100 * coverage.max():.1f} % of {DRAWS} draws"
    return (
        f"worst deviation {np.abs((value - TRUTH) / deviation).max():.1f} sigma; one-sigma coverage {coverage_said}; "
        f"{seconds:.2f} s ({first:.1f} s with compilation) against {baseline.seconds:.2f} s "
        f"and {baseline.calls} evaluations of scipy with finite differences, chi-squared "
        f"{float(found.chi_squared):.1f} against {baseline.cost.min():.1f}"
    )


if __name__ == "__main__":
    study(main)
