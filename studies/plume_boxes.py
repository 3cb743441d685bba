"""What do the paper's gray boxes radiate over aspect, and at what error does each estimator give it? (Figs. 9, 10).

Yu et al. (10.3788/IRLA20200241), section 2.2: a thick box (2 x 2 x 2 m, absorption 10 m-1, source 10) and a thin one
(2 x 2 x .5 m, .01 m-1, 1e4), homogeneous, in orthographic views tilted by 0 to 80 degrees about the height. Parallel
rays cross the silhouette in the middle of `--columns` strips; the closed form is integrated over the silhouette.
"""

import argparse
import time

import jax
import jax.numpy as jnp
import numpy as np

import jaxir
from jaxir.geometry import Rays, crossings
from studies._study import Run, study, subplots

BOXES = {"thick": (2.0, 2.0, 2.0, 10.0, 10.0), "thin": (2.0, 0.5, 2.0, 0.01, 1e4)}  # width, depth, height, kappa, B
ANGLES = np.arange(0.0, 81.0, 10.0)
RAYS = (1, 10, 100)
ESTIMATORS = {
    "point": jaxir.PointIntegration(),
    "line": jaxir.LineIntegration(),
    "combined": jaxir.CombinedIntegration(),
    "exact sum": jaxir.CellSum(),
}


def closed_form(width, depth, height, kappa, source, degrees):
    """Radiant intensity [W/sr]."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    reach = min(width / s if s > 0 else np.inf, depth / c)
    side, full = min(width * c, depth * s), -np.expm1(-kappa * reach)
    return source * height * (abs(width * c - depth * s) * full + 2 * side * (1 - full / (kappa * reach)))


@jax.jit
def mean(path, lists, mu, j, behind, keys):
    """Mean radiance over the rays of each pixel [pixel]."""

    def one(total, key):
        u = jax.random.uniform(key, (behind.shape[0],), behind.dtype)
        return total + path.radiance(lists, mu, j, behind, u), None

    return jax.lax.scan(one, jnp.zeros_like(behind), keys)[0][:, 0] / keys.shape[0]


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--columns", type=int, default=500, help="strips across the silhouette (%(default)s)")


def main(run: Run) -> str:
    chosen = run.options
    rows = []
    for box, (width, depth, height, kappa, source) in BOXES.items():
        grid = jaxir.Grid((-depth / 2, -width / 2, 0.0), (depth / 4, width / 4, height), (4, 4, 1))
        mu = jnp.full((16, 1), kappa)
        for degrees in ANGLES:
            c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
            span = width * c + depth * s
            offset = span * ((np.arange(chosen.columns) + 0.5) / chosen.columns - 0.5)
            start = offset[:, None] * np.array([-s, c, 0]) + np.array([4 * c, 4 * s, height / 2])
            towards = jnp.tile(jnp.array([[-c, -s, 0.0]]), (chosen.columns, 1))
            lists = crossings(grid, Rays(jnp.asarray(start), towards), jnp.full(chosen.columns, jnp.inf))
            behind = jnp.zeros((chosen.columns, 1))
            exact = closed_form(width, depth, height, kappa, source, degrees)
            for name, path in ESTIMATORS.items():
                for count in RAYS:
                    key = jax.random.fold_in(jax.random.key(0), len(rows))  # every case draws its own numbers
                    keys = jax.random.split(key, count)
                    mean(path, lists, mu, source * mu, behind, keys).block_until_ready()
                    began = time.process_time()
                    got = np.asarray(mean(path, lists, mu, source * mu, behind, keys), np.float64)
                    seconds = time.process_time() - began
                    spread = np.asarray(path.variance(lists, mu, source * mu, behind), np.float64).sum() / count
                    intensity = got.sum() * span / chosen.columns * height
                    rows.append(
                        {
                            "box": box,
                            "degrees": degrees,
                            "estimator": name,
                            "rays": count,
                            "closed_form": exact,
                            "intensity": intensity,
                            "error_percent": 100 * (intensity / exact - 1),
                            "expected_error_percent": 100 * spread**0.5 * span / chosen.columns * height / exact,
                            "seconds": seconds,
                        }
                    )
    run.table(rows, digits=6)
    figure, axes = subplots(2, 3, figsize=(13, 7))
    for line, box in enumerate(BOXES):
        for colour, name in enumerate(ESTIMATORS):
            own = [r for r in rows if (r["box"], r["estimator"]) == (box, name)]
            single = [r for r in own if r["rays"] == 1]
            axes[line, 0].plot(ANGLES, [r["intensity"] for r in single], f"C{colour}o", ms=4, label=name)
            rms = {n: np.mean([r["error_percent"] ** 2 for r in own if r["rays"] == n]) ** 0.5 for n in RAYS}
            cost = {n: np.median([r["seconds"] for r in own if r["rays"] == n]) for n in RAYS}
            axes[line, 1].loglog(RAYS, [rms[n] for n in RAYS], f"C{colour}o-")
            axes[line, 2].loglog([cost[n] for n in RAYS], [rms[n] for n in RAYS], f"C{colour}o")
        axes[line, 0].plot(ANGLES, [r["closed_form"] for r in single], "k", lw=0.8, label="closed form")
        axes[line, 0].set_ylabel(f"{box} box [W/sr], 1 ray")
        axes[line, 1].set_ylabel("error of the intensity [%]")
    for axis, label in zip(axes[1], ("aspect [deg]", "rays per pixel", "seconds"), strict=True):
        axis.set_xlabel(label)
    axes[0, 0].legend()
    run.chart(figure, dpi=80)

    def worst(name: str, box: str) -> float:
        return max(r["expected_error_percent"] for r in rows if (r["estimator"], r["box"], r["rays"]) == (name, box, 1))

    sampled = list(ESTIMATORS)[:3]
    said = "; ".join(f"{box} box: " + ", ".join(f"{n} {worst(n, box):.2g} %" for n in sampled) for box in BOXES)
    sums = max(abs(r["error_percent"]) for r in rows if r["estimator"] == "exact sum")
    return (
        f"expected error at one ray a pixel, worst aspect: {said}; the exact sum errs by {sums:.1e} % (the strips' "
        f"midpoint rule)"
    )


if __name__ == "__main__":
    study(main, options)
