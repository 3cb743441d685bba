"""Paths through a plume with particles: from leg to leg, scattered by a particle or reflected by the skin."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Key

from jaxir.geometry import Hit, Rays, no_hit, turned
from jaxir.geometry.search import any_hit, closest_hit
from jaxir.scene.background import AbstractBackground
from jaxir.scene.near_source import AbstractAreaSource
from jaxir.scene.scene import Scene
from jaxir.scene.source import AbstractDeltaSource
from jaxir.transport.around import Around, Vertex, look_around
from jaxir.transport.free_path import FreePath, free_path
from jaxir.transport.radiometry import cell_lights
from jaxir.transport.reflection import Reflection
from jaxir.transport.scattering import Scattering
from jaxir.transport.sight import lit_alone, normal_towards


class Beams(eqx.Module):
    """What a particle sees of the lights that are looked for where a path is scattered, see `vertex_lights`.

    Attributes:
        omega: unit vectors towards them [light, ray, 3].
        distance: [light, ray] [m].
        factor: 1 / density of a direction to a source with an extent [sr], 1 for one without; 0 where the light is
            not seen [light, ray].
    """

    omega: Float[Array, "*leg light ray 3"]
    distance: Float[Array, "*leg light ray"]
    factor: Float[Array, "*leg light ray"]


class ScatterPath(eqx.Module):
    """What happened from leg to leg, stacked over the legs of the paths; the first legs are the rays.

    Attributes:
        rays: origin and direction of each leg.
        length: to the skin [ray] [m]; inf where the leg leaves the scene, 0 for a path that has ended.
        vertex: where the leg ends on the skin, face -1 where it does not; None without skin.
        around: lights sampled there; None where nothing is sampled.
        open: whether a leg that leaves the scene shows what surrounds it [ray]; from skin that samples it, it does not.
        glows: whether the plume's own emission on the leg counts [ray]; not from skin that looked for it.
        place: where the path is scattered; its factor is 0 where it is not.
        omega: direction of the next leg [ray, 3].
        factor: 1 / density of that direction [ray] [sr]; 0 where the path ends, times 1 / chance of reflection rather
            than scattering where the skin reflects it.
        beams: lights as seen from where the path is scattered; None without such lights.
        events: how often the path was scattered before the leg [ray].
        orders: how often at most.
    """

    rays: Rays
    length: Float[Array, "*leg ray"]
    vertex: Vertex | None
    around: Around | None
    open: Bool[Array, "*leg ray"]
    glows: Bool[Array, "*leg ray"]
    place: FreePath
    omega: Float[Array, "*leg ray 3"]
    factor: Float[Array, "*leg ray"]
    beams: Beams | None
    events: Int[Array, "*leg ray"]
    orders: int = eqx.field(static=True)


Source = AbstractDeltaSource | AbstractAreaSource


def vertex_lights(scene: Scene) -> tuple[Source, ...]:
    """Sources looked for where a path is scattered: all but those that every leg sums up, and backgrounds."""
    others = (source for source in scene.sources if not isinstance(source, AbstractBackground))
    return tuple(source for source in others if not any(source is summed for summed in cell_lights(scene)))


def follow(
    scene: Scene,
    reflection: Reflection | None,
    scattering: Scattering,
    rays: Rays,
    hit: Hit,
    vertex: Vertex | None,
    key: Key[Array, ""],
) -> ScatterPath:
    """Follow rays that end at `hit`, `vertex`, from leg to leg.

    Args:
        scene: with particles, without derivatives.
        reflection: how the skin's reflected light is found; None: by sources without extent alone.
        scattering: how often paths are scattered.
        rays: the first legs.
        hit: where they end.
        vertex: the same as points of the skin; None without skin.
        key: random key.
    """
    plume = scene.plume
    assert plume is not None
    bounces = 0 if reflection is None else reflection.bounces
    index = jnp.arange(max(scattering.orders, bounces) + 1, dtype=jnp.int32)
    lights = () if reflection is None else reflection.lights(scene)
    looked_for = reflection is not None and reflection.looks_for_plume(scene)

    def step(state: _State, drawn: tuple[Array, Array, Array]) -> tuple[_State, ScatterPath]:
        key, more, may_bounce = drawn
        at_skin, for_place, for_omega, for_beams = jax.random.split(key, 4)
        around = leg = landed = None
        if reflection is not None and state.vertex is not None and (bounces or reflection.looks(scene)):
            around, leg, landed = look_around(scene, reflection, state.vertex, at_skin, may_bounce if bounces else None)
        u = jax.random.uniform(for_place, state.length.shape, state.length.dtype)
        forced = jnp.ones(u.shape, bool) if leg is None else leg.factor == 0
        reach = jnp.where(more & (state.events < scattering.orders), state.length, 0)
        place = free_path(plume, state.rays, reach, u, forced)
        scattered = place.factor > 0
        point = state.rays.at(place.t)
        omega, factor = _scattered(scene, state.rays.direction, for_omega)
        factor = jnp.where(scattered, factor, 0)
        beams = _beams(scene, point, scattered, for_beams)
        sight = (state.rays, state.length, state.vertex, around, state.open, state.glows)
        link = ScatterPath(*sight, place, omega, factor, beams, state.events, scattering.orders)
        onward = Rays(point, omega)
        hit = _meet(scene, onward, scattered)
        if leg is not None and state.vertex is not None:
            onward, hit = jax.tree.map(
                lambda a, b: jnp.where(scattered.reshape((-1,) + (1,) * (a.ndim - 1)), a, b),
                (onward, hit),
                (Rays(state.vertex.point, leg.omega), eqx.tree_at(lambda h: h.t, landed, leg.length)),
            )
            factor = jnp.where(scattered, factor, leg.factor * place.passing)
            link = eqx.tree_at(lambda x: (x.omega, x.factor), link, (onward.direction, factor))
        vertex = None if state.vertex is None else _vertex(scene, onward, hit, state.vertex.lit is not None)
        if state.vertex is not None and state.vertex.glows is not None:
            vertex = eqx.tree_at(lambda v: v.glows, vertex, scattered, is_leaf=lambda x: x is None)
        events = state.events + scattered.astype(jnp.int32)
        opened, glows = scattered | (len(lights) == 0), scattered | (not looked_for)
        return _State(onward, hit.t, vertex, opened, glows, events), link

    if vertex is not None and reflection is not None and reflection.skin is not None:
        vertex = eqx.tree_at(lambda v: v.glows, vertex, vertex.face >= 0, is_leaf=lambda x: x is None)
    always = jnp.ones(hit.t.shape, bool)
    state = _State(rays, hit.t, vertex, always, always, jnp.zeros(hit.t.shape, jnp.int32))
    keys = jax.random.split(key, index.shape[0])
    return lax.scan(step, state, (keys, index < index.shape[0] - 1, index < bounces))[1]


class _State(NamedTuple):
    """One leg and where it ends; fields as in `ScatterPath`."""

    rays: Rays
    length: Array
    vertex: Vertex | None
    open: Array
    glows: Array
    events: Array


def _scattered(scene: Scene, direction: Array, key: Array) -> tuple[Array, Array]:
    """A direction drawn from the guide's phase function about each ray [ray, 3], and 1 / density [ray]."""
    assert scene.plume is not None and scene.plume.particles is not None
    phase = scene.plume.particles.guide()[1]
    u = jax.random.uniform(key, (direction.shape[0], 2), direction.dtype)
    cosine = jax.vmap(phase.sample)(u[:, 0])
    return jax.vmap(turned)(cosine, u[:, 1], direction), 1 / jax.vmap(phase.pdf)(cosine)


def _meet(scene: Scene, rays: Rays, active: Array) -> Hit:
    """Where rays from free space meet the skin; t is inf for those that leave the scene, 0 for inactive ones."""
    reach = jnp.where(active, jnp.inf, 0).astype(rays.origin.dtype)
    hit = no_hit(rays.origin) if scene.skin is None else closest_hit(scene.skin.mesh, rays, t_max=reach)
    return eqx.tree_at(lambda h: h.t, hit, jnp.where(active, hit.t, 0))


def _vertex(scene: Scene, rays: Rays, hit: Hit, delta: bool) -> Vertex:
    vertex = Vertex(hit.face, hit.point, normal_towards(-rays.direction, hit), -rays.direction, None)
    if not delta:
        return vertex
    lit = jnp.stack([lit_alone(scene, vertex, source) for source in scene.delta_sources])
    return eqx.tree_at(lambda v: v.lit, vertex, lit, is_leaf=lambda x: x is None)


def _beams(scene: Scene, point: Array, active: Array, key: Array) -> Beams | None:
    """What points [ray, 3] in free space see of the lights."""
    found = []
    for place, source in enumerate(vertex_lights(scene)):
        if isinstance(source, AbstractAreaSource):
            u = jax.random.uniform(jax.random.fold_in(key, place), (point.shape[0], 2), point.dtype)
            omega, distance, pdf = jax.vmap(source.sample)(u, point)
            factor = jnp.where(pdf > 0, 1 / jnp.where(pdf > 0, pdf, 1), 0)
        else:
            omega, distance = jax.vmap(source.toward)(point)
            factor = jnp.ones_like(distance)
        seen = active & (factor > 0) & (distance > 0)
        if scene.skin is not None:
            seen = seen & ~any_hit(scene.skin.mesh, Rays(point, omega), t_max=jnp.where(seen, distance, 0))
        found.append((omega, distance, jnp.where(seen, factor, 0)))
    return Beams(*(jnp.stack(parts) for parts in zip(*found, strict=True))) if found else None
