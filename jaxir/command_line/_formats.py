"""Kinds of files that commands write."""

from __future__ import annotations

import contextlib
import importlib.util
import itertools
import stat
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

from jaxir import plot
from jaxir.command_line._inputs import inputs_of
from jaxir.command_line._quantities import named
from jaxir.imaging import Image, Signature
from jaxir.io._files import written_whole
from jaxir.io.result import (
    Conditions,
    require_afsim_name,
    require_suffix,
    save_afsim,
    save_image,
    save_netcdf,
    save_signature,
    save_tiff,
)

PICTURES = (".png", ".gif")


class Format(NamedTuple):
    """A kind of file: what is said of it, the package that it needs with its extra, and how it is written."""

    said: str
    needs: tuple[str, str] | None
    save: Callable[..., None]


def save_figure(path: Path, figure: Any, conditions: Conditions | None = None) -> None:
    """Write a figure as PNG, whose description is the quantity of the conditions."""
    about = {} if conditions is None else {"Description": str(conditions["quantity"])}
    require_suffix(path, ".png")
    with written_whole(path) as part:
        figure.savefig(part, dpi=120, format="png", metadata=about)


def image_figure(image: Image, **options: str) -> Any:
    """The picture of an image, or of its components where no other quantity is asked for."""
    if image.parts is not None and options.get("quantity", "radiance") == "radiance":
        return plot.component_panels(image, scale=options.get("scale", "auto"))
    return plot.radiance_image(image, **options)


def signature_figure(table: Signature, **options: str) -> Any:
    """The picture of a signature, or of its components."""
    return plot.polar_signature(table, **options) if table.parts is None else plot.component_signature(table)


def save_film(path: Path, images: dict[str, Image], **options: Any) -> None:
    """Write a sequence of images as a film."""
    film = plot.film(images, **options)
    with written_whole(path) as part:
        part.write_bytes(film)


def save_text(path: Path, text: str) -> None:
    """Write a text."""
    with written_whole(path) as part:
        part.write_text(text, encoding="utf-8")


RENDER_FORMATS = {
    ".npz": Format("every number, for numpy", None, save_image),
    ".tif": Format(
        "float32 TIFF, a page per band (extra image)",
        ("tifffile", "image"),
        lambda path, image, conditions, errors: save_tiff(path, image, conditions),
    ),
    ".nc": Format("NetCDF with units and conditions (extra netcdf)", ("xarray", "netcdf"), save_netcdf),
    ".png": Format(
        "picture with colour bar, and one of each component (extra plot)",
        ("matplotlib", "plot"),
        lambda path, image, conditions, errors, **options: save_figure(
            path, image_figure(image, **options), conditions
        ),
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
        "polar plot, or lines by component (extra plot)",
        ("matplotlib", "plot"),
        lambda path, table, conditions, errors, **options: save_figure(
            path, signature_figure(table, **options), conditions
        ),
    ),
}
FILM_FORMATS = {
    ".gif": Format("film (extra plot)", ("matplotlib", "plot"), save_film),
    ".png": Format(
        "strip of twelve frames at most (extra plot)",
        ("matplotlib", "plot"),
        lambda path, images, **options: save_figure(path, plot.film_strip(images, **options)),
    ),
}
REPORT_FORMATS = {
    ".html": Format("one page that holds everything (extra plot)", ("matplotlib", "plot"), save_text),
}
SHOW_FORMATS = {
    ".png": Format("mesh, plume, lights and cameras (extra plot)", ("matplotlib", "plot"), save_figure),
}


def outputs_of(asked: list[Path] | None, default: list[Path], formats: dict[str, Format]) -> list[Path]:
    """The files to write, once it is known that they can be."""
    outputs = default if asked is None else asked
    for path in outputs:
        require_suffix(path, *formats)
        needs = formats[path.suffix].needs
        if needs is not None and importlib.util.find_spec(needs[0]) is None:
            raise ImportError(f'{path}: writing it needs {needs[0]}: pip install "jaxir[{needs[1]}]"')
    return outputs


def targets(outputs: Iterable[Path], camera: str, label: str) -> list[Path]:
    """The files of an image or table: those asked for, with what camera and quantity add to their names."""
    return [named(path, f"_{camera}" if camera else "", label) for path in outputs]


def require_targets(scene: Path, outputs: list[Path], cameras: Iterable[str], labels: Iterable[str]) -> None:
    """Raise `ValueError` unless the files of all cameras and quantities can be written, none over one of the scene."""
    inputs, written = {path.resolve() for path in inputs_of(scene).values()}, set()
    for camera, label in itertools.product(cameras, labels):
        for path in targets(outputs, camera, label):
            place = path.resolve()
            if place in inputs:
                raise ValueError(f"-o {path}: got a file that {scene.name} is read from, expected another name")
            if place in written:
                raise ValueError(f"-o {path}: got it twice, expected different files")
            written.add(place)
            try:
                _require_target(path)
            except (OSError, ValueError) as error:
                raise ValueError(f"-o {path}: {getattr(error, 'strerror', None) or error}") from error


def _require_target(path: Path) -> None:
    if path.suffix == ".txt":
        require_afsim_name(path.stem)
    with contextlib.suppress(FileNotFoundError):
        if stat.S_ISDIR(path.stat().st_mode):
            raise ValueError("got a folder, expected a file")
    try:  # what the folder's mode says does not hold for every user and file system
        tempfile.TemporaryFile(dir=path.parent).close()
    except OSError as error:
        raise ValueError(f"the folder {path.parent} may not be written") from error


def write(formats: dict[str, Format], paths: Iterable[Path], *result: Any, **options: str) -> None:
    """Write a result to every path by its ending, and say so; the first error is raised when all were tried.

    Options are those of a picture.
    """
    failed: list[Exception] = []
    for path in paths:
        try:
            formats[path.suffix].save(path, *result, **(options if path.suffix in PICTURES else {}))
            print(f"wrote {path}")
        except Exception as error:
            failed.append(error)
    if failed:
        raise failed[0]
