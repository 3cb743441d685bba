"""Gas whose absorption coefficient is given."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._arrays import non_negative
from jaxir._fields import per_node, quantity
from jaxir.optics.gas._gas import AbstractGas
from jaxir.optics.spectrum import Nodes


class GrayGas(AbstractGas):
    """A gas whose absorption coefficient is given, whatever its temperature.

    Attributes:
        coefficient: absorption coefficient [m-1]; shape [*cell, node], where the node axis may have length 1 (the
            same in every node) and the cell axes may be absent (the same in every cell).

    Differentiable in `coefficient`.
    """

    coefficient: Float[Array, "*cell node"] = quantity("m-1", ("*cell", "node"), non_negative, per_node)

    def absorption(self, nodes: Nodes, temperature: Float[Array, "*cell"]) -> Float[Array, "*cell node"]:
        """See `AbstractGas.absorption`; independent of temperature."""
        value = self.coefficient
        shape = temperature.shape + (nodes.count,)
        cells, node = value.shape[:-1], value.shape[-1]
        if cells not in ((), temperature.shape) or node not in (1, nodes.count):
            raise ValueError(
                f"GrayGas.coefficient: got shape {value.shape}, expected [*cell, node] with cells "
                f"{temperature.shape} (or none) and {nodes.count} nodes (or 1)"
            )
        spread = value.reshape((1,) * (len(shape) - value.ndim) + value.shape)
        return jnp.broadcast_to(spread, shape)

    def diluted(self, share: Float[Array, "*cell"], density: Float[Array, "*cell"]) -> GrayGas:
        """See `AbstractGas.diluted`: the coefficient is proportional to the number of absorbers in a volume.

        Raises:
            ValueError: the coefficient already differs from cell to cell.
        """
        if self.coefficient.ndim != 1:
            raise ValueError(
                f"GrayGas.coefficient: got shape {self.coefficient.shape}, expected one value or (node,): gas that is "
                "the same everywhere before it is diluted"
            )
        absorbers = share * density
        return GrayGas(absorbers[..., None] * self.coefficient.reshape((1,) * absorbers.ndim + (-1,)))

    def amounts(self) -> tuple[Any, ...]:
        """See `AbstractGas.amounts`: a coefficient has none."""
        return ()
