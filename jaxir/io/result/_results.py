"""Images and signature tables out: NPZ, float32 TIFF, NetCDF, CSV. Every file is written whole or not at all.

`conditions` say of what and how a result was computed: pairs of a name and a text or number that go into the file.
`errors` is the result's `error_budget()`, whose known parts and total [W sr-1] go into the file, too.
"""

from __future__ import annotations

import csv
import json
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxir._fields import require_part
from jaxir.imaging import ErrorBudget, Image, Signature
from jaxir.io._files import labels, written_whole

Conditions = Mapping[str, str | int | float]
RADIANCE = "W m-2 sr-1"
INTENSITY = "W sr-1"


def _columns(errors: ErrorBudget | None) -> dict[str, np.ndarray]:
    """Known errors [*view, band] by the name that they have in files."""
    found = {} if errors is None else errors.written()
    return {f"{name}_error": np.asarray(values) for name, values in found.items() if values is not None}


def _split(result: Image | Signature) -> dict[str, np.ndarray]:
    """Components by the name that they have in files: radiances of an image, and intensities; none without."""
    if result.parts is None:
        return {}
    found: dict[str, Any]
    if isinstance(result, Signature):
        found = {"component_intensity": result.parts, "component_error": result.parts_error}
    else:
        error = None if result.parts_error is None else result.component_error()
        found = {"component_intensity": result.component_intensity(), "component_error": error}
        found["component_radiance"] = result.parts
    return {name: np.asarray(values) for name, values in found.items() if values is not None}


def save_image(
    path: str | os.PathLike, image: Image, conditions: Conditions | None = None, errors: ErrorBudget | None = None
) -> None:
    """Write an image as NPZ.

    The arrays: radiance and standard_error [row, column, band] in W m-2 sr-1, empty [row or 1, column or 1, band],
    bands, pixel [2] in m, inverse_range in m-1, frame [3, 3] and target [3] of the camera, unit, and the conditions
    as JSON; with `errors` intensity, sampling_error, spectral_error and so on to total_error [band] in W sr-1; of an
    image by component components, component_radiance [row, column, component, band], component_intensity and
    component_error [component, band].

    Args:
        path: the file, ending in .npz.
        image: what to write.
        conditions: see this module's head.
        errors: likewise.

    Raises:
        ValueError: another ending, or a folder that does not exist.
    """
    require_suffix(path, ".npz")
    require_part("image", image, Image, "an image, of jaxir.render")
    more: dict[str, Any] = {} if errors is None else {"intensity": np.asarray(errors.intensity), **_columns(errors)}
    if image.parts is not None:
        more |= {"components": np.array(image.components), **_split(image)}
    with written_whole(path) as part, part.open("wb") as stream:
        np.savez_compressed(
            stream,
            radiance=np.asarray(image.radiance),
            standard_error=np.asarray(image.standard_error),
            empty=np.asarray(image.empty),
            bands=np.array(image.bands),
            pixel=np.asarray(image.camera.pixel),
            inverse_range=np.asarray(image.camera.inverse_range),
            frame=np.asarray(image.camera.frame),
            target=np.asarray(image.camera.target),
            unit=RADIANCE,
            conditions=json.dumps(dict(conditions or {})),
            **more,
        )


def save_tiff(path: str | os.PathLike, image: Image, conditions: Conditions | None = None) -> None:
    """Write an image's radiance as a float32 TIFF with one page per band, labelled with band, unit and conditions.

    Args:
        path: the file, ending in .tif or .tiff.
        image: what to write.
        conditions: see this module's head.

    Raises:
        ValueError: another ending, or a folder that does not exist.
        ImportError: tifffile is not installed.
    """
    try:
        import tifffile
    except ImportError as error:
        raise ImportError('writing TIFF needs tifffile: pip install "jaxir[image]"') from error
    require_suffix(path, ".tif", ".tiff")
    require_part("image", image, Image, "an image, of jaxir.render")
    radiance = np.asarray(image.radiance, np.float32)
    said = "".join(f"; {name}: {value}" for name, value in (conditions or {}).items())
    with written_whole(path) as part, tifffile.TiffWriter(part) as writer:
        for index, band in enumerate(image.bands):
            described = f"{band} radiance, {RADIANCE}{said}".encode("ascii", "replace").decode()
            writer.write(radiance[:, :, index], photometric="minisblack", description=described, metadata=None)


def save_netcdf(
    path: str | os.PathLike,
    result: Image | Signature,
    conditions: Conditions | None = None,
    errors: ErrorBudget | None = None,
) -> None:
    """Write an image or a signature as NetCDF (version 3), through xarray.

    An image holds radiance and standard_error [row, column, band] and empty, with the place of the pixels' centres in
    the plane through the target [m]; a signature holds intensity and standard_error [view, band] with azimuth and
    elevation [view] in degrees. Every variable has its `units`; the conditions are attributes of the file. With
    `errors` there are sampling_error, spectral_error and so on to total_error, of an image [band] with its intensity.
    By component there are component_intensity and component_error [..., component, band], and component_radiance of an
    image. What else varies in a table (`Signature.axes`) is a coordinate over its views.

    Args:
        path: the file, ending in .nc.
        result: what to write.
        conditions: see this module's head.
        errors: likewise.

    Raises:
        ValueError: another ending, a folder that does not exist, or conditions that no attribute holds.
        ImportError: xarray is not installed.
    """
    try:
        import xarray
    except ImportError as error:
        raise ImportError('writing NetCDF needs xarray: pip install "jaxir[netcdf]"') from error
    require_suffix(path, ".nc")
    data = xarray.Dataset(*(_image_data(result) if isinstance(result, Image) else _signature_data(result)))
    if errors is not None:
        axes = ("view", "band")[-errors.intensity.ndim :]
        for name, values in {"intensity": np.asarray(errors.intensity), **_columns(errors)}.items():
            data[name] = axes, values, {"units": INTENSITY}
    for name, values in _split(result).items():
        radiance = name == "component_radiance"
        axes = ("row", "column", "component", "band") if radiance else ("view", "component", "band")[-values.ndim :]
        data[name] = axes, values, {"units": RADIANCE if radiance else INTENSITY}
        data.coords["component"] = "component", list(result.components)
    data.attrs.update(_attributes(conditions or {}))
    with written_whole(path) as part:
        data.to_netcdf(part, engine="scipy")


def _image_data(image: Image) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Variables, coordinates and attributes."""
    camera, (rows, columns) = image.camera, image.camera.shape
    width, height = (float(size) for size in camera.pixel)
    axes = ("row", "column", "band")
    empty = np.broadcast_to(np.asarray(image.empty), image.radiance.shape)
    variables = {
        name: (axes, np.asarray(value), {"units": RADIANCE, "long_name": said})
        for name, value, said in (
            ("radiance", image.radiance, "mean radiance over each pixel"),
            ("standard_error", image.standard_error, "standard error of radiance"),
            ("empty", empty, "radiance without the scene"),
        )
    }
    coordinates = {
        "band": ("band", list(image.bands)),
        "x": ("column", (np.arange(columns) + 0.5 - columns / 2) * width, {"units": "m"}),
        "y": ("row", (rows / 2 - np.arange(rows) - 0.5) * height, {"units": "m"}),
    }
    attributes = {
        "inverse_range_per_m": float(camera.inverse_range),
        "target_m": np.asarray(camera.target),
        "frame": np.asarray(camera.frame).ravel(),
    }
    return variables, coordinates, attributes


def _signature_data(table: Signature) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    state = {} if table.state is None else dict(zip(table.axes, np.asarray(table.state).T, strict=True))
    variables = {
        "intensity": (("view", "band"), np.asarray(table.intensity), {"units": INTENSITY}),
        "standard_error": (("view", "band"), np.asarray(table.standard_error), {"units": INTENSITY}),
    }
    coordinates = {
        "band": ("band", list(table.bands)),
        "azimuth": ("view", np.asarray(table.azimuth), {"units": "degree"}),
        "elevation": ("view", np.asarray(table.elevation), {"units": "degree"}),
        **{name: ("view", values) for name, values in state.items()},
    }
    return variables, coordinates, {}


def _attributes(conditions: Mapping[Any, Any]) -> dict[str, Any]:
    """Conditions as attributes of NetCDF, whose integers have 32 bits: larger ones are texts."""
    for name, value in conditions.items():
        if not re.fullmatch(r"[^\W\d]\w*", str(name), re.ASCII):
            raise ValueError(f"conditions: got name {name!r}, expected letters, digits and _, a digit not first")
        if not isinstance(value, str | int | float | np.number):
            raise ValueError(f"conditions: got {name} {value!r}, expected a text or a number")
    large = {name: str(x) for name, x in conditions.items() if isinstance(x, int) and not -(2**31) <= x < 2**31}
    return {**conditions, **large}


def save_signature(
    path: str | os.PathLike,
    signature: Signature,
    conditions: Conditions | None = None,
    errors: ErrorBudget | None = None,
) -> None:
    """Write a signature as CSV: azimuth_deg, elevation_deg, then intensity and standard error of every band in W/sr.

    What else varies (`Signature.axes`) has columns before them. Conditions come first, as comments: lines
    `# name: value`. With `errors` every band has its other errors, too, and a signature by component its components
    with their standard errors, as `MWIR_skin_W_per_sr` and `MWIR_skin_standard_error_W_per_sr`.

    Raises:
        ValueError: another ending than .csv, a folder that does not exist, or bands whose columns have one name.
    """
    require_suffix(path, ".csv")
    require_part("signature", signature, Signature, "a signature, of jaxir.signature")
    others = {name: values for name, values in _columns(errors).items() if name != "sampling_error"}
    named = {"": signature.intensity, "standard_error_": signature.standard_error}
    named |= {f"{name}_": values for name, values in others.items()}
    if signature.parts is not None:
        for index, name in enumerate(_in_letters(signature.components)):
            named[f"{name}_"] = signature.parts[:, index]
            if signature.parts_error is not None:
                named[f"{name}_standard_error_"] = signature.parts_error[:, index]
    columns = [f"{band}_{what}W_per_sr" for band in signature.bands for what in named]
    if twice := [name for name in columns if columns.count(name) > 1]:
        raise ValueError(f"bands: got names {signature.bands} that make the column {twice[0]} twice, expected others")
    values = np.stack([np.asarray(part) for part in named.values()], axis=-1)
    with written_whole(path) as part, part.open("w", newline="", encoding="utf-8") as stream:
        stream.writelines(f"# {name}: {_one_line(value)}\r\n" for name, value in (conditions or {}).items())
        writer = csv.writer(stream)
        writer.writerow([*signature.axes, "azimuth_deg", "elevation_deg", *columns])
        aspect = np.stack([np.asarray(signature.azimuth), np.asarray(signature.elevation)], axis=1)
        state = np.zeros((len(values), 0)) if signature.state is None else np.asarray(signature.state)
        shown = [labels(values, 7) for values in state.T.tolist()]
        numbers = np.concatenate([aspect, values.reshape(len(values), -1)], axis=1)
        for own, row in zip(state.tolist(), numbers.tolist(), strict=True):
            first = (names[value] for names, value in zip(shown, own, strict=True))
            writer.writerow([*first, *(f"{number:.9g}" for number in row)])


def _in_letters(names: Sequence[str]) -> list[str]:
    """Names in letters, digits and _, numbered from the second on where they are alike in these."""
    found: list[str] = []
    for name in names:
        plain = own = re.sub(r"\W+", "_", name)
        count = 1
        while own in found:
            count += 1
            own = f"{plain}_{count}"
        found.append(own)
    return found


def _one_line(value: Any) -> str:
    return " ".join(str(value).split())


def require_suffix(path: str | os.PathLike, *endings: str) -> None:
    """Raise `ValueError` unless a file name ends as its format asks and its folder exists."""
    if Path(path).suffix not in endings:
        raise ValueError(f"{path}: expected a file name that ends in {' or '.join(endings)}, as name{endings[0]}")
    if not Path(path).parent.is_dir():
        raise ValueError(f"{path}: the folder {Path(path).parent} does not exist")
