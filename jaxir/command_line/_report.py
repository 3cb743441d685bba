"""What `report` does: everything of a scene file in one HTML file, with what was assumed and from which inputs."""

from __future__ import annotations

import argparse
import datetime
import hashlib
import importlib.metadata
import platform
import shlex
import time
import warnings
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from jaxir import plot
from jaxir._version import __version__
from jaxir.command_line._commands import TOLERANCES, warn_of_errors, warn_of_image, warn_of_missed
from jaxir.command_line._formats import REPORT_FORMATS, outputs_of, require_targets, write
from jaxir.command_line._html import Page
from jaxir.command_line._inputs import inputs_of
from jaxir.command_line._quantities import QUANTITIES, naming, read_scene, scene_of
from jaxir.imaging import ErrorBudget, Image, Signature, render, signature
from jaxir.io.scene_file import SceneFile
from jaxir.optics.spectrum import Nodes
from jaxir.scene import Scene
from jaxir.transport import DirectSampling, Method

MOST_ROWS = 400  # of a table in a page; a CSV holds the rest


def report_command(arguments: argparse.Namespace) -> None:
    """Render and tabulate what the scene file asks for and write one page of it."""
    outputs = outputs_of(arguments.output, [Path(f"{arguments.scene.stem}_report.html")], REPORT_FORMATS)
    began, quantity = time.perf_counter(), arguments.quantity or "apparent"
    with _kept_warnings() as said:
        read = read_scene(arguments.scene)
        require_targets(read.file, outputs, [""], [""])
        if not read.cameras and "views" not in read.signature:
            raise ValueError(f"{read.file}: got neither camera nor signature.views, expected one of them for report")
        page = Page(f"{read.file.stem}: {quantity} radiance and intensity")
        page.paragraph(f"{quantity}: {QUANTITIES[quantity]}.")
        page.heading("Scene")
        page.text("\n".join([read.describe(), *read.notes]))
        page.figure(plot.scene_view(read.scene, read.cameras), "Parts, plumes, lights and the frames of the cameras.")
        if read.scene.skin is not None:
            page.figure(plot.scene_view(Scene(read.scene.skin), colour="temperature"), "Temperature of the faces.")
        scene = scene_of(read, quantity)
        for name, camera in read.cameras.items():
            asked = {"components": "sources", **read.render}
            image = naming(read, partial(render, scene, camera, read.bands, method=read.method, **asked))
            write_image(page, read, name, image, quantity)
        if "views" in read.signature:
            asked = {"components": "sources", **read.signature}
            table = naming(read, partial(signature, scene, bands=read.bands, method=read.method, **asked))
            warn_of_missed(read, table)
            write_signature(page, read, table)
    page.heading("What was assumed")
    page.listed([*assumptions(read, scene), *dict.fromkeys(said)])
    page.heading("How it was made")
    files = [word for path in outputs for word in ("-o", str(path))]
    words = ["jaxir", "report", str(arguments.scene), *files, *(["-q", quantity] if arguments.quantity else [])]
    made = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    used = [f"{name} {importlib.metadata.version(name)}" for name in ("jax", "jaxlib", "numpy")]
    versions = [f"jaxir {__version__}", *used]
    page.listed(
        [
            f"command: {shlex.join(words)}",
            f"made: {made}, in {time.perf_counter() - began:.1f} s",
            f"versions: {', '.join(versions)}, Python {platform.python_version()} on {platform.machine()}",
        ]
    )
    page.table(("input", "SHA-256"), [(name, digest) for name, digest in hashes(read.file).items()])
    page.text(read.file.read_text(encoding="utf-8-sig"), folded=f"{read.file.name}, as it was read")
    write(REPORT_FORMATS, outputs, str(page))


class _kept_warnings:
    """Warnings are shown as ever, and kept."""

    def __enter__(self) -> list[str]:
        self.said: list[str] = []
        self.shown = warnings.showwarning

        def show(message: Any, *rest: Any) -> None:
            self.said.append(f"warning: {message}")
            self.shown(message, *rest)

        replaced: Any = show
        warnings.showwarning = replaced
        return self.said

    def __exit__(self, *error: object) -> None:
        warnings.showwarning = self.shown


def write_image(page: Page, read: SceneFile, name: str, image: Image, quantity: str) -> None:
    errors = image.error_budget(look=False)
    warn_of_image(read, image, errors)
    where = "at the sensor" if quantity == "apparent" else "at the target, without air"
    page.heading(f"Image{f' {name}' if name else ''}")
    page.figure(plot.radiance_image(image), f"Radiance {where}, {int(image.samples)} rays per pixel.")
    seen = "Temperature of a blackbody that is as bright in the band."
    page.figure(plot.radiance_image(image, quantity="temperature"), seen)
    page.figure(plot.component_bars(image), "Radiant intensity by where its light comes from.")
    page.figure(plot.component_panels(image), "The same light as images, each with a scale of its own.")
    page.heading("Radiant intensity [W/sr]", 3)
    _by_component(page, image, errors)
    _write_budget(page, errors)


def write_signature(page: Page, read: SceneFile, table: Signature) -> None:
    errors = table.error_budget(look=False)
    warn_of_errors(read, errors)
    page.heading("Signature")
    page.figure(plot.polar_signature(table), "Radiant intensity, bands of two standard errors.")
    page.figure(plot.component_signature(table), "Radiant intensity by where its light comes from.")
    page.heading("Radiant intensity [W/sr], standard error, and components", 3)
    head = ["azimuth", "elevation"]
    for band in table.bands:
        head += [band, "±", *(f"{band}, {name}" for name in table.components)]
    rows = []
    assert table.parts is not None
    aspects = np.stack([np.asarray(table.azimuth), np.asarray(table.elevation)], axis=1)
    own = np.concatenate([np.asarray(table.intensity)[:, None], np.asarray(table.standard_error)[:, None]], axis=1)
    values = np.concatenate([own, np.asarray(table.parts)], axis=1)
    for aspect, value in zip(aspects[:MOST_ROWS].tolist(), values[:MOST_ROWS], strict=True):
        rows.append([*(f"{angle:g}°" for angle in aspect), *(f"{x:.4g}" for x in value.T.ravel().tolist())])
    page.table(head, rows)
    if len(values) > MOST_ROWS:
        page.paragraph(f"The first {MOST_ROWS} of {len(values)} views; jaxir signature writes all.")
    _write_budget(page, errors)


def _by_component(page: Page, image: Image, errors: ErrorBudget) -> None:
    value = np.concatenate([np.asarray(image.component_intensity()), np.asarray(errors.intensity)[None]])
    error = np.concatenate([np.asarray(image.component_error()), np.asarray(errors.sampling)[None]])
    rows = [
        [name, *(word for x, e in zip(own, spread, strict=True) for word in (f"{x:.5g}", f"{e:.2g}"))]
        for name, own, spread in zip([*image.components, "sum"], value.tolist(), error.tolist(), strict=True)
    ]
    page.table(["component", *(word for band in image.bands for word in (band, "±"))], rows)


def _write_budget(page: Page, errors: ErrorBudget) -> None:
    page.heading("Error budget", 3)
    page.text(str(errors))
    page.figure(plot.error_bars({"": errors}), "Shares of the error; what is not known was not looked for.")


def assumptions(read: SceneFile, scene: Scene) -> list[str]:
    """What the numbers rest on, a sentence each; of the scene whose contrast is the quantity."""
    method = (Method() if read.method is None else read.method).resolved(scene)
    asked = any(name in part for part in (read.render, read.signature) for name in TOLERANCES)
    free = ", or as an error that is asked for needs" if read.method is None and asked else ""
    found = ["The scene is a moment; there are no optics, noise or detector of a sensor."]
    if scene.skin is not None:
        found.append("Skin is opaque; its emissivity follows from its reflectance by Kirchhoff's law.")
        left = "is left out" if method.ambient is None else "is Method.ambient"
        found.append(
            f"Light is followed over {method.bounces} reflections between skin{free}; what comes after {left}."
        )
    lights = [type(source).__name__ for source in scene.sources]
    found.append(f"Sources: {', '.join(lights)}." if lights else "There is no source of light, hence no Sun.")
    if scene.background is None:
        found.append("There is nothing around the scene: neither sky nor earth light it or are seen behind it.")
    else:
        found.append(f"Around the scene is a {type(scene.background).__name__}, seen and lighting it.")
    if scene.extended_lights:
        how = "sampled" if isinstance(method.direct, DirectSampling) else "left out"
        found.append(
            f"Light of sources with an extent and of the surroundings is {how if method.direct else 'left out'}."
        )
    if scene.scatters:
        orders = "all orders, on a lattice" if method.scattering is not None else f"{method.orders} orders"
        found.append(f"Particles scatter: {orders}{free}.")
    elif scene.plumes:
        found.append("Plumes absorb and emit; nothing in them scatters.")
    if scene.atmosphere is None:
        found.append("There is no air between target and sensor.")
    else:
        name = type(scene.atmosphere).__name__
        rest = ", without haze, clouds and scattered sunlight" if name == "StandardAtmosphere" else ""
        found.append(f"The air between target and sensor is a {name}{rest}, one path for the whole image.")
    chosen = (
        "as given"
        if isinstance(read.bands, Nodes)
        else "the fewest that probing rays need within 2 %, if the finest do"
    )
    found.append(f"Spectral nodes: {chosen}; the budget has their error, and not that of the models of gas and air.")
    return found


def hashes(file: Path) -> dict[str, str]:
    """SHA-256 of the scene file and of every file that it names, by name as written there."""
    return {
        name: hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "a folder or missing"
        for name, path in inputs_of(file).items()
    }
