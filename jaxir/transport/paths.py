"""Trace: where rays go. Nothing in it is differentiated."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxir.geometry.mesh import closest_hit
from jaxir.geometry.ray import Bundle, Rays
from jaxir.geometry.shadow import occluded
from jaxir.geometry.triangle import Hit
from jaxir.geometry.walk import Crossings, crossings
from jaxir.scene.plume import GridPlume
from jaxir.scene.scene import Scene


class Paths(eqx.Module):
    """What a batch of rays met: the record between trace and evaluate.

    Attributes:
        rays: the rays.
        hit: where they meet the skin; None without skin.
        normal: unit normal on the side the ray came from [ray, 3], minus the ray's direction where the skin is not
            met; None without skin.
        lit: whether the skin at the hit sees each parallel source [source, ray]; None without skin or sources.
        crossings: cells of the plume crossed in front of the skin; None without a gridded plume, or where the walk is
            repeated at every evaluation instead of stored.
    """

    rays: Rays
    hit: Hit | None
    normal: Float[Array, "ray 3"] | None
    lit: Bool[Array, "source ray"] | None
    crossings: Crossings | None

    @property
    def length(self) -> Float[Array, " ray"]:
        """Distance to the skin [ray] [m]; inf for rays that leave the scene."""
        if self.hit is None:
            return jnp.full((self.rays.count,), jnp.inf, self.rays.origin.dtype)
        return self.hit.t


def trace(scene: Scene, rays: Rays | Bundle) -> Paths:
    """Follow rays to the first face they meet and from there to every parallel source.

    Args:
        scene: only its geometry and the directions of its sources are used.
        rays: unrelated rays, or a bundle (faster).

    Returns:
        The paths, without derivatives; plume cells are not stored, see `store_crossings`.
    """
    fixed = jax.tree.map(lambda leaf: lax.stop_gradient(leaf) if eqx.is_inexact_array(leaf) else leaf, (scene, rays))
    return _trace(*fixed)


def _trace(scene: Scene, rays: Rays | Bundle) -> Paths:
    single = rays.rays() if isinstance(rays, Bundle) else rays
    if scene.skin is None:
        return Paths(single, None, None, None, None)
    hit = closest_hit(scene.skin.mesh, rays)
    away = jnp.sum(hit.normal * single.direction, axis=-1, keepdims=True) > 0
    normal = jnp.where(away, -hit.normal, hit.normal)
    normal = jnp.where((hit.face >= 0)[:, None], normal, -single.direction)
    if not scene.sources:
        return Paths(single, hit, normal, None, None)
    lit = [_lit(scene, hit, normal, source.direction) for source in scene.sources]
    return Paths(single, hit, normal, jnp.stack(lit), None)


def _lit(scene: Scene, hit: Hit, normal: Array, travel: Array) -> Array:
    """Whether each hit faces a parallel source and sees it."""
    assert scene.skin is not None
    facing = (hit.face >= 0) & (jnp.sum(normal * travel[None, :], axis=-1) < 0)
    return facing & ~occluded(scene.skin.mesh, hit.point, hit.face, -travel, facing)


def store_crossings(scene: Scene, paths: Paths) -> Paths:
    """Paths with the crossed cells of a gridded plume stored, so that evaluations need not walk the grid again.

    Worth its memory when the same paths are evaluated many times, as in a fit.
    """
    if not isinstance(scene.plume, GridPlume):
        return paths
    grid = lax.stop_gradient(scene.plume.grid)
    return eqx.tree_at(
        lambda p: p.crossings, paths, crossings(grid, paths.rays, paths.length), is_leaf=lambda x: x is None
    )
