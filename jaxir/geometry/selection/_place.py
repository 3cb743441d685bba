"""Faces by where their centres lie and by where they look."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxir.geometry.selection._selection import AbstractSelection, LabelledFaces

Point = tuple[float, float, float]


def vector(field: str, value: Any) -> Point:
    """Three finite numbers, or `ValueError`."""
    try:
        found = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        found = np.zeros(0)
    if found.shape != (3,) or not np.isfinite(found).all():
        raise ValueError(f"{field}: got {value!r}, expected three finite numbers")
    x, y, z = found.tolist()
    return x, y, z


def direction(field: str, value: Any) -> Point:
    """Three finite numbers that are not all 0, or `ValueError`."""
    found = vector(field, value)
    if not any(found):
        raise ValueError(f"{field}: got {value!r}, expected a direction, not all 0")
    return found


def _unit(value: Any) -> np.ndarray:
    return np.asarray(value) / np.linalg.norm(value)


def require_number(field: str, value: Any, low: float, high: float, expected: str) -> float:
    """A number above `low` and at most `high`, or `ValueError`."""
    number = float(value) if np.ndim(value) == 0 and not isinstance(value, str) else np.nan
    if not low < number <= high:
        raise ValueError(f"{field}: got {value!r}, expected {expected}")
    return number


def _range(field: str, value: Any) -> tuple[float, float]:
    """The ends of a range."""
    try:
        ends = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        ends = np.zeros(0)
    if ends.shape != (2,) or not ends[0] <= ends[1]:
        raise ValueError(f"{field}: got {value!r}, expected two numbers [m], the lower first")
    return float(ends[0]), float(ends[1])


@dataclass(frozen=True)
class InBox(AbstractSelection):
    """Faces whose centre (the mean of the corners) lies in a box along the body axes.

    Attributes:
        x: the lower and the upper end [m]; None for no limit.
        y: likewise.
        z: likewise.
    """

    x: Any = None
    y: Any = None
    z: Any = None

    def __post_init__(self) -> None:
        """Check the ranges."""
        for axis in "xyz":
            ends = getattr(self, axis)
            object.__setattr__(self, axis, None if ends is None else _range(f"InBox.{axis}", ends))

    def holds(self, faces: LabelledFaces) -> np.ndarray:
        """See `AbstractSelection.holds`."""
        ranges = [getattr(self, axis) or (-np.inf, np.inf) for axis in "xyz"]
        low, high = np.transpose(ranges)
        return ((faces.centre >= low) & (faces.centre <= high)).all(axis=1)


@dataclass(frozen=True)
class AbovePlane(AbstractSelection):
    """Faces whose centre lies on the side of a plane to which its normal points: (centre - point) . normal > 0.

    Attributes:
        point: of the plane [3] [m].
        normal: of the plane [3], of any length.
    """

    point: Any
    normal: Any

    def __post_init__(self) -> None:
        """Check both."""
        object.__setattr__(self, "point", vector("AbovePlane.point", self.point))
        object.__setattr__(self, "normal", direction("AbovePlane.normal", self.normal))

    def holds(self, faces: LabelledFaces) -> np.ndarray:
        """See `AbstractSelection.holds`."""
        return (faces.centre - np.asarray(self.point)) @ _unit(self.normal) > 0


@dataclass(frozen=True)
class InCylinder(AbstractSelection):
    """Faces whose centre lies in a cylinder.

    Attributes:
        start: one end of its axis [3] [m].
        end: the other [3] [m].
        radius: [m].
    """

    start: Any
    end: Any
    radius: float

    def __post_init__(self) -> None:
        """Check all three."""
        object.__setattr__(self, "start", vector("InCylinder.start", self.start))
        object.__setattr__(self, "end", vector("InCylinder.end", self.end))
        if self.start == self.end:
            raise ValueError(f"InCylinder.end: got {self.end!r}, which is its start, expected another point")
        require_number("InCylinder.radius", self.radius, 0, np.inf, "a number > 0")

    def holds(self, faces: LabelledFaces) -> np.ndarray:
        """See `AbstractSelection.holds`."""
        start, end = np.asarray(self.start), np.asarray(self.end)
        length = np.linalg.norm(end - start)
        apart = faces.centre - start
        along = apart @ ((end - start) / length)
        across = np.sum(apart**2, axis=1) - along**2
        return (along >= 0) & (along <= length) & (across <= self.radius**2)


@dataclass(frozen=True)
class Facing(AbstractSelection):
    """Faces whose outward normal lies within an angle of a direction.

    Attributes:
        direction: [3], of any length.
        within: the angle [deg].
    """

    direction: Any
    within: float = 45.0

    def __post_init__(self) -> None:
        """Check both."""
        object.__setattr__(self, "direction", direction("Facing.direction", self.direction))
        require_number("Facing.within", self.within, 0, 180, "degrees above 0, at most 180")

    def holds(self, faces: LabelledFaces) -> np.ndarray:
        """See `AbstractSelection.holds`."""
        cosine = faces.normal @ _unit(self.direction)
        return (cosine >= np.cos(np.deg2rad(self.within))) & faces.normal.any(axis=1)
