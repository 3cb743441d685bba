"""Radiance that leaves the skin: its own emission, and what it reflects of lights whose directions are known."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxir._math import dot
from jaxir.geometry.search import face_normal
from jaxir.scene.source import per_node
from jaxir.transport.around import Around, Vertex
from jaxir.transport.closed_form import closed_form
from jaxir.transport.lights import light_radiance
from jaxir.transport.radiometry import Radiometry, plume_emission, plume_transmittance
from jaxir.transport.reflection import ClosedForm, Reflection


def leaving(
    optical: Radiometry, vertex: Vertex, around: Around | None, reflection: Reflection | None
) -> Float[Array, "ray node"]:
    """Own emission plus reflected light that comes straight from lights, equation (3) [ray, node].

    L = emissivity(theta_o) B(T) + sum_s brdf(omega_s, omega_o) cos(theta_s) E_s + sampled lights

    The first term is left out where it was found as a light already.
    """
    radiance = _emitted(optical, vertex.face, dot(vertex.normal, vertex.omega_o))
    if vertex.glows is not None:
        radiance = jnp.where(vertex.glows[:, None], radiance, 0)
    if vertex.lit is not None:
        for source, sees in zip(optical.scene.delta_sources, vertex.lit, strict=True):
            omega_i, distance = jax.vmap(source.toward)(vertex.point)
            beam = jax.vmap(lambda p, source=source: source.beam(optical.nodes, p))(vertex.point)
            beam = jnp.where(sees[:, None], beam, 0)
            passed = plume_transmittance(optical, vertex.point, omega_i, jnp.where(sees, distance, 0))
            radiance = radiance + reflected(optical, vertex, omega_i, jnp.ones_like(distance)) * beam * passed
    if reflection is not None and isinstance(reflection.direct, ClosedForm):
        return radiance + closed_form(optical.scene, optical.nodes, vertex)
    if around is None or reflection is None:
        return radiance
    for place, light in enumerate(reflection.lights(optical.scene)):
        omega, factor = around.omega[place], around.factor[place]
        arriving = light_radiance(light, optical.nodes, omega)
        radiance = radiance + _found(optical, vertex, omega, around.distance[place], factor, arriving)
    if around.faces is not None:
        assert optical.scene.skin is not None
        seen = around.faces
        normal = face_normal(optical.scene.skin.mesh, jnp.maximum(seen.face, 0).reshape(-1)).reshape(seen.omega.shape)
        arriving = jax.vmap(partial(_emitted, optical))(seen.face, jnp.abs(dot(normal, seen.omega)))
        radiance = radiance + _found(optical, vertex, seen.omega, seen.distance, seen.factor, arriving)
    if around.plume is not None:
        drawn = around.plume
        point = jnp.broadcast_to(vertex.point[None], drawn.omega.shape)
        arriving = plume_emission(optical, point, drawn.omega, jnp.where(drawn.factor > 0, drawn.length, 0))
        radiance = radiance + jnp.sum(_reflected_each(optical, vertex, drawn.omega, drawn.factor) * arriving, axis=0)
    return radiance


def _reflected_each(optical: Radiometry, vertex: Vertex, omega: Array, factor: Array) -> Array:
    """`reflected` for several directions [sample, ray, node]."""
    return jax.vmap(lambda w, f: reflected(optical, vertex, w, f))(omega, factor)


def _found(optical: Radiometry, vertex: Vertex, omega: Array, distance: Array, factor: Array, arriving: Array) -> Array:
    """Sum over samples of reflected light that starts as `arriving` [sample, ray, node], behind the plume."""
    value = _reflected_each(optical, vertex, omega, factor)
    point = jnp.broadcast_to(vertex.point[None], omega.shape)
    passed = plume_transmittance(optical, point, omega, jnp.where(factor > 0, distance, 0))
    return jnp.sum(value * arriving * passed, axis=0)


def _emitted(optical: Radiometry, face: Int[Array, " ray"], cos_o: Float[Array, " ray"]) -> Float[Array, "ray node"]:
    """emissivity(theta_o) B(T) [ray, node]."""
    assert optical.scene.skin is not None and optical.skin_source is not None
    face = jnp.maximum(face, 0)
    return jax.vmap(lambda b, c: b.emissivity(c))(optical.scene.skin.brdf.at(face), cos_o) * optical.skin_source[face]


def reflected(optical: Radiometry, vertex: Vertex, omega_i: Array, factor: Array) -> Array:
    """brdf * cos * factor of one direction at each point [ray, node]."""
    assert optical.scene.skin is not None
    brdf = optical.scene.skin.brdf.at(jnp.maximum(vertex.face, 0))
    value = jax.vmap(lambda b, i, o, n: b.eval(i, o, n) * jnp.maximum(dot(i, n), 0))(
        brdf, omega_i, vertex.omega_o, vertex.normal
    )
    return jnp.where((factor > 0)[:, None], value * factor[:, None], 0)


def beyond(optical: Radiometry, vertex: Vertex, reflection: Reflection | None) -> Array | float:
    """Reflection of the ambient term [ray, node]."""
    if reflection is None or reflection.beyond is None:
        return 0.0
    assert optical.scene.skin is not None
    brdf = optical.scene.skin.brdf.at(jnp.maximum(vertex.face, 0))
    cos_o = dot(vertex.normal, vertex.omega_o)
    ambient = per_node("AmbientTerm.radiance", reflection.beyond.radiance, optical.nodes)
    return jax.vmap(lambda b, c: b.reflectance(c))(brdf, cos_o) * ambient[None, :]
