"""What an intensity lacks that more bounces would add: few paths from the skin that is seen, followed further."""

from __future__ import annotations

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxir._arrays import placed
from jaxir._math import matmul, safe_sqrt
from jaxir._programs import program
from jaxir.geometry import Camera
from jaxir.geometry.search import is_convex
from jaxir.imaging._quadrature import quadrature_error, refined
from jaxir.optics.spectrum import Nodes
from jaxir.scene import Scene, nodes_error, on_nodes
from jaxir.transport import Method, bounced, trace

PATHS = 1024  # of a view
FURTHER = 4  # bounces beyond the last


class Asked(eqx.Module):
    """What a result was asked of, so that what it lacks can be looked for afterwards.

    Attributes:
        scene: the scene.
        nodes: the spectral axis.
        cameras: of an image, or of all views [view].
        method: how light was found.
    """

    scene: Scene
    nodes: Nodes
    cameras: Camera
    method: Method

    def spectral(self, look: bool) -> Float[Array, " band"] | None:
        """What the nodes err, as a share of the intensity [band]; None where no look is taken or none can tell."""
        if self.scene.has_spectrum and not look:
            return None
        with jax.ensure_compile_time_eval():
            return nodes_error(self.scene, self.nodes)

    def quadrature(self, look: bool) -> Float[Array, "*view band"] | None:
        """What `quadrature_error` finds [*view, band] [W sr-1]; 0 without jets, else None without a look."""
        if not refined(self.scene):
            return self._none()
        if not look:
            return None
        with jax.ensure_compile_time_eval():
            return self._by_view(quadrature_error(self.scene, self.nodes, self._views()))

    def bounces(self, look: bool) -> Float[Array, "*view band"] | None:
        """What `left_out` finds [*view, band] [W sr-1]; None without a look, or where `Method.ambient` stands for it.

        0 without a look, too, where skin can light no skin: without skin, or convex or plane skin without plumes.
        """
        if self.method.ambient is not None:
            return None
        if not _skin_is_lit_by_parts(self.scene):
            return self._none()
        if not look:
            return None
        method = dataclasses.replace(self.method, bounces=self.method.bounces + FURTHER)
        with jax.ensure_compile_time_eval():
            return self._by_view(left_out(self.scene, self.nodes, self._views(), method))

    def _views(self) -> Camera:
        """The cameras [view], one for an image."""
        alone = self.cameras.frame.ndim == 2
        return jax.tree.map(lambda leaf: leaf[None], self.cameras) if alone else self.cameras

    def _by_view(self, found: Float[Array, "view band"]) -> Float[Array, "*view band"]:
        return found.reshape(*self.cameras.frame.shape[:-2], -1)

    def _none(self) -> Float[Array, "*view band"]:
        shape = (*self.cameras.frame.shape[:-2], self.nodes.response.shape[0])
        return placed(np.zeros(shape, self.nodes.weight.dtype))


def _skin_is_lit_by_parts(scene: Scene) -> bool:
    """Whether skin may meet the light of other skin or of plumes."""
    if scene.skin is None or scene.plumes:
        return scene.skin is not None
    mesh = scene.skin.mesh
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    sides = (faces,) if mesh.closed else (faces, faces[:, ::-1])  # the backs of open skin are seen, too
    return not all(is_convex(vertices, side) for side in sides)


@program
def left_out(scene: Scene, nodes: Nodes, cameras: Camera, method: Method) -> Float[Array, "view band"]:
    """About what more bounces would add to the intensity of views [view, band] [W sr-1].

    With y_i of density p on the skin, drawn by the area that faces look at the eye with, and V_i = 1 where y_i is the
    first that the eye's ray through it meets, inside the frame,

        I_k = 1/N sum_i V_i L_k(y_i) |n . e| / (p (1 - z / range)^3 (1 + tan^2)^2)

    is what comes after k more bounces, e being the direction to the eye, z the height over the target and tan that of
    the angle off the camera's axis. `FURTHER` of them are summed, the rest is that of a geometric series with their
    mean ratio, and twice the standard error of the sum is added. What particles in front of the skin scatter of it is
    not looked for.

    Args:
        scene: with skin.
        nodes: the spectral axis.
        cameras: [view].
        method: with `FURTHER` bounces more than were followed.
    """
    lit = on_nodes(scene, nodes)
    assert scene.skin is not None
    mesh, closed = scene.skin.mesh, scene.skin.mesh.closed
    corners, vector = mesh.corners(), mesh.area_vectors()

    def one(own: tuple[Camera, Array]) -> Array:
        camera, key = own
        for_place, for_paths = jax.random.split(key)
        eye = _to_eye(camera, corners.mean(axis=1))
        facing = jnp.sum(vector * eye, axis=1)
        facing = jnp.maximum(facing, 0) if closed else jnp.abs(facing)
        sums = jnp.cumsum(facing)
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
        height = matmul(point - camera.target[None], camera.frame[2])
        slant = camera.slant(screen)
        turned = jnp.abs(jnp.sum(vector[face] * _to_eye(camera, point), axis=1)) / jnp.where(seen, facing[face], 1)
        weight = jnp.where(seen, sums[-1] * turned / ((1 - height * camera.inverse_range) ** 3 * slant**2), 0)
        found = nodes.in_band(bounced(lit, paths, method.bounces + 1 - FURTHER)) * weight[None, :, None]
        return _series(found)

    keys = jax.random.split(jax.random.key(0), cameras.frame.shape[0])
    return lax.map(one, (cameras, keys))


def _to_eye(camera: Camera, point: Float[Array, "point 3"]) -> Float[Array, "point 3"]:
    """From points to the eye, in units of its range; the eye's direction at infinity [point, 3]."""
    return camera.frame[2][None] - (point - camera.target[None]) * camera.inverse_range


def _series(found: Float[Array, "bounce path band"]) -> Float[Array, " band"]:
    """The sum of a series from samples of its first terms, and twice its standard error; inf where it does not fall."""
    terms, count = found.mean(axis=1), found.shape[1]
    first, last = terms[:-1].sum(axis=0), terms[1:].sum(axis=0)
    falls = last < first
    rest = terms[-1] * last / jnp.where(falls, first - last, 1)
    total = terms.sum(axis=0)
    error = safe_sqrt(jnp.var(found.sum(axis=0), axis=0) / count)
    return jnp.where(total == 0, 0, jnp.where(falls, total + rest + 2 * error, jnp.inf))
