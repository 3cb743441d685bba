"""An image in chunks of tiles: what bounds memory, whatever the size of the image."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int, Key

from jaxir._arrays import Check, as_float, enforce, is_traced, on_host, placed
from jaxir._math import at_once, in_kernels, on_cpu
from jaxir._programs import program
from jaxir.geometry import TILE, Bundle, Camera, stratum_points, tile_rays, turns
from jaxir.geometry.search import MARGIN, may_see
from jaxir.imaging._division import TILES, Chunk, Division, block_size, chunk_size, division
from jaxir.imaging._entry import path_doubts, require_camera, require_parts
from jaxir.imaging._estimate import Estimate, Seen, Varied, of_strata
from jaxir.imaging._image import Image, image_of
from jaxir.optics.spectrum import Band, Nodes
from jaxir.scene import Lit, Scene, nodes_within, on_nodes
from jaxir.transport import (
    Components,
    Method,
    aimed,
    components_of,
    empty_components,
    evaluate_components,
    evaluate_orders,
    lattice_error,
    lattice_lacks,
    solution_checks,
    trace,
    with_own_media,
    with_scattered,
)

TILES_AT_ONCE = 32  # 8192 rays: bounds memory whatever the image, and what they need stays in a processor's cache
PARTS = 8  # chunks of a small image on a CPU, for so many devices to share
QUICK = 2**17  # work of an image of few chunks: a call for each takes .5 ms
FEWER = 4  # times fewer tiles at once where paths may be long
SAMPLES_AT_ONCE = 16  # directions a ray carries before fewer tiles are handled at once


def parts_for(devices: int = 1) -> int:
    """Chunks into which a small image is cut all the same, for so many devices to share.

    On cards as many as JAX has of these: one takes hardly longer for eight chunks than for one, since rays in lockstep
    take as many steps as the slowest.
    """
    return max(PARTS if on_cpu() else jax.device_count(), devices)


class Pass(NamedTuple):
    """One pass over the pixels of an image.

    Attributes:
        lit: the scene on the nodes.
        camera: the eye.
        key: random key of the image.
        number: of the pass, which decides its random numbers with `key`.
        strata: in a pixel.
        method: how radiance is found.
        parts: of `parts_for`.
        components: by which radiance is split; None for none.
        lacking: of `lattice_error`; None where nothing was solved for.
    """

    lit: Lit
    camera: Camera
    key: Array
    number: Array
    strata: Division
    method: Method
    parts: int
    components: Components | None = None
    lacking: Array | None = None

    @property
    def samples(self) -> int:
        """Rays per pixel; of known ones."""
        return 2 * int(np.prod(np.asarray(self.strata.cells)))

    def of(self, samples: int) -> Pass:
        """The same with other rays per pixel."""
        return self._replace(strata=division(samples, not isinstance(self.strata.cells, tuple)))

    def seeing(self, lit: Lit) -> Pass:
        """The same of a scene with its scattered light."""
        held, camera = lax.stop_gradient((lit, self.camera))  # an error has no derivative
        lacks = lattice_lacks(held.in_vacuum(), camera.undivided())
        return self._replace(lit=aimed(lit, self.camera), lacking=lattice_error(held, lacks))

    def of_chunks(self) -> Pass:
        """What is the same for images of all shapes: what `estimate_chunk` asks for."""
        return self._replace(camera=self.camera.endless(), parts=0, lacking=None)

    @property
    def strata_at_once(self) -> int:
        """Strata of every pixel that are traced together."""
        return self._limits()[1]

    def tiles_at_once(self, size: int) -> int:
        """Tiles of a chunk of so many that are traced together: rays are at most those of `TILES_AT_ONCE` tiles."""
        return block_size(size, self._limits()[2])

    @property
    def spots(self) -> int:
        """Strata of single pixels that are traced together."""
        return self._limits()[0] * TILE * TILE // 2

    def _limits(self) -> tuple[int, int, int, int]:
        """Tiles' worth of rays, strata, and tiles that are traced together at most; tiles of a chunk at most."""
        each, few = self._each, FEWER if self.method.bounces > 1 else 1  # most paths end soon, and all in many tiles
        side_by_side = max(at_once(TILES_AT_ONCE) // (few * each), 1)
        strata = min(self.strata.together, max(side_by_side // 2, 1))
        return side_by_side, strata, max(side_by_side // (2 * strata), 1), max(at_once(TILES) // each, 1)

    @property
    def _each(self) -> int:
        """Rays that a ray counts for, by the samples that it carries."""
        return -(-self.method.samples(self.lit.scene) // SAMPLES_AT_ONCE)

    @property
    def uniform(self) -> bool:
        """Whether the empty image is the same in all pixels."""
        return self.lit.scene.background is None or self.lit.scene.background.uniform

    @property
    def noisy(self) -> bool:
        """Whether anything is sampled along rays."""
        return self.method.needs_key(self.lit.scene)

    @property
    def quick(self) -> bool:
        """Whether to call a program for each chunk would take a share of the image's time that matters."""
        return self.work(self.samples) <= QUICK

    def work(self, samples: int) -> int:
        """Rays of an image of so many in each pixel, times nodes and what a ray counts for."""
        return samples * self.tiles * TILE * TILE * self._each * self.lit.nodes.count

    @property
    def tiles(self) -> int:
        """Tiles of the image."""
        return math.prod(self.camera.tiles)

    @property
    def numbers(self) -> Int[np.ndarray, "chunk tile"]:
        """Tiles of the chunks of an image; of small ones there are `parts`, unless all is quick."""
        return self.spread(1 if self.quick else min(self.parts, self.tiles))

    def spread(self, least: int) -> Int[np.ndarray, "chunk tile"]:
        """Tiles of `least` chunks or more, spread over the image, so that these cost the same; some may lie beyond it.

        Chunks are smaller where a ray carries many samples, and in images of less than `parts` full ones.
        """
        *_, together, most = self._limits()
        size = chunk_size(-(-self.tiles // self.parts), most, together)
        count = max(-(-self.tiles // size), least)
        return np.arange(count * size, dtype=np.int32).reshape(size, count).T

    def chunks(self) -> Chunk:
        """The chunks, stacked."""
        return self.holding(self.numbers)

    def holding(self, tile: Int[np.ndarray, "chunk tile"]) -> Chunk:
        """Chunks of tiles, stacked."""
        number = np.arange(len(tile), dtype=np.int32)
        return Chunk(number, self.camera.tile_edges(tile), tile < self.tiles)


def first_pass(
    scene: Scene,
    camera: Camera,
    bands: Nodes | Band | Sequence[Band],
    key: Key[Array, ""],
    samples: int,
    method: Method,
    components: str | None = None,
    rtol: float | None = None,
) -> Pass:
    """The first pass ready to be taken: scene, camera and method checked, the scene evaluated on nodes for an error."""
    require_parts(scene, method)
    require_camera(camera)
    nodes = nodes_within(scene, bands, rtol)
    checks = [*scene.checks_on(nodes), *camera.checks(), *method.checks_for(scene), *method.node_checks(nodes)]
    checks += path_doubts(scene, camera.inverse_range)
    nodes = enforce(nodes, checks)
    method = method.resolved(scene)
    lit = enforce(on_nodes(scene, nodes), eye_outside(scene, camera.inverse_range, camera.target))
    strata = division(samples, not is_traced((lit, camera, key)))
    taken = scattered_for(Pass(lit, camera, key, as_number(0), strata, method, parts_for()), method)
    return taken._replace(components=with_own_media(scene, nodes, method, components_of(scene, method, components)))


def scattered_for(taken: Pass, method: Method) -> Pass:
    """A pass by a method, with what that finds on a lattice, ready for its camera."""
    lit = with_scattered(taken.lit, method)
    if lit is taken.lit:  # nothing is found so, or was before
        return taken._replace(method=method)
    return taken._replace(method=method).seeing(enforce(lit, solution_checks(lit)))


def as_number(number: int) -> Array:
    """The number of a pass as an array, so that another does not compile anew."""
    return placed(np.uint32(number))


@program
def whole_image(taken: Pass, parts: Estimate) -> Image:
    """The image of the estimates of all chunks, stacked."""
    return image_of_pixels(taken, every_pixel(taken, parts), 2 * taken.strata.count)


@program
def every_pixel(taken: Pass, parts: Estimate) -> Estimate:
    """The estimates [row, column, ...] of all chunks, stacked."""
    camera = taken.camera

    def whole(value: Any) -> Any:
        if value is None:
            return None
        of_tile = jnp.swapaxes(value.reshape((*value.shape[:3], -1)), 0, 1)
        of_tile = of_tile.reshape((-1, *of_tile.shape[2:]))[: taken.tiles]
        return camera.untile(of_tile).reshape((*camera.shape, *value.shape[3:]))

    others = {name: whole(value) for name, value in parts._asdict().items() if name != "empty"}
    empty = parts.empty[:1, :1, 0] if parts.empty.shape[2] == 1 else whole(parts.empty)
    return Estimate(empty=empty, **others)


@program
def image_of_pixels(taken: Pass, pixels: Estimate, samples: int | Int[Array, ""]) -> Image:
    """The image of estimates [row, column, ...] from `samples` rays per pixel."""
    camera, nodes = taken.camera, taken.lit.nodes
    names = () if taken.components is None else taken.components.names
    variance, parts_variance = pixels.surer()
    own = pixels.mean, variance, pixels.empty, samples, pixels.orders, taken.lacking, nodes.error
    return image_of(camera, nodes.names, *own, names, pixels.parts, parts_variance)


@program
def estimate_chunk(taken: Pass, chunk: Chunk) -> Estimate:
    """Mean radiance, its variance, and what would be seen without the scene, in the pixels of one chunk of tiles.

    Of a pass `of_chunks`. No ray is taken in tiles beyond the image, nor before a uniform background in those that see
    nothing of the scene.
    """
    lit, camera = taken.lit, taken.camera
    uniform = taken.uniform
    empty = lit.nodes.in_band(lit.empty(camera.frame[:1, None])) if uniform else None
    start, size = lit.scene.start(camera), chunk.edges.shape[0]
    some = chunk.there & may_see(lit.scene.outline(), camera, chunk.edges) if uniform else chunk.there
    order = jnp.argsort(~some, stable=True)  # tiles that see something go together

    def block(own: tuple[Array, Array, Array]) -> tuple[Seen, Varied, Varied]:
        edges, number, some = own

        def nothing() -> tuple[Seen, Varied, Varied]:
            dark = _dark(taken, together, empty)
            none, parts = Varied(dark.radiance, dark.parts), dark.parts
            if empty is None:
                return dark, none, none
            if parts is not None and taken.components is not None:
                parts = parts + lit.nodes.in_band(empty_components(lit, taken.components, camera.frame[0]))[None, None]
            return dark._replace(radiance=dark.radiance + empty, parts=parts), none, none

        return lax.cond(some, lambda: _estimate(taken, edges, key, number, start, empty), nothing)

    together = taken.tiles_at_once(size)
    blocks, number = size // together, jnp.arange(size // together, dtype=jnp.int32)
    key = jax.random.fold_in(jax.random.fold_in(taken.key, taken.number), chunk.number)
    edges, some = (x[order].reshape(blocks, together, *x.shape[1:]) for x in (chunk.edges, some))
    every = lax.map(block, (edges, number, jnp.any(some, axis=1)))
    back = jnp.argsort(order)
    mean, variance, within = jax.tree.map(lambda value: value.reshape((-1, *value.shape[2:]))[back], every)
    seen = mean.empty if empty is None else empty
    own = mean.radiance, variance.radiance, within.radiance, seen, mean.orders
    return Estimate(*own, mean.parts, variance.parts, within.parts)


def _dark(taken: Pass, tiles: int, empty: Array | None) -> Seen:
    """No light in the pixels of some tiles."""
    pixels = (tiles, TILE * TILE)
    bands, dtype = taken.lit.nodes.response.shape[0], taken.camera.pixel.dtype
    zero = jnp.zeros((*pixels, bands), dtype)
    orders = None if not taken.method.samples_particles(taken.lit.scene) else jnp.zeros((*pixels, 2, bands), dtype)
    parts = None if taken.components is None else jnp.zeros((*pixels, len(taken.components.names), bands), dtype)
    return Seen(zero, zero if empty is None else None, orders, parts)


def _estimate(
    taken: Pass,
    edges: Float[Array, "tile 2 17"],
    key: Key[Array, ""],
    number: Int[Array, ""],
    start: Float[Array, ""],
    empty: Array | None,
) -> tuple[Seen, Varied, Varied]:
    """What the pixels of some tiles see, and variances, see `Estimate`; `empty` where it is the same for all.

    `number` of the tiles tells their random numbers from those of others with the same key.
    """
    camera, count, size, some = taken.camera, taken.strata.count, edges.shape[0], taken.strata_at_once
    turn = turns(jax.random.fold_in(key, -1 - number), size)

    def group(step: Array, carry: tuple[Seen, Varied, Varied]) -> tuple[Seen, Varied, Varied]:
        begin = step.astype(jnp.int32) * some
        for_pixels, for_paths = jax.random.split(jax.random.fold_in(key, number * count + begin))
        index = begin + jnp.arange(some, dtype=jnp.int32)
        offset = stratum_points(for_pixels, turn, index, taken.strata.cells)
        bundle = tile_rays(camera, edges, offset, start)
        seen = jax.tree.map(
            lambda value: value.reshape((size, TILE * TILE, some, 2, *value.shape[1:])),
            see(taken, bundle, for_paths),
        )

        def added(value: Array) -> Array:
            there = (index < count).reshape((-1, *(1,) * (value.ndim - 3)))[None, None]
            return jnp.sum(jnp.where(there, value, 0), axis=2)

        mean = jax.tree.map(lambda value: added((value[:, :, :, 0] + value[:, :, :, 1]) / 2), seen)
        two = Varied(seen.radiance, seen.parts)
        half = jax.tree.map(lambda value: (value[:, :, :, 0] - value[:, :, :, 1]) / 2, two)
        apart, square = jax.tree.map(added, half), jax.tree.map(lambda value: added(value**2), half)
        return jax.tree.map(jnp.add, carry, (mean, apart, square))

    dark = _dark(taken, size, empty)
    none = Varied(dark.radiance, dark.parts)
    loop = 0, -(-count // some), group, (dark, none, none)  # which can be turned round if the end is static
    total, apart, square = lax.fori_loop(*loop)
    share = 1 / as_float(count)
    own = share**2 * of_strata(share, taken.noisy)
    return (
        jax.tree.map(lambda sum: sum * share, total),
        jax.tree.map(lambda sum: (sum * share) ** 2, apart),
        jax.tree.map(lambda sum: sum * own, square),
    )


def see(taken: Pass, bundle: Bundle, key: Key[Array, ""]) -> Seen:
    """What rays see; nothing for `empty` where that is the same for all."""
    lit, method = taken.lit, taken.method
    paths = trace(lit.scene, bundle, method, key)
    parts = None if taken.components is None else evaluate_components(lit, paths, taken.components)
    without = None if taken.uniform else lit.empty(bundle.rays().direction)
    if parts is not None and not method.samples_particles(lit.scene):  # they add up to the whole
        return jax.tree.map(lit.nodes.in_band, Seen(in_kernels(parts.sum(axis=1)), without, None, parts))
    found = evaluate_orders(lit, paths)
    orders = jnp.stack([found.last, found.before], axis=1) if method.samples_particles(lit.scene) else None
    return jax.tree.map(lit.nodes.in_band, Seen(in_kernels(found.radiance), without, orders, parts))


def eye_outside(scene: Scene, inverse_range: Any, target: Array | None = None) -> list[Check]:
    """Rays start on the scene's bounding sphere, so an eye must be beyond it; None aims at the scene's middle."""
    if not is_traced(inverse_range) and not np.asarray(inverse_range).any():
        return []
    xp, points, near = on_host(scene.extent(), inverse_range)
    centre = (points.max(axis=0) + points.min(axis=0)) / 2 if target is None else on_host(target)[1]
    share = MARGIN * near * xp.sqrt(xp.max(xp.sum((points - centre[None]) ** 2, axis=1)))
    name = "Camera: (radius of the scene about the target) / distance"
    return [Check(name, share, share < 1, "less than 1: an eye outside the scene's bounding sphere")]
