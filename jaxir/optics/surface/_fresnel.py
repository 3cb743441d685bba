"""Reflection at a smooth interface between vacuum and an absorbing medium."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._math import safe_divide, safe_sqrt


def conductor_absorptance(
    cos: Float[Array, "*batch"], index: Float[Array, "*batch"], extinction: Float[Array, "*batch"]
) -> Float[Array, "*batch"]:
    """1 - R of unpolarised light at a medium of complex refractive index m = n - i k.

    With s2 = sin^2, D = n^2 - k^2 - s2, w = |m^2 - s2| = sqrt(D^2 + 4 n^2 k^2), a = sqrt((w + D) / 2) and c = cos,

        1 - R_s = 4 a c / (w + c^2 + 2 a c),
        R_p = R_s (1 - x),   x = 4 a c s2 / (c^2 w + s2^2 + 2 a c s2),   1 - R_p = (1 - R_s) + R_s x

    (Born and Wolf, "Principles of Optics", 14.2, solved for what is absorbed): no difference of two nearly equal
    reflectances is taken, so an emissivity of 1e-2 has all the digits of float32. Where D < 0 (metals in the infrared)
    a = n k sqrt(2 / (w - D)) avoids the cancellation in w + D.

    Args:
        cos: cosine of the angle of incidence in [0, 1].
        index: n > 0.
        extinction: k >= 0.

    Returns:
        Absorbed fraction; tends to 0 at grazing incidence.

    Differentiable in all three, except at total reflection's onset (n < 1, k = 0).
    """
    square = 1 - cos * cos
    a, modulus, _, _ = _refracted(cos, index, extinction)
    slope = 2 * a * cos
    across = modulus + cos * cos
    absorbed_s = safe_divide(2 * slope, across + slope)
    along = cos * cos * modulus + square * square
    tilt = slope * square
    ratio = safe_divide(2 * tilt, along + tilt)
    absorbed_p = absorbed_s + (1 - absorbed_s) * ratio
    return (absorbed_s + absorbed_p) / 2


def conductor_reflectance(
    cos: Float[Array, "*batch"], index: Float[Array, "*batch"], extinction: Float[Array, "*batch"]
) -> Float[Array, "*batch"]:
    """R of unpolarised light at the same medium, never below 0 and with all its digits where next to nothing reflects.

    With a, w and D of `conductor_absorptance` and b = n k / a,

        R_s = ((a - c)^2 + b^2) / (w + c^2 + 2 a c),     a - c = ((n - 1)(n + 1) - k^2 + b^2) / (a + c),
        R_p = R_s ((a c - s2)^2 + b^2 c^2) / (c^2 w + s2^2 + 2 a c s2)

    Arguments and derivatives as there.
    """
    square = 1 - cos * cos
    a, modulus, excess, b2 = _refracted(cos, index, extinction)
    slope = 2 * a * cos
    step = safe_divide(excess + b2, a + cos)
    r_s = safe_divide(step * step + b2, modulus + cos * cos + slope)
    tilt = a * cos - square
    along = cos * cos * modulus + square * square
    ratio = safe_divide(tilt * tilt + b2 * cos * cos, along + slope * square)
    return r_s * (1 + ratio) / 2


def _refracted(cos: Array, index: Array, extinction: Array) -> tuple[Array, Array, Array, Array]:
    """a, w, (n - 1)(n + 1) - k^2 and b^2 of `conductor_reflectance`."""
    excess = (index - 1) * (index + 1) - extinction * extinction  # exact where the medium is nearly vacuum
    real = excess + cos * cos
    product = 2 * index * extinction
    modulus = safe_sqrt(real * real + product * product)
    dense = real >= 0
    spread = jnp.where(dense, modulus + real, modulus - real)
    other = safe_divide(product * product, spread)
    twice, drop = jnp.where(dense, spread, other), jnp.where(dense, other, spread)
    return safe_sqrt(twice / 2), modulus, excess, drop / 2
