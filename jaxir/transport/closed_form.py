"""Light on convex Lambert skin without samples."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._vector import dot
from jaxir.geometry.form_factor import disc_vector
from jaxir.optics.band import Nodes
from jaxir.scene.background import AbstractUniformBackground
from jaxir.scene.near_source import DiscSource
from jaxir.scene.scene import Scene
from jaxir.transport.around import Vertex


def closed_form(scene: Scene, nodes: Nodes, vertex: Vertex) -> Float[Array, "ray node"]:
    """Reflected radiance [ray, node], reflectance * (sum over discs of F L + background).

    F is the form factor of the disc seen from the point. Right where `ClosedForm.require` holds. Differentiable in
    reflectance and radiances.
    """
    assert scene.skin is not None
    arriving = jnp.zeros((vertex.face.shape[0], nodes.count), vertex.point.dtype)
    for disc in scene.area_sources:
        assert isinstance(disc, DiscSource)
        emitted = disc.emitted(nodes)

        def found(point: Array, normal: Array, disc: DiscSource = disc, emitted: Array = emitted) -> Array:
            vector = disc_vector(point, disc.centre, disc.normal, disc.radius)
            return jnp.maximum(dot(vector, normal), 0) * emitted

        arriving = arriving + jax.vmap(found)(vertex.point, vertex.normal)
    for around in scene.surroundings:
        assert isinstance(around, AbstractUniformBackground)
        arriving = arriving + around.level(nodes)[None, :]
    brdf = scene.skin.brdf.at(jnp.maximum(vertex.face, 0))
    return jax.vmap(lambda b: b.reflectance(jnp.ones((), vertex.point.dtype)))(brdf) * arriving
