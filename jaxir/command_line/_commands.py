"""What `render`, `signature` and `show` do."""

from __future__ import annotations

import argparse
import inspect
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np

from jaxir import plot
from jaxir._arrays import require
from jaxir.command_line._formats import (
    RENDER_FORMATS,
    SHOW_FORMATS,
    SIGNATURE_FORMATS,
    outputs_of,
    save_figure,
    write,
)
from jaxir.command_line._quantities import conditions_of, named, naming, quantities_of, read_scene, scene_of
from jaxir.geometry import Camera
from jaxir.imaging import ErrorBudget, Image, Outcome, check_views, prepare_image, render, signature
from jaxir.io.result import require_full_table
from jaxir.io.scene_file import SceneFile
from jaxir.optics.spectrum import as_nodes
from jaxir.scene import Scene

LEFT_OUT = {
    "quadrature": "the panels of jets err by",
    "truncation": "method.orders leaves out",
    "bounces": "method.bounces leaves out",
    "outside": "the frame leaves out",
}


def render_command(arguments: argparse.Namespace) -> None:
    """`jaxir render`: an image of every camera, in every quantity asked for."""
    outputs = outputs_of(arguments.output, [Path(f"{arguments.scene.stem}.npz")], RENDER_FORMATS)
    read = read_scene(arguments.scene)
    if not read.cameras:
        raise ValueError(f"{read.file}: got no key camera, expected one for render")
    for quantity, label in quantities_of(arguments).items():
        scene = scene_of(read, quantity)
        for name, camera in read.cameras.items():
            began = time.perf_counter()
            asked = read.render | split_by(arguments)
            image = naming(read, partial(render, scene, camera, read.bands, method=read.method, **asked))
            if bool(image.outcome == Outcome.samples_spent):
                missed = "pixel_rtol" if "pixel_rtol" in asked else "rtol"
                said = f"{read.file}: render.{missed} was not met with {int(image.samples)} samples"
                warnings.warn(said, stacklevel=1)
            errors = image.error_budget(arguments.errors)
            warn_of_errors(read, errors)
            conditions = conditions_of(
                read, quantity, began, errors=errors.described(), **_camera_conditions(name, camera, image)
            )
            print(f"{name or 'image'}, {quantity}\n{errors}")
            if image.parts is not None:
                print(_by_component(image))
            for path in outputs:
                write(
                    RENDER_FORMATS,
                    named(path, f"_{name}" if name else "", label),
                    image,
                    conditions,
                    errors,
                    arguments.scale,
                )


def _camera_conditions(name: str, camera: Camera, image: Image) -> dict[str, str | int | float]:
    return {"camera": name or "camera", "samples": int(image.samples), "unit": "W m-2 sr-1"}


def warn_of_errors(read: SceneFile, errors: ErrorBudget) -> None:
    """Say what is left out beyond sampling, where it is more than 1 %."""
    scale = np.abs(np.asarray(errors.intensity))
    for part, what in LEFT_OUT.items():
        values = errors.parts[part]
        share = 0.0 if values is None else float(np.max(np.asarray(values) / np.where(scale > 0, scale, np.inf)))
        if share > 0.01:
            warnings.warn(f"{read.file}: {what} about {share:.0%} of the intensity", stacklevel=2)


def signature_command(arguments: argparse.Namespace) -> None:
    """`jaxir signature`: a table of all aspects, in every quantity asked for."""
    outputs = outputs_of(arguments.output, [Path(f"{arguments.scene.stem}.csv")], SIGNATURE_FORMATS)
    quantities = quantities_of(arguments)
    if any(path.suffix == ".txt" for path in outputs) and list(quantities) != ["source"]:
        raise ValueError("-o FILE.txt: an AFSIM table holds the source, expected --quantity source alone")
    read = read_scene(arguments.scene)
    if "views" not in read.signature:
        raise ValueError(f"{read.file}: got no key signature.views, expected it for signature")
    if any(path.suffix == ".txt" for path in outputs):
        naming(read, lambda: require_full_table(read.signature["views"], read.names))
    for quantity, label in quantities.items():
        scene, began = scene_of(read, quantity), time.perf_counter()
        asked = read.signature | split_by(arguments)
        table = naming(read, partial(signature, scene, bands=read.bands, method=read.method, **asked))
        errors = table.error_budget(arguments.errors)
        warn_of_errors(read, errors)
        print(f"{quantity}\n{errors}")
        conditions = conditions_of(read, quantity, began, errors=errors.described(), unit="W sr-1")
        for path in outputs:
            write(SIGNATURE_FORMATS, named(path, label), table, conditions, errors, arguments.scale)


def split_by(arguments: argparse.Namespace) -> dict[str, str]:
    """What the command line says of components, which goes before the scene file."""
    return {} if arguments.components is None else {"components": arguments.components}


def _by_component(image: Image) -> str:
    """Components of a radiant intensity, a line for each."""
    width = max(len(name) for name in image.components)
    rows = zip(image.components, np.asarray(image.component_intensity()).tolist(), strict=True)
    return "\n".join(f"  {name:{width}s}" + "".join(f"{x:14.5g}" for x in own) for name, own in rows)


def show_command(arguments: argparse.Namespace) -> None:
    """`jaxir show`: what a scene holds; nothing is rendered."""
    outputs = outputs_of(arguments.output, [], SHOW_FORMATS)
    read = read_scene(arguments.scene)
    naming(read, partial(check, read))
    print(read.describe())
    for path in outputs:
        save_figure(path, plot.scene_view(read.scene, read.cameras, arguments.colour))
        print(f"wrote {path}")


def check(read: SceneFile) -> None:
    """Raise `ValueError` for what `render` and `signature` would refuse."""
    nodes = as_nodes(read.bands)  # their ranges are those of any nodes of the bands
    require(read.scene.checks_on(nodes))
    eqx.filter_eval_shape(Scene.on, read.scene, nodes)
    held = {"scene": read.scene, "bands": nodes, "method": read.method}
    for camera in read.cameras.values():
        _prepare(prepare_image, render, **held, **read.render, camera=camera)
    if "views" in read.signature:
        _prepare(check_views, signature, **held, **read.signature)


def _prepare(preparing: Callable, entry: Callable, **given: Any) -> None:
    """Call what prepares an entry with what it would be given, its defaults included."""
    entire = {name: one.default for name, one in inspect.signature(entry).parameters.items()} | given
    preparing(**{name: entire[name] for name in inspect.signature(preparing).parameters})
