"""Infrared signatures for AFSIM, the Advanced Framework for Simulation, Integration, and Modeling.

The layout is that of AFSIM's documentation, pages "infrared_signature", "WSF_INFRARED_SIGNATURE" and
"Azimuth-Elevation Table Definition": `state default`, for every `band` an `inline_table <unit> <azimuths> <elevations>`
whose first row holds the elevations and whose other rows an azimuth and its values. What else varies (`Signature.axes`)
becomes states, `state mach_0.9_altitude_9000`, of which the first is the default, too. Azimuths rise within
-180 ... 180, elevations within -90 ... 90 degrees, at least two of each. Its entities' axes are those of IEEE 1278.1
(page "Coordinate Systems"), x to the nose, y to the right, z down, so its azimuths run to the right wing and ours to
the left: the sign changes.

AFSIM's sensors subtract the background and multiply by the transmittance of the air themselves (page on the equations
of the IRST sensor: I_source - L_background A_projected, times transmittance), so the table they want is that of the
source: without air and background, `jaxir.alone(jaxir.at_target(scene))`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence

import numpy as np

from jaxir.imaging import Signature
from jaxir.io._files import labels, written_whole
from jaxir.io.result._results import Conditions, require_suffix

BANDS = {"SWIR": "short", "MWIR": "medium", "LWIR": "long", "VLWIR": "very_long"}


def save_afsim(path: str | os.PathLike, signature: Signature, name: str, conditions: Conditions | None = None) -> None:
    """Write a signature as AFSIM's `infrared_signature`.

    SWIR, MWIR, LWIR and VLWIR become AFSIM's bands short, medium, long and very_long; a single band of another name
    becomes `default`. Straight behind, azimuth 180, is given at both ends of the circle.

    Args:
        path: the file, ending in .txt.
        signature: intensities of the source [W/sr] at all combinations of azimuths and elevations, in any order;
            azimuths in -180 ... 360.
        name: of the signature in AFSIM.
        conditions: pairs that become comments.

    Raises:
        ValueError: another ending, a folder that does not exist, a name or band that AFSIM cannot take, aspects that
            are no full table, an intensity below zero.
    """
    require_suffix(path, ".txt")
    require_afsim_name(name)
    aspect = np.stack([signature.azimuth, signature.elevation], axis=1)
    states = _states(signature)
    for rows in states.values():
        require_full_table(aspect[rows], signature.bands)
    lines = [f"# {label}: {' '.join(str(value).split())}" for label, value in (conditions or {}).items()]
    lines.append(f"infrared_signature {name}")
    for state, rows in states.items():
        azimuth, elevation, table = _full_table(signature, rows)
        lines.append(f"   state {state}")
        for place, band in enumerate(signature.bands):
            lines += [
                f"      band {BANDS.get(band, 'default')}",
                f"         inline_table w/sr {azimuth.size} {elevation.size}",
                _row("", elevation),
                *(_row(f"{angle:g}", row) for angle, row in zip(azimuth, table[:, :, place], strict=True)),
                "         end_inline_table",
            ]
    lines.append("end_infrared_signature")
    with written_whole(path) as part:
        part.write_text("\n".join(lines) + "\n", encoding="ascii", errors="replace")


def require_afsim_name(name: str) -> None:
    """Raise `ValueError` unless a signature can be called so."""
    if not re.fullmatch(r"\w[\w-]*", name, re.ASCII):
        raise ValueError(f"name: got {name!r}, expected letters, digits, _ and -")


def require_full_table(views: np.ndarray, bands: Sequence[str]) -> None:
    """Raise `ValueError` unless aspects [view, 2] [deg] and bands can become a table of AFSIM."""
    if len(bands) > 1 and not all(band in BANDS for band in bands):
        raise ValueError(f"bands: got {', '.join(bands)}, expected one, or some of {', '.join(BANDS)}")
    if (views[:, 0] < -180).any() or (views[:, 0] > 360).any() or (np.abs(views[:, 1]) > 90).any():
        raise ValueError("views: got angles beyond, expected azimuths in -180 ... 360 and elevations in -90 ... 90")
    turned = {(azimuth % 360, elevation) for azimuth, elevation in views.tolist()}
    azimuths, elevations = ({aspect[axis] for aspect in turned} for axis in (0, 1))
    if len(azimuths) < 2 or len(elevations) < 2 or len(turned) != len(azimuths) * len(elevations):
        raise ValueError(
            f"views: got {len(turned)} aspects of {len(azimuths)} azimuths and {len(elevations)} elevations, expected "
            "every combination for AFSIM, at least two of each"
        )


def _row(head: str, values: np.ndarray) -> str:
    return f"{head:>20}" + "".join(f" {value:>14.7g}" for value in values)


def _states(signature: Signature) -> dict[str, np.ndarray]:
    """The rows of every state by its name, the first as the default, too."""
    if signature.state is None:
        return {"default": np.arange(signature.azimuth.size)}
    every, first, state = np.unique(np.asarray(signature.state), axis=0, return_index=True, return_inverse=True)
    named = [labels(values, 6) for values in every.T.tolist()]
    found = {}
    for index in np.argsort(first).tolist():
        own = zip(signature.axes, named, every[index].tolist(), strict=True)
        name = "_".join(f"{axis}_{names[value]}" for axis, names, value in own)
        found[name] = np.flatnonzero(state.reshape(-1) == index)
    return {"default": next(iter(found.values())), **found}


def _full_table(signature: Signature, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rising azimuths as AFSIM counts them, rising elevations, and intensities [azimuth, elevation, band] of rows."""
    given = np.stack([np.asarray(signature.azimuth), np.asarray(signature.elevation)], axis=1).astype(np.float64)[rows]
    turned = np.where(given[:, 0] > 180, given[:, 0] - 360, given[:, 0])
    intensity = np.asarray(signature.intensity, np.float64)[rows]
    if not (intensity >= 0).all():
        raise ValueError(f"intensity: got {intensity.min():g} W/sr, expected values >= 0: the source's, not a contrast")
    held = {
        (-azimuth or 0.0, elevation): row
        for (azimuth, elevation), row in zip(np.stack([turned, given[:, 1]], 1).tolist(), intensity, strict=True)
    }
    elevation = np.unique(given[:, 1])
    for one, other in ((-180.0, 180.0), (180.0, -180.0)):  # the same direction, which AFSIM wants at both ends
        for angle in elevation.tolist():
            if (one, angle) in held:
                held.setdefault((other, angle), held[one, angle])
    azimuth = np.unique([key[0] for key in held])
    table = np.array([[held[a, e] for e in elevation.tolist()] for a in azimuth.tolist()])
    return azimuth, elevation, table
