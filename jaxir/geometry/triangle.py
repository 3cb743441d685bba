"""The differentiable record of a hit."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int


class Hit(eqx.Module):
    """Where rays meet a mesh, differentiable in vertices and rays; all fields are finite on a miss except t.

    Attributes:
        face: index of the face, -1 on a miss [ray].
        t: distance [ray] [m]; inf on a miss.
        barycentric: weights of the face's three vertices [ray, 3]; 0 on a miss.
        point: [ray, 3] [m]; the ray's origin on a miss.
        normal: unit geometric normal by the order of the vertices [ray, 3]; 0 on a miss.
    """

    face: Int[Array, " ray"]
    t: Float[Array, " ray"]
    barycentric: Float[Array, "ray 3"]
    point: Float[Array, "ray 3"]
    normal: Float[Array, "ray 3"]


def reattach(
    face: Int[Array, ""],
    corners: Float[Array, "3 3"],
    origin: Float[Array, " 3"],
    direction: Float[Array, " 3"],
) -> tuple[Int[Array, ""], Float[Array, ""], Float[Array, " 3"], Float[Array, " 3"], Float[Array, " 3"]]:
    """t, barycentrics, point and normal of a known hit as smooth functions of the ray and the vertices.

    With e1, e2 the edges from the first corner, n = e1 x e2 and s = origin - corner,
    t = -(s . n) / (d . n), b1 = (e2 . (s x d)) / -(d . n), b2 = -(e1 . (s x d)) / -(d . n).

    Args:
        face: the face, -1 on a miss.
        corners: its vertices [corner, 3] [m].
        origin: [3] [m].
        direction: [3], unit.

    Returns:
        face (-1 also where the ray runs within the face's plane), t [m] (inf on a miss), barycentric [3], point [3]
        [m], normal [3].

    Differentiable in corners, origin, direction with zero derivatives on a miss; that the face is met at all
    (silhouettes, shadow edges) has no derivative here.
    """
    a, b, c = ([corners[i, k] for k in range(3)] for i in range(3))
    start, along = [origin[k] for k in range(3)], [direction[k] for k in range(3)]
    e1, e2, s = _minus(b, a), _minus(c, a), _minus(start, a)
    n = _cross(e1, e2)
    size, slope = _dot(n, n), -_dot(along, n)
    hit = (face >= 0) & (size > 0) & (slope != 0)
    inverse = 1 / jnp.where(hit, slope, 1)
    moment = _cross(s, along)
    t = jnp.where(hit, _dot(s, n) * inverse, 0)
    b1 = jnp.where(hit, _dot(e2, moment) * inverse, 0)
    b2 = jnp.where(hit, -_dot(e1, moment) * inverse, 0)
    barycentric = jnp.stack([jnp.where(hit, 1 - b1 - b2, 0), b1, b2])
    shrink = lax.rsqrt(jnp.where(hit, size, 1))
    normal = jnp.stack([jnp.where(hit, x * shrink, 0) for x in n])
    point = jnp.stack([x + t * y for x, y in zip(start, along, strict=True)])
    return jnp.where(hit, face, -1), jnp.where(hit, t, jnp.inf), barycentric, point, normal


# Vectors as lists of scalars: XLA's CPU loops over a last axis of length 3 are slow.


def _minus(a: list[Array], b: list[Array]) -> list[Array]:
    return [x - y for x, y in zip(a, b, strict=True)]


def _dot(a: list[Array], b: list[Array]) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: list[Array], b: list[Array]) -> list[Array]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
