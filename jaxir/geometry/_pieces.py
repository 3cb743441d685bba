"""Boxes that cover a body, each with a power: directions towards them, and the density with which these are drawn.

From a point a box is drawn by what it would send there if it were thin, and a point uniform in its volume. What counts
is the direction alone, so its density is a sum over all boxes,

    pdf(omega) = sum_i P_i / V_i integral t^2 dt over the chord through box i,

exactly. Far away it is proportional to the emission of a thin body along omega, if the boxes resolve it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxir._math import matmul, safe_divide
from jaxir.geometry._box import box_chord, pdf_box, pdf_from_volume, sample_box

EVEN = 0.05  # of the draws, for pieces that emit more than their power tells


class Pieces(NamedTuple):
    """Boxes that cover a body.

    Attributes:
        frame: directions of their edges, rows [3, 3].
        centre: along the frame [3, piece] [m].
        half: half edges [3, piece] [m].
        power: proportional to what each emits, about [piece].
    """

    frame: Float[Array, "3 3"]
    centre: Float[Array, "3 piece"]
    half: Float[Array, "3 piece"]
    power: Float[Array, " piece"]

    def turned_to(self, frame: Float[Array, "3 3"]) -> Pieces:
        """Boxes along another frame that hold these, with the same power each."""
        turn = matmul(frame, self.frame.T)
        return Pieces(frame, matmul(turn, self.centre), matmul(jnp.abs(turn), self.half), self.power)


class Sight(NamedTuple):
    """Pieces seen from one point.

    Attributes:
        offset: of their centres, along the frame [3, piece] [m].
        chance: with which each is drawn [piece]; 0 for all where none is above the horizon.
    """

    offset: Float[Array, "3 piece"]
    chance: Float[Array, " piece"]


def sight_of(pieces: Pieces, point: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Sight:
    """Draw pieces by what they send to a surface, about: power * cos / distance^2, cos that of the highest point.

    One draw in 20 is even among the pieces above the horizon, whatever their power.
    """
    offset = pieces.centre - matmul(pieces.frame, point)[:, None]
    up = matmul(pieces.frame, normal)[:, None]
    height = jnp.maximum(jnp.sum(offset * up + pieces.half * jnp.abs(up), axis=0), 0)
    square = jnp.maximum(jnp.sum(offset**2, axis=0), jnp.sum(pieces.half**2, axis=0))
    sent = pieces.power * height / (square * jnp.sqrt(square))
    above = (height > 0).astype(sent.dtype)
    return Sight(offset, (1 - EVEN) * _shares(sent) + EVEN * _shares(above))


def _shares(weight: Float[Array, " piece"]) -> Float[Array, " piece"]:
    return safe_divide(weight, jnp.broadcast_to(jnp.sum(weight), weight.shape))


def sample_pieces(
    pieces: Pieces, sight: Sight, draw: Callable[[int], Float[Array, "count 2"]]
) -> Float[Array, "count 3"]:
    """Unit vectors towards points drawn in the pieces [count, 3]; `draw` gives the numbers of decisions 0 and 1."""
    first, second = draw(0), draw(1)
    number = sight.chance.shape[0]
    up_to_each = np.triu(np.ones((number, number), sight.chance.dtype))
    upto = matmul(sight.chance, up_to_each)  # a sum over few is no scan's work
    chosen = jnp.minimum(jnp.sum((first[:, :1] >= upto[None]).astype(jnp.int32), axis=-1), number - 1)
    u = jnp.concatenate([first[:, 1:], second], axis=-1)
    offset = matmul(sight.offset.T[chosen] + jax.vmap(sample_box)(u, pieces.half.T[chosen]), pieces.frame)
    square = jnp.sum(offset * offset, axis=-1, keepdims=True)
    return offset * lax.rsqrt(jnp.where(square > 0, square, 1))


def pdf_pieces(pieces: Pieces, sight: Sight, omega: Float[Array, " 3"]) -> Float[Array, ""]:
    """Density [] [sr-1] of `sample_pieces` for a direction."""
    near, far = box_chord(sight.offset, pieces.half, matmul(pieces.frame, omega))
    return jnp.sum(pdf_from_volume(sight.chance * pdf_box(pieces.half), near, far))
