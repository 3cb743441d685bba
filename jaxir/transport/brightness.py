"""Roughly what shines where in a scene: where rays are worth most, before any is traced.

Skin counts with its own emission and what it would scatter of unhidden lights without extent, a plume with its
emission, dimmed by itself as a layer as deep as the plume is wide. Nothing hides anything. Estimates may be as rough as
this, because they only place rays.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxir._arrays import as_float
from jaxir.geometry import Brightness, Camera, graded_camera
from jaxir.geometry.search import face_normal
from jaxir.optics import phi1
from jaxir.transport.jet import JetMedium
from jaxir.transport.medium import GridMedium
from jaxir.transport.radiometry import Radiometry

STATIONS = 48  # pieces of a jet along its axis
RINGS = 4  # and across it
BLOCKS = 24  # most pieces of a grid along each axis


def brightness(optical: Radiometry) -> Brightness:
    """Where a scene is bright, each band's intensity normalised and the bands averaged; without derivatives."""
    optical = lax.stop_gradient(optical)
    dtype, bands = optical.nodes.weight.dtype, optical.nodes.response.shape[0]
    corners, radiance = jnp.zeros((0, 3, 3), dtype), jnp.zeros((0, bands), dtype)
    ends, radius, intensity = jnp.zeros((0, 2, 3), dtype), jnp.zeros(0, dtype), jnp.zeros((0, bands), dtype)
    if optical.scene.skin is not None:
        mesh = optical.scene.skin.mesh
        corners = mesh.vertices[mesh.faces]
        radiance = optical.nodes.in_band(_of_skin(optical, corners))
    if optical.medium is not None:
        medium = optical.medium
        ends, radius, emitted = _of_grid(medium) if isinstance(medium, GridMedium) else _of_jet(medium)
        intensity = optical.nodes.in_band(emitted)
    area = jnp.linalg.norm(jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    total = jnp.sum(radiance * area[:, None], axis=0) / 8 + jnp.sum(intensity, axis=0)  # faces are seen by a quarter
    share = 1 / jnp.where(total > 0, total, 1) / bands
    return Brightness(corners, radiance @ share, ends, radius, intensity @ share)


@eqx.filter_jit
def graded_cameras(
    optical: Radiometry, aspect: Float[Array, "view 2"], shape: tuple[int, int], distance: Any
) -> Camera:
    """Cameras [view] that hold the scene and are graded by its brightness, for intensities; see `graded_camera`.

    Args:
        optical: the scene on the nodes.
        aspect: azimuth and elevation [view, 2] [deg].
        shape: rows and columns.
        distance: from the middle of the scene to the sensor [m]; inf allowed.
    """
    bright, extent = brightness(optical), optical.scene.extent()
    return lax.map(lambda a: graded_camera(a[0], a[1], extent, bright, shape, distance), aspect)


def _of_skin(optical: Radiometry, corners: Float[Array, "face 3 3"]) -> Float[Array, "face node"]:
    """Radiance of every face, as if a Lambert one."""
    skin, nodes = optical.scene.skin, optical.nodes
    assert skin is not None and optical.skin_source is not None
    face = jnp.arange(skin.mesh.count, dtype=jnp.int32)
    one = as_float(1.0)
    emissivity = jax.vmap(lambda b: b.emissivity(one))(skin.brdf.at(face))
    centre, normal = corners.mean(axis=1), face_normal(skin.mesh, face)
    irradiance = jnp.zeros_like(optical.skin_source)
    for source in optical.scene.delta_sources:
        toward, _ = jax.vmap(source.toward)(centre)
        beam = jax.vmap(lambda p, source=source: source.beam(nodes, p))(centre)
        irradiance = irradiance + jnp.maximum(jnp.sum(toward * normal, axis=1), 0)[:, None] * beam
    return emissivity * optical.skin_source + (1 - emissivity) * irradiance / np.pi


def _of_grid(medium: GridMedium) -> tuple[Array, Array, Array]:
    """Blocks of cells as balls: ends, radius, and intensity [block, node]."""
    grid, shape = medium.grid, medium.grid.shape
    size = grid.spacing * as_float(np.array(shape))
    emitted = medium.emission * phi1(medium.extinction * jnp.min(size)) * jnp.prod(grid.spacing)
    step = tuple(-(-count // BLOCKS) for count in shape)
    blocks = tuple(-(-count // each) for count, each in zip(shape, step, strict=True))
    pads = [(0, b * s - n) for b, s, n in zip(blocks, step, shape, strict=True)]
    padded = jnp.pad(emitted, [*pads, (0, 0)])
    whole = padded.reshape(blocks[0], step[0], blocks[1], step[1], blocks[2], step[2], -1).sum(axis=(1, 3, 5))
    place = jnp.stack(jnp.meshgrid(*(jnp.arange(b) for b in blocks), indexing="ij"), axis=-1).reshape(-1, 3)
    block = grid.spacing * as_float(np.array(step))
    centre = grid.origin[None] + (as_float(place) + 0.5) * block[None]
    radius = jnp.full(centre.shape[:1], jnp.max(block) / 2)
    return jnp.repeat(centre[:, None], 2, axis=1), radius, whole.reshape(centre.shape[0], -1)


def _of_jet(medium: JetMedium) -> tuple[Array, Array, Array]:
    """Rings about pieces of the axis as capsules: ends, radius, and intensity [piece * ring, node]."""
    jet = medium.jet
    radius = jet.diameter / 2
    z = jet.stations(as_float(np.linspace(0, 1, STATIONS + 1)))
    low, high = z[:-1], z[1:]
    middle = (low + high) / 2
    edge = radius + jet.spreading * middle
    outer = edge[:, None] * as_float(np.arange(1, RINGS + 1) / RINGS)[None, :]
    inner = outer - edge[:, None] / RINGS
    volume = np.pi * (outer**2 - inner**2) * (high - low)[:, None]
    fraction = jet.fraction(jnp.broadcast_to(middle[:, None], outer.shape), ((inner + outer) / 2) ** 2)
    knot = jnp.round(fraction * (medium.extinction.shape[0] - 1)).astype(jnp.int32)
    escaping = phi1(medium.extinction[knot] * edge[:, None, None])
    emitted = medium.emission[knot] * escaping * volume[..., None]
    ends = jet.nozzle[None, None] + jnp.stack([low, high], axis=1)[:, :, None] * jet.direction[None, None]
    return (
        jnp.repeat(ends, RINGS, axis=0),
        outer.reshape(-1),
        emitted.reshape(STATIONS * RINGS, -1),
    )
