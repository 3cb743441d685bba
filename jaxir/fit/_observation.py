"""Traced paths that predict a measurement: traced once, evaluated at every step of a fit.

A prediction is a weighted sum of the radiance of rays, so rays that cannot differ from the empty image are dropped,
rays that must have the same radiance are merged, and what remains is laid out in slices of one row each and evaluated
a few slices at a time: the intermediate results of one step then stay in the processor's cache.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Key

from jaxir.fit._measurement import Measurement
from jaxir.geometry import Camera, Rays, hilbert_index, pixel_samples
from jaxir.geometry.search import closest_hit
from jaxir.optics.spectrum import Nodes
from jaxir.scene.background import AbstractUniformBackground
from jaxir.scene.jet import JetPlume
from jaxir.scene.scene import Scene
from jaxir.scene.source import ParallelSource
from jaxir.transport.drift import density_ratio, effective_share
from jaxir.transport.evaluate import empty_radiance, evaluate
from jaxir.transport.jet import meets_jet
from jaxir.transport.march import optical_depth
from jaxir.transport.paths import Paths, store_crossings, trace
from jaxir.transport.radiometry import Radiometry, radiometry
from jaxir.transport.reflection import Reflection, reflection_of

RAYS_BY_NODES = 1 << 16  # evaluated at once
SLICE = 64  # rays in a slice, at most
LEADING = 32  # rays of each half of a row that lead a jet near the solution
STEERING = 448  # that tell the slopes there: standard deviations within 0.2 to 1.6 % of those of all, for eight keys
CURVE = 12  # bits of the raster, along the longer side of an image, on which rays are put in order
ROUND = 8  # slices of a chunk are a multiple of it, so that a few rays more or less compile nothing anew
EVEN = 0.1  # share of those that lead spread evenly, the rest where the radiance is
EVEN_STEERING = 0.5  # of those that steer: a jet's length, say, acts where it is dim


class RaySum(eqx.Module):
    """Rays whose radiance is summed row by row.

    Attributes:
        paths: of the rays; every leaf has a leading axis [chunk], the rays of a chunk lie slice by slice.
        weight: 0 for a place that no ray fills [chunk, slice, place].
        group: row + (number of rows) * half of the rays of a slice [chunk, slice].
    """

    paths: Paths
    weight: Float[Array, "chunk slice place"]
    group: Int[Array, "chunk slice"]

    def add(
        self, optical: Radiometry, reflection: Reflection | None, totals: Float[Array, "group band"]
    ) -> Float[Array, "group band"]:
        """`totals` and the sums of weight * (L - L_empty) of every group. Differentiable as `evaluate`."""
        nodes = optical.nodes

        @jax.checkpoint  # a gradient evaluates a chunk again instead of keeping all of them
        def chunk(paths: Paths, weight: Array) -> Array:
            empty = empty_radiance(optical, paths.rays.direction)
            contrast = nodes.in_band(evaluate(optical, paths, reflection) - empty)
            return jnp.einsum("sp,spb->sb", weight, contrast.reshape((*weight.shape, -1)))

        sums = lax.map(lambda each: chunk(*each), (self.paths, self.weight))
        return totals.at[self.group].add(sums)

    @eqx.filter_jit
    def parts(self, scene: Scene, measurement: Measurement) -> Float[Array, "chunk slice place band"]:
        """Magnitude of what each ray adds to its row."""
        optical = radiometry(scene, measurement.nodes)

        def chunk(each: tuple[Paths, Array]) -> Array:
            paths, weight = each
            empty = empty_radiance(optical, paths.rays.direction)
            contrast = optical.nodes.in_band(evaluate(optical, paths, measurement.reflection) - empty)
            return jnp.abs(weight[..., None] * contrast.reshape((*weight.shape, -1)))

        return lax.map(chunk, (self.paths, self.weight))


class Observation(eqx.Module):
    """A measurement with the traced paths that predict it.

    The prediction of a row is base * L_empty + sum over its rays of weight * (L - L_empty). Rays of the two halves are
    the two independent points of each stratum of a pixel, so the difference of the halves' predictions tells the
    sampling error.

    Attributes:
        measurement: what was measured.
        scene: what was traced.
        through: rays on which a plume acts; None without.
        leading: few rays that stand for `through` on the way to a solution; None where all are needed.
        steering: more, that tell its slopes; None where all are needed.
        beside: rays that meet skin and on which no plume acts; None without.
        lacking: what is added to the predictions of both halves [2, row, band]; None where `through` is all rays.
    """

    measurement: Measurement
    scene: Scene
    through: RaySum | None
    leading: RaySum | None
    steering: RaySum | None
    beside: RaySum | None
    lacking: Float[Array, "2 row band"] | None

    def predict_halves(self, scene: Scene) -> Float[Array, "2 row band"]:
        """Predictions of both halves of the rays; their mean is the prediction. Differentiable as `evaluate`."""
        measurement = self.measurement
        nodes, (rows, bands) = measurement.nodes, measurement.value.shape
        optical = radiometry(scene, nodes)
        totals = jnp.zeros((2 * rows, bands), measurement.value.dtype)
        if self.through is not None:
            totals = self.through.add(optical, measurement.reflection, totals)
        if self.beside is not None:
            clear = eqx.tree_at(lambda o: o.medium, optical, None, is_leaf=lambda x: x is None)
            totals = self.beside.add(clear, measurement.reflection, totals)
        contrast = 2 * totals.reshape((2, rows, bands))
        if self.lacking is not None:
            contrast = contrast + self.lacking
        if not measurement.per_pixel:
            return contrast
        direction = measurement.cameras.frame[0, 2:]  # any: the background is uniform, see `observe`
        return contrast + nodes.in_band(empty_radiance(optical, direction))[None]

    def fewer(self, rays: RaySum | None) -> Observation:
        """The same measurement, predicted by fewer rays where there are such."""
        if rays is None:
            return eqx.tree_at(lambda o: (o.leading, o.steering), self, (None, None), is_leaf=lambda x: x is None)
        lacking = jnp.zeros((2, *self.measurement.value.shape), self.measurement.value.dtype)
        return Observation(self.measurement, self.scene, rays, None, None, self.beside, lacking)

    def raised(self, residual: Float[Array, "2 row band"]) -> Observation:
        """The same observation with predictions raised by residuals; as it is where `through` is all rays."""
        if self.lacking is None:
            return self
        more = self.lacking + residual * self.measurement.standard_deviation[None]
        return eqx.tree_at(lambda o: o.lacking, self, more)

    @eqx.filter_jit
    def effective_share(self, scene: Scene) -> Float[Array, ""]:
        """Effective share of the directions that the traced brdf drew when they serve another scene, see `drift`."""
        ratios = [
            lax.map(lambda p: density_ratio(p, self.measurement.reflection, self.scene, scene), rays.paths)
            for rays in (self.through, self.beside)
            if rays is not None
        ]
        return effective_share(jnp.concatenate([ratio.reshape(-1) for ratio in ratios]))

    def holds(self, scene: Scene) -> bool:
        """Whether the images and the starts of the rays still hold the outline of another scene."""
        return not isinstance(scene.plume, JetPlume) or bool(_held(self, scene))


@eqx.filter_jit
def _held(observation: Observation, scene: Scene) -> Bool[Array, ""]:
    cameras = _widened(observation.measurement, scene)
    same = (cameras.pixel <= observation.measurement.cameras.pixel).all()
    reach = [jax.vmap(s.radius)(cameras.target) for s in (scene, observation.scene)]
    return same & (reach[0] <= reach[1]).all()


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
        ValueError: no ray meets anything, or images are fitted before a background that is not uniform.
    """
    background = scene.background
    if measurement.per_pixel and not (background is None or isinstance(background, AbstractUniformBackground)):
        raise ValueError(f"measurement: got images before a {type(background).__name__}, expected a uniform background")
    measurement = eqx.tree_at(lambda m: m.cameras, measurement, _widened(measurement, scene))
    views = []
    for view in range(measurement.cameras.pixel.shape[0]):
        camera = jax.tree.map(lambda leaf, index=view: leaf[index], measurement.cameras)
        rays = _rays_of_view(scene, camera, jax.random.fold_in(key, view), measurement.samples)
        views.append(_with_rows(rays, view, measurement))
    rays = jax.tree.map(lambda *leaves: np.concatenate(leaves), *views)
    crosses, on_skin = np.asarray(rays.crosses), np.asarray(rays.face) >= 0
    if not (crosses | on_skin).any():
        raise ValueError("measurement: got views in which no ray meets skin or plume, expected the scene in view")
    if moving:
        crosses = np.ones_like(crosses)
    elif scene.plume is not None and (scene.sources or reflection_of(scene, measurement.reflection) is not None):
        crosses = crosses | on_skin  # the plume dims or sends the light that the skin reflects
    through = _gather(rays, np.flatnonzero(crosses))
    bare = scene if scene.skin is None or scene.plume is None else eqx.tree_at(lambda s: s.plume, scene, None)
    beside = _merged(bare, measurement, _gather(rays, np.flatnonzero(on_skin & ~crosses)))
    full = _ray_sum(scene, measurement, through, key)
    leading, steering = (_ray_sum(scene, measurement, some, key) for some in _thinned(scene, measurement, full))
    return Observation(measurement, scene, full, leading, steering, _ray_sum(bare, measurement, beside, key), None)


def _widened(measurement: Measurement, scene: Scene) -> Camera:
    """Cameras of intensities with pixels large enough for images that hold the scene; other cameras as they are."""
    cameras = measurement.cameras
    if measurement.per_pixel:
        return cameras
    extent = scene.extent()

    def widen(camera: Camera) -> Array:
        half = jnp.max(jnp.abs(camera.project(extent)), axis=0)
        rows, columns = camera.shape
        return jnp.maximum(camera.pixel, 2 * half / jnp.asarray([columns, rows], half.dtype))

    return eqx.tree_at(lambda c: c.pixel, cameras, jax.vmap(widen)(cameras))


class _ViewRays(eqx.Module):
    """Rays of views: weight, group as in `RaySum`, face met or -1, whether the plume acts on them [ray]."""

    rays: Rays
    weight: Float[Array, " ray"]
    group: Int[Array, " ray"]
    face: Int[Array, " ray"]
    crosses: Bool[Array, " ray"]


@eqx.filter_jit
def _rays_of_view(scene: Scene, camera: Camera, key: Array, samples: int) -> _ViewRays:
    """All rays of one view, along a curve that fills its image.

    Weights are those of an intensity, `group` is pixel + (number of pixels) * half, or -1.
    """
    tile = jnp.arange(camera.tiles[0] * camera.tiles[1], dtype=jnp.int32)
    offset = pixel_samples(key, tile.shape[0], samples)
    count = 2 * offset.shape[0]
    screen = jax.vmap(lambda o: camera.screen(tile, o))(offset.reshape((count, *offset.shape[2:]))).reshape(-1, 2)
    # on the sphere, if that is further out: a jet may grow inside it, see `Observation.holds`
    start = jnp.maximum(scene.start(camera), scene.radius(camera.target))
    bundle = camera.bundle(screen, start)
    rays = bundle.rays()
    reach = jnp.full_like(rays.origin[:, 0], jnp.inf)
    face = jnp.full(reach.shape, -1, jnp.int32)
    if scene.skin is not None:
        hit = closest_hit(scene.skin.mesh, bundle)
        reach, face = hit.t, hit.face
    crosses = jnp.zeros(reach.shape, bool)
    if isinstance(scene.plume, JetPlume):
        crosses = meets_jet(scene.plume, rays, reach)
    elif scene.plume is not None:
        box = jnp.ones((*scene.plume.grid.shape, 1), reach.dtype)
        crosses = optical_depth(scene.plume.grid, box, rays, reach)[:, 0] > 0
    pixel = camera.pixel_index(tile)
    area = camera.pixel_area().reshape(-1)[jnp.maximum(pixel, 0)]

    def spread(value: Array) -> Array:
        return jnp.broadcast_to(value[None], (count, *value.shape)).reshape(-1)

    half = jnp.repeat(jnp.arange(count, dtype=jnp.int32) % 2, pixel.size)
    group = jnp.where(spread(pixel) >= 0, spread(pixel) + camera.shape[0] * camera.shape[1] * half, -1)
    size = camera.pixel * max(camera.shape)
    cell = jnp.clip((screen / size[None, :] + 0.5) * 2**CURVE, 0, 2**CURVE - 1).astype(jnp.int32)
    order = jnp.argsort(hilbert_index(cell[:, 0], cell[:, 1], CURVE))
    return jax.tree.map(lambda leaf: leaf[order], _ViewRays(rays, spread(area / samples), group, face, crosses))


def _with_rows(rays: _ViewRays, view: int, measurement: Measurement) -> _ViewRays:
    """Groups and weights of a measurement; rays beyond an image's edge dropped."""
    rays = _gather(rays, np.flatnonzero(np.asarray(rays.group) >= 0))
    if measurement.per_pixel:
        return eqx.tree_at(lambda r: r.weight, rays, np.full_like(rays.weight, 1 / measurement.samples))
    pixels = measurement.cameras.shape[0] * measurement.cameras.shape[1]
    rows = measurement.value.shape[0]
    return eqx.tree_at(lambda r: r.group, rays, view + rows * (rays.group >= pixels).astype(np.int32))


def _gather(rays: _ViewRays, index: np.ndarray) -> _ViewRays:
    return jax.tree.map(lambda leaf: np.asarray(leaf)[index], rays)  # on the host: every number of rays is another


def _merged(scene: Scene, measurement: Measurement, rays: _ViewRays) -> _ViewRays:
    """One ray for all that meet one face in one view with the same sources in sight.

    They have the same radiance where every ray of a view has one direction and light comes from parallel sources
    alone.
    """
    parallel = all(isinstance(source, ParallelSource) for source in scene.sources)
    alike = parallel and reflection_of(scene, measurement.reflection) is None
    if not alike or bool((measurement.cameras.inverse_range > 0).any()) or rays.face.size == 0:
        return rays
    kinds = [np.asarray(rays.group), np.asarray(rays.face)]
    if scene.sources:
        lit = eqx.filter_jit(trace)(scene, rays.rays).lit
        assert lit is not None
        kinds += list(np.asarray(lit))
    _, first, kind = np.unique(np.stack(kinds), axis=1, return_index=True, return_inverse=True)
    weight = np.bincount(kind.reshape(-1), np.asarray(rays.weight, np.float64))
    return eqx.tree_at(lambda r: r.weight, _gather(rays, first), jnp.asarray(weight, rays.weight.dtype))


def _thinned(
    scene: Scene, measurement: Measurement, through: RaySum | None
) -> tuple[_ViewRays | None, _ViewRays | None]:
    """About `LEADING` and `STEERING` rays in each group that stand for all rays that meet a jet and no skin.

    Systematic sampling with a probability proportional to what a ray contributes now, averaged over bands, so that
    each ray kept stands for the same part of its row, along a curve that fills the image, so that it stands for its
    neighbours. A jet's few parameters act on all of its rays; parameters of the skin may act on a few rays only, so
    those that meet it stay. None where that leaves most.
    """
    if not isinstance(scene.plume, JetPlume) or through is None:
        return None, None
    weight, part = (np.asarray(x, np.float64) for x in (through.weight, through.parts(scene, measurement)))
    group = np.broadcast_to(np.asarray(through.group)[..., None], weight.shape).reshape(-1)
    weight, part = weight.reshape(-1), part.reshape(-1, part.shape[-1])
    face = np.full(group.shape, -1) if through.paths.hit is None else np.asarray(through.paths.hit.face).reshape(-1)
    free, on_skin = np.flatnonzero((face < 0) & (weight > 0)), np.flatnonzero((face >= 0) & (weight > 0))
    free = free[np.argsort(group[free], kind="stable")]
    _, of = np.unique(group[free], return_inverse=True)
    by_light, by_area = _share(part[free], of).mean(axis=1), _share(weight[free, None], of)[:, 0]

    def about(count: int, even: float) -> _ViewRays | None:
        share = (1 - even) * by_light + even * by_area
        share = share / np.bincount(of, share)[of]
        above = np.cumsum(share) - of  # groups lie one behind the other and have a share of 1 each
        picks = np.floor(count * above + 0.5) - np.floor(count * (above - share) + 0.5)
        kept = np.flatnonzero(picks > 0)
        if 2 * kept.size > free.size:
            return None
        scaled = weight.copy()
        scaled[free[kept]] *= picks[kept] / (count * share[kept])
        index = np.concatenate([on_skin, free[kept]])
        rays = jax.tree.map(lambda leaf: leaf.reshape(-1, 3)[index], through.paths.rays)
        group_of, face_of = (jnp.asarray(x[index], jnp.int32) for x in (group, face))
        scaled_weight = jnp.asarray(scaled[index], through.weight.dtype)
        return _ViewRays(rays, scaled_weight, group_of, face_of, jnp.ones(index.size, bool))

    return about(LEADING, EVEN), about(STEERING, EVEN_STEERING)


def _share(part: np.ndarray, of: np.ndarray) -> np.ndarray:
    """Parts [ray, band] over their sum in the group `of` each ray; an even share where all are 0."""
    total = np.stack([np.bincount(of, column) for column in part.T], axis=1)[of]
    even = (1 / np.bincount(of))[of][:, None]
    return np.where(total > 0, part / np.where(total > 0, total, 1), even)


def _ray_sum(scene: Scene, measurement: Measurement, rays: _ViewRays | None, key: Array) -> RaySum | None:
    """Trace rays and lay them out."""
    if rays is None or rays.face.size == 0:
        return None
    index, gap, group = _layout(np.asarray(rays.group), measurement.nodes)
    laid = _gather(rays, index.reshape(index.shape[0], -1))
    paths = _trace_chunks(scene, laid.rays, measurement, jax.random.split(key, index.shape[0]))
    if paths.crossings is not None:
        longest = max(1, int(jax.vmap(lambda c: c.longest())(paths.crossings).max()))
        trimmed = jax.vmap(lambda c: c.trim(longest))(paths.crossings)
        paths = eqx.tree_at(lambda p: p.crossings, paths, trimmed)
    weight = jnp.where(gap, 0, laid.weight.reshape(index.shape))
    return RaySum(paths, weight, jnp.asarray(group, jnp.int32))


@eqx.filter_jit
def _trace_chunks(scene: Scene, rays: Rays, measurement: Measurement, keys: Array) -> Paths:
    def chunk(each: tuple[Rays, Array]) -> Paths:
        traced = trace(scene, each[0], measurement.reflection, each[1], measurement.scattering)
        return store_crossings(scene, traced)

    return lax.map(chunk, (rays, keys))


def _layout(group: np.ndarray, nodes: Nodes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which ray lies where [chunk, slice, place], places without a ray likewise, group of each slice [chunk, slice].

    Sums over groups are then plain reductions; a scatter of every ray is far slower on a CPU.
    """
    order = np.argsort(group, kind="stable")
    _, first, counts = np.unique(group[order], return_index=True, return_counts=True)
    places = min(SLICE, int(counts.max()))
    slices = -(-counts // places)
    begin = np.repeat(first, slices) + places * (
        np.arange(slices.sum()) - np.repeat(np.cumsum(slices) - slices, slices)
    )
    end = np.repeat(first + counts, slices)
    chunks = -(-begin.size * places * nodes.count // RAYS_BY_NODES)
    each = -(-begin.size // chunks)
    each = -(-each // ROUND) * ROUND
    chunks = -(-begin.size // each)
    begin, end = (np.pad(edge, (0, chunks * each - edge.size)).reshape(chunks, each) for edge in (begin, end))
    place = begin[..., None] + np.arange(places)
    gap = place >= end[..., None]
    index = order[np.where(gap, begin[..., None], place)]
    return index, gap, group[index[..., 0]]
