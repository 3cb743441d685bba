"""The path from the target out of the air, as sunlight takes it."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._arrays import Check, finite, require
from jaxir._fields import quantity, require_part
from jaxir._plausible import ELEVATION, usual
from jaxir.optics._tables import COLD_PATH_EDGES
from jaxir.optics.air import Profile, air_along, path_emission, path_transmittance, to_sky, us_standard_1976
from jaxir.optics.spectrum import Nodes, bins_inside
from jaxir.scene.air._air import AbstractAtmosphere, AirPath

TARGET_ALTITUDE = usual(-500, 20e3, "m", above="nearly all air is below")


def or_us_standard(profile: Profile | None) -> Profile:
    """A profile, or the US Standard Atmosphere 1976; `ValueError` for what is none."""
    if profile is None:
        return us_standard_1976()
    require_part("profile", profile, Profile, "a profile, e.g. jaxir.optics.air.us_standard_1976(), or None")
    return profile


class PathToSpace(AbstractAtmosphere):
    """The path from a point in the air to the end of the profile, over the round earth and without refraction.

    Transmittance and emission as those of `StandardAtmosphere`, to 25 km: above lie 2.5 % of the air, nearly no water
    and about a third of the ozone, which are left out. A path that meets the ground lets nothing pass.

    Attributes:
        altitude: where it begins [m].
        elevation: of its end above the horizontal [deg].
        profile: state of the air over altitude; None for the US Standard Atmosphere 1976.

    Differentiable in every field but `profile.altitude`.
    """

    altitude: Float[Array, ""] = quantity("m", within=(finite, TARGET_ALTITUDE))
    elevation: Float[Array, ""] = quantity("deg", within=(finite, ELEVATION))
    profile: Profile = eqx.field(converter=or_us_standard, default=None)

    def on(self, nodes: Nodes) -> AirPath:
        """See `AbstractAtmosphere.on`.

        Raises:
            ValueError: a bin outside 800-10000 cm-1 (1-12.5 um), where bins are known.
        """
        require(self.node_checks(nodes))
        hidden = to_sky(self.profile, self.altitude, self.elevation).ground
        clear = jnp.where(hidden, 90.0, self.elevation)  # through the earth air would be denser than numbers hold
        air = air_along(self.profile, self.altitude, to_sky(self.profile, self.altitude, clear))
        passed, emitted = path_transmittance(air, nodes), path_emission(air, nodes)
        return AirPath(jnp.where(hidden, 0, passed), jnp.where(hidden, 0, emitted))

    @property
    def has_spectrum(self) -> bool:
        """See `Physical.has_spectrum`."""
        return True

    def node_checks(self, nodes: Nodes) -> list[Check]:
        """See `Physical.node_checks`: bins lie within 800-10000 cm-1."""
        return bins_inside("PathToSpace", nodes, COLD_PATH_EDGES)

    def relations(self) -> list[Check]:
        """The point lies inside the profile."""
        low, high = self.profile.altitude[0], self.profile.altitude[-1]
        inside = (self.altitude >= low - 1) & (self.altitude < high)
        return [Check("PathToSpace.altitude", self.altitude, inside, "an altitude inside the profile")]
