"""One ray against one triangle, watertight, and the differentiable record of a hit.

The test is that of Woop, Benthin and Wald, "Watertight ray/triangle intersection" (JCGT 2(1), 2013): vertices are
carried into a frame in which the ray is the z axis, so neighbours see the same two projected points of a shared edge,
and the edge functions a.x b.y - a.y b.x are compared with their own rounding bound, in place of the paper's double
precision fallback (a compiler may fuse one product into the subtraction, after which the sign of a tie is arbitrary).
"""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

EDGE_ROUNDING = 2.0  # units of the last place of the products by which an edge function may miss its sign


def ray_frame(direction: Float[Array, " 3"]) -> Float[Array, "3 3"]:
    """Rows x', y', z' of a shear that carries `direction` to (0, 0, 1).

    The largest component of `direction` becomes z'; multiply [point - origin] by the rows to get (x, y, t).
    """
    axis = jnp.argmax(jnp.abs(direction))
    eye = jnp.eye(3, dtype=direction.dtype)
    third, first, second = (eye[(axis + k) % 3] for k in range(3))
    scale = 1 / direction[axis]
    depth = third * scale
    return jnp.stack([first - direction[(axis + 1) % 3] * depth, second - direction[(axis + 2) % 3] * depth, depth])


def ray_triangle(frame: Float[Array, "3 3"], corners: Float[Array, "3 3"]) -> tuple[Bool[Array, ""], Float[Array, ""]]:
    """Whether a ray meets a triangle, and where.

    Args:
        frame: `ray_frame` of the ray's direction.
        corners: vertices minus the ray's origin [corner, 3] [m].

    Returns:
        (inside, t): whether the line of the ray passes through the triangle, edges and vertices included, and the
        distance t [m] (any sign; only meaningful when inside). A triangle of zero projected area is never met.

    Not differentiable: see `reattach`.
    """
    x, y, t = (jnp.sum(corners * frame[k][None, :], axis=-1) for k in range(3))
    rounding = EDGE_ROUNDING * jnp.finfo(x.dtype).eps
    weights, slack = [], []
    for i, j in ((1, 2), (2, 0), (0, 1)):
        left, right = x[i] * y[j], y[i] * x[j]
        weights.append(left - right)
        slack.append(rounding * (jnp.abs(left) + jnp.abs(right)))
    edge, tolerance = jnp.stack(weights), jnp.stack(slack)
    area = jnp.sum(edge)
    inside = (jnp.all(edge >= -tolerance) | jnp.all(edge <= tolerance)) & (area != 0)
    return inside, jnp.sum(edge * t) / jnp.where(area != 0, area, 1)


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
) -> tuple[Float[Array, ""], Float[Array, " 3"], Float[Array, " 3"], Float[Array, " 3"]]:
    """t, barycentrics, point and normal of a known hit as smooth functions of the ray and the vertices.

    With e1, e2 the edges from the first corner, n = e1 x e2 and s = origin - corner,
    t = -(s . n) / (d . n), b1 = (e2 . (s x d)) / -(d . n), b2 = -(e1 . (s x d)) / -(d . n).

    Args:
        face: the face, -1 on a miss.
        corners: its vertices [corner, 3] [m].
        origin: [3] [m].
        direction: [3], unit.

    Returns:
        t [m] (inf on a miss), barycentric [3], point [3] [m], normal [3].

    Differentiable in corners, origin, direction with zero derivatives on a miss; that the face is met at all
    (silhouettes, shadow edges) has no derivative here.
    """
    e1, e2, s = corners[1] - corners[0], corners[2] - corners[0], origin - corners[0]
    n = jnp.cross(e1, e2)
    size = jnp.sum(n * n)
    slope = -jnp.sum(direction * n)
    hit = (face >= 0) & (size > 0) & (slope != 0)
    inverse = 1 / jnp.where(hit, slope, 1)
    moment = jnp.cross(s, direction)
    t = jnp.where(hit, jnp.sum(s * n) * inverse, 0)
    b1 = jnp.where(hit, jnp.sum(e2 * moment) * inverse, 0)
    b2 = jnp.where(hit, -jnp.sum(e1 * moment) * inverse, 0)
    barycentric = jnp.stack([jnp.where(hit, 1 - b1 - b2, 0), b1, b2])
    normal = jnp.where(hit, n * lax.rsqrt(jnp.where(hit, size, 1)), 0)
    return jnp.where(face >= 0, t, jnp.inf), barycentric, origin + t * direction, normal
