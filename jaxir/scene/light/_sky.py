"""What lies around a scene, by elevation: sky above, earth below."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._arrays import Check, finite, non_negative
from jaxir._fields import SpectralLight, quantity
from jaxir._math import safe_sqrt
from jaxir._plausible import ELEVATION
from jaxir.optics.spectrum import Nodes
from jaxir.scene.light._light import AbstractBackground, spread


def _rows(value: Array) -> Array:
    """[elevation] as [elevation, 1]."""
    return value[:, None] if value.ndim == 1 else value


class ElevationTable(AbstractBackground):
    """Radiance of sky and earth as a function of elevation alone, linear between given elevations.

    Attributes:
        elevation: increasing, from below to above the horizon [elevation] [deg]; constant beyond its ends. Two equal
            entries make a step, as the horizon is one.
        radiance: towards each elevation [elevation], or [elevation, node or 1] [W m-2 sr-1], or as many spectra.

    Differentiable in `radiance`.
    """

    elevation: Float[Array, " elevation"] = quantity("deg", ("elevation",), (finite, ELEVATION))
    radiance: SpectralLight = quantity("W m-2 sr-1", ("elevation", "node"), non_negative, _rows, light=True)

    def structure(self) -> None:
        """See `Physical.structure`."""
        if self.elevation.shape[0] == 0:
            raise ValueError("ElevationTable.elevation: got no value, expected at least one")

    def on(self, nodes: Nodes) -> ElevationTable:
        """See `AbstractLight.on`."""
        return spread(self, nodes)

    @property
    def uniform(self) -> bool:
        """See `AbstractBackground.uniform`."""
        return False

    def arriving(self, omega_i: Float[Array, "*batch 3"]) -> Float[Array, "*batch node"]:
        """See `AbstractExtendedLight.arriving`."""
        return jax.vmap(self._toward)(omega_i.reshape(-1, 3)).reshape(omega_i.shape[:-1] + self.radiance.shape[1:])

    def form_factor_checks(self, corner: Float[Array, "face 3"], normal: Float[Array, "face 3"]) -> None:
        """See `AbstractExtendedLight.form_factor_checks`: there is no closed form."""
        return None

    def form_factor(self, point: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Float[Array, ""]:
        """See `AbstractExtendedLight.form_factor`."""
        raise NotImplementedError("ElevationTable: no closed form")

    def relations(self) -> list[Check]:
        """Elevations do not decrease."""
        step = jnp.diff(self.elevation)
        return [Check("steps of ElevationTable.elevation", step, step >= 0, "elevations that do not decrease")]

    def _toward(self, omega: Float[Array, " 3"]) -> Float[Array, " node"]:
        """Radiance [node] seen in direction `omega` [3], unit length."""
        side = safe_sqrt(omega[0] ** 2 + omega[1] ** 2)
        angle = jnp.rad2deg(jnp.arctan2(omega[2], side))
        above = jnp.searchsorted(self.elevation, angle, side="right")
        low = jnp.clip(above - 1, 0, self.elevation.size - 1)
        high = jnp.clip(above, 0, self.elevation.size - 1)
        step = self.elevation[high] - self.elevation[low]
        part = jnp.where(step > 0, (angle - self.elevation[low]) / jnp.where(step > 0, step, 1), 0)
        return (1 - part) * self.radiance[low] + part * self.radiance[high]
