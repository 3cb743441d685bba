"""Functions of direction: real spherical harmonics, and a rule that integrates them over the sphere."""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxir._math import gauss_legendre


def harmonics(direction: Float[Array, "*batch 3"], order: int) -> Float[Array, "*batch harmonic"]:
    """Real spherical harmonics Y_lm of unit vectors, orthonormal over the sphere, for l = 0 .. `order`.

    Degrees follow one another, each with m = -l .. l. Polynomials in x, y, z, so that no direction is singular.
    Differentiable in `direction`.
    """
    x, y, z = direction[..., 0], direction[..., 1], direction[..., 2]
    cosine, sine = [jnp.ones_like(x)], [jnp.zeros_like(x)]  # of m azimuth, times the sine of the polar angle to the m
    for m in range(order):
        cosine.append(cosine[m] * x - sine[m] * y)
        sine.append(cosine[m] * y + sine[m] * x)
    found = {}
    for m in range(order + 1):
        legendre = {m - 1: jnp.zeros_like(z), m: jnp.full_like(z, math.prod(range(1, 2 * m, 2)))}
        for degree in range(m + 1, order + 1):
            above = (2 * degree - 1) * z * legendre[degree - 1] - (degree + m - 1) * legendre[degree - 2]
            legendre[degree] = above / (degree - m)
        for degree in range(m, order + 1):
            ratio = math.factorial(degree - m) / math.factorial(degree + m)
            scale = math.sqrt((2 if m else 1) * (2 * degree + 1) / (4 * math.pi) * ratio)
            found[degree, m] = scale * legendre[degree] * cosine[m]
            if m:
                found[degree, -m] = scale * legendre[degree] * sine[m]
    return jnp.stack([found[degree, m] for degree in range(order + 1) for m in range(-degree, degree + 1)], axis=-1)


def degrees(order: int) -> np.ndarray:
    """The degree l of every harmonic [harmonic]."""
    return np.concatenate([np.full(2 * degree + 1, degree) for degree in range(order + 1)])


def rule_size(degree: int) -> int:
    """How many directions `sphere_rule` has."""
    return 2 * (degree // 2 + 1) * _azimuths(degree)


def sphere_rule(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions [direction, 3] and weights [direction] [sr] of an integral over the sphere.

    Gauss-Legendre in the cosine of the polar angle, on either side of 0 by itself, so that light may differ between
    above and below as that at a flat body's surface does; times equal steps of azimuth, alike in all quarters and off
    the planes between them, along which the sides of cells may lie. Exact for harmonics up to `degree`.
    """
    share, weight = gauss_legendre(degree // 2 + 1)
    cosine, weight = np.concatenate([-share[::-1], share]), np.concatenate([weight[::-1], weight])
    count = _azimuths(degree)
    azimuth = (np.arange(count) + 0.5) * 2 * np.pi / count
    sine = np.sqrt(1 - cosine**2)
    z = np.broadcast_to(cosine[:, None], (len(cosine), count))
    direction = np.stack([sine[:, None] * np.cos(azimuth), sine[:, None] * np.sin(azimuth), z], axis=-1)
    return direction.reshape(-1, 3), np.repeat(weight * 2 * np.pi / count, count)


def _azimuths(degree: int) -> int:
    """Steps of azimuth: more than degree, and as many in each quarter."""
    return 4 * (degree // 4 + 1)
