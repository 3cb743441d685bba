"""A light at a place, without extent."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxir._fields import SpectralLight, light, quantity
from jaxir._math import dot
from jaxir.geometry.search import Mesh, occluded_from
from jaxir.optics.spectrum import Nodes
from jaxir.scene.light._light import AbstractDeltaSource, spread, towards


class PointSource(AbstractDeltaSource):
    """A light without extent that shines alike in all directions.

    Attributes:
        position: [3] [m].
        intensity: [node or 1] [W sr-1].

    Differentiable in `intensity`, and in `position` where no shadow moves.
    """

    position: Float[Array, " 3"] = quantity("m", (3,))
    intensity: SpectralLight = light("W sr-1")

    def on(self, nodes: Nodes) -> PointSource:
        """See `AbstractLight.on`."""
        return spread(self, nodes)

    def toward(self, point: Float[Array, " 3"]) -> tuple[Float[Array, " 3"], Float[Array, ""]]:
        """See `AbstractDeltaSource.toward`."""
        return towards(self.position - point)

    def beam(self, point: Float[Array, " 3"]) -> Float[Array, " node"]:
        """See `AbstractDeltaSource.beam`; intensity / distance^2, and 0 at the light itself."""
        offset = self.position - point
        square = dot(offset, offset)
        there = square > 0
        return jnp.where(there, self.intensity / jnp.where(there, square, 1), 0)

    @property
    def travel(self) -> None:
        """See `AbstractDeltaSource.travel`."""
        return None

    def hidden(
        self, mesh: Mesh, point: Float[Array, "ray 3"], face: Int[Array, " ray"], active: Bool[Array, " ray"]
    ) -> Bool[Array, " ray"]:
        """See `AbstractDeltaSource.hidden`."""
        return occluded_from(mesh, point, face, self.position, active)
