"""Light from outside the scene."""

from __future__ import annotations

import abc
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._arrays import Check, as_float, non_negative, require_shape, unit_vector
from jaxir.optics.spectrum import Nodes


def per_node(field: str, value: Float[Array, " n"], nodes: Nodes) -> Float[Array, " node"]:
    """A spectral leaf [node or 1] spread over the nodes; `ValueError` if its length is neither."""
    if value.shape not in ((1,), (nodes.count,)):
        raise ValueError(
            f"{field}: got {value.shape[0]} spectral values, expected 1 or {nodes.count}, one for each node "
            f"of the bands {nodes.names}"
        )
    return jnp.broadcast_to(value, (nodes.count,))


def spectral(field: str, value: Any) -> Float[Array, " n"]:
    """A number or a sequence over nodes as a spectral leaf [node or 1]."""
    array = as_float(value, field)
    if array.ndim > 1:
        raise ValueError(f"{field}: got shape {array.shape}, expected one value or one per node")
    return array[None] if array.ndim == 0 else array


class AbstractDeltaSource(eqx.Module):
    """A light without extent: its light arrives from one direction, which is evaluated and never sampled."""

    @abc.abstractmethod
    def toward(self, point: Float[Array, " 3"]) -> tuple[Float[Array, " 3"], Float[Array, ""]]:
        """Unit vector to the light [3] and its distance [m]."""

    @abc.abstractmethod
    def beam(self, nodes: Nodes, point: Float[Array, " 3"]) -> Float[Array, " node"]:
        """Irradiance [node] [W m-2] of a surface at `point` that faces the light."""

    @abc.abstractmethod
    def checks(self) -> list[Check]:
        """What must hold of the fields' values."""


class ParallelSource(AbstractDeltaSource):
    """A source at infinity without extent, as the sun nearly is.

    Attributes:
        direction: in which its light travels [3], unit length; (0, 0, -1) shines from above.
        irradiance: on a surface facing it [node or 1] [W m-2], integrated over each node's bin.

    Differentiable in `irradiance`; not in `direction` where shadows move.
    """

    direction: Float[Array, " 3"]
    irradiance: Float[Array, " node"]

    def __init__(self, direction: Any, irradiance: Any):
        """Convert; `direction` must have length 1, `irradiance` is one value or one per node."""
        self.direction = as_float(direction, "ParallelSource.direction")
        require_shape("ParallelSource.direction", self.direction, (3,))
        self.irradiance = spectral("ParallelSource.irradiance", irradiance)

    def toward(self, point: Float[Array, " 3"]) -> tuple[Float[Array, " 3"], Float[Array, ""]]:
        """See `AbstractDeltaSource.toward`; the same direction from everywhere, at infinity."""
        return -self.direction, jnp.full((), jnp.inf, self.direction.dtype)

    def beam(self, nodes: Nodes, point: Float[Array, " 3"]) -> Float[Array, " node"]:
        """See `AbstractDeltaSource.beam`; the same everywhere."""
        return per_node("ParallelSource.irradiance", self.irradiance, nodes)

    def checks(self) -> list[Check]:
        """The direction has length 1, the irradiance is not negative."""
        return [
            unit_vector("ParallelSource.direction", self.direction),
            non_negative("ParallelSource.irradiance", self.irradiance),
        ]
