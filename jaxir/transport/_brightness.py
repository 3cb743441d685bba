"""Roughly what shines where in a scene: where rays are worth most, before any is traced.

Skin counts with its own emission and what it would scatter of unhidden lights without extent, a plume with its
emission, dimmed by itself as a layer as deep as the plume is wide. Nothing hides anything. Estimates may be as rough as
this, because they only place rays.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxir._arrays import as_float, is_traced, placed
from jaxir._math import dot, einsum, matmul
from jaxir._programs import program
from jaxir.geometry import Brightness, Camera, Rays, graded_camera
from jaxir.geometry.search import any_hit, face_normal
from jaxir.scene import Lit

PROJECTED = 2**16  # points of faces, but at least four of each
VIEWS = 64  # whose cameras are made by one program, however many of them are wanted


class _Shining(NamedTuple):
    """What shines: faces with their radiance [face, band], capsules with their intensity [capsule, band]."""

    corners: Float[Array, "face 3 3"]
    radiance: Float[Array, "face band"]
    ends: Float[Array, "capsule 2 3"]
    radius: Float[Array, " capsule"]
    intensity: Float[Array, "capsule band"]


def _shining(lit: Lit, behind: Float[Array, " node"] | None = None) -> _Shining:
    """Without derivatives; skin in contrast to what is `behind` it, if that is given."""
    lit = lax.stop_gradient(lit)
    dtype, bands = lit.nodes.weight.dtype, lit.nodes.response.shape[0]
    corners, radiance = jnp.zeros((0, 3, 3), dtype), jnp.zeros((0, bands), dtype)
    ends, radius, intensity = jnp.zeros((0, 2, 3), dtype), jnp.zeros(0, dtype), jnp.zeros((0, bands), dtype)
    if lit.scene.skin is not None:
        mesh = lit.scene.skin.mesh
        corners = mesh.vertices[mesh.faces]
        radiance = lit.nodes.in_band(_of_skin(lit, corners, behind))
    if lit.medium is not None:
        ends, radius, emitted = lit.medium.capsules()
        intensity = lit.nodes.in_band(emitted)
    return _Shining(corners, radiance, ends, radius, intensity)


def brightness(lit: Lit) -> Brightness:
    """Where a scene is bright, each band's intensity normalised and the bands averaged; without derivatives."""
    corners, radiance, ends, radius, intensity = _shining(lit)
    area = jnp.linalg.norm(jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    total = jnp.sum(radiance * area[:, None], axis=0) / 8 + jnp.sum(intensity, axis=0)  # faces are seen by a quarter
    share = 1 / jnp.where(total > 0, total, 1) / radiance.shape[1]
    return Brightness(corners, matmul(radiance, share), ends, radius, matmul(intensity, share))


def share_outside(lit: Lit, camera: Camera) -> Float[Array, " band"]:
    """About the share of a scene's intensity that a camera's frame leaves out [band]; without derivatives.

    Of every face that looks at the eye the centres of four pieces or, of few faces, of more are projected, of every
    capsule of a plume its middle and points towards the ends. Nothing hides anything.
    """
    shining, camera = _shining(lit), lax.stop_gradient(camera)
    corners, radiance, ends, _, intensity = shining
    vector = jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    seen = jnp.maximum(dot(vector, camera.frame[2:]), 0)[:, None] * radiance
    of_faces, of_capsules = _beyond(corners, ends, camera)
    total = jnp.sum(seen, axis=0) + jnp.sum(intensity, axis=0)
    left_out = matmul(of_faces, seen) + matmul(of_capsules, intensity)
    return left_out / jnp.where(total > 0, total, 1)


def _beyond(corners: Array, ends: Array, camera: Camera) -> tuple[Float[Array, " face"], Float[Array, " capsule"]]:
    """About the shares of faces and capsules that lie beyond a camera's frame."""
    half = camera.half_size() * (1 + 1e-3)

    def beyond(point: Float[Array, "part point 3"]) -> Float[Array, " part"]:
        out = jnp.any(jnp.abs(camera.project(point)) > half[None, None], axis=-1)
        return jnp.mean(out.astype(point.dtype), axis=-1)

    place = jnp.asarray(_centres(int(min(max((PROJECTED / max(len(corners), 1)) ** 0.5, 2), 16))), corners.dtype)
    along = jnp.asarray([0.1, 0.3, 0.5, 0.7, 0.9], ends.dtype)[None, :, None]
    return beyond(einsum("pc,fck->fpk", place, corners)), beyond(ends[:, :1] + along * (ends[:, 1:] - ends[:, :1]))


@program
def patch_that_shines(lit: Lit, camera: Camera, in_sight: Bool[Array, " face"] | None) -> Float[Array, " band"]:
    """Area of an even patch that rays would find as hard as they do what shines in a camera's frame [band] [m2].

    Of n even rays a pixel, of area A, n a / A meet a part of projected area a. Of independent ones the intensity would
    have the relative variance A / (n patch) with

        patch = (sum I)^2 / sum (I^2 / a),

    I being the intensities of the parts in contrast to what is behind the scene: where a face of a hundredth of a pixel
    sends most, it alone counts. It is at most the area of all parts, which overlap, and of the rectangle that holds the
    scene; these alone where nothing shines by itself.

    Args:
        lit: the scene on the nodes.
        camera: the eye.
        in_sight: see `faces_in_sight`; None: nothing hides anything.
    """
    behind = lit.background(-camera.frame[2])
    corners, radiance, ends, radius, intensity = _shining(lit, behind)
    x, y = jnp.moveaxis(camera.project(corners), -1, 0)
    turn = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    closed = lit.scene.skin is not None and lit.scene.skin.mesh.closed
    of_faces = (jnp.maximum(turn, 0) if closed else jnp.abs(turn)) / 2
    if in_sight is not None:
        of_faces = jnp.where(in_sight, of_faces, 0)
    long = jnp.linalg.norm(camera.project(ends[:, 1]) - camera.project(ends[:, 0]), axis=-1)
    inside = 1 - jnp.concatenate(_beyond(corners, ends, camera))
    area = jnp.concatenate([of_faces, radius * (np.pi * radius + 2 * long)]) * inside
    # as shares of the brightest: squares of what is faint underflow
    each = jnp.concatenate([jnp.abs(radiance) * of_faces[:, None], intensity]) * inside[:, None]
    each = each / jnp.maximum(each.max(axis=0, keepdims=True), jnp.finfo(each.dtype).tiny)
    spread = jnp.sum(each**2 / jnp.where(area > 0, area, 1)[:, None], axis=0)
    patch = jnp.where(spread > 0, jnp.sum(each, axis=0) ** 2 / jnp.where(spread > 0, spread, 1), jnp.inf)
    low, high = camera.rectangle(lit.scene.extent())
    return jnp.minimum(patch, jnp.minimum(jnp.prod(high - low), jnp.sum(area)))


@program
def faces_in_sight(lit: Lit, camera: Camera) -> Bool[Array, " face"]:
    """Whether a camera sees the middle of each face of the skin."""
    assert lit.scene.skin is not None
    mesh = lit.scene.skin.mesh
    centre = mesh.corners().mean(axis=1)
    toward = camera.frame[2][None] + camera.inverse_range * (camera.target[None] - centre)
    toward = toward / jnp.linalg.norm(toward, axis=1, keepdims=True)
    return ~any_hit(mesh, Rays(centre, toward), leaving=jnp.arange(mesh.count, dtype=jnp.int32))


def _centres(cuts: int) -> np.ndarray:
    """Barycentric coordinates of the centres of the cuts^2 equal pieces of a triangle [piece, 3]."""
    i, j = np.indices((cuts, cuts)).reshape(2, -1)
    upright, other = (np.stack([i, j], 1)[i + j < cuts - more] + (1 + more) / 3 for more in (0, 1))
    two = np.concatenate([upright, other]) / cuts
    return np.concatenate([1 - two.sum(axis=1, keepdims=True), two], axis=1)


class _Outlook(NamedTuple):
    """What cameras are made of, see `graded_camera`."""

    extent: Float[Array, "corner 3"]
    bright: Brightness
    shape: tuple[int, int]
    distance: Array


def graded_cameras(lit: Lit, aspect: Float[Array, "view 2"], shape: tuple[int, int], distance: Any) -> Camera:
    """Cameras [view] that hold the scene and are graded by its brightness, for intensities; see `graded_camera`.

    Args:
        lit: the scene on the nodes.
        aspect: azimuth and elevation [view, 2] [deg].
        shape: rows and columns.
        distance: from the middle of the scene to the sensor [m]; inf allowed.
    """
    outlook = _Outlook(lit.scene.extent(), _bright(lit), shape, as_float(distance))
    if is_traced((outlook, aspect)):
        return _cameras(outlook, aspect, None)
    count, given = aspect.shape[0], np.asarray(aspect)
    more = -count % VIEWS
    found = _cameras(outlook, placed(np.pad(given, ((0, more), (0, 0)))), placed(np.arange(count + more) < count))
    return jax.tree.map(lambda leaf: placed(np.asarray(leaf)[:count]), found)


@program
def _bright(lit: Lit) -> Brightness:
    return brightness(lit)


@program
def _cameras(outlook: _Outlook, aspect: Float[Array, "view 2"], wanted: Bool[Array, " view"] | None) -> Camera:
    """A camera for every aspect, zeros for those that are not wanted."""
    own = outlook.extent, outlook.bright, outlook.shape, outlook.distance

    def camera(aspect: Array) -> Camera:
        return graded_camera(aspect[0], aspect[1], *own)

    if wanted is None:
        return lax.map(camera, aspect)
    none = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(camera, aspect[0]))
    return lax.map(lambda one: lax.cond(one[1], camera, lambda _: none, one[0]), (aspect, wanted))


def _of_skin(lit: Lit, corners: Float[Array, "face 3 3"], behind: Array | None) -> Float[Array, "face node"]:
    """Radiance of every face, as if a Lambert one; in contrast to what is `behind` it and as bright before it."""
    skin = lit.scene.skin
    assert skin is not None and lit.blackbody is not None
    face = jnp.arange(skin.mesh.count, dtype=jnp.int32)
    one = as_float(1.0)
    emissivity = jax.vmap(lambda b: b.directional_emissivity(one))(skin.brdf.at(face))
    centre, normal = corners.mean(axis=1), face_normal(skin.mesh, face)
    irradiance = jnp.zeros_like(lit.blackbody)
    for source in lit.scene.delta_sources:
        toward, _ = jax.vmap(source.toward)(centre)
        beam = jax.vmap(lambda p, source=source: source.beam(p))(centre)
        irradiance = irradiance + jnp.maximum(jnp.sum(toward * normal, axis=1), 0)[:, None] * beam
    emitted = lit.blackbody if behind is None else lit.blackbody - behind[None]
    return emissivity * emitted + (1 - emissivity) * irradiance / np.pi
