"""How the coordinates of a file lie in the body axes: unit, directions and place."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np

METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "km": 1e3, "in": 0.0254, "ft": 0.3048}
_ALONG = {sign + "xyz"[i]: number * np.eye(3)[i] for i in range(3) for sign, number in (("", 1), ("+", 1), ("-", -1))}


def metres(unit: Any) -> float:
    """Metres of a length unit: one of `METRES`, or a number, say 0.02 for a model of a fiftieth in m.

    Raises:
        ValueError: another name, or a number that is not finite and positive.
    """
    if isinstance(unit, str) and unit in METRES:
        return METRES[unit]
    if isinstance(unit, Real) and not isinstance(unit, bool) and 0 < float(unit) < np.inf:
        return float(unit)
    raise ValueError(f"unit: got {unit!r}, expected one of {', '.join(METRES)}, or the unit's metres, a number > 0")


def direction(name: str, given: Any) -> np.ndarray:
    """A unit vector [3] from "x", "+x", "-x", ... or from three numbers; `name` is said in errors."""
    if isinstance(given, str) and given in _ALONG:
        return _ALONG[given]
    vector = np.zeros(0) if isinstance(given, str) else np.asarray(given, np.float64)
    length = np.linalg.norm(vector) if vector.shape == (3,) else 0.0
    if not 0 < length < np.inf:
        raise ValueError(f"{name}: got {given!r}, expected +x, -x, +y, -y, +z, -z or three numbers, not all 0")
    return vector / length


@dataclass(frozen=True)
class Axes:
    """Where the body axes are in a file: x to the nose, y to the left wing, z up, see the conventions.

        x_body = R x_file + offset, with the rows nose, up x nose and up of R

    R is a rotation: a file is turned and never mirrored.

    Attributes:
        nose: direction to the nose in the file's coordinates: "+x", "-x", "+y", ... or three numbers.
        up: direction up, likewise; of three numbers that part counts which is across the nose.
        offset: where the origin of the file lies in the body axes [3] [m].

    Raises:
        ValueError: no direction, up along the nose, an offset that is not three finite numbers.
    """

    nose: Any = "+x"
    up: Any = "+z"
    offset: Any = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """Check all three."""
        if np.linalg.norm(np.cross(direction("nose", self.nose), direction("up", self.up))) < 1e-6:
            raise ValueError(f"up: got {self.up!r} along the nose, {self.nose!r}, expected another direction")
        if np.shape(self.offset) != (3,) or not np.isfinite(np.asarray(self.offset, np.float64)).all():
            raise ValueError(f"offset: got {self.offset!r}, expected three finite numbers in m")

    @property
    def rotation(self) -> np.ndarray:
        """R [3, 3]."""
        nose, up = direction("nose", self.nose), direction("up", self.up)
        left = np.cross(up, nose)
        left = left / np.linalg.norm(left)
        return np.stack([nose, left, np.cross(nose, left)])

    def to_body(self, point: np.ndarray, unit: float) -> np.ndarray:
        """Points [..., 3] of a file whose unit is `unit` metres, in body axes [m]."""
        return unit * point @ self.rotation.T + np.asarray(self.offset, np.float64)

    def to_file(self, point: np.ndarray, unit: float) -> np.ndarray:
        """The inverse of `to_body`."""
        return (point - np.asarray(self.offset, np.float64)) @ self.rotation / unit
