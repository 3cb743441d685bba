"""How many panels a jet needs."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from jaxir._arrays import as_float, enforce
from jaxir._math import frame_around, matmul
from jaxir._programs import program
from jaxir.geometry import Rays
from jaxir.medium import JetMedium
from jaxir.optics.spectrum import Band, Nodes, as_nodes
from jaxir.scene.plume._jet import JetPlume

MOST_PANELS = 256
_SAMPLE_ANGLES = np.deg2rad([0.0, 3.0, 15.0, 45.0, 90.0, 135.0, 165.0, 177.0, 180.0])
_SAMPLE_RAYS = 128


@program
def _sampled(medium: JetMedium) -> tuple[Array, Array]:
    """Radiance and transmittance of rays through points spread over the jet, at angles with its axis [view, ray, node].

    Points are spread evenly in ln(z + d / 2), in area and in azimuth by a Kronecker sequence.
    """
    jet = medium.shape
    ray = np.arange(1, _SAMPLE_RAYS + 1)[:, None]
    u = as_float(np.modf(ray * np.array([[0.8191725134, 0.6710436067, 0.5497004779]]))[0])
    frame = frame_around(jet.direction)
    z = jet.stations(u[:, 0])
    r = jet.edge(z) * jnp.sqrt(u[:, 1])
    turn = 2 * jnp.pi * u[:, 2]
    point = matmul(jnp.stack([r * jnp.cos(turn), r * jnp.sin(turn), z], axis=-1), frame) + jet.nozzle[None, :]
    back = 2 * (jet.end + jet.edge(jet.end))

    def view(angle: Array) -> tuple[Array, Array]:
        direction = jnp.cos(angle) * frame[2] + jnp.sin(angle) * frame[0]
        rays = Rays(point - back * direction[None, :], jnp.broadcast_to(direction, point.shape))
        t_max = jnp.full((_SAMPLE_RAYS,), jnp.inf, point.dtype)
        dark = jnp.zeros((_SAMPLE_RAYS, medium.extinction.shape[1]), point.dtype)
        return medium.radiance(rays, t_max, dark), medium.transmittance(rays, t_max)

    return lax.map(view, as_float(_SAMPLE_ANGLES))


def resolve_jet(
    jet: JetPlume, bands: Nodes | Band | tuple[Band, ...] | list[Band], tolerance: float = 1e-3
) -> JetPlume:
    """The jet with the fewest panels, a power of two, that keep its quadrature within a tolerance.

    Panels are doubled until doubling changes, on 128 rays from each of 9 angles between head-on and tail-on, no
    radiance by more than `tolerance` times the largest of its angle and node, and no transmittance by more than
    `tolerance`. On the host; the number of panels is structure, so ask once and not inside a fit.

    Args:
        jet: the jet.
        bands: bands or nodes.
        tolerance: > 0. Interpolation between the states of the jet adds about 1e-4 that no panel removes.

    Returns:
        The jet with its `panels` replaced.

    Raises:
        ValueError: the tolerance is not a positive number, is not reached with 256 panels, or the jet's values are
            out of range.
    """
    if not (np.isfinite(tolerance) and tolerance > 0):
        raise ValueError(f"tolerance: got {tolerance}, expected a number > 0")
    nodes = enforce(as_nodes(bands), jet.checks())

    def at(panels: int) -> tuple[np.ndarray, np.ndarray]:
        sampled = _sampled(jet.with_panels(panels).medium(nodes))
        return np.asarray(sampled[0], np.float64), np.asarray(sampled[1], np.float64)

    panels, coarse = 1, at(1)
    while True:
        fine = at(2 * panels)
        largest = np.maximum(fine[0].max(axis=1, keepdims=True), np.finfo(np.float32).tiny)
        change = max(float(np.max(np.abs(fine[0] - coarse[0]) / largest)), float(np.max(np.abs(fine[1] - coarse[1]))))
        if change <= tolerance:
            return jet.with_panels(panels)
        panels, coarse = 2 * panels, fine
        if panels > MOST_PANELS:
            raise ValueError(
                f"tolerance: got {tolerance}, expected one that {MOST_PANELS} panels reach; the last doubling changed "
                f"radiance by {change:.1e}"
            )
