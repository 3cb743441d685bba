"""Images, signature tables and values of faces out: NPZ, float32 TIFF, CSV, PLY. Each is written whole or not."""

from __future__ import annotations

import csv
import os

import numpy as np
from numpy.typing import ArrayLike

from jaxir.geometry.mesh import Mesh
from jaxir.io.files import written_whole
from jaxir.render import Image, Signature

BLUE, WHITE, RED = (33.0, 102.0, 172.0), (247.0, 247.0, 247.0), (178.0, 24.0, 43.0)  # of a diverging scale


def save_image(path: str | os.PathLike, image: Image) -> None:
    """Write an image as NPZ.

    The arrays: radiance and standard_error [row, column, band] in W m-2 sr-1, empty [row or 1, column or 1, band],
    bands, pixel [2] in m, inverse_range in m-1, frame [3, 3] and target [3] of the camera, unit.

    Args:
        path: the file, ending in .npz.
        image: what to write.

    Raises:
        ValueError: another ending, or a folder that does not exist.
    """
    _require_suffix(path, ".npz")
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
            unit="W m-2 sr-1",
        )


def save_tiff(path: str | os.PathLike, image: Image) -> None:
    """Write an image's radiance as a float32 TIFF with one page per band, labelled with band and unit.

    Args:
        path: the file, ending in .tif or .tiff.
        image: what to write.

    Raises:
        ValueError: another ending, or a folder that does not exist.
        ImportError: tifffile is not installed.
    """
    try:
        import tifffile
    except ImportError as error:
        raise ImportError('writing TIFF needs tifffile: pip install "jaxir[image]"') from error
    _require_suffix(path, ".tif", ".tiff")
    radiance = np.asarray(image.radiance, np.float32)
    with written_whole(path) as part, tifffile.TiffWriter(part) as writer:
        for index, band in enumerate(image.bands):
            writer.write(
                radiance[:, :, index],
                photometric="minisblack",
                description=f"{band} radiance, W m-2 sr-1",
                metadata=None,
            )


def save_signature(path: str | os.PathLike, signature: Signature) -> None:
    """Write a signature as CSV: azimuth_deg, elevation_deg, then intensity and standard error of every band in W/sr.

    Raises:
        ValueError: another ending than .csv, or a folder that does not exist.
    """
    _require_suffix(path, ".csv")
    columns = [f"{band}_{what}" for band in signature.bands for what in ("W_per_sr", "standard_error_W_per_sr")]
    values = np.stack([np.asarray(signature.intensity), np.asarray(signature.standard_error)], axis=-1)
    with written_whole(path) as part, part.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["azimuth_deg", "elevation_deg", *columns])
        for azimuth, elevation, row in zip(signature.azimuth, signature.elevation, values, strict=True):
            numbers = [float(azimuth), float(elevation), *row.ravel().tolist()]
            writer.writerow([f"{number:.9g}" for number in numbers])


def face_colours(value: ArrayLike, largest: float) -> np.ndarray:
    """Colours [face, 3] of values [face]: blue at -largest, white at 0, red at +largest, linear between."""
    share = np.clip(np.asarray(value, np.float64) / largest, -1, 1)
    ends = np.where(share[:, None] < 0, np.array(BLUE), np.array(RED))
    mixed = np.array(WHITE) + np.abs(share)[:, None] * (ends - np.array(WHITE))
    return np.rint(mixed).astype(np.uint8)


def save_face_values(path: str | os.PathLike, mesh: Mesh, value: ArrayLike, *, name: str, unit: str) -> None:
    """Write a mesh with a value per face, as colour and as number, as binary PLY.

    Every face carries `red`, `green`, `blue` and its number as the float property `value`; comments in the header say
    what the value is, its unit and which values have which colours.

    Args:
        path: the file, ending in .ply.
        mesh: the triangles; coordinates are written in metres.
        value: one number per face [face].
        name: what the value is, such as "d(intensity)/d(emissivity)".
        unit: of the value.

    Raises:
        ValueError: another ending, a folder that does not exist, values that are not finite or not one per face.
    """
    _require_suffix(path, ".ply")
    number = np.asarray(value, np.float64)
    if number.shape != (mesh.count,) or not np.isfinite(number).all():
        raise ValueError(f"value: got shape {number.shape}, expected {mesh.count} finite numbers, one per face")
    largest = float(np.abs(number).max()) or 1.0
    vertices = np.asarray(mesh.vertices, "<f4")
    face = np.zeros(mesh.count, [("count", "u1"), ("corner", "<i4", 3), ("colour", "u1", 3), ("value", "<f4")])
    face["count"], face["corner"] = 3, np.asarray(mesh.faces)
    face["colour"], face["value"] = face_colours(number, largest), number
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment value: {name} [{unit}]",
        f"comment colours: blue {-largest:.6g}, white 0, red {largest:.6g} {unit}, linear between",
        "comment coordinates in metres",
        f"element vertex {len(vertices)}",
        *(f"property float {axis}" for axis in "xyz"),
        f"element face {mesh.count}",
        "property list uchar int vertex_indices",
        *(f"property uchar {colour}" for colour in ("red", "green", "blue")),
        "property float value",
        "end_header\n",
    ]
    with written_whole(path) as part, part.open("wb") as stream:
        stream.write("\n".join(header).encode("ascii", "replace"))
        stream.write(vertices.tobytes())
        stream.write(face.tobytes())


def _require_suffix(path: str | os.PathLike, *endings: str) -> None:
    if not str(path).endswith(endings):
        raise ValueError(f"{path}: expected a file name that ends in {' or '.join(endings)}")
