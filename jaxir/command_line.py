"""The command line: scenes from TOML files rendered to images and signature tables.

jaxir render scene.toml -o image.npz
jaxir signature scene.toml -o table.csv
jaxir show scene.toml -o setup.png
"""

from __future__ import annotations

import argparse
import importlib.metadata
import importlib.util
import inspect
import sys
import time
import warnings
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import equinox as eqx
import numpy as np

from jaxir import plot
from jaxir._arrays import require
from jaxir.geometry import Camera
from jaxir.imaging import ErrorBudget, Image, Outcome, Signature, check_views, prepare_image, render, signature
from jaxir.io._files import written_whole
from jaxir.io.result import (
    Conditions,
    require_full_table,
    require_suffix,
    save_afsim,
    save_image,
    save_netcdf,
    save_signature,
    save_tiff,
)
from jaxir.io.scene_file import SceneFile, load_scene
from jaxir.optics.spectrum import as_nodes
from jaxir.quantity import alone, at_target
from jaxir.scene import Scene

DESCRIPTION = "Infrared radiance images and signatures of scenes described in TOML files."
EPILOG = """
A scene file describes mesh, materials, temperatures, plume, lights, air, cameras and bands;
examples/*.toml are complete ones, docs/scene_files.md lists every key.

exit status: 0 when every file was written, 1 for a scene that is wrong, 2 for a wrong command
"""
QUANTITIES = {
    "apparent": "at the sensor, through the air, in contrast to the background",
    "contrast": "at the target, without air, in contrast to the background",
    "source": "of skin and plume alone, at the target, without air and background",
}

LEFT_OUT = {
    "truncation": "method.orders leaves out",
    "bounces": "method.bounces leaves out",
    "outside": "the frame leaves out",
}


def main(argv: list[str]) -> int:
    """Run a command.

    Args:
        argv: its words.

    Returns:
        The exit status. Errors of the scene and its files are one line on stderr.
    """
    arguments = _parser().parse_args(argv)
    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        # A scene is checked when it is read and again for every image: what was said is not said again.
        said = cache(lambda text: _say(f"warning: {text}"))
        warnings.showwarning = lambda message, *rest: said(str(message))
        try:
            arguments.command(arguments)
        except KeyboardInterrupt:
            _say("interrupted; nothing was written that is not complete")
            return 130
        except (ValueError, OSError, ImportError, MemoryError, RuntimeError) as error:
            if arguments.traceback:
                raise
            _say(str(error) or type(error).__name__)
            return 1
    return 0


def run() -> NoReturn:
    """The command `jaxir`, which `python -m jaxir` runs too: `main` of the process's words, then the end."""
    sys.exit(main(sys.argv[1:]))


def _say(text: str) -> None:
    """One line on stderr."""
    print(f"jaxir: {' '.join(text.split())}", file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        prog="jaxir", description=DESCRIPTION, epilog=EPILOG, formatter_class=raw, allow_abbrev=False
    )
    parser.add_argument("--version", action="version", version=f"jaxir {importlib.metadata.version('jaxir')}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for name, run, said, formats in (
        ("render", _render, "radiance images, one for each camera", RENDER_FORMATS),
        ("signature", _signature, "radiant intensity over aspects", SIGNATURE_FORMATS),
        ("show", _show, "read and check a scene, say what it holds, draw it; nothing is rendered", SHOW_FORMATS),
    ):
        listed = "\n".join(f"  {suffix:<6} {format_.said}" for suffix, format_ in formats.items())
        command = commands.add_parser(
            name,
            help=said,
            description=said[0].upper() + said[1:] + ".",
            epilog=f"formats, by the ending of FILE:\n{listed}\n",
            formatter_class=raw,
            allow_abbrev=False,
        )
        command.set_defaults(command=run)
        command.add_argument("scene", type=Path, metavar="SCENE.toml", help="the scene file")
        default = {"render": "the scene's name with .npz, here", "signature": "the scene's name with .csv, here"}
        command.add_argument(
            "-o",
            "--output",
            action="append",
            type=Path,
            metavar="FILE",
            help=f"a file to write, may be repeated (default: {default.get(name, 'none')})",
        )
        if name != "show":
            command.add_argument(
                "-q",
                "--quantity",
                action="append",
                choices=list(QUANTITIES),
                help="; ".join(f"{quantity}: {what}" for quantity, what in QUANTITIES.items())
                + ". May be repeated, which puts its name into the files' names (default: apparent)",
            )
            command.add_argument(
                "--errors", action="store_true", help="look for what bounces leave out, too; compiles another program"
            )
        command.add_argument("--traceback", action="store_true", help="show where in the program an error arose")
    return parser


class Format(NamedTuple):
    """A kind of file: what is said of it, the package that it needs with its extra, and how it is written."""

    said: str
    needs: tuple[str, str] | None
    save: Callable[..., None]


def _save_figure(path: Path, figure: Any) -> None:
    require_suffix(path, ".png")
    with written_whole(path) as part:
        figure.savefig(part, dpi=120, format="png")


RENDER_FORMATS = {
    ".npz": Format("every number, for numpy", None, save_image),
    ".tif": Format(
        "float32 TIFF, a page per band (extra image)",
        ("tifffile", "image"),
        lambda path, image, conditions, errors: save_tiff(path, image, conditions),
    ),
    ".nc": Format("NetCDF with units and conditions (extra netcdf)", ("xarray", "netcdf"), save_netcdf),
    ".png": Format(
        "picture with colour bar (extra plot)",
        ("matplotlib", "plot"),
        lambda path, image, *about: _save_figure(path, plot.radiance_image(image)),
    ),
}
SIGNATURE_FORMATS = {
    ".csv": Format("table", None, save_signature),
    ".txt": Format(
        "AFSIM infrared_signature; wants --quantity source",
        None,
        lambda path, table, conditions, errors: save_afsim(path, table, path.stem, conditions),
    ),
    ".nc": Format("NetCDF with units and conditions (extra netcdf)", ("xarray", "netcdf"), save_netcdf),
    ".png": Format(
        "polar plot (extra plot)",
        ("matplotlib", "plot"),
        lambda path, table, *about: _save_figure(path, plot.polar_signature(table)),
    ),
}
SHOW_FORMATS = {
    ".png": Format("mesh, plume, lights and cameras (extra plot)", ("matplotlib", "plot"), _save_figure),
}


def _outputs(asked: list[Path] | None, default: list[Path], formats: dict[str, Format]) -> list[Path]:
    """The files to write, once it is known that they can be."""
    outputs = default if asked is None else asked
    for path in outputs:
        require_suffix(path, *formats)
        needs = formats[path.suffix].needs
        if needs is not None and importlib.util.find_spec(needs[0]) is None:
            raise ImportError(f'{path}: writing it needs {needs[0]}: pip install "jaxir[{needs[1]}]"')
    return outputs


def _scene_of(read: SceneFile, quantity: str) -> Scene:
    """The scene whose contrast through the air is the quantity."""
    if quantity == "apparent":
        return read.scene
    scene = at_target(read.scene)
    return scene if quantity == "contrast" else alone(scene)


def _quantities(arguments: argparse.Namespace) -> dict[str, str]:
    """The quantities asked for, each with what it adds to a file's name."""
    asked = list(dict.fromkeys(arguments.quantity or ["apparent"]))
    return {quantity: f"_{quantity}" if len(asked) > 1 else "" for quantity in asked}


def _conditions(read: SceneFile, quantity: str, began: float, **more: str | int | float) -> Conditions:
    return {
        "scene": read.file.name,
        "quantity": f"{quantity}: {QUANTITIES[quantity]}",
        **more,
        "jaxir": importlib.metadata.version("jaxir"),
        "jax": importlib.metadata.version("jax"),
        "seconds": round(time.perf_counter() - began, 3),
    }


def _named(path: Path, *parts: str) -> Path:
    """The path with parts added to its name in front of the ending."""
    return path.with_name(path.stem + "".join(parts) + path.suffix)


def _render(arguments: argparse.Namespace) -> None:
    outputs = _outputs(arguments.output, [Path(f"{arguments.scene.stem}.npz")], RENDER_FORMATS)
    read = _read(arguments.scene)
    if not read.cameras:
        raise ValueError(f"{read.file}: got no key camera, expected one for render")
    for quantity, label in _quantities(arguments).items():
        scene = _scene_of(read, quantity)
        for name, camera in read.cameras.items():
            began = time.perf_counter()
            image = _of(read, partial(render, scene, camera, read.bands, method=read.method, **read.render))
            if bool(image.outcome == Outcome.samples_spent):
                warnings.warn(f"{read.file}: render.rtol was not met with {int(image.samples)} samples", stacklevel=1)
            errors = image.error_budget(arguments.errors)
            _warn_of_errors(read, errors)
            conditions = _conditions(
                read, quantity, began, errors=errors.described(), **_camera_conditions(name, camera, image)
            )
            print(f"{name or 'image'}, {quantity}\n{errors}")
            for path in outputs:
                _write(RENDER_FORMATS, _named(path, f"_{name}" if name else "", label), image, conditions, errors)


def _camera_conditions(name: str, camera: Camera, image: Image) -> dict[str, str | int | float]:
    return {"camera": name or "camera", "samples": int(image.samples), "unit": "W m-2 sr-1"}


def _warn_of_errors(read: SceneFile, errors: ErrorBudget) -> None:
    """Say what is left out beyond sampling, where it is more than 1 %."""
    scale = np.abs(np.asarray(errors.intensity))
    for part, what in LEFT_OUT.items():
        values = errors.parts[part]
        share = 0.0 if values is None else float(np.max(np.asarray(values) / np.where(scale > 0, scale, np.inf)))
        if share > 0.01:
            warnings.warn(f"{read.file}: {what} about {share:.0%} of the intensity", stacklevel=2)


def _signature(arguments: argparse.Namespace) -> None:
    outputs = _outputs(arguments.output, [Path(f"{arguments.scene.stem}.csv")], SIGNATURE_FORMATS)
    quantities = _quantities(arguments)
    if any(path.suffix == ".txt" for path in outputs) and list(quantities) != ["source"]:
        raise ValueError("-o FILE.txt: an AFSIM table holds the source, expected --quantity source alone")
    read = _read(arguments.scene)
    if "views" not in read.signature:
        raise ValueError(f"{read.file}: got no key signature.views, expected it for signature")
    if any(path.suffix == ".txt" for path in outputs):
        _of(read, lambda: require_full_table(read.signature["views"], read.names))
    for quantity, label in quantities.items():
        scene, began = _scene_of(read, quantity), time.perf_counter()
        table = _of(read, partial(signature, scene, bands=read.bands, method=read.method, **read.signature))
        errors = table.error_budget(arguments.errors)
        _warn_of_errors(read, errors)
        print(f"{quantity}\n{errors}")
        conditions = _conditions(read, quantity, began, errors=errors.described(), unit="W sr-1")
        for path in outputs:
            _write(SIGNATURE_FORMATS, _named(path, label), table, conditions, errors)


def _read(path: Path) -> SceneFile:
    read = load_scene(path)
    for note in read.notes:
        print(note)
    return read


def _of(read: SceneFile, compute: Callable[[], Any]) -> Any:
    """What `compute` returns; its errors name the file."""
    try:
        return compute()
    except (ValueError, RuntimeError) as error:
        raise ValueError(f"{read.file}: {error}") from error


def _write(
    formats: dict[str, Format], path: Path, result: Image | Signature, conditions: Conditions, errors: ErrorBudget
) -> None:
    formats[path.suffix].save(path, result, conditions, errors)
    print(f"wrote {path}")


def _show(arguments: argparse.Namespace) -> None:
    outputs = _outputs(arguments.output, [], SHOW_FORMATS)
    read = _read(arguments.scene)
    _of(read, partial(_check, read))
    print(read.describe())
    for path in outputs:
        _save_figure(path, plot.scene_view(read.scene, read.cameras))
        print(f"wrote {path}")


def _check(read: SceneFile) -> None:
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
