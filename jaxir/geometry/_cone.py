"""Where a ray runs inside a round cone that is cut off at both ends."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from jaxir._math import safe_sqrt

FLAT = 1e-6  # a ray whose slope differs by less from an axis's or a cone's does not meet it within any length of use


class AxisView(NamedTuple):
    """A ray seen from an axis; s is the distance along it from a point of reference `start` [m] from its origin.

    The distance along the axis is z = along + slope s, the squared distance from the axis is
    r^2 = square + 2 half s + sine s^2. The ray is nearest to the axis at `nearest`.
    """

    start: Float[Array, ""]
    along: Float[Array, ""]
    slope: Float[Array, ""]
    square: Float[Array, ""]
    half: Float[Array, ""]
    sine: Float[Array, ""]
    nearest: Float[Array, ""]

    def z(self, s: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Distance along the axis [m]."""
        return self.along + s * self.slope

    def r_squared(self, s: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Squared distance from the axis [m2]."""
        return jnp.maximum(self.square + s * (2 * self.half + s * self.sine), 0)


def view_from_axis(
    base: Float[Array, " 3"],
    axis: Float[Array, " 3"],
    end: Float[Array, ""],
    origin: Float[Array, " 3"],
    direction: Float[Array, " 3"],
) -> AxisView:
    """One ray seen from the axis through `base` along the unit vector `axis`.

    The point of reference is the ray's nearest to the axis with 0 <= z <= end. Nothing depends on it but rounding,
    so it has no derivative.

    Differentiable in base, axis, origin, direction.
    """
    offset = origin - base
    slope, height = jnp.sum(direction * axis), jnp.sum(offset * axis)
    sideways, lateral = direction - slope * axis, offset - height * axis
    sine, half = jnp.sum(sideways * sideways), jnp.sum(lateral * sideways)
    oblique = sine > FLAT**2
    low, high = between(slope, -height, end - height)
    nearest = jnp.where(oblique, -half / jnp.where(oblique, sine, 1), 0)
    start = lax.stop_gradient(jnp.where(low < high, jnp.clip(nearest, low, high), nearest))
    lateral = lateral + start * sideways
    half = jnp.sum(lateral * sideways)
    nearest = jnp.where(oblique, -half / jnp.where(oblique, sine, 1), 0)
    return AxisView(start, height + start * slope, slope, jnp.sum(lateral * lateral), half, sine, nearest)


def between(
    slope: Float[Array, ""], low: Float[Array, ""], high: Float[Array, ""]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Interval of s where low <= slope s <= high; (inf, -inf) when nowhere."""
    flat = jnp.abs(slope) < FLAT
    within = (low <= 0) & (high >= 0)
    safe = jnp.where(flat, 1, slope)
    first, second = low / safe, high / safe
    return (
        jnp.where(flat, jnp.where(within, -jnp.inf, jnp.inf), jnp.minimum(first, second)),
        jnp.where(flat, jnp.where(within, jnp.inf, -jnp.inf), jnp.maximum(first, second)),
    )


def inside_cone(
    view: AxisView, radius: Float[Array, ""], flare: Float[Array, ""], end: Float[Array, ""]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Interval of s where 0 <= z <= end and r <= radius + flare z, a convex body.

    Where a ray is less steep than the cone it is inside between the roots of
    a s^2 + 2 b s + c = r^2 - (radius + flare z)^2. A steeper ray meets each of the two nappes once and is inside
    beyond a root, on the side where the cone opens; the slab 0 <= z <= end keeps it on the nappe that is meant.

    Args:
        view: the ray.
        radius: at z = 0 [m].
        flare: change of the radius with z, not 0; radius + flare end >= 0.
        end: where the cone is cut off [m].

    Returns:
        First and last s [m]; the first is not below the last on a miss.

    Differentiable in all arguments; a ray that grazes the cone has an unbounded derivative.
    """
    here, opening = radius + flare * view.along, flare * view.slope
    a = view.sine - opening * opening
    b = view.half - opening * here
    c = view.square - here * here
    discriminant = b * b - a * c
    flat = jnp.abs(a) < FLAT
    steep = (a < 0) | flat
    meets = steep | (discriminant > 0)
    root = safe_sqrt(discriminant)
    q = -(b + jnp.where(b < 0, -1, 1) * root)
    first = c / jnp.where(q == 0, 1, q)
    second = jnp.where(flat, first, q / jnp.where(flat, 1, a))
    low, high = jnp.minimum(first, second), jnp.maximum(first, second)
    opens = opening > 0
    begin = jnp.where(steep, jnp.where(opens, high, -jnp.inf), low)
    finish = jnp.where(steep, jnp.where(opens, jnp.inf, low), high)
    slab = between(view.slope, -view.along, end - view.along)
    begin, finish = jnp.maximum(begin, slab[0]), jnp.minimum(finish, slab[1])
    return jnp.where(meets, begin, jnp.inf), jnp.where(meets, finish, -jnp.inf)
