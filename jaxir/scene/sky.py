"""What lies around a scene, by elevation: sky above, earth below."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._arrays import Check, as_float, finite, non_negative
from jaxir.optics.spectrum import Nodes
from jaxir.scene.background import AbstractBackground
from jaxir.scene.source import per_node


class ElevationTable(AbstractBackground):
    """Radiance of sky and earth as a function of elevation alone, linear between given elevations.

    Attributes:
        elevation: increasing, from below to above the horizon [elevation] [deg]; constant beyond its ends. Two equal
            entries make a step, as the horizon is one.
        given_radiance: towards each elevation [elevation, node or 1] [W m-2 sr-1].

    Differentiable in `given_radiance`.
    """

    elevation: Float[Array, " elevation"]
    given_radiance: Float[Array, "elevation node"]

    def __init__(self, elevation: Any, radiance: Any):
        """Convert; `radiance` is [elevation] or [elevation, node]."""
        self.elevation = as_float(elevation, "ElevationTable.elevation")
        value = as_float(radiance, "ElevationTable.radiance")
        value = value[:, None] if value.ndim == 1 else value
        if self.elevation.ndim != 1 or self.elevation.size == 0 or value.shape[:1] != self.elevation.shape:
            raise ValueError(
                f"ElevationTable: got elevation of shape {self.elevation.shape} and radiance of shape {value.shape}, "
                "expected (n,) and (n,) or (n, node) with n >= 1"
            )
        if value.ndim != 2:
            raise ValueError(f"ElevationTable.radiance: got shape {value.shape}, expected (n,) or (n, node)")
        self.given_radiance = value

    def towards(self, omega: Float[Array, " 3"]) -> Float[Array, " node"]:
        """Radiance [node or 1] [W m-2 sr-1] seen in direction `omega` [3], unit length."""
        horizontal = omega[0] ** 2 + omega[1] ** 2
        side = jnp.where(horizontal > 0, jnp.sqrt(jnp.where(horizontal > 0, horizontal, 1)), 0)
        angle = jnp.rad2deg(jnp.arctan2(omega[2], side))
        above = jnp.searchsorted(self.elevation, angle, side="right")
        low = jnp.clip(above - 1, 0, self.elevation.size - 1)
        high = jnp.clip(above, 0, self.elevation.size - 1)
        step = self.elevation[high] - self.elevation[low]
        part = jnp.where(step > 0, (angle - self.elevation[low]) / jnp.where(step > 0, step, 1), 0)
        return (1 - part) * self.given_radiance[low] + part * self.given_radiance[high]

    def radiance(self, nodes: Nodes, direction: Float[Array, "*batch 3"]) -> Float[Array, "*batch node"]:
        """See `AbstractBackground.radiance`."""
        level = jax.vmap(lambda row: per_node("ElevationTable.radiance", row, nodes))(self.given_radiance)
        table = eqx.tree_at(lambda t: t.given_radiance, self, level)
        seen = jax.vmap(table.towards)(direction.reshape(-1, 3))
        return seen.reshape(direction.shape[:-1] + (nodes.count,))

    def checks(self) -> list[Check]:
        """Elevations are finite and do not decrease, radiances are not negative."""
        step = jnp.diff(self.elevation)
        return [
            finite("ElevationTable.elevation", self.elevation),
            Check("steps of ElevationTable.elevation", step, step >= 0, "elevations that do not decrease"),
            non_negative("ElevationTable.radiance", self.given_radiance),
        ]
