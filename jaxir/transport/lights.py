"""Lights with an extent as seen from one point of the skin: area sources, and the background over its horizon."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir.optics.spectrum import Nodes
from jaxir.optics.surface import cosine_density, cosine_direction
from jaxir.scene.background import AbstractBackground
from jaxir.scene.near_source import AbstractAreaSource, Arrival

Light = AbstractAreaSource | AbstractBackground


def sample_light(light: Light, u: Float[Array, " 2"], point: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Arrival:
    """A direction towards the light from two uniform numbers; the background is drawn with density cos / pi."""
    if isinstance(light, AbstractAreaSource):
        return light.sample(u, point)
    return _background(cosine_direction(u, normal), normal)


def meet_light(
    light: Light, omega_i: Float[Array, " 3"], point: Float[Array, " 3"], normal: Float[Array, " 3"]
) -> Arrival:
    """Where a direction meets the light, with the density that `sample_light` has for it."""
    return light.meet(point, omega_i) if isinstance(light, AbstractAreaSource) else _background(omega_i, normal)


def light_radiance(light: Light, nodes: Nodes, omega_i: Float[Array, "*batch 3"]) -> Float[Array, "*batch node"]:
    """Radiance that arrives from the light in directions that meet it [W m-2 sr-1]. Differentiable in its leaves."""
    if isinstance(light, AbstractBackground):
        return light.radiance(nodes, omega_i)
    return jnp.broadcast_to(light.emitted(nodes), omega_i.shape[:-1] + (nodes.count,))


def _background(omega_i: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Arrival:
    return Arrival(omega_i, jnp.full((), jnp.inf, omega_i.dtype), cosine_density(omega_i, normal))
