"""Rough conductors: the GGX microfacet brdf with Fresnel reflection and the energy of multiple scattering.

Walter et al., "Microfacet models for refraction through rough surfaces" (EGSR 2007); Heitz, "Understanding the
masking-shadowing function" (JCGT 3(2), 2014) for the height-correlated shadowing; Dupuy and Benyoub, "Sampling visible
GGX normals with spherical caps" (HPG 2023); Kulla and Conty, "Revisiting physically based shading at Imageworks"
(SIGGRAPH course, 2017) for the reciprocal term that returns what single scattering loses. The loss matters here: 12 %
of the light at normal incidence for a roughness of .3 would otherwise appear as emissivity.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxir._arrays import as_float, as_one_program, non_negative, positive
from jaxir._math import dot, frame_around, gauss_legendre, matmul, safe_divide, safe_sqrt, tensordot
from jaxir.optics.surface._brdf import (
    NARROWEST,
    AbstractBrdf,
    cosine_density,
    cosine_direction,
    facing,
    parameter,
    width_of_lobe,
)
from jaxir.optics.surface._fresnel import conductor_absorptance, conductor_reflectance

_DEGREE = (16, 10)  # Chebyshev coefficients of the loss in (direction, roughness)
_OF_MEAN = 28  # and of the logarithm of its mean in that of the roughness
_FINE = 48  # quadrature points behind those coefficients
_COARSE = 6  # and behind the mean absorptance of one direction, each way
_MEAN = 12


class RoughConductor(AbstractBrdf):
    """A rough surface of complex refractive index n - i k: GGX facets with conductor Fresnel reflection.

    brdf = F D / (2 (c_i r_o + c_o r_i)) + F_ms (1 - E_i)(1 - E_o) / (pi (1 - E_mean)),  r = sqrt(c^2 + a^2 (1 - c^2)),

    with D the GGX distribution of roughness a, E(cos, a) the directional reflectance of perfectly reflecting facets
    and F_ms the Fresnel factor of light that met more than one facet. Both terms are reciprocal and the reflectance
    never exceeds 1. E has no elementary form: it is a Chebyshev series fitted to its integral on first use (errs by
    1e-4 rms, 8e-4 at worst, near grazing). The emissivity is computed from what facets absorb, not as a difference
    from 1: within .7 % rms of itself, 2 % at grazing.

    Attributes:
        index: n [face | 1, node | 1].
        extinction: k [face | 1, node | 1].
        roughness: a in [1e-4, 1] [face | 1, node | 1].

    Differentiable in all three.
    """

    index: Float[Array, "face node"] = parameter(positive)
    extinction: Float[Array, "face node"] = parameter(non_negative)
    roughness: Float[Array, "face node"] = parameter(width_of_lobe)

    @property
    def diffuse(self) -> bool:
        """See `AbstractBrdf.diffuse`."""
        return False

    @as_one_program
    def eval(
        self, omega_i: Float[Array, " 3"], omega_o: Float[Array, " 3"], normal: Float[Array, " 3"]
    ) -> Float[Array, " node"]:
        """See `AbstractBrdf.eval`."""
        frame = frame_around(facing(omega_o, normal))
        i, o = matmul(frame, omega_i), matmul(frame, omega_o)
        above = i[2] > 0
        cos_i, cos_o = jnp.where(above, i[2], 1), jnp.maximum(o[2], 0)
        half = _half(i, o)
        cross = cos_i * _reach(cos_o, self.roughness) + cos_o * _reach(cos_i, self.roughness)
        reflected = self._of_facet(conductor_reflectance, jnp.clip(dot(o, half), 0, 1))
        single = reflected * _facets(half, self.roughness) / (2 * cross)
        lost = _loss(cos_i, self.roughness) * _loss(cos_o, self.roughness) / _mean_loss(self.roughness)
        return jnp.where(above, single + self._lost_reflectance() * lost / jnp.pi, 0)

    @as_one_program
    def sample(
        self, u: Float[Array, " 2"], omega_o: Float[Array, " 3"], normal: Float[Array, " 3"]
    ) -> Float[Array, " 3"]:
        """See `AbstractBrdf.sample`; a visible facet, or a cosine lobe for multiply scattered light."""
        up = facing(omega_o, normal)
        frame = frame_around(up)
        o = matmul(frame, omega_o)
        width = _one_width(self.roughness)
        share = _diffuse_share(o[2], width)
        diffuse = u[0] < share
        first = jnp.where(diffuse, u[0], u[0] - share) / jnp.where(diffuse, share, 1 - share)
        again = jnp.stack([jnp.clip(first, 0, 1), u[1]])
        angle = 2 * jnp.pi * again[1]
        half = jnp.stack(_visible_facet(again[0], (jnp.cos(angle), jnp.sin(angle)), o, width))
        mirrored = matmul(2 * dot(o, half) * half - o, frame)
        return jnp.where(diffuse, cosine_direction(again, up), mirrored)

    @as_one_program
    def pdf(
        self, omega_i: Float[Array, " 3"], omega_o: Float[Array, " 3"], normal: Float[Array, " 3"]
    ) -> Float[Array, ""]:
        """See `AbstractBrdf.pdf`; facets also send a little below the horizon, where the brdf is 0."""
        up = facing(omega_o, normal)
        frame = frame_around(up)
        i, o = matmul(frame, omega_i), matmul(frame, omega_o)
        width = _one_width(self.roughness)
        share = _diffuse_share(o[2], width)
        half = _half(i, o)
        facet = _facets(half, width) / (2 * (o[2] + _reach(o[2], width)))
        facet = jnp.where((half[2] > 0) & (dot(o, half) > 0), facet, 0)
        return share * cosine_density(omega_i, up) + (1 - share) * facet

    @as_one_program
    def directional_reflectance(self, cos_o: Float[Array, ""]) -> Float[Array, " node"]:
        """See `AbstractBrdf.directional_reflectance`; as the emissivity, and never below 0."""
        return self._over_facets(cos_o, conductor_reflectance, self._lost_reflectance())

    @as_one_program
    def directional_emissivity(self, cos_o: Float[Array, ""]) -> Float[Array, " node"]:
        """See `AbstractBrdf.directional_emissivity`.

        E <A> + (1 - E)(1 - F_ms) with <A> the mean absorptance of visible facets.
        """
        return self._over_facets(cos_o, conductor_absorptance, self._lost_absorptance())

    def _over_facets(self, cos_o: Float[Array, ""], fresnel: Callable, lost: Float[Array, " node"]) -> Array:
        """Mean of a Fresnel factor over visible facets, and the same of light that met more than one.

        Facet by facet: XLA makes no vector code of sums over an axis so short.
        """
        sine = safe_sqrt(1 - cos_o * cos_o)
        o = sine, jnp.zeros_like(sine), cos_o

        def add(sums: tuple[Array, Array], own: tuple[Array, ...]) -> tuple[tuple[Array, Array], None]:
            u, *turned, weight = own
            x, _, z = _visible_facet(u, turned, o, self.roughness)
            cos = jnp.clip(cos_o * z + sine * x, 0, 1)
            out = 2 * cos * z - cos_o
            above = out > 0
            seen = weight * jnp.where(above, _seen(cos_o, jnp.where(above, out, 1), self.roughness), 0)
            return (sums[0] + seen * self._of_facet(fresnel, cos), sums[1] + seen), None

        spans = (leaf.shape for leaf in (self.index, self.extinction, self.roughness))
        none = jnp.zeros(jnp.broadcast_shapes(*spans), sine.dtype), jnp.zeros_like(self.roughness)
        (total, below), _ = lax.scan(add, none, tuple(map(as_float, _facet_points())))
        loss = _loss(cos_o, self.roughness)
        return safe_divide((1 - loss) * total, below) + loss * lost

    def _of_facet(self, fresnel: Callable, cos: Float[Array, "..."]) -> Float[Array, " node"]:
        node = jnp.broadcast_shapes(cos.shape, self.index.shape, self.extinction.shape)
        return fresnel(*(jnp.broadcast_to(a, node) for a in (cos, self.index, self.extinction)))

    def _mean(self, fresnel: Callable) -> Float[Array, " node"]:
        """Mean of a Fresnel factor over cosine-weighted directions."""
        point, weight = gauss_legendre(_MEAN)

        def add(total: Array, own: tuple[Array, Array]) -> tuple[Array, None]:
            cos, weight = own
            return total + weight * self._of_facet(fresnel, cos), None

        none = jnp.zeros(jnp.broadcast_shapes(self.index.shape, self.extinction.shape), self.index.dtype)
        return lax.scan(add, none, (as_float(point), as_float(2 * weight * point)))[0]

    def _lost_absorptance(self) -> Float[Array, " node"]:
        """1 - F_ms = A (1 + F E) / (1 - F (1 - E)), F = 1 - A and E means over cosine-weighted directions."""
        absorbed, loss = self._mean(conductor_absorptance), _mean_loss(self.roughness)
        reflected = 1 - absorbed
        return absorbed * (1 + reflected * (1 - loss)) / (1 - reflected * loss)

    def _lost_reflectance(self) -> Float[Array, " node"]:
        """F_ms = F^2 E / (1 - F (1 - E))."""
        reflected, loss = self._mean(conductor_reflectance), _mean_loss(self.roughness)
        return reflected * reflected * (1 - loss) / (1 - reflected * loss)


def _reach(cos: Float[Array, "..."], roughness: Float[Array, "..."]) -> Float[Array, "..."]:
    """r = cos (1 + 2 Lambda), Lambda being Smith's shadowing."""
    return jnp.sqrt(cos * cos + roughness * roughness * (1 - cos * cos))


def _seen(cos_o: Float[Array, ""], cos_i: Float[Array, "..."], roughness: Float[Array, "..."]) -> Float[Array, "..."]:
    """G2 / G1 = (1 + Lambda_o) / (1 + Lambda_o + Lambda_i), the part of a visible facet's light that gets out."""
    reach_o, reach_i = _reach(cos_o, roughness), _reach(cos_i, roughness)
    return cos_i * (cos_o + reach_o) / (cos_i * reach_o + cos_o * reach_i)


def _facets(half: Float[Array, " 3"], roughness: Float[Array, "..."]) -> Float[Array, "..."]:
    """D = a^2 / (pi (a^2 z^2 + x^2 + y^2)^2); narrow peaks keep their digits because no 1 - cos^2 is formed."""
    square = roughness * roughness
    return square / (jnp.pi * (square * half[2] ** 2 + (half[0] ** 2 + half[1] ** 2)) ** 2)


def _half(i: Float[Array, " 3"], o: Float[Array, " 3"]) -> Float[Array, " 3"]:
    """Unit vector half way between two; the normal where they are opposite to rounding."""
    total = i + o
    square = dot(total, total)
    there = square > jnp.finfo(square.dtype).eps ** 2
    return jnp.where(there, total / jnp.sqrt(jnp.where(there, square, 1)), jnp.asarray([0, 0, 1], total.dtype))


def _visible_facet(
    u: Float[Array, ""],
    turned: Sequence[Array],
    o: Sequence[Array] | Float[Array, " 3"],
    roughness: Float[Array, "..."],
) -> tuple[Array, Array, Array]:
    """Normal of a facet seen from `o` with density D G1 max(o . h, 0) / o_z: a point of a spherical cap, stretched.

    `turned` are cosine and sine of its angle about the cap's axis. Components by themselves, for vector code.
    """
    long = jnp.sqrt(o[2] ** 2 + roughness**2 * (o[0] ** 2 + o[1] ** 2))
    x, y, z = roughness * o[0] / long, roughness * o[1] / long, o[2] / long
    height = (1 - u) * (1 + z) - z
    radius = safe_sqrt(1 - height * height)
    h = roughness * (radius * turned[0] + x), roughness * (radius * turned[1] + y), height + z
    square = h[0] * h[0] + h[1] * h[1] + h[2] * h[2]
    length = jnp.sqrt(jnp.where(square > 0, square, 1))
    return h[0] / length, h[1] / length, h[2] / length


def _one_width(roughness: Float[Array, " node"]) -> Float[Array, ""]:
    """One roughness for all nodes to sample by; the largest, so that weights stay bounded."""
    return jnp.max(roughness)


def _diffuse_share(cos_o: Float[Array, ""], roughness: Float[Array, ""]) -> Float[Array, ""]:
    """Probability of sampling multiply scattered light."""
    return jnp.clip(_loss(cos_o, roughness), 0.02, 0.9)


# The energy that single scattering loses ----------------------------------------------------------------------------


def _loss(cos: Float[Array, "..."], roughness: Float[Array, "..."]) -> Float[Array, "..."]:
    """1 - E(cos, a), a Chebyshev series in sqrt(cos (1 + a) / (cos + a)) and a."""
    t = safe_sqrt(cos * (1 + roughness) / (cos + roughness))
    in_t = tensordot(as_float(_loss_table()[0]), _chebyshev(2 * roughness - 1, _DEGREE[1]), 1)
    return jnp.maximum(_series(list(in_t), 2 * t - 1), 0)  # the fit's own error of 1e-4 around a true 0


def _mean_loss(roughness: Float[Array, "..."]) -> Float[Array, "..."]:
    """Mean of `_loss` over cosine-weighted directions, to 2e-4 of itself.

    It is that of the series, whatever this errs: of what multiply scattered light is divided by it, all is sent.
    """
    x = 1 - 2 * jnp.log(roughness) / np.log(NARROWEST)
    return jnp.exp(_series(_loss_table()[1].tolist(), x))


def _series(coefficients: Sequence[Any], x: Float[Array, "..."]) -> Array:
    """Sum of coefficients times T_k(x), at least two, by the recurrence of `_chebyshev`.

    The last first, as Clenshaw sums, XLA's simplifier turns in circles in programs of one roughness, and says so.
    """
    before, last = jnp.ones_like(x), x
    total = coefficients[0] + coefficients[1] * x
    for coefficient in coefficients[2:]:
        before, last = last, 2 * x * last - before
        total = total + coefficient * last
    return total


def _chebyshev(x: Float[Array, "*leaf"], count: int) -> Float[Array, "order *leaf"]:
    """T_0 ... T_{count - 1} by their recurrence; smooth at both ends, unlike cos(k arccos x)."""
    values = [jnp.ones_like(x), x]
    while len(values) < count:
        values.append(2 * x * values[-1] - values[-2])
    return jnp.stack(values)


@functools.cache
def _loss_table() -> tuple[np.ndarray, np.ndarray]:
    """Chebyshev coefficients of 1 - E [direction, roughness] and of its mean's logarithm, in double precision."""
    t, a = (_chebyshev_points(n) for n in _DEGREE)
    tt, aa = (m.ravel() for m in np.meshgrid(t, a, indexing="ij"))
    cos = aa * tt**2 / (1 + aa - tt**2)
    loss = 1 - _single_scattering(cos, aa).reshape(_DEGREE)
    cheb = np.polynomial.chebyshev
    to_t, to_a = (np.linalg.inv(cheb.chebvander(2 * x - 1, len(x) - 1)) for x in (t, a))
    table = to_t @ loss @ to_a.T
    mu, weight = gauss_legendre(200)
    x = _chebyshev_points(_OF_MEAN)
    a = NARROWEST ** (1 - x)
    s = np.sqrt(mu[:, None] * (1 + a) / (mu[:, None] + a))
    each = np.maximum(cheb.chebval2d(2 * s - 1, 2 * a[None] - 1 + 0 * s, table), 0)
    mean = 2 * np.sum((weight * mu)[:, None] * each, axis=0)
    return table, np.linalg.inv(cheb.chebvander(2 * x - 1, _OF_MEAN - 1)) @ np.log(mean)


def _single_scattering(cos: np.ndarray, roughness: np.ndarray) -> np.ndarray:
    """E, the mean of G2 / G1 over visible facets.

    The cap is cut where reflection dips below the horizon, so that Gauss-Legendre sees a smooth integrand.
    """
    point, weight = gauss_legendre(_FINE)
    mu, a = cos[:, None, None], roughness[:, None, None]
    sine = np.sqrt(1 - mu * mu)
    long = np.sqrt(mu**2 + (a * sine) ** 2)
    x, z, angle = a * sine / long, mu / long, np.pi * point[None, :, None]

    def reflected(height: np.ndarray) -> np.ndarray:
        radius = np.sqrt(np.maximum(1 - height**2, 0))
        hx, hy, hz = a * (radius * np.cos(angle) + x), a * radius * np.sin(angle), height + z
        norm = np.sqrt(hx**2 + hy**2 + hz**2) + 1e-300
        return 2 * (hx * sine + hz * mu) * hz / norm**2 - mu

    low, high = np.broadcast_to(-z + 1e-15, (len(cos), _FINE, 1)), np.ones((len(cos), _FINE, 1))
    whole = reflected(low) > 0
    for _ in range(50):
        middle = (low + high) / 2
        above = reflected(middle) > 0
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    start = np.where(whole, -z, high)
    out = np.maximum(reflected(start + (1 - start) * point[None, None, :]), 1e-300)
    reach_o, reach_i = (np.sqrt(c * c + a * a * (1 - c * c)) for c in (mu, out))
    seen = out * (mu + reach_o) / (out * reach_o + mu * reach_i)
    return np.sum(weight[:, None] * weight * (1 - start) / (1 + z) * seen, axis=(1, 2))


@functools.cache
def _facet_points() -> tuple[np.ndarray, ...]:
    """Quadrature over visible facets: u, cosine and sine of the angle, weights [point]."""
    u, weight = gauss_legendre(_COARSE)
    turn = (np.arange(_COARSE) + 0.5) / _COARSE  # midpoints: spectral for an even periodic function
    u, turn = (x.ravel() for x in np.meshgrid(u, turn, indexing="ij"))
    return u, np.cos(np.pi * turn), np.sin(np.pi * turn), np.repeat(weight / _COARSE, _COARSE)


def _chebyshev_points(count: int) -> np.ndarray:
    return (np.cos(np.pi * (np.arange(count) + 0.5) / count) + 1) / 2
