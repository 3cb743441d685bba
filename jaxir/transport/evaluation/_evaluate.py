"""Evaluate: radiance of traced paths for the present temperatures, emissivities and coefficients. Smooth.

With b_k the throughput of segment k (b_0 = 1), A_k what segment k brings without going on (the plume's emission, beams
scattered once, and what leaves the skin at its end or surrounds the scene), D_k the direct light where particles
scatter the path, and T the transmittance up to where it goes on,

    L = sum_k b_k (A_k + e_k (D_k - E_k)),    e_k = T scattering / pdf_length,
    b_(k+1) = b_k (e_k phase / pdf, or T brdf cos / (pdf chance)).

E_k is 0, or what a lattice of scattered light says of D_k and of what segment k + 1 brings, which is in A_k already.
Densities are those of the trace; scattering, T, phase, brdf and emission carry the derivatives.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from jaxir._math import in_kernels
from jaxir._programs import program
from jaxir.scene import Lit
from jaxir.transport._paths import Paths, Segment
from jaxir.transport._through import Through
from jaxir.transport.evaluation._scattered import with_scattered
from jaxir.transport.evaluation._segments import (
    brings,
    direct_at_particles,
    event,
    expected_at_particles,
    onward,
    transmittance,
)

T = TypeVar("T")


class Orders(NamedTuple):
    """Radiance of paths [ray, node], and the parts of it scattered as often as may be, and once less."""

    radiance: Float[Array, "ray node"]
    last: Float[Array, "ray node"]
    before: Float[Array, "ray node"]


def evaluate(lit: Lit, paths: Paths) -> Float[Array, "ray node"]:
    """Radiance at the entrance pupil along each path, equations (2) and (3) with (4) and (5) in front.

        L = atmosphere's transmittance * [plume in front of (skin, or background where no skin is met)] + path radiance

    Args:
        lit: the scene on the nodes, `scene.on(nodes)`.
        paths: `trace(scene, rays, method, key)`; they carry the method.

    Returns:
        Radiance [ray, node] [W m-2 sr-1], integrated over each node's bin.

    Differentiable, in both modes, in every radiometric leaf of the scene, without bias: directions keep the density
    with which they were drawn and the brdf in front of it carries the derivative. Not in the scene's geometry,
    but for the place and shape of a jet.
    """
    return evaluate_orders(lit, paths).radiance


def evaluate_orders(lit: Lit, paths: Paths) -> Orders:
    """`evaluate`, with what the last two orders of scattering brought [ray, node]."""
    return _orders(with_scattered(lit, paths.method), paths)


@program
def _orders(lit: Lit, paths: Paths) -> Orders:
    found = _along_paths(lit, paths)
    return Orders(lit.through_air(found.radiance), lit.dimmed_by_air(found.last), lit.dimmed_by_air(found.before))


def radiance_before_air(lit: Lit, paths: Paths) -> Float[Array, "ray node"]:
    """`evaluate` without the air [ray, node], of a scene that is ready, see `with_scattered`."""
    return _along_paths(lit, paths).radiance


def bounced(lit: Lit, paths: Paths, least: int) -> Float[Array, "bounce ray node"]:
    """What paths bring after `least`, least + 1, ... `Method.bounces` reflections each [bounce, ray, node]."""
    lit = with_scattered(lit, paths.method)
    dark = jnp.zeros((paths.method.bounces + 1 - least, paths.length.shape[0], lit.nodes.count), paths.length.dtype)
    asked = jnp.arange(least, paths.method.bounces + 1, dtype=jnp.int32)

    def added(sums: Array, part: Array, segment: Segment, index: Array, _: int) -> Array:
        before = (
            index if segment.scattering is None else index - segment.scattering.before
        )  # they go on from one of both
        return sums + jnp.where((asked[:, None] == before)[..., None], part, 0)

    return lit.dimmed_by_air(_summed(lit, paths, dark, added))


def _along_paths(lit: Lit, paths: Paths) -> Orders:
    """Radiance along paths, before the air."""
    method = paths.method
    dark = jnp.zeros((paths.length.shape[0], lit.nodes.count), paths.length.dtype)
    if method.segments() == 1:
        through = Through(lit)
        passed = transmittance(paths, paths.first, through)
        radiance = brings(lit, paths, paths.first, True, True, passed, through)()
        return Orders(radiance, radiance if method.samples_particles(lit.scene) else dark, dark)

    def added(sums: Orders, part: Array, segment: Segment, index: Array, more: int) -> Orders:
        if segment.scattering is None:
            return sums._replace(radiance=sums.radiance + part)
        order = segment.scattering.before + more
        last, one_less = (jnp.where((order == method.orders - less)[:, None], part, 0) for less in (0, 1))
        return Orders(sums.radiance + part, sums.last + last, sums.before + one_less)

    return _summed(lit, paths, Orders(dark, dark, dark), added)


def _summed(lit: Lit, paths: Paths, sums: T, added: Callable[[T, Array, Segment, Array, int], T]) -> T:
    """Sums over the segments of paths of what each brings, which `added` adds to them.

    It is told how often that was scattered beside what paths were before the segment: direct light at a particle, once.
    """
    method, count = paths.method, paths.method.segments()
    one = jnp.ones((paths.length.shape[0], lit.nodes.count), paths.length.dtype)

    def step(state: tuple[T, Array], own: tuple[Segment, Array]) -> tuple[tuple[T, Array], None]:
        ended = ~jnp.any(own[0].length > 0)  # which costs nothing where all paths have
        return lax.cond(ended, lambda state, _: state, follow, state, own), None

    def follow(state: tuple[T, Array], own: tuple[Segment, Array]) -> tuple[T, Array]:
        (sums, throughput), (segment, index) = state, own
        at, through = segment.scattering, Through(lit)
        whole = transmittance(paths, segment, through)
        brought = brings(lit, paths, segment, index == 0, index == count - 1, whole, through)
        going_on = event(segment, whole, through)
        straight = None if at is None else direct_at_particles(lit, method, segment, at, through)
        passed, beside = going_on()
        sums = added(sums, throughput * brought(), segment, index, 0)
        if at is not None and straight is not None:
            direct = straight()
            if method.scattering is not None:
                direct = direct - expected_at_particles(lit, segment, at)
            sums = added(sums, throughput * beside * direct, segment, index, 1)
        return sums, in_kernels(throughput * onward(lit, segment, passed, beside))

    return lax.scan(step, (sums, one), (paths.segments, jnp.arange(count, dtype=jnp.int32)))[0][0]
