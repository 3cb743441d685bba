"""Can the state of an exhaust jet be read off its signature, and how fast?

Exit temperature, scale of the mole fractions, core length and soot of a round jet of combustion products from three
bands and twelve aspects with 1 % noise; truth against fit with error bars, and cost against seconds beside scipy with
finite differences on the traced residuals and on `jaxir.signature`, which traces every time, and beside Gauss and
Newton's steps with automatic Jacobians that trace every time.
"""

import time

import equinox as eqx
import jax
import numpy as np

import jaxir
from jaxir.fit import jet_parameter, measured_intensity, mole_fraction_scale, particle_loading, prepare
from jaxir.optics.particle import ParticleTable
from studies._study import Run, judge, study, subplots
from studies.fitting import error_bars, finite_differences, timed_solve, tracing_every_step

BANDS = (jaxir.SWIR, jaxir.MWIR, jaxir.LWIR)
VIEWS = [(30.0 * k, (10.0, 25.0, 50.0)[k % 3]) for k in range(12)]
NOISE = 0.01
TRUTH = np.array([1800.0, 1.0, 5.0, 1.0])  # K, scale of the mole fractions, diameters, scale of the soot
START = np.array([1200.0, 0.5, 8.0, 1 / 3])
EQUAL = 0.3  # of chi-squared, within which two residuals count as equal
GOALS = {"scipy, rays kept": 20, "scipy, rays traced anew": 20, "Jacobians, rays traced anew": 10}  # times as fast
RASTER = {"shape": (64, 64), "samples": 2}
PRESSURE = 26_500.0  # Pa, at 10 km
EXHAUST = jaxir.combustion_products(12, 23, 0.8)
NODES = jaxir.resolved_nodes(BANDS, 200.0, 1, 0)  # the same for truth and fit, so what they leave out does not matter
PARAMETERS = [
    jet_parameter("exit_temperature"),
    mole_fraction_scale(),
    jet_parameter("core_length"),
    particle_loading(),
]
RELATIVE = np.array([1.0, START[1], 1.0, START[3]])  # factors are relative to the start
SOOT_VOLUME = 5e-8  # of soot in exhaust at the nozzle, as a share of the gas's: an optical depth of some 0.1
METHOD = jaxir.Method(orders=0)  # soot this fine absorbs; the study prints how little it scatters


def soot_index(wavelength: np.ndarray) -> np.ndarray:
    """Refractive index n - ik of flame soot at wavelengths [um].

    Chang and Charalampopoulos, "Determination of the wavelength dependence of refractive indices of flame soot", Proc.
    R. Soc. Lond. A 430 (1990): polynomials in the logarithm of the wavelength for 0.4 to 30 um, as several
    public codes print them. A transcription of the paper's table for soot at one height of the flame differs from
    them by up to 10 % in n and 17 % in k between 1 and 11 um; measured was soot up to 6.4 um, beyond that it is a
    dispersion model.
    """
    powers = np.log(wavelength)[:, None] ** np.arange(4)
    return powers @ [1.811, 0.1263, 0.0270, 0.0417] - 1j * (powers @ [0.5821, 0.1213, 0.2309, -0.0100])


def soot() -> ParticleTable:
    """Spheres of 50 nm of flame soot."""
    wavelength = np.geomspace(1.0, 12.5, 61)
    return jaxir.mie_table(0.05, soot_index(wavelength), wavelength)


def scene(temperature: float, scale: float, core: float, load: float, table: ParticleTable) -> jaxir.Scene:
    # scipy's steps leave the temperatures for which the gas was made
    composition = {"h2o": EXHAUST.h2o * scale, "co2": EXHAUST.co2 * scale, "o2": EXHAUST.o2}
    gas = jaxir.NarrowBandGas(PRESSURE, **composition, extrapolate=True)
    particles = jaxir.Particles(load * SOOT_VOLUME / float(table.volume), table)
    place, shape = ((0, 0, 0), (-1, 0, 0), 0.5), {"core_length": core, "length": 20.0, "panels": 2}
    return jaxir.Scene(plumes=jaxir.JetPlume(*place, temperature, 218.0, gas, particles=particles, **shape))


def main(run: Run) -> str:
    table = soot()
    seen = {"method": METHOD, "key": jax.random.key(1)}
    truly = scene(*TRUTH, table)
    exact = np.asarray(jaxir.signature(truly, VIEWS, NODES, shape=(192, 192), samples=2, **seen).intensity)
    spread = NOISE * exact
    noisy = exact + spread * np.random.default_rng(0).normal(size=exact.shape)
    start = scene(*START, table)
    began = time.perf_counter()
    measured = measured_intensity(start, VIEWS, NODES, noisy, spread, method=METHOD, **RASTER)
    problem = prepare(start, PARAMETERS, [measured])
    prepared = time.perf_counter() - began
    found, first, seconds = timed_solve(problem)

    def traced_anew(z: np.ndarray) -> np.ndarray:
        here = problem.coordinates.scene(problem.coordinates.values(z))
        there = np.asarray(jaxir.signature(here, VIEWS, NODES, **RASTER, **seen).intensity)
        return (there - noisy).ravel() / spread.ravel()

    residual = eqx.filter_jit(lambda p, z: p.residual(z))
    origin = problem.coordinates.origin()
    baselines = {
        "scipy, rays kept": finite_differences(lambda z: residual(problem, z), origin),
        "scipy, rays traced anew": finite_differences(traced_anew, origin),
        "Jacobians, rays traced anew": tracing_every_step(problem, 30),
    }
    seconds = (seconds + timed_solve(problem)[2]) / 2  # before and after the baselines: a machine's pace drifts

    truth = TRUTH / RELATIVE
    value, deviation = np.asarray(found.uncertainty.value), np.asarray(found.uncertainty.standard_deviation)
    columns = ("parameter", "truth", "fit", "standard_deviation", "sampling_error")
    fitted = zip(found.uncertainty.labels, truth, value, deviation, np.asarray(found.sampling_error), strict=True)
    run.table([dict(zip(columns, row, strict=True)) for row in fitted], digits=6)
    columns = ("solver", "seconds", "evaluations", "chi_squared")
    solvers = [("jaxir.fit", seconds, found.steps, float(found.chi_squared))]
    solvers += [(name, b.seconds, b.calls, b.cost.min()) for name, b in baselines.items()]
    run.table([dict(zip(columns, row, strict=True)) for row in solvers], "fit_plume_solvers", digits=6)
    figure, (left, right) = subplots(1, 2, figsize=(9.5, 3.6))
    error_bars(left, found.uncertainty.labels, truth, found)
    left.set_title("12 aspects, 3 bands, 1 % noise")
    for name, baseline in baselines.items():
        right.loglog(baseline.at, np.minimum.accumulate(baseline.cost), drawstyle="steps-post", label=name)
    right.loglog([seconds], [float(found.chi_squared)], "o", label="jaxir.fit")
    right.set(xlabel="seconds, compilation apart", ylabel="chi-squared of the best point")
    right.legend(loc="center left", fontsize="small")
    run.chart(figure, dpi=100)
    print(found)
    albedo = np.asarray(table.scattering / table.extinction)
    print(f"soot scatters {100 * albedo.max():.2g} % of what it takes at 1 um and less beyond, which is left out")
    for name, b in baselines.items():
        as_good = b.at[b.cost < float(found.chi_squared) + EQUAL]  # its first point as good as the fit's
        spent = as_good[0] if as_good.size else b.seconds
        print(
            f"{name}: {b.seconds:.1f} s, {b.calls} evaluations, chi-squared {b.cost.min():.2f}"
            + (f", as good as the fit after {spent:.1f} s" if as_good.size else ", never as good as the fit")
        )
        print("  " + judge("times as fast", b.seconds / seconds, GOALS[name]))
    return (
        f"worst deviation {np.abs((value - truth) / deviation).max():.1f} sigma; {seconds:.2f} s ({first:.1f} s with "
        f"compilation, {prepared:.1f} s to trace), chi-squared {float(found.chi_squared):.2f}"
    )


if __name__ == "__main__":
    study(main)
