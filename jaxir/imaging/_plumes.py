"""Radiant intensity of a gridded plume alone, seen from afar: parallel rays through its box, no image."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxir._arrays import as_float, enforce
from jaxir.geometry import Grid, Rays, view_frame
from jaxir.optics.spectrum import Band, Nodes, as_nodes
from jaxir.scene.plume import GridPlume
from jaxir.scene.scene import Scene
from jaxir.transport.evaluate import empty_radiance
from jaxir.transport.radiometry import background_radiance, radiometry, through_air, through_plume

GOLDEN = (math.sqrt(5) - 1) / 2


def plume_intensity(
    scene: Scene, azimuth: Any, elevation: Any, bands: Nodes | Band | Sequence[Band], rays: int = 8192
) -> Float[Array, " band"]:
    """Radiant intensity of a gridded plume alone, by the exact sum along parallel rays that all meet it.

        I = sum_f |n_f . o| A_f mean (L - L_empty)    over the three faces f of its box towards the sensor

    The faces lie side by side, each as wide as its share of the outline, and rays enter at the points ((i + 1/2) / n,
    i (sqrt 5 - 1) / 2 mod 1) of the golden-ratio lattice, which fill a rectangle evenly whatever its proportions and
    n (Niederreiter, Random Number Generation and Quasi-Monte Carlo Methods, 1992, ch. 3), so the error falls almost
    as 1 / rays.

    Args:
        scene: a gridded plume without particles, with background and air if present; no skin.
        azimuth: aspect [deg], see `view_frame`.
        elevation: likewise [deg].
        bands: bands or nodes.
        rays: how many.

    Returns:
        Radiant intensity in contrast to the background [band] [W sr-1]; with air the apparent one.

    Raises:
        ValueError: the scene has skin, or no gridded plume, or one with particles; values are out of range.

    Differentiable in every radiometric leaf; not in the grid or the aspect.
    """
    plume = scene.plume
    if scene.skin is not None or not isinstance(plume, GridPlume) or plume.particles is not None:
        raise ValueError("scene: got skin, particles or no gridded plume, expected a gridded plume of gas alone")
    if isinstance(rays, bool) or not isinstance(rays, int) or rays < 1:
        raise ValueError(f"rays: got {rays!r}, expected an integer >= 1")
    nodes = enforce(as_nodes(bands), scene.checks())
    optical = radiometry(scene, nodes)
    through, area = entering(plume.grid, view_frame(azimuth, elevation)[2], rays)
    far = jnp.full(through.count, jnp.inf, area.dtype)
    seen = through_air(optical, through_plume(optical, through, far, background_radiance(optical, through.direction)))
    contrast = seen - empty_radiance(optical, through.direction)
    return nodes.in_band(jnp.sum(contrast, axis=0) * area)


def entering(grid: Grid, toward: Float[Array, " 3"], count: int) -> tuple[Rays, Float[Array, ""]]:
    """Rays against `toward` that start on the faces of the box, and the cross-section that each stands for [m2]."""
    size = grid.spacing * as_float(jnp.asarray(grid.shape))
    index = np.arange(count)  # on the host: a multiple of the golden ratio soon fills the digits of float32
    along, across = as_float((index + 0.5) / count), as_float((index * GOLDEN + 0.5) % 1)
    projected = jnp.abs(toward) * jnp.prod(size) / size
    whole = jnp.sum(projected)
    origin, begin = jnp.zeros((count, 3), size.dtype), as_float(0.0)
    for axis in range(3):  # the three faces side by side, each as wide as its share of the outline
        long, short = sorted(((axis + 1) % 3, (axis + 2) % 3), key=lambda other: -grid.shape[other])
        share = projected[axis] / whole
        place = {axis: jnp.broadcast_to(jnp.where(toward[axis] > 0, size[axis], 0), along.shape)}
        place[long] = jnp.clip((along - begin) / jnp.where(share > 0, share, 1), 0, 1) * size[long]
        place[short] = across * size[short]
        own = jnp.stack([place[a] for a in range(3)], axis=1)
        origin = jnp.where(((along >= begin) & (share > 0))[:, None], own, origin)
        begin = begin + share
    start = origin + grid.origin[None]
    return Rays(start, jnp.broadcast_to(-toward, start.shape)), whole / count
