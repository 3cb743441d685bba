"""Which part of a mesh a camera sees where."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxir._programs import program
from jaxir.geometry import TILE, Camera, tile_points
from jaxir.geometry.search._mesh import Mesh, closest_hit
from jaxir.geometry.search._outline import clear_of
from jaxir.geometry.search._tree import WIDTH


@program
def visible_faces(mesh: Mesh, camera: Camera) -> Int[Array, "row column"]:
    """The face that the centre of each pixel sees, -1 for none: turns values of faces into an image.

    Args:
        mesh: the triangles.
        camera: the view; the eye is outside the mesh's bounding sphere about the camera's target.

    Returns:
        Face [row, column]. Not differentiable.
    """
    edges = jnp.asarray(camera.tile_edges())
    middle = jnp.full((edges.shape[0], TILE * TILE, 2), 0.5, camera.pixel.dtype)
    start = clear_of(mesh.outline(WIDTH), mesh.vertices, camera)
    hit = closest_hit(mesh, camera.bundle(tile_points(edges, middle).reshape(-1, 2), start))
    return camera.untile(hit.face.reshape(middle.shape[:2]))
