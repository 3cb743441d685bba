"""Triangle meshes and the one door to them: `closest_hit` and `any_hit`."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxir._arrays import Check, as_float, finite
from jaxir.geometry.ray import Bundle, Rays
from jaxir.geometry.triangle import Hit, ray_frame, ray_triangle, reattach

_RAY_CHUNK = 256
_FACE_CHUNK = 256


class Mesh(eqx.Module):
    """Triangles with outward orientation by the right-hand rule.

    Attributes:
        vertices: [vertex, 3] [m].
        faces: vertex indices [face, 3], int32.
    """

    vertices: Float[Array, "vertex 3"]
    faces: Int[Array, "face 3"]

    def __init__(self, vertices: Any, faces: Any):
        self.vertices = as_float(vertices, "Mesh.vertices")
        index = np.asarray(faces)
        if index.ndim != 2 or index.shape[-1] != 3 or not np.issubdtype(index.dtype, np.integer):
            raise ValueError(f"Mesh.faces: got {index.dtype} of shape {index.shape}, expected integers (face, 3)")
        if index.shape[0] == 0:
            raise ValueError("Mesh.faces: got 0 faces, expected at least 1")
        if self.vertices.ndim != 2 or self.vertices.shape[1] != 3:
            raise ValueError(f"Mesh.vertices: got shape {self.vertices.shape}, expected (vertex, 3)")
        if index.min() < 0 or index.max() >= self.vertices.shape[0]:
            raise ValueError(
                f"Mesh.faces: got indices {index.min()} to {index.max()}, expected 0 to {self.vertices.shape[0] - 1}"
            )
        self.faces = jnp.asarray(index, jnp.int32)

    @property
    def count(self) -> int:
        """Number of faces."""
        return self.faces.shape[0]

    def corners(self) -> Float[Array, "face 3 3"]:
        """Vertices of every face [face, corner, 3] [m]."""
        return self.vertices[self.faces]

    def area_vectors(self) -> Float[Array, "face 3"]:
        """Half the cross product of two edges: outward normal times area [face, 3] [m2]."""
        p = self.corners()
        return jnp.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]) / 2

    def checks(self) -> list[Check]:
        """Vertices are finite."""
        return [finite("Mesh.vertices", self.vertices)]


def closest_hit(
    mesh: Mesh,
    rays: Rays | Bundle,
    t_min: Float[Array, " ray"] | float = 0.0,
    t_max: Float[Array, " ray"] | float = jnp.inf,
) -> Hit:
    """The first face that each ray meets with t_min < t < t_max.

    Args:
        mesh: the triangles; both sides of a face are met.
        rays: unrelated rays, or a bundle.
        t_min: per ray or one for all [m].
        t_max: per ray or one for all [m].

    Returns:
        The hits. Ties go to the lowest face index.

    Differentiable in vertices and rays through t, barycentrics, point, normal; visibility has no derivative.
    """
    single = rays.rays() if isinstance(rays, Bundle) else rays
    face = lax.stop_gradient(_search(mesh, single, t_min, t_max))
    corners = mesh.vertices[mesh.faces[jnp.maximum(face, 0)]]
    t, barycentric, point, normal = jax.vmap(reattach)(face, corners, single.origin, single.direction)
    return Hit(face, t, barycentric, point, normal)


def any_hit(
    mesh: Mesh,
    rays: Rays | Bundle,
    t_min: Float[Array, " ray"] | float = 0.0,
    t_max: Float[Array, " ray"] | float = jnp.inf,
) -> Bool[Array, " ray"]:
    """Whether each ray meets any face with t_min < t < t_max; arguments as in `closest_hit`. Not differentiable."""
    single = rays.rays() if isinstance(rays, Bundle) else rays
    return lax.stop_gradient(_search(mesh, single, t_min, t_max)) >= 0


def occluded(
    mesh: Mesh,
    point: Float[Array, "ray 3"],
    face: Int[Array, " ray"],
    toward: Float[Array, " 3"],
    active: Bool[Array, " ray"],
) -> Bool[Array, " ray"]:
    """Whether points of the mesh are hidden from a direction by any other face.

    Args:
        mesh: the triangles.
        point: points on the mesh [ray, 3] [m].
        face: the face on which each point lies [ray].
        toward: direction in which to look [3], unit.
        active: points to be tested; others return False.

    Returns:
        [ray]. Not differentiable.
    """
    size = jnp.max(jnp.abs(mesh.vertices))
    rays = Rays(point, jnp.broadcast_to(toward, point.shape))
    near = jnp.full_like(point[:, 0], 1) * size * 1e-5
    return any_hit(mesh, rays, near, jnp.where(active, jnp.inf, -jnp.inf)) & active


def _search(mesh: Mesh, rays: Rays, t_min: Any, t_max: Any) -> Int[Array, " ray"]:
    """Brute force in chunks of rays and faces: exact, memory bounded, for a handful of triangles."""
    corners = mesh.corners()
    size = min(_FACE_CHUNK, mesh.count)
    blocks = -(-mesh.count // size)
    pad = blocks * size - mesh.count
    tables = jnp.pad(corners, ((0, pad), (0, 0), (0, 0))).reshape(blocks, size, 3, 3)
    low = jnp.broadcast_to(jnp.asarray(t_min, rays.origin.dtype), (rays.count,))
    high = jnp.broadcast_to(jnp.asarray(t_max, rays.origin.dtype), (rays.count,))

    def one(item: tuple[Array, Array, Array, Array]) -> Array:
        origin, direction, near, far = item
        frame = ray_frame(direction)

        def block(carry: tuple[Array, Array], table: tuple[Array, Array]) -> tuple[tuple[Array, Array], None]:
            best, face = carry
            inside, t = jax.vmap(lambda c: ray_triangle(frame, c - origin[None, :]))(table[0])
            t = jnp.where(inside & (t > near), t, jnp.inf)
            k = jnp.argmin(t)
            closer = t[k] < best
            return (
                jnp.where(closer, t[k], best),
                jnp.where(closer, table[1] + k.astype(jnp.int32), face),
            ), None

        starts = jnp.arange(blocks, dtype=jnp.int32) * size
        (_, face), _ = lax.scan(block, (far, jnp.full((), -1, jnp.int32)), (tables, starts))
        return face

    return lax.map(one, (rays.origin, rays.direction, low, high), batch_size=_RAY_CHUNK)
