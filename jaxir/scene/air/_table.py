"""A path tabulated over wavenumber."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._arrays import Check, fraction, increasing, non_negative, positive, require
from jaxir._fields import quantity
from jaxir._plausible import WAVENUMBER
from jaxir.optics._tables import sample_weights
from jaxir.optics.spectrum import Nodes, bins_inside
from jaxir.scene.air._air import AbstractAtmosphere, AirPath


class TableAtmosphere(AbstractAtmosphere):
    """A path tabulated over wavenumber by another program, linear between samples and averaged over each bin.

    `jaxir.io.spectra` reads it from CSV and from MODTRAN's tape7.

    Attributes:
        wavenumber: increasing [sample] [cm-1].
        transmittance: [sample].
        spectral_path_radiance: spectral radiance that the path adds [sample] [W m-2 sr-1 / cm-1]; None adds nothing.

    Differentiable in transmittance and radiance.
    """

    wavenumber: Float[Array, " sample"] = quantity("cm-1", ("sample",), (positive, increasing, WAVENUMBER), least=2)
    transmittance: Float[Array, " sample"] = quantity("1", ("sample",), fraction)
    spectral_path_radiance: Float[Array, " sample"] | None = quantity(
        "W m-2 sr-1 / cm-1", ("sample",), non_negative, default=None
    )

    @property
    def has_spectrum(self) -> bool:
        """See `Physical.has_spectrum`."""
        return True

    def node_checks(self, nodes: Nodes) -> list[Check]:
        """See `Physical.node_checks`: bins lie within the table."""
        return bins_inside("TableAtmosphere", nodes, self.wavenumber)

    def on(self, nodes: Nodes) -> AirPath:
        """See `AbstractAtmosphere.on`.

        Raises:
            ValueError: a bin outside the table, where bins are known.
        """
        require(self.node_checks(nodes))
        weight = sample_weights(nodes.lower, nodes.upper, self.wavenumber)
        added = jnp.zeros_like(nodes.weight)
        if self.spectral_path_radiance is not None:
            added = weight @ self.spectral_path_radiance * (nodes.upper - nodes.lower)
        return AirPath(weight @ self.transmittance, added)
