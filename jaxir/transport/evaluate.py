"""Evaluate: radiance of traced paths for the present temperatures, emissivities and coefficients. Smooth."""

from __future__ import annotations

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Key

from jaxir.geometry import Rays
from jaxir.geometry.search import face_normal
from jaxir.transport.around import Leg, Vertex
from jaxir.transport.leaving import beyond, leaving, reflected
from jaxir.transport.medium import GridMedium
from jaxir.transport.path_estimator import AbstractPathEstimator, CellSum
from jaxir.transport.paths import Chain, Paths
from jaxir.transport.radiometry import (
    Radiometry,
    background_radiance,
    dimmed_by_air,
    plume_transmittance,
    through_air,
    through_plume,
)
from jaxir.transport.reflection import Reflection, reflection_of
from jaxir.transport.scatter_sum import Orders, scatter_sum


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
    if paths.scatter is not None:
        if not isinstance(path, CellSum):
            raise ValueError(f"path: got {type(path).__name__}, expected CellSum for a plume with particles")
        return evaluate_orders(optical, paths, reflection).radiance
    radiance = background_radiance(optical, paths.rays.direction)
    if paths.hit is not None:
        skin = _chain(optical, paths.chain, reflection) if paths.chain is not None and reflection is not None else None
        if skin is None:
            skin = leaving(optical, paths.vertex(), paths.around, reflection) + beyond(
                optical, paths.vertex(), reflection
            )
        radiance = jnp.where((paths.hit.face >= 0)[:, None], skin, radiance)
    if not isinstance(path, CellSum):
        if key is None or not isinstance(optical.medium, GridMedium):
            raise ValueError(f"path: got {type(path).__name__}, expected a random key and a gridded plume with it")
        return through_air(optical, optical.medium.sampled_leg(path, paths.rays, paths.length, radiance, key))
    if isinstance(optical.medium, GridMedium) and paths.crossings is not None:
        return through_air(optical, optical.medium.listed_leg(paths.crossings, radiance))
    return through_air(optical, through_plume(optical, paths.rays, paths.length, radiance))


def evaluate_orders(optical: Radiometry, paths: Paths, reflection: Reflection | None = None) -> Orders:
    """`evaluate` for a plume with particles, with what the last two orders of scattering brought [ray, node]."""
    assert paths.scatter is not None
    orders = scatter_sum(optical, paths.scatter, reflection_of(optical.scene, reflection))
    last, before = (dimmed_by_air(optical, part) for part in (orders.last, orders.before))
    return Orders(through_air(optical, orders.radiance), last, before)


def empty_radiance(optical: Radiometry, direction: Float[Array, "*batch 3"]) -> Float[Array, "*batch node"]:
    """What the sensor sees where the scene is not: the background through the air [*batch, node] [W m-2 sr-1]."""
    return through_air(optical, background_radiance(optical, direction))


def _chain(optical: Radiometry, chain: Chain, reflection: Reflection) -> Array:
    """Radiance that leaves the first vertices of paths, from the last bounce back [ray, node]."""

    def step(radiance: Array, link: tuple[Chain, Array]) -> tuple[Array, None]:
        (vertex, leg), last = (link[0].vertex, link[0].leg), link[1]
        arriving = lax.cond(  # the last leg goes nowhere, so its plume is not integrated
            last, lambda: jnp.zeros_like(radiance), lambda: _along(optical, vertex, leg, reflection, radiance)
        )
        left = leaving(optical, vertex, link[0].around, reflection)
        left = left + reflected(optical, vertex, leg.omega, leg.factor) * arriving
        if reflection.beyond is not None:
            left = left + jnp.where(last, beyond(optical, vertex, reflection), 0)
        return left, None

    count = reflection.bounces + 1
    last = jnp.arange(count, dtype=jnp.int32) == reflection.bounces
    assert optical.skin_source is not None
    nothing = jnp.zeros((chain.leg.factor.shape[1], optical.nodes.count), optical.skin_source.dtype)
    return lax.scan(step, nothing, (chain, last), reverse=True)[0]


def _along(optical: Radiometry, vertex: Vertex, leg: Leg, reflection: Reflection, radiance: Array) -> Array:
    """What legs bring to their first ends of `radiance` that leaves the skin at their others [ray, node]."""
    behind = jnp.where(leg.met[:, None], radiance, 0)
    if reflection.looks_for_plume(optical.scene):  # its emission was found as that of a light
        return plume_transmittance(optical, vertex.point, leg.omega, leg.length) * behind
    return through_plume(optical, Rays(vertex.point, leg.omega), leg.length, behind)


def unoccluded_radiance(optical: Radiometry, toward: Float[Array, " 3"]) -> Float[Array, "face node"]:
    """Radiance leaving the front of every face in one direction if no face hides or shades another [face, node]."""
    assert optical.scene.skin is not None
    mesh = optical.scene.skin.mesh
    face = jnp.arange(mesh.count, dtype=jnp.int32)
    normal = face_normal(mesh, face)
    sources = optical.scene.delta_sources
    lit = jnp.ones((len(sources), mesh.count), bool) if sources else None
    centre = jnp.mean(mesh.corners(), axis=1)
    return leaving(optical, Vertex(face, centre, normal, jnp.broadcast_to(toward, normal.shape), lit), None, None)
