"""A ball that shines."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._arrays import positive
from jaxir._fields import SpectralLight, light, quantity
from jaxir._math import dot, safe_sqrt
from jaxir.geometry import sample_cap, sphere_drop
from jaxir.optics.spectrum import Nodes
from jaxir.scene.light._light import AbstractAreaSource, Arrival, spread, towards


class SphereSource(AbstractAreaSource):
    """A ball that shines; seen from inside it shines from everywhere.

    Attributes:
        centre: [3] [m].
        radius: [m].
        radiance: [node or 1] [W m-2 sr-1].

    Differentiable in `radiance`; not in its place and size, because it is sampled and what has been drawn stays.
    """

    centre: Float[Array, " 3"] = quantity("m", (3,))
    radius: Float[Array, ""] = quantity("m", (), positive)
    radiance: SpectralLight = light("W m-2 sr-1")

    def on(self, nodes: Nodes) -> SphereSource:
        """See `AbstractLight.on`."""
        return spread(self, nodes)

    def sample(self, u: Float[Array, " 2"], point: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Arrival:
        """See `AbstractExtendedLight.sample`; uniform in the solid angle under which the sphere is seen."""
        axis, _ = towards(self.centre - point)
        drop = sphere_drop(point, self.centre, self.radius)
        omega_i = sample_cap(u, axis, drop)
        reach = self._reach(point, omega_i)
        along = jnp.maximum(dot(self.centre - point, omega_i), 0)  # where rounding makes a ray at the rim miss
        return Arrival(omega_i, jnp.where(jnp.isfinite(reach), reach, along), _cap_density(drop))

    def meet(self, omega_i: Float[Array, " 3"], point: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Arrival:
        """See `AbstractExtendedLight.meet`."""
        distance = self._reach(point, omega_i)
        density = _cap_density(sphere_drop(point, self.centre, self.radius))
        return Arrival(omega_i, distance, jnp.where(jnp.isfinite(distance), density, 0))

    def arriving(self, omega_i: Float[Array, "*batch 3"]) -> Float[Array, "*batch node"]:
        """See `AbstractExtendedLight.arriving`."""
        return jnp.broadcast_to(self.radiance, omega_i.shape[:-1] + self.radiance.shape)

    def form_factor_checks(self, corner: Float[Array, "face 3"], normal: Float[Array, "face 3"]) -> None:
        """See `AbstractExtendedLight.form_factor_checks`: there is no closed form."""
        return None

    def form_factor(self, point: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Float[Array, ""]:
        """See `AbstractExtendedLight.form_factor`."""
        raise NotImplementedError("SphereSource: no closed form")

    def _reach(self, point: Float[Array, " 3"], omega_i: Float[Array, " 3"]) -> Float[Array, ""]:
        """Distance to the sphere along a ray, to its far side from inside; inf on a miss."""
        offset = self.centre - point
        along = dot(offset, omega_i)
        across = offset - along * omega_i
        room = self.radius * self.radius - dot(across, across)
        chord = safe_sqrt(room)
        outside = dot(offset, offset) > self.radius * self.radius
        distance = jnp.where(outside, along - chord, along + chord)
        return jnp.where((room >= 0) & (distance > 0), distance, jnp.inf)


def _cap_density(drop: Float[Array, ""]) -> Float[Array, ""]:
    return jnp.where(drop > 0, 1 / (2 * jnp.pi * jnp.where(drop > 0, drop, 1)), 0)
