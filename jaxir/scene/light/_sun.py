"""The Sun, where it stands and what the air leaves of its light."""

from __future__ import annotations

import datetime
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxir._arrays import Check, finite, known, non_negative
from jaxir._fields import SpectralLight, light, over_nodes, quantity
from jaxir._plausible import ELEVATION, usual
from jaxir.geometry.search import Mesh, occluded
from jaxir.optics.spectrum import BlackbodySpectrum, Nodes
from jaxir.scene.air import AbstractAtmosphere, PathToSpace
from jaxir.scene.light._light import AbstractDeltaSource, AbstractLight
from jaxir.scene.light._parallel import SUNLIGHT, ParallelSource

TEMPERATURE = 5772.0  # K, nominal effective temperature, IAU 2015 resolution B3
SOLID_ANGLE = np.pi * (6.957e8 / 1.495978707e11) ** 2  # sr, of the nominal radius at the astronomical unit


def sunlight(distance: float = 1.0) -> BlackbodySpectrum:
    """Sunlight above the air: a blackbody of 5772 K in the Sun's solid angle, 1361 W m-2 at all wavelengths.

    Right in its integral. Band by band the Sun's own lines and layers depart from it by some per cent: a
    `TabulatedSpectrum` of a reference spectrum says how much.

    Args:
        distance: of the earth from the Sun [astronomical units].
    """
    kind: Any = BlackbodySpectrum
    return kind(TEMPERATURE, SOLID_ANGLE / distance**2)


class Sun(AbstractDeltaSource):
    """Sunlight at the target: parallel light from an elevation and azimuth, dimmed by the air above.

    Azimuth and elevation are those of the aspect convention, in body axes: azimuth from the nose towards the left wing,
    elevation above the wings' plane, so that a Sun at the sensor's aspect stands behind the sensor. They are those over
    the horizon where the wings are level.

    Attributes:
        elevation: [deg].
        azimuth: [deg].
        irradiance: above the air, across the beam [W m-2], as that of `ParallelSource`; None for `sunlight()`.
        air: the path from the target to the Sun. None: in a scene with a `StandardAtmosphere`, or another that knows
            where the target is, the `PathToSpace` from there; in a scene without air, none. `FixedPath(1.0)` where
            `irradiance` is that at the target already, as a table of MODTRAN's may be.

    Differentiable in `irradiance` and `air`; not in the direction where shadows move.
    """

    elevation: Float[Array, ""] = quantity("deg", within=(finite, ELEVATION))
    azimuth: Float[Array, ""] = quantity("deg", within=(finite, usual(-360, 360, "deg")))
    irradiance: SpectralLight | None = light("W m-2", (non_negative, SUNLIGHT), default=None)
    air: AbstractAtmosphere | None = eqx.field(default=None)

    @property
    def direction(self) -> Float[Array, " 3"]:
        """In which its light travels [3]."""
        up, around = jnp.deg2rad(self.elevation), jnp.deg2rad(self.azimuth)
        level = jnp.cos(up)
        return -jnp.stack([level * jnp.cos(around), level * jnp.sin(around), jnp.sin(up)])

    def within(self, atmosphere: AbstractAtmosphere | None, sources: tuple[AbstractLight, ...]) -> Sun:
        """See `AbstractLight.within`: with the path to it through the scene's air, unless one is given.

        Raises:
            ValueError: air that does not know where the target is.
        """
        if self.air is not None or atmosphere is None:
            return self
        place = atmosphere.target
        if place is None:
            raise ValueError(
                f"Sun.air: got none in a scene with {type(atmosphere).__name__}, which tells no altitude; expected the "
                "path to the Sun, e.g. PathToSpace(altitude, elevation), or FixedPath(1.0) for light at the target"
            )
        return Sun(self.elevation, self.azimuth, self.irradiance, PathToSpace(place[0], self.elevation, place[1]))

    @property
    def dimmed(self) -> bool:
        """Whether the air of the model dims it, and not one that was given."""
        return isinstance(self.air, PathToSpace)

    def above(self, nodes: Nodes) -> Float[Array, " node"]:
        """Irradiance above the air, across the beam [node] [W m-2]. Differentiable."""
        own = over_nodes(self, nodes).irradiance
        return sunlight().on(nodes) if own is None else own

    def on(self, nodes: Nodes) -> ParallelSource:
        """See `AbstractLight.on`: parallel light."""
        passed = 1.0 if self.air is None else self.air.on(nodes).transmittance
        return ParallelSource(self.direction, self.above(nodes) * passed)

    def toward(self, point: Float[Array, " 3"]) -> tuple[Float[Array, " 3"], Float[Array, ""]]:
        """See `AbstractDeltaSource.toward`; the same direction from everywhere, at infinity."""
        return -self.direction, jnp.full((), jnp.inf, self.elevation.dtype)

    def beam(self, point: Float[Array, " 3"]) -> Float[Array, " node"]:
        """See `AbstractDeltaSource.beam`; known on the nodes alone."""
        raise NotImplementedError("Sun: its irradiance is that of `on(nodes)`")

    @property
    def travel(self) -> Float[Array, " 3"]:
        """See `AbstractDeltaSource.travel`."""
        return self.direction

    def hidden(
        self, mesh: Mesh, point: Float[Array, "ray 3"], face: Int[Array, " ray"], active: Bool[Array, " ray"]
    ) -> Bool[Array, " ray"]:
        """See `AbstractDeltaSource.hidden`."""
        return occluded(mesh, point, face, -self.direction, active)

    def doubts(self) -> list[Check]:
        """It is above the horizontal, which it leaves for a few degrees below only as seen from high up."""
        elevation = known(self.elevation)
        if elevation is None:
            return []
        up = np.asarray(elevation >= -5.0)
        return [Check("Sun.elevation", self.elevation, up, "above the horizon; by night there is no Sun", doubt=True)]


def sun_position(time: datetime.datetime, latitude: float, longitude: float) -> tuple[float, float, float]:
    """Where the Sun stands, to .01 degrees from 1950 to 2050, without refraction.

    The low-precision formulas of the Astronomical Almanac, as in Michalsky, Solar Energy 40 (1988) 227.

    Args:
        time: with its time zone.
        latitude: [deg], positive to the north.
        longitude: [deg], positive to the east.

    Returns:
        Elevation [deg], azimuth from north through east [deg], and distance [astronomical units].

    Raises:
        ValueError: a time without zone, a latitude beyond 90 degrees or a longitude beyond 360.
    """
    if not isinstance(time, datetime.datetime) or time.tzinfo is None:
        raise ValueError(f"time: got {time!s}, expected date and time with a zone, as 2026-06-21T12:00:00Z")
    for name, value, most in (("latitude", latitude, 90.0), ("longitude", longitude, 360.0)):
        if not abs(value) <= most:
            raise ValueError(f"{name}: got {value}, expected -{most:g} to {most:g} degrees")
    noon = datetime.datetime(2000, 1, 1, 12, tzinfo=datetime.UTC)
    days = (time - noon) / datetime.timedelta(days=1)
    mean, anomaly = np.deg2rad(280.460 + 0.9856474 * days), np.deg2rad(357.528 + 0.9856003 * days)
    ecliptic = mean + np.deg2rad(1.915 * np.sin(anomaly) + 0.020 * np.sin(2 * anomaly))
    tilt = np.deg2rad(23.439 - 4e-7 * days)
    ascension = np.arctan2(np.cos(tilt) * np.sin(ecliptic), np.cos(ecliptic))
    sine = np.sin(tilt) * np.sin(ecliptic)  # of the declination
    cosine = np.sqrt(1 - sine**2)
    distance = 1.00014 - 0.01671 * np.cos(anomaly) - 0.00014 * np.cos(2 * anomaly)
    turned = 15 * (18.697374558 + 24.06570982441908 * days) + longitude  # sidereal time at the place
    hour, north = np.deg2rad(turned) - ascension, np.deg2rad(latitude)
    up = sine * np.sin(north) + cosine * np.cos(north) * np.cos(hour)
    azimuth = np.arctan2(-cosine * np.sin(hour), sine * np.cos(north) - cosine * np.sin(north) * np.cos(hour))
    return float(np.rad2deg(np.arcsin(up))), float(np.rad2deg(azimuth) % 360), float(distance)


def sun_at(
    time: datetime.datetime,
    latitude: float,
    longitude: float,
    heading: float = 0.0,
    irradiance: Any = None,
    air: AbstractAtmosphere | None = None,
) -> Sun:
    """The Sun over a body that flies level.

    Args:
        time: see `sun_position`.
        latitude: likewise [deg].
        longitude: likewise [deg].
        heading: of the nose, from north through east [deg].
        irradiance: as that of `Sun`; None for `sunlight` at the day's distance.
        air: as that of `Sun`.

    Raises:
        ValueError: as `sun_position`.
    """
    elevation, azimuth, distance = sun_position(time, latitude, longitude)
    own = sunlight(distance) if irradiance is None else irradiance
    kind: Any = Sun
    return kind(elevation, (heading - azimuth + 180) % 360 - 180, own, air)
