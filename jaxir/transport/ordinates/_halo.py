"""Light of a beam that is scattered forward more than once: the halo about a source seen through particles.

On the lattice the share f of a lobe is taken as not scattered, so that a beam is as bright at depth t of such
scattering as if it had met nothing. Scattered once with the whole lobe p (Nakajima and Tanaka, JQSRT 40, 1988) all of
it seems to come from one direction; in truth it has been spread. With P the lobe of what is scattered forward, of
moments c_l, which are 1 up to the harmonics' degree, light straight from the source is, where angles are small, spread
to

    sum_k exp(-t) t^k / k! P^k*        (k-fold convolutions; exp(t (c_l - 1)) in moments),

and as it goes on by dt it sends, in place of f P, what that grows by: f G(t) of moments

    G_l = (c_l - 1) exp(t (c_l - 1)) + exp(-t),        G_l(0) = c_l.

To first order in t the change is -t (2 P - P^2*), the second correction of Nakajima and Tanaka. Without it the sun seen
through particles is too bright, by 9 and 30 % at depths of .3 and 1 where g is .8 and the harmonics' degree 3, by 22
and 91 % where g is .95; with it these four err by .2 to 1 %. Far aside the lobe is smooth where light has spread, and
once scattered by all of it is right to some per cent; G would be wrong by a third, so the change ends at `WIDEST`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxir._arrays import as_float
from jaxir._math import INSIDE, einsum

DEGREE = 384  # of the moments: lobes down to a degree
ANGLES = 128  # at which it is tabulated, crowded where light goes straight on
WIDEST = 40.0  # [deg] to which the change fades out, smoothly
POWERS = 7  # Chebyshev polynomials of the depth


class Halo(NamedTuple):
    """f (G(t) - P), what the lobe changes by at a depth t of forward scattering.

    Attributes:
        table: coefficients of Chebyshev polynomials of t / deepest, from 0 to 1 [angle, power, node] [sr-1].
        deepest: the largest t [node].
    """

    table: Float[Array, "angle power node"]
    deepest: Float[Array, " node"]

    def change(self, cosine: Float[Array, " ray"], depth: Float[Array, "ray node"]) -> Float[Array, "ray node"]:
        """At cosines of the angle to straight on, and depths. Differentiable in both, and in what made the table."""
        away = (1 - cosine) / 2
        place = lax.stop_gradient(jnp.clip(away, 0, 1) ** 0.25 * (ANGLES - 1))
        low = jnp.clip(place.astype(jnp.int32), 0, ANGLES - 2)
        begin, end = (as_float(_away())[low + side] for side in (0, 1))
        share = ((away - begin) / (end - begin))[:, None, None]
        own = self.table.at[low].get(**INSIDE) * (1 - share) + self.table.at[low + 1].get(**INSIDE) * share
        x = 2 * depth / jnp.where(self.deepest > 0, self.deepest, 1)[None] - 1
        before, now, total = jnp.ones_like(x), x, own[:, 0] + own[:, 1] * x
        for k in range(2, POWERS):
            before, now = now, 2 * x * now - before
            total = total + own[:, k] * now
        return total


def halo(chi: Float[Array, "degree node"], forward: Float[Array, " node"], order: int, deepest: Array) -> Halo:
    """The halo of a lobe of moments `chi` up to `DEGREE`, of which the share `forward` is taken as not scattered.

    Args:
        chi: Legendre moments.
        forward: f.
        order: highest degree of the harmonics.
        deepest: largest depth of forward scattering [node].
    """
    some = forward > 1e-4  # else next to nothing
    share = chi / jnp.where(some, forward, 1)[None]
    degree = np.arange(DEGREE + 1)
    c = jnp.where(as_float(degree)[:, None] <= order, 1, jnp.clip(share, -1, 1))[None]
    place = np.cos(np.pi * np.arange(POWERS) / (POWERS - 1))
    t = as_float((place + 1) / 2)[:, None, None] * deepest[None, None]
    change = (c - 1) * jnp.exp(t * (c - 1)) + jnp.exp(-t) - c
    legendre = np.polynomial.legendre.legvander(1 - 2 * _away(), DEGREE) * (2 * degree + 1) / (4 * np.pi)
    at_depths = einsum("al,tln->atn", as_float(legendre), change)
    to_powers = np.linalg.inv(np.polynomial.chebyshev.chebvander(place, POWERS - 1))
    table = einsum("pt,atn->apn", as_float(to_powers), at_depths)
    near = np.clip(1 - 2 * _away() / (1 - np.cos(np.deg2rad(WIDEST))), 0, 1)
    fading = as_float(near**2 * (3 - 2 * near))[:, None, None]
    return Halo(table * fading * jnp.where(some, forward, 0)[None, None], deepest)


def _away() -> np.ndarray:
    """(1 - cosine) / 2 of the angles of the table."""
    return (np.arange(ANGLES) / (ANGLES - 1)) ** 4
