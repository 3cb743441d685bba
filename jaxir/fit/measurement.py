"""What was measured, and the traced paths that predict it: traced once, evaluated at every step of a fit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from jaxir._arrays import Check, as_float, enforce, positive
from jaxir.geometry.camera import Camera, fitted_camera, pixel_samples
from jaxir.geometry.mesh import closest_hit
from jaxir.geometry.ray import Rays
from jaxir.optics.band import Band, Nodes, as_nodes
from jaxir.scene.background import AbstractUniformBackground
from jaxir.scene.jet import JetPlume
from jaxir.scene.scene import Scene
from jaxir.transport.evaluate import empty_radiance, evaluate
from jaxir.transport.march import optical_depth
from jaxir.transport.paths import Paths, store_crossings, trace
from jaxir.transport.radiometry import radiometry


class Measurement(eqx.Module):
    """Numbers with standard deviations, and how a scene predicts them.

    Attributes:
        value: measured [row, band].
        standard_deviation: of each value [row, band].
        cameras: the views, stacked leaf by leaf [view, ...].
        nodes: spectral axis of the prediction.
        samples: rays per pixel; even.
        per_pixel: whether each row is a pixel's radiance (one view) or a view's radiant intensity.
    """

    value: Float[Array, "row band"]
    standard_deviation: Float[Array, "row band"]
    cameras: Camera
    nodes: Nodes
    samples: int = eqx.field(static=True)
    per_pixel: bool = eqx.field(static=True)

    def checks(self) -> list[Check]:
        """Values are finite, standard deviations positive."""
        return [
            Check("measurement.value", self.value, jnp.isfinite(self.value), "finite values"),
            positive("measurement.standard_deviation", self.standard_deviation),
        ]


def measured_intensity(
    scene: Scene,
    views: Any,
    bands: Nodes | Band | Sequence[Band],
    value: Any,
    standard_deviation: Any,
    *,
    distance: Any = np.inf,
    shape: tuple[int, int] = (64, 64),
    samples: int = 2,
) -> Measurement:
    """Measured contrast intensities over aspects, as `signature` predicts them.

    Args:
        scene: whose outline the images must hold; only its geometry is used.
        views: azimuth and elevation [view, 2] [deg].
        bands: bands or nodes.
        value: [view, band] [W sr-1].
        standard_deviation: of each value, or one for all [W sr-1].
        distance: from the scene to the sensor [m].
        shape: rows and columns of the images that predict.
        samples: rays per pixel; even.

    Returns:
        The measurement.

    Raises:
        ValueError: shapes disagree, values are not finite, standard deviations not positive.
    """
    nodes = as_nodes(bands)
    aspect = as_float(views, "views")
    if aspect.ndim != 2 or aspect.shape[1] != 2:
        raise ValueError(f"views: got shape {aspect.shape}, expected (view, 2): azimuth and elevation in degrees")
    extent = scene.extent()
    cameras = jax.vmap(lambda a: fitted_camera(a[0], a[1], extent, shape, distance))(aspect)
    wanted = (aspect.shape[0], len(nodes.names))
    return _measurement(value, standard_deviation, wanted, cameras, nodes, samples, per_pixel=False)


def measured_image(
    camera: Camera,
    bands: Nodes | Band | Sequence[Band],
    value: Any,
    standard_deviation: Any,
    *,
    samples: int = 2,
) -> Measurement:
    """A measured radiance image; an image of one pixel is a measured band radiance.

    Args:
        camera: the view.
        bands: bands or nodes.
        value: [row, column, band] [W m-2 sr-1].
        standard_deviation: of each value, or one for all.
        samples: rays per pixel; even.

    Returns:
        The measurement.

    Raises:
        ValueError: as `measured_intensity`.
    """
    nodes = as_nodes(bands)
    wanted = (*camera.shape, len(nodes.names))
    one = jax.tree.map(lambda leaf: leaf[None], camera)
    return _measurement(value, standard_deviation, wanted, one, nodes, samples, per_pixel=True)


def _measurement(
    value: Any, deviation: Any, shape: tuple[int, ...], cameras: Camera, nodes: Nodes, samples: int, per_pixel: bool
) -> Measurement:
    numbers, spread = as_float(value, "measurement.value"), as_float(deviation, "measurement.standard_deviation")
    if numbers.shape != shape:
        raise ValueError(f"measurement.value: got shape {numbers.shape}, expected {shape}: views or pixels, then bands")
    if spread.shape not in ((), shape):
        raise ValueError(f"measurement.standard_deviation: got shape {spread.shape}, expected one value or {shape}")
    flat = (-1, shape[-1])
    spread = jnp.broadcast_to(spread, shape).reshape(flat)
    made = Measurement(numbers.reshape(flat), spread, cameras, nodes, samples, per_pixel)
    return enforce(made, made.checks())


class Observation(eqx.Module):
    """A measurement with the traced paths that predict it.

    The prediction of a row is base * L_empty + sum over its rays of weight * (L - L_empty): rays that meet nothing
    contribute exactly nothing and are not kept. Rays of the two halves are the two independent points of each stratum
    of a pixel, so the difference of the halves' predictions tells the sampling error.

    Attributes:
        measurement: what was measured.
        paths: of the rays that meet skin or plume.
        weight: of each ray in its row, half of the rays by half, rows present only [group, place].
        group: row + (number of rows) * half of each group present [group].
    """

    measurement: Measurement
    paths: Paths
    weight: Float[Array, "group place"]
    group: Int[Array, " group"]

    def predict_halves(self, scene: Scene) -> Float[Array, "2 row band"]:
        """Predictions of both halves of the rays; their mean is the prediction. Differentiable as `evaluate`."""
        nodes = self.measurement.nodes
        optical = radiometry(scene, nodes)
        empty = nodes.in_band(empty_radiance(optical, self.paths.rays.direction))
        rows, bands = self.measurement.value.shape
        contrast = nodes.in_band(evaluate(optical, self.paths)) - empty
        sums = 2 * jnp.einsum("gp,gpb->gb", self.weight, contrast.reshape((*self.weight.shape, bands)))
        spread = jnp.zeros((2 * rows, bands), sums.dtype).at[self.group].set(sums)
        base = empty[0] if self.measurement.per_pixel else jnp.zeros_like(empty[0])  # uniform: see `observe`
        return spread.reshape((2, rows, bands)) + base[None, None, :]


def observe(scene: Scene, measurement: Measurement, key: Key[Array, ""]) -> Observation:
    """Trace the rays that predict a measurement and keep those that meet something.

    Args:
        scene: its geometry is traced.
        measurement: what to predict.
        key: random key of the points in the pixels.

    Returns:
        The observation. Runs on the host: the number of kept rays depends on the scene.

    Raises:
        ValueError: no ray meets anything, or images are fitted before a background that is not uniform.
    """
    background = scene.background
    if measurement.per_pixel and not (background is None or isinstance(background, AbstractUniformBackground)):
        raise ValueError(f"measurement: got images before a {type(background).__name__}, expected a uniform background")
    found = []
    for view in range(measurement.cameras.pixel.shape[0]):
        camera = jax.tree.map(lambda leaf, index=view: leaf[index], measurement.cameras)
        rays = _rays_of_view(scene, camera, jax.random.fold_in(key, view), measurement.samples)
        index = np.flatnonzero(np.asarray(rays.meets))
        found.append((view, jax.tree.map(lambda leaf, index=index: leaf[index], rays)))
    rays = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *(rays for _, rays in found))
    if rays.pixel.shape[0] == 0:
        raise ValueError("measurement: got views in which no ray meets skin or plume, expected the scene in view")
    if measurement.per_pixel:
        row, weight = rays.pixel, jnp.full_like(rays.weight, 1 / measurement.samples)
    else:
        counts = [part.pixel.shape[0] for _, part in found]
        row, weight = jnp.asarray(np.repeat([view for view, _ in found], counts), jnp.int32), rays.weight
    group = np.asarray(row) + measurement.value.shape[0] * np.asarray(rays.second)
    present, index, gap = _table(group)
    paths = store_crossings(
        scene, trace(scene, jax.tree.map(lambda leaf: leaf[index.reshape(-1)], rays.rays), None, key)
    )
    if paths.crossings is not None:
        longest = int(paths.crossings.longest())
        paths = eqx.tree_at(lambda p: p.crossings, paths, paths.crossings.trim(max(1, longest)))
    return Observation(measurement, paths, jnp.where(gap, 0, weight[index]), jnp.asarray(present, jnp.int32))


def _table(group: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rays of each group side by side: groups present, ray of each place [group, place], places to be left out.

    Sums over groups are then plain reductions; a scatter of every ray is far slower on a CPU.
    """
    present, counts = np.unique(group, return_counts=True)
    order = np.argsort(group, kind="stable")
    first = np.cumsum(counts) - counts
    place = np.arange(counts.max())
    gap = place[None, :] >= counts[:, None]
    index = order[np.where(gap, first[:, None], first[:, None] + place[None, :])]
    return present, index, gap


class _RaysOfView(eqx.Module):
    """All rays of one view: pixel, weight for the intensity, half, and whether they meet anything [ray]."""

    rays: Rays
    pixel: Int[Array, " ray"]
    weight: Float[Array, " ray"]
    second: Int[Array, " ray"]
    meets: Bool[Array, " ray"]


@eqx.filter_jit
def _rays_of_view(scene: Scene, camera: Camera, key: Array, samples: int) -> _RaysOfView:
    tile = jnp.arange(camera.tiles[0] * camera.tiles[1], dtype=jnp.int32)
    offset = pixel_samples(key, tile.shape[0], samples)
    count = 2 * offset.shape[0]
    screen = jax.vmap(lambda o: camera.screen(tile, o))(offset.reshape((count, *offset.shape[2:])))
    bundle = camera.bundle(screen.reshape(-1, 2), scene.radius(camera.target))
    rays = bundle.rays()
    reach = jnp.full_like(rays.origin[:, 0], jnp.inf)
    meets = jnp.zeros(reach.shape, bool)
    if scene.skin is not None:
        meets = meets | (closest_hit(scene.skin.mesh, bundle).face >= 0)
    if isinstance(scene.plume, JetPlume):
        meets = jnp.ones_like(meets)  # a fit may move the jet anywhere
    elif scene.plume is not None:
        box = jnp.ones((*scene.plume.grid.shape, 1), reach.dtype)
        meets = meets | (optical_depth(scene.plume.grid, box, rays, reach)[:, 0] > 0)
    pixel = camera.pixel_index(tile)
    area = camera.pixel_area().reshape(-1)[jnp.maximum(pixel, 0)]
    second = jnp.broadcast_to(jnp.arange(count, dtype=jnp.int32)[:, None, None] % 2, (count, *pixel.shape))

    def spread(value: Array) -> Array:
        return jnp.broadcast_to(value[None], (count, *value.shape)).reshape(-1)

    return _RaysOfView(rays, spread(pixel), spread(area / samples), second.reshape(-1), meets & (spread(pixel) >= 0))
