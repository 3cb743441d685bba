"""Where does each path estimator fail?

Maps the relative variance of one sample (closed form and measured) and the bias of the gradient over optical depths
1e-8 to 1e4 for four media of 32 cells (homogeneous, linear ramp of absorption, hot core, cold front), in float32 and
float64. The gradient is that along the logarithm of the absorption; its bias is judged only where a hundred of the
samples or more are absorbed, because a sample without events has no standard error. Beside it stands the gradient that
is naive: the same estimators differentiated at held random numbers, so that the place of absorption moves with the
medium and its weight does not.
"""

import argparse
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

import jaxir
from jaxir.geometry import Crossings
from jaxir.medium import crossing_sum
from studies._study import Run, study, subplots

CELLS, LENGTH = 32, 1 / 32
DEPTHS = 10.0 ** np.arange(-8, 5)
ESTIMATORS = {
    "exact sum": jaxir.CellSum(),
    "point": jaxir.PointIntegration(),
    "line": jaxir.LineIntegration(),
    "combined": jaxir.CombinedIntegration(),
}
X = (np.arange(CELLS) + 0.5) / CELLS
MEDIA = {  # absorption and source along the ray, near to far
    "homogeneous": (np.ones(CELLS), np.ones(CELLS)),
    "ramp": (X, np.ones(CELLS)),
    "hot core": (np.ones(CELLS), 0.01 + np.exp(-32 * (X - 0.5) ** 2)),
    "cold front": (np.ones(CELLS), np.where(X < 0.5, 0.01, 1.0)),
}


@jax.jit
def samples(path, lists, mu, j, behind, u):
    """Samples and their derivatives along the logarithm of the absorption."""
    return jax.jvp(lambda m, e: path.radiance(lists, m, e, behind, u), (mu, j), (mu, j))


@jax.jit
def closed(path, lists, mu, j, behind):
    exact = jax.jvp(lambda m, e: crossing_sum(lists, m, e, behind), (mu, j), (mu, j))
    return *exact, path.variance(lists, mu, j, behind)


@jax.jit
def naive(mu, j, u):
    """Derivatives along the logarithm of the absorption at held random numbers [estimator, sample]."""

    def one(u):
        x = -jnp.log1p(-u)

        def samples(mu, j):
            own = mu[:, 0] * LENGTH
            before = jnp.cumsum(own) - own
            come, source = jnp.clip(x - before, 0, own), j[:, 0] / mu[:, 0]
            absorbed = (x >= before) & (x < before + own)
            point = jnp.sum(jnp.where(absorbed, source, 0))
            line = jnp.sum(source * come)
            combined = jnp.sum(source * jnp.exp(-before) * -jnp.expm1(-come)) - jnp.expm1(-x) * point
            return jnp.stack([point, line, combined])

        return jax.jvp(samples, (mu, j), (mu, j))[1]

    return jax.vmap(one, out_axes=1)(u)


def rows_of(precision: str, count: int) -> list[dict]:
    rows = []
    dtype = np.dtype(precision)
    cell = jnp.arange(CELLS, dtype=jnp.int32)[None]
    one = Crossings(cell, jnp.full((1, CELLS), LENGTH, dtype))
    many = Crossings(jnp.tile(cell, (count, 1)), jnp.full((count, CELLS), LENGTH, dtype))
    u = jax.random.uniform(jax.random.key(1), (count,), dtype)
    dark = jnp.zeros((count, 1), dtype)
    for medium, (absorption, source) in tqdm(MEDIA.items(), desc=precision, leave=False):
        for depth in DEPTHS:
            mu = depth * absorption / (absorption.sum() * LENGTH)
            mu, j = (jnp.asarray(v[:, None], dtype) for v in (mu, mu * source))
            moved = np.asarray(naive(mu, j, u), np.float64)
            for place, (name, path) in enumerate(ESTIMATORS.items()):
                value, slope, variance = (float(v[0, 0]) for v in closed(path, one, mu, j, dark[:1]))
                got, got_slope = (np.asarray(v, np.float64)[:, 0] for v in samples(path, many, mu, j, dark, u))
                own = moved[place - 1]  # of no meaning for the exact sum
                rows.append(
                    {
                        "precision": precision,
                        "medium": medium,
                        "optical_depth": depth,
                        "estimator": name,
                        "radiance": value,
                        "mean_over_exact": got.mean() / value,
                        "standard_error": got.std() / value / count**0.5,
                        "relative_variance_theory": variance / value**2,
                        "relative_variance_measured": got.var() / value**2,
                        "gradient_bias_over_radiance": (got_slope.mean() - slope) / value,
                        "gradient_standard_error": got_slope.std() / value / count**0.5,
                        "naive_gradient_bias_over_radiance": (own.mean() - slope) / value if place else 0.0,
                        "naive_gradient_standard_error": own.std() / value / count**0.5 if place else 0.0,
                        "finite": bool(np.isfinite(got).all() and np.isfinite(got_slope).all()),
                    }
                )
    return rows


def chart(rows: list[dict], count: int) -> Any:
    figure, axes = subplots(3, len(MEDIA), figsize=(14, 9), sharex=True, sharey="row")
    for column, medium in enumerate(MEDIA):
        for colour, name in zip(("C0", "C1", "C2"), list(ESTIMATORS)[1:], strict=True):
            for precision, mark in (("float32", "x"), ("float64", "o")):
                own = [r for r in rows if (r["medium"], r["estimator"], r["precision"]) == (medium, name, precision)]
                depth = [r["optical_depth"] for r in own]
                axis = axes[0, column]
                if precision == "float64":
                    axis.loglog(depth, [max(r["relative_variance_theory"], 1e-12) for r in own], colour, label=name)
                axis.loglog(depth, [max(r["relative_variance_measured"], 1e-12) for r in own], colour + mark, ms=4)
                off = [r["gradient_bias_over_radiance"] / max(r["gradient_standard_error"], 1e-30) for r in own]
                judged = np.array(depth) * count >= 100
                off = np.where(judged & (np.abs(off) < 1e3), off, np.nan)
                axes[1, column].semilogx(depth, off, colour + mark, ms=4)
                if precision == "float64":
                    for key, style in (("naive_gradient", "--"), ("gradient", "o")):
                        bias = np.array([r[f"{key}_bias_over_radiance"] for r in own])
                        error = np.array([r[f"{key}_standard_error"] for r in own])
                        good = judged & (error < 0.1)
                        axes[2, column].semilogx(depth, np.where(good, bias, np.nan), colour + style, ms=4)
        axes[0, column].set_title(medium)
        axes[0, column].set_ylim(1e-10, 1e10)
        axes[1, column].axhspan(-3, 3, color="0.9", zorder=0)
        axes[2, column].axhline(0, color="0.6", lw=0.8, zorder=0)
        axes[2, column].set_xlabel("optical depth")
    axes[0, 0].set_ylabel("relative variance of a sample")
    axes[1, 0].set_ylabel("gradient: bias / standard error")
    axes[2, 0].set_ylabel("gradient: bias / radiance\n(dashes: naive, circles: detached)")
    axes[0, 0].legend()
    figure.suptitle("lines: closed form; crosses: float32, circles: float64")
    return figure


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--samples", type=int, default=20000, help="per point of the map (%(default)s)")


def main(run: Run) -> str:
    chosen = run.options
    rows = []
    for precision in ("float32", "float64"):
        with jax.enable_x64(precision == "float64"):
            rows += rows_of(precision, chosen.samples)
    run.table(rows, digits=6)
    run.chart(chart(rows, chosen.samples), dpi=80)
    half = len(rows) // 2
    apart = max(abs(a["radiance"] / b["radiance"] - 1) for a, b in zip(rows[:half], rows[half:], strict=True))
    worst = {
        name: max((r for r in rows if r["estimator"] == name), key=lambda r: r["relative_variance_theory"])
        for name in list(ESTIMATORS)[1:]
    }
    said = ", ".join(
        f"{n} {r['relative_variance_theory']:.2g} ({r['medium']}, {r['optical_depth']:.0e})" for n, r in worst.items()
    )
    said_naive = []
    for name in list(ESTIMATORS)[1:]:
        own = [r for r in rows[half:] if r["estimator"] == name and r["optical_depth"] * chosen.samples >= 100]
        off = [(r, r["naive_gradient_bias_over_radiance"], 4 * r["naive_gradient_standard_error"]) for r in own]
        sure = [
            (abs(bias), f"{bias:+.2g} ({r['medium']}, {r['optical_depth']:.0e})") for r, bias, e in off if abs(bias) > e
        ]
        said_naive.append(f"{name} {max(sure)[1] if sure else 'not at all'}")
    bad = sum(not r["finite"] for r in rows)
    return (
        f"largest relative variance of a sample: {said}; the exact sum has none and float32 is within {apart:.1e} of "
        f"float64; naive gradients are off by {', '.join(said_naive)} of the radiance; {bad} results are not finite"
    )


if __name__ == "__main__":
    study(main, options)
