"""What `render`, `signature` and `show` do."""

from __future__ import annotations

import argparse
import inspect
import tempfile
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
    FILM_FORMATS,
    PICTURES,
    RENDER_FORMATS,
    SHOW_FORMATS,
    SIGNATURE_FORMATS,
    outputs_of,
    require_targets,
    targets,
    write,
)
from jaxir.command_line._quantities import conditions_of, named, naming, quantities_of, read_scene, scene_of
from jaxir.geometry import Camera
from jaxir.imaging import ErrorBudget, Image, Outcome, Signature, check_views, prepare_image, render, signature
from jaxir.io.result import require_full_table, sweep, sweep_states
from jaxir.io.scene_file import SceneFile
from jaxir.optics.spectrum import as_nodes
from jaxir.scene import Scene

LEFT_OUT = {
    "quadrature": "panels of jets or sunlit cells err by",
    "truncation": "method.orders leaves out",
    "bounces": "method.bounces leaves out",
    "outside": "the frame leaves out",
}
TOLERANCES = ("rtol", "atol", "pixel_rtol")
SHARED = ("bands", "signature.views", "signature.components")  # of all states of a table


def render_command(arguments: argparse.Namespace) -> None:
    """`jaxir render`: an image of every camera, in every quantity asked for."""
    outputs = outputs_of(arguments.output, [Path(f"{arguments.scene.stem}.npz")], RENDER_FORMATS)
    require_picture(arguments, outputs)
    read = read_scene(arguments.scene)
    if not read.cameras:
        raise ValueError(f"{read.file}: got no key camera, expected one for render")
    quantities = quantities_of(arguments)
    require_targets(read.file, outputs, read.cameras, quantities.values())
    for quantity, label in quantities.items():
        scene = scene_of(read, quantity)
        for name, camera in read.cameras.items():
            began = time.perf_counter()
            asked = read.render | split_by(arguments)
            image = naming(read, partial(render, scene, camera, read.bands, method=read.method, **asked))
            errors = image.error_budget(arguments.errors)
            warn_of_image(read, image, errors)
            conditions = conditions_of(
                read, quantity, began, errors=errors.described(), **_camera_conditions(name, camera, image)
            )
            print(f"{name or 'image'}, {quantity}\n{errors}")
            if image.parts is not None:
                print(_by_component(image))
            write(RENDER_FORMATS, targets(outputs, name, label), image, conditions, errors, **drawn_as(arguments))


def _camera_conditions(name: str, camera: Camera, image: Image) -> dict[str, str | int | float]:
    return {"camera": name or "camera", "samples": int(image.samples), "unit": "W m-2 sr-1"}


def warn_of_image(read: SceneFile, image: Image, errors: ErrorBudget, state: str = "") -> None:
    """Say where an image, of a state, does not meet a tolerance that was asked for, and `warn_of_errors`."""
    missed = " or ".join(f"render.{name}" for name in TOLERANCES if name in read.render)
    which = f" in {state}" if state else ""
    if bool(image.outcome == Outcome.samples_spent):
        spent = f"{int(image.samples)} samples ({_limits(render, read.render)})"
        warnings.warn(f"{read.file}: {missed} was not met{which} with {spent}", stacklevel=2)
    elif bool(image.outcome == Outcome.left_out):
        said = f"{read.file}: {missed} was not met{which}, because orders, bounces, nodes or sunlit cells err by more"
        warnings.warn(said, stacklevel=2)
    warn_of_errors(read, errors)


def warn_of_errors(read: SceneFile, errors: ErrorBudget) -> None:
    """Say what is left out beyond sampling, where it is more than 1 %."""
    for part, what in LEFT_OUT.items():
        values = errors.parts[part]
        share = 0.0 if values is None else float(np.max(errors.shares(values)))
        if share > 0.01:
            much = f"about {share:.0%} of the intensity" if share < np.inf else "more than can be told"
            warnings.warn(f"{read.file}: {what} {much}", stacklevel=2)


def warn_of_missed(read: SceneFile, table: Signature, state: str = "") -> None:
    """Say in how many views, of a state, a tolerance that was asked for is not met."""
    asked = {name: value for name in ("rtol", "atol") if (value := read.signature.get(name)) is not None}
    missed = int(np.sum(~table.meets(**asked)))
    if missed:
        names = " or ".join(f"signature.{name}" for name in asked)
        views = f"{missed} of {len(table.azimuth)} views{f' of {state}' if state else ''}"
        warnings.warn(
            f"{read.file}: {names} was not met in {views} ({_limits(signature, read.signature)})", stacklevel=2
        )


def _limits(entry: Callable, asked: dict[str, Any]) -> str:
    """What ends the rays of an entry, of what it was asked and its defaults."""
    given = _defaults(entry) | asked
    return " or ".join(f"{name} = {given[name]}" for name in ("max_samples", "max_seconds") if given[name] is not None)


def signature_command(arguments: argparse.Namespace) -> None:
    """`jaxir signature`: a table of all aspects, in every quantity asked for."""
    outputs = outputs_of(arguments.output, [Path(f"{arguments.scene.stem}.csv")], SIGNATURE_FORMATS)
    require_picture(arguments, outputs)
    quantities = quantities_of(arguments)
    if any(path.suffix == ".txt" for path in outputs) and list(quantities) != ["source"]:
        raise ValueError("-o FILE.txt: an AFSIM table holds the source, expected --quantity source alone")
    read = read_scene(arguments.scene)
    if "views" not in read.signature:
        raise ValueError(f"{read.file}: got no key signature.views, expected it for signature")
    if arguments.scale is not None and "components" in read.signature | split_by(arguments):
        raise ValueError(f"--scale: got {arguments.scale}, expected none: lines by component have a scale of their own")
    if any(path.suffix == ".txt" for path in outputs):
        naming(read, lambda: require_full_table(read.signature["views"], read.names))
    refuse_shared(read)
    if read.states is not None:
        naming(read, partial(check_states, read, cameras=False))  # before any of them is computed
    require_targets(read.file, outputs, [""], quantities.values())
    for quantity, label in quantities.items():
        began = time.perf_counter()
        table = naming(read, partial(table_of, read, quantity, label, arguments))
        errors = table.error_budget(arguments.errors)
        warn_of_errors(read, errors)
        print(f"{quantity}\n{errors}")
        conditions = conditions_of(read, quantity, began, errors=errors.described(), unit="W sr-1")
        write(SIGNATURE_FORMATS, targets(outputs, "", label), table, conditions, errors, **drawn_as(arguments))


def table_of(read: SceneFile, quantity: str, label: str, arguments: argparse.Namespace) -> Signature:
    """The table of a file, or of all its states, whose finished views are kept in a folder if there is one."""

    def of(own: SceneFile, entry: Callable[..., Signature], state: str = "") -> Signature:
        asked = own.signature | split_by(arguments)
        table = entry(scene_of(own, quantity), bands=own.bands, method=own.method, **asked)
        warn_of_missed(own, table, state)
        return table

    if read.states is None and arguments.folder is None:
        return of(read, signature)
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.folder or Path(temporary) / "views"
        kept = named(folder.resolve(), label)
        if read.states is None:
            return of(read, partial(sweep, kept))
        over = read.states.over
        return sweep_states(kept, over, lambda view, state: of(read.at(**state), partial(sweep, view), view.name))


def film_command(arguments: argparse.Namespace) -> None:
    """`jaxir film`: an image of every camera in every state of `over`, as a film or a strip."""
    outputs = outputs_of(arguments.output, [Path(f"{arguments.scene.stem}.gif")], FILM_FORMATS)
    read = read_scene(arguments.scene)
    if read.states is None or not read.cameras:
        raise ValueError(f"{read.file}: got no section over or no camera, expected both for film")
    quantities = quantities_of(arguments)
    require_targets(read.file, outputs, read.cameras, quantities.values())
    naming(read, partial(check_states, read, views=False))
    shown = read.states.labels
    for quantity, label in quantities.items():
        films: dict[str, dict[str, Image]] = {}
        kinds: dict[str, tuple[tuple[str, ...], tuple[int, int]]] = {}
        for state in read.states.every:
            own = naming(read, partial(read.at, **state))
            title = ", ".join(f"{axis} {shown[axis][value]}" for axis, value in state.items())
            for name, camera in own.cameras.items():
                kind = own.names, camera.shape
                if kinds.setdefault(name, kind) != kind:
                    raise ValueError(f"{read.file}: over: got other bands or shape at {title}, expected equal ones")
                asked = {"method": own.method, **own.render}
                image = naming(read, partial(render, scene_of(own, quantity), camera, own.bands, **asked))
                warn_of_image(own, image, image.error_budget(look=False), title)
                films.setdefault(name, {})[title] = image
        for name, images in films.items():
            write(FILM_FORMATS, targets(outputs, name, label), images, **drawn_as(arguments))


def drawn_as(arguments: argparse.Namespace) -> dict[str, str]:
    """What the command line says of pictures."""
    asked = {"scale": arguments.scale, "quantity": getattr(arguments, "picture", None)}
    return {name: value for name, value in asked.items() if value is not None}


def require_picture(arguments: argparse.Namespace, outputs: list[Path]) -> None:
    """Raise `ValueError` where something is asked of a picture and none is to be written."""
    if drawn_as(arguments) and not any(path.suffix in PICTURES for path in outputs):
        name = "picture" if "quantity" in drawn_as(arguments) else "scale"
        raise ValueError(f"--{name}: got {getattr(arguments, name)} without a picture, expected -o FILE.png with it")


def split_by(arguments: argparse.Namespace) -> dict[str, str]:
    """What the command line says of components, which goes before the scene file."""
    return {} if arguments.components is None else {"components": arguments.components}


def _by_component(image: Image) -> str:
    """Components of a radiant intensity with their standard errors, a line for each."""
    width = max(len(name) for name in image.components)
    value, error = np.asarray(image.component_intensity()), np.asarray(image.component_error())
    rows = zip(image.components, np.stack([value, error], axis=2).tolist(), strict=True)
    return "\n".join(
        f"  {name:{width}s}" + "".join(f"{f'{x:.5g} ± {e:.2g}':>22s}" for x, e in own) for name, own in rows
    )


def show_command(arguments: argparse.Namespace) -> None:
    """`jaxir show`: what a scene holds; nothing is rendered."""
    outputs = outputs_of(arguments.output, [], SHOW_FORMATS)
    read = read_scene(arguments.scene)
    require_targets(read.file, outputs, [""], [""])
    if "views" in read.signature:
        refuse_shared(read)
    naming(read, partial(check_states, read))
    if read.states is not None:  # other commands take the file without them
        naming(read, partial(check, read, cameras=True, views=True))
    print(read.describe())
    if outputs:
        write(SHOW_FORMATS, outputs, plot.scene_view(read.scene, read.cameras, arguments.colour))


def refuse_shared(read: SceneFile) -> None:
    """Raise `ValueError` where something varies that states of one table share."""
    if read.states is not None:
        read.states.refuse(SHARED, "bands, views and components of a table are the same in all states")


def check_states(read: SceneFile, cameras: bool = True, views: bool = True) -> None:
    """`check` of the file, or of all its states."""
    if read.states is None:
        return check(read, cameras, views)
    for state in read.states.every:
        try:
            check(read.at(**state), cameras, views)
        except ValueError as error:
            named = ", ".join(f"{axis}={read.states.labels[axis][value]}" for axis, value in state.items())
            raise ValueError(f"{named}: {error}") from error


def check(read: SceneFile, cameras: bool, views: bool) -> None:
    """Raise `ValueError` for what `render` would refuse of the cameras and `signature` of the views."""
    nodes = as_nodes(read.bands)  # their ranges are those of any nodes of the bands
    require(read.scene.checks_on(nodes))
    eqx.filter_eval_shape(Scene.on, read.scene, nodes)
    held = {"scene": read.scene, "bands": nodes, "method": read.method}
    for camera in read.cameras.values() if cameras else ():
        _prepare(prepare_image, render, **held, **read.render, camera=camera)
    if views and "views" in read.signature:
        _prepare(check_views, signature, **held, **read.signature)


def _prepare(preparing: Callable, entry: Callable, **given: Any) -> None:
    """Call what prepares an entry with what it would be given, its defaults included."""
    entire = _defaults(entry) | given
    preparing(**{name: entire[name] for name in inspect.signature(preparing).parameters})


def _defaults(entry: Callable) -> dict[str, Any]:
    return {name: one.default for name, one in inspect.signature(entry).parameters.items()}
