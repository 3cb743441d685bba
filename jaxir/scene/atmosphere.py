"""The path between target and sensor: L at the pupil = transmittance * L at the target + path radiance (2)."""

from __future__ import annotations

import abc
from typing import Any

import equinox as eqx
from jaxtyping import Array, Float

from jaxir._arrays import Check, fraction, non_negative
from jaxir.optics.spectrum import Nodes
from jaxir.scene.source import per_node, spectral


class AbstractAtmosphere(eqx.Module):
    """One path through the atmosphere, the same for every pixel."""

    @abc.abstractmethod
    def transmittance(self, nodes: Nodes) -> Float[Array, " node"]:
        """Transmittance of the path [node]."""

    @abc.abstractmethod
    def path_radiance(self, nodes: Nodes) -> Float[Array, " node"]:
        """Radiance emitted and scattered into the path [node] [W m-2 sr-1]."""

    @abc.abstractmethod
    def checks(self) -> list[Check]:
        """What must hold of the fields' values."""


class FixedPath(AbstractAtmosphere):
    """A path whose transmittance and radiance are given.

    Attributes:
        given_transmittance: [node or 1].
        given_path_radiance: [node or 1] [W m-2 sr-1].

    Differentiable in both.
    """

    given_transmittance: Float[Array, " node"]
    given_path_radiance: Float[Array, " node"]

    def __init__(self, transmittance: Any, path_radiance: Any = 0.0):
        """Convert; one value or one per node."""
        self.given_transmittance = spectral("FixedPath.transmittance", transmittance)
        self.given_path_radiance = spectral("FixedPath.path_radiance", path_radiance)

    def transmittance(self, nodes: Nodes) -> Float[Array, " node"]:
        """See `AbstractAtmosphere.transmittance`."""
        return per_node("FixedPath.transmittance", self.given_transmittance, nodes)

    def path_radiance(self, nodes: Nodes) -> Float[Array, " node"]:
        """See `AbstractAtmosphere.path_radiance`."""
        return per_node("FixedPath.path_radiance", self.given_path_radiance, nodes)

    def checks(self) -> list[Check]:
        """The transmittance lies in [0, 1], the radiance is not negative."""
        return [
            fraction("FixedPath.transmittance", self.given_transmittance),
            non_negative("FixedPath.path_radiance", self.given_path_radiance),
        ]
