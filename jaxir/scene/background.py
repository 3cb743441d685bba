"""What a ray sees that meets nothing."""

from __future__ import annotations

import abc
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._arrays import Check, as_float, non_negative, positive, require_shape
from jaxir.optics.spectrum import Nodes, band_radiance
from jaxir.scene.source import per_node, spectral


class AbstractBackground(eqx.Module):
    """Radiance from around the scene, at the scene."""

    @abc.abstractmethod
    def radiance(self, nodes: Nodes, direction: Float[Array, "*batch 3"]) -> Float[Array, "*batch node"]:
        """Radiance [*batch, node] [W m-2 sr-1] seen in unit directions [*batch, 3]."""

    @abc.abstractmethod
    def checks(self) -> list[Check]:
        """What must hold of the fields' values."""


class AbstractUniformBackground(AbstractBackground):
    """A background that is the same in every direction."""

    @abc.abstractmethod
    def level(self, nodes: Nodes) -> Float[Array, " node"]:
        """Radiance [node] [W m-2 sr-1]."""

    def radiance(self, nodes: Nodes, direction: Float[Array, "*batch 3"]) -> Float[Array, "*batch node"]:
        """See `AbstractBackground.radiance`."""
        return jnp.broadcast_to(self.level(nodes), direction.shape[:-1] + (nodes.count,))


class UniformBackground(AbstractUniformBackground):
    """The same given radiance in every direction.

    Attributes:
        value: [node or 1] [W m-2 sr-1], integrated over each node's bin. Differentiable.
    """

    value: Float[Array, " node"]

    def __init__(self, value: Any):
        """Convert; one value or one per node."""
        self.value = spectral("UniformBackground.value", value)

    def level(self, nodes: Nodes) -> Float[Array, " node"]:
        """See `AbstractUniformBackground.level`."""
        return per_node("UniformBackground.value", self.value, nodes)

    def checks(self) -> list[Check]:
        """The radiance is not negative."""
        return [non_negative("UniformBackground.value", self.value)]


class BlackbodyBackground(AbstractUniformBackground):
    """A blackbody of one temperature in every direction.

    Attributes:
        temperature: [] [K]. Differentiable.
    """

    temperature: Float[Array, ""]

    def __init__(self, temperature: Any):
        """Convert to an array."""
        self.temperature = as_float(temperature, "BlackbodyBackground.temperature")
        require_shape("BlackbodyBackground.temperature", self.temperature, ())

    def level(self, nodes: Nodes) -> Float[Array, " node"]:
        """See `AbstractUniformBackground.level`."""
        return band_radiance(self.temperature, nodes)

    def checks(self) -> list[Check]:
        """The temperature is positive."""
        return [positive("BlackbodyBackground.temperature", self.temperature)]
