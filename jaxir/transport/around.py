"""What the skin sees around it: sampled directions towards lights, and the direction in which a path goes on."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Key

from jaxir._math import dot
from jaxir.geometry import Hit, Rays, no_hit
from jaxir.geometry.search import Mesh, any_hit, closest_hit, face_normal
from jaxir.optics.surface import AbstractBrdf
from jaxir.scene.scene import Scene
from jaxir.transport.lights import Light, meet_light, sample_light
from jaxir.transport.mis import mis_weight
from jaxir.transport.plume_light import draw_towards, pdf_towards, plume_pieces, sight_of
from jaxir.transport.reflection import Reflection, concavity
from jaxir.transport.skin_light import draw_points, face_odds, pdf_points


class Vertex(eqx.Module):
    """Where paths touch the skin.

    Attributes:
        face: which face, -1 where a path does not touch [ray].
        point: [ray, 3] [m].
        normal: unit normal on the side of `omega_o` [ray, 3].
        omega_o: unit vector back along the path [ray, 3].
        lit: whether the point sees each delta source [source, ray]; None without such sources.
        glows: whether its own emission still counts, and was not looked for from where the path came [ray]; None
            where it always counts.
    """

    face: Int[Array, "*vertex ray"]
    point: Float[Array, "*vertex ray 3"]
    normal: Float[Array, "*vertex ray 3"]
    omega_o: Float[Array, "*vertex ray 3"]
    lit: Bool[Array, "*vertex source ray"] | None
    glows: Bool[Array, "*vertex ray"] | None = None


class FacesSeen(eqx.Module):
    """Points of the skin looked for as lights from another point, first those drawn, then those met by the brdf.

    Attributes:
        face: which face [sample, ray]; -1 for none.
        omega: unit vectors towards them [sample, ray, 3].
        distance: [sample, ray] [m].
        factor: as in `Around`; 0 where the point is not seen.
    """

    face: Int[Array, "*vertex sample ray"]
    omega: Float[Array, "*vertex sample ray 3"]
    distance: Float[Array, "*vertex sample ray"]
    factor: Float[Array, "*vertex sample ray"]


class PlumeSeen(eqx.Module):
    """Directions in which the plume is looked for as a light, first those drawn, then those of the brdf.

    Attributes:
        omega: unit vectors [sample, ray, 3].
        length: up to where they meet the skin [sample, ray] [m]; inf where they do not.
        factor: as in `Around`.
    """

    omega: Float[Array, "*vertex sample ray 3"]
    length: Float[Array, "*vertex sample ray"]
    factor: Float[Array, "*vertex sample ray"]


class Around(eqx.Module):
    """Sampled directions in which a point of the skin looks for each light.

    Light found is sum over samples of brdf(omega, omega_o) cos(theta) factor * radiance.

    Attributes:
        omega: unit vectors, first those drawn from the light, then those drawn from the brdf [light, sample, ray, 3].
        distance: to the light [light, sample, ray] [m]; inf for the background.
        factor: weight (9) / (number of samples * density) [light, sample, ray] [sr]; 0 where the light is not seen.
        faces: the skin as a light; None where it is none.
        plume: the plume as a light; None where it is none.
    """

    omega: Float[Array, "*vertex light sample ray 3"]
    distance: Float[Array, "*vertex light sample ray"]
    factor: Float[Array, "*vertex light sample ray"]
    faces: FacesSeen | None
    plume: PlumeSeen | None


class Leg(eqx.Module):
    """How paths go on from one point of the skin to the next.

    Attributes:
        omega: unit vector [ray, 3].
        factor: 1 / density [ray] [sr]; 0 for a path that ends.
        length: to the next face [ray] [m]; inf where the leg leaves the scene, 0 for a path that ends.
        met: whether the leg ends on the skin [ray].
    """

    omega: Float[Array, "*vertex ray 3"]
    factor: Float[Array, "*vertex ray"]
    length: Float[Array, "*vertex ray"]
    met: Bool[Array, "*vertex ray"]


def look_around(
    scene: Scene,
    reflection: Reflection,
    vertex: Vertex,
    key: Key[Array, ""],
    go_on: Bool[Array, ""] | None,
) -> tuple[Around | None, Leg | None, Hit | None]:
    """Sample the lights from points of the skin, and the next leg of their paths.

    The first direction drawn from the brdf is also the leg on which a path goes on: one ray finds lights and skin.

    Args:
        scene: without derivatives.
        reflection: how.
        vertex: the points.
        key: random key.
        go_on: whether paths go on; None where no path ever does.

    Returns:
        Lights, None where the scene has none to sample; the leg and where it ends, None where no path goes on.
    """
    assert scene.skin is not None
    mesh, lights = scene.skin.mesh, reflection.lights(scene)
    count, own = reflection.direct.counts() if reflection.looks(scene) else (0, 0)
    legs = max(own, 0 if go_on is None else 1)
    if reflection.skin is not None:
        key, at_faces = jax.random.split(key)
    if reflection.looks_for_plume(scene):
        key, at_plume = jax.random.split(key)
    keys = jax.random.split(key, vertex.face.shape[0])
    brdf = scene.skin.brdf.at(jnp.maximum(vertex.face, 0))

    draw = partial(_draw, lights, reflection, (count, own, legs))
    omega, distance, factor, leg_omega, leg_factor = jax.vmap(draw, out_axes=(2, 2, 2, 1, 1))(
        keys, brdf, vertex.point, vertex.normal, vertex.omega_o, vertex.face >= 0
    )

    def rays(towards: Array) -> tuple[Rays, Array]:
        """Rays [sample * ray] from every point."""
        samples = towards.shape[0]
        origin = jnp.broadcast_to(vertex.point[None], towards.shape)
        face = jnp.broadcast_to(vertex.face[None], towards.shape[:-1])
        return Rays(origin.reshape(-1, 3), towards.reshape(-1, 3)), face.reshape(samples * face.shape[1])

    hollow = _hollow(mesh, vertex)
    reach = jnp.where(factor > 0, distance, 0)
    seen = [jnp.zeros((len(lights), 0) + vertex.face.shape, bool)]
    if count and lights:
        flat, face = rays(omega[:, :count].reshape((-1,) + omega.shape[2:]))
        end = reach[:, :count].reshape(-1)
        hidden = lax.cond(
            hollow, lambda: any_hit(mesh, flat, t_max=end, leaving=face), lambda: jnp.zeros(end.shape, bool)
        )
        seen = [~hidden.reshape(reach[:, :count].shape)]
    leg = hit = met = None
    if legs:
        limit = jnp.max(reach[:, count:], axis=0, initial=0) if own and lights else jnp.zeros_like(leg_factor)
        if own and (reflection.skin is not None or reflection.looks_for_plume(scene)):
            limit = jnp.where(leg_factor > 0, jnp.inf, 0)
        if go_on is not None:
            limit = limit.at[0].set(jnp.where(go_on & (leg_factor[0] > 0), jnp.inf, limit[0]))
        flat, face = rays(leg_omega)
        search = partial(closest_hit, mesh, flat, t_max=limit.reshape(-1), leaving=face)
        met = lax.cond(hollow, search, lambda: no_hit(flat.origin))
        free = met.t.reshape(limit.shape)
        if own and lights:
            seen.append(free[None] >= distance[:, count:])
        if go_on is not None:
            hit = jax.tree.map(lambda leaf: leaf[: vertex.face.shape[0]], met)
            on = go_on & (leg_factor[0] > 0)
            hit = eqx.tree_at(lambda h: h.face, hit, jnp.where(on, hit.face, -1))
            leg = Leg(leg_omega[0], jnp.where(on, leg_factor[0], 0), jnp.where(on, free[0], 0), hit.face >= 0)
    if not reflection.looks(scene):
        return None, leg, hit
    faces = plume = own_legs = None
    if met is not None and own:
        met_at = (leaf.reshape(leg_factor.shape)[:own] for leaf in (met.face, met.t))
        own_legs = _Legs(leg_omega[:own], leg_factor[:own], *met_at)
    if reflection.skin is not None:
        faces = _look_for_faces(scene, reflection, vertex, at_faces, own_legs, hollow)
    if reflection.looks_for_plume(scene):
        plume = _look_for_plume(scene, reflection, vertex, at_plume, own_legs, hollow)
    factor = jnp.where(jnp.concatenate(seen, axis=1), factor, 0) if lights else factor
    return Around(omega, distance, factor, faces, plume), leg, hit


class _Legs(NamedTuple):
    """Directions drawn from the brdf, 1 / density, and the face they meet at which distance, [sample, ray]."""

    omega: Array
    inverse: Array
    face: Array
    distance: Array


def _drawn_share(scene: Scene, reflection: Reflection, vertex: Vertex, omega: Array, pdf: Array) -> tuple[Array, Array]:
    """Directions [sample, ray] drawn towards a light: whether they can bring light, weight (9) / (count * pdf)."""
    assert scene.skin is not None
    count, own = reflection.direct.counts()
    weight = jnp.ones_like(pdf)
    if own:
        brdf = scene.skin.brdf.at(jnp.maximum(vertex.face, 0))
        rival = jax.vmap(lambda b, w, o, n: jax.vmap(lambda w: b.pdf(w, o, n))(w), in_axes=(0, 1, 0, 0), out_axes=1)
        weight = mis_weight(count, pdf, own, rival(brdf, omega, vertex.omega_o, vertex.normal))
    good = (vertex.face >= 0)[None] & (pdf > 0) & (dot(omega, vertex.normal[None]) > 0)
    return good, _share(good, weight, count, pdf)


def _first_met(scene: Scene, vertex: Vertex, omega: Array, good: Array, hollow: Array) -> tuple[Array, Array]:
    """The face that each good direction [sample, ray] meets first, and where; -1 and inf for none."""
    assert scene.skin is not None
    flat = Rays(jnp.broadcast_to(vertex.point[None], omega.shape).reshape(-1, 3), omega.reshape(-1, 3))
    leaving = jnp.broadcast_to(vertex.face[None], good.shape).reshape(-1)
    end = jnp.where(good, jnp.inf, 0).astype(omega.dtype).reshape(-1)
    search = partial(closest_hit, scene.skin.mesh, flat, t_max=end, leaving=leaving)
    met = lax.cond(hollow, search, lambda: no_hit(flat.origin))
    return met.face.reshape(good.shape), met.t.reshape(good.shape)


def _look_for_plume(
    scene: Scene, reflection: Reflection, vertex: Vertex, key: Array, legs: _Legs | None, hollow: Array
) -> PlumeSeen:
    """The plume as a light: directions drawn towards it, and those of legs."""
    assert scene.plume is not None and reflection.plume is not None
    pieces = plume_pieces(scene.plume, reflection.plume)
    count, own = reflection.direct.counts()
    sight = jax.vmap(partial(sight_of, pieces))(vertex.point, vertex.normal)
    density = jax.vmap(jax.vmap(partial(pdf_towards, pieces)), in_axes=(None, 0))
    parts = []
    if count:
        keys = jax.random.split(key, vertex.face.shape[0])
        draw = partial(draw_towards, pieces, sampler=reflection.sampler, count=count)
        omega = jax.vmap(lambda s, k: draw(s, key=k), out_axes=1)(sight, keys)
        good, factor = _drawn_share(scene, reflection, vertex, omega, density(sight, omega))
        parts.append((omega, _first_met(scene, vertex, omega, good, hollow)[1], factor))
    if legs is not None:
        sent = legs.inverse > 0
        pdf = 1 / jnp.where(sent, legs.inverse, 1)
        rival = density(sight, legs.omega) if count else jnp.zeros_like(pdf)
        weight = mis_weight(own, pdf, count, rival)
        parts.append((legs.omega, legs.distance, _share(sent, weight, own, pdf)))
    return PlumeSeen(*(jnp.concatenate(part) for part in zip(*parts, strict=True)))


def _look_for_faces(
    scene: Scene, reflection: Reflection, vertex: Vertex, key: Array, legs: _Legs | None, hollow: Array
) -> FacesSeen:
    """The skin as a light: points drawn on it, and those met by legs."""
    assert scene.skin is not None and reflection.skin is not None
    mesh, odds = scene.skin.mesh, face_odds(scene.skin, reflection.skin)
    count, own = reflection.direct.counts()
    density = jax.vmap(partial(pdf_points, mesh, odds))
    parts = []
    if count:
        keys = jax.random.split(key, vertex.face.shape[0])
        draw = partial(draw_points, mesh, odds, reflection.sampler, count=count)
        face, target = jax.vmap(draw, out_axes=1)(keys)
        offset = target - vertex.point[None]
        distance = jnp.sqrt(dot(offset, offset))
        omega = offset / jnp.where(distance > 0, distance, 1)[..., None]
        good, factor = _drawn_share(scene, reflection, vertex, omega, density(face, omega, distance))
        first, _ = _first_met(scene, vertex, omega, good, hollow)
        parts.append((face, omega, distance, jnp.where(first == face, factor, 0)))
    if legs is not None:
        met = (legs.inverse > 0) & (legs.face >= 0)
        reach = jnp.where(met, legs.distance, 0)
        pdf = 1 / jnp.where(met, legs.inverse, 1)
        weight = mis_weight(own, pdf, count, density(legs.face, legs.omega, reach))
        parts.append((jnp.where(met, legs.face, -1), legs.omega, reach, _share(met, weight, own, pdf)))
    return FacesSeen(*(jnp.concatenate(part) for part in zip(*parts, strict=True)))


def _hollow(mesh: Mesh, vertex: Vertex) -> Bool[Array, ""]:
    """False where nothing can hide anything: skin of a handful of faces, flat, or closed, convex, seen from outside."""
    if mesh.tree is not None:
        return jnp.asarray(True)
    outward = face_normal(mesh, jnp.maximum(vertex.face, 0))
    inside = (vertex.face >= 0) & (dot(vertex.normal, outward) < 0) & mesh.closed
    return jnp.any(jnp.greater(*concavity(mesh))) | jnp.any(inside)


def _draw(
    lights: tuple[Light, ...],
    reflection: Reflection,
    counts: tuple[int, int, int],
    key: Array,
    brdf: AbstractBrdf,
    point: Array,
    normal: Array,
    omega_o: Array,
    active: Array,
) -> tuple[Array, Array, Array, Array, Array]:
    """One point: directions to lights [light, sample, ...], and those of legs [leg, ...] with 1 / density."""
    count, own, legs = counts
    from_brdf, from_light = jax.random.split(key)
    dtype = point.dtype

    def upward(omega: Array, pdf: Array) -> Array:
        return active & (pdf > 0) & (dot(omega, normal) > 0)

    leg_omega, density, sent = jnp.zeros((0, 3), dtype), jnp.zeros(0, dtype), jnp.zeros(0, bool)
    if legs:
        u = reflection.sampler.draw(from_brdf, legs)
        leg_omega = jax.vmap(lambda u: brdf.sample(u, omega_o, normal))(u)
        density = jax.vmap(lambda w: brdf.pdf(w, omega_o, normal))(leg_omega)
        sent = jax.vmap(upward)(leg_omega, density)
    omega: list[Array] = []
    distance: list[Array] = []
    factor: list[Array] = []
    for place, light in enumerate(lights):
        parts = []
        if count:
            u = reflection.sampler.draw(jax.random.fold_in(from_light, place), count)
            drawn = jax.vmap(lambda u, light=light: sample_light(light, u, point, normal))(u)
            weight = jnp.ones_like(drawn.pdf)
            if own:
                rival = jax.vmap(lambda w: brdf.pdf(w, omega_o, normal))(drawn.omega_i)
                weight = mis_weight(count, drawn.pdf, own, rival)
            good = jax.vmap(upward)(drawn.omega_i, drawn.pdf)
            parts.append((drawn.omega_i, drawn.distance, _share(good, weight, count, drawn.pdf)))
        if own:
            met = jax.vmap(lambda w, light=light: meet_light(light, w, point, normal))(leg_omega[:own])
            weight = mis_weight(own, density[:own], count, met.pdf)
            parts.append(
                (leg_omega[:own], met.distance, _share(sent[:own] & (met.pdf > 0), weight, own, density[:own]))
            )
        for total, part in zip((omega, distance, factor), zip(*parts, strict=True), strict=True):
            total.append(jnp.concatenate(part))
    return (
        jnp.stack(omega) if lights else jnp.zeros((0, 0, 3), dtype),
        jnp.stack(distance) if lights else jnp.zeros((0, 0), dtype),
        jnp.stack(factor) if lights else jnp.zeros((0, 0), dtype),
        leg_omega,
        _share(sent, jnp.ones_like(density), 1, density),
    )


def _share(good: Array, weight: Array, count: int, pdf: Array) -> Array:
    """weight / (count * pdf) where good, else 0."""
    return jnp.where(good, weight / (count * jnp.where(good, pdf, 1)), 0)
