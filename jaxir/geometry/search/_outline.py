"""Boxes around the parts of a body: what can be said of where it is seen before any ray is traced.

An outline is a table with sixteen boxes to a row, lower x, y, z, then upper x, y, z, as a search tree holds them; an
empty box is a far point.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxir._math import dot, radius_about
from jaxir.geometry import Camera
from jaxir.geometry.search._bundles import extents, project_boxes, travel_of
from jaxir.geometry.search._tree import FAR, WIDTH

MARGIN = 1.001  # of a sphere, so that what it holds lies inside it
NEAREST = 0.999  # share of the eye's distance within which boxes are projected without losing digits


def outline(low: Float[Array, "box 3"], high: Float[Array, "box 3"]) -> Float[Array, "row 96"]:
    """The outline of boxes given by their lower and upper corners [m]."""
    pad = ((0, -low.shape[0] % WIDTH), (0, 0))
    sides = [jnp.pad(side, pad, constant_values=FAR).reshape(-1, WIDTH, 3).transpose(0, 2, 1) for side in (low, high)]
    return jnp.concatenate(sides, axis=1).reshape(-1, 6 * WIDTH)


def front_of(
    boxes: Float[Array, "row 96"], direction: Float[Array, " 3"], origin: Float[Array, " 3"]
) -> Float[Array, ""]:
    """Distance from `origin` along a unit vector that no box exceeds [m]."""
    nearest, _, empty = extents(boxes, -direction[None], dot(direction, origin)[None])
    return -jnp.min(jnp.where(empty, FAR, nearest))


def clear_of(boxes: Float[Array, "row 96"], points: Float[Array, "point 3"], camera: Camera) -> Float[Array, ""]:
    """Height above a camera's target plane at which rays start before a body [m].

    Before the boxes, so that rays are searched together (see `closest_hit`); where these reach the eye, on a sphere
    about the target that holds `points`, whose hull holds the body.
    """
    sides = boxes.reshape(-1, 2, 3, WIDTH)
    reach = jnp.max(jnp.where(sides < FAR / 2, jnp.abs(sides - camera.target[None, None, :, None]), 0))
    start = front_of(boxes, camera.frame[2], camera.target) + 1e-3 * reach
    return lax.cond(
        start * camera.inverse_range < 1, lambda: start, lambda: MARGIN * radius_about(points, camera.target)
    )


def may_see(boxes: Float[Array, "row 96"], camera: Camera, edges: Float[Array, "tile 2 17"]) -> Bool[Array, " tile"]:
    """Whether tiles of `Camera.tile_edges` may see what lies in the boxes; all of them where a box is at the eye."""
    before = front_of(boxes, camera.frame[2], camera.target) * camera.inverse_range < NEAREST
    travel = travel_of(camera.frame)
    seen = project_boxes(boxes, travel, dot(travel, -camera.target[None]), camera.inverse_range)
    left, right, bottom, top = (seen[None, :, k * WIDTH : (k + 1) * WIDTH] for k in range(4))
    ends = edges[..., 0], edges[..., -1]
    begin, end = (side.T[:, :, None, None] for side in (jnp.minimum(*ends), jnp.maximum(*ends)))
    some = jnp.any((left <= end[0]) & (right >= begin[0]) & (bottom <= end[1]) & (top >= begin[1]), axis=(1, 2))
    return some | ~before
