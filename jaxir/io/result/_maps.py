"""Values of faces out: coloured PLY, written whole or not at all."""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import ArrayLike

from jaxir.geometry.search import Mesh
from jaxir.io._files import written_whole
from jaxir.io.result._results import require_suffix

BLUE, WHITE, RED = (33.0, 102.0, 172.0), (247.0, 247.0, 247.0), (178.0, 24.0, 43.0)  # of a diverging scale


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
    require_suffix(path, ".ply")
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
