"""Evaluate: radiance of traced paths for the present temperatures, emissivities and coefficients. Smooth."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Key

from jaxir._vector import dot
from jaxir.geometry.mesh import face_normal
from jaxir.geometry.ray import Rays
from jaxir.optics.band import Nodes
from jaxir.optics.planck import band_radiance
from jaxir.scene.background import AbstractUniformBackground
from jaxir.scene.plume import GridPlume
from jaxir.scene.scene import Scene
from jaxir.scene.source import per_node
from jaxir.transport.around import Around, Vertex
from jaxir.transport.closed_form import closed_form
from jaxir.transport.jet import JetMedium, jet_medium
from jaxir.transport.lights import light_radiance
from jaxir.transport.medium import GridMedium, grid_medium
from jaxir.transport.path_estimator import AbstractPathEstimator, CellSum
from jaxir.transport.paths import Chain, Paths
from jaxir.transport.reflection import ClosedForm, Reflection, reflection_of


class Radiometry(eqx.Module):
    """A scene on the spectral nodes: what is computed once and then looked up by every ray.

    Attributes:
        scene: the scene.
        nodes: the spectral axis.
        skin_source: blackbody radiance of each face [face, node] [W m-2 sr-1].
        medium: the plume.
        background: where it is uniform [node] [W m-2 sr-1].
        transmittance: of the atmosphere [node].
        path_radiance: of the atmosphere [node] [W m-2 sr-1].

    A field is None where the scene lacks the part.
    """

    scene: Scene
    nodes: Nodes
    skin_source: Float[Array, "face node"] | None
    medium: GridMedium | JetMedium | None
    background: Float[Array, " node"] | None
    transmittance: Float[Array, " node"] | None
    path_radiance: Float[Array, " node"] | None


def radiometry(scene: Scene, nodes: Nodes) -> Radiometry:
    """Evaluate temperatures, gas and lights on the nodes. Differentiable in every radiometric leaf of the scene."""
    skin, plume, background, air = scene.skin, scene.plume, scene.background, scene.atmosphere
    medium: GridMedium | JetMedium | None = None
    if plume is not None:
        medium = grid_medium(plume, nodes) if isinstance(plume, GridPlume) else jet_medium(plume, nodes)
    return Radiometry(
        scene=scene,
        nodes=nodes,
        skin_source=None if skin is None else band_radiance(skin.temperature, nodes),
        medium=medium,
        background=background.level(nodes) if isinstance(background, AbstractUniformBackground) else None,
        transmittance=None if air is None else air.transmittance(nodes),
        path_radiance=None if air is None else air.path_radiance(nodes),
    )


def evaluate(
    optical: Radiometry,
    paths: Paths,
    reflection: Reflection | None = None,
    path: AbstractPathEstimator = CellSum(),  # noqa: B008
    key: Key[Array, ""] | None = None,
) -> Float[Array, "ray node"]:
    """Radiance at the entrance pupil along each path, equations (2) and (3) with (4) and (5) in front.

        L = atmosphere's transmittance * [plume in front of (skin, or background where no skin is met)] + path radiance

    Args:
        optical: the scene on the nodes, `radiometry(scene, nodes)`.
        paths: `trace(scene, rays, reflection, key)`.
        reflection: what the paths were traced with.
        path: how the radiance of a gridded plume in front of the eye is estimated; its type decides what is compiled.
        key: random key, which every estimator but `CellSum` needs.

    Returns:
        Radiance [ray, node] [W m-2 sr-1], integrated over each node's bin.

    Raises:
        ValueError: an estimator that samples, without a key or without a gridded plume.

    Differentiable, in both modes, in every radiometric leaf of the scene, without bias: directions keep the density
    with which they were drawn and the brdf in front of it carries the derivative. Not in the scene's geometry,
    but for the place and shape of a jet.
    """
    reflection = reflection_of(optical.scene, reflection)
    radiance = _background(optical, paths.rays.direction)
    if paths.hit is not None:
        skin = _chain(optical, paths.chain, reflection) if paths.chain is not None and reflection is not None else None
        if skin is None:
            skin = _leaving(optical, paths.vertex(), paths.around, reflection) + _beyond(
                optical, paths.vertex(), reflection
            )
        radiance = jnp.where((paths.hit.face >= 0)[:, None], skin, radiance)
    if not isinstance(path, CellSum):
        if key is None or not isinstance(optical.medium, GridMedium):
            raise ValueError(f"path: got {type(path).__name__}, expected a random key and a gridded plume with it")
        return through_air(optical, optical.medium.sampled_leg(path, paths.rays, paths.length, radiance, key))
    if isinstance(optical.medium, GridMedium) and paths.crossings is not None:
        return through_air(optical, optical.medium.listed_leg(paths.crossings, radiance))
    return through_air(optical, _through_plume(optical, paths.rays, paths.length, radiance))


def through_air(optical: Radiometry, radiance: Float[Array, "*batch node"]) -> Float[Array, "*batch node"]:
    """Equation (2): transmittance * L + path radiance; both absent means vacuum."""
    lead = (None,) * (radiance.ndim - 1)
    if optical.transmittance is not None:
        radiance = radiance * optical.transmittance[lead]
    if optical.path_radiance is not None:
        radiance = radiance + optical.path_radiance[lead]
    return radiance


def empty_radiance(optical: Radiometry, direction: Float[Array, "*batch 3"]) -> Float[Array, "*batch node"]:
    """What the sensor sees where the scene is not: the background through the air [*batch, node] [W m-2 sr-1]."""
    return through_air(optical, _background(optical, direction))


def _background(optical: Radiometry, direction: Array) -> Array:
    """[*batch, node]."""
    shape = direction.shape[:-1] + (optical.nodes.count,)
    background = optical.scene.background
    if background is None:
        return jnp.zeros(shape, direction.dtype)
    if optical.background is not None:
        return jnp.broadcast_to(optical.background, shape)
    return background.radiance(optical.nodes, direction)


def _through_plume(optical: Radiometry, rays: Rays, length: Array, behind: Array) -> Array:
    """Radiance at the origins of rays that end after `length` [ray], where `behind` [ray, node] enters them."""
    return behind if optical.medium is None else optical.medium.leg(rays, length, behind)


def _plume_transmittance(optical: Radiometry, point: Array, omega: Array, length: Array) -> Array | float:
    """Transmittance [*batch, node] from points along unit vectors [*batch, 3] for `length` [*batch]."""
    if optical.medium is None:
        return 1.0
    rays = Rays(point.reshape(-1, 3), omega.reshape(-1, 3))
    passed = optical.medium.transmittance(rays, length.reshape(-1))
    return passed.reshape(length.shape + (optical.nodes.count,))


def _chain(optical: Radiometry, chain: Chain, reflection: Reflection) -> Array:
    """Radiance that leaves the first vertices of paths, from the last bounce back [ray, node]."""

    def step(radiance: Array, link: tuple[Chain, Array]) -> tuple[Array, None]:
        (vertex, leg), last = (link[0].vertex, link[0].leg), link[1]
        behind = jnp.where(leg.met[:, None], radiance, 0)
        arriving = _through_plume(optical, Rays(vertex.point, leg.omega), leg.length, behind)
        left = _leaving(optical, vertex, link[0].around, reflection)
        left = left + _reflected(optical, vertex, leg.omega, leg.factor) * arriving
        if reflection.beyond is not None:
            left = left + jnp.where(last, _beyond(optical, vertex, reflection), 0)
        return left, None

    count = reflection.bounces + 1
    last = jnp.arange(count, dtype=jnp.int32) == reflection.bounces
    assert optical.skin_source is not None
    nothing = jnp.zeros((chain.leg.factor.shape[1], optical.nodes.count), optical.skin_source.dtype)
    return lax.scan(step, nothing, (chain, last), reverse=True)[0]


def _reflected(optical: Radiometry, vertex: Vertex, omega_i: Array, factor: Array) -> Array:
    """brdf * cos * factor of one direction at each point [ray, node]."""
    assert optical.scene.skin is not None
    brdf = optical.scene.skin.brdf.at(jnp.maximum(vertex.face, 0))
    value = jax.vmap(lambda b, i, o, n: b.eval(i, o, n) * jnp.maximum(dot(i, n), 0))(
        brdf, omega_i, vertex.omega_o, vertex.normal
    )
    return jnp.where((factor > 0)[:, None], value * factor[:, None], 0)


def _leaving(
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
            passed = _plume_transmittance(optical, vertex.point, omega_i, jnp.where(sees, distance, 0))
            radiance = radiance + _reflected(optical, vertex, omega_i, jnp.ones_like(distance)) * beam * passed
    if reflection is not None and isinstance(reflection.direct, ClosedForm):
        return radiance + closed_form(optical.scene, optical.nodes, vertex)
    if around is None or reflection is None:
        return radiance
    for place, light in enumerate(reflection.lights(optical.scene)):
        omega, factor = around.omega[place], around.factor[place]
        value = jax.vmap(lambda w, f: _reflected(optical, vertex, w, f))(omega, factor)
        point = jnp.broadcast_to(vertex.point[None], omega.shape)
        reach = jnp.where(factor > 0, around.distance[place], 0)
        passed = _plume_transmittance(optical, point, omega, reach)
        radiance = radiance + jnp.sum(value * light_radiance(light, optical.nodes, omega) * passed, axis=0)
    return radiance


def _beyond(optical: Radiometry, vertex: Vertex, reflection: Reflection | None) -> Array | float:
    """Reflection of the ambient term [ray, node]."""
    if reflection is None or reflection.beyond is None:
        return 0.0
    assert optical.scene.skin is not None
    brdf = optical.scene.skin.brdf.at(jnp.maximum(vertex.face, 0))
    cos_o = jnp.sum(vertex.normal * vertex.omega_o, axis=-1)
    ambient = per_node("AmbientTerm.radiance", reflection.beyond.radiance, optical.nodes)
    return jax.vmap(lambda b, c: b.reflectance(c))(brdf, cos_o) * ambient[None, :]


def emitted_radiance(optical: Radiometry, vertex: Vertex) -> Float[Array, "ray node"]:
    """emissivity(theta_o) B(T) [ray, node]."""
    assert optical.scene.skin is not None and optical.skin_source is not None
    face = jnp.maximum(vertex.face, 0)
    cos_o = jnp.sum(vertex.normal * vertex.omega_o, axis=-1)
    return jax.vmap(lambda b, c: b.emissivity(c))(optical.scene.skin.brdf.at(face), cos_o) * optical.skin_source[face]


def unoccluded_radiance(optical: Radiometry, toward: Float[Array, " 3"]) -> Float[Array, "face node"]:
    """Radiance leaving the front of every face in one direction if no face hides or shades another [face, node]."""
    assert optical.scene.skin is not None
    mesh = optical.scene.skin.mesh
    face = jnp.arange(mesh.count, dtype=jnp.int32)
    normal = face_normal(mesh, face)
    sources = optical.scene.sources
    lit = jnp.ones((len(sources), mesh.count), bool) if sources else None
    centre = jnp.mean(mesh.corners(), axis=1)
    return _leaving(optical, Vertex(face, centre, normal, jnp.broadcast_to(toward, normal.shape), lit), None, None)
