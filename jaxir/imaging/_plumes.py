"""Radiant intensity of plumes alone, seen from afar: parallel rays through their box, no image."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxir._arrays import as_float, enforce
from jaxir._fields import require_count
from jaxir._programs import program
from jaxir.geometry import Rays, view_frame
from jaxir.optics.spectrum import Band, Nodes
from jaxir.scene import Scene, on_nodes, scene_nodes

GOLDEN = (math.sqrt(5) - 1) / 2
BEFORE = 0.01  # of a box, by which rays start before it: where a jet ends on it slopes would be those of either side


def plume_intensity(
    scene: Scene, azimuth: Any, elevation: Any, bands: Nodes | Band | Sequence[Band], rays: int = 8192
) -> Float[Array, " band"]:
    """Radiant intensity of plumes alone, by the integral along parallel rays that all enter the box around them.

        I = sum_f |n_f . o| A_f mean (L - L_empty)    over the three faces f of the box towards the sensor

    The faces lie side by side, each as wide as its share of the outline, and rays enter at the points ((i + 1/2) / n,
    i (sqrt 5 - 1) / 2 mod 1) of the golden-ratio lattice, which fill a rectangle evenly whatever its proportions and
    n (Niederreiter, Random Number Generation and Quasi-Monte Carlo Methods, 1992, ch. 3), so the error falls almost
    as 1 / rays. Of jets that shine by a thin ring at the lip, gray ones of a depth of 20 across the nozzle, it is some
    7 % with 8192 rays, of a depth of 60 a fifth.

    Args:
        scene: plumes without particles, with background and air if present; no skin.
        azimuth: aspect [deg], see `view_frame`.
        elevation: likewise [deg].
        bands: bands or nodes.
        rays: how many.

    Returns:
        Radiant intensity in contrast to the background [band] [W sr-1]; with air the apparent one.

    Raises:
        ValueError: the scene has skin or particles; values are out of range.

    Differentiable in every radiometric leaf, and in the place and shape of a jet; not in a grid or the aspect. Of one
    jet alone what its ends do is in the slopes (`AbstractPlume.carried`); of several plumes, with rays that stay, it is
    not, as in images.
    """
    if scene.skin is not None or scene.scatters:
        raise ValueError("scene: got skin or particles, expected plumes of gas alone")
    require_count("rays", rays)
    nodes = scene_nodes(scene, bands)
    return _integrated(scene, enforce(nodes, scene.checks_on(nodes)), view_frame(azimuth, elevation), rays)


@program
def _integrated(scene: Scene, nodes: Nodes, frame: Array, rays: int) -> Array:
    lit, extent = on_nodes(scene, nodes), lax.stop_gradient(scene.extent())
    through, area = entering(extent.min(axis=0), extent.max(axis=0), frame[2], rays)
    if len(scene.plumes) == 1:  # several do not move alike
        through, grown = scene.plumes[0].carried(through)
        area = area * grown
    far = jnp.full(through.count, jnp.inf, area.dtype)
    seen = lit.through_air(lit.through_plume(through, far, lit.background(through.direction)))
    return nodes.in_band(jnp.sum((seen - lit.empty(through.direction)) * area[:, None], axis=0))


def entering(
    low: Float[Array, " 3"], high: Float[Array, " 3"], toward: Float[Array, " 3"], count: int
) -> tuple[Rays, Float[Array, " ray"]]:
    """Rays against `toward` that start before the faces of a box, and the cross-section of each [ray] [m2]."""
    size = high - low
    index = np.arange(count)  # on the host: a multiple of the golden ratio soon fills the digits of float32
    along, across = as_float((index + 0.5) / count), as_float((index * GOLDEN + 0.5) % 1)
    projected = jnp.abs(toward) * jnp.prod(size) / size
    shares = projected / jnp.sum(projected)
    origin, area, begin = jnp.zeros((count, 3), size.dtype), jnp.zeros(count, size.dtype), as_float(0.0)
    for axis in range(3):  # the three faces side by side, each as wide as its share of the outline
        share = shares[axis]
        place = {axis: jnp.broadcast_to(jnp.where(toward[axis] > 0, size[axis], 0), along.shape)}
        even = jnp.clip((along - begin) / jnp.where(share > 0, share, 1), 0, 1)
        a, b = (axis + 1) % 3, (axis + 2) % 3
        longer = size[a] >= size[b]
        place[a], place[b] = jnp.where(longer, even, across) * size[a], jnp.where(longer, across, even) * size[b]
        own = jnp.stack([place[a] for a in range(3)], axis=1)
        here = (along >= begin) & (share > 0)
        origin = jnp.where(here[:, None], own, origin)
        area = jnp.where(here, projected[axis] / (jnp.where(share > 0, share, 1) * count), area)
        begin = begin + share
    start = origin + (low + BEFORE * jnp.max(size) * toward)[None]
    return Rays(start, jnp.broadcast_to(-toward, start.shape)), area
