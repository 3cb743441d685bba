"""Lines of sight from a point in the air: to the end of the air, or to the ground; over the round earth."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxir._math import safe_sqrt
from jaxir.optics.air._profile import Profile
from jaxir.optics.air._standard import EARTH_RADIUS, PathAir, path_air

NEAREST = 1.0  # m; a shorter path has no logarithm of its column, and no air to speak of


class Sight(NamedTuple):
    """Where a line of sight ends.

    Attributes:
        altitude: of its end [m].
        distance: to there [m].
        ground: whether it meets the ground.
    """

    altitude: Float[Array, ""]
    distance: Float[Array, ""]
    ground: Bool[Array, ""]


def horizon(altitude: Float[Array, ""]) -> Float[Array, ""]:
    """Elevation of the horizon seen from an altitude [deg], <= 0; refraction is left out. Differentiable above 0 m."""
    height = jnp.maximum(altitude, 0)
    rise = safe_sqrt(height * (2 * EARTH_RADIUS + height)) / (EARTH_RADIUS + height)
    return -jnp.rad2deg(jnp.arcsin(rise))


def to_sky(profile: Profile, altitude: Float[Array, ""], elevation: Float[Array, ""]) -> Sight:
    """The line of sight to the highest level of the profile; one that meets the ground is said to, and goes through it.

    Args:
        profile: the atmosphere.
        altitude: where the line begins, inside the profile [m].
        elevation: above the horizontal there [deg].

    Differentiable.
    """
    top = profile.altitude[-1]
    radius, sine = EARTH_RADIUS + altitude, jnp.sin(jnp.deg2rad(elevation))
    along, free = radius * sine, (top - altitude) * (2 * radius + (top - altitude))
    root = safe_sqrt(along**2 + free)
    rising = along > 0  # of the two forms the one without cancellation
    distance = jnp.where(rising, free / jnp.where(rising, along + root, 1), root - along)
    tangent = along**2 - altitude * (2 * EARTH_RADIUS + altitude)  # < 0 where the line stays above the ground
    return Sight(top, jnp.maximum(distance, NEAREST), (sine < 0) & (tangent > 0))


def to_ground(altitude: Float[Array, ""], elevation: Float[Array, ""]) -> Sight:
    """The line of sight to the ground at 0 m, of an elevation at or below the horizon. Differentiable below it."""
    along = -(EARTH_RADIUS + altitude) * jnp.sin(jnp.deg2rad(elevation))
    drop = altitude * (2 * EARTH_RADIUS + altitude)
    root = safe_sqrt(jnp.maximum(along**2 - drop, 0))
    distance = jnp.maximum(drop / jnp.maximum(along + root, NEAREST), NEAREST)
    return Sight(jnp.zeros_like(distance), distance, jnp.ones_like(distance, bool))


def air_along(profile: Profile, altitude: Float[Array, ""], sight: Sight) -> PathAir:
    """Optical depths along a line of sight, see `path_air`."""
    return path_air(profile, altitude, sight.altitude, sight.distance)
