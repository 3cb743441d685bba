"""Radiance along paths through a plume with particles.

With b_k the throughput of leg k (b_0 = 1), A_k what leg k brings without further scattering (emission, beams scattered
once, what the skin at its end sends, or the background), and T the transmittance up to where the path goes on,

    L = sum_k b_k A_k,    b_(k+1) = b_k T (scattering phase / (pdf_length pdf), or brdf cos / (pdf chance)).

Densities are those of the trace; scattering, T, phase and brdf carry the derivatives.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from jaxir._math import dot
from jaxir.scene.near_source import AbstractAreaSource
from jaxir.transport.leaving import beyond, leaving, reflected
from jaxir.transport.medium import GridMedium
from jaxir.transport.radiometry import (
    Radiometry,
    background_radiance,
    cell_lights,
    plume_emission,
    plume_transmittance,
    surrounding_radiance,
)
from jaxir.transport.reflection import Reflection
from jaxir.transport.scatter_trace import ScatterPath, vertex_lights


class Orders(NamedTuple):
    """Radiance of paths [ray, node], and the parts of it scattered as often as may be, and once less."""

    radiance: Float[Array, "ray node"]
    last: Float[Array, "ray node"]
    before: Float[Array, "ray node"]


class _Place(NamedTuple):
    """Whether a leg is the first, which is the eye's, and whether it is the last."""

    first: Array
    last: Array


def scatter_sum(optical: Radiometry, path: ScatterPath, reflection: Reflection | None) -> Orders:
    """Radiance along paths of `follow`, before the air. Differentiable in every radiometric leaf of the scene."""
    medium = optical.medium
    assert medium is not None and medium.phase is not None
    phase = medium.phase
    count = path.length.shape[0]

    def brings(leg: ScatterPath, place: _Place) -> Array:
        brought = _unscattered(optical, leg, reflection, _at_end(optical, leg, reflection, place))
        for source, irradiance in zip(cell_lights(optical.scene), optical.irradiance, strict=True):
            assert isinstance(medium, GridMedium)
            cosine = dot(leg.rays.direction, -source.direction[None])
            brought = brought + medium.in_scattered(irradiance, cosine, leg.rays, leg.length)
        return brought

    def step(state: tuple[Orders, Array], link: tuple[ScatterPath, _Place]) -> tuple[tuple[Orders, Array], None]:
        (sums, through), (leg, place) = state, link
        brought = brings(leg, place)
        scattered = leg.place.factor > 0
        reach = jnp.where(scattered, leg.place.t, jnp.where(leg.factor > 0, leg.length, 0))
        passed = medium.transmittance(leg.rays, reach)
        point = leg.rays.at(leg.place.t)
        event = jnp.where(scattered[:, None], medium.scattering_at(point) * passed * leg.place.factor[:, None], 0)
        if leg.beams is not None:
            brought = brought + event * _arriving(optical, leg, point)
        cosine = dot(leg.rays.direction, leg.omega)
        onward = event * jax.vmap(phase.eval)(cosine) * leg.factor[:, None]
        if leg.vertex is not None and reflection is not None and reflection.bounces:
            bounced = passed * reflected(optical, leg.vertex, leg.omega, jnp.where(scattered, 0, leg.factor))
            onward = jnp.where(scattered[:, None], onward, bounced)
        part = through * brought
        last, before = (jnp.where((leg.events == path.orders - less)[:, None], part, 0) for less in (0, 1))
        return (Orders(sums.radiance + part, sums.last + last, sums.before + before), through * onward), None

    first = jax.tree.map(lambda leaf: leaf[0], path.rays)
    dark = jnp.zeros((first.count, optical.nodes.count), first.origin.dtype)
    index = jnp.arange(count, dtype=jnp.int32)
    places = _Place(index == 0, index == count - 1)
    if count == 1:  # nothing goes on
        only, place = jax.tree.map(lambda leaf: leaf[0], (path, places))
        brought = brings(only, place)
        return Orders(brought, brought, dark)
    return lax.scan(step, (Orders(dark, dark, dark), jnp.ones_like(dark)), (path, places))[0][0]


def _unscattered(optical: Radiometry, leg: ScatterPath, reflection: Reflection | None, behind: Array) -> Array:
    """What comes along the legs [ray, node]: `behind` through the plume, with its emission unless found before."""
    assert optical.medium is not None
    if reflection is None or not reflection.looks_for_plume(optical.scene):
        return optical.medium.leg(leg.rays, leg.length, behind)
    own = plume_emission(optical, leg.rays.origin, leg.rays.direction, jnp.where(leg.glows, leg.length, 0))
    return own + optical.medium.transmittance(leg.rays, leg.length) * behind


def _at_end(optical: Radiometry, leg: ScatterPath, reflection: Reflection | None, place: _Place) -> Array:
    """What enters the legs at their far ends [ray, node]: what leaves the skin, or what surrounds the scene."""
    leaves = leg.open & jnp.isinf(leg.length)
    around = surrounding_radiance(optical, leg.rays.direction)
    if len(optical.scene.surroundings) > (optical.scene.background is not None):  # some are hidden from the eye
        around = jnp.where(place.first, background_radiance(optical, leg.rays.direction), around)
    behind = jnp.where(leaves[:, None], around, 0)
    if leg.vertex is None:
        return behind
    skin = leaving(optical, leg.vertex, leg.around, reflection)
    if reflection is not None and reflection.beyond is not None:
        skin = skin + jnp.where(place.last, beyond(optical, leg.vertex, reflection), 0)
    return jnp.where((leg.vertex.face >= 0)[:, None], skin, behind)


def _arriving(optical: Radiometry, leg: ScatterPath, point: Array) -> Array:
    """Sum over lights of phase(cosine) * light that reaches where paths are scattered [ray, node]."""
    assert leg.beams is not None and optical.medium is not None and optical.medium.phase is not None
    phase, total = optical.medium.phase, jnp.zeros((point.shape[0], optical.nodes.count), point.dtype)
    for place, source in enumerate(vertex_lights(optical.scene)):
        omega, factor = leg.beams.omega[place], leg.beams.factor[place]
        if isinstance(source, AbstractAreaSource):
            light = jnp.broadcast_to(source.emitted(optical.nodes)[None], total.shape)
        else:
            light = jax.vmap(lambda p, source=source: source.beam(optical.nodes, p))(point)
        spread = jax.vmap(lambda w, d: phase.eval(dot(w, d)))(omega, leg.rays.direction)
        dimmed = plume_transmittance(optical, point, omega, jnp.where(factor > 0, leg.beams.distance[place], 0))
        total = total + jnp.where((factor > 0)[:, None], spread * light * dimmed * factor[:, None], 0)
    return total
