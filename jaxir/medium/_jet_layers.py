"""Radiance across the panels of a jet, whose optics are tabulated over its mixture fraction.

A panel is integrated by two points of Gauss and Legendre,

    R <- E1 E2 R,    E: through a homogeneous layer,    A1 = a1 - x (a2 - a1),  A2 = a2 + x (a2 - a1),

with a = (extinction, emission) times half the panel's length at the two points and x = 1/sqrt(3) - 1/2: the
commutator-free Magnus integrator of fourth order (Blanes and Moan, "Fourth- and sixth-order commutator-free Magnus
integrators for linear and non-linear dynamical systems", Appl. Numer. Math. 56, 2006). Where a1 and a2 differ much, x
is reduced so that no layer becomes negative: however thick the medium, its radiance lies between 0 and that of its
brightest point. Equal points make the panel one homogeneous layer, exactly.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from jaxir._math import INSIDE
from jaxir.optics import phi1, thinning, through_layer

COMPUTED = 256  # knots at which the optics are computed, 7 K apart between 300 and 2000 K
BETWEEN = 4  # knots of the table for each interval of those
KNOTS = BETWEEN * (COMPUTED - 1)  # intervals of the table; see `tabulated_jet` for what they err
GAUSS = (0.5 - 3**-0.5 / 2, 0.5 + 3**-0.5 / 2)  # the two points of a panel, as shares of it
_DARK = 1e-18  # the inverse square of what is smaller overflows in float32
_EXTRAPOLATE = 3**-0.5 - 0.5


@jax.custom_jvp
def across_panels(
    behind: Float[Array, "ray node"],
    extinction: Float[Array, "knot node"],
    emission: Float[Array, "knot node"],
    fraction: Float[Array, "panel 2 ray"],
    length: Float[Array, "panel 2 ray"],
) -> Float[Array, "ray node"]:
    """The radiance in front of panels, each of which is A2 and before it A1 of this file's head.

    What is found in the tables lies in rows of one ray, what follows in one long row, because loops over a few nodes
    are slow; and each is a computation of its own, because XLA would join the loops. A panel that none of the rays
    crosses, as the core behind its end, is left out.
    """
    none = jnp.zeros((2 * behind.shape[0], behind.shape[1]), behind.dtype)

    def panel(radiance: Array, each: tuple[Array, Array]) -> tuple[Array, None]:
        fraction, length = each
        crossed = (length > 0).any()

        def look_up() -> list[Array]:
            return [at_both(table, fraction) * both(length) for table in (extinction, emission)]

        depth, sent = (x.reshape(2, -1) for x in lax.cond(crossed, look_up, lambda: [none, none]))
        return lax.cond(crossed, lambda: front_of_panel(radiance, *depth, *sent), lambda: radiance), None

    return lax.scan(panel, behind.reshape(-1), (fraction, length), reverse=True)[0].reshape(behind.shape)


@across_panels.defjvp
def _across_panels_jvp(primals, tangents):
    """As the value, with factors for the tangents, which are found once for all of them."""
    behind, extinction, emission, fraction, length = primals
    d_behind, d_extinction, d_emission, d_fraction, d_length = tangents
    none = jnp.zeros((2 * behind.shape[0], behind.shape[1]), behind.dtype)

    def panel(state: tuple[Array, Array], each: tuple[Array, ...]) -> tuple[tuple[Array, Array], None]:
        radiance, change = state
        fraction, length, d_fraction, d_length = each
        crossed = (length > 0).any()

        def look_up() -> list[tuple[Array, Array]]:
            return [(at_both(table, fraction), _slope(table, fraction.reshape(-1))) for table in (extinction, emission)]

        found = lax.cond(crossed, look_up, lambda: [(none, none)] * 2)
        half, d_half, d_place = map(both, (length, d_length, d_fraction))
        layers = [layer for value, _ in found for layer in (value * half).reshape(2, -1)]
        passing = radiance, jnp.ones_like(radiance), [jnp.zeros_like(radiance)] * 4
        front, kept, factors = lax.cond(crossed, lambda: _factors(radiance, *layers), lambda: passing)
        change = kept.reshape(change.shape) * change
        for i, ((value, slope), table) in enumerate(zip(found, (d_extinction, d_emission), strict=True)):
            moved = half * (at_both(table, fraction) + slope * d_place) + value * d_half
            for factor, own in zip(factors[2 * i : 2 * i + 2], jnp.split(moved, 2), strict=True):
                change = change + factor.reshape(change.shape) * own
        return (front, change), None

    panels = fraction, length, d_fraction, d_length
    front, change = lax.scan(panel, (behind.reshape(-1), d_behind), panels, reverse=True)[0]
    return front.reshape(behind.shape), change


def front_of_panel(behind: Array, near_u: Array, far_u: Array, near_j: Array, far_j: Array) -> Array:
    """The radiance in front of a panel. Differentiable."""
    shift_u, shift_j = _shift(near_u, far_u)[0], _shift(near_j, far_j)[0]
    unit = jnp.ones_like(behind)
    between = through_layer(behind, far_u + shift_u, far_j + shift_j, unit)
    return through_layer(between, near_u - shift_u, near_j - shift_j, unit)


def panel_weights(near_u: Array, far_u: Array) -> tuple[Array, Array]:
    """Shares of the emissions at both points of a panel in the radiance in front of it.

    As of `front_of_panel`, where emissions at both points are not so different that it holds back.
    """
    shift = _shift(near_u, far_u)[0]
    near, far = phi1(near_u - shift), jnp.exp(shift - near_u) * phi1(far_u + shift)
    x = _EXTRAPOLATE
    return (1 + x) * near - x * far, (1 + x) * far - x * near


def _factors(behind: Array, near_u: Array, far_u: Array, near_j: Array, far_j: Array) -> tuple[Array, Array, list]:
    """The radiance in front of a panel, and its derivatives by that behind and by each of the other arguments.

    A layer has dR' = exp(-u) dR + phi1 dj - (exp(-u) R + thinning j) du, with phi1 = exp(-u) + u thinning.
    """
    shift_u, by_near_u, by_far_u = _shift(near_u, far_u)
    shift_j, by_near_j, by_far_j = _shift(near_j, far_j)

    def layer(behind: Array, u: Array, j: Array) -> tuple[Array, Array, Array, Array]:
        kept, bend = jnp.exp(-u), thinning(u)
        mean = kept + u * bend
        return kept * behind + mean * j, kept, mean, -(kept * behind + bend * j)

    between, far_kept, far_mean, far_slope = layer(behind, far_u + shift_u, far_j + shift_j)
    front, kept, mean, slope = layer(between, near_u - shift_u, near_j - shift_j)
    far_mean, far_slope = kept * far_mean, kept * far_slope
    by_u = slope + (far_slope - slope) * by_near_u, far_slope + (far_slope - slope) * by_far_u
    by_j = mean + (far_mean - mean) * by_near_j, far_mean + (far_mean - mean) * by_far_j
    return front, kept * far_kept, [*by_u, *by_j]


def _shift(near: Array, far: Array) -> tuple[Array, Array, Array]:
    """By how much A1 is less than `near` and A2 more than `far`, and the derivatives of that by both.

    It is x (far - near), times 2 q / (1 + q^2) with the ratio q <= 1 of the two, so that neither layer is negative.
    """
    large = jnp.maximum(near, far)
    there = large > _DARK
    ratio = jnp.where(there, jnp.minimum(near, far) / jnp.where(there, large, 1), 0)
    inverse = jnp.where(there, 2 / (1 + ratio * ratio), 0)
    alike = inverse * ratio
    a, b = jnp.where(near < far, ratio, 1), jnp.where(near < far, 1, ratio)
    steep = alike * (b - a)
    by_near, by_far = inverse * (b * (b - 2 * a) - a * steep), inverse * (a * (2 * b - a) - b * steep)
    return _EXTRAPOLATE * alike * (far - near), _EXTRAPOLATE * by_near, _EXTRAPOLATE * by_far


def at_both(table: Float[Array, "knot node"], fraction: Float[Array, "2 ray"]) -> Float[Array, "both node"]:
    """A table at both points of a panel, those of the first before those of the second: half the operations."""
    return between_knots(table, fraction.reshape(-1))


def both(value: Float[Array, "2 ray"]) -> Float[Array, "both 1"]:
    """What rays have at both points, as `at_both` has it."""
    return value.reshape(-1)[:, None]


def between_knots(table: Float[Array, "knot node"], fraction: Float[Array, " ray"]) -> Float[Array, "ray node"]:
    """A table over the exhaust fraction, linear between knots."""
    low, high, part = _neighbours(table, fraction)
    return low + part * (high - low)


def _slope(table: Float[Array, "knot node"], fraction: Float[Array, " ray"]) -> Float[Array, "ray node"]:
    """The derivative of a table by the exhaust fraction."""
    low, high, _ = _neighbours(table, fraction)
    return KNOTS * (high - low)


def _neighbours(table: Float[Array, "knot node"], fraction: Float[Array, " ray"]) -> tuple[Array, Array, Array]:
    """The values of a table at the knots below and above [ray, node], and where between them [ray, 1]."""
    place = fraction * KNOTS
    knot = jnp.clip(place.astype(jnp.int32), 0, KNOTS - 1)
    low, high = (table.at[k].get(**INSIDE) for k in (knot, knot + 1))
    return low, high, (place - knot.astype(place.dtype))[:, None]
