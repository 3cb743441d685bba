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
from jaxtyping import Array, Float

from jaxir._arrays import as_float
from jaxir._math import dot
from jaxir._programs import program
from jaxir.geometry import Brightness, Camera, graded_camera
from jaxir.geometry.search import face_normal
from jaxir.scene import Lit

PROJECTED = 2**16  # points of faces, but at least four of each


class _Shining(NamedTuple):
    """What shines: faces with their radiance [face, band], capsules with their intensity [capsule, band]."""

    corners: Float[Array, "face 3 3"]
    radiance: Float[Array, "face band"]
    ends: Float[Array, "capsule 2 3"]
    radius: Float[Array, " capsule"]
    intensity: Float[Array, "capsule band"]


def _shining(lit: Lit) -> _Shining:
    """Without derivatives."""
    lit = lax.stop_gradient(lit)
    dtype, bands = lit.nodes.weight.dtype, lit.nodes.response.shape[0]
    corners, radiance = jnp.zeros((0, 3, 3), dtype), jnp.zeros((0, bands), dtype)
    ends, radius, intensity = jnp.zeros((0, 2, 3), dtype), jnp.zeros(0, dtype), jnp.zeros((0, bands), dtype)
    if lit.scene.skin is not None:
        mesh = lit.scene.skin.mesh
        corners = mesh.vertices[mesh.faces]
        radiance = lit.nodes.in_band(_of_skin(lit, corners))
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
    return Brightness(corners, radiance @ share, ends, radius, intensity @ share)


def share_outside(lit: Lit, camera: Camera) -> Float[Array, " band"]:
    """About the share of a scene's intensity that a camera's frame leaves out [band]; without derivatives.

    Of every face that looks at the eye the centres of four pieces or, of few faces, of more are projected, of every
    capsule of a plume its middle and points towards the ends. Nothing hides anything.
    """
    corners, radiance, ends, _, intensity = _shining(lit)
    camera = lax.stop_gradient(camera)
    half = camera.half_size() * (1 + 1e-3)

    def beyond(point: Float[Array, "part point 3"]) -> Float[Array, " part"]:
        out = jnp.any(jnp.abs(camera.project(point)) > half[None, None], axis=-1)
        return jnp.mean(out.astype(point.dtype), axis=-1)

    vector = jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    place = jnp.asarray(_centres(int(min(max((PROJECTED / max(len(corners), 1)) ** 0.5, 2), 16))), corners.dtype)
    seen = jnp.maximum(dot(vector, camera.frame[2:]), 0)[:, None] * radiance
    of_faces = beyond(jnp.einsum("pc,fck->fpk", place, corners))
    along = jnp.asarray([0.1, 0.3, 0.5, 0.7, 0.9], ends.dtype)[None, :, None]
    of_capsules = beyond(ends[:, :1] + along * (ends[:, 1:] - ends[:, :1]))
    total = jnp.sum(seen, axis=0) + jnp.sum(intensity, axis=0)
    left_out = of_faces @ seen + of_capsules @ intensity
    return left_out / jnp.where(total > 0, total, 1)


def _centres(cuts: int) -> np.ndarray:
    """Barycentric coordinates of the centres of the cuts^2 equal pieces of a triangle [piece, 3]."""
    i, j = np.indices((cuts, cuts)).reshape(2, -1)
    upright, other = (np.stack([i, j], 1)[i + j < cuts - more] + (1 + more) / 3 for more in (0, 1))
    two = np.concatenate([upright, other]) / cuts
    return np.concatenate([1 - two.sum(axis=1, keepdims=True), two], axis=1)


@program
def graded_cameras(lit: Lit, aspect: Float[Array, "view 2"], shape: tuple[int, int], distance: Any) -> Camera:
    """Cameras [view] that hold the scene and are graded by its brightness, for intensities; see `graded_camera`.

    Args:
        lit: the scene on the nodes.
        aspect: azimuth and elevation [view, 2] [deg].
        shape: rows and columns.
        distance: from the middle of the scene to the sensor [m]; inf allowed.
    """
    bright, extent = brightness(lit), lit.scene.extent()
    return lax.map(lambda a: graded_camera(a[0], a[1], extent, bright, shape, distance), aspect)


def _of_skin(lit: Lit, corners: Float[Array, "face 3 3"]) -> Float[Array, "face node"]:
    """Radiance of every face, as if a Lambert one."""
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
    return emissivity * lit.blackbody + (1 - emissivity) * irradiance / np.pi
