"""Radiant intensity over aspects."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.sharding import Mesh
from jaxtyping import Array, Float, Int, Key

from jaxir._arrays import Check, as_float, enforce
from jaxir.geometry import Camera, pixel_strata
from jaxir.imaging._chunks import Pass, estimate_chunk, eye_outside, whole_image
from jaxir.imaging._devices import over_items, shared_by
from jaxir.optics.spectrum import Band, Nodes, as_nodes
from jaxir.scene import Lit, Scene, compiled_on_nodes
from jaxir.transport import Method, graded_cameras, method_checks


class Signature(eqx.Module):
    """Radiant intensity over aspects.

    Attributes:
        azimuth: of each view [view] [deg].
        elevation: of each view [view] [deg].
        intensity: contrast intensity, see `Image.radiant_intensity` [view, band] [W sr-1].
        standard_error: of `intensity` [view, band] [W sr-1].
        bands: band names.
        truncation: estimated share of `intensity` that orders of scattering beyond the last would add, see
            `Image.truncation` [view, band].
    """

    azimuth: Float[Array, " view"]
    elevation: Float[Array, " view"]
    intensity: Float[Array, "view band"]
    standard_error: Float[Array, "view band"]
    bands: tuple[str, ...] = eqx.field(static=True)
    truncation: Float[Array, "view band"]


class Views(NamedTuple):
    """What is seen from where, ready to be computed view by view.

    Attributes:
        lit: the scene on the nodes.
        cameras: of all views [view].
        keys: of all views [view]; those of the first views do not depend on how many follow.
        strata: columns and rows of strata in a pixel.
        method: how radiance is found.
        azimuth: [view] [deg].
        elevation: [view] [deg].
    """

    lit: Lit
    cameras: Camera
    keys: Array
    strata: tuple[int, int]
    method: Method
    azimuth: Array
    elevation: Array


def signature(
    scene: Scene,
    views: Any,
    bands: Nodes | Band | Sequence[Band],
    *,
    distance: Any = np.inf,
    shape: tuple[int, int] = (128, 128),
    samples: int = 2,
    key: Key[Array, ""] | None = None,
    method: Method | None = None,
    devices: Mesh | None = None,
) -> Signature:
    """Radiant intensity of a scene over aspects, all of them under one compilation.

    Every view is an image that just holds the scene's outline, with its rows and columns close together where the
    scene is bright (`graded_camera`), so the accuracy is that of the raster whatever the aspect; more rows and columns
    buy more than more samples.

    Args:
        scene: the scene.
        views: azimuth and elevation of each view [view, 2] [deg].
        bands: bands or nodes.
        distance: from the scene to the sensor [m]; infinite by default.
        shape: rows and columns of the images.
        samples: rays per pixel; even.
        key: random key.
        method: as `render`.
        devices: as `render`; views are shared out.

    Returns:
        The table.

    Raises:
        ValueError: as `render`; `views` of another shape; more devices than views.

    Differentiable as `render`.
    """
    asked = prepare_views(
        scene,
        views,
        bands,
        distance=distance,
        shape=shape,
        samples=samples,
        key=key,
        method=Method() if method is None else method,
    )
    index = jnp.arange(asked.azimuth.shape[0], dtype=jnp.int32)
    mesh = shared_by(devices, index.shape[0], "views")
    intensity, error, truncation = over_items(view_intensity, asked, index, "signature", mesh)
    return Signature(asked.azimuth, asked.elevation, intensity, error, asked.lit.nodes.names, truncation)


def prepare_views(
    scene: Scene,
    views: Any,
    bands: Nodes | Band | Sequence[Band],
    *,
    distance: Any,
    shape: tuple[int, int],
    samples: int,
    key: Key[Array, ""] | None,
    method: Method,
) -> Views:
    """Check what `signature` is asked and make it ready; arguments and errors as there."""
    aspect = as_float(views, "views")
    if aspect.ndim != 2 or aspect.shape[1] != 2 or aspect.shape[0] == 0:
        raise ValueError(f"views: got shape {aspect.shape}, expected (view, 2): azimuth and elevation in degrees")
    nodes = as_nodes(bands)
    base = jax.random.key(0) if key is None else key
    lit = compiled_on_nodes(scene, nodes)
    cameras = graded_cameras(lit, aspect, shape, distance)
    outside = jax.vmap(lambda camera: eye_outside(scene, camera).value)(cameras)
    eye = Check("signature: (radius of the scene) / distance", outside, outside < 1, "less than 1: sensors outside it")
    nodes = enforce(nodes, [*scene.checks(), *cameras.checks(), eye, *method_checks(method, scene)])
    keys = jax.vmap(jax.random.fold_in, (None, 0))(base, jnp.arange(aspect.shape[0], dtype=jnp.uint32))
    return Views(lit, cameras, keys, pixel_strata(samples), method.resolved(scene), aspect[:, 0], aspect[:, 1])


@eqx.filter_jit
def view_intensity(
    views: Views, index: Int[Array, ""]
) -> tuple[Float[Array, " band"], Float[Array, " band"], Float[Array, " band"]]:
    """Contrast intensity of one view, its standard error, and the share left out."""
    camera, key = jax.tree.map(lambda leaf: leaf[index], (views.cameras, views.keys))
    taken = Pass(views.lit, camera, key, views.strata, views.method)
    image = whole_image(taken, lax.map(lambda chunk: estimate_chunk(taken, chunk), taken.chunks()))
    return image.radiant_intensity(), image.intensity_error(), image.truncation
