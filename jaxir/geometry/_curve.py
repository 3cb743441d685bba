"""A curve that fills a square: what is near along it is near in the plane."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Int


def hilbert_index(x: Int[Array, "*batch"], y: Int[Array, "*batch"], bits: int) -> Int[Array, "*batch"]:
    """Place along Hilbert's curve of the cells of a raster of 2^bits by 2^bits.

    Cells next to each other along the curve share an edge, and d^2 <= 6 n between cells n places apart (Gotsman and
    Lindenbaum, "On the metric properties of discrete space-filling curves", IEEE Trans. Image Process. 5(5), 1996). A
    systematic sample along the curve is therefore even in the plane.

    Args:
        x: column, in [0, 2^bits).
        y: row, in [0, 2^bits).
        bits: at most 15.

    Returns:
        Place, in [0, 4^bits); the curve begins in cell (0, 0) and ends in (2^bits - 1, 0).
    """
    place = jnp.zeros_like(x)
    for level in reversed(range(bits)):
        right, up = (x >> level) & 1, (y >> level) & 1
        place = 4 * place + 2 * right + (right ^ up)
        turned, mirrored = up == 0, (up == 0) & (right == 1)  # both lower quarters lie on their side
        x, y = jnp.where(turned, y, x), jnp.where(turned, x, y)
        x, y = jnp.where(mirrored, ~x, x), jnp.where(mirrored, ~y, y)
    return place
