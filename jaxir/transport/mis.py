"""How two ways of finding the same light share it."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float


def mis_weight(
    count: int, pdf: Float[Array, "*batch"], other_count: int, other_pdf: Float[Array, "*batch"]
) -> Float[Array, "*batch"]:
    """Quadratic heuristic (9): (n p)^2 / ((n p)^2 + (n' p')^2) for one of n samples drawn with density p.

    Veach and Guibas, "Optimally combining sampling techniques for Monte Carlo rendering" (SIGGRAPH 1995). The larger
    of the two is divided out first, so neither square overflows.

    Args:
        count: n, samples of this way.
        pdf: p, its density [sr-1].
        other_count: n', samples of the other way.
        other_pdf: p', the density the other way has for the same direction [sr-1].

    Returns:
        Weight in [0, 1]; 0 where both densities are 0.
    """
    mine, other = count * pdf, other_count * other_pdf
    larger = jnp.maximum(mine, other)
    scale = jnp.where(larger > 0, larger, 1)
    a, b = (mine / scale) ** 2, (other / scale) ** 2
    return jnp.where(larger > 0, a / jnp.where(larger > 0, a + b, 1), 0)
