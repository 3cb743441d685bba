"""Axisymmetric solutions: a half plane or a wedge beside an axis stands for all that is around it."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxir.io._axes import direction

WIDEST = np.pi / 2  # angle of a wedge [rad]
FLAT = 1e-3  # angle below which it is a plane [rad]


class Revolution(NamedTuple):
    """The middle half plane of an axisymmetric solution, in the coordinates of its file.

    Attributes:
        along: unit vector of the axis, which passes through the origin [3].
        outward: unit vector across it in the half plane [3].
        angle: of the wedge, 0 for a plane [rad].
    """

    along: np.ndarray
    outward: np.ndarray
    angle: float

    def folded(self, point: np.ndarray) -> np.ndarray:
        """The points of the half plane [point, 3] at the place along the axis and the distance from it of others."""
        place = point @ self.along
        radius = np.linalg.norm(point - place[:, None] * self.along, axis=1)
        return place[:, None] * self.along + radius[:, None] * self.outward

    def bounds(self, points: np.ndarray) -> np.ndarray:
        """The eight corners of a box around all that points stand for [8, 3]."""
        place = points @ self.along
        radius = np.linalg.norm(points - place[:, None] * self.along, axis=1).max()
        least = np.eye(3)[np.argmin(np.abs(self.along))]
        one = np.cross(self.along, least) / np.linalg.norm(np.cross(self.along, least))
        other = np.cross(self.along, one)  # of an axis of the file both are axes of the file
        return np.array(
            [
                a * self.along + b * one + c * other
                for a in (place.min(), place.max())
                for b in (-radius, radius)
                for c in (-radius, radius)
            ]
        )

    def volumes(self, size: np.ndarray, centre: np.ndarray) -> np.ndarray:
        """Volumes of the rings for which cells stand [cell], from their areas or, in a wedge, volumes.

        Of a plane by Pappus, 2 pi r A. A flat-sided wedge is 2 r tan(angle / 2) thick at the distance r of its middle
        plane from the axis, so its cell stands for pi / tan(angle / 2) times its volume.
        """
        if self.angle:
            return size * np.pi / np.tan(self.angle / 2)
        return size * 2 * np.pi * (centre @ self.outward)


def revolution(file: Path, points: np.ndarray, axis: str) -> Revolution:
    """Find the half plane of an axisymmetric solution.

    Args:
        file: named in errors.
        points: of the solution [point, 3].
        axis: direction of its axis, which passes through the origin.

    Returns:
        The half plane.

    Raises:
        ValueError: no direction, or points on more than one side of the axis.
    """
    along = direction("axisymmetric", axis)
    across = points - (points @ along)[:, None] * along
    radius = np.linalg.norm(across, axis=1)
    off = across[radius > 1e-2 * radius.max(initial=0.0)]
    guess = off[0] if len(off) else np.zeros(3)
    guess = guess / (np.linalg.norm(guess) or 1.0)
    other = np.cross(along, guess)
    around = np.arctan2(off @ other, off @ guess)
    low, high = around.min(initial=0.0), around.max(initial=0.0)
    if not len(off) or high - low > WIDEST:
        raise ValueError(
            f"{file}: got points over {np.degrees(high - low):.3g} degrees around the axis {axis} through the origin, "
            f"expected a half plane or a wedge of at most 90 beside it"
        )
    middle = (low + high) / 2
    angle = float(high - low)
    return Revolution(along, np.cos(middle) * guess + np.sin(middle) * other, angle if angle > FLAT else 0.0)
