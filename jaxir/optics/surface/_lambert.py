"""Diffuse reflection."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._arrays import fraction
from jaxir._math import dot
from jaxir.optics.surface._brdf import AbstractBrdf, cosine_density, cosine_direction, facing, parameter


class Lambert(AbstractBrdf):
    """A diffuse reflector, the same in every direction: brdf = (1 - emissivity) / pi.

    Attributes:
        emissivity: [face | 1, node | 1].

    Differentiable in `emissivity`.
    """

    emissivity: Float[Array, "face node"] = parameter(fraction)

    @property
    def diffuse(self) -> bool:
        """See `AbstractBrdf.diffuse`."""
        return True

    def eval(
        self, omega_i: Float[Array, " 3"], omega_o: Float[Array, " 3"], normal: Float[Array, " 3"]
    ) -> Float[Array, " node"]:
        """See `AbstractBrdf.eval`."""
        above = dot(omega_i, facing(omega_o, normal)) > 0
        return jnp.where(above, (1 - self.emissivity) / jnp.pi, 0)

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
        """See `AbstractBrdf.directional_reflectance`; independent of cos_o."""
        return 1 - self.emissivity

    def directional_emissivity(self, cos_o: Float[Array, ""]) -> Float[Array, " node"]:
        """See `AbstractBrdf.directional_emissivity`; the parameter, free of the rounding of 1 - (1 - emissivity)."""
        return self.emissivity
