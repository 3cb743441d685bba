"""Random points and directions: every `sample_x` has a twin `pdf_x`, and one object decides how even they are.

A sampler gives the uniform numbers of one decision (which point of a light, which direction of a bounce) for all
`count` samples of one estimate, as [count, 2]. Decisions take different keys and are mutually independent; within one
decision the points of the even samplers repel one another.
"""

from __future__ import annotations

import abc
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Key, UInt32

from jaxir._arrays import as_one_program, float_dtype
from jaxir._math import dot, frame_around, matmul, safe_sqrt

# Directions -----------------------------------------------------------------------------------------------------------


def sample_hemisphere(u: Float[Array, " 2"], normal: Float[Array, " 3"]) -> Float[Array, " 3"]:
    """A direction [3] uniform in solid angle on the side of `normal`, from two numbers uniform in [0, 1)."""
    return turned(1 - u[0], u[1], normal)


def pdf_hemisphere(omega: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Float[Array, ""]:
    """Density of `sample_hemisphere`: 1 / (2 pi) above, 0 below [sr-1]."""
    return jnp.where(dot(omega, normal) > 0, 1 / (2 * jnp.pi), 0)


def sample_cap(u: Float[Array, " 2"], axis: Float[Array, " 3"], drop: Float[Array, ""]) -> Float[Array, " 3"]:
    """A direction uniform in the cap about `axis`.

    Args:
        u: uniform numbers [2].
        axis: unit vector [3].
        drop: 1 - cos of the cap's half angle, in [0, 2]; given so because a small cap would lose its digits in cos.

    Returns:
        Unit vector [3].

    Differentiable in axis and drop.
    """
    return turned(1 - u[0] * drop, u[1], axis)


def pdf_cap(omega: Float[Array, " 3"], axis: Float[Array, " 3"], drop: Float[Array, ""]) -> Float[Array, ""]:
    """Density of `sample_cap`: 1 / (2 pi drop) inside, 0 outside [sr-1]."""
    apart = omega - axis
    inside = (dot(apart, apart) / 2 <= drop) & (drop > 0)
    return jnp.where(inside, 1 / (2 * jnp.pi * jnp.where(drop > 0, drop, 1)), 0)


def sphere_drop(point: Float[Array, " 3"], centre: Float[Array, " 3"], radius: Float[Array, ""]) -> Float[Array, ""]:
    """1 - cos of the half angle under which a sphere is seen; 2 from inside, where it is everywhere.

    With s = radius / distance, 1 - sqrt(1 - s^2) = s^2 / (1 + sqrt(1 - s^2)). Differentiable in all three.
    """
    offset = centre - point
    square = dot(offset, offset)
    outside = square > radius * radius
    ratio = jnp.where(outside, radius * radius / jnp.where(outside, square, 1), 0)
    return jnp.where(outside, ratio / (1 + jnp.sqrt(1 - ratio)), 2)


def turned(cos: Float[Array, ""], turn: Float[Array, ""], axis: Float[Array, " 3"]) -> Float[Array, " 3"]:
    """The direction [3] whose angle with the axis has the cosine `cos`, `turn` of a full turn around it."""
    square = (1 - cos) * (1 + cos)
    sine = safe_sqrt(square)
    angle = 2 * jnp.pi * turn
    return matmul(jnp.stack([sine * jnp.cos(angle), sine * jnp.sin(angle), cos]), frame_around(axis))


# Points of surfaces -----------------------------------------------------------------------------------------------


def sample_disc(
    u: Float[Array, " 2"], centre: Float[Array, " 3"], normal: Float[Array, " 3"], radius: Float[Array, ""]
) -> Float[Array, " 3"]:
    """A point uniform in area on a disc [3] [m].

    Shirley and Chiu, "A low distortion map between disk and square" (1997): neighbours in the square stay neighbours
    on the disc, so even points stay even. Differentiable in centre and radius.
    """
    a, b = 2 * u[0] - 1, 2 * u[1] - 1
    wide = jnp.abs(a) > jnp.abs(b)
    r = jnp.where(wide, a, b)
    ratio = jnp.where(wide, b, a) / jnp.where(r != 0, r, 1)
    angle = jnp.where(wide, jnp.pi / 4 * ratio, jnp.pi / 2 - jnp.pi / 4 * ratio)
    frame = frame_around(normal)
    return centre + radius * r * (jnp.cos(angle) * frame[0] + jnp.sin(angle) * frame[1])


def pdf_disc(radius: Float[Array, ""]) -> Float[Array, ""]:
    """Density of `sample_disc`: 1 / (pi r^2) [m-2]; 0 for a disc without area."""
    there = radius > 0
    return jnp.where(there, 1 / (jnp.pi * jnp.where(there, radius, 1) ** 2), 0)


def sample_triangle(u: Float[Array, " 2"]) -> Float[Array, " 3"]:
    """Barycentric weights of a point uniform in area on a triangle [3].

    Heitz, "A low-distortion map between triangle and square" (2019): the square is folded along its diagonal.
    """
    small = u[0] < u[1]
    first = jnp.where(small, u[0] / 2, u[0] - u[1] / 2)
    second = jnp.where(small, u[1] - u[0] / 2, u[1] / 2)
    return jnp.stack([first, second, 1 - first - second])


def pdf_triangle(corners: Float[Array, "3 3"]) -> Float[Array, ""]:
    """Density of `sample_triangle` on the triangle with these corners: 1 / area [m-2]; 0 without area."""
    return pdf_polygon(corners)


def polygon_vector(corners: Float[Array, "corner 3"]) -> Float[Array, " 3"]:
    """Area vector of a plane polygon [3] [m2]: 1/2 sum_k c_k x c_k+1, which sees it counterclockwise."""
    spokes = corners[1:] - corners[:1]
    return jnp.sum(jnp.cross(spokes[:-1], spokes[1:]), axis=0) / 2


@as_one_program
def sample_polygon(u: Float[Array, " 2"], corners: Float[Array, "corner 3"]) -> Float[Array, " 3"]:
    """A point uniform in area on a convex plane polygon [3] [m].

    The fan of triangles about the first corner: the first number chooses one by its area, and what is left of that
    number is uniform again. Differentiable in corners.
    """
    vector = polygon_vector(corners)
    spokes = corners[1:] - corners[:1]
    share = matmul(jnp.cross(spokes[:-1], spokes[1:]), vector) / 2
    total = jnp.sum(share)
    there = total > 0
    reached = jnp.cumsum(share) / jnp.where(there, total, 1)
    chosen = jnp.minimum(jnp.sum((u[0] >= reached).astype(jnp.int32)), share.shape[0] - 1)
    width = share[chosen] / jnp.where(there, total, 1)
    left = (u[0] - (reached[chosen] - width)) / jnp.where(width > 0, width, 1)
    weights = sample_triangle(jnp.stack([jnp.clip(left, 0, 1), u[1]]))  # rounding alone leads out of [0, 1]
    return matmul(weights, jnp.stack([corners[0], corners[chosen + 1], corners[chosen + 2]]))


def pdf_polygon(corners: Float[Array, "corner 3"]) -> Float[Array, ""]:
    """Density of `sample_polygon`: 1 / area [m-2]; 0 without area."""
    vector = polygon_vector(corners)
    square = dot(vector, vector)
    there = square > 0
    return jnp.where(there, lax.rsqrt(jnp.where(there, square, 1)), 0)


def pdf_from_area(
    pdf_area: Float[Array, ""], omega: Float[Array, " 3"], distance: Float[Array, ""], normal: Float[Array, " 3"]
) -> Float[Array, ""]:
    """Density per solid angle of a point drawn per area: pdf_area * distance^2 / |cos| [sr-1]; 0 edge-on."""
    cos = jnp.abs(dot(omega, normal))
    there = cos > 0
    return jnp.where(there, pdf_area * distance**2 / jnp.where(there, cos, 1), 0)


# Uniform numbers --------------------------------------------------------------------------------------------------


class AbstractSampler(eqx.Module):
    """How the uniform numbers of one decision are spread over the unit square."""

    @abc.abstractmethod
    def draw(self, key: Key[Array, ""], count: int) -> Float[Array, "count 2"]:
        """`count` points [count, 2] in [0, 1)^2, each alone uniform; their order tells nothing about their place."""


class Independent(AbstractSampler):
    """Independent points: the error of a mean falls as count^-1/2."""

    def draw(self, key: Key[Array, ""], count: int) -> Float[Array, "count 2"]:
        """See `AbstractSampler.draw`."""
        return jax.random.uniform(key, (count, 2), float_dtype())


class Stratified(AbstractSampler):
    """One random point in each cell of a raster as square as the divisors of `count` allow."""

    def draw(self, key: Key[Array, ""], count: int) -> Float[Array, "count 2"]:
        """See `AbstractSampler.draw`."""
        columns, rows = nearly_square(count)
        place, order = jax.random.split(key)
        jitter = jax.random.uniform(place, (count, 2), float_dtype())
        corner = np.stack(np.divmod(np.arange(count), rows), axis=-1).astype(jitter.dtype)
        inside = (jnp.asarray(corner) + jitter) / jnp.asarray([[columns, rows]], jitter.dtype)
        return jax.random.permutation(order, jnp.minimum(inside, _below_one(jitter.dtype)))


class Sobol(AbstractSampler):
    """The first two dimensions of Sobol's sequence, with Owen's nested scrambling and a nested shuffle of the order.

    Laine and Karras, "Stratified sampling for stochastic transparency" (EGSR 2011) and Burley, "Practical hash-based
    Owen scrambling" (JCGT 9(4), 2020). Best for a power of two of samples.
    """

    def draw(self, key: Key[Array, ""], count: int) -> Float[Array, "count 2"]:
        """See `AbstractSampler.draw`."""
        seed = jax.random.bits(key, (3,), jnp.uint32)
        index = _owen(jnp.arange(count, dtype=jnp.uint32), seed[0])  # an aligned block of the sequence, in any order
        first = _reverse(index)
        points = jnp.stack([_unit(_owen(first, seed[1])), _unit(_owen(_second_sobol(first), seed[2]))], axis=-1)
        return lax.optimization_barrier(points)  # or XLA computes them anew for every use


class Lattice(AbstractSampler):
    """A rank-1 lattice with a random shift: (k / N, frac(k g / N)), g near N / golden ratio and coprime to N.

    For smooth integrands the most even of all; the order is shuffled.
    """

    def draw(self, key: Key[Array, ""], count: int) -> Float[Array, "count 2"]:
        """See `AbstractSampler.draw`."""
        step = next(g for g in range(max(round(count * (math.sqrt(5) - 1) / 2), 1), 0, -1) if math.gcd(g, count) == 1)
        k = np.arange(count)
        point = jnp.asarray(np.stack([k / count, k * step % count / count], axis=-1), float_dtype())
        place, order = jax.random.split(key)
        moved = point + jax.random.uniform(place, (1, 2), float_dtype())
        moved = moved - jnp.floor(moved)
        return jax.random.permutation(order, jnp.minimum(moved, _below_one(moved.dtype)))


def nearly_square(count: int) -> tuple[int, int]:
    """Columns and rows with columns * rows = count, as square as the divisors allow; columns >= rows."""
    rows = next(d for d in range(math.isqrt(count), 0, -1) if count % d == 0)
    return count // rows, rows


def _below_one(dtype: np.dtype) -> float:
    return float(1 - jnp.finfo(dtype).epsneg)


def _unit(bits: UInt32[Array, " count"]) -> Float[Array, " count"]:
    """32 random bits as a number in [0, 1); float32 keeps the 24 highest."""
    dtype = float_dtype()
    kept = 24 if dtype == np.float32 else 32
    return (bits >> (32 - kept)).astype(dtype) * float(2.0**-kept)


def _reverse(bits: UInt32[Array, " count"]) -> UInt32[Array, " count"]:
    """The 32 bits in reverse order."""
    for shift, mask in ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF)):
        bits = ((bits >> shift) & jnp.uint32(mask)) | ((bits & jnp.uint32(mask)) << shift)
    return (bits >> 16) | (bits << 16)


def _owen(bits: UInt32[Array, " count"], seed: UInt32[Array, ""]) -> UInt32[Array, " count"]:
    """Nested uniform scrambling: every bit is flipped by a hash of the bits above it (Laine and Karras's)."""
    bits = _reverse(bits)
    bits = bits ^ (bits * jnp.uint32(0x3D20ADEA))
    bits = bits + seed
    bits = bits * ((seed >> 16) | 1)
    bits = bits ^ (bits * jnp.uint32(0x05526C56))
    return _reverse(bits ^ (bits * jnp.uint32(0x53A22864)))


def _second_sobol(first: UInt32[Array, " count"]) -> UInt32[Array, " count"]:
    """Sobol's second dimension, polynomial x + 1, from the first, which is the index with its bits reversed.

    Its direction numbers v_(k+1) = v_k ^ (v_k >> 1) are Pascal's triangle modulo 2, whose halves are alike.
    """
    for shift, mask in ((16, 0x0000FFFF), (8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        first = first ^ ((first & jnp.uint32(mask)) << shift)
    return first
