"""Entry: radiance image with standard error, radiant intensity, signature over aspects."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int, Key
from tqdm import tqdm

from jaxir._arrays import Check, as_float, enforce
from jaxir.geometry.camera import TILE, Camera, fitted_camera, view_frame
from jaxir.optics.band import Band, Nodes, as_nodes
from jaxir.scene.scene import Scene
from jaxir.transport.evaluate import Radiometry, empty_radiance, evaluate, radiometry, unoccluded_radiance
from jaxir.transport.path_estimator import AbstractPathEstimator, CellSum
from jaxir.transport.paths import trace

TILES_AT_ONCE = 64  # 16384 rays: bounds memory whatever the image


class Image(eqx.Module):
    """A radiance image at the entrance pupil.

    Attributes:
        radiance: mean over each pixel, equation (1) [row, column, band] [W m-2 sr-1].
        standard_error: of `radiance`, from the pixel's own samples [row, column, band].
        empty: radiance of a pixel that sees the scene nowhere [band].
        camera: what took it.
        bands: band names.
    """

    radiance: Float[Array, "row column band"]
    standard_error: Float[Array, "row column band"]
    empty: Float[Array, " band"]
    camera: Camera
    bands: tuple[str, ...] = eqx.field(static=True)

    def radiant_intensity(self) -> Float[Array, " band"]:
        """Radiant intensity in contrast to what the empty image would show [band] [W sr-1].

        I = sum over pixels of (L - L_empty) * area, with `Camera.pixel_area`. Without background and air this is the
        intensity of the source itself; with air it is the apparent one.
        """
        area = self.camera.pixel_area()
        return jnp.sum((self.radiance - self.empty[None, None, :]) * area[:, :, None], axis=(0, 1))

    def intensity_error(self) -> Float[Array, " band"]:
        """Standard error of `radiant_intensity` [band] [W sr-1]; pixels are sampled independently."""
        area = self.camera.pixel_area()
        variance = jnp.sum((self.standard_error * area[:, :, None]) ** 2, axis=(0, 1))
        return _sqrt(variance)


def render(
    scene: Scene,
    camera: Camera,
    bands: Nodes | Band | Sequence[Band],
    *,
    samples: int = 8,
    key: Key[Array, ""] | None = None,
    path: AbstractPathEstimator = CellSum(),  # noqa: B008
) -> Image:
    """Radiance image of a scene.

    Every pixel is cut into samples / 2 strata and each stratum gets two random points, so that half their squared
    difference is an unbiased estimate of its variance:

        L = mean_k (a_k + b_k) / 2,      se^2 = sum_k (a_k - b_k)^2 / 4 / strata^2.

    Everything along a ray is exact, so a pixel that sees a uniform field has a standard error of 0. The variance over
    strata of a smooth field falls as samples^-2, across a silhouette as samples^-3/2.

    Args:
        scene: the scene.
        camera: the eye.
        bands: bands (one gray node each) or spectral nodes.
        samples: rays per pixel; even.
        key: random key; a fixed one by default, so results repeat.
        path: estimator of the plume's radiance along a ray; the exact sum over cells unless asked otherwise.

    Returns:
        The image. Memory beyond it is bounded by `TILES_AT_ONCE` tiles of 256 rays.

    Raises:
        ValueError: wrong shapes, values out of range, an eye inside the scene.

    Differentiable, in both modes, in every radiometric leaf of the scene; the geometry is seen as fixed.
    """
    nodes = as_nodes(bands)
    strata = _strata(samples)
    key = jax.random.key(0) if key is None else key
    nodes = enforce(nodes, [*scene.checks(), *camera.checks(), _eye_outside(scene, camera)])
    optical = _radiometry(scene, nodes)
    mean, variance = _over_chunks(
        lambda begin: _chunk(optical, camera, key, begin, strata, path),
        _chunks(camera),
        (optical, camera, key),
        "render",
    )
    mean, variance = _untile(camera, mean), _untile(camera, variance)
    return Image(mean, _sqrt(variance), nodes.in_band(empty_radiance(optical)), camera, nodes.names)


@eqx.filter_jit
def _radiometry(scene: Scene, nodes: Nodes) -> Radiometry:
    return radiometry(scene, nodes)


def _chunk_size(camera: Camera) -> int:
    return min(TILES_AT_ONCE, camera.tiles[0] * camera.tiles[1])


def _chunks(camera: Camera) -> Int[Array, " chunk"]:
    """First tile of each chunk; the last chunk may run past the image."""
    size = _chunk_size(camera)
    return jnp.arange(-(-camera.tiles[0] * camera.tiles[1] // size), dtype=jnp.int32) * size


def _untile(camera: Camera, value: Float[Array, "chunk tile pixel band"]) -> Float[Array, "row column band"]:
    flat = value.reshape((-1,) + value.shape[2:])
    return camera.untile(flat[: camera.tiles[0] * camera.tiles[1]])


@eqx.filter_jit
def _chunk(
    optical: Radiometry,
    camera: Camera,
    key: Array,
    begin: Int[Array, ""],
    strata: tuple[int, int],
    path: AbstractPathEstimator = CellSum(),  # noqa: B008
) -> tuple[Float[Array, "tile pixel band"], Float[Array, "tile pixel band"]]:
    """Mean radiance and its variance in the pixels of one chunk of tiles."""
    size, pixels = _chunk_size(camera), TILE * TILE
    start = scene_radius(optical.scene, camera)
    tile = begin + jnp.arange(size, dtype=jnp.int32)
    cells = as_float(np.array(strata))

    def sample(drawn: tuple[Array, Array | None]) -> Array:
        offset, along = drawn
        screen = camera.screen(tile, offset).reshape(-1, 2)
        paths = trace(optical.scene, camera.bundle(screen, start))
        return optical.nodes.in_band(evaluate(optical, paths, path, along)).reshape(size, pixels, -1)

    def stratum(carry: tuple[Array, Array], index: Array) -> tuple[tuple[Array, Array], None]:
        corner = jnp.stack([index % strata[0], index // strata[0]]).astype(cells.dtype)
        own = jax.random.fold_in(jax.random.fold_in(key, begin), index)
        jitter = jax.random.uniform(own, (2, size, pixels, 2), cells.dtype)
        along = None if isinstance(path, CellSum) else jax.random.split(jax.random.fold_in(own, 1), 2)
        pair = lax.map(sample, ((corner[None, None, None, :] + jitter) / cells[None, None, None, :], along))
        total, square = carry
        return (total + (pair[0] + pair[1]) / 2, square + (pair[0] - pair[1]) ** 2 / 4), None

    count = strata[0] * strata[1]
    zero = jnp.zeros((size, pixels, optical.nodes.response.shape[0]), cells.dtype)
    (total, square), _ = lax.scan(stratum, (zero, zero), jnp.arange(count, dtype=jnp.int32))
    return total / count, square / count**2


def _over_chunks(function: Callable[[Array], Any], items: Array, inputs: Any, label: str) -> Any:
    """Map over items: one compiled loop when `inputs` are traced, else a loop on the host behind a progress bar."""
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(inputs)):
        return lax.map(function, items)
    results = []
    for item in tqdm(items, desc=label, delay=5, leave=False):
        results.append(jax.block_until_ready(function(item)))
    return jax.tree.map(lambda *parts: jnp.stack(parts), *results)


def scene_radius(scene: Scene, camera: Camera) -> Float[Array, ""]:
    """Radius about the camera's target of a sphere that holds the scene, plus .1 % [m]."""
    offset = scene.extent() - camera.target[None, :]
    return lax.stop_gradient(jnp.sqrt(jnp.max(jnp.sum(offset * offset, axis=-1))) * 1.001)


def _eye_outside(scene: Scene, camera: Camera) -> Check:
    """Rays start on the scene's bounding sphere, so the eye must be beyond it."""
    reach = scene_radius(scene, camera) * camera.inverse_range
    return Check(
        "Camera: (radius of the scene about the target) / distance",
        reach,
        reach < 1,
        "less than 1: an eye outside the scene's bounding sphere",
    )


def _strata(samples: int) -> tuple[int, int]:
    """Columns and rows of strata in a pixel: samples / 2 of them, as square as its divisors allow."""
    if samples < 2 or samples % 2:
        raise ValueError(f"samples: got {samples}, expected an even number >= 2 (two points in each stratum)")
    half = samples // 2
    rows = max(d for d in range(1, math.isqrt(half) + 1) if half % d == 0)
    return half // rows, rows


def _sqrt(value: Array) -> Array:
    """Square root with a derivative of 0 at 0."""
    return jnp.where(value > 0, jnp.sqrt(jnp.where(value > 0, value, 1)), 0)


def unoccluded_intensity(
    scene: Scene, azimuth: Any, elevation: Any, bands: Nodes | Band | Sequence[Band]
) -> Float[Array, " band"]:
    """Radiant intensity of skin whose faces do not hide or shade one another: a sum over faces, no rays.

        I = sum_f A_f max(n_f . o, 0) L_f(o)

    Exact for convex bodies and for open surfaces seen from outside; an upper bound otherwise. Backs of faces do not
    count.

    Args:
        scene: skin, with sources and air if present; no plume. The background is not subtracted.
        azimuth: aspect [deg], see `view_frame`.
        elevation: likewise [deg].
        bands: bands or nodes.

    Returns:
        Radiant intensity [band] [W sr-1], through the atmosphere's transmittance if there is one.

    Raises:
        ValueError: the scene has a plume or no skin, or values are out of range.

    Differentiable in every radiometric leaf, in the vertices, and in the aspect.
    """
    if scene.skin is None or scene.plume is not None:
        raise ValueError("scene: got a plume or no skin, expected skin alone; use render or signature for plumes")
    nodes = enforce(as_nodes(bands), scene.checks())
    optical = radiometry(scene, nodes)
    toward = view_frame(azimuth, elevation)[2]
    vector = scene.skin.mesh.area_vectors()
    projected = jnp.maximum(jnp.sum(vector * toward[None, :], axis=-1), 0)
    radiance = unoccluded_radiance(optical, toward)
    intensity = jnp.sum(projected[:, None] * radiance, axis=0)
    if optical.transmittance is not None:
        intensity = intensity * optical.transmittance
    return nodes.in_band(intensity)


class Signature(eqx.Module):
    """Radiant intensity over aspects.

    Attributes:
        azimuth: of each view [view] [deg].
        elevation: of each view [view] [deg].
        intensity: contrast intensity, see `Image.radiant_intensity` [view, band] [W sr-1].
        standard_error: of `intensity` [view, band] [W sr-1].
        bands: band names.
    """

    azimuth: Float[Array, " view"]
    elevation: Float[Array, " view"]
    intensity: Float[Array, "view band"]
    standard_error: Float[Array, "view band"]
    bands: tuple[str, ...] = eqx.field(static=True)


def signature(
    scene: Scene,
    views: Any,
    bands: Nodes | Band | Sequence[Band],
    *,
    distance: Any = np.inf,
    shape: tuple[int, int] = (128, 128),
    samples: int = 2,
    key: Key[Array, ""] | None = None,
) -> Signature:
    """Radiant intensity of a scene over aspects, all of them under one compilation.

    Every view is an image whose pixels just hold the scene's outline, so the accuracy is that of the raster whatever
    the aspect; more rows and columns buy more than more samples.

    Args:
        scene: the scene.
        views: azimuth and elevation of each view [view, 2] [deg].
        bands: bands or nodes.
        distance: from the scene to the sensor [m]; infinite by default.
        shape: rows and columns of the images.
        samples: rays per pixel; even.
        key: random key.

    Returns:
        The table.

    Raises:
        ValueError: as `render`; `views` of another shape.

    Differentiable as `render`.
    """
    aspect = as_float(views, "views")
    if aspect.ndim != 2 or aspect.shape[1] != 2 or aspect.shape[0] == 0:
        raise ValueError(f"views: got shape {aspect.shape}, expected (view, 2): azimuth and elevation in degrees")
    nodes = as_nodes(bands)
    strata = _strata(samples)
    base = jax.random.key(0) if key is None else key
    extent = scene.extent()
    cameras = jax.vmap(lambda a: fitted_camera(a[0], a[1], extent, shape, distance))(aspect)
    outside = jax.vmap(lambda camera: _eye_outside(scene, camera).value)(cameras)
    eye = Check("signature: (radius of the scene) / distance", outside, outside < 1, "less than 1: sensors outside it")
    nodes = enforce(nodes, [*scene.checks(), *cameras.checks(), eye])
    optical = _radiometry(scene, nodes)
    keys = jax.random.split(base, aspect.shape[0])

    def view(index: Array) -> tuple[Array, Array]:
        return _view(optical, jax.tree.map(lambda leaf: leaf[index], cameras), keys[index], strata)

    index = jnp.arange(aspect.shape[0], dtype=jnp.int32)
    intensity, error = _over_chunks(view, index, (optical, cameras, keys), "signature")
    return Signature(aspect[:, 0], aspect[:, 1], intensity, error, nodes.names)


@eqx.filter_jit
def _view(
    optical: Radiometry, camera: Camera, key: Array, strata: tuple[int, int]
) -> tuple[Float[Array, " band"], Float[Array, " band"]]:
    """Contrast intensity of one view and its standard error."""
    mean, variance = lax.map(lambda begin: _chunk(optical, camera, key, begin, strata), _chunks(camera))
    empty = optical.nodes.in_band(empty_radiance(optical))
    image = Image(_untile(camera, mean), _sqrt(_untile(camera, variance)), empty, camera, optical.nodes.names)
    return image.radiant_intensity(), image.intensity_error()
