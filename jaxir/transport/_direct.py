"""Direct light by multiple importance sampling: one loop over all lights, at points of skin and at particles."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Key

from jaxir._math import dot
from jaxir.geometry import Hit, Rays, no_hit
from jaxir.geometry.search import Mesh, face_met, face_normal, hit_on
from jaxir.scene import Scene
from jaxir.transport._lights import Drawn, Met, SampledLight
from jaxir.transport._method import Method, concavity
from jaxir.transport._paths import LightSamples


def mis_weight(
    count: int, pdf: Float[Array, "*batch"], other_count: int, other_pdf: Float[Array, "*batch"]
) -> Float[Array, "*batch"]:
    """Quadratic heuristic (9): (n p)^2 / ((n p)^2 + (n' p')^2) for one of n samples drawn with density p.

    Veach and Guibas, "Optimally combining sampling techniques for Monte Carlo rendering" (SIGGRAPH 1995). The larger
    of the two is divided out first, so neither square overflows.

    Args:
        count: n, samples of this way.
        pdf: p, its density [sr-1].
        other_count: n', samples of the other way.
        other_pdf: p', the density the other way has for the same direction [sr-1].

    Returns:
        Weight in [0, 1]; 0 where both densities are 0.
    """
    mine, other = count * pdf, other_count * other_pdf
    larger = jnp.maximum(mine, other)
    scale = jnp.where(larger > 0, larger, 1)
    a, b = (mine / scale) ** 2, (other / scale) ** 2
    return jnp.where(larger > 0, a / jnp.where(larger > 0, a + b, 1), 0)


# The loop -------------------------------------------------------------------------------------------------------------


class Points(NamedTuple):
    """Points from which lights are looked for, of skin or in free space.

    Attributes:
        point: [ray, 3] [m].
        normal: [ray, 3]; for particles any.
        face: of the skin, -1 in free space [ray].
        active: whether a path touches there [ray].
        above: whether directions below `normal` are of no use; static.
    """

    point: Float[Array, "ray 3"]
    normal: Float[Array, "ray 3"]
    face: Int[Array, " ray"]
    active: Bool[Array, " ray"]
    above: bool


class Spread(NamedTuple):
    """How points reflect or scatter: a direction from two uniform numbers [ray, 2], and the density of directions."""

    sample: Callable[[Float[Array, "ray 2"]], Float[Array, "ray 3"]]
    pdf: Callable[[Float[Array, "ray 3"]], Float[Array, " ray"]]


class Straight(NamedTuple):
    """Sources without extent as points ask for them: directions, and distances [m] or 0 where they do not ask."""

    omega: Float[Array, "source ray 3"]
    reach: Float[Array, "source ray"]


class Onward(NamedTuple):
    """The next segment: direction, 1 / density (0 where the path ends), and what it meets (t = 0 where it ends)."""

    omega: Float[Array, "ray 3"]
    inverse_pdf: Float[Array, " ray"]
    hit: Hit


def sample_direct(
    scene: Scene,
    method: Method,
    lights: tuple[SampledLight, ...],
    at: Points,
    spread: Spread,
    key: Key[Array, ""] | None,
    go_on: Bool[Array, " ray"] | None,
    straight: Straight,
) -> tuple[tuple[LightSamples, ...], Onward | None, Bool[Array, "source ray"]]:
    """Sample lights from points, and the directions in which their paths go on, and see what is hidden.

    The first direction drawn from the brdf or phase function is also that of the next segment: one ray finds lights
    and skin.

    Args:
        scene: without derivatives.
        method: resolved.
        lights: of `lights_at_skin` or `lights_at_particles`.
        at: the points.
        spread: how they reflect or scatter.
        key: random key; None where nothing is drawn.
        go_on: whether paths go on [ray]; None where no path ever does.
        straight: the sources without extent that are asked for.

    Returns:
        Samples of each light; the next segments, None where no path goes on; which of `straight` are seen.
    """
    count, own = method.counts if lights else (0, 0)
    onward = max(own, 0 if go_on is None else 1)
    rays = at.point.shape[0]
    keys = None  # [ray, decision]
    if key is not None:
        keys = jax.vmap(lambda k: jax.random.split(k, 1 + len(lights)))(jax.random.split(key, rays))

    def upward(omega: Array, pdf: Array) -> Array:
        good = at.active[None] & (pdf > 0)
        return good & (dot(omega, at.normal[None]) > 0) if at.above else good

    # Directions of the brdf or the phase function ---------------------------------------------------------------------
    u = (
        jax.vmap(lambda k: method.sampler.draw(k, onward), out_axes=1)(keys[:, 0])
        if onward and keys is not None
        else jnp.zeros((0, rays, 2))
    )
    u = u.astype(at.point.dtype)
    omega = jax.vmap(spread.sample)(u)
    density = jax.vmap(spread.pdf)(omega)
    sent = upward(omega, density)

    # Directions towards the lights ------------------------------------------------------------------------------------
    def drawn_from(place: int, light: SampledLight) -> Drawn:
        assert keys is not None

        def one(key: Array, point: Array, normal: Array) -> Drawn:
            return light.sample(lambda k: method.sampler.draw(jax.random.fold_in(key, k), count), point, normal)

        return jax.vmap(one, out_axes=1)(keys[:, 1 + place], at.point, at.normal)

    drawn = [drawn_from(place, light) for place, light in enumerate(lights)] if count else []
    good = [upward(d.omega, d.pdf) for d in drawn]

    # What they meet, all in one search --------------------------------------------------------------------------------
    hollow = _hollow(scene, at)
    limit = jnp.zeros((onward, rays), at.point.dtype)
    for light in lights if own else ():
        limit = limit.at[:own].max(_limit(light, at, omega[:own], sent[:own]))
    if go_on is not None:
        limit = limit.at[0].set(jnp.where(go_on & sent[0], jnp.inf, limit[0]))
    order = sorted(range(len(drawn)), key=lambda place: lights[place].needs_face)  # those that ask for less come first
    reach = [jnp.where(good[i], jnp.inf if lights[i].needs_face else drawn[i].distance, 0) for i in order]
    beams = straight.reach.shape[0]
    hidden, hit = _first_met(
        scene,
        at,
        hollow,
        jnp.concatenate([straight.omega, *(drawn[i].omega for i in order), omega]),
        jnp.concatenate([*(part.astype(limit.dtype) for part in (straight.reach, *reach)), limit]),
        beams + count * sum(not lights[i].needs_face for i in order),
    )
    sees = (straight.reach > 0) & ~hidden[:beams]
    hidden = hidden[beams:]
    shadowed = Met(jnp.full(hidden.shape, -1, jnp.int32), jnp.where(hidden, 0, jnp.inf).astype(omega.dtype))
    every = jax.tree.map(lambda *each: jnp.concatenate(each), shadowed, Met(hit.face, hit.t))
    met = {i: jax.tree.map(lambda leaf, k=k: leaf[k * count : (k + 1) * count], every) for k, i in enumerate(order)}
    first_met = jax.tree.map(lambda leaf: leaf[leaf.shape[0] - onward :], hit)

    # Weights (9) ------------------------------------------------------------------------------------------------------
    found = []
    for place, light in enumerate(lights):
        parts = []
        if count:
            d = drawn[place]
            weight = mis_weight(count, d.pdf, own, jax.vmap(spread.pdf)(d.omega)) if own else jnp.ones_like(d.pdf)
            seen, distance = light.seen(d, met[place])
            parts.append(_samples(light, d.omega, distance, good[place] & seen, weight, count, d.pdf, d.face))
        if own:
            first = Met(first_met.face[:own], first_met.t[:own])
            meet = jax.vmap(jax.vmap(light.meet), in_axes=(0, None, None, 0))
            distance, pdf = meet(omega[:own], at.point, at.normal, first)
            weight = mis_weight(own, density[:own], count, pdf)
            seen, distance = light.seen(Drawn(omega[:own], distance, pdf, first.face), first)
            seen = seen & sent[:own] & (light.needs_face | (pdf > 0))
            parts.append(_samples(light, omega[:own], distance, seen, weight, own, density[:own], first.face))
        found.append(jax.tree.map(lambda *each: jnp.concatenate(each), *parts))
    if go_on is None:
        return tuple(found), None, sees
    on = go_on & sent[0]
    hit = jax.tree.map(lambda leaf: leaf[0], first_met)
    hit = eqx.tree_at(lambda h: (h.face, h.t), hit, (jnp.where(on, hit.face, -1), jnp.where(on, hit.t, 0)))
    # where paths end any unit vector does, but not one drawn about it: lengths would err twice as much every time
    along = jnp.where(on[:, None], omega[0], at.normal)
    return tuple(found), Onward(along, jnp.where(on, 1 / jnp.where(on, density[0], 1), 0), hit), sees


def _samples(
    light: SampledLight, omega: Array, distance: Array, good: Array, weight: Array, count: int, pdf: Array, face: Array
) -> LightSamples:
    share = jnp.where(good, weight / (count * jnp.where(good, pdf, 1)), 0)
    return LightSamples(omega, distance, share, jnp.where(good, face, -1) if light.keeps_face else None)


def _limit(light: SampledLight, at: Points, omega: Array, sent: Array) -> Array:
    """How far directions [sample, ray] must be followed to know what they see of a light [m]; 0 for nothing."""
    if light.needs_face:
        return jnp.where(sent, jnp.inf, 0).astype(omega.dtype)
    nothing = Met(jnp.full(sent.shape, -1, jnp.int32), jnp.full(sent.shape, jnp.inf, omega.dtype))
    meet = jax.vmap(jax.vmap(light.meet), in_axes=(0, None, None, 0))
    distance, pdf = meet(omega, at.point, at.normal, nothing)
    return jnp.where(sent & (pdf > 0), distance, 0)


def _first_met(
    scene: Scene, at: Points, hollow: Array, omega: Array, reach: Array, some: int
) -> tuple[Bool[Array, "some ray"], Hit]:
    """What directions [sample, ray] meet within a reach: of the first `some` samples whether anything, else the hit."""
    samples, count = reach.shape
    origin, leaving = jnp.broadcast_to(at.point[None], omega.shape), jnp.broadcast_to(at.face[None], reach.shape)
    rays, leaving = Rays(origin.reshape(-1, 3), omega.reshape(-1, 3)), leaving.reshape(-1)
    begin = some * count
    late = jax.tree.map(lambda leaf: leaf[begin:], rays)

    def nothing() -> tuple[Array, Hit]:
        return jnp.full(rays.count, -1, jnp.int32), no_hit(late.origin)

    def search(mesh: Mesh) -> tuple[Array, Hit]:
        face = face_met(mesh, rays, jnp.arange(rays.count) < begin, reach.reshape(-1), leaving)
        return face, hit_on(mesh, late, face[begin:]) if late.count else no_hit(late.origin)

    found = nothing()
    if scene.skin is not None and rays.count:
        found = lax.cond(hollow, partial(search, scene.skin.mesh), nothing)
    face, hit = found
    shaped = jax.tree.map(lambda leaf: leaf.reshape(samples - some, count, *leaf.shape[1:]), hit)
    return (face[:begin] >= 0).reshape(some, count), shaped


def _hollow(scene: Scene, at: Points) -> Bool[Array, ""]:
    """False where nothing can hide anything: skin of a handful of faces, flat, or closed, convex, seen from outside."""
    if scene.skin is None or scene.skin.mesh.tree is not None or not at.above:
        return jnp.asarray(True)
    mesh: Mesh = scene.skin.mesh
    outward = face_normal(mesh, jnp.maximum(at.face, 0))
    inside = (at.face >= 0) & (dot(at.normal, outward) < 0) & mesh.closed
    return jnp.any(jnp.greater(*concavity(mesh))) | jnp.any(inside)
