"""Light on convex Lambert skin without samples."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._math import dot
from jaxir.geometry import disc_vector, polygon_form_factor
from jaxir.optics.spectrum import Nodes
from jaxir.scene.background import AbstractUniformBackground
from jaxir.scene.near_source import AbstractAreaSource, DiscSource, PolygonSource
from jaxir.scene.scene import Scene
from jaxir.transport.around import Vertex


def closed_form(scene: Scene, nodes: Nodes, vertex: Vertex) -> Float[Array, "ray node"]:
    """Reflected radiance [ray, node], reflectance * (sum over sources of F L + background).

    F is the form factor of the disc or polygon seen from the point. Right where `ClosedForm.require` holds.
    Differentiable in reflectance and radiances.
    """
    assert scene.skin is not None
    arriving = jnp.zeros((vertex.face.shape[0], nodes.count), vertex.point.dtype)
    for light in scene.area_sources:
        emitted = light.emitted(nodes)
        factor = jax.vmap(lambda p, n, light=light: _form_factor(light, p, n))(vertex.point, vertex.normal)
        arriving = arriving + factor[:, None] * emitted[None]
    for around in scene.surroundings:
        assert isinstance(around, AbstractUniformBackground)
        arriving = arriving + around.level(nodes)[None, :]
    brdf = scene.skin.brdf.at(jnp.maximum(vertex.face, 0))
    return jax.vmap(lambda b: b.reflectance(jnp.ones((), vertex.point.dtype)))(brdf) * arriving


def _form_factor(light: AbstractAreaSource, point: Array, normal: Array) -> Array:
    """How much of a receiver's view the light fills, weighted by the cosine []."""
    if isinstance(light, DiscSource):
        return jnp.maximum(dot(disc_vector(point, light.centre, light.normal, light.radius), normal), 0)
    assert isinstance(light, PolygonSource)
    return polygon_form_factor(point, normal, light.corners)
