"""Evaluate: radiance of traced paths for the present temperatures, emissivities and coefficients. Smooth."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int, Key

from jaxir.geometry.ray import Rays
from jaxir.optics.band import Nodes
from jaxir.optics.planck import band_radiance
from jaxir.scene.scene import Scene
from jaxir.scene.source import per_node
from jaxir.transport.crossing_sum import crossing_sum
from jaxir.transport.march import march, transmittance
from jaxir.transport.path_estimator import AbstractPathEstimator, CellSum, sampled_march
from jaxir.transport.paths import Paths


class Radiometry(eqx.Module):
    """A scene on the spectral nodes: what is computed once and then looked up by every ray.

    Attributes:
        scene: the scene.
        nodes: the spectral axis.
        skin_source: blackbody radiance of each face [face, node] [W m-2 sr-1].
        extinction: of each cell [nx, ny, nz, node] [m-1].
        emission: absorption times blackbody radiance of each cell [nx, ny, nz, node] [W m-3 sr-1].
        irradiance: of each parallel source [source, node] [W m-2].
        background: [node] [W m-2 sr-1].
        transmittance: of the atmosphere [node].
        path_radiance: of the atmosphere [node] [W m-2 sr-1].

    A field is None where the scene lacks the part.
    """

    scene: Scene
    nodes: Nodes
    skin_source: Float[Array, "face node"] | None
    extinction: Float[Array, "nx ny nz node"] | None
    emission: Float[Array, "nx ny nz node"] | None
    irradiance: Float[Array, "source node"] | None
    background: Float[Array, " node"] | None
    transmittance: Float[Array, " node"] | None
    path_radiance: Float[Array, " node"] | None


def radiometry(scene: Scene, nodes: Nodes) -> Radiometry:
    """Evaluate temperatures, gas and lights on the nodes. Differentiable in every radiometric leaf of the scene."""
    skin, plume, background, air = scene.skin, scene.plume, scene.background, scene.atmosphere
    extinction = emission = None
    if plume is not None:
        extinction = plume.gas.absorption(nodes, plume.temperature)
        emission = extinction * band_radiance(plume.temperature, nodes)
    sources = [per_node("ParallelSource.irradiance", s.irradiance, nodes) for s in scene.sources]
    return Radiometry(
        scene=scene,
        nodes=nodes,
        skin_source=None if skin is None else band_radiance(skin.temperature, nodes),
        extinction=extinction,
        emission=emission,
        irradiance=jnp.stack(sources) if sources else None,
        background=None if background is None else background.radiance(nodes),
        transmittance=None if air is None else air.transmittance(nodes),
        path_radiance=None if air is None else air.path_radiance(nodes),
    )


def evaluate(
    optical: Radiometry,
    paths: Paths,
    path: AbstractPathEstimator = CellSum(),  # noqa: B008
    key: Key[Array, ""] | None = None,
) -> Float[Array, "ray node"]:
    """Radiance at the entrance pupil along each path, equations (2) and (3) with (4) and (5) in front.

        L = atmosphere's transmittance * [plume in front of (skin, or background where no skin is met)] + path radiance

    Args:
        optical: the scene on the nodes, `radiometry(scene, nodes)`.
        paths: `trace(scene, rays)`.
        path: how the radiance of the plume is estimated; its type decides what is compiled.
        key: random key, which every estimator but `CellSum` needs.

    Returns:
        Radiance [ray, node] [W m-2 sr-1], integrated over each node's bin.

    Differentiable, in both modes, in every radiometric leaf of the scene; not in its geometry.
    """
    radiance = _behind_plume(optical, paths)
    grid = None if optical.scene.plume is None else optical.scene.plume.grid
    if grid is not None and optical.extinction is not None and optical.emission is not None:
        cells = (-1, optical.nodes.count)
        extinction, emission = optical.extinction.reshape(cells), optical.emission.reshape(cells)
        if not isinstance(path, CellSum):
            if key is None:
                raise ValueError(f"key: got None, expected a random key for {type(path).__name__}")
            radiance = sampled_march(path, grid, extinction, emission, paths.rays, paths.length, radiance, key)
        elif paths.crossings is None:
            radiance = march(grid, optical.extinction, optical.emission, paths.rays, paths.length, radiance)
        else:
            radiance = crossing_sum(paths.crossings, extinction, emission, radiance)
    return through_air(optical, radiance)


def through_air(optical: Radiometry, radiance: Float[Array, "*batch node"]) -> Float[Array, "*batch node"]:
    """Equation (2): transmittance * L + path radiance; both absent means vacuum."""
    lead = (None,) * (radiance.ndim - 1)
    if optical.transmittance is not None:
        radiance = radiance * optical.transmittance[lead]
    if optical.path_radiance is not None:
        radiance = radiance + optical.path_radiance[lead]
    return radiance


def empty_radiance(optical: Radiometry) -> Float[Array, " node"]:
    """What the sensor sees where the scene is not: the background through the air [node] [W m-2 sr-1]."""
    return through_air(optical, _background(optical))


def _background(optical: Radiometry) -> Array:
    if optical.background is None:
        return jnp.zeros_like(optical.nodes.weight)
    return optical.background


def _behind_plume(optical: Radiometry, paths: Paths) -> Array:
    """Radiance that enters the plume from behind: skin where met, else background [ray, node]."""
    shape = (paths.rays.count, optical.nodes.count)
    background = jnp.broadcast_to(_background(optical), shape)
    if paths.hit is None:
        return background
    face = jnp.maximum(paths.hit.face, 0)
    assert paths.normal is not None
    light = None if paths.lit is None else _light_on_skin(optical, paths.hit.point, paths.lit)
    skin = leaving_radiance(optical, face, paths.normal, -paths.rays.direction, light)
    return jnp.where((paths.hit.face >= 0)[:, None], skin, background)


def _light_on_skin(optical: Radiometry, point: Array, lit: Array) -> Array:
    """Irradiance across each source's beam at points of the skin, dimmed by the plume [source, ray, node]."""
    assert optical.irradiance is not None
    beams = []
    for source, sees, irradiance in zip(optical.scene.sources, lit, optical.irradiance, strict=True):
        beam = jnp.where(sees[:, None], irradiance[None, :], 0)
        if optical.scene.plume is not None and optical.extinction is not None:
            toward = jnp.broadcast_to(-source.direction, point.shape)
            reach = jnp.where(sees, jnp.inf, 0)
            beam = beam * transmittance(optical.scene.plume.grid, optical.extinction, Rays(point, toward), reach)
        beams.append(beam)
    return jnp.stack(beams)


def leaving_radiance(
    optical: Radiometry,
    face: Int[Array, " ray"],
    normal: Float[Array, "ray 3"],
    omega_o: Float[Array, "ray 3"],
    light: Float[Array, "source ray node"] | None,
) -> Float[Array, "ray node"]:
    """Own emission plus reflected parallel light leaving the skin, equation (3).

        L = emissivity(theta_o) B(T) + sum_s brdf(omega_s, omega_o) cos(theta_s) E_s

    Args:
        optical: the scene on the nodes.
        face: which face.
        normal: unit normal on the side of `omega_o`.
        omega_o: towards the eye.
        light: irradiance E_s across each source's beam [W m-2], 0 where it does not reach; None without sources.

    Returns:
        Radiance [ray, node] [W m-2 sr-1].
    """
    assert optical.scene.skin is not None and optical.skin_source is not None
    brdf = optical.scene.skin.brdf.at(face)
    cos_o = jnp.sum(normal * omega_o, axis=-1)
    radiance = jax.vmap(lambda b, c: b.emissivity(c))(brdf, cos_o) * optical.skin_source[face]
    if light is None:
        return radiance
    for source, beam in zip(optical.scene.sources, light, strict=True):
        omega_i = jnp.broadcast_to(-source.direction, omega_o.shape)
        cos_i = jnp.maximum(jnp.sum(normal * omega_i, axis=-1), 0)
        reflected = jax.vmap(lambda b, i, o, n: b.eval(i, o, n))(brdf, omega_i, omega_o, normal)
        radiance = radiance + reflected * beam * cos_i[:, None]
    return radiance


def unoccluded_radiance(optical: Radiometry, toward: Float[Array, " 3"]) -> Float[Array, "face node"]:
    """Radiance leaving the front of every face in one direction if no face hides or shades another [face, node]."""
    assert optical.scene.skin is not None
    vector = optical.scene.skin.mesh.area_vectors()
    square = jnp.sum(vector * vector, axis=-1, keepdims=True)
    normal = vector * lax.rsqrt(jnp.where(square > 0, square, 1))
    face = jnp.arange(vector.shape[0], dtype=jnp.int32)
    omega_o = jnp.broadcast_to(toward, normal.shape)
    light = None
    if optical.irradiance is not None:
        shape = (optical.irradiance.shape[0], vector.shape[0], optical.nodes.count)
        light = jnp.broadcast_to(optical.irradiance[:, None, :], shape)
    return leaving_radiance(optical, face, normal, omega_o, light)
