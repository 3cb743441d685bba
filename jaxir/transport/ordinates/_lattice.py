"""The lattice on which scattered light is solved: its points in a medium's cube, and what lies between them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxir._arrays import as_float
from jaxir._math import INSIDE, tensordot
from jaxir.medium import AbstractScatterer
from jaxir.transport._method import DiscreteOrdinates

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

FINER = 2  # points of the lattice that is read for each of that which is solved
INSET = 1e-3  # of the cube's edges, by which the outer points lie inside


class Lattice(NamedTuple):
    """Points of a medium's cube: those that are solved for and those that are read, and ways from one to the other.

    Attributes:
        solved: how many along each edge.
        read: how many along each edge.
        cubics: see `_cubic`, of each edge.
        lines: the same where lines are drawn between the points that are solved for alone.
    """

    solved: tuple[int, int, int]
    read: tuple[int, int, int]
    cubics: tuple[np.ndarray, ...]
    lines: tuple[np.ndarray, ...]


def lattice_of(medium: AbstractScatterer, ordinates: DiscreteOrdinates) -> Lattice:
    solved = medium.lattice(ordinates.along, ordinates.across)
    cubics, lines = (tuple(way(count) for count in solved) for way in (_cubic, _lines))
    read = tuple(len(matrix) for matrix in cubics)
    return Lattice(solved, (read[0], read[1], read[2]), cubics, lines)


def _cubic(count: int) -> np.ndarray:
    """What is read between `count` even points from values at them [read, solved], by a cubic spline.

    Straight lines between values of a curve lie beside it by h^2 / 12 of its second derivative in the mean, h being
    their length; they are drawn between values from which this is taken, so that sums along rays err less.
    """
    spline, place = _spline(count), _read(count)
    return spline(place) - spline(place, nu=2) / (12 * FINER**2)


def _lines(count: int) -> np.ndarray:
    """The same by straight lines between the even points, with differences in the place of derivatives.

    Those of splines make three times as much of what turns from point to point, more than light scattered in a thick
    plume loses.
    """
    inner = np.clip(np.arange(count), 1, count - 2)
    every = np.eye(count)
    values = every - (every[inner - 1] - 2 * every[inner] + every[inner + 1]) / 12
    return np.stack([np.interp(_read(count), np.arange(count), one) for one in values.T], axis=1)


def _read(count: int) -> np.ndarray:
    """Where it is read between `count` points, in steps of theirs [read]."""
    return np.arange(FINER * (count - 1) + 1) / FINER


def _spline(count: int) -> BSpline:
    """The spline of each of `count` even values by itself, cubic where there are points enough."""
    from scipy.interpolate import make_interp_spline  # which takes long to import

    return make_interp_spline(np.arange(count), np.eye(count), k=min(3, count - 1))


def places(counts: tuple[int, ...]) -> np.ndarray:
    """Places of a lattice in the unit cube [point, 3]."""
    each = [INSET + (1 - 2 * INSET) * np.linspace(0, 1, count) for count in counts]
    return np.stack(np.meshgrid(*each, indexing="ij"), axis=-1).reshape(-1, 3)


def beside(counts: tuple[int, ...]) -> np.ndarray:
    """A quarter of the step from each of `places` to the next along each axis; none from the outer ones [point, 3]."""
    each = [np.where((np.arange(n) > 0) & (np.arange(n) < n - 1), (1 - 2 * INSET) / (4 * (n - 1)), 0) for n in counts]
    return np.stack(np.meshgrid(*each, indexing="ij"), axis=-1).reshape(-1, 3)


def refined(
    lattice: Lattice, table: Float[Array, "point *more"], ways: Sequence[Any] | None = None
) -> Float[Array, "read *more"]:
    """A table at the points that are read, by the lattice's `cubics` or other `ways`."""
    whole = table.reshape(*lattice.solved, -1)
    for axis, matrix in enumerate(lattice.cubics if ways is None else ways):
        whole = jnp.moveaxis(tensordot(as_float(matrix), whole, axes=(1, axis)), 0, axis)
    return whole.reshape(-1, *table.shape[1:])


def at_solved(lattice: Lattice, table: Float[Array, "read *more"]) -> Float[Array, "point *more"]:
    """A table at the points that are read, at those alone that are solved for."""
    whole = table.reshape(*lattice.read, -1)[::FINER, ::FINER, ::FINER]
    return whole.reshape(-1, *table.shape[1:])


class Between(NamedTuple):
    """The eight points of a lattice about a place: four pairs that follow one another, and the shares of both.

    Attributes:
        point: the first of each pair.
        share: of both.
    """

    point: Int[Array, "ray 4"]
    share: Float[Array, "ray 4 2"]

    def read(self, table: Float[Array, "read *more"]) -> Float[Array, "ray *more"]:
        """A table there."""
        shares = self.share.reshape(self.share.shape + (1,) * (table.ndim - 1))
        each = [shares[:, k, side] * table.at[self.point[:, k] + side].get(**INSIDE) for k, side in np.ndindex(4, 2)]
        return sum(each[1:], each[0])


def about(counts: tuple[int, ...], place: Float[Array, "ray 3"]) -> Between:
    last = np.array(counts) - 1
    inner = jnp.clip((place - INSET) / (1 - 2 * INSET), 0, 1) * as_float(last)[None]
    low = jnp.clip(inner.astype(jnp.int32), 0, jnp.asarray(last - 1, jnp.int32)[None])
    high = inner - low.astype(inner.dtype)
    points, shares = [], []
    last_two = jnp.stack([1 - high[:, 2], high[:, 2]], axis=1)
    for corner in np.ndindex(2, 2):
        x, y = (low[:, axis] + side for axis, side in enumerate(corner))
        points.append((x * counts[1] + y) * counts[2] + low[:, 2])
        a, b = (high[:, axis] if side else 1 - high[:, axis] for axis, side in enumerate(corner))
        shares.append((a * b)[:, None] * last_two)
    return Between(jnp.stack(points, axis=1), jnp.stack(shares, axis=1))
