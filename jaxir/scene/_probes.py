"""What may be seen of a scene, by which its spectral nodes are tried: rays through its plumes, its skin and its lights.

An image shows contrasts, of which those between like things are spectra of their own: skin of 300 K before a background
of 299 K is the slope of Planck's law.
"""

from __future__ import annotations

import itertools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxir._arrays import as_float
from jaxir._math import frame_around, matmul, middles
from jaxir.geometry import Rays
from jaxir.optics.spectrum import Nodes, band_radiance
from jaxir.scene._scene import Lit, Scene
from jaxir.scene._skin import Skin
from jaxir.scene.light import AbstractLight, area_sources, backgrounds, delta_sources, towards
from jaxir.scene.plume import AbstractPlume

RAYS = 144  # through each plume
ACROSS = 6  # rows and columns of rays
DIRECTIONS = np.array([[1.0, 0.0, 0.0], [0.6, 0.0, 0.8], [0.0, 0.28, 0.96], [0.12, 0.09, 0.98868]])  # z along plumes
HOT = 6.0  # power of the temperature by which places are drawn, about that of what is emitted at 3 to 5 um
ALONG = 0.15  # 1 - cos of the directions about a plume's axis that half of the rays have, at most
WARM = 17  # temperatures of skin that are tried
BEHIND = 3  # of them behind plumes
# Where light comes from that differs from place to place: from above, below and aside, and from between.
TOWARD = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [0.0, 0.8, 0.6], [0.0, 0.995, 0.0998749]])


def draws() -> np.ndarray:
    """Even numbers in [0, 1) [ray, 6]: multiples of powers of the root of x^7 = x + 1 (Roberts 2018)."""
    root = 1.0
    for _ in range(64):
        root = (1 + root) ** (1 / 7)
    return ((np.arange(RAYS)[:, None] + 1) * root ** -(1.0 + np.arange(6))) % 1


def across(scene: Scene) -> Rays:
    """Rays from outside, `ACROSS`^2 even ones in each of `DIRECTIONS` through the box about each plume."""
    place = middles(ACROSS)
    share = np.full((len(DIRECTIONS), len(place), 3), 0.5)
    for own, toward in zip(share, DIRECTIONS, strict=True):
        own[:, np.arange(3) != np.argmax(np.abs(toward))] = place
    direction = np.repeat(DIRECTIONS, len(place), axis=0)

    def of(plume: AbstractPlume) -> Rays:
        frame = _along(plume)
        corners = matmul(plume.extent(), frame.T)
        low, high = corners.min(axis=0), corners.max(axis=0)
        origin = low[None] + as_float(share.reshape(-1, 3)) * (high - low)[None]
        return Rays(matmul(origin, frame), matmul(as_float(direction), frame))

    return from_outside(scene, joined([of(plume) for plume in scene.plumes]))


def between(scene: Scene) -> list[Rays]:
    """`ACROSS`^2 rays through each two plumes, from places in one to like places in the other: one hides the other."""
    share = as_float(draws()[: ACROSS**2, 1:4])

    def places(plume: AbstractPlume) -> Float[Array, "ray 3"]:
        low, high = plume.extent().min(axis=0), plume.extent().max(axis=0)
        return low[None] + share * (high - low)[None]

    def of(one: AbstractPlume, other: AbstractPlume) -> Rays:
        origin = places(one)
        return from_outside(scene, Rays(origin, jax.vmap(towards)(places(other) - origin)[0]))

    return [of(*pair) for pair in itertools.permutations(scene.plumes, 2)]  # both ways


def through(scene: Scene, draws: Float[Array, "ray 6"]) -> Rays:
    """`RAYS` rays through each plume that begin in it: at places drawn half by what is hot and half evenly.

    Every other goes to any side, and those between nearly along the plume.
    """
    return joined([_through(plume, draws) for plume in scene.plumes])


def joined(each: list[Rays]) -> Rays:
    """All of several groups of rays."""
    return jax.tree.map(lambda *all: jnp.concatenate(all), *each)


def _through(plume: AbstractPlume, draws: Float[Array, "ray 6"]) -> Rays:
    pieces = plume.pieces(as_float(HOT))
    share = pieces.power / jnp.sum(pieces.power) + 1 / pieces.power.size
    place = jnp.searchsorted(jnp.cumsum(share), draws[:, 0] * jnp.sum(share))
    place = jnp.minimum(place, pieces.power.size - 1)
    local = pieces.centre[:, place] + (2 * draws[:, 1:4].T - 1) * pieces.half[:, place]
    cosine = 2 * draws[:, 4] - 1
    axial = jnp.sign(cosine) * (1 - ALONG * cosine**2)
    cosine = jnp.where(np.arange(RAYS) % 2 == 0, cosine, axial)
    turn, sine = 2 * np.pi * draws[:, 5], jnp.sqrt(jnp.maximum(1 - cosine**2, 0))
    direction = jnp.stack([sine * jnp.cos(turn), sine * jnp.sin(turn), cosine], axis=1)
    return Rays(matmul(local.T, pieces.frame), matmul(direction, _along(plume)))


def _along(plume: AbstractPlume) -> Float[Array, "3 3"]:
    """Unit vectors as rows, the last along the plume: that in which its corners are farthest apart."""
    corners = plume.extent()
    apart = corners - corners.mean(axis=0, keepdims=True)
    spread = matmul(apart.T, apart)
    for _ in range(6):  # of its powers the largest direction is left
        spread = spread / jnp.trace(spread)
        spread = matmul(spread, spread)
    axis = spread[jnp.argmax(jnp.diagonal(spread))]
    return frame_around(axis / jnp.sqrt(jnp.sum(axis**2)))


def from_outside(scene: Scene, rays: Rays) -> Rays:
    """The same rays from before the scene."""
    corners = scene.extent()
    away = jnp.sqrt(jnp.sum((corners.max(axis=0) - corners.min(axis=0)) ** 2))
    return Rays(rays.origin - away * rays.direction, rays.direction)


def warmth(skin: Skin, nodes: Nodes) -> Float[Array, "warm node"]:
    """Blackbodies of `WARM` temperatures from that of the coldest skin to that of the warmest, even in 1 / T."""
    cold, hot = skin.temperature.min(), skin.temperature.max()
    share = as_float(np.arange(WARM) / (WARM - 1))
    return jax.vmap(lambda t: band_radiance(t, nodes))(1 / (1 / cold + share * (1 / hot - 1 / cold)))


def behind(warm: Float[Array, "warm node"]) -> Float[Array, "behind node"]:
    """Those of them that are looked at through plumes."""
    return warm[:: (WARM - 1) // (BEHIND - 1)]


def scattered(lit: Lit, rays: Rays, passed: Float[Array, "ray node"]) -> Float[Array, "ray node"]:
    """What particles scatter of light from outside, if once and lit as if nothing were before; of the sky evenly."""
    assert lit.medium is not None
    found = jnp.zeros_like(passed)
    lobes = [part.lobe for part in lit.medium.parts_with_particles if part.lobe is not None]
    centre, omega = lit.scene.extent().mean(axis=0), jnp.asarray(TOWARD, passed.dtype)
    for source in delta_sources(lit.scene.sources):
        cosine = matmul(rays.direction, source.toward(centre)[0])
        found = found + source.beam(centre)[None] * sum(jax.vmap(lobe.eval)(cosine) for lobe in lobes) / len(lobes)
    for around in lit.scene.surroundings:
        found = found + around.arriving(omega).mean(axis=0)[None]
    shares = [jnp.ones(passed.shape[1], passed.dtype) for _ in lobes]
    absorbed = lit.medium.less_forward(shares).transmittance(rays, jnp.full(rays.count, jnp.inf, passed.dtype))
    return (absorbed - passed) * found


def brought(lights: tuple[AbstractLight, ...], nodes: Nodes) -> list[Float[Array, "_light node"]]:
    """What lights on the nodes bring from `TOWARD`."""
    omega = jnp.asarray(TOWARD, nodes.weight.dtype)
    found = [source.beam(omega[0])[None] for source in delta_sources(lights)]
    return found + [light.arriving(omega) for light in (*area_sources(lights), *backgrounds(lights))]
