"""A scene on the spectral nodes, and what its surroundings and its plume do to a ray."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from jaxir.geometry import Rays
from jaxir.geometry.search import occluded
from jaxir.optics.spectrum import Nodes, band_radiance
from jaxir.scene.background import AbstractUniformBackground
from jaxir.scene.plume import GridPlume
from jaxir.scene.scene import Scene
from jaxir.scene.source import ParallelSource
from jaxir.transport.jet import JetMedium, jet_medium
from jaxir.transport.medium import GridMedium, grid_medium


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
        irradiance: of each of `cell_lights` at the centres of cells, for particles [nx, ny, nz, node] [W m-2].

    A field is None where the scene lacks the part.
    """

    scene: Scene
    nodes: Nodes
    skin_source: Float[Array, "face node"] | None
    medium: GridMedium | JetMedium | None
    background: Float[Array, " node"] | None
    transmittance: Float[Array, " node"] | None
    path_radiance: Float[Array, " node"] | None
    irradiance: tuple[Float[Array, "nx ny nz node"], ...]


def cell_lights(scene: Scene) -> tuple[ParallelSource, ...]:
    """Sources whose light, scattered once, is summed over cells: parallel ones, in a gridded plume with particles."""
    if not isinstance(scene.plume, GridPlume) or scene.plume.particles is None:
        return ()
    return tuple(source for source in scene.sources if isinstance(source, ParallelSource))


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
        irradiance=tuple(_at_cells(scene, medium, nodes, source) for source in cell_lights(scene)),
    )


compiled_radiometry = eqx.filter_jit(radiometry)


def _at_cells(scene: Scene, medium: GridMedium | JetMedium | None, nodes: Nodes, source: ParallelSource) -> Array:
    """Irradiance of a beam at the centre of every cell, behind skin and plume [nx, ny, nz, node]."""
    assert isinstance(medium, GridMedium) and medium.scattering is not None and isinstance(scene.plume, GridPlume)
    centre = lax.stop_gradient(scene.plume.grid.centres()).reshape(-1, 3)
    toward = jnp.broadcast_to(-source.direction, centre.shape)
    there = jnp.any(medium.scattering > 0, axis=-1).reshape(-1)  # a cell without particles costs no march
    passed = medium.transmittance(Rays(centre, toward), jnp.where(there, jnp.inf, 0).astype(centre.dtype))
    if scene.skin is not None:
        free = jnp.full(centre.shape[:1], -1, jnp.int32)
        hidden = occluded(scene.skin.mesh, centre, free, -source.direction, there)
        passed = jnp.where(hidden[:, None], 0, passed)
    return (passed * source.beam(nodes, centre[0])[None]).reshape((*scene.plume.grid.shape, nodes.count))


def dimmed_by_air(optical: Radiometry, radiance: Float[Array, "*batch node"]) -> Float[Array, "*batch node"]:
    """transmittance * L; without air L itself."""
    lead = (None,) * (radiance.ndim - 1)
    return radiance if optical.transmittance is None else radiance * optical.transmittance[lead]


def through_air(optical: Radiometry, radiance: Float[Array, "*batch node"]) -> Float[Array, "*batch node"]:
    """Equation (2): transmittance * L + path radiance; both absent means vacuum."""
    radiance, lead = dimmed_by_air(optical, radiance), (None,) * (radiance.ndim - 1)
    return radiance if optical.path_radiance is None else radiance + optical.path_radiance[lead]


def background_radiance(optical: Radiometry, direction: Array) -> Array:
    """[*batch, node]."""
    shape = direction.shape[:-1] + (optical.nodes.count,)
    background = optical.scene.background
    if background is None:
        return jnp.zeros(shape, direction.dtype)
    if optical.background is not None:
        return jnp.broadcast_to(optical.background, shape)
    return background.radiance(optical.nodes, direction)


def surrounding_radiance(optical: Radiometry, direction: Array) -> Array:
    """What legs that leave the scene find [*batch, node]: the background, and those that the eye does not see."""
    found = background_radiance(optical, direction)
    for hidden in optical.scene.surroundings:
        if hidden is not optical.scene.background:
            found = found + hidden.radiance(optical.nodes, direction)
    return found


def through_plume(optical: Radiometry, rays: Rays, length: Array, behind: Array) -> Array:
    """Radiance at the origins of rays that end after `length` [ray], where `behind` [ray, node] enters them."""
    return behind if optical.medium is None else optical.medium.leg(rays, length, behind)


def plume_emission(optical: Radiometry, point: Array, omega: Array, length: Array) -> Array:
    """Radiance [*batch, node] of the plume alone at points along unit vectors [*batch, 3] up to `length` [*batch]."""
    rays, nodes = Rays(point.reshape(-1, 3), omega.reshape(-1, 3)), optical.nodes.count
    emitted = through_plume(optical, rays, length.reshape(-1), jnp.zeros((rays.count, nodes), point.dtype))
    return emitted.reshape(length.shape + (nodes,))


def plume_transmittance(optical: Radiometry, point: Array, omega: Array, length: Array) -> Array | float:
    """Transmittance [*batch, node] from points along unit vectors [*batch, 3] for `length` [*batch]."""
    if optical.medium is None:
        return 1.0
    rays = Rays(point.reshape(-1, 3), omega.reshape(-1, 3))
    passed = optical.medium.transmittance(rays, length.reshape(-1))
    return passed.reshape(length.shape + (optical.nodes.count,))
