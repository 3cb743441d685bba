"""Light by its spectrum, which lights and backgrounds take in place of numbers for bands."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxir._arrays import Check, increasing, non_negative, on_host, positive, require, thermal
from jaxir._fields import AbstractSpectrum, quantity
from jaxir._math import matmul
from jaxir._plausible import KELVIN, usual
from jaxir.optics._tables import sample_weights
from jaxir.optics.spectrum._band import Nodes, bins_inside
from jaxir.optics.spectrum._planck import band_radiance

_MICROMETRES = usual(0.1, 1000, "um", below="is it in m?", above="is it in nm or cm-1?")


class BlackbodySpectrum(AbstractSpectrum):
    """A blackbody's radiance times a factor, integrated over each node's bin.

    The factor makes it what is asked for: the solid angle of the source [sr] for an irradiance, 6.79e-5 with 5772 K for
    the Sun above the air; an emissivity for a radiance; an area across the line of sight [m2] for an intensity.

    Attributes:
        temperature: [K]; [elevation] for an `ElevationTable`.
        factor: >= 0, one number, or one for each temperature.

    Differentiable in both.
    """

    temperature: Float[Array, "*batch"] = quantity("K", ("*batch",), (thermal, KELVIN))
    factor: Float[Array, "*batch"] = quantity("1", ("*batch",), non_negative, default=1.0)

    @property
    def batch(self) -> tuple[int, ...]:
        """See `AbstractSpectrum.batch`."""
        return np.broadcast_shapes(self.temperature.shape, self.factor.shape)

    def on(self, nodes: Nodes) -> Float[Array, "*batch node"]:
        """See `AbstractSpectrum.on`."""
        temperature, factor = (jnp.broadcast_to(x, self.batch) for x in (self.temperature, self.factor))
        return factor[..., None] * band_radiance(temperature, nodes)


class TabulatedSpectrum(AbstractSpectrum):
    """Light tabulated over wavelength, linear between samples, integrated exactly over each node's bin.

    Attributes:
        wavelength: increasing [sample] [um].
        value: light per um [sample], e.g. [W m-2 um-1] for an irradiance; [elevation, sample] for an `ElevationTable`.

    Differentiable in `value`.
    """

    wavelength: Float[Array, " sample"] = quantity("um", ("sample",), (positive, increasing, _MICROMETRES), least=2)
    value: Float[Array, "*batch sample"] = quantity("W um-1", ("*batch", "sample"), non_negative)

    @property
    def batch(self) -> tuple[int, ...]:
        """See `AbstractSpectrum.batch`."""
        return self.value.shape[:-1]

    def node_checks(self, nodes: Nodes) -> list[Check]:
        """See `Physical.node_checks`: bins lie within the table."""
        _, wavelength = on_host(self.wavelength)
        return bins_inside("TabulatedSpectrum", nodes, 1e4 / wavelength[::-1])

    def on(self, nodes: Nodes) -> Float[Array, "*batch node"]:
        """See `AbstractSpectrum.on`.

        Raises:
            ValueError: a bin outside the table, where bins are known.
        """
        require(self.node_checks(nodes))
        width = 1e4 * (nodes.upper - nodes.lower) / (nodes.lower * nodes.upper)
        return matmul(self.value, sample_weights(1e4 / nodes.upper, 1e4 / nodes.lower, self.wavelength).T) * width
