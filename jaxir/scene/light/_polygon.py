"""A flat plate with straight edges that shines."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._arrays import Check, as_one_program
from jaxir._fields import SpectralLight, light, quantity
from jaxir._math import dot, matmul
from jaxir.geometry import pdf_from_area, pdf_polygon, polygon_form_factor, polygon_vector, sample_polygon
from jaxir.optics.spectrum import Nodes
from jaxir.scene.light._light import AbstractAreaSource, Arrival, spread, to_plane, towards


class PolygonSource(AbstractAreaSource):
    """A flat convex plate with straight edges that shines on one side.

    Attributes:
        corners: counterclockwise seen from the side that shines [corner, 3] [m]; at least three, in one plane.
        radiance: [node or 1] [W m-2 sr-1].

    Differentiable in `radiance`, and in `corners` where `ClosedForm` finds its light: where it is sampled, what has
    been drawn stays.
    """

    corners: Float[Array, "corner 3"] = quantity("m", ("corner", 3))
    radiance: SpectralLight = light("W m-2 sr-1")

    def structure(self) -> None:
        """See `Physical.structure`."""
        if self.corners.shape[0] < 3:
            raise ValueError(f"PolygonSource.corners: got {self.corners.shape[0]} corners, expected at least 3")

    @property
    def normal(self) -> Float[Array, " 3"]:
        """Unit normal of the side that shines [3]; 0 without area."""
        return polygon_vector(self.corners) * pdf_polygon(self.corners)

    def on(self, nodes: Nodes) -> PolygonSource:
        """See `AbstractLight.on`."""
        return spread(self, nodes)

    @as_one_program
    def sample(self, u: Float[Array, " 2"], point: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Arrival:
        """See `AbstractExtendedLight.sample`; uniform in area."""
        omega_i, distance = towards(sample_polygon(u, self.corners) - point)
        own = self.normal
        pdf = pdf_from_area(pdf_polygon(self.corners), omega_i, distance, own)
        return Arrival(omega_i, distance, jnp.where(dot(omega_i, own) < 0, pdf, 0))

    @as_one_program
    def meet(self, omega_i: Float[Array, " 3"], point: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Arrival:
        """See `AbstractExtendedLight.meet`."""
        own = self.normal
        distance, ahead = to_plane(point, omega_i, self.corners[0], own)
        inward = jnp.cross(own[None], jnp.roll(self.corners, -1, axis=0) - self.corners)
        apart = (point + distance * omega_i)[None] - self.corners
        met = ahead & jnp.all(jnp.sum(inward * apart, axis=-1) >= 0)
        pdf = pdf_from_area(pdf_polygon(self.corners), omega_i, distance, own)
        return Arrival(omega_i, jnp.where(met, distance, jnp.inf), jnp.where(met, pdf, 0))

    def arriving(self, omega_i: Float[Array, "*batch 3"]) -> Float[Array, "*batch node"]:
        """See `AbstractExtendedLight.arriving`."""
        return jnp.broadcast_to(self.radiance, omega_i.shape[:-1] + self.radiance.shape)

    def form_factor_checks(self, corner: Float[Array, "face 3"], normal: Float[Array, "face 3"]) -> list[Check]:
        """See `AbstractExtendedLight.form_factor_checks`: it may cross the plane of a face."""
        return []

    def form_factor(self, point: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Float[Array, ""]:
        """See `AbstractExtendedLight.form_factor`."""
        return polygon_form_factor(point, normal, self.corners)

    def relations(self) -> list[Check]:
        """The corners span an area, lie in one plane and in convex position.

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
            Check("area of PolygonSource.corners", area, area > grain * size, "corners that span an area"),
            Check(
                "PolygonSource.corners", self.corners, jnp.abs(matmul(spokes, normal)) <= grain, "corners in one plane"
            ),
            Check("PolygonSource.corners", self.corners, jnp.all(over >= -grain * size, axis=0), "a convex polygon"),
        ]
