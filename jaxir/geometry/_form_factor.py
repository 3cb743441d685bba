"""Closed forms: how much of a receiver's view a disc or a polygon fills, weighted by the cosine.

A uniform diffuse source of radiance L gives a surface the irradiance pi F L; F is the form factor of the source seen
from a point of the receiver. The vector form factor V has F = V . normal for every receiver that has the whole source
above its horizon.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxir._arrays import as_one_program
from jaxir._math import dot, safe_sqrt
from jaxir.geometry._sampling import polygon_vector


@as_one_program
def disc_vector(
    point: Float[Array, " 3"], centre: Float[Array, " 3"], normal: Float[Array, " 3"], radius: Float[Array, ""]
) -> Float[Array, " 3"]:
    """Vector form factor of a disc that emits on the side of its normal; 0 behind it.

    With h the height of the point above the disc's plane, a its distance from the axis, S = h^2 + a^2 + r^2 and
    D^2 = ((a - r)^2 + h^2)((a + r)^2 + h^2) = (a^2 - r^2)^2 + h^2 (2 a^2 + 2 r^2 + h^2),

        along the axis  1/2 [1 - (h^2 + a^2 - r^2) / D] = 2 r^2 h^2 / (D (D + h^2 + a^2 - r^2)),
        across it       (h / 2a) [S / D - 1]           = 2 r^2 h a / (D (D + S)),

    (Howell, "A catalog of radiation heat transfer configuration factors", B-12 and B-13), in the second forms because
    the first lose their digits for small discs and on the axis.

    Args:
        point: of the receiver [3] [m].
        centre: of the disc [3] [m].
        normal: unit normal of the emitting side [3].
        radius: r [m].

    Returns:
        V [3], pointing from the receiver to the disc.

    Differentiable in all four, off the disc's rim.
    """
    offset = point - centre
    h = dot(offset, normal)
    radial = offset - h * normal
    square = dot(radial, radial)
    product = (square - radius * radius) ** 2 + h * h * (2 * square + 2 * radius * radius + h * h)
    lit = (h > 0) & (product > 0)
    d = jnp.sqrt(jnp.where(lit, product, 1))
    excess = (h * h + square) - radius * radius
    far = excess >= 0
    small = 2 * (radius * h) ** 2 / (d * jnp.where(far & lit, d + excess, 1))
    along = jnp.where(far, small, (1 - excess / d) / 2)
    across = 2 * radius * radius * h / (d * (d + h * h + square + radius * radius))  # of a unit offset
    return jnp.where(lit, -along * normal - across * radial, 0)


def disc_above(
    point: Float[Array, " 3"],
    receiver: Float[Array, " 3"],
    centre: Float[Array, " 3"],
    normal: Float[Array, " 3"],
    radius: Float[Array, ""],
) -> Bool[Array, ""]:
    """Whether the whole disc lies above the horizon of a receiver at `point` with unit normal `receiver`."""
    cos = dot(receiver, normal)
    square = (1 - cos) * (1 + cos)
    sine = safe_sqrt(square)
    return dot(centre - point, receiver) >= radius * sine


@as_one_program
def polygon_form_factor(
    point: Float[Array, " 3"], receiver: Float[Array, " 3"], corners: Float[Array, "corner 3"]
) -> Float[Array, ""]:
    """Form factor of a convex plane polygon, the part below the receiver's horizon cut off.

    Lambert's formula, F = 1 / (2 pi) sum_k angle_k unit(v_k x v_k+1) . n over the edges seen from the point; an edge
    that dips below the horizon is shortened, and the cut is closed along the horizon.

    Args:
        point: of the receiver [3] [m].
        receiver: its unit normal [3].
        corners: counterclockwise seen from the emitting side [corner, 3] [m].

    Returns:
        F in [0, 1]; 0 for a point behind the polygon or in its plane.

    Differentiable in all three, apart from corners in the horizon and points on an edge.
    """

    def add(sums: tuple[Array, Array, Array], edge: tuple[Array, Array]) -> tuple[tuple[Array, Array, Array], None]:
        total, exit_point, entry_point = sums
        begin, end = edge[0] - point, edge[1] - point
        h0, h1 = dot(begin, receiver), dot(end, receiver)
        crosses = (h0 > 0) != (h1 > 0)
        part = jnp.where(crosses, h0 / jnp.where(crosses, h0 - h1, 1), 0)
        cut = begin + part * (end - begin)
        own = _edge(jnp.where(h0 > 0, begin, cut), jnp.where(h1 > 0, end, cut), receiver)
        total = total + jnp.where((h0 > 0) | (h1 > 0), own, 0)
        leaving, entering = (jnp.where(crosses & (h > 0), cut, 0) for h in (h0, h1))
        return (total, exit_point + leaving, entry_point + entering), None

    none = jnp.zeros((), point.dtype), jnp.zeros_like(point), jnp.zeros_like(point)
    (total, leaves, enters), _ = lax.scan(add, none, (corners, jnp.roll(corners, -1, axis=0)))
    total = total + _edge(leaves, enters, receiver)  # along the horizon
    return jnp.where(dot(polygon_vector(corners), corners[0] - point) < 0, jnp.maximum(-total, 0) / (2 * jnp.pi), 0)


def _edge(begin: Float[Array, " 3"], end: Float[Array, " 3"], receiver: Float[Array, " 3"]) -> Float[Array, ""]:
    """Angle of an edge times the unit normal of its plane along the receiver's; 0 for one that is seen end on."""
    cross = jnp.cross(begin, end)
    square = dot(cross, cross)
    seen = square > 0
    sine = jnp.sqrt(jnp.where(seen, square, 1))
    angle = jnp.arctan2(sine, jnp.where(seen, dot(begin, end), 1))
    return jnp.where(seen, angle / sine * dot(cross, receiver), 0)
