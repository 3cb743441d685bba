"""Which bands tell the temperature of a gray slab from its optical depth?

Expected standard deviations of (T, optical depth) for 1 % noise per band, over optical depth and sets of bands, and
the coverage of the claimed one-sigma intervals over 1000 noise draws at 1000 K and depth 1.
"""

import numpy as np

import jaxir
from jaxir.fit import Factor, Measurement, expected_uncertainty, measured_image, prepare, solve
from studies._study import Run, study, subplots

PIXEL = jaxir.orthographic_camera(0.0, 0.0, 0.1, (1, 1))
PARAMETERS = [Factor("temperature", lambda s: s.plume.temperature), Factor("depth", lambda s: s.plume.gas.coefficient)]
SETS = {
    "MWIR": (jaxir.MWIR,),
    "MWIR + LWIR": (jaxir.MWIR, jaxir.LWIR),
    "SWIR + MWIR + LWIR": (jaxir.SWIR, jaxir.MWIR, jaxir.LWIR),
}
THEORY = {("MWIR + LWIR", 1.0): (0.00738, 0.0388), ("SWIR + MWIR + LWIR", 1.0): (0.00311, 0.0240)}


def slab(depth: float) -> jaxir.Scene:
    grid = jaxir.Grid((-0.5, -0.5, -0.5), (1.0, 1.0, 1.0), (1, 1, 1))
    return jaxir.Scene(plumes=jaxir.GridPlume(grid, 1000.0, jaxir.GrayGas(depth)))


def measured(scene: jaxir.Scene, bands) -> Measurement:
    radiance = np.asarray(jaxir.render(scene, PIXEL, bands, samples=2).radiance)
    return measured_image(PIXEL, bands, radiance, 0.01 * radiance)


def coverage(draws: int) -> np.ndarray:
    truth = slab(1.0)
    one = measured(truth, SETS["SWIR + MWIR + LWIR"])
    problem = prepare(truth, PARAMETERS, [one])
    value, spread = np.asarray(one.value), np.asarray(one.standard_deviation)
    rng = np.random.default_rng(1)
    inside = []
    for _ in range(draws):
        found = solve(problem.with_values([value + spread * rng.normal(size=value.shape)])).uncertainty
        inside.append(np.abs(np.asarray(found.value) - 1) < np.asarray(found.standard_deviation))
    return np.mean(inside, axis=0)


def main(run: Run) -> str:
    depths = np.array([0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 3.0, 5.0])
    rows = []
    for name, bands in SETS.items():
        for depth in depths:
            scene = slab(depth)
            got = expected_uncertainty(scene, PARAMETERS, [measured(scene, bands)])
            rows.append([name, depth, *np.asarray(got.standard_deviation).tolist(), "; ".join(got.undetermined())])
    columns = ("bands", "optical_depth", "std_temperature_relative", "std_depth_relative", "not_determined")
    run.table([dict(zip(columns, row, strict=True)) for row in rows], digits=6)
    figure, axes = subplots(1, 2, figsize=(9, 3.6), sharex=True)
    for axis, column, title in zip(axes, (2, 3), ("temperature", "optical depth"), strict=True):
        for name in SETS:
            shown = np.array([row[column] for row in rows if row[0] == name])
            axis.loglog(depths, 100 * np.where(np.isfinite(shown), shown, np.nan), "o-", label=name)
        axis.set(title=title, xlabel="optical depth of the slab", ylabel="standard deviation [%]")
    axes[0].legend()
    run.chart(figure, dpi=100)
    covered = coverage(1000)
    worst = max(
        abs(row[2 + k] / THEORY[key][k] - 1)
        for row in rows
        for key in THEORY
        if key == (row[0], row[1])
        for k in (0, 1)
    )
    return (
        f"MWIR alone never separates temperature from depth; adding LWIR does up to depth 3 or so; standard deviations "
        f"differ from the closed form by {100 * worst:.2g} %; one-sigma coverage {100 * covered[0]:.1f} % (T), "
        f"{100 * covered[1]:.1f} % (depth) of 1000 draws"
    )


if __name__ == "__main__":
    study(main)
