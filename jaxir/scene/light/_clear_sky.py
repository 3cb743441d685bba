"""Clear sky above and earth below, from the model of the air."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxir._arrays import Check, as_float, finite, fraction, thermal
from jaxir._fields import over_nodes, quantity, spectral
from jaxir._math import matmul
from jaxir._plausible import KELVIN
from jaxir.optics._tables import COLD_PATH_EDGES
from jaxir.optics.air import (
    Profile,
    Sight,
    air_along,
    horizon,
    path_emission,
    path_transmittance,
    to_ground,
    to_sky,
)
from jaxir.optics.spectrum import Nodes, band_radiance, bins_inside
from jaxir.scene.air import TARGET_ALTITUDE, AbstractAtmosphere, or_us_standard
from jaxir.scene.light._light import AbstractBackground, AbstractLight
from jaxir.scene.light._sky import ElevationTable
from jaxir.scene.light._sun import Sun

ROWS = 21  # elevations of the table on each side of the horizon
ZENITHS = 6  # of the quadrature over the sky that the ground sees


class ClearSky(AbstractBackground):
    """The thermal emission of a clear sky, and the earth seen through the air, at a point of a standard atmosphere.

    Towards the sky L = path emission to 25 km; towards the ground

        L = tau [ e B(T) + (1 - e) / pi (E_sky + E_sun sin(elevation of the Sun)) ] + path emission,

    with e and T those of the ground, which reflects alike in all directions, E_sky the sky's irradiance of the ground
    and E_sun that of the Sun there. Everything is a function of elevation, a table of 21 values on each side of the
    horizon, which errs by less than .5 % of a band's irradiance from above or below; the cut of paths into segments
    errs by up to .6 % of it, and 1.1 % of the radiance just above the horizon. Transmittance and emission are those of
    `StandardAtmosphere`, over the round earth, without haze, clouds and refraction. Left out is sunlight that the air
    scatters: by molecules alone an irradiance of about 2e-3 of the Sun's in SWIR at the ground, less elsewhere.

    Attributes:
        altitude: of the target [m]. None: that of the scene's `StandardAtmosphere`.
        ground_temperature: [K]; None for that of the air at the ground.
        ground_emissivity: [node or 1].
        sun: what lights the ground. None: the first `Sun` among the scene's sources; without one the ground is dark.
        profile: state of the air; None for the scene's, or the US Standard Atmosphere 1976.

    Differentiable in every field but `profile.altitude`.
    """

    altitude: Float[Array, ""] | None = quantity("m", within=(finite, TARGET_ALTITUDE), default=None)
    ground_temperature: Float[Array, ""] | None = quantity("K", within=(thermal, KELVIN), default=None)
    ground_emissivity: Float[Array, " node"] = spectral("1", fraction, default=0.9)
    sun: Sun | None = eqx.field(default=None)
    profile: Profile | None = eqx.field(default=None)

    def within(self, atmosphere: AbstractAtmosphere | None, sources: tuple[AbstractLight, ...]) -> ClearSky:
        """See `AbstractLight.within`: with the scene's altitude, air and Sun where none is given."""
        place = None if atmosphere is None else atmosphere.target
        altitude, profile, sun = self.altitude, self.profile, self.sun
        if altitude is None and place is not None:
            altitude = place[0]
        if profile is None and place is not None:
            profile = place[1]
        if sun is None:
            sun = next((source for source in sources if isinstance(source, Sun)), None)
        elif atmosphere is not None:
            sun = sun.within(atmosphere, ())
        return ClearSky(altitude, self.ground_temperature, self.ground_emissivity, sun, profile)

    @property
    def uniform(self) -> bool:
        """See `AbstractBackground.uniform`."""
        return False

    @property
    def has_spectrum(self) -> bool:
        """See `Physical.has_spectrum`."""
        return True

    def node_checks(self, nodes: Nodes) -> list[Check]:
        """See `Physical.node_checks`: bins lie within 800-10000 cm-1."""
        return [*super().node_checks(nodes), *bins_inside("ClearSky", nodes, COLD_PATH_EDGES)]

    def on(self, nodes: Nodes) -> ElevationTable:
        """See `AbstractLight.on`: the radiance over elevation.

        Raises:
            ValueError: no altitude, and none in the scene.
        """
        if self.altitude is None:
            raise ValueError(
                "ClearSky.altitude: got none, expected the target's [m], or a scene with a StandardAtmosphere"
            )
        profile, altitude = or_us_standard(self.profile), self.altitude
        level, low = horizon(altitude), jnp.maximum(profile.altitude[0], 0)
        share, (sine, weight) = as_float(np.linspace(0, 1, ROWS) ** 3), _zeniths()
        above, below = level + (90 - level) * share, level - (90 + level) * share[::-1]
        high = as_float(-90.0) if self.sun is None else self.sun.elevation
        # All paths of one program: down and up from the target, up from the ground, and from there to the Sun.
        shining = jnp.where(high > 0, high, 90.0)  # from below the horizon none comes; paths there would meet the earth
        from_ground = jnp.concatenate([jnp.rad2deg(jnp.arcsin(sine)), shining[None]])
        sights = [
            jax.vmap(lambda e: to_ground(altitude, e))(below),
            jax.vmap(lambda e: to_sky(profile, altitude, e))(above),
            jax.vmap(lambda e: to_sky(profile, low, e))(from_ground),
        ]
        start = jnp.concatenate([jnp.full(2 * ROWS, altitude), jnp.full(ZENITHS + 1, low)])
        sight = jax.tree.map(lambda *each: jnp.concatenate(each), *sights)

        def along(start: Array, sight: Sight) -> tuple[Array, Array]:
            air = air_along(profile, start, sight)
            return path_transmittance(air, nodes), path_emission(air, nodes)

        passed, emitted = jax.vmap(along)(start, sight)
        arriving = matmul(weight, emitted[2 * ROWS : -1]) + self._sunlight(nodes, passed[-1]) * jnp.maximum(
            jnp.sin(jnp.deg2rad(high)), 0
        )
        emissivity = over_nodes(self, nodes).ground_emissivity
        warm = profile.at(low).temperature if self.ground_temperature is None else self.ground_temperature
        ground = emissivity * band_radiance(warm, nodes) + (1 - emissivity) / np.pi * arriving
        behind = jnp.where((jnp.arange(2 * ROWS) < ROWS)[:, None], ground[None], 0)
        radiance = passed[: 2 * ROWS] * behind + emitted[: 2 * ROWS]
        return ElevationTable(jnp.concatenate([below, above]), radiance)

    def _sunlight(self, nodes: Nodes, passed: Float[Array, " node"]) -> Float[Array, " node"]:
        """Irradiance across the Sun's beam at the ground, to which the air lets `passed` through."""
        if self.sun is None:
            return jnp.zeros_like(passed)
        return self.sun.above(nodes) * passed if self.sun.dimmed else self.sun.on(nodes).irradiance

    def arriving(self, omega_i: Float[Array, "*batch 3"]) -> Float[Array, "*batch node"]:
        """See `AbstractExtendedLight.arriving`; known on the nodes alone."""
        raise NotImplementedError("ClearSky: its radiance is that of `on(nodes)`")

    def form_factor_checks(self, corner: Float[Array, "face 3"], normal: Float[Array, "face 3"]) -> None:
        """See `AbstractExtendedLight.form_factor_checks`: there is no closed form."""
        return None

    def form_factor(self, point: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Float[Array, ""]:
        """See `AbstractExtendedLight.form_factor`."""
        raise NotImplementedError("ClearSky: no closed form")


def _zeniths() -> tuple[Array, Array]:
    """Sines of elevation [zenith], and weights with which radiance from there adds up to irradiance [zenith] [sr]."""
    place, weight = np.polynomial.legendre.leggauss(ZENITHS)
    sine = (place + 1) / 2
    return as_float(sine), as_float(sine * weight * np.pi)
