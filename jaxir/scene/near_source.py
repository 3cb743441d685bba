"""Lights at a finite distance: a point, a disc, a polygon, a sphere.

Each is a leaf module of numbers with methods for one point of the skin. Lights are seen by the skin only: a camera
does not see them, and they cast no shadow.
"""

from __future__ import annotations

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxir._arrays import Check, as_float, finite, non_negative, positive, require_shape, unit_vector
from jaxir._math import dot
from jaxir.geometry import (
    pdf_disc,
    pdf_from_area,
    pdf_polygon,
    polygon_vector,
    sample_cap,
    sample_disc,
    sample_polygon,
    sphere_drop,
)
from jaxir.optics.spectrum import Nodes
from jaxir.scene.source import AbstractDeltaSource, per_node, spectral


class Arrival(NamedTuple):
    """A direction in which a light is looked for.

    Attributes:
        omega_i: unit vector towards the light [3].
        distance: to the light [m]; inf where that direction misses it.
        pdf: density of the light's sampler in that direction [sr-1]; 0 where it misses.
    """

    omega_i: Float[Array, " 3"]
    distance: Float[Array, ""]
    pdf: Float[Array, ""]


class AbstractAreaSource(eqx.Module):
    """A light with an extent: the same radiance from every point of it in every direction."""

    @abc.abstractmethod
    def sample(self, u: Float[Array, " 2"], point: Float[Array, " 3"]) -> Arrival:
        """A direction towards the light from two uniform numbers; pdf 0 if the light does not shine on the point."""

    @abc.abstractmethod
    def meet(self, point: Float[Array, " 3"], omega_i: Float[Array, " 3"]) -> Arrival:
        """Where a ray from the skin meets the light, with the density `sample` has for that direction."""

    @abc.abstractmethod
    def emitted(self, nodes: Nodes) -> Float[Array, " node"]:
        """Its radiance [node] [W m-2 sr-1]."""

    @abc.abstractmethod
    def checks(self) -> list[Check]:
        """What must hold of the fields' values."""


class PointSource(AbstractDeltaSource):
    """A light without extent that shines alike in all directions.

    Attributes:
        position: [3] [m].
        intensity: [node or 1] [W sr-1].

    Differentiable in `intensity`, and in `position` where no shadow moves.
    """

    position: Float[Array, " 3"]
    intensity: Float[Array, " node"]

    def __init__(self, position: Any, intensity: Any):
        """Convert; `intensity` is one value or one per node."""
        self.position = _vector3("PointSource.position", position)
        self.intensity = spectral("PointSource.intensity", intensity)

    def toward(self, point: Float[Array, " 3"]) -> tuple[Float[Array, " 3"], Float[Array, ""]]:
        """See `AbstractDeltaSource.toward`."""
        return _toward(self.position - point)

    def beam(self, nodes: Nodes, point: Float[Array, " 3"]) -> Float[Array, " node"]:
        """See `AbstractDeltaSource.beam`; intensity / distance^2, and 0 at the light itself."""
        offset = self.position - point
        square = dot(offset, offset)
        there = square > 0
        intensity = per_node("PointSource.intensity", self.intensity, nodes)
        return jnp.where(there, intensity / jnp.where(there, square, 1), 0)

    def checks(self) -> list[Check]:
        """The position is finite, the intensity not negative."""
        return [finite("PointSource.position", self.position), non_negative("PointSource.intensity", self.intensity)]


class DiscSource(AbstractAreaSource):
    """A round plate that shines on the side of its normal.

    Attributes:
        centre: [3] [m].
        normal: of the side that shines [3], unit length.
        radius: [m].
        radiance: [node or 1] [W m-2 sr-1].

    Differentiable in `radiance`, and in the others where no shadow moves.
    """

    centre: Float[Array, " 3"]
    normal: Float[Array, " 3"]
    radius: Float[Array, ""]
    radiance: Float[Array, " node"]

    def __init__(self, centre: Any, normal: Any, radius: Any, radiance: Any):
        """Convert; `radiance` is one value or one per node."""
        self.centre = _vector3("DiscSource.centre", centre)
        self.normal = _vector3("DiscSource.normal", normal)
        self.radius = as_float(radius, "DiscSource.radius")
        require_shape("DiscSource.radius", self.radius, ())
        self.radiance = spectral("DiscSource.radiance", radiance)

    def sample(self, u: Float[Array, " 2"], point: Float[Array, " 3"]) -> Arrival:
        """See `AbstractAreaSource.sample`; uniform in area."""
        omega_i, distance = _toward(sample_disc(u, self.centre, self.normal, self.radius) - point)
        lit = dot(omega_i, self.normal) < 0
        pdf = pdf_from_area(pdf_disc(self.radius), omega_i, distance, self.normal)
        return Arrival(omega_i, distance, jnp.where(lit, pdf, 0))

    def meet(self, point: Float[Array, " 3"], omega_i: Float[Array, " 3"]) -> Arrival:
        """See `AbstractAreaSource.meet`."""
        distance, ahead = _to_plane(point, omega_i, self.centre, self.normal)
        apart = point + distance * omega_i - self.centre
        met = ahead & (dot(apart, apart) <= self.radius * self.radius)
        pdf = pdf_from_area(pdf_disc(self.radius), omega_i, distance, self.normal)
        return Arrival(omega_i, jnp.where(met, distance, jnp.inf), jnp.where(met, pdf, 0))

    def emitted(self, nodes: Nodes) -> Float[Array, " node"]:
        """See `AbstractAreaSource.emitted`."""
        return per_node("DiscSource.radiance", self.radiance, nodes)

    def checks(self) -> list[Check]:
        """The disc has a size, its normal length 1, its radiance is not negative."""
        return [
            finite("DiscSource.centre", self.centre),
            unit_vector("DiscSource.normal", self.normal),
            positive("DiscSource.radius", self.radius),
            non_negative("DiscSource.radiance", self.radiance),
        ]


class PolygonSource(AbstractAreaSource):
    """A flat convex plate with straight edges that shines on one side.

    Attributes:
        corners: counterclockwise seen from the side that shines [corner, 3] [m]; at least three, in one plane.
        radiance: [node or 1] [W m-2 sr-1].

    Differentiable in `radiance`, and in `corners` where no shadow moves.
    """

    corners: Float[Array, "corner 3"]
    radiance: Float[Array, " node"]

    def __init__(self, corners: Any, radiance: Any):
        """Convert; `radiance` is one value or one per node.

        Raises:
            ValueError: fewer than three corners.
        """
        self.corners = as_float(corners, "PolygonSource.corners")
        require_shape("PolygonSource.corners", self.corners, ("corner", 3))
        if self.corners.shape[0] < 3:
            raise ValueError(f"PolygonSource.corners: got {self.corners.shape[0]} corners, expected at least 3")
        self.radiance = spectral("PolygonSource.radiance", radiance)

    @property
    def normal(self) -> Float[Array, " 3"]:
        """Unit normal of the side that shines [3]; 0 without area."""
        return polygon_vector(self.corners) * pdf_polygon(self.corners)

    def sample(self, u: Float[Array, " 2"], point: Float[Array, " 3"]) -> Arrival:
        """See `AbstractAreaSource.sample`; uniform in area."""
        omega_i, distance = _toward(sample_polygon(u, self.corners) - point)
        lit = dot(omega_i, self.normal) < 0
        pdf = pdf_from_area(pdf_polygon(self.corners), omega_i, distance, self.normal)
        return Arrival(omega_i, distance, jnp.where(lit, pdf, 0))

    def meet(self, point: Float[Array, " 3"], omega_i: Float[Array, " 3"]) -> Arrival:
        """See `AbstractAreaSource.meet`."""
        normal = self.normal
        distance, ahead = _to_plane(point, omega_i, self.corners[0], normal)
        inward = jnp.cross(normal[None], jnp.roll(self.corners, -1, axis=0) - self.corners)
        apart = (point + distance * omega_i)[None] - self.corners
        met = ahead & jnp.all(jnp.sum(inward * apart, axis=-1) >= 0)
        pdf = pdf_from_area(pdf_polygon(self.corners), omega_i, distance, normal)
        return Arrival(omega_i, jnp.where(met, distance, jnp.inf), jnp.where(met, pdf, 0))

    def emitted(self, nodes: Nodes) -> Float[Array, " node"]:
        """See `AbstractAreaSource.emitted`."""
        return per_node("PolygonSource.radiance", self.radiance, nodes)

    def checks(self) -> list[Check]:
        """The corners span an area, lie in one plane and in convex position, the radiance is not negative.

        Tolerance: 1e-5 of the polygon's size, and the rounding of the coordinates.
        """
        spokes = self.corners - self.corners[:1]
        size = jnp.max(jnp.abs(spokes))
        grain = 1e-5 * size + 16 * jnp.finfo(size.dtype).eps * jnp.max(jnp.abs(self.corners))
        vector, normal = polygon_vector(self.corners), self.normal
        area = jnp.sqrt(dot(vector, vector))
        edge = jnp.roll(self.corners, -1, axis=0) - self.corners
        # over[k, j] is edge k's length times how far corner j lies on its inner side
        inward = jnp.cross(normal[None], edge)
        over = jnp.sum(inward[:, None] * (self.corners[None] - self.corners[:, None]), axis=-1)
        return [
            finite("PolygonSource.corners", self.corners),
            Check("area of PolygonSource.corners", area, area > grain * size, "corners that span an area"),
            Check("PolygonSource.corners", self.corners, jnp.abs(spokes @ normal) <= grain, "corners in one plane"),
            Check("PolygonSource.corners", self.corners, jnp.all(over >= -grain * size, axis=0), "a convex polygon"),
            non_negative("PolygonSource.radiance", self.radiance),
        ]


class SphereSource(AbstractAreaSource):
    """A ball that shines; seen from inside it shines from everywhere.

    Attributes:
        centre: [3] [m].
        radius: [m].
        radiance: [node or 1] [W m-2 sr-1].

    Differentiable in `radiance`, and in the others where no shadow moves.
    """

    centre: Float[Array, " 3"]
    radius: Float[Array, ""]
    radiance: Float[Array, " node"]

    def __init__(self, centre: Any, radius: Any, radiance: Any):
        """Convert; `radiance` is one value or one per node."""
        self.centre = _vector3("SphereSource.centre", centre)
        self.radius = as_float(radius, "SphereSource.radius")
        require_shape("SphereSource.radius", self.radius, ())
        self.radiance = spectral("SphereSource.radiance", radiance)

    def sample(self, u: Float[Array, " 2"], point: Float[Array, " 3"]) -> Arrival:
        """See `AbstractAreaSource.sample`; uniform in the solid angle under which the sphere is seen."""
        axis, _ = _toward(self.centre - point)
        drop = sphere_drop(point, self.centre, self.radius)
        omega_i = sample_cap(u, axis, drop)
        reach = self._reach(point, omega_i)
        along = jnp.maximum(dot(self.centre - point, omega_i), 0)  # where rounding makes a ray at the rim miss
        return Arrival(omega_i, jnp.where(jnp.isfinite(reach), reach, along), _cap_density(drop))

    def meet(self, point: Float[Array, " 3"], omega_i: Float[Array, " 3"]) -> Arrival:
        """See `AbstractAreaSource.meet`."""
        distance = self._reach(point, omega_i)
        density = _cap_density(sphere_drop(point, self.centre, self.radius))
        return Arrival(omega_i, distance, jnp.where(jnp.isfinite(distance), density, 0))

    def emitted(self, nodes: Nodes) -> Float[Array, " node"]:
        """See `AbstractAreaSource.emitted`."""
        return per_node("SphereSource.radiance", self.radiance, nodes)

    def checks(self) -> list[Check]:
        """The sphere has a size, its radiance is not negative."""
        return [
            finite("SphereSource.centre", self.centre),
            positive("SphereSource.radius", self.radius),
            non_negative("SphereSource.radiance", self.radiance),
        ]

    def _reach(self, point: Float[Array, " 3"], omega_i: Float[Array, " 3"]) -> Float[Array, ""]:
        """Distance to the sphere along a ray, to its far side from inside; inf on a miss."""
        offset = self.centre - point
        along = dot(offset, omega_i)
        across = offset - along * omega_i
        room = self.radius * self.radius - dot(across, across)
        met = room >= 0
        chord = jnp.where(room > 0, jnp.sqrt(jnp.where(room > 0, room, 1)), 0)
        outside = dot(offset, offset) > self.radius * self.radius
        distance = jnp.where(outside, along - chord, along + chord)
        return jnp.where(met & (distance > 0), distance, jnp.inf)


def _to_plane(
    point: Float[Array, " 3"], omega_i: Float[Array, " 3"], origin: Float[Array, " 3"], normal: Float[Array, " 3"]
) -> tuple[Float[Array, ""], Bool[Array, ""]]:
    """Distance along a ray to a plane that shines along its normal, and whether the ray meets that side of it."""
    slope = dot(omega_i, normal)
    height = dot(origin - point, normal)
    ahead = (slope < 0) & (height < 0)
    return jnp.where(ahead, height / jnp.where(ahead, slope, 1), 0), ahead


def _cap_density(drop: Float[Array, ""]) -> Float[Array, ""]:
    return jnp.where(drop > 0, 1 / (2 * jnp.pi * jnp.where(drop > 0, drop, 1)), 0)


def _toward(offset: Float[Array, " 3"]) -> tuple[Float[Array, " 3"], Float[Array, ""]]:
    """Unit vector and length of an offset; (0, 0, 1) and 0 for no offset, with finite derivatives."""
    square = dot(offset, offset)
    there = square > 0
    inverse = lax.rsqrt(jnp.where(there, square, 1))
    up = jnp.asarray([0, 0, 1], offset.dtype)
    return jnp.where(there, offset * inverse, up), jnp.where(there, square * inverse, 0)


def _vector3(field: str, value: Any) -> Float[Array, " 3"]:
    array = as_float(value, field)
    require_shape(field, array, (3,))
    return array
