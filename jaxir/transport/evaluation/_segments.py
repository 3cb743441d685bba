"""What segments of paths bring for the present temperatures, emissivities and coefficients, and how they go on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._fields import by_band, over_nodes
from jaxir._math import dot
from jaxir.geometry.search import face_normal
from jaxir.scene import Lit
from jaxir.transport._lights import SampledLight, emitted, lights_at_particles, lights_at_skin
from jaxir.transport._method import ClosedForm, Method
from jaxir.transport._paths import LightSamples, Paths, Scattering, Segment, Vertex
from jaxir.transport.ordinates import Scattered

# What a segment brings ------------------------------------------------------------------------------------------------


def behind_plumes(lit: Lit, method: Method, segment: Segment, first: Array | bool, last: Array | bool) -> Array:
    """What enters segments at their far ends [ray, node]: what leaves the skin, or what surrounds the scene."""
    behind = _surroundings(lit, segment, first)
    if segment.vertex is not None:
        skin = outgoing_radiance(lit, method, segment.vertex)
        if method.ambient is not None:
            skin = skin + jnp.where(last, _of_ambient(lit, method, segment.vertex), 0)
        behind = jnp.where((segment.vertex.face >= 0)[:, None], skin, behind)
    return behind


def brings(lit: Lit, paths: Paths, segment: Segment, first: Array | bool, last: Array | bool) -> Array:
    """A_k: what comes along segments without going on [ray, node]; `first` are those of the eye."""
    behind = behind_plumes(lit, paths.method, segment, first, last)
    brought = _through_plumes(lit, segment, behind, paths.route)
    if paths.method.scattering is not None:
        return brought
    for source, irradiance in zip(lit.scene.summed_beams, lit.beams, strict=True):
        assert lit.medium is not None and source.travel is not None
        cosine = dot(segment.rays.direction, -source.travel[None])
        brought = brought + lit.medium.in_scattered(irradiance, cosine, segment.rays, segment.length)
    return brought


def _surroundings(lit: Lit, segment: Segment, first: Array | bool) -> Array:
    """What segments that leave the scene bring from around it [ray, node]; the eye does not see hidden lights."""
    direction = segment.rays.direction
    if segment.sees_surroundings is None:
        return lit.background(direction)
    around = lit.surroundings(direction)
    if lit.scene.hidden:
        around = jnp.where(first, lit.background(direction), around)
    leaves = segment.sees_surroundings & jnp.isinf(segment.length)
    return jnp.where(leaves[:, None], around, 0)


def _through_plumes(lit: Lit, segment: Segment, behind: Array, route: Any) -> Array:
    """`behind` through the plumes, with their emission unless it was found as that of a light."""
    if lit.medium is None:
        return behind
    if segment.sees_plume is None:
        return lit.medium.radiance(segment.rays, segment.length, behind, route)
    reach = jnp.where(segment.sees_plume, segment.length, 0)
    own = lit.emission(segment.rays.origin, segment.rays.direction, reach)
    return own + lit.medium.transmittance(segment.rays, segment.length) * behind


# How paths go on ------------------------------------------------------------------------------------------------------


def event(lit: Lit, segment: Segment) -> tuple[Array | float, Array | float]:
    """Transmittance to where paths go on, and that over the density of the distance where particles scatter them."""
    assert segment.inverse_pdf is not None
    reach = jnp.where(segment.inverse_pdf > 0, segment.length, 0)
    if segment.scattering is None:
        return lit.transmittance(segment.rays.origin, segment.rays.direction, reach), 0.0
    scattered = segment.scattering.inverse_pdf > 0
    reach = jnp.where(scattered, segment.scattering.t, reach)
    passed = lit.transmittance(segment.rays.origin, segment.rays.direction, reach)
    return passed, jnp.where(scattered[:, None], passed * segment.scattering.inverse_pdf[:, None], 0)


def onward(lit: Lit, segment: Segment, passed: Array | float, event: Array | float) -> Array:
    """Throughput of the next segment over that of this one [ray, node]."""
    assert segment.omega is not None and segment.inverse_pdf is not None
    inverse = segment.inverse_pdf
    onward = jnp.zeros((inverse.shape[0], lit.nodes.count), inverse.dtype)
    if segment.scattering is not None:
        assert lit.medium is not None
        scattered = segment.scattering.inverse_pdf > 0
        spread = lit.medium.scattering(
            segment.rays.at(segment.scattering.t), dot(segment.rays.direction, segment.omega)
        )
        onward = event * spread * inverse[:, None]
        inverse = jnp.where(scattered, 0, inverse)
    if segment.vertex is not None:
        onward = onward + passed * reflected(lit, segment.vertex, segment.omega, inverse)
    return onward


def direct_at_particles(lit: Lit, method: Method, segment: Segment, at: Scattering) -> Array:
    """Light straight from the lights, scattered towards the segment's begin [ray, node] [W m-3 sr-1]."""
    assert lit.medium is not None
    medium, point, along = lit.medium, segment.rays.at(at.t), segment.rays.direction
    total = jnp.zeros((point.shape[0], lit.nodes.count), point.dtype)
    for place, source in enumerate(method.sampled_beams(lit.scene)):
        beam = jnp.where(at.visible[place][:, None], jax.vmap(source.beam)(point), 0)
        passed = lit.transmittance(point, at.omega[place], jnp.where(at.visible[place], at.distance[place], 0))
        total = total + medium.scattering(point, dot(at.omega[place], along)) * beam * passed

    def spread(omega: Array, weight: Array) -> Array:
        return medium.scattering(point, dot(omega, along)) * weight[:, None]

    for light, samples in zip(lights_at_particles(lit.scene, method), at.lights, strict=True):
        total = total + _found(lit, light, samples, point, spread)
    return total


def expected_at_particles(lit: Lit, segment: Segment, at: Scattering) -> Array:
    """What the lattice says of the light that `direct_at_particles` and the next segment find [ray, node]."""
    assert isinstance(lit.medium, Scattered) and segment.omega is not None and segment.inverse_pdf is not None
    point, along = segment.rays.at(at.t), segment.rays.direction
    found = lit.medium.expected(point, along, segment.omega)
    return found * segment.inverse_pdf[:, None] + lit.medium.expected_beams(point, along)


# What leaves the skin -------------------------------------------------------------------------------------------------


def outgoing_radiance(lit: Lit, method: Method, vertex: Vertex) -> Float[Array, "ray node"]:
    """Own emission plus reflected light that comes straight from lights, equation (3) [ray, node].

        L = emissivity(theta_o) B(T) + sum_s brdf(omega_s, omega_o) cos(theta_s) E_s + sampled lights

    The first term is left out where it was found as a light already.
    """
    radiance = emitted(lit, vertex.face, dot(vertex.normal, vertex.omega_o))
    if vertex.counts_emission is not None:
        radiance = jnp.where(vertex.counts_emission[:, None], radiance, 0)
    for source, sees in zip(lit.scene.delta_sources, vertex.visible, strict=True):
        omega_i, distance = jax.vmap(source.toward)(vertex.point)
        beam = jnp.where(sees[:, None], jax.vmap(source.beam)(vertex.point), 0)
        passed = lit.transmittance(vertex.point, omega_i, jnp.where(sees, distance, 0))
        radiance = radiance + reflected(lit, vertex, omega_i, jnp.ones_like(distance)) * beam * passed
    if isinstance(method.direct, ClosedForm):
        return radiance + _closed_form(lit, vertex)

    def spread(omega: Array, weight: Array) -> Array:
        return reflected(lit, vertex, omega, weight)

    for light, samples in zip(lights_at_skin(lit.scene, method), vertex.lights, strict=True):
        radiance = radiance + _found(lit, light, samples, vertex.point, spread)
    return radiance


def _found(
    lit: Lit,
    light: SampledLight,
    samples: LightSamples,
    point: Array,
    spread: Callable[[Array, Array], Array],
) -> Array:
    """Light of one source sent on from points [ray, node]; `spread` of directions and weights is how they send it."""
    everywhere = jnp.broadcast_to(point[None], samples.omega.shape)
    incident = light.incident(lit, samples, everywhere)
    return jnp.sum(jax.vmap(spread)(samples.omega, samples.weight) * incident, axis=0)


def reflected(lit: Lit, vertex: Vertex, omega_i: Float[Array, "ray 3"], weight: Float[Array, " ray"]) -> Array:
    """brdf * cos * weight of one direction at each point [ray, node]."""
    assert lit.scene.skin is not None
    brdf = lit.scene.skin.brdf.at(jnp.maximum(vertex.face, 0))
    value = jax.vmap(lambda b, i, o, n: b.eval(i, o, n) * jnp.maximum(dot(i, n), 0))(
        brdf, omega_i, vertex.omega_o, vertex.normal
    )
    return jnp.where((weight > 0)[:, None], value * weight[:, None], 0)


def _closed_form(lit: Lit, vertex: Vertex) -> Array:
    """reflectance * sum over lights of F L, F being the form factor of the light seen from the point [ray, node].

    Right where `Method.checks_for` holds. Differentiable in reflectance and radiances.
    """
    arriving = jnp.zeros((vertex.face.shape[0], lit.nodes.count), vertex.point.dtype)
    for light in lit.scene.extended_lights:
        factor = jax.vmap(light.form_factor)(vertex.point, vertex.normal)
        arriving = arriving + factor[:, None] * light.arriving(vertex.normal)
    return _reflectance(lit, vertex) * arriving


def _of_ambient(lit: Lit, method: Method, vertex: Vertex) -> Array:
    """Reflection of the same radiance from everywhere [ray, node]."""
    ambient = on_nodes(method, lit).ambient
    assert ambient is not None
    return _reflectance(lit, vertex) * ambient[None]


def on_nodes(method: Method, lit: Lit) -> Method:
    """The method with what it knows of light on the nodes."""
    return over_nodes(by_band(method, lit.nodes), lit.nodes)


def _reflectance(lit: Lit, vertex: Vertex) -> Array:
    """Directional-hemispherical reflectance towards `omega_o` [ray, node or 1]."""
    assert lit.scene.skin is not None
    brdf = lit.scene.skin.brdf.at(jnp.maximum(vertex.face, 0))
    return jax.vmap(lambda b, c: b.directional_reflectance(c))(brdf, dot(vertex.normal, vertex.omega_o))


def unoccluded_radiance(lit: Lit, toward: Float[Array, " 3"]) -> Float[Array, "face node"]:
    """Radiance leaving the front of every face in one direction if no face hides or shades another [face, node].

    With the light of parallel sources and of surroundings, which are uniform, and without that of others.
    """
    assert lit.scene.skin is not None
    mesh = lit.scene.skin.mesh
    face = jnp.arange(mesh.count, dtype=jnp.int32)
    normal = face_normal(mesh, face)
    visible = jnp.ones((len(lit.scene.delta_sources), mesh.count), bool)
    centre, back = jnp.mean(mesh.corners(), axis=1), jnp.broadcast_to(toward, normal.shape)
    return outgoing_radiance(lit, Method(direct=ClosedForm()), Vertex(face, centre, normal, back, visible, None))
