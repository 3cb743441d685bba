"""Radiant intensity over aspects."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Key

from jaxir._arrays import Check, as_float, enforce
from jaxir.geometry.camera import Camera, fitted_camera, pixel_strata
from jaxir.optics.band import Band, Nodes, as_nodes
from jaxir.render.chunks import (
    Method,
    chunk_begins,
    chunk_size,
    compiled_radiometry,
    estimate_chunk,
    eye_outside,
    method_of,
    over_items,
    whole_image,
)
from jaxir.scene.scene import Scene
from jaxir.transport.path_estimator import AbstractPathEstimator, CellSum
from jaxir.transport.radiometry import Radiometry
from jaxir.transport.reflection import Reflection
from jaxir.transport.scattering import Scattering


class Signature(eqx.Module):
    """Radiant intensity over aspects.

    Attributes:
        azimuth: of each view [view] [deg].
        elevation: of each view [view] [deg].
        intensity: contrast intensity, see `Image.radiant_intensity` [view, band] [W sr-1].
        standard_error: of `intensity` [view, band] [W sr-1].
        bands: band names.
        missing: estimated share of `intensity` that orders of scattering beyond the last would add, see
            `Image.missing` [view, band].
    """

    azimuth: Float[Array, " view"]
    elevation: Float[Array, " view"]
    intensity: Float[Array, "view band"]
    standard_error: Float[Array, "view band"]
    bands: tuple[str, ...] = eqx.field(static=True)
    missing: Float[Array, "view band"]


def signature(
    scene: Scene,
    views: Any,
    bands: Nodes | Band | Sequence[Band],
    *,
    distance: Any = np.inf,
    shape: tuple[int, int] = (128, 128),
    samples: int = 2,
    key: Key[Array, ""] | None = None,
    reflection: Reflection | None = None,
    scattering: Scattering | None = None,
    path: AbstractPathEstimator = CellSum(),  # noqa: B008
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
        reflection: as `render`.
        scattering: as `render`.
        path: as `render`.

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
    strata = pixel_strata(samples)
    base = jax.random.key(0) if key is None else key
    extent = lax.stop_gradient(scene.extent())  # a camera follows the outline of a jet but does not belong to it
    cameras = jax.vmap(lambda a: fitted_camera(a[0], a[1], extent, shape, distance))(aspect)
    outside = jax.vmap(lambda camera: eye_outside(scene, camera).value)(cameras)
    eye = Check("signature: (radius of the scene) / distance", outside, outside < 1, "less than 1: sensors outside it")
    method = method_of(scene, reflection, scattering, path)
    nodes = enforce(nodes, [*scene.checks(), *cameras.checks(), eye, *method.checks(scene)])
    optical = compiled_radiometry(scene, nodes)
    keys = jax.random.split(base, aspect.shape[0])

    def view(index: Array) -> tuple[Array, Array, Array]:
        return _view(optical, jax.tree.map(lambda leaf: leaf[index], cameras), keys[index], strata, method)

    index = jnp.arange(aspect.shape[0], dtype=jnp.int32)
    intensity, error, missing = over_items(view, index, (optical, cameras, keys, method), "signature")
    return Signature(aspect[:, 0], aspect[:, 1], intensity, error, nodes.names, missing)


@eqx.filter_jit
def _view(
    optical: Radiometry, camera: Camera, key: Array, strata: tuple[int, int], method: Method
) -> tuple[Float[Array, " band"], Float[Array, " band"], Float[Array, " band"]]:
    """Contrast intensity of one view, its standard error, and the share missing from it."""
    begins = chunk_begins(camera, chunk_size(camera, optical.scene, method))
    parts = lax.map(lambda begin: estimate_chunk(optical, camera, key, begin, strata, method), begins)
    image = whole_image(optical, camera, parts, 2 * strata[0] * strata[1])
    return image.radiant_intensity(), image.intensity_error(), image.missing()
