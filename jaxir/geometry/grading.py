"""Rasters whose pixels are small where a scene shines: what makes a radiant intensity cost few rays.

The intensity of a view is an integral over the image plane, and its rays are best spent where the integrand is. The
edges of columns and of rows are placed at equal shares of a density, half of it even over the image and half the
brightness of the scene projected on the axis, after the image has been rolled so that the brightness is uncorrelated in
its two axes. The pixels' areas are their weights, so that whatever the brightness, expectations stay what they are.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxir._arrays import as_float
from jaxir.geometry.camera import Camera, Grading, camera_around, view_frame

BINS = 512  # in which brightness is collected along an axis of the image
EVEN = 0.5  # share of the density that is even over the image


class Brightness(eqx.Module):
    """Roughly what shines where, in any unit of intensity.

    Attributes:
        corners: of triangles [triangle, 3, 3] [m].
        radiance: of triangles, intensity per area seen [triangle] [m-2].
        ends: of the axes of capsules [capsule, 2, 3] [m].
        radius: of capsules [capsule] [m].
        intensity: of capsules [capsule].
    """

    corners: Float[Array, "triangle 3 3"]
    radiance: Float[Array, " triangle"]
    ends: Float[Array, "capsule 2 3"]
    radius: Float[Array, " capsule"]
    intensity: Float[Array, " capsule"]


def graded_camera(
    azimuth: Any,
    elevation: Any,
    extent: Float[Array, "corner 3"],
    brightness: Brightness,
    shape: tuple[int, int],
    distance: Any = np.inf,
) -> Camera:
    """A camera as `fitted_camera`, rolled and graded for the brightness of what it sees; without derivatives."""
    extent, brightness = lax.stop_gradient((extent, brightness))
    frame = view_frame(azimuth, elevation)
    _, _, middle, weight = _seen(camera_around(frame, extent, shape, distance), brightness)
    total = jnp.sum(weight)
    share = weight / jnp.where(total > 0, total, 1)
    offset = middle - jnp.sum(share[:, None] * middle, axis=0)[None]
    uu, vv, uv = (jnp.sum(share * offset[:, i] * offset[:, j]) for i, j in ((0, 0), (1, 1), (0, 1)))
    roll = jnp.arctan2(2 * uv, uu - vv) / 2
    u, v, w = frame
    rolled = jnp.stack([jnp.cos(roll) * u + jnp.sin(roll) * v, jnp.cos(roll) * v - jnp.sin(roll) * u, w])
    camera = camera_around(rolled, extent, shape, distance)
    low, high, _, weight = _seen(camera, brightness)
    rows, columns = camera.shape
    size = camera.pixel * as_float(np.array([columns, rows]))
    # Rows are counted downwards.
    across = _edges(low[:, 0] / size[0] + 0.5, high[:, 0] / size[0] + 0.5, weight, columns)
    down = _edges(0.5 - high[:, 1] / size[1], 0.5 - low[:, 1] / size[1], weight, rows)
    return eqx.tree_at(lambda c: c.grading, camera, Grading(across, down), is_leaf=lambda x: x is None)


def _seen(camera: Camera, brightness: Brightness) -> tuple[Array, Array, Array, Array]:
    """Lower and upper corner of the outline of every part [part, 2], its middle, and its intensity [part]."""
    corners, ends = camera.project(brightness.corners), camera.project(brightness.ends)
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = jnp.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / 2
    low = jnp.concatenate([corners.min(axis=1), ends.min(axis=1) - brightness.radius[:, None]])
    high = jnp.concatenate([corners.max(axis=1), ends.max(axis=1) + brightness.radius[:, None]])
    middle = jnp.concatenate([corners.mean(axis=1), ends.mean(axis=1)])
    return low, high, middle, jnp.concatenate([brightness.radiance * area, brightness.intensity])


def _edges(low: Array, high: Array, weight: Array, count: int) -> Float[Array, " edge"]:
    """Edges of `count` pixels in [0, 1] at equal shares of the density of parts that are even over [low, high].

    A part's density steps up at `low` and down at `high`; each step is shared by the two bin edges beside it.
    """
    width = jnp.maximum(high - low, 1 / BINS)
    step = weight / width

    def stepped(at: Array, step: Array) -> Array:
        place = jnp.clip(at, 0, 1) * BINS
        edge = jnp.minimum(jnp.floor(place), BINS - 1)
        bin, part = edge.astype(jnp.int32), place - edge
        steps = jnp.zeros(BINS + 1, place.dtype)
        return steps.at[bin].add(step * (1 - part)).at[bin + 1].add(step * part)

    middle = (low + high) / 2
    steps = stepped(middle - width / 2, step) - stepped(middle + width / 2, step)
    density = jnp.maximum(jnp.cumsum(steps)[:-1], 0)
    total = jnp.sum(density)
    share = EVEN / BINS + (1 - EVEN) * jnp.where(total > 0, density / jnp.where(total > 0, total, 1), 1 / BINS)
    upto = jnp.concatenate([jnp.zeros(1, share.dtype), jnp.cumsum(share)])
    edges = jnp.interp(as_float(np.linspace(0, 1, count + 1)), upto / upto[-1], as_float(np.linspace(0, 1, BINS + 1)))
    return edges.at[0].set(0).at[-1].set(1)
