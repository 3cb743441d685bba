"""A path tabulated over wavenumber."""

from __future__ import annotations

import functools
import operator

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxir._arrays import Check, fraction, increasing, known, non_negative, on_host, positive, require
from jaxir._fields import quantity
from jaxir._math import matmul
from jaxir._plausible import WAVENUMBER, doubt
from jaxir.optics._tables import sample_weights
from jaxir.optics.spectrum import Nodes, bins_inside, spectral_radiance_on_host
from jaxir.scene.air._air import AbstractAtmosphere, AirPath

HOT, SUN = 400.0, 5800.0  # K, of air that is hotter than any, and of the Sun
SUNLIT = 1e-3  # of the Sun's radiance, fifteen times what fills the sky where all of its light is scattered


class TableAtmosphere(AbstractAtmosphere):
    """A path tabulated over wavenumber by another program, linear between samples and averaged over each bin.

    `jaxir.io.spectra` reads it from CSV and from MODTRAN's tape7.

    Attributes:
        wavenumber: increasing [sample] [cm-1].
        transmittance: [sample].
        spectral_path_radiance: spectral radiance that the path adds [sample] [W m-2 sr-1 / cm-1]; None adds nothing.
        gaps: ranges without data between the samples [gap, 2] [cm-1]; None for none. No bin may reach into one.

    Differentiable in transmittance and radiance.
    """

    wavenumber: Float[Array, " sample"] = quantity("cm-1", ("sample",), (positive, increasing, WAVENUMBER), least=2)
    transmittance: Float[Array, " sample"] = quantity("1", ("sample",), fraction)
    spectral_path_radiance: Float[Array, " sample"] | None = quantity(
        "W m-2 sr-1 / cm-1", ("sample",), non_negative, default=None
    )
    gaps: Float[Array, "gap 2"] | None = quantity("cm-1", ("gap", 2), (positive, WAVENUMBER), default=None)

    @property
    def has_spectrum(self) -> bool:
        """See `Physical.has_spectrum`."""
        return True

    def doubts(self) -> list[Check]:
        """See `Physical.doubts`: no air shines brighter than a black body of 400 K and sunlight all around."""
        if self.spectral_path_radiance is None:
            return []

        def shines(radiance: np.ndarray, wavenumber: np.ndarray) -> np.ndarray:
            most = np.zeros(np.shape(wavenumber))
            for share, temperature in ((1.0, HOT), (SUNLIT, SUN)):
                most += share * spectral_radiance_on_host(np.maximum(wavenumber, 1e-9), temperature)
            return radiance <= most

        name, expected = "TableAtmosphere.spectral_path_radiance", "W m-2 sr-1 / cm-1 as air has; is it per um?"
        return [doubt(name, shines, expected, self.spectral_path_radiance, self.wavenumber)]

    def node_checks(self, nodes: Nodes) -> list[Check]:
        """See `Physical.node_checks`: bins lie within the table, and in none of its gaps."""
        checks = bins_inside("TableAtmosphere", nodes, self.wavenumber)
        if self.gaps is None:
            return checks
        _, lower, upper, gaps = on_host(nodes.lower, nodes.upper, self.gaps)
        within = [(upper > low * (1 + 1e-5)) & (lower < high * (1 - 1e-5)) for low, high in zip(*gaps.T, strict=True)]
        lost = known(gaps)
        said = (
            "its gaps" if lost is None else ", ".join(f"{1e4 / high:.4g} to {1e4 / low:.4g} um" for low, high in lost)
        )
        free = ~functools.reduce(operator.or_, within)
        return [*checks, Check("nodes.lower", lower, free, f"bins outside {said}, where TableAtmosphere has no data")]

    @property
    def described(self) -> str:
        """See `AbstractAtmosphere.described`: its ranges."""
        ends = np.asarray(self.wavenumber, np.float64)[[0, -1]]
        inner = np.zeros(0) if self.gaps is None else np.asarray(self.gaps, np.float64).ravel()
        edges = np.sort(1e4 / np.concatenate([ends, inner])).reshape(-1, 2)
        ranges = ", ".join(f"{low:.4g} to {high:.4g} um" for low, high in edges.tolist())
        dark = ", without path radiance" if self.spectral_path_radiance is None else ""
        return f"{super().described}, {ranges}{dark}"

    def on(self, nodes: Nodes) -> AirPath:
        """See `AbstractAtmosphere.on`.

        Raises:
            ValueError: a bin outside the table, where bins are known.
        """
        require(self.node_checks(nodes))
        weight = sample_weights(nodes.lower, nodes.upper, self.wavenumber)
        added = jnp.zeros_like(nodes.weight)
        if self.spectral_path_radiance is not None:
            added = matmul(weight, self.spectral_path_radiance) * (nodes.upper - nodes.lower)
        return AirPath(matmul(weight, self.transmittance), added)
