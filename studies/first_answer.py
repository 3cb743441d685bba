"""How long does a first answer take, in a fresh process, without and with the programs that an earlier one compiled?

Each job runs in processes of its own: first with an empty folder of compiled programs ("cold"), then with the folder
that this filled ("warm"). Times are wall time from the start of the interpreter, imports included. Where Mitsuba is
installed (extra `peers`), its first image of a box in the sun is timed the same way.
"""

import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from studies import mitsuba_peer
from studies._study import HERE, Run, study, subplots

ROOT = HERE.parent
IMAGE = re.search(r"```python\n(import jax\n.*?)\n\nintensity = ", (ROOT / "README.md").read_text(), re.DOTALL)
STEP = """
intensity = lambda e, t: jaxir.render(scene(e, t), camera, jaxir.MWIR, samples=2).radiant_intensity()[0]
slope = jax.grad(intensity, argnums=(0, 1))
jax.block_until_ready(slope(0.8, 900.0))
"""
AGAIN = """
import time
began = time.perf_counter()
jax.block_until_ready(slope(0.7, 800.0))
print("again", time.perf_counter() - began)
"""
FIT = """
import jaxir
from jaxir.fit import fit, jet_parameter, measured_intensity

jet = lambda t: jaxir.Scene(
    None, jaxir.JetPlume((0.0, 0.0, 0.0), (-1.0, 0.0, 0.0), 0.5, t, 223.0, jaxir.GrayGas(0.4))
)
views = [(30.0 * k, 0.0) for k in range(7)]
seen = jaxir.signature(jet(900.0), views, jaxir.MWIR, shape=(32, 64)).intensity
data = measured_intensity(jet(800.0), views, jaxir.MWIR, seen, 0.02 * seen, shape=(32, 64))
print(fit(jet(800.0), [jet_parameter("exit_temperature")], [data]))
"""
MITSUBA = """
import mitsuba as mi

mi.set_variant("llvm_ad_rgb")
sun = {"type": "directional", "direction": [0, 0, -1]}
pose = mi.ScalarTransform4f().look_at([0, 9, 3], [0, 0, 0], [0, 0, 1])
parts = {"integrator": {"type": "direct"}, "box": {"type": "cube"}, "sun": sun}
scene = mi.load_dict({"type": "scene", **parts, "camera": {"type": "perspective", "to_world": pose}})
print(mi.render(scene, spp=8).numpy().sum())
"""


def jobs() -> dict[str, list[str]]:
    """Commands by what they answer."""
    assert IMAGE is not None
    image = IMAGE[1]
    found = {
        "README, image": [sys.executable, "-c", image],
        "README, image and gradient": [sys.executable, "-c", image + STEP],
        "jaxir render box.toml": [sys.executable, "-m", "jaxir", "render", "examples/box.toml", "-o", "{out}/box.npz"],
        "jaxir render aircraft.toml": [
            *(sys.executable, "-m", "jaxir", "render", "examples/aircraft.toml", "-o", "{out}/aircraft.npz")
        ],
        "first fit of a plume": [sys.executable, "-c", FIT],
    }
    why = mitsuba_peer.trouble(MITSUBA)
    if why:
        print(f"Mitsuba is not measured: {why}")
    else:
        found["Mitsuba's first image"] = [sys.executable, "-c", MITSUBA]
    return found


def seconds(command: list[str], folder: Path) -> float:
    """Wall time of a command in a process of its own."""
    environment = {**os.environ, "JAXIR_CACHE": str(folder / "programs"), "PYTHONPATH": str(ROOT)}
    words = [word.replace("{out}", str(folder)) for word in command]
    began = time.perf_counter()
    subprocess.run(words, cwd=ROOT, env=environment, check=True, capture_output=True)
    return time.perf_counter() - began


def main(run: Run) -> str:
    rows = []
    for name, command in jobs().items():
        with tempfile.TemporaryDirectory() as folder:
            cold = seconds(command, Path(folder))
            warm = min(seconds(command, Path(folder)) for _ in range(3))
        rows.append({"job": name, "cold_s": cold, "warm_s": warm})
    assert IMAGE is not None
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "JAXIR_CACHE": str(Path(folder) / "programs"), "PYTHONPATH": str(ROOT)}
        command = [sys.executable, "-c", IMAGE[1] + STEP + AGAIN]
        said = subprocess.run(command, cwd=ROOT, env=environment, check=True, capture_output=True, text=True).stdout
    again = float(said.split("again")[1])
    rows.append({"job": "next step of the gradient, not jitted", "cold_s": again, "warm_s": again})
    run.table(rows)
    figure, axis = subplots(figsize=(7, 3.2))
    place = range(len(rows))
    axis.barh([p - 0.2 for p in place], [row["cold_s"] for row in rows], 0.4, label="nothing compiled before")
    axis.barh([p + 0.2 for p in place], [row["warm_s"] for row in rows], 0.4, label="a second process")
    axis.set_yticks(list(place), [str(row["job"]) for row in rows])
    axis.invert_yaxis()
    axis.set(xlabel="wall time from the start of the interpreter [s]")
    axis.legend()
    run.chart(figure)
    image, both = rows[0], rows[1]
    return (
        f"README's image {image['cold_s']:.1f} s, in a second process {image['warm_s']:.1f} s; with its gradient "
        f"{both['cold_s']:.1f} and {both['warm_s']:.1f} s; the next step of the gradient {again:.2g} s"
    )


if __name__ == "__main__":
    study(main)
