"""Trace: where rays go. All randomness and all geometry is here, and nothing in it is differentiated."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Key

from jaxir._math import dot, in_kernels
from jaxir._programs import program
from jaxir.geometry import Bundle, Hit, Rays, no_hit
from jaxir.geometry.search import closest_hit
from jaxir.scene import Scene
from jaxir.scene.light import AbstractDeltaSource
from jaxir.scene.plume import AbstractPlume, pdf_direction, sample_direction
from jaxir.transport._direct import Onward, Points, Spread, Straight, sample_direct
from jaxir.transport._lights import lights_at_particles, lights_at_skin
from jaxir.transport._method import Method
from jaxir.transport._paths import LightSamples, Paths, Scattering, Segment, Vertex

TOWARD_SOURCES = 0.25  # share of directions in which particles scatter paths that are drawn about those to sources


class _State(NamedTuple):
    """The segment that comes next; fields as in `Segment`, None where no path goes on, and the count of scatterings."""

    rays: Rays
    length: Array
    vertex: Vertex | None
    sees_surroundings: Array | None
    sees_plume: Array | None
    scattered: Array


class _Drawn(NamedTuple):
    """What the steps of a path are told: a random key, and whether paths may go on at all and from skin.

    And `seen`, whether it is known what points see of sources without extent.
    """

    key: Array | None
    seen: Array
    go_on: Array
    bounce: Array


@program
def trace(scene: Scene, rays: Rays | Bundle, method: Method | None = None, key: Key[Array, ""] | None = None) -> Paths:
    """Follow rays to the first face they meet, from there to every source, and on as the method asks.

    Args:
        scene: only its geometry, the places of its sources and, for sampling, its brdf and particles are used.
        rays: unrelated rays, or a bundle (faster).
        method: how light is found; None: `Method()`.
        key: random key; needed where anything is sampled.

    Returns:
        The paths, without derivatives, with every sampled direction and its weight, and with the method; plume cells
        are not stored, see `store_route`.

    Raises:
        ValueError: something is to be sampled and there is no key.
    """
    method = (Method() if method is None else method).resolved(scene)
    ambient = method.ambient  # which is no geometry
    scene, rays, method = jax.tree.map(
        lambda leaf: lax.stop_gradient(leaf) if eqx.is_inexact_array(leaf) else leaf, (scene, rays, method)
    )
    if key is None and method.needs_key(scene):
        raise ValueError("trace: got no key, expected one: lights with an extent, bounces and particles are sampled")

    # The first segments end at the eye; a bundle is searched together, for its faces and for their shadows ------------
    together = isinstance(rays, Bundle)
    single = rays.rays() if isinstance(rays, Bundle) else rays
    hit = no_hit(single.origin) if scene.skin is None else closest_hit(scene.skin.mesh, rays)
    vertex = None if scene.skin is None else _vertex(scene, method, single, hit, True, together)
    count = method.segments()
    looks = bool(scene.delta_sources) and (count > 1 or not together)
    everywhere = jnp.ones(hit.t.shape, bool) if count > 1 else None
    seen = everywhere if method.plume_light is not None and count > 1 else None
    state = _State(single, hit.t, vertex, everywhere, seen, jnp.zeros(hit.t.shape, jnp.int32))

    # Segment by segment -----------------------------------------------------------------------------------------------
    index = jnp.arange(count, dtype=jnp.int32)
    keys = None
    if key is not None and method.needs_key(scene):
        keys = jax.vmap(jax.random.fold_in, (None, 0))(key, index)
    drawn = _Drawn(keys, (index == 0) & together, index < count - 1, index < method.bounces)
    if count == 1:
        only = jax.tree.map(lambda leaf: leaf[0], drawn)
        segments = jax.tree.map(lambda leaf: leaf[None], _step(scene, method, looks, state, only)[1])
    else:
        segments = lax.scan(lambda state, own: _step(scene, method, looks, state, own), state, drawn)[1]
    return Paths(segments, dataclasses.replace(method, ambient=ambient))


def _step(scene: Scene, method: Method, looks: bool, state: _State, drawn: _Drawn) -> tuple[_State, Segment]:
    """What happens on one segment of each path, and the next one; `looks` for sources without extent."""
    count, plume = method.segments(), scene.plume
    vertex, scattering, onward = state.vertex, None, None
    at_skin, at_particle = (None, None) if drawn.key is None else jax.random.split(drawn.key)

    # Where it ends on the skin: lights, and the direction of reflection -----------------------------------------------
    lights = lights_at_skin(scene, method)
    if vertex is not None and (lights or method.bounces or looks):
        bounce = jnp.broadcast_to(drawn.bounce, state.length.shape) if method.bounces else None
        omega, distance = _toward(scene.delta_sources if looks else (), vertex.point)
        reach = jnp.where(vertex.visible & ~drawn.seen, distance, 0) if looks else distance
        found, onward, sees = _look_from_skin(scene, method, vertex, at_skin, bounce, Straight(omega, reach))
        visible = jnp.where(drawn.seen, vertex.visible, sees) if looks else vertex.visible
        vertex = dataclasses.replace(vertex, lights=found, visible=visible)

    # Where a particle scatters it before: lights, and the direction of scattering -------------------------------------
    if method.orders:
        assert plume is not None and at_particle is not None
        for_distance, for_lights = jax.random.split(at_particle)
        u = jax.random.uniform(for_distance, state.length.shape, state.length.dtype)
        forced = jnp.ones(u.shape, bool) if onward is None else onward.inverse_pdf == 0
        reach = jnp.where(drawn.go_on & (state.scattered < method.orders), state.length, 0)
        place = plume.sample_distance(state.rays, reach, u, forced)
        hits = place.inverse_pdf > 0
        point = state.rays.at(place.t)
        omega, distance = _toward(method.sampled_beams(scene), point)
        straight = Straight(omega, jnp.where(hits[None], distance, 0))
        found, from_particle, sees = _look_from_particles(scene, method, state.rays, point, hits, for_lights, straight)
        scattering = Scattering(place.t, place.inverse_pdf, state.scattered, omega, distance, sees, found)
        onward = from_particle if onward is None else _either(hits, from_particle, onward, place.passing)
    here = (state.rays, state.length, vertex, scattering, state.sees_surroundings, state.sees_plume)
    if count == 1:
        return state, Segment(*here, None, None)
    assert onward is not None

    # The next segment -------------------------------------------------------------------------------------------------
    scattered = jnp.zeros(state.length.shape, bool) if scattering is None else scattering.inverse_pdf > 0
    begin = state.rays.at(scattering.t) if scattering is not None else jnp.zeros_like(state.rays.origin)
    if state.vertex is not None:
        begin = jnp.where(scattered[:, None], begin, state.vertex.point)
    rays = Rays(begin, in_kernels(onward.omega))
    landed = None
    if state.vertex is not None:
        landed = _vertex(scene, method, rays, onward.hit, False, False)
    following = _State(
        rays,
        onward.hit.t,
        landed,
        scattered & (method.direct is not None),
        None if state.sees_plume is None else scattered,
        state.scattered + scattered.astype(jnp.int32),
    )
    return following, Segment(*here, onward.omega, onward.inverse_pdf)


def _vertex(scene: Scene, method: Method, rays: Rays, hit: Hit, first: bool, together: bool) -> Vertex:
    """Where rays meet the skin, the `first` ones or others; `together` where their points are neighbours.

    Of others `visible` tells what they face, until the next step looks whether something is in the way.
    """
    assert scene.skin is not None
    back = -rays.direction
    side = jnp.where(dot(hit.normal, back) < 0, -1, 1).astype(back.dtype)
    normal = jnp.where((hit.face >= 0)[:, None], side[:, None] * hit.normal, back)
    counts = None
    if method.skin_light is not None:  # whence paths go on, it was looked for
        counts = (hit.face >= 0) & first
    omega, distance = _toward(scene.delta_sources, hit.point)
    visible = (hit.face >= 0)[None] & (distance > 0) & (dot(normal[None], omega) > 0)
    if together and scene.delta_sources:
        mesh, each = scene.skin.mesh, zip(scene.delta_sources, visible, strict=True)
        visible = visible & ~jnp.stack([source.hidden(mesh, hit.point, hit.face, facing) for source, facing in each])
    return Vertex(hit.face, hit.point, normal, back, visible, counts)


def _toward(sources: Sequence[AbstractDeltaSource], point: Array) -> tuple[Array, Array]:
    """Directions to sources without extent [source, ray, 3], and distances [source, ray]."""
    found = [jax.vmap(source.toward)(point) for source in sources]
    if not found:
        return jnp.zeros((0, *point.shape), point.dtype), jnp.zeros((0, point.shape[0]), point.dtype)
    omega, distance = (jnp.stack(parts) for parts in zip(*found, strict=True))
    return omega, distance


def _look_from_skin(
    scene: Scene, method: Method, vertex: Vertex, key: Array | None, go_on: Array | None, straight: Straight
) -> tuple[tuple[LightSamples, ...], Onward | None, Array]:
    """Lights and directions of reflection at points of the skin."""
    assert scene.skin is not None
    brdf = scene.skin.brdf.at(jnp.maximum(vertex.face, 0))
    spread = Spread(
        lambda u: jax.vmap(lambda b, u, o, n: b.sample(u, o, n))(brdf, u, vertex.omega_o, vertex.normal),
        lambda w: jax.vmap(lambda b, w, o, n: b.pdf(w, o, n))(brdf, w, vertex.omega_o, vertex.normal),
    )
    at = Points(vertex.point, vertex.normal, vertex.face, vertex.face >= 0, above=True)
    return sample_direct(scene, method, lights_at_skin(scene, method), at, spread, key, go_on, straight)


def _look_from_particles(
    scene: Scene, method: Method, rays: Rays, point: Array, active: Array, key: Array, straight: Straight
) -> tuple[tuple[LightSamples, ...], Onward | None, Array]:
    """Lights and directions of scattering at points of particles."""
    plume = scene.plume
    assert plume is not None
    spread = _scattered_by(scene, method, plume, point, rays.direction)
    free = jnp.full(active.shape, -1, jnp.int32)
    at = Points(point, rays.direction, free, active, above=False)
    go_on = active if method.orders else None
    return sample_direct(scene, method, lights_at_particles(scene, method), at, spread, key, go_on, straight)


def _scattered_by(scene: Scene, method: Method, plume: AbstractPlume, point: Array, along: Array) -> Spread:
    """Directions of the phase function about that of a path, some about those to sources without extent.

    Where a lobe is narrow most of a source's light comes to a path along the latter, which the former seldom are: each
    would bring much, and most estimates be too small with a standard error that is, too.
    """
    axes, shares = [along], [1.0]
    if method.orders > 1 and scene.delta_sources:
        axes += list(_toward(scene.delta_sources, point)[0])
        shares = [1 - TOWARD_SOURCES] + [TOWARD_SOURCES / len(scene.delta_sources)] * len(scene.delta_sources)

    def sample(u: Array) -> Array:
        first, begin, axis = u[:, 0], 0.0, along
        for share, other in zip(shares, axes, strict=True):  # what is left of a number is uniform again
            inside = u[:, 0] >= begin
            axis = jnp.where(inside[:, None], other, axis)
            first = jnp.where(inside, (u[:, 0] - begin) / share, first)
            begin += share
        first = jnp.clip(first, 0, 1 - jnp.finfo(first.dtype).epsneg)
        return sample_direction(plume, jnp.stack([first, u[:, 1]], axis=1), point, axis)

    def pdf(omega: Array) -> Array:
        each = [share * pdf_direction(plume, dot(omega, axis), point) for share, axis in zip(shares, axes, strict=True)]
        return sum(each[1:], each[0])

    return Spread(sample, pdf)


def _either(scattered: Array, by_particle: Onward | None, by_skin: Onward, passing: Array) -> Onward:
    """The next segment from where a particle scatters a path, or from skin if it comes so far."""
    if by_particle is None:
        return by_skin._replace(inverse_pdf=by_skin.inverse_pdf * passing)
    reflected = by_skin._replace(inverse_pdf=by_skin.inverse_pdf * passing)
    return jax.tree.map(
        lambda a, b: jnp.where(scattered.reshape((-1,) + (1,) * (a.ndim - 1)), a, b), by_particle, reflected
    )


def store_route(scene: Scene, paths: Paths) -> Paths:
    """Paths with what a plume stores of their first segments, so that evaluations need not walk its grid again.

    Worth its memory when the same paths are evaluated many times, as in a fit. Paths of several segments are walked.
    """
    plume = scene.plume
    if plume is None or paths.method.segments() > 1 or paths.method.scattering is not None:
        return paths
    route = lax.stop_gradient(plume).route(paths.rays, paths.length)
    return dataclasses.replace(paths, route=route)
