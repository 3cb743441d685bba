"""Traced paths that predict a measurement: traced once, evaluated at every step of a fit.

A prediction is a weighted sum of the radiance of rays, so rays that cannot differ from the empty image are dropped,
rays that must have the same radiance are merged, and what remains is laid out in slices of one row each and evaluated
a few slices at a time: the intermediate results of one step then stay in the processor's cache.
"""

from __future__ import annotations

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Key

from jaxir._arrays import as_float, known, placed
from jaxir._math import einsum
from jaxir._programs import program
from jaxir.fit._drift import density_ratio, effective_share
from jaxir.fit._measurement import Measurement
from jaxir.geometry import Camera, Crossings, Rays, hilbert_index, pixel_samples, tile_rays, view_angles
from jaxir.geometry.search import MARGIN, closest_hit
from jaxir.optics.spectrum import Nodes
from jaxir.scene import Lit, Scene, on_nodes
from jaxir.transport import Paths, evaluate, graded_cameras, store_route, trace

RAYS_BY_NODES = 1 << 16  # evaluated at once
BLOCKS = 8  # of an image's pixels, whose sampling errors are independent
SPARE = 1.1  # width of an image over what holds the scene, of jets whose outline may move
ROOMY = 2.0  # area of an image over what holds the scene, beyond which too few rays meet it
SLICE = 64  # rays in a slice, at most
CURVE = 12  # bits of the raster, along the longer side of an image, on which rays are put in order
ROUND = 8  # slices of a chunk are a multiple of it, of many an eighth, so that a few rays more compile nothing anew


class RaySum(eqx.Module):
    """Rays whose radiance is summed row by row.

    Attributes:
        paths: of the rays; every leaf has a leading axis [chunk], the rays of a chunk lie slice by slice.
        weight: 0 for a place that no ray fills [chunk, slice, place].
        group: row + (number of rows) * (half + 2 * block) of the rays of a slice [chunk, slice].
    """

    paths: Paths
    weight: Float[Array, "chunk slice place"]
    group: Int[Array, "chunk slice"]

    def add(self, lit: Lit, totals: Float[Array, "group band"]) -> Float[Array, "group band"]:
        """`totals` and the sums of weight * (L - L_empty) of every group. Differentiable as `evaluate`."""

        @jax.checkpoint  # a gradient evaluates a chunk again instead of keeping all of them
        def chunk(paths: Paths, weight: Array) -> Array:
            contrast = lit.nodes.in_band(evaluate(lit, paths) - lit.empty(paths.rays.direction))
            return einsum("sp,spb->sb", weight, contrast.reshape((*weight.shape, -1)))

        sums = lax.map(lambda each: chunk(*each), (self.paths, self.weight))
        return totals.at[self.group].add(sums)


class Observation(eqx.Module):
    """A measurement with the traced paths that predict it.

    The prediction of a row is base * L_empty + sum over its rays of weight * (L - L_empty). Rays of the two halves are
    the two independent sets of points in each pixel, so the difference of the halves' sums tells the sampling
    error, and in each block of the pixels of an intensity it tells it anew.

    Attributes:
        measurement: what was measured.
        scene: what was traced.
        through: rays on which a plume acts; None without.
        beside: rays that meet skin and on which no plume acts; None without.
        blocks: of each row's rays.
    """

    measurement: Measurement
    scene: Scene
    through: RaySum | None
    beside: RaySum | None
    blocks: int = eqx.field(static=True)

    def predict_halves(self, scene: Scene) -> Float[Array, "block 2 row band"]:
        """Predictions, each by one half of one block as if it were all; their mean is the prediction.

        Differentiable as `evaluate`.
        """
        measurement = self.measurement
        nodes, (rows, bands) = measurement.nodes, measurement.value.shape
        lit = measurement.lit(scene)
        totals = jnp.zeros((2 * self.blocks * rows, bands), measurement.value.dtype)
        if self.through is not None:
            totals = self.through.add(lit, totals)
        if self.beside is not None:
            totals = self.beside.add(lit.without_plumes(), totals)
        contrast = 2 * self.blocks * totals.reshape((self.blocks, 2, rows, bands))
        if not measurement.per_pixel:
            return contrast
        direction = measurement.cameras.frame[0, 2:]  # any: the background is uniform, see `observe`
        return contrast + nodes.in_band(lit.empty(direction))[None, None]

    @program
    def effective_share(self, scene: Scene) -> Float[Array, ""]:
        """Effective share of the directions that the traced brdf drew when they serve another scene, see `drift`."""
        ratios = [
            lax.map(lambda p: density_ratio(p, self.scene, scene), rays.paths)
            for rays in (self.through, self.beside)
            if rays is not None
        ]
        return effective_share(jnp.concatenate([ratio.reshape(-1) for ratio in ratios]))

    def holds(self, scene: Scene) -> bool:
        """Whether the images and the starts of the rays still hold the outline of another scene, and no more."""
        return not scene.plumes or bool(_held(self, scene))


@program
def _held(observation: Observation, scene: Scene) -> Bool[Array, ""]:
    given = observation.measurement.cameras
    reach = [jax.vmap(s.radius)(given.target) for s in (scene, observation.scene)]
    starts = (reach[0] <= MARGIN * reach[1]).all()  # rays start so far outside
    if observation.measurement.per_pixel:
        return starts
    wanted = _pixels_wanted(given, scene)
    large = jnp.prod(given.pixel, axis=1) <= ROOMY * jnp.prod(wanted, axis=1)
    return starts & (wanted <= given.pixel).all() & large.all()


def observe(scene: Scene, measurement: Measurement, key: Key[Array, ""], moving: bool) -> Observation:
    """Trace the rays that predict a measurement.

    Args:
        scene: its geometry is traced.
        measurement: what to predict; images of intensities are widened where they do not hold the scene.
        key: random key of the points in the pixels and of sampled light.
        moving: whether a fit may move the outline of a jet, so that a ray that misses it now may meet it later.

    Returns:
        The observation. Runs on the host: the number of kept rays depends on the scene.

    Raises:
        ValueError: no ray meets anything, images are fitted before a background that is not uniform, or values are
            known only inside jit.
    """
    if any(known(leaf) is None for leaf in jax.tree.leaves((scene, measurement))):
        raise ValueError("measurement, scene: got traced values (inside jit), expected a call outside it")
    background = scene.background
    if measurement.per_pixel and not (background is None or background.uniform):
        raise ValueError(f"measurement: got images before a {type(background).__name__}, expected a uniform background")
    room = as_float(SPARE if moving else 1.0)
    measurement = eqx.tree_at(lambda m: m.cameras, measurement, _widened(measurement, scene, room))
    for_pixels, for_through, for_beside = jax.random.split(key, 3)
    merging = not scene.plumes and _alike(scene, measurement)  # rays of one block alone merge
    blocks = 1 if measurement.per_pixel or merging else BLOCKS
    views = []
    cameras = jax.tree.map(np.asarray, measurement.cameras)
    for view in range(cameras.pixel.shape[0]):
        camera = jax.tree.map(lambda leaf, view=view: placed(leaf[view]), cameras)
        rays = _rays_of_view(scene, camera, placed(np.int32(view)), for_pixels, measurement.samples)
        views.append(_with_rows(rays, view, measurement, blocks))
    rays = jax.tree.map(lambda *leaves: np.concatenate(leaves), *views)
    crosses, on_skin = np.asarray(rays.crosses), np.asarray(rays.face) >= 0
    if not (crosses | on_skin).any():
        raise ValueError("measurement: got views in which no ray meets skin or plume, expected the scene in view")
    if moving:
        crosses = np.ones_like(crosses)
    elif scene.plumes and _lit_by_others(scene, measurement):
        crosses = crosses | on_skin  # the plume dims or sends the light that the skin reflects
    through = _gather(rays, np.flatnonzero(crosses))
    bare = scene if scene.skin is None else eqx.tree_at(lambda s: s.plumes, scene, ())
    beside = _merged(bare, measurement, _gather(rays, np.flatnonzero(on_skin & ~crosses)))
    sums = ray_sum(scene, measurement, through, for_through), ray_sum(bare, measurement, beside, for_beside)
    return Observation(measurement, scene, *sums, blocks)


def _lit_by_others(scene: Scene, measurement: Measurement) -> bool:
    """Whether the skin reflects anything."""
    method = measurement.method.resolved(scene)
    return bool(scene.delta_sources) or method.direct is not None or method.bounces > 0


@program
def _widened(measurement: Measurement, scene: Scene, room: Float[Array, ""]) -> Camera:
    """Cameras of intensities with pixels large enough for images that hold the scene; other cameras as they are.

    Images are `room` times as wide at least as what holds the scene.
    """
    cameras = measurement.cameras
    if measurement.per_pixel:
        return cameras
    return eqx.tree_at(lambda c: c.pixel, cameras, jnp.maximum(cameras.pixel, room * _pixels_wanted(cameras, scene)))


def _pixels_wanted(cameras: Camera, scene: Scene) -> Float[Array, "view 2"]:
    """How large pixels must be at least for images that hold a scene."""
    extent = scene.extent()

    def wanted(camera: Camera) -> Array:
        half = jnp.max(jnp.abs(camera.project(extent)), axis=0)
        rows, columns = camera.shape
        return 2 * half / jnp.asarray([columns, rows], half.dtype)

    return jax.vmap(wanted)(cameras)


def reframed(measurement: Measurement, scene: Scene) -> Measurement:
    """The same with images of intensities made for another scene, whose jets a fit has moved."""
    if measurement.per_pixel or not scene.plumes:
        return measurement
    cameras = jax.tree.map(np.asarray, measurement.cameras)
    aspect = as_float(view_angles(cameras.frame))
    with np.errstate(divide="ignore"):
        distance = 1 / cameras.inverse_range[0]
    made = graded_cameras(on_nodes(scene, measurement.nodes), aspect, cameras.shape, as_float(distance))
    return dataclasses.replace(measurement, cameras=made)


class ViewRays(eqx.Module):
    """Rays of views: weight, group as in `RaySum`, face met or -1, whether the plume acts on them [ray]."""

    rays: Rays
    weight: Float[Array, " ray"]
    group: Int[Array, " ray"]
    face: Int[Array, " ray"]
    crosses: Bool[Array, " ray"]


@program
def _rays_of_view(scene: Scene, camera: Camera, view: Int[Array, ""], key: Array, samples: int) -> ViewRays:
    """All rays of one view, along a curve that fills its image.

    Weights are those of an intensity, `group` is pixel + (number of pixels) * half, or -1.
    """
    key = jax.random.fold_in(key, view)
    edges = jnp.asarray(camera.tile_edges())
    offset = pixel_samples(key, edges.shape[0], samples)
    count = 2 * offset.shape[0]
    # on the sphere, if that is further out: a jet may grow inside it, see `Observation.holds`
    start = jnp.maximum(scene.start(camera), scene.radius(camera.target))
    bundle = tile_rays(camera, edges, offset, start)
    rays = bundle.rays()
    reach = jnp.full_like(rays.origin[:, 0], jnp.inf)
    face = jnp.full(reach.shape, -1, jnp.int32)
    if scene.skin is not None:
        hit = closest_hit(scene.skin.mesh, bundle)
        reach, face = hit.t, hit.face
    crosses = jnp.zeros(reach.shape, bool)
    if scene.plume is not None:
        crosses = scene.plume.meets(rays, reach)
    pixel = jnp.asarray(camera.pixel_index())
    area = camera.pixel_area().reshape(-1)[jnp.maximum(pixel, 0)]

    def spread(value: Array) -> Array:
        return jnp.repeat(value.reshape(-1), count)

    half = jnp.tile(jnp.arange(count, dtype=jnp.int32) % 2, pixel.size)
    group = jnp.where(spread(pixel) >= 0, spread(pixel) + camera.shape[0] * camera.shape[1] * half, -1)
    size = camera.pixel * max(camera.shape)
    cell = jnp.clip((bundle.screen / size[None, :] + 0.5) * 2**CURVE, 0, 2**CURVE - 1).astype(jnp.int32)
    order = jnp.argsort(hilbert_index(cell[:, 0], cell[:, 1], CURVE))
    return jax.tree.map(lambda leaf: leaf[order], ViewRays(rays, spread(area / samples), group, face, crosses))


def _with_rows(rays: ViewRays, view: int, measurement: Measurement, blocks: int) -> ViewRays:
    """Groups and weights of a measurement; rays beyond an image's edge dropped.

    Blocks are diagonal lines of pixels, so that all are alike and a straight edge crosses all.
    """
    rays = _gather(rays, np.flatnonzero(np.asarray(rays.group) >= 0))
    if measurement.per_pixel:
        return eqx.tree_at(lambda r: r.weight, rays, np.full_like(rays.weight, 1 / measurement.samples))
    height, width = measurement.cameras.shape
    half, pixel = np.divmod(rays.group, height * width)
    block = (pixel % width + 3 * (pixel // width)) % blocks
    rows = measurement.value.shape[0]
    return eqx.tree_at(lambda r: r.group, rays, (view + rows * (half + 2 * block)).astype(np.int32))


def _gather(rays: ViewRays, index: np.ndarray) -> ViewRays:
    return jax.tree.map(lambda leaf: np.asarray(leaf)[index], rays)  # on the host: every number of rays is another


def _merged(scene: Scene, measurement: Measurement, rays: ViewRays) -> ViewRays:
    """One ray for all of one group that meet one face with the same sources in sight, where they are `_alike`."""
    if not _alike(scene, measurement) or rays.face.size == 0:
        return rays
    method = measurement.method.resolved(scene)
    kinds = [np.asarray(rays.group), np.asarray(rays.face)]
    if scene.delta_sources:
        vertex = trace(scene, rays.rays, method).first.vertex
        assert vertex is not None
        kinds += list(np.asarray(vertex.visible))
    _, first, kind = np.unique(np.stack(kinds), axis=1, return_index=True, return_inverse=True)
    weight = np.bincount(kind.reshape(-1), np.asarray(rays.weight, np.float64))
    return eqx.tree_at(lambda r: r.weight, _gather(rays, first), jnp.asarray(weight, rays.weight.dtype))


def _alike(scene: Scene, measurement: Measurement) -> bool:
    """Whether all rays of a view that meet one face with the same sources in sight have the same radiance.

    So they have where they have one direction and light comes from parallel sources alone. That of others changes over
    a face, in closed form, too.
    """
    parallel = not scene.area_sources and all(source.travel is not None for source in scene.delta_sources)
    far = not bool((np.asarray(measurement.cameras.inverse_range) > 0).any())
    return far and parallel and not measurement.method.resolved(scene).needs_key(scene)


def ray_sum(scene: Scene, measurement: Measurement, rays: ViewRays | None, key: Array) -> RaySum | None:
    """Trace rays and lay them out."""
    if rays is None or rays.face.size == 0:
        return None
    index, gap, group = _layout(np.asarray(rays.group), measurement.nodes)
    laid = _gather(rays, index.reshape(index.shape[0], -1))
    paths = _trace_chunks(scene, laid.rays, measurement, jax.random.split(key, index.shape[0]))
    if isinstance(paths.route, Crossings):
        longest = max(1, int(jax.vmap(lambda c: c.longest())(paths.route).max()))
        trimmed = jax.vmap(lambda c: c.trim(longest))(paths.route)
        paths = eqx.tree_at(lambda p: p.route, paths, trimmed)
    weight = jnp.where(gap, 0, laid.weight.reshape(index.shape))
    return RaySum(paths, weight, jnp.asarray(group, jnp.int32))


@program
def _trace_chunks(scene: Scene, rays: Rays, measurement: Measurement, keys: Array) -> Paths:
    def chunk(each: tuple[Rays, Array]) -> Paths:
        return store_route(scene, trace(scene, each[0], measurement.method, each[1]))

    return lax.map(chunk, (rays, keys))


def _layout(group: np.ndarray, nodes: Nodes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which ray lies where [chunk, slice, place], places without a ray likewise, group of each slice [chunk, slice].

    Sums over groups are then plain reductions; a scatter of every ray is far slower on a CPU.
    """
    order = np.argsort(group, kind="stable")
    _, first, counts = np.unique(group[order], return_index=True, return_counts=True)
    widths = [SLICE >> k for k in range(SLICE.bit_length())]  # few, so that a few rays more compile nothing anew
    places = min(widths, key=lambda width: int((-(-counts // width)).sum()) * (width + 1))  # the fewest empty places
    slices = -(-counts // places)
    begin = np.repeat(first, slices) + places * (
        np.arange(slices.sum()) - np.repeat(np.cumsum(slices) - slices, slices)
    )
    end = np.repeat(first + counts, slices)
    chunks = -(-begin.size * places * nodes.count // RAYS_BY_NODES)
    each = -(-begin.size // chunks)
    step = max(ROUND, (1 << each.bit_length()) // 16)
    each = -(-each // step) * step
    chunks = -(-begin.size // each)
    begin, end = (np.pad(edge, (0, chunks * each - edge.size)).reshape(chunks, each) for edge in (begin, end))
    place = begin[..., None] + np.arange(places)
    gap = place >= end[..., None]
    index = order[np.where(gap, begin[..., None], place)]
    return index, gap, group[index[..., 0]]
