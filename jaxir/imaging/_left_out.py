"""What an intensity lacks that more bounces would add: few paths from the skin that is seen, followed further."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxir._arrays import as_float, evaluated_now, placed
from jaxir._concurrent import side_by_side
from jaxir._math import safe_sqrt
from jaxir._programs import program
from jaxir.geometry import Camera
from jaxir.geometry.search import is_convex
from jaxir.imaging._devices import stacked
from jaxir.imaging._quadrature import beams_in_cells, quadrature_error, refined
from jaxir.optics.spectrum import Nodes
from jaxir.scene import Lit, Scene, nodes_error, on_nodes
from jaxir.transport import Method, beyond_frame, bounced, emitted, trace

PATHS = 2048  # of a view
FURTHER = 4  # bounces beyond the last
MOST_BOUNCES = 63  # that are chosen


class Asked(eqx.Module):
    """What a result was asked of, so that what it lacks can be looked for afterwards.

    Attributes:
        scene: the scene.
        nodes: the spectral axis.
        cameras: of an image, or of all views [view].
        method: how light was found.
        left: share that more bounces would add to an image, or at most to some of the views [band], where it was looked
            for beforehand, else None.
    """

    scene: Scene
    nodes: Nodes
    cameras: Camera
    method: Method
    left: Float[Array, " band"] | None = None

    def spectral(self, look: bool) -> Float[Array, " band"] | None:
        """What the nodes err, as a share of the contrast [band]; None where no look is taken or none can tell."""
        if self.scene.has_spectrum and not look:
            return None
        with evaluated_now():
            return nodes_error(self.scene, self.nodes)

    def quadrature(self, look: bool) -> Float[Array, "*view band"] | None:
        """What `quadrature_error` finds [*view, band] [W sr-1]; 0 where nothing is, else None without a look."""
        if not (refined(self.scene) or beams_in_cells(self.scene, self.method)):
            return self._none()
        if not look:
            return None
        with evaluated_now():
            return self._by_view(quadrature_error(self.scene, self.nodes, self._views(), self.method))

    def bounces(self, look: bool) -> Float[Array, "*view band"] | None:
        """What `left_out` finds [*view, band] [W sr-1]; None without a look, or where `Method.ambient` stands for it.

        0 without a look, too, where skin can light no skin: without skin, or convex or plane skin without plumes.
        """
        if self.method.ambient is not None:
            return None
        if not lights_its_skin(self.scene):
            return self._none()
        if not look:
            return None
        with evaluated_now():
            found = left_out(on_nodes(self.scene, self.nodes), self._views(), further(self.method))
            return self._by_view(found[:, 0])

    def outside(self) -> Float[Array, " band"]:
        """What `beyond_frame` finds of an image [band] [W sr-1]."""
        with evaluated_now():
            return beyond_frame(on_nodes(self.scene, self.nodes), self.cameras)

    def _views(self) -> Camera:
        """The cameras [view], one for an image."""
        return _alone(self.cameras) if self.cameras.frame.ndim == 2 else self.cameras

    def _by_view(self, found: Float[Array, "view band"]) -> Float[Array, "*view band"]:
        return found.reshape(*self.cameras.frame.shape[:-2], -1)

    def _none(self) -> Float[Array, "*view band"]:
        shape = (*self.cameras.frame.shape[:-2], self.nodes.response.shape[0])
        return placed(np.zeros(shape, self.nodes.weight.dtype))


def lights_its_skin(scene: Scene) -> bool:
    """Whether skin may meet the light of other skin or of plumes."""
    if scene.skin is None or scene.plumes:
        return scene.skin is not None
    mesh = scene.skin.mesh
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    sides = (faces,) if mesh.closed else (faces, faces[:, ::-1])  # the backs of open skin are seen, too
    return not all(is_convex(vertices, side) for side in sides)


@program
def shining_share(lit: Lit) -> Float[Array, " band"]:
    """Share of the skin that emits most of its light [band]: (sum A L)^2 / sum A L^2 over its faces, of sum A.

    Or of a tenth of the square of the scene's diagonal, if that is more: about what paths meet of it by chance.
    """
    assert lit.scene.skin is not None
    mesh = lit.scene.skin.mesh
    area = safe_sqrt(jnp.sum(mesh.area_vectors() ** 2, axis=1))[:, None]
    glow = lit.nodes.in_band(emitted(lit, jnp.arange(mesh.count, dtype=jnp.int32), jnp.ones_like(area[:, 0])))
    glow = glow / jnp.where(glow.max(axis=0) > 0, glow.max(axis=0), 1)[None]
    diagonal = jnp.ptp(lit.scene.extent(), axis=0)
    most = jnp.maximum(jnp.sum(area), jnp.sum(diagonal**2) / 10) * jnp.sum(area * glow**2, axis=0)
    return jnp.where(most > 0, jnp.sum(area * glow, axis=0) ** 2 / jnp.where(most > 0, most, 1), 1)


def _alone(camera: Camera) -> Camera:
    """The cameras [view] of one view."""
    return jax.tree.map(lambda leaf: leaf[None], camera)


def enough_bounces(
    lit: Lit,
    camera: Camera,
    method: Method,
    before: Callable[[], Float[np.ndarray, " band"]],
    allowed: Callable[[Float[np.ndarray, " band"]], Float[np.ndarray, " band"]],
) -> tuple[int, Float[np.ndarray, " band"], Float[np.ndarray, " band"]]:
    """The fewest bounces, those of a method or more, that leave out at most what is allowed, and what they leave out.

    Args:
        lit: with skin.
        camera: the eye.
        method: how light is found else.
        before: finds the intensity by it [band] [W sr-1], beside the first look, which has a thread of its own.
        allowed: what may be left out of an intensity [band] [W sr-1]. Of what stays dark it does not matter.

    Returns:
        Bounces, `MOST_BOUNCES` at most, what more of them would add [band] [W sr-1], see `left_out`, and the size of
        the intensity with all of them [band].
    """
    cameras = _alone(camera)

    def look() -> Float[np.ndarray, "bounce band"]:
        return np.asarray(left_out(lit, cameras, further(method, less - method.bounces)), np.float64)[0]

    less = method.bounces
    found, own = side_by_side(look, before)
    size = np.abs(own + np.where(np.isfinite(found[0]), found[0], 0))
    most = np.where((size > 0) | (found[0] > 0), allowed(size), np.inf)
    while True:
        enough = np.flatnonzero((found <= most).all(axis=1))
        if enough.size or less + FURTHER > MOST_BOUNCES:
            place = int(enough[0]) if enough.size else FURTHER - 1
            return less + place, found[place], size
        more = max(FURTHER + _more(found, most), less)  # each look compiles: few of them
        less = min(less + more, MOST_BOUNCES + 1 - FURTHER)
        found = look()


def _more(found: Float[np.ndarray, "bounce band"], allowed: Float[np.ndarray, " band"]) -> int:
    """How many bounces beyond `FURTHER` are of no use, if what is left out goes on to fall as it did."""
    first, last = found[0], found[-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        wanted = np.log(last / allowed) / np.log(first / last) * (FURTHER - 1)
    short = (last < first) & (last > allowed) & np.isfinite(wanted)
    return int(wanted[short].max()) - 1 if short.any() and wanted[short].max() >= 1 else 0


def further(method: Method, more: int = 0) -> Method:
    """A method that follows paths `FURTHER` bounces beyond some more than its own."""
    return dataclasses.replace(method, bounces=method.bounces + more + FURTHER)


def left_out(lit: Lit, cameras: Camera, method: Method) -> Float[Array, "view bounce band"]:
    """About what more bounces would add to the intensity of views [view, bounce, band] [W sr-1].

    Of the method's bounces, less `FURTHER`, and of up to `FURTHER` - 1 more.

    With y_i of density p on the skin, half of them drawn by the area that faces look at the eye with and half by that
    times their glow, and V_i = 1 where y_i is the first that the eye's ray through it meets, inside the frame,

        I_k = 1/N sum_i V_i L_k(y_i) |n . e| / (p (1 - z / range)^3 (1 + tan^2)^2)

    is what comes after k more bounces, e being the direction to the eye, z the height over the target and tan that of
    the angle off the camera's axis. Those of `FURTHER` that are left are summed, the rest is that of a geometric series
    with their mean ratio, or with the largest reflectance met, at 60 degrees, where few paths bring more and more, and
    twice the standard error of the sum is added. What particles in front of the skin scatter of it is not looked for.

    Args:
        lit: with skin.
        cameras: [view].
        method: with `FURTHER` bounces more than were followed.
    """
    views = jax.vmap(Camera.undivided)(cameras), np.arange(cameras.frame.shape[0], dtype=np.uint32)
    return stacked(_beyond, (lit, method), views, "bounces")


@program
def _beyond(asked: tuple[Lit, Method], view: tuple[Camera, Array]) -> Float[Array, "bounce band"]:
    """`left_out` of one view, with its number."""
    (lit, method), (camera, number) = asked, view
    skin, nodes = lit.scene.skin, lit.nodes
    assert skin is not None
    mesh, closed = skin.mesh, skin.mesh.closed
    corners, vector = mesh.corners(), mesh.area_vectors()
    assert lit.blackbody is not None
    glow = nodes.in_band(jnp.broadcast_to(lit.blackbody, (mesh.count, nodes.count)))
    shine = jnp.mean(glow / jnp.where(glow.max(axis=0) > 0, glow.max(axis=0), 1)[None], axis=1)

    for_place, for_paths = jax.random.split(jax.random.fold_in(jax.random.key(0), number))
    eye = camera.eye.away(corners.mean(axis=1))
    facing = jnp.sum(vector * eye, axis=1)
    facing = jnp.maximum(facing, 0) if closed else jnp.abs(facing)
    drawn = facing * shine
    drawn = facing / _sum(facing) + drawn / _sum(drawn)  # half of the paths from where it is warm
    sums = jnp.cumsum(drawn)
    u = jax.random.uniform(for_place, (PATHS, 3), corners.dtype)
    even = (jnp.arange(PATHS, dtype=u.dtype) + u[:, 0]) / PATHS
    face = jnp.clip(jnp.searchsorted(sums, even * sums[-1]), 0, mesh.count - 1)
    root = jnp.sqrt(u[:, 1])
    share = jnp.stack([1 - root, root * (1 - u[:, 2]), root * u[:, 2]], axis=1)
    point = jnp.sum(share[:, :, None] * corners[face], axis=1)
    screen = camera.project(point)
    rays = camera.bundle(screen, lit.scene.start(camera)).rays()
    paths = trace(lit.scene, rays, method, for_paths)
    half = camera.half_size()
    seen = (paths.face == face) & jnp.all(jnp.abs(screen) <= half[None], axis=1) & (facing[face] > 0)
    turned = jnp.abs(jnp.sum(vector[face] * camera.eye.away(point), axis=1)) / jnp.where(seen, drawn[face], 1)
    weight = jnp.where(seen, sums[-1] * turned / camera.lessening(point), 0)
    found = nodes.in_band(bounced(lit, paths, method.bounces + 1 - FURTHER)) * weight[None, :, None]
    most = jax.vmap(lambda own: own.directional_reflectance(as_float(0.5)))(skin.brdf.at(face))
    return _series(found, jnp.max(most))


def _sum(values: Array) -> Array:
    """The sum, or 1 where that is 0."""
    total = jnp.sum(values)
    return jnp.where(total > 0, total, 1)


def _series(found: Float[Array, "bounce path band"], most: Float[Array, ""]) -> Float[Array, "bounce band"]:
    """Sums of a series from each of its first terms on, of which samples are known, with twice their standard errors.

    By the terms' mean ratio, or `most` where few samples make them rise; inf where that is 1.
    """
    terms, count = found.mean(axis=1), found.shape[1]
    first, last = terms[:-1].sum(axis=0), terms[1:].sum(axis=0)
    ratio = jnp.where(last < first, last / jnp.where(first > 0, first, 1), most)
    rest = jnp.where(ratio < 1, terms[-1] * ratio / jnp.where(ratio < 1, 1 - ratio, 1), jnp.inf)
    onwards = lax.cumsum(found, reverse=True)
    total = onwards.mean(axis=1)
    error = safe_sqrt(jnp.var(onwards, axis=1) / count)
    return jnp.where(total == 0, 0, total + rest[None] + 2 * error)
