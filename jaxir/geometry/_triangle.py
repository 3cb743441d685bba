"""The differentiable record of a hit."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from jaxir._math import INSIDE, on_platform
from jaxir.geometry._loops import in_blocks, varying


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


_BLOCK = 1024  # rays whose intermediate values stay in the processor's cache; a block of misses costs nothing


@jax.custom_jvp
def reattach(
    vertices: Float[Array, "vertex 3"],
    faces: Int[Array, "face 3"],
    face: Int[Array, " ray"],
    origin: Float[Array, "ray 3"],
    direction: Float[Array, "ray 3"],
) -> tuple[Float[Array, " ray"], Float[Array, "ray 3"], Float[Array, "ray 3"], Float[Array, "ray 3"]]:
    """t, barycentrics, point and normal of known hits as smooth functions of the rays and the vertices.

    With e1, e2 the edges from the first corner, n = e1 x e2 and s = origin - corner,
    t = -(s . n) / (d . n), b1 = (e2 . (s x d)) / -(d . n), b2 = -(e1 . (s x d)) / -(d . n). A face within whose plane
    the ray runs, by rounding, is said to be met at its centroid.

    Args:
        vertices: [vertex, 3] [m].
        faces: [face, 3].
        face: the face that each ray meets, -1 on a miss [ray].
        origin: [ray, 3] [m].
        direction: unit [ray, 3].

    Returns:
        t [ray] [m] (inf on a miss), barycentric [ray, 3], point [ray, 3] [m], normal [ray, 3].

    Differentiable in vertices, origin, direction with zero derivatives on a miss; that the face is met at all
    (silhouettes, shadow edges) has no derivative here.
    """
    return on_platform(vertices, faces, face, origin, direction, cpu=_by_blocks, default=_at_once)


@reattach.defjvp
def _reattach_jvp(primals: tuple[Array, ...], tangents: tuple[Any, ...]) -> tuple[Any, Any]:
    # not through the loop over blocks, whose transpose would add up a gradient of the whole mesh in every block
    vertices, faces, face, origin, direction = primals
    moving = (vertices, origin, direction)
    return jax.jvp(lambda v, o, d: _at_once(v, faces, face, o, d), moving, (tangents[0], *tangents[3:]))


def _by_blocks(vertices: Array, faces: Array, face: Array, origin: Array, direction: Array) -> tuple[Array, ...]:
    count = face.shape[0]
    size = min(_BLOCK, max(count, 1))
    rays = [in_blocks(x, size) for x in (face, origin, direction)]

    def one(block: list[Array]) -> tuple[Array, ...]:
        face, origin, direction = block

        def missed() -> tuple[Array, ...]:
            hit = no_hit(origin)
            return varying((hit.t, hit.barycentric, hit.point, hit.normal), face)

        return lax.cond(jnp.any(face >= 0), lambda: _at_once(vertices, faces, face, origin, direction), missed)

    out = lax.map(one, rays)
    return tuple(x.reshape(-1, *x.shape[2:])[:count] for x in out)


def _at_once(vertices: Array, faces: Array, face: Array, origin: Array, direction: Array) -> tuple[Array, ...]:
    o, d = ([x[:, k] for k in range(3)] for x in (origin, direction))
    t, *vectors = _record(face, corners_of(vertices, faces, face), o, d)
    return t, *(jnp.stack(v).T for v in vectors)


# Vectors as lists of components, and flat gathers: XLA's CPU loops over a last axis of length 3 are slow.


def corners_of(
    vertices: Float[Array, "vertex 3"], faces: Int[Array, "face 3"], face: Int[Array, " ray"]
) -> list[list[Float[Array, " ray"]]]:
    """Coordinate k of corner i of each face, as [i][k]; of face 0 where `face` is -1."""
    near, number = jnp.maximum(face, 0) * 3, vertices.reshape(-1)
    first = [faces.reshape(-1).at[near + i].get(**INSIDE) * 3 for i in range(3)]
    return [[number.at[at + k].get(**INSIDE) for k in range(3)] for at in first]


def unit_normal(corners: list[list[Array]]) -> list[Array]:
    """Unit normals of faces given by `corners_of`; 0 for a face without area."""
    a, b, c = corners
    return _unit(_cross(_minus(b, a), _minus(c, a)))


def _record(
    face: Array, corners: list[list[Array]], start: list[Array], along: list[Array]
) -> tuple[Array, list[Array], list[Array], list[Array]]:
    """`reattach`, elementwise over vectors as lists of components."""
    a, b, c = corners
    e1, e2, s = _minus(b, a), _minus(c, a), _minus(start, a)
    n = _cross(e1, e2)
    size, slope = dot(n, n), -dot(along, n)
    met = face >= 0
    solid = met & (size > 0)
    hit = solid & (slope != 0)
    inverse = 1 / jnp.where(hit, slope, 1)
    moment = _cross(s, along)
    centroid = [x + (y + z) / 3 for x, y, z in zip(a, e1, e2, strict=True)]
    t = jnp.where(hit, dot(s, n) * inverse, jnp.where(met, dot(_minus(centroid, start), along), 0))
    third = jnp.where(met, jnp.full_like(t, 1 / 3), 0)
    b1 = jnp.where(hit, dot(e2, moment) * inverse, third)
    b2 = jnp.where(hit, -dot(e1, moment) * inverse, third)
    normal = [jnp.where(solid, x, 0) for x in _unit(n)]
    point = [x + t * y for x, y in zip(start, along, strict=True)]
    return jnp.where(met, t, jnp.inf), [jnp.where(met, 1 - b1 - b2, 0), b1, b2], point, normal


def _unit(vector: list[Array]) -> list[Array]:
    """Vectors of length 1 along vectors, or 0; first brought to about that size, as derivatives ask whose cube is."""
    largest = jnp.maximum(jnp.maximum(jnp.abs(vector[0]), jnp.abs(vector[1])), jnp.abs(vector[2]))
    there = largest > 4 * jnp.finfo(largest.dtype).tiny
    grow = lax.stop_gradient(1 / jnp.where(there, largest, 1))
    near = [jnp.where(there, x, 0) * grow for x in vector]
    shrink = lax.rsqrt(jnp.where(there, dot(near, near), 1))
    return [x * shrink for x in near]


def _minus(a: list[Array], b: list[Array]) -> list[Array]:
    return [x - y for x, y in zip(a, b, strict=True)]


def dot(a: list[Array], b: list[Array]) -> Array:
    """Inner product of vectors given as lists of components."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: list[Array], b: list[Array]) -> list[Array]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def no_hit(origin: Float[Array, "ray 3"]) -> Hit:
    """The record of rays [ray, 3] that meet nothing."""
    none = jnp.zeros_like(origin)
    count = origin.shape[0]
    miss = jnp.full(count, -1, jnp.int32)
    return Hit(miss, jnp.full(count, jnp.inf, origin.dtype), barycentric=none, point=origin, normal=none)
