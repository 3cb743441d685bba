"""Rasters whose pixels are small where a scene shines: what makes a radiant intensity cost few rays.

The intensity of a view is an integral over the image plane, and its rays are best spent where the integrand is. The
edges of columns and of rows are placed at equal shares of a density, half of it even over the image and half the
brightness of the scene projected on the axis, after the image has been rolled so that the brightness is uncorrelated in
its two axes. The pixels' areas are their weights, so that whatever the brightness, expectations stay what they are.
"""

from __future__ import annotations

import dataclasses
from functools import partial, reduce
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxir._arrays import as_float, on_host, placed
from jaxir._math import matmul
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


class _Outlines(NamedTuple):
    """Parts as a camera sees them: all as simplices of three corners, a capsule's third is its first again.

    Attributes:
        x, y: of the corners [corner][part] [m].
        corners: how many of them count [part].
        radius: about them [part] [m].
        weight: intensity [part].
    """

    x: list[Array]
    y: list[Array]
    corners: Array
    radius: Array
    weight: Array

    def moved(self, cos: Float[Array, ""], sin: Float[Array, ""], shift: Float[Array, " 2"]) -> _Outlines:
        """Turned and shifted in the image plane."""
        each = list(zip(self.x, self.y, strict=True))
        return self._replace(
            x=[cos * x + sin * y + shift[0] for x, y in each], y=[cos * y - sin * x + shift[1] for x, y in each]
        )

    def box(self) -> tuple[Array, Array]:
        """Lower and upper edges along both axes [axis, part]."""
        low, high = (
            jnp.stack([reduce(least, axis) for axis in (self.x, self.y)]) for least in (jnp.minimum, jnp.maximum)
        )
        return low - self.radius[None], high + self.radius[None]


def rolled_camera(
    azimuth: Any,
    elevation: Any,
    extent: Float[Array, "corner 3"],
    brightness: Brightness,
    distance: Any = np.inf,
) -> tuple[Camera, Float[Array, "2 edge"]]:
    """A camera as `fitted_camera`, of one pixel, rolled for the brightness of what it sees; without derivatives.

    And shares of the density up to edges of `BINS` equal bins, of columns and of rows: what `graded` makes rasters of.
    """
    extent, brightness = lax.stop_gradient((extent, brightness))
    frame = view_frame(azimuth, elevation)
    upright = camera_around(frame, extent, (1, 1), distance)
    parts = _seen(upright, brightness)
    roll, (u, v, w) = _roll(parts), frame
    cos, sin = jnp.cos(roll), jnp.sin(roll)
    camera = camera_around(jnp.stack([cos * u + sin * v, cos * v - sin * u, w]), extent, (1, 1), distance)
    # parts are seen as before, turned; an eye at infinity may look at another point
    low, high = parts.moved(cos, sin, matmul(camera.frame[:2], upright.target - camera.target)).box()
    low, high = (side / camera.pixel[:, None] + 0.5 for side in (low, high))
    # rows are counted downwards
    return camera, _upto(jnp.stack([low[0], 1 - high[1]]), jnp.stack([high[0], 1 - low[1]]), parts.weight)


def graded(cameras: Camera, upto: Float[Array, "view 2 edge"], shape: tuple[int, int]) -> Camera:
    """Stacked cameras [view] of `rolled_camera`, of so many rows and columns; by numpy where all is known."""
    xp, shares, size = on_host(upto, cameras.pixel)
    bins, counts = np.linspace(0, 1, BINS + 1).astype(shares.dtype), np.array(shape[::-1])

    def edges(own: Any, count: int) -> Any:
        inner = xp.interp((np.arange(1, count) / count).astype(own.dtype), own / own[-1], bins)
        return xp.concatenate([bins[:1], inner.astype(own.dtype), bins[-1:]])

    def of_views(own: Any, count: int) -> Any:
        every = partial(edges, count=count)
        return np.stack(list(map(every, own))) if xp is np else jax.vmap(every)(own)

    each = [of_views(shares[:, axis], count) for axis, count in enumerate(counts.tolist())]

    def divided(camera: Camera, pixel: Array, *grading: Array) -> Camera:
        return dataclasses.replace(camera, pixel=pixel, shape=shape, grading=Grading(*grading))

    return jax.vmap(divided)(cameras, *map(placed, (size / counts[None].astype(size.dtype), *each)))


def _seen(camera: Camera, brightness: Brightness) -> _Outlines:
    """Every part as a camera sees it."""
    triangles, capsules = brightness.radiance.shape[0], brightness.intensity.shape[0]
    corners = jnp.concatenate([brightness.corners, brightness.ends[:, np.array([0, 1, 0])]])
    flat = camera.project(jnp.swapaxes(corners, 0, 1).reshape(-1, 3))
    x, y = (list(flat[:, axis].reshape(3, -1)) for axis in (0, 1))
    area = jnp.abs((x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])) / 2
    return _Outlines(
        x,
        y,
        as_float(np.repeat([3.0, 2.0], [triangles, capsules])),
        jnp.concatenate([jnp.zeros(triangles, area.dtype), brightness.radius]),
        jnp.concatenate([brightness.radiance * area[:triangles], brightness.intensity]),
    )


def _roll(parts: _Outlines) -> Float[Array, ""]:
    """Angle from the image's u to the axis along which brightness is spread most; 0 where no axis stands out.

    A simplex of k corners about its centre c has the second moment (sum of corner corner' + k^2 c c') / (k (k + 1)).
    """
    total = jnp.sum(parts.weight)
    share = parts.weight / jnp.where(total > 0, total, 1)
    count, third = parts.corners, parts.corners - 2

    def summed(one: list[Array]) -> Array:
        return one[0] + one[1] + third * one[2]

    def centred(one: list[Array]) -> list[Array]:  # else all that is left of a small part aside is rounding
        mean = jnp.sum(share * summed(one) / count)
        return [corner - mean for corner in one]

    sides = centred(parts.x), centred(parts.y)

    def spread(i: int, j: int) -> Array:
        a, b = sides[i], sides[j]
        square = a[0] * b[0] + a[1] * b[1] + third * a[2] * b[2]
        return jnp.sum(share * (square + summed(a) * summed(b)) / (count * (count + 1)))

    along, across, twice = spread(0, 0), spread(1, 1), 2 * spread(0, 1)
    stands_out = jnp.hypot(along - across, twice) > STANDS_OUT * (along + across)
    return jnp.where(stands_out, jnp.arctan2(twice, along - across) / 2, 0)


def _upto(
    low: Float[Array, "2 part"], high: Float[Array, "2 part"], weight: Float[Array, " part"]
) -> Float[Array, "2 edge"]:
    """Shares of the density along two axes, up to edges of bins, of parts that are even over [low, high].

    A part's density steps up at `low` and down at `high`; each step is shared by the two bin edges beside it.
    """
    width = jnp.maximum(high - low, 1 / BINS)
    middle, step = (low + high) / 2, weight[None] / width
    place = jnp.clip(jnp.concatenate([middle - width / 2, middle + width / 2], axis=1), 0, 1) * BINS
    edge = jnp.minimum(jnp.floor(place), BINS - 1)
    step, part = jnp.concatenate([step, -step], axis=1), place - edge
    bin = edge.astype(jnp.int32) + np.array([[0], [BINS + 1]], np.int32)
    steps = jnp.zeros(2 * (BINS + 1), place.dtype)
    both = jnp.stack([bin, bin + 1]).reshape(-1), jnp.stack([step * (1 - part), step * part]).reshape(-1)
    steps = steps.at[both[0]].add(both[1]).reshape(2, -1)
    density = jnp.maximum(jnp.cumsum(steps, axis=1)[:, :-1], 0)
    total = jnp.sum(density, axis=1, keepdims=True)
    share = EVEN / BINS + (1 - EVEN) * jnp.where(total > 0, density / jnp.where(total > 0, total, 1), 1 / BINS)
    return jnp.pad(jnp.cumsum(share, axis=1), ((0, 0), (1, 0)))
