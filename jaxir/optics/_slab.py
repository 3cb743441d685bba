"""Emission and transmission of one homogeneous layer, accurate from no optical depth to 1e30.

A layer of extinction mu [m-1], emission j [W m-3 sr-1] (absorption times source) and length l [m] in front of the
radiance R turns it into

    R' = exp(-u) R + l phi1(u) j,    u = mu l,    phi1(u) = (1 - exp(-u)) / u,

the solution of the equation of transfer dR/ds = j - mu R (Modest, Radiative Heat Transfer, ch. 10). Written with j
rather than j / mu nothing is divided by the extinction, so a layer that does not absorb has a value and a gradient.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

SERIES_BELOW = 0.5  # optical depth under which the power series are used


def _series(u: Array, first: int) -> Array:
    """sum_k (-u)^k / (k + first)! for u < SERIES_BELOW, truncated below the rounding of u's dtype."""
    terms = 9 if u.dtype == jnp.float32 else 16
    total = jnp.full_like(u, 1 / math.factorial(terms + first))
    for k in range(terms - 1, -1, -1):
        total = 1 / math.factorial(k + first) - u * total
    return total


def phi1(u: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """(1 - exp(-u)) / u: the mean transmittance over a layer, 1 at u = 0.

    Args:
        u: optical depth >= 0 [*batch].

    Returns:
        [*batch], relative error below 4 units of the last place.

    Differentiable in `u`.
    """
    thin = u < SERIES_BELOW
    large = jnp.where(thin, 1, u)
    return jnp.where(thin, _series(jnp.where(thin, u, 0), 1), (1 - jnp.exp(-large)) / large)


def phi2(u: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """(1 - phi1(u)) / u, 1/2 at u = 0; the derivative of phi1 is phi2 - phi1.

    Args:
        u: optical depth >= 0 [*batch].

    Returns:
        [*batch], relative error below 8 units of the last place.

    Differentiable in `u`.
    """
    thin = u < SERIES_BELOW
    large = jnp.where(thin, 1, u)
    return jnp.where(thin, _series(jnp.where(thin, u, 0), 2), (1 - (1 - jnp.exp(-large)) / large) / large)


def thinning(u: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """-d phi1 / du = phi1 - phi2 = (1 - (1 + u) exp(-u)) / u^2, 1/2 at u = 0; a difference that loses no digits.

    Args:
        u: optical depth >= 0 [*batch].

    Returns:
        [*batch].

    Differentiable in `u`.
    """
    thin = u < SERIES_BELOW
    small, large = jnp.where(thin, u, 0), jnp.where(thin, 1, u)
    terms = 9 if u.dtype == jnp.float32 else 16
    total = jnp.full_like(u, (terms + 1) / math.factorial(terms + 2))
    for k in range(terms - 1, -1, -1):
        total = (k + 1) / math.factorial(k + 2) - small * total
    # One division at the end: XLA's CPU backend repeats all that follows the last one for each use of a value.
    return jnp.where(thin, total, (1 - jnp.exp(-large)) / large - jnp.exp(-large)) / large


def attenuate(radiance: Float[Array, "*batch"], u: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """exp(-u) times `radiance`, without drift over many thin layers and without cancellation in thick ones.

    exp(-u) is next to 1 in a thin layer and its rounding is one-sided there; R - (1 - exp(-u)) R is not, but loses
    all digits in a thick one.

    Args:
        radiance: R [*batch].
        u: optical depth >= 0 [*batch].

    Returns:
        [*batch].

    Differentiable in both.
    """
    return jnp.where(u < SERIES_BELOW, radiance - (u * phi1(u)) * radiance, jnp.exp(-u) * radiance)


def across_layer(
    behind: Float[Array, "*batch"],
    extinction: Float[Array, "*batch"],
    emission: Float[Array, "*batch"],
    length: Float[Array, "*batch"],
) -> Float[Array, "*batch"]:
    """The value of `through_layer`, in the fewest operations: one exponential, one division, one selection.

    Two whole formulas and a selection between them compile to twice the speed of selections inside one formula.

    Not differentiable: what is selected away may have no finite derivative.
    """
    u = extinction * length
    passed = jnp.exp(-u)
    thin = behind + length * _series(jnp.minimum(u, SERIES_BELOW), 1) * (emission - extinction * behind)
    thick = passed * behind + (1 - passed) / jnp.maximum(extinction, 1e-37) * emission
    return jnp.where(u < SERIES_BELOW, thin, thick)


@jax.custom_jvp
def through_layer(
    behind: Float[Array, "*batch"],
    extinction: Float[Array, "*batch"],
    emission: Float[Array, "*batch"],
    length: Float[Array, "*batch"],
) -> Float[Array, "*batch"]:
    """Radiance in front of a homogeneous layer: exp(-u) R + l phi1(u) j.

    Args:
        behind: radiance behind the layer R [*batch] [W m-2 sr-1].
        extinction: mu [*batch] [m-1], >= 0.
        emission: absorption times source j [*batch] [W m-3 sr-1].
        length: l [*batch] [m], >= 0.

    Returns:
        Radiance [*batch] [W m-2 sr-1].

    Differentiable in all arguments, forward and reverse, to any order.
    """
    return across_layer(behind, extinction, emission, length)


def _through_layer_jvp(primals, tangents):
    """dR' = exp(-u) dR + l phi1 dj - l (exp(-u) R + l thinning j) dmu + exp(-u) (j - mu R) dl: nothing cancels.

    Its factors are computed once for all tangents; a compiler left alone repeats them for each.
    """
    behind, extinction, emission, length = primals
    u = extinction * length
    thin, mean, passed = u < SERIES_BELOW, phi1(u), jnp.exp(-u)
    kept, lost = jnp.where(thin, 1, passed), jnp.where(thin, u * mean, 0)  # as in `attenuate`
    by_extinction = -length * (attenuate(behind, u) + length * thinning(u) * emission)
    factors = kept, lost, by_extinction, length * mean, passed * (emission - extinction * behind)
    kept, lost, *others = lax.optimization_barrier(factors)
    change = jnp.zeros_like(behind)
    if not isinstance(tangents[0], SymbolicZero):
        change = kept * tangents[0] - lost * tangents[0]
    for factor, tangent in zip(others, tangents[1:], strict=True):
        if not isinstance(tangent, SymbolicZero):
            change = change + factor * tangent
    return through_layer(behind, extinction, emission, length), change


through_layer.defjvp(_through_layer_jvp, symbolic_zeros=True)
