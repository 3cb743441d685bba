"""What points of the skin see: which side of a face they are on, and which lights without extent reach them."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxir._math import dot
from jaxir.geometry import Hit, Rays
from jaxir.geometry.search import any_hit, occluded, occluded_from
from jaxir.scene.near_source import PointSource
from jaxir.scene.scene import Scene
from jaxir.scene.source import AbstractDeltaSource, ParallelSource
from jaxir.transport.around import Vertex


def normal_towards(omega: Array, hit: Hit) -> Array:
    """Normals on the side of `omega`; `omega` itself on a miss."""
    side = jnp.where(dot(hit.normal, omega) < 0, -1, 1).astype(omega.dtype)
    return jnp.where((hit.face >= 0)[:, None], side[:, None] * hit.normal, omega)


def lit_from(scene: Scene, hit: Hit, normal: Array, source: AbstractDeltaSource) -> Array:
    """Whether each hit faces a source without extent and sees it: all points look along one bundle."""
    assert scene.skin is not None
    omega_i, distance = jax.vmap(source.toward)(hit.point)
    facing = (hit.face >= 0) & (distance > 0) & (dot(normal, omega_i) > 0)
    if isinstance(source, ParallelSource):
        return facing & ~occluded(scene.skin.mesh, hit.point, hit.face, -source.direction, facing)
    assert isinstance(source, PointSource)
    return facing & ~occluded_from(scene.skin.mesh, hit.point, hit.face, source.position, facing)


def lit_alone(scene: Scene, vertex: Vertex, source: AbstractDeltaSource) -> Array:
    """The same for points that are no neighbours."""
    assert scene.skin is not None
    omega_i, distance = jax.vmap(source.toward)(vertex.point)
    facing = (vertex.face >= 0) & (distance > 0) & (dot(vertex.normal, omega_i) > 0)
    reach = jnp.where(facing, distance, 0)
    return facing & ~any_hit(scene.skin.mesh, Rays(vertex.point, omega_i), t_max=reach, leaving=vertex.face)
