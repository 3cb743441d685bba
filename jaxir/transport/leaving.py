"""Radiance that leaves the skin: its own emission, and what it reflects of lights whose directions are known."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._vector import dot
from jaxir.scene.source import per_node
from jaxir.transport.around import Around, Vertex
from jaxir.transport.closed_form import closed_form
from jaxir.transport.lights import light_radiance
from jaxir.transport.radiometry import Radiometry, plume_transmittance
from jaxir.transport.reflection import ClosedForm, Reflection


def leaving(
    optical: Radiometry, vertex: Vertex, around: Around | None, reflection: Reflection | None
) -> Float[Array, "ray node"]:
    """Own emission plus reflected light that comes straight from lights, equation (3) [ray, node].

    L = emissivity(theta_o) B(T) + sum_s brdf(omega_s, omega_o) cos(theta_s) E_s + sampled lights
    """
    radiance = emitted_radiance(optical, vertex)
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
        value = jax.vmap(lambda w, f: reflected(optical, vertex, w, f))(omega, factor)
        point = jnp.broadcast_to(vertex.point[None], omega.shape)
        reach = jnp.where(factor > 0, around.distance[place], 0)
        passed = plume_transmittance(optical, point, omega, reach)
        radiance = radiance + jnp.sum(value * light_radiance(light, optical.nodes, omega) * passed, axis=0)
    return radiance


def emitted_radiance(optical: Radiometry, vertex: Vertex) -> Float[Array, "ray node"]:
    """emissivity(theta_o) B(T) [ray, node]."""
    assert optical.scene.skin is not None and optical.skin_source is not None
    face = jnp.maximum(vertex.face, 0)
    cos_o = jnp.sum(vertex.normal * vertex.omega_o, axis=-1)
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
    cos_o = jnp.sum(vertex.normal * vertex.omega_o, axis=-1)
    ambient = per_node("AmbientTerm.radiance", reflection.beyond.radiance, optical.nodes)
    return jax.vmap(lambda b, c: b.reflectance(c))(brdf, cos_o) * ambient[None, :]
