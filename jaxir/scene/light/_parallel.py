"""A source at infinity without extent."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxir._arrays import non_negative, unit_vector
from jaxir._fields import SpectralLight, light, quantity
from jaxir._plausible import usual
from jaxir.geometry.search import Mesh, occluded
from jaxir.optics.spectrum import Nodes
from jaxir.scene.light._light import AbstractDeltaSource, spread

SUNLIGHT = usual(0, 2e3, "W m-2", above="the Sun gives 1361 at all wavelengths together")


class ParallelSource(AbstractDeltaSource):
    """A source at infinity without extent, as the sun nearly is.

    Attributes:
        direction: in which its light travels [3], unit length; (0, 0, -1) shines from above.
        irradiance: on a surface facing it [W m-2], in every band, in each [band], or in each node's bin [node].

    Differentiable in `irradiance`; not in `direction` where shadows move.
    """

    direction: Float[Array, " 3"] = quantity("1", (3,), unit_vector)
    irradiance: SpectralLight = light("W m-2", (non_negative, SUNLIGHT))

    def on(self, nodes: Nodes) -> ParallelSource:
        """See `AbstractLight.on`."""
        return spread(self, nodes)

    def toward(self, point: Float[Array, " 3"]) -> tuple[Float[Array, " 3"], Float[Array, ""]]:
        """See `AbstractDeltaSource.toward`; the same direction from everywhere, at infinity."""
        return -self.direction, jnp.full((), jnp.inf, self.direction.dtype)

    def beam(self, point: Float[Array, " 3"]) -> Float[Array, " node"]:
        """See `AbstractDeltaSource.beam`; the same everywhere."""
        return self.irradiance

    @property
    def travel(self) -> Float[Array, " 3"]:
        """See `AbstractDeltaSource.travel`."""
        return self.direction

    def hidden(
        self, mesh: Mesh, point: Float[Array, "ray 3"], face: Int[Array, " ray"], active: Bool[Array, " ray"]
    ) -> Bool[Array, " ray"]:
        """See `AbstractDeltaSource.hidden`."""
        return occluded(mesh, point, face, -self.direction, active)
