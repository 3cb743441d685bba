"""Radiant intensity of skin that hides nothing: no rays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxir._arrays import enforce, known
from jaxir._programs import program
from jaxir.geometry import view_frame
from jaxir.geometry.search import is_convex
from jaxir.optics.spectrum import Band, Nodes
from jaxir.scene import Scene, on_nodes, scene_nodes
from jaxir.transport import unoccluded_radiance


def unoccluded_intensity(
    scene: Scene,
    azimuth: Any,
    elevation: Any,
    bands: Nodes | Band | Sequence[Band],
    *,
    upper_bound: bool = False,
) -> Float[Array, " band"]:
    """Radiant intensity of skin whose faces do not hide or shade one another: a sum over faces, no rays.

        I = sum_f A_f max(n_f . o, 0) L_f(o)

    Exact for closed convex bodies and for plane surfaces from in front; else refused unless asked for: an upper bound
    where no face is seen from behind. Backs of faces do not count.

    Args:
        scene: skin, with parallel sources, uniform surroundings and air if present; no plume. What skin reflects of
            the background counts, what it hides of it is not subtracted.
        azimuth: aspect [deg], see `view_frame`.
        elevation: likewise [deg].
        bands: bands or nodes.
        upper_bound: whether skin is allowed whose faces may hide or shade one another.

    Returns:
        Radiant intensity [band] [W sr-1], through the atmosphere's transmittance if there is one.

    Raises:
        ValueError: the scene has a plume or no skin, skin that is neither convex nor plane, other sources or
            surroundings, or values are out of range.

    Differentiable in every radiometric leaf, in the vertices, and in the aspect.
    """
    if scene.skin is None or scene.plumes:
        raise ValueError("scene: got a plume or no skin, expected skin alone; use render or signature for plumes")
    if scene.area_sources or any(source.travel is None for source in scene.delta_sources):
        raise ValueError("scene: got sources at a finite distance, expected parallel ones; use render or signature")
    if uneven := [type(around).__name__ for around in scene.surroundings if not around.uniform]:
        raise ValueError(f"scene: got a {uneven[0]}, expected uniform surroundings; use render or signature")
    vertices = known(scene.skin.mesh.vertices)
    if not upper_bound and vertices is not None and vertices.ndim == 2:
        if not is_convex(vertices, np.asarray(scene.skin.mesh.faces)):
            raise ValueError(
                "scene.skin: got faces that may hide one another or be seen from behind, expected a closed convex body "
                "or a plane surface; use render or signature, or upper_bound=True"
            )
    nodes = scene_nodes(scene, bands)
    return _summed(scene, enforce(nodes, scene.checks_on(nodes)), view_frame(azimuth, elevation))


@program
def _summed(scene: Scene, nodes: Nodes, frame: Array) -> Array:
    assert scene.skin is not None
    lit, toward = on_nodes(scene, nodes), frame[2]
    vector = scene.skin.mesh.area_vectors()
    projected = jnp.maximum(jnp.sum(vector * toward[None, :], axis=-1), 0)
    radiance = unoccluded_radiance(lit, toward)
    intensity = jnp.sum(projected[:, None] * radiance, axis=0)
    return nodes.in_band(lit.dimmed_by_air(intensity))
