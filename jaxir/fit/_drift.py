"""How well directions that were drawn for one scene serve another."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir.scene import Scene
from jaxir.transport import Paths, Vertex


def density_ratio(paths: Paths, drawn_for: Scene, scene: Scene) -> Float[Array, " direction"]:
    """Density under one brdf over that under the brdf which drew them, for the directions of traced paths.

    Directions drawn from lights or by particles keep their density whatever the brdf, and are not listed.

    Args:
        paths: traced in `drawn_for`.
        drawn_for: the scene that was traced.
        scene: another one of the same geometry.

    Returns:
        The ratio, 0 where a direction found nothing [direction]; no direction where none was drawn from the brdf.

    Not to be differentiated.
    """
    segments, vertex = paths.segments, paths.segments.vertex
    if vertex is None:
        return jnp.zeros(0, paths.length.dtype)
    if segments.omega is not None and segments.inverse_pdf is not None:
        drawn = segments.inverse_pdf > 0
        if segments.scattering is not None:
            drawn = drawn & (segments.scattering.inverse_pdf == 0)
        return jax.vmap(partial(_ratio, drawn_for, scene))(vertex, segments.omega, drawn).reshape(-1)
    first, ratios = paths.method.counts[0], [jnp.zeros(0, paths.length.dtype)]
    at = jax.tree.map(lambda leaf: leaf[0], vertex)
    for samples in at.lights:
        of_sample = jax.vmap(lambda w, d: _ratio(drawn_for, scene, at, w, d))
        ratios.append(of_sample(samples.omega[first:], samples.weight[first:] > 0).reshape(-1))
    return jnp.concatenate(ratios)


def _ratio(drawn_for: Scene, scene: Scene, vertex: Vertex, omega: Array, drawn: Array) -> Array:
    """[ray]."""

    def density(of: Scene) -> Array:
        assert of.skin is not None
        brdf = of.skin.brdf.at(jnp.maximum(vertex.face, 0))
        return jax.vmap(lambda b, i, o, n: b.pdf(i, o, n))(brdf, omega, vertex.omega_o, vertex.normal)

    before = density(drawn_for)
    good = drawn & (vertex.face >= 0) & (before > 0)
    return jnp.where(good, density(scene) / jnp.where(good, before, 1), 0)


def effective_share(ratio: Float[Array, " direction"]) -> Float[Array, ""]:
    """Kish's effective number of samples over their number, (sum w)^2 / (n sum w^2), of density ratios w > 0.

    An estimate from directions drawn for another brdf has no bias, but its variance grows as the share falls.
    1 where there is no direction.
    """
    count, total, square = jnp.sum(ratio > 0), jnp.sum(ratio), jnp.sum(ratio * ratio)
    some = square > 0
    return jnp.where(some, total * total / jnp.where(some, count.astype(ratio.dtype) * square, 1), 1)
