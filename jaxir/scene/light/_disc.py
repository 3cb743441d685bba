"""A round plate that shines."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._arrays import Check, as_one_program, positive, unit_vector
from jaxir._fields import SpectralLight, light, quantity
from jaxir._math import dot
from jaxir.geometry import disc_above, disc_vector, pdf_disc, pdf_from_area, sample_disc
from jaxir.optics.spectrum import Nodes
from jaxir.scene.light._light import AbstractAreaSource, Arrival, spread, to_plane, towards


class DiscSource(AbstractAreaSource):
    """A round plate that shines on the side of its normal.

    Attributes:
        centre: [3] [m].
        normal: of the side that shines [3], unit length.
        radius: [m].
        radiance: [node or 1] [W m-2 sr-1].

    Differentiable in `radiance`, and in the others where `ClosedForm` finds its light: where it is sampled, what has
    been drawn stays.
    """

    centre: Float[Array, " 3"] = quantity("m", (3,))
    normal: Float[Array, " 3"] = quantity("1", (3,), unit_vector)
    radius: Float[Array, ""] = quantity("m", (), positive)
    radiance: SpectralLight = light("W m-2 sr-1")

    def on(self, nodes: Nodes) -> DiscSource:
        """See `AbstractLight.on`."""
        return spread(self, nodes)

    @as_one_program
    def sample(self, u: Float[Array, " 2"], point: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Arrival:
        """See `AbstractExtendedLight.sample`; uniform in area."""
        omega_i, distance = towards(sample_disc(u, self.centre, self.normal, self.radius) - point)
        lit = dot(omega_i, self.normal) < 0
        pdf = pdf_from_area(pdf_disc(self.radius), omega_i, distance, self.normal)
        return Arrival(omega_i, distance, jnp.where(lit, pdf, 0))

    @as_one_program
    def meet(self, omega_i: Float[Array, " 3"], point: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Arrival:
        """See `AbstractExtendedLight.meet`."""
        distance, ahead = to_plane(point, omega_i, self.centre, self.normal)
        apart = point + distance * omega_i - self.centre
        met = ahead & (dot(apart, apart) <= self.radius * self.radius)
        pdf = pdf_from_area(pdf_disc(self.radius), omega_i, distance, self.normal)
        return Arrival(omega_i, jnp.where(met, distance, jnp.inf), jnp.where(met, pdf, 0))

    def arriving(self, omega_i: Float[Array, "*batch 3"]) -> Float[Array, "*batch node"]:
        """See `AbstractExtendedLight.arriving`."""
        return jnp.broadcast_to(self.radiance, omega_i.shape[:-1] + self.radiance.shape)

    def form_factor_checks(self, corner: Float[Array, "face 3"], normal: Float[Array, "face 3"]) -> list[Check]:
        """See `AbstractExtendedLight.form_factor_checks`."""

        def above(side: int) -> Array:
            return eqx.filter_vmap(lambda p, n: disc_above(p, side * n, self.centre, self.normal, self.radius))(
                corner, normal
            )

        apart = above(1) | above(-1)
        expected = "a disc wholly above or wholly below the plane of every face; sample it"
        return [Check("ClosedForm: DiscSource.radius", jnp.broadcast_to(self.radius, apart.shape), apart, expected)]

    def form_factor(self, point: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Float[Array, ""]:
        """See `AbstractExtendedLight.form_factor`."""
        return jnp.maximum(dot(disc_vector(point, self.centre, self.normal, self.radius), normal), 0)
