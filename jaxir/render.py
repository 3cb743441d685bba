"""Entry: radiance image with standard error, radiant intensity, signature over aspects."""

from __future__ import annotations

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
from jaxir.geometry.camera import TILE, Camera, fitted_camera, pixel_strata, stratum_points, view_frame
from jaxir.optics.band import Band, Nodes, as_nodes
from jaxir.scene.background import AbstractUniformBackground
from jaxir.scene.scene import Scene
from jaxir.scene.source import ParallelSource
from jaxir.transport.evaluate import empty_radiance, evaluate, unoccluded_radiance
from jaxir.transport.path_estimator import AbstractPathEstimator, CellSum
from jaxir.transport.paths import trace
from jaxir.transport.radiometry import Radiometry, radiometry
from jaxir.transport.reflection import Reflection, reflection_of

TILES_AT_ONCE = 64  # 16384 rays: bounds memory whatever the image
SAMPLES_AT_ONCE = 16  # directions a ray carries before fewer tiles are handled at once


class Outcome(eqx.Enumeration):
    """Why a computation ended."""

    samples_taken = "All samples asked for were taken."
    tolerance_met = "The standard error of every band's intensity fell below the relative tolerance."
    samples_spent = "The samples were spent before the standard error met the relative tolerance."


class Image(eqx.Module):
    """A radiance image at the entrance pupil.

    Attributes:
        radiance: mean over each pixel, equation (1) [row, column, band] [W m-2 sr-1].
        standard_error: of `radiance`, from the pixel's own samples [row, column, band].
        empty: what the pixels would show without the scene; one pixel stands for all where the background is uniform
            [row | 1, column | 1, band].
        camera: what took it.
        bands: band names.
        samples: rays taken per pixel.
        outcome: why no more were taken, an item of `Outcome`.
    """

    radiance: Float[Array, "row column band"]
    standard_error: Float[Array, "row column band"]
    empty: Float[Array, "_row _column band"]
    camera: Camera
    bands: tuple[str, ...] = eqx.field(static=True)
    samples: Int[Array, ""]
    outcome: Outcome

    def radiant_intensity(self) -> Float[Array, " band"]:
        """Radiant intensity in contrast to what the empty image would show [band] [W sr-1].

        I = sum over pixels of (L - L_empty) * area, with `Camera.pixel_area`. Without background and air this is the
        intensity of the source itself; with air it is the apparent one.
        """
        area = self.camera.pixel_area()
        return jnp.sum((self.radiance - self.empty) * area[:, :, None], axis=(0, 1))

    def intensity_error(self) -> Float[Array, " band"]:
        """Standard error of `radiant_intensity` [band] [W sr-1]; pixels are sampled independently.

        Where the background is not uniform this counts its variation within pixels too, which the contrast does not.
        """
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
    reflection: Reflection | None = None,
    rtol: float | None = None,
    max_samples: int = 4096,
    path: AbstractPathEstimator = CellSum(),  # noqa: B008
) -> Image:
    """Radiance image of a scene.

    Every pixel is cut into samples / 2 strata and each stratum gets two random points, so that half their squared
    difference is an unbiased estimate of its variance:

        L = mean_k (a_k + b_k) / 2,      se^2 = sum_k (a_k - b_k)^2 / 4 / strata^2.

    Everything along a ray is exact, so a pixel that sees a uniform field has a standard error of 0. The variance over
    strata of a smooth field falls as samples^-2, across a silhouette as samples^-3/2. Light from area sources and
    bounces is sampled anew, independently, at every point, so the standard error counts it.

    Args:
        scene: the scene.
        camera: the eye.
        bands: bands (one gray node each) or spectral nodes.
        samples: rays per pixel; even.
        key: random key; a fixed one by default, so results repeat.
        reflection: how light from lights with an extent, from the background and from the skin itself is found; see
            `jaxir.trace`. By default delta sources alone light the skin, and `Reflection()` serves area sources.
        rtol: keep adding passes of `samples` until the standard error of the radiant intensity of every band is at
            most rtol times the intensity; None takes one pass. `Image.outcome` says whether it was met.
        max_samples: rays per pixel at which to give up.
        path: estimator of a gridded plume's radiance along a ray; the exact sum over cells unless asked otherwise.

    Returns:
        The image. Memory beyond it is bounded by `TILES_AT_ONCE` tiles of 256 rays.

    Raises:
        ValueError: wrong shapes, values out of range, an eye inside the scene, `rtol` inside jit.

    Differentiable, in both modes, in every radiometric leaf of the scene and in the place and shape of a jet; other
    geometry is seen as fixed.
    """
    nodes = as_nodes(bands)
    strata = pixel_strata(samples)
    key = jax.random.key(0) if key is None else key
    reflection = reflection_of(scene, reflection)
    nodes = enforce(
        nodes, [*scene.checks(), *camera.checks(), _eye_outside(scene, camera), *_reflection_checks(scene, reflection)]
    )
    optical = _radiometry(scene, nodes)

    def take(own: Array) -> Image:
        inputs = (optical, camera, own, reflection)
        chunks = _chunks(camera, _chunk_size(camera, scene, reflection))
        parts = _over_chunks(
            lambda begin: _chunk(*inputs[:3], begin, strata, reflection, path), chunks, inputs, "render"
        )
        return _image(optical, camera, parts, samples)

    if rtol is None:
        return take(key)
    if _is_traced((optical, camera, key, reflection)):
        raise ValueError("rtol: got values known only inside jit, expected a call outside it, or rtol=None")
    if not rtol > 0 or max_samples < samples:
        raise ValueError(
            f"rtol, max_samples: got {rtol}, {max_samples}, expected rtol > 0 and max_samples >= samples = {samples}"
        )
    image, passes = take(key), 1
    while not _meets(image, rtol) and (passes + 1) * samples <= max_samples:
        image = _joined(image, passes, take(jax.random.fold_in(key, passes)), samples)
        passes += 1
    outcome = Outcome.tolerance_met if _meets(image, rtol) else Outcome.samples_spent
    return eqx.tree_at(lambda i: i.outcome, image, outcome, is_leaf=lambda x: isinstance(x, type(outcome)))


def _reflection_checks(scene: Scene, reflection: Reflection | None) -> list[Check]:
    return [] if reflection is None else reflection.checks(scene)


def _image(optical: Radiometry, camera: Camera, parts: tuple[Array, Array, Array], samples: int) -> Image:
    """The image of the parts of all chunks."""
    mean, variance = _untile(camera, parts[0]), _untile(camera, parts[1])
    empty = parts[2][:1, :1, 0] if parts[2].shape[2] == 1 else _untile(camera, parts[2])
    taken = jnp.asarray(samples, jnp.int32)
    return Image(mean, _sqrt(variance), empty, camera, optical.nodes.names, taken, Outcome.samples_taken)  # type: ignore


def _meets(image: Image, rtol: float) -> bool:
    return bool((image.intensity_error() <= rtol * jnp.abs(image.radiant_intensity())).all())


def _joined(image: Image, passes: int, more: Image, samples: int) -> Image:
    """The mean of an image of some passes and that of one more."""
    share = 1 / (passes + 1)
    error = jnp.sqrt(((1 - share) * image.standard_error) ** 2 + (share * more.standard_error) ** 2)
    radiance, empty = (
        (1 - share) * a + share * b for a, b in ((image.radiance, more.radiance), (image.empty, more.empty))
    )
    taken = image.samples + samples
    return Image(radiance, error, empty, image.camera, image.bands, taken, image.outcome)


@eqx.filter_jit
def _radiometry(scene: Scene, nodes: Nodes) -> Radiometry:
    return radiometry(scene, nodes)


def _chunk_size(camera: Camera, scene: Scene, reflection: Reflection | None) -> int:
    """Tiles handled at once: fewer where a ray carries many samples."""
    each = 1 if reflection is None else -(-reflection.samples(scene) // SAMPLES_AT_ONCE)
    return min(max(TILES_AT_ONCE // each, 1), camera.tiles[0] * camera.tiles[1])


def _chunks(camera: Camera, size: int) -> Int[Array, " chunk"]:
    """First tile of each chunk; the last chunk may run past the image."""
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
    reflection: Reflection | None,
    path: AbstractPathEstimator = CellSum(),  # noqa: B008
) -> tuple[Float[Array, "tile pixel band"], Float[Array, "tile pixel band"], Float[Array, "_tile _pixel band"]]:
    """Mean radiance, its variance, and what would be seen without the scene, in the pixels of one chunk of tiles."""
    size = _chunk_size(camera, optical.scene, reflection)
    start = optical.scene.radius(camera.target)
    tile = begin + jnp.arange(size, dtype=jnp.int32)
    background = optical.scene.background
    uniform = background is None or isinstance(background, AbstractUniformBackground)

    def sample(drawn: tuple[Array, Array]) -> Array:
        screen = camera.screen(tile, drawn[0]).reshape(-1, 2)
        paths = trace(optical.scene, camera.bundle(screen, start), reflection, drawn[1])
        along = None if isinstance(path, CellSum) else jax.random.fold_in(drawn[1], 1)
        seen = optical.nodes.in_band(evaluate(optical, paths, reflection, path, along))
        if not uniform:
            empty = optical.nodes.in_band(empty_radiance(optical, paths.rays.direction))
            seen = jnp.concatenate([seen, empty], axis=-1)
        return seen.reshape(size, TILE * TILE, -1)

    def stratum(carry: tuple[Array, Array], index: Array) -> tuple[tuple[Array, Array], None]:
        own = jax.random.fold_in(key, begin)
        offset = stratum_points(own, index, size, strata)
        anew = jax.random.fold_in(jax.random.fold_in(own, index), 1)
        pair = lax.map(sample, (offset, jax.random.split(anew, 2)))
        total, square = carry
        return (total + (pair[0] + pair[1]) / 2, square + (pair[0] - pair[1]) ** 2 / 4), None

    count, bands = strata[0] * strata[1], optical.nodes.response.shape[0]
    zero = jnp.zeros((size, TILE * TILE, bands if uniform else 2 * bands), start.dtype)
    (total, square), _ = lax.scan(stratum, (zero, zero), jnp.arange(count, dtype=jnp.int32))
    mean, variance = total / count, square[..., :bands] / count**2
    if uniform:
        return mean, variance, optical.nodes.in_band(empty_radiance(optical, camera.frame[:1, None]))
    return mean[..., :bands], variance, mean[..., bands:]


def _is_traced(inputs: Any) -> bool:
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(inputs))


def _over_chunks(function: Callable[[Array], Any], items: Array, inputs: Any, label: str) -> Any:
    """Map over items: one compiled loop when `inputs` are traced, else a loop on the host behind a progress bar."""
    if _is_traced(inputs):
        return lax.map(function, items)
    results = []
    for item in tqdm(items, desc=label, delay=5, leave=False):
        results.append(jax.block_until_ready(function(item)))
    return jax.tree.map(lambda *parts: jnp.stack(parts), *results)


def _eye_outside(scene: Scene, camera: Camera) -> Check:
    """Rays start on the scene's bounding sphere, so the eye must be beyond it."""
    reach = scene.radius(camera.target) * camera.inverse_range
    return Check(
        "Camera: (radius of the scene about the target) / distance",
        reach,
        reach < 1,
        "less than 1: an eye outside the scene's bounding sphere",
    )


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
    if not all(isinstance(source, ParallelSource) for source in scene.sources):
        raise ValueError("scene: got sources at a finite distance, expected parallel ones; use render or signature")
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
    reflection: Reflection | None = None,
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
    outside = jax.vmap(lambda camera: _eye_outside(scene, camera).value)(cameras)
    eye = Check("signature: (radius of the scene) / distance", outside, outside < 1, "less than 1: sensors outside it")
    reflection = reflection_of(scene, reflection)
    nodes = enforce(nodes, [*scene.checks(), *cameras.checks(), eye, *_reflection_checks(scene, reflection)])
    optical = _radiometry(scene, nodes)
    keys = jax.random.split(base, aspect.shape[0])

    def view(index: Array) -> tuple[Array, Array]:
        return _view(optical, jax.tree.map(lambda leaf: leaf[index], cameras), keys[index], strata, reflection)

    index = jnp.arange(aspect.shape[0], dtype=jnp.int32)
    intensity, error = _over_chunks(view, index, (optical, cameras, keys, reflection), "signature")
    return Signature(aspect[:, 0], aspect[:, 1], intensity, error, nodes.names)


@eqx.filter_jit
def _view(
    optical: Radiometry, camera: Camera, key: Array, strata: tuple[int, int], reflection: Reflection | None
) -> tuple[Float[Array, " band"], Float[Array, " band"]]:
    """Contrast intensity of one view and its standard error."""
    chunks = _chunks(camera, _chunk_size(camera, optical.scene, reflection))
    parts = lax.map(lambda begin: _chunk(optical, camera, key, begin, strata, reflection), chunks)
    image = _image(optical, camera, parts, 2 * strata[0] * strata[1])
    return image.radiant_intensity(), image.intensity_error()
