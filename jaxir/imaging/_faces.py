"""Radiant intensity of skin that hides nothing: no rays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._arrays import enforce
from jaxir.geometry import view_frame
from jaxir.optics.spectrum import Band, Nodes, as_nodes
from jaxir.scene import Scene, on_nodes
from jaxir.transport import unoccluded_radiance


def unoccluded_intensity(
    scene: Scene, azimuth: Any, elevation: Any, bands: Nodes | Band | Sequence[Band]
) -> Float[Array, " band"]:
    """Radiant intensity of skin whose faces do not hide or shade one another: a sum over faces, no rays.

        I = sum_f A_f max(n_f . o, 0) L_f(o)

    Exact for convex bodies and for open surfaces seen from outside; an upper bound otherwise. Backs of faces do not
    count.

    Args:
        scene: skin, with sources and air if present; no plume. The background is not subtracted.
        azimuth: aspect [deg], see `view_frame`.
        elevation: likewise [deg].
        bands: bands or nodes.

    Returns:
        Radiant intensity [band] [W sr-1], through the atmosphere's transmittance if there is one.

    Raises:
        ValueError: the scene has a plume or no skin, or values are out of range.

    Differentiable in every radiometric leaf, in the vertices, and in the aspect.
    """
    if scene.skin is None or scene.plumes:
        raise ValueError("scene: got a plume or no skin, expected skin alone; use render or signature for plumes")
    if scene.area_sources or any(source.travel is None for source in scene.delta_sources):
        raise ValueError("scene: got sources at a finite distance, expected parallel ones; use render or signature")
    nodes = as_nodes(bands)
    return _summed(scene, enforce(nodes, scene.checks_on(nodes)), view_frame(azimuth, elevation))


@eqx.filter_jit
def _summed(scene: Scene, nodes: Nodes, frame: Array) -> Array:
    assert scene.skin is not None
    lit, toward = on_nodes(scene, nodes), frame[2]
    vector = scene.skin.mesh.area_vectors()
    projected = jnp.maximum(jnp.sum(vector * toward[None, :], axis=-1), 0)
    radiance = unoccluded_radiance(lit, toward)
    intensity = jnp.sum(projected[:, None] * radiance, axis=0)
    return nodes.in_band(lit.dimmed_by_air(intensity))
