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
    product = 2 * index * extinction
    real = (index - extinction) * (index + extinction) - square
    modulus = safe_sqrt(real * real + product * product)
    dense = real >= 0
    spread = jnp.where(dense, modulus + real, modulus - real)
    twice = jnp.where(dense, spread, safe_divide(product * product, spread))
    slope = cos * safe_sqrt(2 * twice)  # 2 a cos
    across = modulus + cos * cos
    absorbed_s = safe_divide(2 * slope, across + slope)
    along = cos * cos * modulus + square * square
    tilt = slope * square
    ratio = safe_divide(2 * tilt, along + tilt)
    absorbed_p = absorbed_s + (1 - absorbed_s) * ratio
    return (absorbed_s + absorbed_p) / 2
