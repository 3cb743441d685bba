"""Triangle meshes and the one door to them: `closest_hit` and `any_hit`."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxir._arrays import Check, as_float, below, enforce, finite, float_dtype, told_apart
from jaxir._math import dot
from jaxir._plausible import EXTENT
from jaxir.geometry import Bundle, Hit, Rays, corners_of, reattach, unit_normal
from jaxir.geometry.search._bundles import View, project, search_bundle
from jaxir.geometry.search._hits import Query
from jaxir.geometry.search._outline import front_of, outline
from jaxir.geometry.search._single import search_single
from jaxir.geometry.search._topology import is_closed
from jaxir.geometry.search._tree import WIDTH, Tree, build, single_leaf

HANDFUL = 32  # faces up to which a mesh has no tree: they are its only leaf
_LARGEST = 1e9  # [m]; products of three coordinates must not overflow in float32
_OFFSET = 32.0  # units of the last place of the mesh's size by which a ray leaves a face of an open mesh


class Mesh(eqx.Module):
    """Triangles with outward orientation by the right-hand rule, and the tree in which rays search them.

    The constructor runs on the host, because it builds the tree and looks whether the faces bound a solid; use
    `refit` to move the vertices of an existing mesh, under jit or not. Replacing `vertices` alone would leave the
    tree behind.

    Attributes:
        vertices: [vertex, 3] [m].
        faces: vertex indices [face, 3], int32.
        tree: None for a handful of faces.
        closed: whether the faces bound a solid and look outwards, see `topology.is_closed`.
    """

    vertices: Float[Array, "vertex 3"]
    faces: Int[Array, "face 3"]
    tree: Tree | None
    closed: bool = eqx.field(static=True)

    def __init__(self, vertices: Any, faces: Any):
        self.vertices = as_float(vertices, "Mesh.vertices")
        index = np.asarray(faces)
        if index.ndim != 2 or index.shape[-1] != 3 or not np.issubdtype(index.dtype, np.integer):
            raise ValueError(f"Mesh.faces: got {index.dtype} of shape {index.shape}, expected integers (face, 3)")
        if not 0 < index.shape[0] <= 2**27:
            raise ValueError(f"Mesh.faces: got {index.shape[0]} faces, expected 1 to {2**27}")
        if self.vertices.ndim != 2 or self.vertices.shape[1] != 3:
            raise ValueError(f"Mesh.vertices: got shape {self.vertices.shape}, expected (vertex, 3)")
        if index.min() < 0 or index.max() >= self.vertices.shape[0]:
            raise ValueError(
                f"Mesh.faces: got indices {index.min()} to {index.max()}, expected 0 to {self.vertices.shape[0] - 1}"
            )
        self.faces = jax.device_put(index.astype(np.int32))
        if isinstance(self.vertices, jax.core.Tracer):
            if len(index) > HANDFUL:
                raise ValueError(
                    f"Mesh.vertices: got a traced array, expected known values for a mesh of {len(index)} faces; "
                    "build the mesh outside jit and move it with Mesh.refit"
                )
            self.tree, self.closed = None, False
        else:
            enforce(self.vertices, [*self.checks(), _edges_told(vertices, index)])
            points = np.asarray(self.vertices)
            self.tree = build(points, index) if len(index) > HANDFUL else None
            self.closed = is_closed(points, index)

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

    def outline(self, most: int) -> Float[Array, "row 96"]:
        """Boxes that hold the mesh, see `jaxir.geometry.search`: at most `most`, but the 16 below the tree's root."""
        if self.tree is not None:
            return self.tree.outline(most)
        corners = self.corners()
        return outline(corners.min(axis=1), corners.max(axis=1))

    def refit(self, vertices: Any) -> Mesh:
        """The same faces about moved vertices [vertex, 3] [m]; runs under jit.

        The search stays exact; it slows down when faces that were neighbours move far apart. A closed mesh must stay
        closed: vertices that coincided still do, and it is not turned inside out.

        Raises:
            ValueError: the number of vertices changes.

        Differentiable in vertices.
        """
        moved = as_float(vertices, "Mesh.vertices")
        if moved.shape != self.vertices.shape:
            raise ValueError(f"Mesh.vertices: got shape {moved.shape}, expected {self.vertices.shape}")
        tree = None if self.tree is None else self.tree.refit(lax.stop_gradient(moved), self.faces)
        return eqx.tree_at(lambda m: (m.vertices, m.tree), self, (moved, tree), is_leaf=lambda x: x is None)

    def search_tree(self) -> Tree:
        """The tree, or all faces as its only leaf."""
        return lax.stop_gradient(single_leaf(self.vertices, self.faces) if self.tree is None else self.tree)

    def checks(self) -> list[Check]:
        """Vertices are finite and not astronomical; the mesh is as large as a body is."""
        return [
            finite("Mesh.vertices", self.vertices),
            below("Mesh.vertices", self.vertices, _LARGEST, "m"),
            EXTENT("Mesh: longest side", self.vertices, lambda points: np.ptp(points, axis=-2).max(axis=-1)),
        ]


def _edges_told(vertices: Any, faces: np.ndarray) -> Check:
    """Coordinates as they were given are told much more finely than the median edge."""
    corners = np.asarray(vertices, np.float64)[faces]
    length = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
    typical = np.median(length[length > 0]) if length.any() else np.inf
    return told_apart("Mesh.vertices", np.abs(corners).max().astype(float_dtype()), typical, "edges")


def closest_hit(
    mesh: Mesh,
    rays: Rays | Bundle,
    t_min: Float[Array, " ray"] | float = 0.0,
    t_max: Float[Array, " ray"] | float = jnp.inf,
    leaving: Int[Array, " ray"] | None = None,
) -> Hit:
    """The first face that each ray meets with t_min < t < t_max.

    Both sides of a face are met; a face without area never is. Whether a face is met is decided for the numbers as they
    are given: where rounding in float32 leaves it open the ray is searched again in double precision, in which a ray
    within 11 eps of an edge meets it. So no ray slips through a shared edge or vertex, and none is stopped beside a
    silhouette. A ray that goes on from a hit with `leaving` crosses the skin of a closed mesh once there, also through
    an edge or a vertex; on an open mesh so does one whose faces fold by less than a right angle. Of faces at the same
    t any one may be reported.

    Args:
        mesh: the triangles.
        rays: unrelated rays, or a bundle, which is faster. A bundle keeps its speed when it starts beyond the whole
            mesh and t_min is 0.
        t_min: per ray or one for all [m].
        t_max: per ray or one for all [m]; a ray with t_max <= t_min is inactive: it meets nothing and costs nothing.
        leaving: the face on which each ray starts, -1 for none [ray]. That face is not met again, nor are its
            neighbours where the ray starts: the ray starts a rounding distance (4e-6 of the mesh's size in float32)
            off the face, on the side to which it goes; and on a closed mesh, which it must next enter (or leave, when
            it goes inwards), it meets only faces that look against it (along it), on an open mesh any but that face.

    Returns:
        The hits.

    Differentiable in vertices and rays through t, barycentrics, point, normal; visibility has no derivative.
    """
    return hit_on(mesh, rays, _face(mesh, rays, t_min, t_max, leaving, some=False))


def any_hit(
    mesh: Mesh,
    rays: Rays | Bundle,
    t_min: Float[Array, " ray"] | float = 0.0,
    t_max: Float[Array, " ray"] | float = jnp.inf,
    leaving: Int[Array, " ray"] | None = None,
) -> Bool[Array, " ray"]:
    """Whether each ray meets any face with t_min < t < t_max; arguments as in `closest_hit`. Not differentiable."""
    return _face(mesh, rays, t_min, t_max, leaving, some=True) >= 0


def face_met(
    mesh: Mesh, rays: Rays, some: Bool[Array, " ray"], t_max: Float[Array, " ray"], leaving: Int[Array, " ray"] | None
) -> Int[Array, " ray"]:
    """The face of `closest_hit`, -1 for none, or any face before t_max for those rays of which `some` will do.

    One search for rays that ask one and rays that ask the other. Not differentiable; see `hit_on`.
    """
    return _face(mesh, rays, 0.0, t_max, leaving, some)


# Inner functions are compiled as units: without jit around it, every call would trace its loops anew.


@jax.jit
def hit_on(mesh: Mesh, rays: Rays | Bundle, face: Int[Array, " ray"]) -> Hit:
    """Where rays meet the planes of faces; face -1 meets nothing. Differentiable as `closest_hit`."""
    single = rays.rays() if isinstance(rays, Bundle) else rays
    return Hit(face, *reattach(mesh.vertices, mesh.faces, face, single.origin, single.direction))


def _face(mesh: Mesh, rays: Rays | Bundle, t_min: Any, t_max: Any, leaving: Array | None, some: bool | Array) -> Array:
    """The face that each ray meets, -1 for none; nothing in here is differentiated.

    `some` tells whether any face will do, of all rays or of each; rays of a bundle meet the first in any case.
    """
    dtype = mesh.vertices.dtype
    # limits that are known to be none cost nothing
    near = None if isinstance(t_min, (int, float)) and t_min == 0 else t_min
    far = None if isinstance(t_max, (int, float)) and t_max == jnp.inf else t_max
    near, far = (None if t is None else jnp.broadcast_to(jnp.asarray(t, dtype), (rays.count,)) for t in (near, far))
    mesh, rays, near, far = lax.stop_gradient((mesh, rays, near, far))
    if isinstance(rays, Rays) or near is not None or leaving is not None:
        return _search_single(mesh, rays, near, far, leaving, jnp.broadcast_to(some, (rays.count,)))
    return _search_bundle(mesh, rays, far)


@jax.jit
def _search_single(
    mesh: Mesh, rays: Rays | Bundle, near: Array | None, far: Array | None, leaving: Array | None, some: Array
) -> Array:
    tree = mesh.search_tree()
    near, far = (
        jnp.full((rays.count,), none, mesh.vertices.dtype) if limit is None else limit
        for limit, none in ((near, 0.0), (far, jnp.inf))
    )
    return search_single(tree, _query(mesh, tree, rays, near, far, leaving, some))


@jax.jit
def _search_bundle(mesh: Mesh, bundle: Bundle, far: Array | None) -> Array:
    # seen from beyond a closed mesh, the first face met looks at the eye
    side = 1 if mesh.closed else 0
    return search_bundle(mesh.search_tree(), bundle_view(bundle, far), _before(mesh, bundle), side)


def _query(
    mesh: Mesh, tree: Tree, rays: Rays | Bundle, near: Array, far: Array, leaving: Array | None, some: Array
) -> Query:
    single = rays.rays() if isinstance(rays, Bundle) else rays
    origin, direction = single.origin, single.direction
    side, skip = jnp.zeros_like(near), jnp.full(near.shape, -1, jnp.int32)
    if leaving is not None:
        started = leaving >= 0
        normal = face_normal(mesh, jnp.maximum(leaving, 0))
        along = jnp.sign(dot(normal, direction))
        origin = origin + jnp.where(started, off_face(tree) * along, 0)[:, None] * normal
        if mesh.closed:
            side = jnp.where(started, -along, 0)
        else:
            skip = leaving
    return Query(origin, direction, near, far, skip, side, some)


def face_normal(mesh: Mesh, face: Int[Array, " ray"]) -> Float[Array, "ray 3"]:
    """Unit normals of faces [ray, 3]; 0 for a face without area."""
    return jnp.stack(unit_normal(corners_of(mesh.vertices, mesh.faces, face))).T


def off_face(tree: Tree) -> Float[Array, ""]:
    """Distance by which rays start off their faces [m]: some rounding errors of the mesh's coordinates."""
    size = jnp.sqrt(jnp.sum(tree.extent * tree.extent)) + jnp.max(jnp.abs(tree.centre))
    return _OFFSET * jnp.finfo(size.dtype).eps * size


def bundle_view(bundle: Bundle, far: Float[Array, " ray"] | None) -> View:
    """The projective map of a bundle whose rays end at `far` [ray] [m]; those with far <= 0 are inactive."""
    limit = None
    if far is not None:
        x, y = bundle.screen[:, 0], bundle.screen[:, 1]
        slant = 1 / jnp.sqrt(1 + bundle.inverse_range**2 * (x * x + y * y))
        limit = jnp.where(far > 0, project(far * slant - bundle.start, bundle.inverse_range), -jnp.inf)
    return View(bundle.target, bundle.frame, bundle.inverse_range, bundle.start, bundle.screen, limit)


def _before(mesh: Mesh, bundle: Bundle) -> Bool[Array, ""]:
    """Whether the whole tree lies beyond the plane on which the bundle starts."""
    front = front_of(mesh.outline(WIDTH), bundle.frame[2], bundle.target)
    return (front < bundle.start) & (front * bundle.inverse_range < 1)
