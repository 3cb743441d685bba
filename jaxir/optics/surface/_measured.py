"""Measured reflection: a brdf interpolated in a table."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxir._arrays import Check, as_float, fraction, non_negative
from jaxir._fields import quantity
from jaxir._math import dot, einsum, gauss_legendre, safe_sqrt
from jaxir.optics.surface._brdf import AbstractBrdf, at_face, cosine_density, cosine_direction, facing


class BrdfTable(AbstractBrdf):
    """An isotropic brdf, multilinear between equal steps of (theta_i, theta_o, azimuth between the two).

    The reflectance is the exact integral of the interpolated function,

        rho(theta_o) = 2 sum_jk w_j v_k f_jk(theta_o),   w_j = int hat_j(theta) cos theta sin theta dtheta,

    v_k trapezoidal weights in azimuth, so that emission and reflection agree whatever the table's resolution.
    Directions are sampled by their cosine.

    Attributes:
        value: [face | 1, theta_i, theta_o, azimuth, node | 1] [sr-1]; thetas run from 0 to pi / 2, azimuth from 0
            (backscatter) to pi (the plane of specular reflection).
        albedo: reflectance at the table's theta_o [theta_o, node | 1] of one that was taken `at` a face: an integral
            over the table for each ray would be most of its work; None where it follows from `value`.

    Differentiable in `value`, and in directions between the table's points.
    """

    value: Float[Array, "..."] = quantity("sr-1", None, non_negative)
    albedo: Float[Array, "..."] | None

    def __init__(self, value: Any):
        """Convert and symmetrise.

        Args:
            value: [theta_i, theta_o, azimuth], with a trailing [node] and then a leading [face] axis if wanted, at
                least 2 points an angle [sr-1]. The mean of the table and of itself with theta_i and theta_o exchanged
                is kept, and over the azimuth where one of them is 0 and there is no azimuth: these are laws, what
                breaks them in a measurement is noise.

        Raises:
            ValueError: another number of axes, or different numbers of theta_i and theta_o.
        """
        array = as_float(value, "BrdfTable.value")
        if array.ndim == 3:
            array = array[None, ..., None]
        elif array.ndim == 4:
            array = array[None]
        if array.ndim != 5 or array.shape[1] != array.shape[2] or min(array.shape[1:4]) < 2:
            raise ValueError(
                f"BrdfTable.value: got shape {np.shape(value)}, expected ([face,] theta, theta, azimuth[, node]) with "
                "as many theta_i as theta_o and at least 2 points an angle"
            )
        array = (array + jnp.swapaxes(array, 1, 2)) / 2
        normal = np.minimum(*np.indices(array.shape[1:3]))[None, :, :, None, None] == 0
        even = einsum("fijkn,k->fijn", array, as_float(_trapezoid(array.shape[3])))
        self.value, self.albedo = jnp.where(normal, even[:, :, :, None], array), None

    def at(self, face: Int[Array, "*batch"]) -> BrdfTable:
        """See `AbstractBrdf.at`, with its reflectance."""
        own = tuple(at_face(leaf, face) for leaf in (self.value, self._albedo()))
        return eqx.tree_at(lambda b: (b.value, b.albedo), self, own, is_leaf=lambda leaf: leaf is None)

    @property
    def diffuse(self) -> bool:
        """See `AbstractBrdf.diffuse`."""
        return False

    def eval(
        self, omega_i: Float[Array, " 3"], omega_o: Float[Array, " 3"], normal: Float[Array, " 3"]
    ) -> Float[Array, " node"]:
        """See `AbstractBrdf.eval`."""
        up = facing(omega_o, normal)
        cos_i, cos_o = dot(omega_i, up), dot(omega_o, up)
        azimuth = _azimuth(omega_i - cos_i * up, omega_o - cos_o * up, up)
        table = self.value
        for position in (_angle_from_normal(cos_i), _angle_from_normal(cos_o), azimuth / jnp.pi):
            table = _between(table, position)
        return jnp.where(cos_i > 0, table, 0)

    def sample(
        self, u: Float[Array, " 2"], omega_o: Float[Array, " 3"], normal: Float[Array, " 3"]
    ) -> Float[Array, " 3"]:
        """See `AbstractBrdf.sample`; density cos / pi."""
        return cosine_direction(u, facing(omega_o, normal))

    def pdf(
        self, omega_i: Float[Array, " 3"], omega_o: Float[Array, " 3"], normal: Float[Array, " 3"]
    ) -> Float[Array, ""]:
        """See `AbstractBrdf.pdf`."""
        return cosine_density(omega_i, facing(omega_o, normal))

    def directional_reflectance(self, cos_o: Float[Array, ""]) -> Float[Array, " node"]:
        """See `AbstractBrdf.directional_reflectance`."""
        return _between(self._albedo(), _angle_from_normal(cos_o))

    def directional_emissivity(self, cos_o: Float[Array, ""]) -> Float[Array, " node"]:
        """See `AbstractBrdf.directional_emissivity`."""
        return 1 - self.directional_reflectance(cos_o)

    def relations(self) -> list[Check]:
        """No direction reflects more than it gets."""
        return [fraction("reflectance of BrdfTable", self._albedo())]

    def _albedo(self) -> Float[Array, "*face theta node"]:
        """Reflectance at the table's theta_o."""
        if self.albedo is not None:
            return self.albedo
        polar, turn = self.value.shape[-4], self.value.shape[-2]
        weight = 2 * np.outer(_hat_weights(polar), np.pi * _trapezoid(turn))
        return einsum("...ijkn,ik->...jn", self.value, as_float(weight))


def _between(table: Float[Array, "point *rest"], position: Float[Array, ""]) -> Float[Array, "*rest"]:
    """Linear interpolation along the first axis, `position` from 0 to 1."""
    place = position * (table.shape[0] - 1)
    low = jnp.clip(jnp.floor(place).astype(jnp.int32), 0, table.shape[0] - 2)
    part = place - low.astype(place.dtype)
    return (1 - part) * table[low] + part * table[low + 1]


def _angle_from_normal(cos: Float[Array, ""]) -> Float[Array, ""]:
    """theta / (pi / 2) in [0, 1] with a finite derivative at the normal."""
    return _angle(cos, safe_sqrt(1 - cos * cos)) / (jnp.pi / 2)


def _angle(along: Float[Array, ""], across: Float[Array, ""]) -> Float[Array, ""]:
    """atan2 with value and derivative 0 at the origin."""
    there = (along != 0) | (across != 0)
    return jnp.where(there, jnp.arctan2(across, jnp.where(there, along, 1)), 0)


def _azimuth(a: Float[Array, " 3"], b: Float[Array, " 3"], up: Float[Array, " 3"]) -> Float[Array, ""]:
    """Angle in [0, pi] between two tangents of the surface; 0 where one of them vanishes."""
    return _angle(dot(a, b), jnp.abs(dot(jnp.cross(a, b), up)))


def _trapezoid(points: int) -> np.ndarray:
    """Weights of the mean over [0, 1]."""
    weight = np.full(points, 1 / (points - 1))
    weight[[0, -1]] /= 2
    return weight


def _hat_weights(points: int) -> np.ndarray:
    """Integrals of piecewise linear hats times cos theta sin theta over [0, pi / 2]."""
    theta = np.linspace(0, np.pi / 2, points)
    part, weight = gauss_legendre(12)
    result = np.zeros(points)
    for k in range(points - 1):
        step = theta[k + 1] - theta[k]
        density = np.sin(2 * (theta[k] + step * part)) / 2 * weight * step
        result[k] += np.sum(density * (1 - part))
        result[k + 1] += np.sum(density * part)
    return result
