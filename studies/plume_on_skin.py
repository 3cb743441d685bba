"""When does it pay to look for the plume as a light on the skin?

Three scenes in MWIR: a fin beside a small jet, a plate beside a plume on a grid, and an aircraft with its own jet. Of
each the same image is computed with many keys by bounces that meet the plume by chance and by directions drawn towards
it. The scatter of what the skin reflects, which is the image less that without reflection under the same key, and of
the whole intensity, over time, says what each is worth. Methods take turns, so that a busy machine disturbs all alike.
"""

import time

import jax
import numpy as np
from tqdm import tqdm

import jaxir
from jaxir import DirectSampling, Method, PlumeLight
from studies import aircraft
from studies._study import Run, study, subplots

KEYS = 16
METHODS = {
    "met by a bounce": Method(DirectSampling(0, 1), bounces=1),
    "drawn, and a bounce": Method(bounces=1, plume_light=PlumeLight()),
    "drawn": Method(plume_light=PlumeLight()),
}
GAS = jaxir.GrayGas(1.0)
SQUARE = np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]])


def cases() -> dict[str, tuple[jaxir.Scene, jaxir.Camera]]:
    """Scenes, and cameras that see the lit side."""
    plate, fin = (
        jaxir.Skin(jaxir.Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]])), 260.0, jaxir.Lambert(0.5))
        for corners in (SQUARE, SQUARE[:, [0, 2, 1]])
    )
    jet = jaxir.JetPlume((-1.5, 1.0, 0.0), (-1.0, 0.0, 0.0), 0.2, 1000.0, 250.0, GAS)
    grid = jaxir.Grid((-0.5, -2.0, 0.5), (0.05, 0.1, 0.05), (20, 40, 20))
    centre = np.asarray(grid.centres(), np.float64)
    share = np.exp(-((centre[..., 0] ** 2 + (centre[..., 2] - 1) ** 2) / 0.2**2)) * np.clip(centre[..., 1] + 2, 0.2, 1)
    beside = jaxir.GridPlume(grid, 250 + 750 * share, jaxir.GrayGas(share[..., None]))
    vertices, faces, _ = aircraft.generic_aircraft(0.25)
    skin = jaxir.Skin(jaxir.Mesh(vertices, faces), aircraft.skin_temperature(vertices, faces), jaxir.Lambert(0.8))
    back = (aircraft.TAIL_X, 0.0, 0.0)
    own = jaxir.JetPlume(back, (-1.0, 0.0, 0.0), aircraft.NOZZLE, 2000.0, aircraft.AMBIENT, GAS, length=60.0)
    return {
        "fin, small jet": (jaxir.Scene(fin, jet), jaxir.orthographic_camera(90.0, 0.0, 1 / 64, (64, 64))),
        "plate beside a grid": (jaxir.Scene(plate, beside), jaxir.orthographic_camera(0.0, 90.0, 1 / 64, (64, 64))),
        "aircraft": (jaxir.Scene(skin, own), jaxir.orthographic_camera(90.0, -20.0, 0.25, (40, 80))),
    }


def measured(scene: jaxir.Scene, camera: jaxir.Camera, name: str) -> list[dict]:
    """Scatter of intensities over keys and seconds of each image, by every method."""

    def intensity(key: int, method: Method | None) -> tuple[float, float]:
        began = time.perf_counter()
        image = jaxir.render(scene, camera, jaxir.MWIR, samples=2, method=method, key=jax.random.key(key))
        return float(image.radiant_intensity()[0]), time.perf_counter() - began

    for method in (None, *METHODS.values()):
        intensity(0, method)
    found: dict[str, list[tuple[float, float]]] = {label: [] for label in METHODS}
    plain = []
    for key in tqdm(range(KEYS), desc=name, leave=False):
        plain.append(intensity(key, None)[0])
        for label, method in METHODS.items():
            found[label].append(intensity(key, method))
    rows = []
    for label, pairs in found.items():
        whole, seconds = np.array(pairs).T
        reflected = whole - plain
        rows.append(
            {
                "scene": name,
                "method": label,
                "reflected": reflected.mean(),
                "error_of_mean": reflected.std(ddof=1) / KEYS**0.5,
                "share_of_intensity": reflected.mean() / whole.mean(),
                "scatter_of_reflected": reflected.std(ddof=1) / reflected.mean(),
                "scatter_of_intensity": whole.std(ddof=1) / whole.mean(),
                "seconds": np.median(seconds),
            }
        )
    for row in rows:
        for part in ("reflected", "intensity"):
            cost, first = ((r[f"scatter_of_{part}"] ** 2 * r["seconds"]) for r in (row, rows[0]))
            row[f"gain_{part}"] = first / cost
    return rows


def main(run: Run) -> str:
    rows = [row for name, case in cases().items() for row in measured(*case, name)]
    run.table(rows)
    names = list(dict.fromkeys(row["scene"] for row in rows))
    figure, axes = subplots(1, 2, figsize=(11, 4), sharey=True)
    for axis, part, title in zip(
        axes, ("reflected", "intensity"), ("what the skin reflects", "the whole intensity"), strict=True
    ):
        for shift, label in enumerate(METHODS):
            gain = [row[f"gain_{part}"] for row in rows if row["method"] == label]
            axis.bar(np.arange(len(names)) + 0.25 * (shift - 1), gain, 0.25, label=label)
        axis.axhline(1, color="0.5", lw=0.8)
        axis.set(yscale="log", title=title)
        axis.set_xticks(range(len(names)), names)
    axes[0].set_ylabel("speed to equal error, beside bounces")
    axes[0].legend()
    run.chart(figure, dpi=90)
    said = "; ".join(
        f"{row['scene']} {row['gain_reflected']:.2g} times ({row['gain_intensity']:.2g} for the whole intensity, "
        f"of which {100 * row['share_of_intensity']:.2g} % is reflected)"
        for row in rows
        if row["method"] == "drawn, and a bounce"
    )
    return f"as fast to equal error, beside bounces alone: {said}"


if __name__ == "__main__":
    study(main)
