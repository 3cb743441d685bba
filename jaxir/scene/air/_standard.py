"""The standard atmosphere."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxir._arrays import Check, as_float, finite, positive, require
from jaxir._fields import flag, quantity
from jaxir._plausible import reach, usual
from jaxir.optics._tables import COLD_PATH_EDGES
from jaxir.optics.air import (
    Profile,
    altitude_along,
    path_air,
    path_emission,
    path_transmittance,
    slot_path,
)
from jaxir.optics.spectrum import Nodes, bins_inside
from jaxir.scene.air._air import AbstractAtmosphere, AirPath
from jaxir.scene.air._to_space import or_us_standard

_FIT = "the fit to LOWTRAN 7"
_HIGHEST, _FARTHEST = 12e3, 60e3  # that it was made for [m]


class StandardAtmosphere(AbstractAtmosphere):
    """Molecular absorption and emission of a straight path, from the embedded fit to LOWTRAN 7 (no haze, no clouds).

    The path runs over the round earth, slant or level; refraction is left out. Equations and accuracy are those of
    `jaxir.optics.air`, made for altitudes up to 12 km and paths up to 60 km through the US Standard Atmosphere; more of
    either is refused unless the air was told to `extrapolate`, and a path that leaves the profile (25 km) always.
    Scattered sunlight is not part of the path radiance. LOWTRAN 7 gives its lowest kilometre the mean temperature of
    the layer; here each segment has its own, so a sensor on the ground sees 288 K instead of 285 K where the air is
    opaque.

    Use it with `resolved_nodes`: the transmittance of a node is the mean over the node's bin, and a mean over a whole
    band is the wrong factor for anything whose spectrum follows that of the air (for a 360 K surface seen from the
    ground the SWIR transmittance is .15, its band mean .50). Hot CO2 behind cold CO2 has lines that coincide: mean
    transmittances would err by +3 % (1500 K, thick) to +37 % (1000 K, dilute) at 4.3 um. Between 2000 and 2400 cm-1 a
    scene with a plume therefore gives each node the mean over the wavenumbers of its quantile, from tables of lines of
    CO2 that keep the mean of each bin (`jaxir.optics.air.slot_path`): the radiance is within 5 % of line by line
    (`studies.spectral_fidelity`) from 800 K on, and within 9 % at 500 K. Water is left out: its hot and cold lines are
    multiplied as means. With lists of lines `jaxir.io.spectra.slot_atmosphere` does it for all.

    Attributes:
        sensor_altitude: [m].
        target_altitude: [m].
        distance: from sensor to target [m]; see `jaxir.optics.air.slant_range`.
        profile: state of the air over altitude; None for the US Standard Atmosphere 1976.
        extrapolate: go on beyond 12 km of altitude and 60 km of path, with a `PlausibilityWarning`.

    Differentiable in every field but `profile.altitude`.
    """

    sensor_altitude: Float[Array, ""] = quantity("m", within=(finite, usual(-500, np.inf, "m")))
    target_altitude: Float[Array, ""] = quantity("m", within=(finite, usual(25, np.inf, "m", "is it in km?")))
    distance: Float[Array, ""] = quantity("m", within=(positive, usual(100, np.inf, "m", "is it in km?")))
    profile: Profile = eqx.field(converter=or_us_standard, default=None)
    extrapolate: bool = flag()

    def doubts(self) -> list[Check]:
        """The path is no higher and no longer than the fit was made for."""
        limits = {"sensor_altitude": _HIGHEST, "target_altitude": _HIGHEST, "distance": _FARTHEST}
        return [
            reach(f"StandardAtmosphere.{name}", getattr(self, name), -np.inf, most, "m", _FIT, self.extrapolate)
            for name, most in limits.items()
        ]

    def on(self, nodes: Nodes) -> AirPath:
        """See `AbstractAtmosphere.on`: the radiance is the air's own emission.

        Raises:
            ValueError: a bin outside 800-10000 cm-1 (1-12.5 um), where bins are known.
        """
        require(self.node_checks(nodes))
        air = path_air(self.profile, self.sensor_altitude, self.target_altitude, self.distance)
        return AirPath(path_transmittance(air, nodes), path_emission(air, nodes))

    def in_front_of(self, nodes: Nodes, hottest: Float[Array, ""]) -> AirPath:
        """See `AbstractAtmosphere.in_front_of`: at 4.3 um the air in the slots of the nodes' quantiles.

        Raises:
            ValueError: as `on`.
        """
        require(self.node_checks(nodes))
        air = path_air(self.profile, self.sensor_altitude, self.target_altitude, self.distance)
        return AirPath(*slot_path(air, nodes, hottest))

    @property
    def target(self) -> tuple[Float[Array, ""], Profile]:
        """See `AbstractAtmosphere.target`."""
        return self.target_altitude, self.profile

    @property
    def has_spectrum(self) -> bool:
        """See `Physical.has_spectrum`."""
        return True

    def node_checks(self, nodes: Nodes) -> list[Check]:
        """See `Physical.node_checks`: bins lie within 800-10000 cm-1."""
        return bins_inside("StandardAtmosphere", nodes, COLD_PATH_EDGES)

    def relations(self) -> list[Check]:
        """The path is long enough for its two altitudes and stays within the profile."""
        lowest, highest = self.profile.altitude[0], self.profile.altitude[-1]
        share = as_float(jnp.linspace(0, 1, 33))
        along = altitude_along(self.sensor_altitude, self.target_altitude, self.distance, share)
        within = (along >= lowest - 1) & (along <= highest + 1)
        rise = jnp.abs(self.target_altitude - self.sensor_altitude)
        return [
            Check(
                "StandardAtmosphere.distance",
                self.distance,
                self.distance * (1 + 1e-5) >= rise,
                "at least the difference of the altitudes",
            ),
            Check("StandardAtmosphere: altitude along the path", along, within, "altitudes inside the profile"),
        ]
