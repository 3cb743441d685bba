"""Whether points of a mesh lie in its own shadow."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import sequential_vmap
from jaxtyping import Array, Bool, Float, Int

from jaxir._math import on_platform
from jaxir.geometry import Rays, corners_of, dot, for_each, in_blocks, unit_normal, varying
from jaxir.geometry.search._bundles import BEYOND, TILE, Tile, dual, project, search_tile, see
from jaxir.geometry.search._hits import NONE, Query
from jaxir.geometry.search._lockstep import side_by_side
from jaxir.geometry.search._mesh import Mesh, any_hit, off_face
from jaxir.geometry.search._single import settled


def occluded(
    mesh: Mesh,
    point: Float[Array, "ray 3"],
    face: Int[Array, " ray"],
    toward: Float[Array, " 3"],
    active: Bool[Array, " ray"],
) -> Bool[Array, " ray"]:
    """Whether points on the mesh are hidden from a parallel source.

    On a closed mesh a point is hidden when its face looks away, or when a face that looks away lies before it: a ray
    from the lamp that reaches the back of a face has passed through the body. So the point's own face and its lit
    neighbours cannot shade it. On an open mesh both sides of a face are skin, and the point's own face is skipped.
    In both cases the point is first moved off its face by rounding, as for `leaving` in `closest_hit`.

    Args:
        mesh: the triangles.
        point: on the mesh [ray, 3] [m]; neighbours in this list should be neighbours in space.
        face: the face on which each point lies, -1 for a point in free space [ray].
        toward: unit vector to the source [3].
        active: False leaves a point out, at no cost [ray].

    Returns:
        True where an active point is hidden; False where it is lit or inactive [ray].

    Not differentiable: shadow edges have no derivative.
    """
    mesh, point, toward = lax.stop_gradient((mesh, point, toward))
    return _occluded(mesh, point, face, toward, active, None)


def occluded_from(
    mesh: Mesh,
    point: Float[Array, "ray 3"],
    face: Int[Array, " ray"],
    position: Float[Array, " 3"],
    active: Bool[Array, " ray"],
) -> Bool[Array, " ray"]:
    """Whether points on the mesh are hidden from a point source at `position` [3] [m]; otherwise as `occluded`.

    Fast when the source lies outside the mesh's box as seen along the line from its centre to the source.
    """
    mesh, point, position = lax.stop_gradient((mesh, point, position))
    return _occluded_from(mesh, point, face, position, active)


@jax.jit
@sequential_vmap
def _occluded_from(mesh: Mesh, point: Array, face: Array, position: Array, active: Array) -> Array:
    tree = mesh.search_tree()
    ray = position[None, :] - point
    distance = jnp.sqrt(jnp.sum(ray * ray, axis=-1))
    direction = ray / jnp.where(distance > 0, distance, 1)[:, None]
    offset = position - tree.centre
    distance_of_eye = jnp.sqrt(jnp.sum(offset * offset))
    toward = offset / jnp.where(distance_of_eye > 0, distance_of_eye, 1)

    def alone() -> Array:
        far = jnp.where(active, distance, 0)
        return any_hit(mesh, Rays(point, direction), t_max=far, leaving=face)

    outside = jnp.sum(jnp.abs(toward) * tree.extent) < 0.99 * distance_of_eye
    inverse_range = 1 / jnp.where(outside, distance_of_eye, 1)
    return lax.cond(outside, lambda: _occluded(mesh, point, face, toward, active, inverse_range), alone)


@jax.jit
@sequential_vmap
def _occluded(
    mesh: Mesh, point: Array, face: Array, toward: Array, active: Array, inverse_range: Array | None
) -> Array:
    """The shadow of one bundle of rays, parallel to `toward` or to an eye that lies this way from the tree's centre."""
    tree = mesh.search_tree()
    frame = orthonormal(toward)
    scene = see(tree, tree.centre, frame, inverse_range)
    offset = off_face(tree)

    side = -1 if mesh.closed else 0

    def tile(point: Array, face: Array, active: Array) -> Array:
        position, lit = start(point, face)
        away = (face >= 0) & (lit <= 0) if mesh.closed else jnp.zeros_like(active)
        skip = None if mesh.closed else face
        x, y, z = (dot(list(axis), position) for axis in frame)
        scale = jnp.ones_like(z) if inverse_range is None else 1 / (1 - z * inverse_range)
        limit = jnp.where(active & ~away, project(-z, inverse_range), -BEYOND)
        found = search_tile(scene, Tile(x * scale, y * scale, limit, skip), side, any_hit=True)
        return jnp.where(active & away, 0, found)

    def start(point: Array, face: Array) -> tuple[list[Array], Array]:
        """Points off their faces, measured from the tree's centre, and how much of the light their faces look at."""
        normal = unit_normal(corners_of(mesh.vertices, mesh.faces, face))
        position = [point[:, k] - tree.centre[k] for k in range(3)]
        if inverse_range is None:
            lit = dot(normal, list(toward))
        else:
            lit = dot(normal, [toward[k] - position[k] * inverse_range for k in range(3)])
        step = jnp.where(face >= 0, offset * jnp.sign(lit), 0)
        return [position[k] + step * normal[k] for k in range(3)], lit

    def ask(ray: tuple[Array, Array]) -> Query:
        """The ray of one point in double precision."""
        point, face = ray
        double = jnp.float64
        position = jnp.concatenate(start(point[None, :], face[None])[0]).astype(double)
        w = dual(frame)[2]
        direction, far = w, jnp.full((), jnp.inf, double)
        if inverse_range is not None:
            direction = w / inverse_range.astype(double) - position
            far = jnp.sqrt(jnp.sum(direction * direction))
            direction = direction / far
        skip = jnp.full((), -1, jnp.int32) if mesh.closed else face
        origin = position + tree.centre.astype(double)
        near, looking = jnp.zeros((), double), jnp.full((), side, double)
        return Query(origin, direction, near, far, skip, looking, jnp.asarray(True))

    def by_tiles(*rays: Array) -> Array:
        count = len(point)
        size = min(TILE, -(-count // 16) * 16)
        return _where_active(tile, *(in_blocks(x, size) for x in rays)).reshape(-1)[:count]

    def all_at_once(point: Array, face: Array, active: Array) -> Array:
        found = side_by_side(tree, (point, face), ask)
        if mesh.closed:
            found = jnp.where((face >= 0) & (start(point, face)[1] <= 0), 0, found)
        return jnp.where(active, found, NONE)

    found = on_platform(point, face, active, cpu=by_tiles, default=all_at_once)
    return settled(tree, found, (point, face), ask) >= 0


def _where_active(tile: Callable[..., Array], point: Array, face: Array, active: Array) -> Array:
    """`tile` of the tiles that hold an active point, one after another; `NONE` in the others."""

    def search(k: Array, found: Array) -> Array:
        return found.at[k].set(tile(point[k], face[k], active[k]))

    return for_each(jnp.any(active, axis=1), search, varying(jnp.full(active.shape, NONE, jnp.int32), point))


def orthonormal(w: Float[Array, " 3"]) -> Float[Array, "3 3"]:
    """Rows u, v, w of a right-handed frame about the unit vector w [3]."""
    helper = jnp.where(jnp.abs(w[2]) < 0.9, jnp.asarray([0, 0, 1], w.dtype), jnp.asarray([0, 1, 0], w.dtype))
    u = jnp.cross(helper, w)
    u = u / jnp.sqrt(jnp.sum(u * u))
    return jnp.stack([u, jnp.cross(w, u), w])
