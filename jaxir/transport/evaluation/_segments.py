"""What segments of paths bring for the present temperatures, emissivities and coefficients, and how they go on."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._fields import by_band, over_nodes
from jaxir._math import dot
from jaxir.geometry.search import face_normal
from jaxir.scene import Lit
from jaxir.scene.light import AbstractDeltaSource
from jaxir.transport._lights import SampledLight, emitted, lights_at_particles, lights_at_skin
from jaxir.transport._method import ClosedForm, Method
from jaxir.transport._paths import LightSamples, Paths, Scattering, Segment, Vertex
from jaxir.transport._through import Answer, Through
from jaxir.transport.ordinates import Scattered

# What a segment brings ------------------------------------------------------------------------------------------------


def behind_plumes(
    lit: Lit, method: Method, segment: Segment, first: Array | bool, last: Array | bool, through: Through
) -> Answer:
    """What enters segments at their far ends [ray, node]: what leaves the skin, or what surrounds the scene."""
    around = _surroundings(lit, segment, first)
    vertex = segment.vertex
    if vertex is None:
        return lambda: around
    leaving = _outgoing(lit, method, vertex, through)

    def found() -> Array:
        skin = leaving()
        if method.ambient is not None:
            skin = skin + jnp.where(last, _of_ambient(lit, method, vertex), 0)
        return jnp.where((vertex.face >= 0)[:, None], skin, around)

    return found


def brings(
    lit: Lit,
    paths: Paths,
    segment: Segment,
    first: Array | bool,
    last: Array | bool,
    passed: Answer | None,
    through: Through,
) -> Answer:
    """A_k: what comes along segments without going on [ray, node]; `first` are those of the eye.

    `passed` is their `transmittance`.
    """
    behind = behind_plumes(lit, paths.method, segment, first, last, through)
    rays, medium = segment.rays, lit.medium
    if medium is None:
        return behind
    own = None
    if _apart(paths):
        seen = segment.length if segment.sees_plume is None else jnp.where(segment.sees_plume, segment.length, 0)
        own = through.emitted(rays.origin, rays.direction, seen)

    def found() -> Array:
        if own is None:
            brought = medium.radiance(rays, segment.length, behind(), paths.route)
        else:
            assert passed is not None
            brought = own() + passed() * behind()
        if paths.method.scattering is not None:
            return brought
        for source, irradiance in zip(lit.scene.summed_beams, lit.beams, strict=True):
            assert source.travel is not None
            cosine = dot(rays.direction, -source.travel[None])
            brought = brought + medium.in_scattered(irradiance, cosine, rays, segment.length)
        return brought

    return found


def _surroundings(lit: Lit, segment: Segment, first: Array | bool) -> Array:
    """What segments that leave the scene bring from around it [ray, node].

    The eye does not see hidden lights, but for what of their light was scattered forward in passing.
    """
    direction = segment.rays.direction
    around = lit.background(direction)
    if lit.scene.hidden:
        every = lit.surroundings(direction)
        around = jnp.where(first, around, every)
        if isinstance(lit.medium, Scattered):
            around = every - lit.medium.unscattered(segment.rays, segment.length) * (every - around)
    if segment.sees_surroundings is None:
        return around
    leaves = segment.sees_surroundings & jnp.isinf(segment.length)
    return jnp.where(leaves[:, None], around, 0)


def _apart(paths: Paths) -> bool:
    """Whether the emission of plumes is found apart from what passes through them: where it is that of a light, too."""
    return paths.method.plume_light is not None and paths.route is None


# How paths go on ------------------------------------------------------------------------------------------------------


def transmittance(paths: Paths, segment: Segment, through: Through) -> Answer | None:
    """Transmittance of segments [ray, node]: where paths go on from their ends or, if `brings` needs it, of all."""
    reach = segment.length
    if not _apart(paths):
        if segment.scattering is not None or segment.inverse_pdf is None:
            return None
        reach = jnp.where(segment.inverse_pdf > 0, reach, 0)
    return through.passed(segment.rays.origin, segment.rays.direction, reach)


def event(
    segment: Segment, passed: Answer | None, through: Through
) -> Callable[[], tuple[Array | float, Array | float]]:
    """Transmittance to where paths go on, and that over the density of the distance where particles scatter them."""
    assert segment.inverse_pdf is not None
    scattering = segment.scattering
    if scattering is None:
        assert passed is not None
        return lambda: (passed(), 0.0)
    scattered = scattering.inverse_pdf > 0
    reach = jnp.where(scattered, scattering.t, jnp.where(segment.inverse_pdf > 0, segment.length, 0))
    there = through.passed(segment.rays.origin, segment.rays.direction, reach)
    return lambda: (there(), jnp.where(scattered[:, None], there() * scattering.inverse_pdf[:, None], 0))


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


def direct_at_particles(lit: Lit, method: Method, segment: Segment, at: Scattering, through: Through) -> Answer:
    """Light straight from the lights, scattered towards the segment's begin [ray, node] [W m-3 sr-1]."""
    assert lit.medium is not None
    medium, point, along = lit.medium, segment.rays.at(at.t), segment.rays.direction

    def spread(omega: Array, weight: Array) -> Array:
        return medium.scattering(point, dot(omega, along)) * weight[:, None]

    beams = method.sampled_beams(lit.scene)
    straight = [_straight(*each, point, through) for each in zip(beams, at.omega, at.distance, at.visible, strict=True)]
    lights = zip(lights_at_particles(lit.scene, method), at.lights, strict=True)
    sampled = [_found(lit, light, samples, point, spread, through) for light, samples in lights]

    def found() -> Array:
        total = jnp.zeros((point.shape[0], lit.nodes.count), point.dtype)
        for omega, arriving in zip(at.omega, straight, strict=True):
            total = total + medium.scattering(point, dot(omega, along)) * arriving()
        for light in sampled:
            total = total + light()
        return total

    return found


def expected_at_particles(lit: Lit, segment: Segment, at: Scattering) -> Array:
    """What the lattice says of the light that `direct_at_particles` and the next segment find [ray, node]."""
    assert isinstance(lit.medium, Scattered) and segment.omega is not None and segment.inverse_pdf is not None
    point, along = segment.rays.at(at.t), segment.rays.direction
    found = lit.medium.expected(point, along, segment.omega)
    return found * segment.inverse_pdf[:, None] + lit.medium.expected_beams(point, along)


# What leaves the skin -------------------------------------------------------------------------------------------------


def _outgoing(lit: Lit, method: Method, vertex: Vertex, through: Through) -> Answer:
    """Own emission plus reflected light that comes straight from lights, equation (3) [ray, node].

        L = emissivity(theta_o) B(T) + sum_s brdf(omega_s, omega_o) cos(theta_s) E_s + sampled lights

    The first term is left out where it was found as a light already.
    """

    def spread(omega: Array, weight: Array) -> Array:
        return reflected(lit, vertex, omega, weight)

    toward = [jax.vmap(source.toward)(vertex.point) for source in lit.scene.delta_sources]
    each = zip(lit.scene.delta_sources, toward, vertex.visible, strict=True)
    straight = [_straight(source, *where, sees, vertex.point, through) for source, where, sees in each]
    sampled = []
    if not isinstance(method.direct, ClosedForm):
        lights = zip(lights_at_skin(lit.scene, method), vertex.lights, strict=True)
        sampled = [_found(lit, light, samples, vertex.point, spread, through) for light, samples in lights]

    def found() -> Array:
        radiance = emitted(lit, vertex.face, dot(vertex.normal, vertex.omega_o))
        if vertex.counts_emission is not None:
            radiance = jnp.where(vertex.counts_emission[:, None], radiance, 0)
        for (omega, distance), arriving in zip(toward, straight, strict=True):
            radiance = radiance + spread(omega, jnp.ones_like(distance)) * arriving()
        if isinstance(method.direct, ClosedForm):
            return radiance + _closed_form(lit, vertex)
        for light in sampled:
            radiance = radiance + light()
        return radiance

    return found


def _straight(
    source: AbstractDeltaSource, omega: Array, distance: Array, visible: Array, point: Array, through: Through
) -> Answer:
    """Irradiance across the light of a source without extent at points [ray, node] [W m-2]."""
    passed = through.passed(point, omega, jnp.where(visible, distance, 0))
    return lambda: jnp.where(visible[:, None], jax.vmap(source.beam)(point), 0) * passed()


def _found(
    lit: Lit,
    light: SampledLight,
    samples: LightSamples,
    point: Array,
    spread: Callable[[Array, Array], Array],
    through: Through,
) -> Answer:
    """Light of one source sent on from points [ray, node]; `spread` of directions and weights is how they send it."""
    everywhere = jnp.broadcast_to(point[None], samples.omega.shape)
    incident = light.incident(lit, samples, everywhere, through)
    return lambda: jnp.sum(jax.vmap(spread)(samples.omega, samples.weight) * incident(), axis=0)


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

    With the light of parallel sources and of surroundings, which are uniform, and without that of others. Of faces that
    look away it is what leaves along their normals: models of surfaces hold for directions above them.
    """
    assert lit.scene.skin is not None
    mesh = lit.scene.skin.mesh
    face = jnp.arange(mesh.count, dtype=jnp.int32)
    normal = face_normal(mesh, face)
    visible = jnp.ones((len(lit.scene.delta_sources), mesh.count), bool)
    centre, seen = jnp.mean(mesh.corners(), axis=1), dot(normal, toward[None]) > 0
    vertex = Vertex(face, centre, normal, jnp.where(seen[:, None], toward[None], normal), visible, None)
    return _outgoing(lit, Method(direct=ClosedForm()), vertex, Through(lit))()
