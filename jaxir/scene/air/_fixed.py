"""A path whose transmittance and radiance are given."""

from __future__ import annotations

from jaxtyping import Array, Float

from jaxir._arrays import fraction
from jaxir._fields import SpectralLight, light, over_nodes, spectral
from jaxir.optics.spectrum import Nodes
from jaxir.scene.air._air import AbstractAtmosphere, AirPath


class FixedPath(AbstractAtmosphere):
    """A path whose transmittance and radiance are given.

    Attributes:
        transmittance: [node or 1].
        path_radiance: [node or 1] [W m-2 sr-1], or a spectrum.

    Differentiable in both.
    """

    transmittance: Float[Array, " node"] = spectral("1", fraction)
    path_radiance: SpectralLight = light("W m-2 sr-1", default=0.0)

    def on(self, nodes: Nodes) -> AirPath:
        """See `AbstractAtmosphere.on`."""
        own = over_nodes(self, nodes)
        return AirPath(own.transmittance, own.path_radiance)
