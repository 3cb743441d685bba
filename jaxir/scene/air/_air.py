"""The path between target and sensor: L at the pupil = transmittance * L at the target + path radiance (2)."""

from __future__ import annotations

import abc

import equinox as eqx
from jaxtyping import Array, Float

from jaxir._fields import Physical
from jaxir.optics.air import Profile
from jaxir.optics.spectrum import Nodes


class AirPath(eqx.Module):
    """What a path does to light on spectral nodes.

    Attributes:
        transmittance: [node].
        path_radiance: emitted and scattered into the path [node] [W m-2 sr-1].
    """

    transmittance: Float[Array, " node"]
    path_radiance: Float[Array, " node"]


class AbstractAtmosphere(Physical):
    """One path through the atmosphere, the same for every pixel."""

    @property
    def target(self) -> tuple[Float[Array, ""], Profile] | None:
        """Altitude of the target [m] and the air around it, from which sky and sunlight follow; None if not known."""
        return None

    @property
    def described(self) -> str:
        """What it is in a few words."""
        return type(self).__name__

    @abc.abstractmethod
    def on(self, nodes: Nodes) -> AirPath:
        """Transmittance and radiance of the path on `nodes`. Differentiable in the fields."""

    def in_front_of(self, nodes: Nodes, hottest: Float[Array, ""]) -> AirPath:
        """The same in front of gas that is nowhere hotter than `hottest` [K].

        Its lines may be those of the air, which then takes more from the quantiles of strong absorption; here it does
        not matter. Differentiable in the fields and in `hottest`.
        """
        return self.on(nodes)
