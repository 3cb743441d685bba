"""Cameras: where the eye is, and which screen points belong to which pixel.

A camera is a projective map about a target point (see `Bundle`), so that 5 km and infinity are one code and the grain
of float32 is that of the target's size, not of the range. Pixels are delivered in square tiles, because neighbouring
rays traced together share their work.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Shaped

from jaxir._arrays import (
    Check,
    as_float,
    broadcast,
    enforce,
    finite,
    on_host,
    placed,
    positive,
    require,
    require_precision,
    require_shape,
)
from jaxir._fields import require_counts
from jaxir._math import dot, matmul, safe_sqrt
from jaxir._plausible import ELEVATION, usual
from jaxir.geometry._ray import Bundle

TILE = 16
_PIXELS = np.stack(np.divmod(np.arange(TILE * TILE), TILE), axis=-1)  # row and column of those of a tile
MARGIN = 1e-5  # beside what a camera is fitted to, of half the image, for rounding: rays that meet nothing hardly tell
_RADIAN = usual(1e-8, 0.2, "rad", above="is it in degrees, mrad or urad?")


class Grading(NamedTuple):
    """Edges of pixels as shares of the image, rising from 0 to 1: of columns from the left, of rows from the top."""

    columns: Float[Array, " column_edge"]
    rows: Float[Array, " row_edge"]


class Eye(NamedTuple):
    """Where a camera's rays meet: at a range along an axis from a target, or at infinity.

    Attributes:
        target: [3] [m].
        axis: from the target to the eye, unit length [3].
        inverse_range: 1 / range [m-1]; 0 at infinity.
    """

    target: Float[Array, " 3"]
    axis: Float[Array, " 3"]
    inverse_range: Float[Array, ""]

    def away(self, point: Float[Array, "point 3"]) -> Float[Array, "point 3"]:
        """From points to the eye, in units of its range; its axis where that is infinite. Differentiable."""
        return self.axis[None] - (point - self.target[None]) * self.inverse_range

    def toward(self, point: Float[Array, "point 3"]) -> Float[Array, "point 3"]:
        """Unit vectors from points to the eye. Differentiable."""
        away = self.away(point)
        return away / safe_sqrt(dot(away, away))[:, None]


class Camera(eqx.Module):
    """A pinhole at a range, or at infinity.

    Attributes:
        target: the point in the middle of the image [3] [m].
        frame: rows u (right in the image), v (up), w (from the target to the eye) [3, 3].
        inverse_range: 1 / range [m-1]; 0 for an orthographic camera.
        pixel: size of a pixel in the plane through the target [2] along u and v [m]; the mean size of graded ones.
        shape: rows and columns.
        grading: where pixels of unequal size lie; None for equal ones.
    """

    target: Float[Array, " 3"]
    frame: Float[Array, "3 3"]
    inverse_range: Float[Array, ""]
    pixel: Float[Array, " 2"]
    shape: tuple[int, int] = eqx.field(static=True)
    grading: Grading | None = None

    @property
    def eye(self) -> Eye:
        """Where all rays meet."""
        return Eye(self.target, self.frame[2], self.inverse_range)

    @property
    def tiles(self) -> tuple[int, int]:
        """Rows and columns of tiles that cover the image."""
        return -(-self.shape[0] // TILE), -(-self.shape[1] // TILE)

    def edges(self, axis: int, index: Int[np.ndarray, "*edge"]) -> Float[Any, "*edge"]:
        """Where edges between columns (axis 0) or rows (axis 1) are on the screen [*edge] [m]; of numpy if known.

        Column or row `index` begins there. Beyond the image's edge its raster goes on, or where it is graded ends.
        """
        count, turned = self.shape[1 - axis], (1, -1)[axis]
        if self.grading is None:
            _, pixel = on_host(self.pixel)
            return turned * ((index - count / 2).astype(pixel.dtype) * pixel[axis])
        _, share, pixel = on_host(self.grading[axis], self.pixel)
        return turned * ((share[np.minimum(index, count)] - 0.5) * (count * pixel[axis]))

    def tile_edges(self, tile: Int[np.ndarray, "*tile"] | None = None) -> Float[Any, "*tile 2 17"]:
        """Edges of the columns and of the rows of tiles on the screen [*tile, 2, 17] [m], see `edges`.

        Of all tiles, or by index, row by row.
        """
        first = self._first(tile)
        xp, *each = on_host(*(self.edges(axis, first[..., 1 - axis, None] + np.arange(TILE + 1)) for axis in (0, 1)))
        return xp.stack(each, axis=-2)

    def _first(self, tile: Int[np.ndarray, "*tile"] | None) -> Int[np.ndarray, "*tile 2"]:
        """Row and column of the first pixel of tiles."""
        tile = np.arange(self.tiles[0] * self.tiles[1]) if tile is None else tile
        return TILE * np.stack(np.divmod(tile, self.tiles[1]), axis=-1)

    def endless(self) -> Camera:
        """The same eye and frame for `tile_edges` of any image: what looks at them compiles once for all shapes."""
        return dataclasses.replace(self, shape=(0, 0), grading=None)

    def project(self, point: Float[Array, "*batch 3"]) -> Float[Array, "*batch 2"]:
        """Screen points of points of the scene [m]."""
        around = (None,) * (point.ndim - 1)
        local = dot((point - self.target[around])[..., None, :], self.frame[around])
        return local[..., :2] / (1 - local[..., 2:] * self.inverse_range)

    def undivided(self) -> Camera:
        """The same frame as one pixel: what looks at no pixels compiles once for images of all shapes."""
        xp, pixel = on_host(self.pixel)
        size = pixel * xp.asarray(self.shape[::-1], pixel.dtype)
        return Camera(self.target, self.frame, self.inverse_range, placed(size), (1, 1))

    def half_size(self) -> Float[Array, " 2"]:
        """Half the image's width and height on the screen [2] [m]."""
        return jnp.stack([self.shape[1] * self.pixel[0], self.shape[0] * self.pixel[1]]) / 2

    def slant(self, screen: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
        """1 + tan^2 of the angle from the axis to points of the screen [*batch, 2] [m]; 1 in an orthographic one."""
        return 1 + self.inverse_range**2 * jnp.sum(screen * screen, axis=-1)

    def lessening(self, point: Float[Array, "point 3"]) -> Float[Array, " point"]:
        """(1 - z / range)^3 (1 + tan^2)^2, z being heights over the target and tan that of angles off the axis.

        A patch dA of normal n and radiance L sends L |n . `Eye.away`| dA / this of the intensity that pixels add up to.
        """
        height = matmul(point - self.target[None], self.frame[2])
        return (1 - height * self.inverse_range) ** 3 * self.slant(self.project(point)) ** 2

    def rectangle(self, outline: Float[Array, "point 3"]) -> tuple[Float[Array, " 2"], Float[Array, " 2"]]:
        """Lower and upper corner of what the rectangle about projected points fills of the frame [m]."""
        half, corner = self.half_size(), self.project(outline)
        return jnp.clip(corner.min(axis=0), -half, half), jnp.clip(corner.max(axis=0), -half, half)

    def spread_over(
        self, outline: Float[Array, "point 3"], side: int
    ) -> tuple[Float[Array, "ray 2"], Float[Array, " ray"]]:
        """Screen points spread evenly over the rectangle about projected points inside the frame, and their weights.

        There are side^2 of them [m], side being a power of 2; those that follow one another are near one another.
        sum weight L is what lies in the rectangle of I = sum L dA / (1 + tan^2)^2 [m2].
        """
        low, high = self.rectangle(outline)
        place = np.arange(side**2)[:, None] >> np.arange(2)[None]  # bits of columns and rows take turns
        cell = sum(((place >> 2 * bit) & 1) << bit for bit in range(side.bit_length() - 1))
        screen = low[None] + (high - low)[None] * as_float((cell + 0.5) / side)
        return screen, jnp.prod(high - low) / side**2 / self.slant(screen) ** 2

    def pixel_index(self, tile: Int[np.ndarray, " tile"] | None = None) -> Int[np.ndarray, "tile pixel"]:
        """row * columns + column of every pixel of tiles, as of `tile_edges`, -1 beyond the image's edge."""
        row, column = np.moveaxis(self._first(tile)[:, None] + _PIXELS, -1, 0)
        index = np.where((row < self.shape[0]) & (column < self.shape[1]), row * self.shape[1] + column, -1)
        return index.astype(np.int32)

    def bundle(self, screen: Float[Array, "ray 2"], start: Float[Array, ""]) -> Bundle:
        """The rays through screen points, starting on the plane `start` [m] in front of the target."""
        return Bundle(self.target, self.frame, self.inverse_range, start, screen)

    def untile(self, value: Shaped[Array, "tile pixel *field"]) -> Shaped[Array, "row column *field"]:
        """An image [row, column, ...] from values per tile and pixel, tiles row by row."""
        rows, columns = self.tiles
        field = value.shape[2:]
        grid = value.reshape((rows, columns, TILE, TILE) + field)
        image = jnp.swapaxes(grid, 1, 2).reshape((rows * TILE, columns * TILE) + field)
        return image[: self.shape[0], : self.shape[1]]

    def pixel_area(self) -> Float[Array, "row column"]:
        """Weight that turns an image of radiance into radiant intensity [row, column] [m2].

        The irradiance at the pupil on a plane facing the target is E = sum L cos(theta) dOmega with
        dOmega cos(theta) = (pixel / range)^2 cos^4(theta), and the intensity I = E range^2.
        """
        return self._area(self._pixels(0), self._pixels(1))

    def tile_area(self, edges: Float[Array, "tile 2 17"]) -> Float[Array, "tile pixel"]:
        """`pixel_area` of the pixels between `tile_edges` [tile, pixel] [m2]; 0 beyond the edge of a graded image."""
        middle, size = (edges[..., 1:] + edges[..., :-1]) / 2, jnp.abs(edges[..., 1:] - edges[..., :-1])
        return self._area(*((middle[:, axis], size[:, axis]) for axis in (0, 1))).reshape(edges.shape[0], -1)

    def _area(
        self, columns: tuple[Float[Array, "*tile column"], ...], rows: tuple[Float[Array, "*tile row"], ...]
    ) -> Float[Array, "*tile row column"]:
        """See `pixel_area`; of the middles of columns and rows, and their sizes [m]."""
        (x, width), (y, height) = (part[..., None, :] for part in columns), (part[..., :, None] for part in rows)
        return height * width / (1 + (y**2 + x**2) * self.inverse_range**2) ** 2

    def _pixels(self, axis: int) -> tuple[Float[Array, " pixel"], Float[Array, " pixel"]]:
        """Distance of the middle of columns (axis 0) or rows (axis 1) from the image's, and their size [m]."""
        count = self.shape[1 - axis]
        if self.grading is None:
            middle = jnp.arange(count).astype(self.pixel.dtype) + 0.5 - count / 2
            return middle * self.pixel[axis], jnp.broadcast_to(self.pixel[axis], (count,))
        edges = jnp.asarray(self.edges(axis, np.arange(count + 1)))
        return (edges[1:] + edges[:-1]) / 2, jnp.abs(edges[1:] - edges[:-1])

    def checks(self) -> list[Check]:
        """The target is finite, the frame a number, pixels have positive size; all in the precision in force."""
        require_precision(self)
        return [
            finite("Camera.target", self.target),
            finite("Camera.frame", self.frame),
            finite("Camera.inverse_range", self.inverse_range),
            positive("Camera.pixel", self.pixel),
        ]


def view_checks(views: Float[Array, "view 2"]) -> list[Check]:
    """Azimuths and elevations [view, 2] [deg] are finite; elevations go up to 90."""
    return [finite("views", views), ELEVATION("views: elevation", views, lambda aspect: aspect[..., 1])]


def tile_points(edges: Float[Array, "tile 2 17"], offset: Float[Array, "tile pixel 2"]) -> Float[Array, "tile pixel 2"]:
    """Screen points in the pixels of tiles [tile, pixel, 2] [m].

    Args:
        edges: of `Camera.tile_edges`.
        offset: place inside each pixel, in [0, 1) along columns and rows.
    """
    grid = edges.shape[0], TILE, TILE
    begin, size = edges[..., :-1], edges[..., 1:] - edges[..., :-1]

    def along(axis: int) -> Array:
        of_pixels = (jnp.broadcast_to(jnp.expand_dims(x[:, axis], 1 + axis), grid) for x in (begin, size))
        first, width = (x.reshape(edges.shape[0], -1) for x in of_pixels)
        return first + offset[..., axis] * width

    return jnp.stack([along(0), along(1)], axis=-1)


def view_frame(azimuth: Any, elevation: Any) -> Float[Array, "3 3"]:
    """Image frame of an observer at an aspect.

    Args:
        azimuth: from the nose (+x) towards the left wing (+y) [deg].
        elevation: above the wings' plane [deg].

    Returns:
        Rows u (right), v (up), w = (cos el cos az, cos el sin az, sin el), the direction from target to observer.
        Seen from straight above or below, "up" continues from the limit along the azimuth.
    """
    angles = as_float(azimuth, "azimuth"), as_float(elevation, "elevation")
    require_shape("azimuth", angles[0], ())
    require_shape("elevation", angles[1], ())
    require([*map(finite, ("azimuth", "elevation"), angles), ELEVATION("elevation", angles[1])])
    xp, az, el = on_host(*angles)
    az, el = xp.deg2rad(az), xp.deg2rad(el)
    ca, sa, ce, se = xp.cos(az), xp.sin(az), xp.cos(el), xp.sin(el)
    u = xp.stack([-sa, ca, xp.zeros_like(ca)])
    v = xp.stack([-se * ca, -se * sa, ce])
    w = xp.stack([ce * ca, ce * sa, se])
    return placed(xp.stack([u, v, w]))


def view_angles(frame: Any) -> np.ndarray:
    """Azimuth and elevation [*batch, 2] [deg] of observers with frames [*batch, 3, 3] of `view_frame`; on the host."""
    x, y, z = np.moveaxis(np.asarray(frame, np.float64)[..., 2, :], -1, 0)
    return np.rad2deg(np.stack([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))], axis=-1))


def _shape(shape: tuple[int, int]) -> tuple[int, int]:
    rows, columns = require_counts("Camera.shape", shape, "(rows, columns)", 2)
    return rows, columns


def perspective_camera(
    azimuth: Any,
    elevation: Any,
    distance: Any,
    angular_resolution: Any,
    shape: tuple[int, int],
    target: Any = (0.0, 0.0, 0.0),
) -> Camera:
    """A camera at a finite range.

    Args:
        azimuth: aspect of the camera seen from the target [deg], see `view_frame`.
        elevation: likewise [deg].
        distance: from the target to the camera [m].
        angular_resolution: angle of one pixel at the image's centre [rad].
        shape: rows and columns.
        target: point in the middle of the image [3] [m].

    Returns:
        The camera.

    Raises:
        ValueError: a shape is wrong, or distance or resolution are not positive.
    """
    range_ = as_float(distance, "distance")
    step = as_float(angular_resolution, "angular_resolution")
    for field, value in (("distance", range_), ("angular_resolution", step)):
        require_shape(field, value, ())
        _require_positive(field, value)
    require([_RADIAN("angular_resolution", step)])
    point = as_float(target, "target")
    require_shape("target", point, (3,))
    xp, away, angle = on_host(range_, step)
    pixel = xp.stack([away * angle] * 2)
    return Camera(point, view_frame(azimuth, elevation), placed(1 / away), placed(pixel), _shape(shape))


def orthographic_camera(
    azimuth: Any,
    elevation: Any,
    pixel: Any,
    shape: tuple[int, int],
    target: Any = (0.0, 0.0, 0.0),
) -> Camera:
    """A camera at infinity; `pixel` is the size of a pixel at the target [m], others as `perspective_camera`."""
    size = as_float(pixel, "pixel")
    if size.shape not in ((), (2,)):
        raise ValueError(f"pixel: got shape {size.shape}, expected one value or (2,)")
    _require_positive("pixel", size)
    point = as_float(target, "target")
    require_shape("target", point, (3,))
    return Camera(point, view_frame(azimuth, elevation), as_float(0.0), broadcast(size, (2,)), _shape(shape))


def in_front(field: str, distance: Array) -> Check:
    """A distance to an eye is positive; it may be infinite."""
    _, x = on_host(distance)
    return Check(field, x, x > 0, "a distance > 0, or inf")


def _require_positive(field: str, value: Array) -> None:
    """Raise `ValueError` for known values that are not positive and finite."""
    enforce(value, [positive(field, value)])


def fitted_camera(
    azimuth: Any, elevation: Any, extent: Float[Array, "corner 3"], shape: tuple[int, int], distance: Any = np.inf
) -> Camera:
    """A camera whose image just holds a scene.

    Args:
        azimuth: [deg].
        elevation: [deg].
        extent: points whose convex hull holds the scene [corner, 3] [m].
        shape: rows and columns; pixels are as wide and as high as the scene's outline asks.
        distance: from the middle of the extent to the camera [m]; infinite by default.

    Returns:
        The camera, aimed at the middle of the extent, or from infinity at that of the outline.
    """
    return camera_around(view_frame(azimuth, elevation), extent, shape, distance)


def camera_around(
    frame: Float[Array, "3 3"], extent: Float[Array, "corner 3"], shape: tuple[int, int], distance: Any = np.inf
) -> Camera:
    """As `fitted_camera`, with an image frame of any roll."""
    away = as_float(distance, "distance")
    require_shape("distance", away, ())
    require([in_front("distance", away)])
    inverse = 1 / away
    rows, columns = _shape(shape)
    centre = (extent.max(axis=0) + extent.min(axis=0)) / 2

    def aimed(target: Array) -> Camera:
        return Camera(target, frame, inverse, jnp.ones_like(target[:2]), (rows, columns))

    seen = aimed(centre).project(extent)
    aside = matmul((seen.max(axis=0) + seen.min(axis=0)) / 2, frame[:2])
    # an eye at a finite distance would move aside with its target
    camera = aimed(centre + jnp.where(inverse > 0, 0, aside))
    half = jnp.max(jnp.abs(camera.project(extent)), axis=0)
    half = jnp.maximum(half, 1e-6 * jnp.max(half))  # a plate seen edge-on still has an image
    return eqx.tree_at(lambda c: c.pixel, camera, half * (2 + MARGIN) / as_float(np.array([columns, rows])))
