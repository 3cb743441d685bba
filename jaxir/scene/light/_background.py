"""Surroundings that are the same in every direction."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._arrays import Check, thermal
from jaxir._fields import SpectralLight, light, quantity
from jaxir._plausible import KELVIN
from jaxir.optics.spectrum import Nodes, band_radiance
from jaxir.scene.light._light import AbstractBackground, spread


class UniformBackground(AbstractBackground):
    """The same given radiance in every direction.

    Attributes:
        radiance: [W m-2 sr-1], in every band, in each [band], or in each node's bin [node]. Differentiable.
    """

    radiance: SpectralLight = light("W m-2 sr-1")

    def on(self, nodes: Nodes) -> UniformBackground:
        """See `AbstractLight.on`."""
        return spread(self, nodes)

    @property
    def uniform(self) -> bool:
        """See `AbstractBackground.uniform`."""
        return True

    def arriving(self, omega_i: Float[Array, "*batch 3"]) -> Float[Array, "*batch node"]:
        """See `AbstractExtendedLight.arriving`."""
        return jnp.broadcast_to(self.radiance, omega_i.shape[:-1] + self.radiance.shape)

    def form_factor_checks(self, corner: Float[Array, "face 3"], normal: Float[Array, "face 3"]) -> list[Check]:
        """See `AbstractExtendedLight.form_factor_checks`."""
        return []

    def form_factor(self, point: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Float[Array, ""]:
        """See `AbstractExtendedLight.form_factor`: all of it."""
        return jnp.ones((), point.dtype)


class BlackbodyBackground(AbstractBackground):
    """A blackbody of one temperature in every direction.

    Attributes:
        temperature: [] [K]. Differentiable.
    """

    temperature: Float[Array, ""] = quantity("K", (), (thermal, KELVIN))

    def on(self, nodes: Nodes) -> UniformBackground:
        """See `AbstractLight.on`: the radiance of the blackbody."""
        return UniformBackground(band_radiance(self.temperature, nodes))

    @property
    def uniform(self) -> bool:
        """See `AbstractBackground.uniform`."""
        return True

    def arriving(self, omega_i: Float[Array, "*batch 3"]) -> Float[Array, "*batch node"]:
        """See `AbstractExtendedLight.arriving`; known on the nodes alone."""
        raise NotImplementedError("BlackbodyBackground: its radiance is that of `on(nodes)`")

    def form_factor_checks(self, corner: Float[Array, "face 3"], normal: Float[Array, "face 3"]) -> list[Check]:
        """See `AbstractExtendedLight.form_factor_checks`."""
        return []

    def form_factor(self, point: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Float[Array, ""]:
        """See `AbstractExtendedLight.form_factor`: all of it."""
        return jnp.ones((), point.dtype)
