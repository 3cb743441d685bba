"""Points of the skin drawn as lights, and the density with which they are."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int, Key

from jaxir.geometry import AbstractSampler, pdf_from_area, pdf_triangle, sample_triangle
from jaxir.geometry.search import Mesh, face_normal
from jaxir.scene.skin import Skin
from jaxir.transport.reflection import SkinLight


def face_odds(skin: Skin, light: SkinLight) -> Float[Array, " face"]:
    """Probability that the face drawn is this one or one before it [face].

    Steps below the rounding of 1 (6e-8 in float32) are lost: such a face is drawn a little too often, or never.
    """
    vector = skin.mesh.area_vectors()
    area = jnp.sqrt(jnp.sum(vector * vector, axis=-1))
    warmth = (skin.temperature / jnp.max(skin.temperature)) ** light.exponent
    below = lax.cummax(jnp.cumsum(area * warmth))  # a sum in parallel may fall by its rounding
    return below / jnp.where(below[-1] > 0, below[-1], 1)


def draw_points(
    mesh: Mesh, odds: Float[Array, " face"], sampler: AbstractSampler, key: Key[Array, ""], count: int
) -> tuple[Int[Array, " count"], Float[Array, "count 3"]]:
    """Faces chosen by their odds, and points uniform in area on them [m]."""
    for_face, for_point = jax.random.split(key)
    chosen = sampler.draw(for_face, count)[:, 0]
    face = jnp.searchsorted(odds, chosen, side="right").astype(jnp.int32)
    face = jnp.minimum(face, mesh.count - 1)
    weights = jax.vmap(sample_triangle)(sampler.draw(for_point, count))
    return face, jnp.sum(weights[:, :, None] * mesh.vertices[mesh.faces[face]], axis=1)


def pdf_points(
    mesh: Mesh,
    odds: Float[Array, " face"],
    face: Int[Array, " ray"],
    omega: Float[Array, "ray 3"],
    distance: Float[Array, " ray"],
) -> Float[Array, " ray"]:
    """Density [ray] [sr-1] of `draw_points` for a point of a face at a distance; 0 for face -1."""
    at = jnp.maximum(face, 0)
    chance = odds[at] - jnp.where(at > 0, odds[at - 1], 0)
    density = jax.vmap(pdf_triangle)(mesh.vertices[mesh.faces[at]])
    reach = jnp.where(face >= 0, distance, 0)
    return jax.vmap(pdf_from_area)(chance * density, omega, reach, face_normal(mesh, at))
