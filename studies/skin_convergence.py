"""How fast does the light of a disc on a plate converge? Table 1 and Fig. 8 of Yu et al. (2021).

A plate of 1 m2 and reflectance .5 under a disc of radius 1 m and radiance 100 W m-2 sr-1. The paper does not say where
the disc is; 1.8 m above the plate, 1.2 m aside along both edges, gives its numbers, once an image is clipped at 12.75
and truncated to 8 bits, as images on a screen are. Errors are relative root mean squares over pixels against the
closed form.
"""

import argparse
import time
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

import jaxir
from jaxir.geometry import Rays
from studies._study import Run, study, subplots

NODES = jaxir.gray_nodes((jaxir.MWIR,))
HEIGHT, OFFSET, RADIUS, RADIANCE, REFLECTANCE = 1.8, 1.2, 1.0, 100.0, 0.5
RAYS = (1, 10, 100, 1000, 10000)
PAPER = {"brdf": (1.143, 0.938, 0.320, 0.1035, 0.0364), "both": (0.494, 0.163, 0.0522, 0.01785, 0.00852)}
EVEN = (1, 4, 16, 64, 256, 1024, 4096)
SAMPLES_AT_ONCE = 1 << 18


def scene() -> jaxir.Scene:
    corners = [[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]]
    mesh = jaxir.Mesh(corners, [[0, 1, 2], [0, 2, 3]])
    disc = jaxir.DiscSource([OFFSET, OFFSET, HEIGHT], [0.0, 0.0, -1.0], RADIUS, RADIANCE)
    return jaxir.Scene(jaxir.Skin(mesh, 3.0, jaxir.Lambert(1 - REFLECTANCE)), sources=(disc,))


def closed_form(points: np.ndarray) -> np.ndarray:
    """Reflected radiance by the form factor of a disc (Howell, B-13), in double precision."""
    a2, h2, r2 = np.sum((points - OFFSET) ** 2, axis=-1), HEIGHT**2, RADIUS**2
    factor = 0.5 * (1 - (a2 + h2 - r2) / np.sqrt((a2 + h2 + r2) ** 2 - 4 * r2 * a2))
    return REFLECTANCE * RADIANCE * factor


@eqx.filter_jit
def radiance(world: jaxir.Scene, rays: Rays, method: jaxir.Method, key: jax.Array) -> jax.Array:
    return jaxir.evaluate(world.on(NODES), jaxir.trace(world, rays, method, key))[:, 0]


def image(world: jaxir.Scene, points: np.ndarray, method: jaxir.Method, key: jax.Array) -> tuple[np.ndarray, float]:
    """Radiance at every point, and CPU seconds without compilation."""
    size = int(np.clip(SAMPLES_AT_ONCE // max(sum(method.counts), 1), 16, len(points)))
    parts, seconds = [], 0.0
    for begin in range(0, len(points), size):
        own = points[begin : begin + size]
        origin = jnp.asarray(np.column_stack([own, np.full(len(own), 0.5)]), jnp.float32)
        rays = Rays(origin, jnp.broadcast_to(jnp.asarray([0.0, 0.0, -1.0]), origin.shape))
        one = jax.random.fold_in(key, begin)
        if begin == 0:
            radiance(world, rays, method, one).block_until_ready()
        started = time.process_time()
        parts.append(np.asarray(radiance(world, rays, method, one), float))
        seconds += time.process_time() - started
    return np.concatenate(parts), seconds


def rrmse(got: np.ndarray, expected: np.ndarray) -> float:
    return float(np.sqrt(np.mean((got / expected - 1) ** 2)))


def quantised(value: np.ndarray) -> np.ndarray:
    """Clipped at 12.75 and truncated to 8 bits."""
    return np.floor(np.minimum(value, 12.75) / 12.75 * 255) / 255 * 12.75


def methods(count: int, even: bool) -> dict[str, jaxir.Method]:
    both = jaxir.DirectSampling(count, count)
    if even:
        return {
            "both, Sobol": jaxir.Method(both, sampler=jaxir.Sobol()),
            "light, Sobol": jaxir.Method(jaxir.DirectSampling(count, 0), sampler=jaxir.Sobol()),
        }
    return {"brdf": jaxir.Method(jaxir.DirectSampling(0, count)), "both": jaxir.Method(both)}


def measure(pixels: int) -> tuple[list[dict], float, dict[tuple[str, int], np.ndarray]]:
    """One row per method and number of rays; the error of the closed form in float32; the images of Table 1."""
    x = (np.arange(pixels) + 0.5) / pixels - 0.5
    points = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2)
    world, expected, rows, images = scene(), closed_form(points), [], {}
    cases = [(n, False) for n in RAYS] + [(n, True) for n in EVEN]
    for count, even in tqdm(cases, desc="skin_convergence", delay=5, leave=False):
        for name, method in methods(count, even).items():
            got, seconds = image(world, points, method, jax.random.key(count))
            if name in PAPER:
                images[name, count] = got.reshape(pixels, pixels)
            rows.append(
                {
                    "method": name,
                    "rays": count,
                    "rrmse": rrmse(got, expected),
                    "rrmse_8_bit": rrmse(quantised(got), expected),
                    "paper": PAPER[name][RAYS.index(count)] if name in PAPER else "",
                    "seconds": seconds,
                }
            )
    exact, _ = image(world, points, jaxir.Method(jaxir.ClosedForm()), jax.random.key(0))
    images["closed form", 0] = exact.reshape(pixels, pixels)
    return rows, rrmse(exact, expected), images


def chart(rows: list[dict]) -> Any:
    figure, axes = subplots(1, 2, figsize=(11, 4.6), sharey=True)
    for name in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == name]
        for axis, against in zip(axes, ("rays", "seconds"), strict=True):
            line = axis.plot([r[against] for r in own], [100 * r["rrmse"] for r in own], "o-", ms=4, label=name)
        if name in PAPER:
            axes[0].plot(RAYS, 100 * np.array(PAPER[name]), "x", color=line[0].get_color(), label=f"{name}, paper")
            axes[0].plot(
                RAYS, [100 * r["rrmse_8_bit"] for r in own], ":", color=line[0].get_color(), label=f"{name}, 8 bits"
            )
    axes[0].set(xlabel="samples of each kind per pixel", ylabel="relative RMS error [%]")
    axes[1].set(xlabel="CPU seconds for the image, compilation apart")
    for axis in axes:
        axis.set(xscale="log", yscale="log")
        axis.grid(alpha=0.3, which="both")
    axes[0].legend(fontsize=8)
    return figure


def table_of_images(images: dict[tuple[str, int], np.ndarray]) -> Any:
    """Table 1: the plate by samples of the brdf alone and with samples of the light, and in closed form."""
    names = {"brdf": "brdf", "both": "brdf and light"}
    figure, axes = subplots(len(names), len(RAYS) + 1, figsize=(15, 5.2))
    last = images["closed form", 0]
    for row, (key, name) in enumerate(names.items()):
        drawn = [(f"{name}, {count}", images[key, count]) for count in RAYS] + [("closed form", last)]
        for axis, (title, value) in zip(axes[row], drawn, strict=True):
            shown = axis.imshow(value.T, origin="lower", cmap="inferno", vmin=0.0, vmax=last.max())
            axis.set_title(title, fontsize=10)
            axis.set_axis_off()
    figure.colorbar(shown, ax=axes, label="reflected radiance [W m$^{-2}$ sr$^{-1}$]", shrink=0.8)
    return figure


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--pixels", type=int, default=64, help="rows and columns (%(default)s)")


def main(run: Run) -> str:
    chosen = run.options
    rows, exact, images = measure(chosen.pixels)
    run.table(rows)
    run.chart(chart(rows), dpi=90)
    run.chart(table_of_images(images), "skin_convergence_images", dpi=90)
    print("rays     brdf sampling [%]: paper  8 bit  float     both [%]: paper  8 bit  float")
    for count in RAYS:
        b, m = (next(r for r in rows if r["method"] == name and r["rays"] == count) for name in ("brdf", "both"))
        cells = [100 * r[k] for r in (b, m) for k in ("paper", "rrmse_8_bit", "rrmse")]
        widths = (25, 6, 6, 19, 6, 6)
        print(f"{count:6d} " + " ".join(f"{cell:{width}.4g}" for cell, width in zip(cells, widths, strict=True)))
    even = {row["rays"]: row["rrmse"] for row in rows if row["method"] == "light, Sobol"}
    return (
        f"relative RMS error: {100 * even[64]:.2g} % at 64 and {100 * even[1024]:.2g} % at 1024 Sobol samples of the "
        f"light, {100 * exact:.1g} % in closed form"
    )


if __name__ == "__main__":
    study(main, options)
