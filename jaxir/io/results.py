"""Images and signature tables out: NPZ, float32 TIFF, CSV. Every file is written whole or not at all."""

from __future__ import annotations

import csv
import os

import numpy as np

from jaxir.io.files import written_whole
from jaxir.render import Image, Signature


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


def _require_suffix(path: str | os.PathLike, *endings: str) -> None:
    if not str(path).endswith(endings):
        raise ValueError(f"{path}: expected a file name that ends in {' or '.join(endings)}")
