"""Air that attenuates uniformly."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._arrays import non_negative, thermal
from jaxir._fields import over_nodes, quantity, spectral
from jaxir._plausible import KELVIN, usual
from jaxir.optics.spectrum import Nodes, band_radiance
from jaxir.scene.air._air import AbstractAtmosphere, AirPath

_METRES = usual(100, 1e6, "m", below="is it in km?", above="is it in mm?")


class UniformAtmosphere(AbstractAtmosphere):
    """Air with one extinction coefficient along the path: transmittance = exp(-extinction * distance).

    Attributes:
        extinction: [node or 1] [m-1].
        distance: [m].
        temperature: of the air, which then emits (1 - transmittance) B(T) [K]; None adds no radiance.

    Differentiable in every field.
    """

    extinction: Float[Array, " node"] = spectral("m-1")
    distance: Float[Array, ""] = quantity("m", within=(non_negative, _METRES))
    temperature: Float[Array, ""] | None = quantity("K", within=(thermal, KELVIN), default=None)

    def on(self, nodes: Nodes) -> AirPath:
        """See `AbstractAtmosphere.on`."""
        depth = self.distance * over_nodes(self, nodes).extinction
        added = jnp.zeros_like(depth)
        if self.temperature is not None:
            added = -jnp.expm1(-depth) * band_radiance(self.temperature, nodes)
        return AirPath(jnp.exp(-depth), added)
