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
from jaxir.geometry._camera import Camera, Grading, camera_around, view_frame

BINS = 512  # in which brightness is collected along an axis of the image
STANDS_OUT = 0.02  # difference of variances along two axes, over their sum, from which one of them stands out
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
    roll = _roll(camera_around(frame, extent, shape, distance), brightness)
    u, v, w = frame
    rolled = jnp.stack([jnp.cos(roll) * u + jnp.sin(roll) * v, jnp.cos(roll) * v - jnp.sin(roll) * u, w])
    camera = camera_around(rolled, extent, shape, distance)
    low, high, weight = _seen(camera, brightness)
    rows, columns = camera.shape
    size = camera.pixel * as_float(np.array([columns, rows]))
    # Rows are counted downwards.
    across = _edges(low[:, 0] / size[0] + 0.5, high[:, 0] / size[0] + 0.5, weight, columns)
    down = _edges(0.5 - high[:, 1] / size[1], 0.5 - low[:, 1] / size[1], weight, rows)
    return eqx.tree_at(lambda c: c.grading, camera, Grading(across, down), is_leaf=lambda x: x is None)


def _roll(camera: Camera, brightness: Brightness) -> Float[Array, ""]:
    """Angle from the image's u to the axis along which brightness is spread most; 0 where no axis stands out.

    A simplex of k corners about its centre c has the second moment (sum of corner corner' + k^2 c c') / (k (k + 1)).
    """
    weight = _seen(camera, brightness)[2]
    total = jnp.sum(weight)
    share = weight / jnp.where(total > 0, total, 1)
    middles, seconds = [], []
    for corners in (camera.project(brightness.corners), camera.project(brightness.ends)):
        count, middle = corners.shape[1], corners.mean(axis=1)
        square = jnp.einsum("nki,nkj->nij", corners, corners)
        around = count**2 * middle[:, :, None] * middle[:, None, :]
        seconds.append((square + around) / (count * (count + 1)))
        middles.append(middle)
    mean = share @ jnp.concatenate(middles)
    spread = jnp.einsum("n,nij->ij", share, jnp.concatenate(seconds)) - mean[:, None] * mean[None, :]
    difference, twice = spread[0, 0] - spread[1, 1], 2 * spread[0, 1]
    stands_out = jnp.hypot(difference, twice) > STANDS_OUT * (spread[0, 0] + spread[1, 1])
    return jnp.where(stands_out, jnp.arctan2(twice, difference) / 2, 0)


def _seen(camera: Camera, brightness: Brightness) -> tuple[Array, Array, Array]:
    """Lower and upper corner of the outline of every part [part, 2], and its intensity [part]."""
    corners, ends = camera.project(brightness.corners), camera.project(brightness.ends)
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = jnp.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / 2
    low = jnp.concatenate([corners.min(axis=1), ends.min(axis=1) - brightness.radius[:, None]])
    high = jnp.concatenate([corners.max(axis=1), ends.max(axis=1) + brightness.radius[:, None]])
    return low, high, jnp.concatenate([brightness.radiance * area, brightness.intensity])


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
