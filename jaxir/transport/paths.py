"""Trace: where rays go. Nothing in it is differentiated."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Key

from jaxir.geometry import Bundle, Crossings, Hit, Rays, crossings, no_hit
from jaxir.geometry.search import closest_hit
from jaxir.scene.plume import GridPlume
from jaxir.scene.scene import Scene
from jaxir.transport.around import Around, Leg, Vertex, look_around
from jaxir.transport.reflection import Reflection, reflection_of
from jaxir.transport.scatter_trace import ScatterPath, follow
from jaxir.transport.scattering import Scattering, scattering_of
from jaxir.transport.sight import lit_alone, lit_from, normal_towards


class Chain(eqx.Module):
    """What happened from bounce to bounce, stacked over the vertices of the paths.

    Attributes:
        vertex: where paths touched the skin; the first is where they left for the eye.
        around: lights sampled there.
        leg: how paths went on from there; the last leg of all goes nowhere.
    """

    vertex: Vertex
    around: Around | None
    leg: Leg


class Paths(eqx.Module):
    """What a batch of rays met: the record between trace and evaluate.

    Attributes:
        rays: the rays.
        hit: where they meet the skin; None without skin.
        normal: unit normal on the side the ray came from [ray, 3], minus the ray's direction where the skin is not
            met; None without skin.
        lit: whether the skin at the hit sees each delta source [source, ray]; None without skin or such sources.
        crossings: cells of the plume crossed in front of the skin; None without a gridded plume, or where the
            walk is repeated at every evaluation instead of stored.
        around: lights sampled at the hit; None where nothing is sampled.
        chain: bounces; None without, and with particles.
        scatter: legs through a plume with particles; None without them.
    """

    rays: Rays
    hit: Hit | None
    normal: Float[Array, "ray 3"] | None
    lit: Bool[Array, "source ray"] | None
    crossings: Crossings | None
    around: Around | None = None
    chain: Chain | None = None
    scatter: ScatterPath | None = None

    @property
    def length(self) -> Float[Array, " ray"]:
        """Distance to the skin [ray] [m]; inf for rays that leave the scene."""
        if self.hit is None:
            return jnp.full((self.rays.count,), jnp.inf, self.rays.origin.dtype)
        return self.hit.t

    def vertex(self) -> Vertex:
        """Where the rays meet the skin."""
        assert self.hit is not None and self.normal is not None
        return Vertex(self.hit.face, self.hit.point, self.normal, -self.rays.direction, self.lit)


def trace(
    scene: Scene,
    rays: Rays | Bundle,
    reflection: Reflection | None = None,
    key: Key[Array, ""] | None = None,
    scattering: Scattering | None = None,
) -> Paths:
    """Follow rays to the first face they meet, from there to every delta source, and on as `reflection` asks.

    Args:
        scene: only its geometry, the places of its sources and, for sampling, its brdf are used.
        rays: unrelated rays, or a bundle (faster).
        reflection: how light from lights with an extent, from the background and from the skin itself is found;
            None: `Reflection()` if the scene has area sources, else only delta sources light the skin.
        key: random key; needed where anything is sampled.
        scattering: how often paths are scattered by particles; None: `Scattering()` if the plume has particles.

    Returns:
        The paths, without derivatives, with every sampled direction and its weight; plume cells are not stored, see
        `store_crossings`.

    Raises:
        ValueError: something is to be sampled and there is no key.
    """
    scene, rays = jax.tree.map(
        lambda leaf: lax.stop_gradient(leaf) if eqx.is_inexact_array(leaf) else leaf, (scene, rays)
    )
    reflection, scattering = reflection_of(scene, reflection), scattering_of(scene, scattering)
    if scattering is None:
        return _trace(scene, rays, reflection, key)
    if key is None:
        raise ValueError("trace: got no key, expected one: scattering by particles is sampled")
    return _through_particles(scene, rays, reflection, scattering, key)


def _through_particles(
    scene: Scene, rays: Rays | Bundle, reflection: Reflection | None, scattering: Scattering, key: Array
) -> Paths:
    """The first legs as without particles, then from leg to leg."""
    paths = _trace(scene, rays, None, None)
    hit = no_hit(paths.rays.origin) if paths.hit is None else paths.hit
    vertex = None if paths.hit is None else paths.vertex()
    legs = follow(scene, reflection, scattering, paths.rays, hit, vertex, key)
    return eqx.tree_at(lambda p: p.scatter, paths, legs, is_leaf=lambda x: x is None)


def _trace(scene: Scene, rays: Rays | Bundle, reflection: Reflection | None, key: Array | None) -> Paths:
    single = rays.rays() if isinstance(rays, Bundle) else rays
    if scene.skin is None:
        return Paths(single, None, None, None, None)
    hit = closest_hit(scene.skin.mesh, rays)
    normal = normal_towards(-single.direction, hit)
    lit = None
    if scene.delta_sources:
        lit = jnp.stack([lit_from(scene, hit, normal, source) for source in scene.delta_sources])
    paths = Paths(single, hit, normal, lit, None)
    if reflection is None or not (reflection.bounces or reflection.looks(scene)):
        return paths
    if key is None:
        raise ValueError(
            "trace: got no key, expected one: light from area sources, background, skin or bounces is sampled"
        )
    if reflection.bounces == 0:
        around, _, _ = look_around(scene, reflection, paths.vertex(), key, None)
        return eqx.tree_at(lambda p: p.around, paths, around, is_leaf=lambda x: x is None)
    chain = _bounce(scene, reflection, paths.vertex(), key)
    return eqx.tree_at(lambda p: p.chain, paths, chain, is_leaf=lambda x: x is None)


def _bounce(scene: Scene, reflection: Reflection, first: Vertex, key: Array) -> Chain:
    """Go on from the skin `bounces` times."""

    def step(vertex: Vertex, drawn: tuple[Array, Array]) -> tuple[Vertex, Chain]:
        around, leg, hit = look_around(scene, reflection, vertex, *drawn)
        assert leg is not None and hit is not None
        glows = None if vertex.glows is None else jnp.zeros_like(vertex.glows)
        landed = Vertex(hit.face, hit.point, normal_towards(-leg.omega, hit), -leg.omega, None, glows)
        if vertex.lit is not None:
            lit = jnp.stack([lit_alone(scene, landed, source) for source in scene.delta_sources])
            landed = eqx.tree_at(lambda v: v.lit, landed, lit, is_leaf=lambda x: x is None)
        return landed, Chain(vertex, around, leg)

    if reflection.skin is not None:
        first = eqx.tree_at(lambda v: v.glows, first, first.face >= 0, is_leaf=lambda x: x is None)
    count = reflection.bounces + 1
    go_on = jnp.arange(count, dtype=jnp.int32) < reflection.bounces
    return lax.scan(step, first, (jax.random.split(key, count), go_on))[1]


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
