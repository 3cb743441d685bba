"""Can a plume's temperature field be read off images of it, cell by cell?

1,440 cells of a gray plume from three views in two bands with 1 % noise, and the knowledge that neighbours differ
little: truth, fit, their difference and the standard deviation that the fit claims. A finite-difference gradient would
take one evaluation per cell; its time is extrapolated from one evaluation.
"""

import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

import jaxir
from jaxir.fit import Bounds, Leaf, SmoothPrior, measured_image, prepare, solve
from studies._study import Run, study, subplots

SHAPE = (24, 10, 6)
SPACING = (0.25, 0.1, 0.1)
GRID = jaxir.Grid((-3.0, -0.5, -0.3), SPACING, SHAPE)
BANDS = (jaxir.MWIR, jaxir.LWIR)
NOISE = 0.01
STEP = 60.0  # K, between neighbours: of the order of the true field's
START = 700.0  # K, everywhere
CAMERAS = [jaxir.orthographic_camera(*aspect, 0.15, (12, 44)) for aspect in ((90, 0), (90, 90), (60, 35))]
FIELD = [Leaf("temperature", lambda s: s.plume.temperature, Bounds(0.0), "K")]


def true_field() -> np.ndarray:
    """A hot core that cools and bends as it leaves [K]."""
    centre = np.asarray(GRID.centres(), np.float64)
    s = (3.0 - centre[..., 0]) / 6.0
    r2 = (centre[..., 1] - 0.15 * s**2) ** 2 + centre[..., 2] ** 2
    return 450.0 + 900.0 * np.exp(-1.2 * s) * np.exp(-r2 / (0.15 + 0.2 * s) ** 2)


def scene(temperature) -> jaxir.Scene:
    return jaxir.Scene(plumes=jaxir.GridPlume(GRID, temperature, jaxir.GrayGas(0.6)))


def measured(truth: np.ndarray) -> list:
    rng = np.random.default_rng(0)
    found = []
    for camera in CAMERAS:
        radiance = np.asarray(jaxir.render(scene(truth), camera, BANDS, samples=72).radiance)
        spread = NOISE * radiance + 1e-3 * radiance.max((0, 1))  # a floor where hardly anything is seen
        noisy = radiance + spread * rng.normal(size=radiance.shape)
        found.append(measured_image(camera, BANDS, noisy, spread, samples=72))
    return found


def main(run: Run) -> str:
    truth = true_field()
    problem = prepare(scene(START), FIELD, measured(truth), priors={"temperature": SmoothPrior(SHAPE, STEP)})
    began = time.perf_counter()
    found = solve(problem, solver=optx.LBFGS(rtol=1e-6, atol=1e-4), max_steps=3000)
    seconds = time.perf_counter() - began
    value = np.asarray(found.uncertainty.value, np.float64).reshape(SHAPE)
    spread = np.asarray(found.uncertainty.standard_deviation, np.float64).reshape(SHAPE)
    off = (value - truth) / spread

    z = problem.coordinates.origin()
    loss = eqx.filter_jit(lambda p, z: jnp.sum(p.residual(z) ** 2))
    gradient = eqx.filter_jit(lambda p, z: jax.grad(lambda z: jnp.sum(p.residual(z) ** 2))(z))
    taken = []
    for function in (loss, gradient):
        jax.block_until_ready(function(problem, z))
        began = time.perf_counter()
        for _ in range(5):
            jax.block_until_ready(function(problem, z))
        taken.append((time.perf_counter() - began) / 5)

    place, columns = np.asarray(GRID.centres()).reshape(-1, 3), ("x", "y", "z", "truth", "fit", "standard_deviation")
    rows = zip(*place.T, truth.ravel(), value.ravel(), spread.ravel(), strict=True)
    run.table([dict(zip(columns, row, strict=True)) for row in rows], digits=6)
    layer = SHAPE[2] // 2
    panels = (("truth", truth), ("fit", value), ("fit − truth", value - truth), ("claimed deviation", spread))
    figure, axes = subplots(4, 1, figsize=(7, 8), sharex=True)
    for axis, (title, field) in zip(axes, panels, strict=True):
        shown = field[:, :, layer].T
        low, high = (truth.min(), truth.max()) if title in ("truth", "fit") else (None, None)
        drawn = axis.imshow(shown, vmin=low, vmax=high, origin="lower", extent=(-3, 3, -0.5, 0.5), cmap="inferno")
        axis.set(title=f"{title} [K], middle layer", ylabel="y [m]")
        figure.colorbar(drawn, ax=axis)
    axes[-1].set_xlabel("x [m]")
    run.chart(figure, dpi=90)
    inside = 100 * np.mean(np.abs(off) < 1)
    return (
        f"{truth.size} temperatures from {problem.data} numbers in {seconds:.0f} s and {found.steps} steps, "
        f"chi-squared {float(found.chi_squared):.0f}; rms error {np.sqrt(np.mean((value - truth) ** 2)):.1f} K, "
        f"claimed {np.sqrt(np.mean(spread**2)):.1f} K, {inside:.0f} % of the cells within one deviation, worst "
        f"{np.abs(off).max():.1f}; one reverse pass costs {taken[1] / taken[0]:.1f} evaluations, finite differences "
        f"would cost {truth.size}: "
        f"{taken[0] * truth.size:.1f} s a gradient instead of {taken[1]:.3f} s (extrapolated)"
    )


if __name__ == "__main__":
    study(main)
