"""How well directions that were drawn for one scene serve another."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir.scene.scene import Scene
from jaxir.transport.around import Vertex
from jaxir.transport.paths import Paths
from jaxir.transport.reflection import Reflection, reflection_of


def density_ratio(
    paths: Paths, reflection: Reflection | None, drawn_for: Scene, scene: Scene
) -> Float[Array, " direction"]:
    """Density under one brdf over that under the brdf which drew them, for the directions of traced paths.

    Directions drawn from lights keep their density whatever the brdf, and are not listed.

    Args:
        paths: traced with `reflection` in `drawn_for`.
        reflection: how.
        drawn_for: the scene that was traced.
        scene: another one of the same geometry.

    Returns:
        The ratio, 0 where a direction found nothing [direction]; no direction where none was drawn from the brdf.

    Not to be differentiated.
    """
    reflection = reflection_of(drawn_for, reflection)
    if reflection is not None and paths.chain is not None:
        leg = paths.chain.leg
        each = jax.vmap(lambda v, w, f: _ratio(drawn_for, scene, v, w, f))(paths.chain.vertex, leg.omega, leg.factor)
        return each.reshape(-1)
    if reflection is None or paths.around is None:
        return jnp.zeros(0, paths.rays.origin.dtype)
    first, vertex = reflection.direct.counts()[0], paths.vertex()
    omega, factor = paths.around.omega[:, first:], paths.around.factor[:, first:]
    of_sample = jax.vmap(lambda w, f: _ratio(drawn_for, scene, vertex, w, f))
    return jax.vmap(of_sample)(omega, factor).reshape(-1)


def _ratio(drawn_for: Scene, scene: Scene, vertex: Vertex, omega: Array, factor: Array) -> Array:
    """[ray]."""

    def density(of: Scene) -> Array:
        assert of.skin is not None
        brdf = of.skin.brdf.at(jnp.maximum(vertex.face, 0))
        return jax.vmap(lambda b, i, o, n: b.pdf(i, o, n))(brdf, omega, vertex.omega_o, vertex.normal)

    before = density(drawn_for)
    drawn = (factor > 0) & (before > 0)
    return jnp.where(drawn, density(scene) / jnp.where(drawn, before, 1), 0)


def effective_share(ratio: Float[Array, " direction"]) -> Float[Array, ""]:
    """Kish's effective number of samples over their number, (sum w)^2 / (n sum w^2), of density ratios w > 0.

    An estimate from directions drawn for another brdf has no bias, but its variance grows as the share falls.
    1 where there is no direction.
    """
    count, total, square = jnp.sum(ratio > 0), jnp.sum(ratio), jnp.sum(ratio * ratio)
    some = square > 0
    return jnp.where(some, total * total / jnp.where(some, count.astype(ratio.dtype) * square, 1), 1)
