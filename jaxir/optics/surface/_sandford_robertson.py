"""The brdf of Sandford and Robertson, the infrared community's model of aircraft paint.

Sandford and Robertson, "Infrared reflectance properties of aircraft paints", Proc. IRIS Targets, Backgrounds and
Discrimination (1985): a diffuse part, an emissivity that falls towards grazing, and a lobe that takes what is left.
"""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from jaxir._arrays import Check, as_float, fraction
from jaxir._math import dot, frame_around, gauss_legendre, matmul
from jaxir.optics.surface._brdf import (
    AbstractBrdf,
    cosine_density,
    cosine_direction,
    facing,
    parameter,
    width_of_lobe,
)

_POINTS = 8  # of integrals whose poles lie so far away that these err by rounding in double precision
_ROUNDING = 8  # units of the last place by which a sum that is 1 may exceed it
_WIDE = 0.7  # width beyond which the lobe is integrated by quadrature, because its closed form cancels
_SHALLOW = 0.7  # b^2 beyond which the fall towards grazing is


class SandfordRobertson(AbstractBrdf):
    """Paint: diffuse reflection, a specular lobe, and an emissivity that falls towards grazing.

    With mu = cos theta, g(mu) = 2 mu^2 / (mu^2 + b^2 (1 - mu^2)) and G(b) = 2 int_0^1 g mu dmu,

        emissivity(mu)  = E g(mu) / G,
        brdf            = D g(mu_i) g(mu_o) / (pi G^2)  +  S(mu_o) h / (4 pi H(mu_o)),
        S(mu)           = 1 - (E + D) g(mu) / G,
        h               = (1 + e^2 - (1 - e^2) cos a)^-2,   a = angle between omega_i and the mirrored omega_o.

    H is the exact integral (1 / 4 pi) int h cos_i d omega_i, so that reflectance + emissivity = 1 in every direction
    omega_o. The diffuse part is reciprocal. The lobe is reciprocal at its peak only: the model fixes E(mu) and the
    shape of the lobe at will, and the factor S(mu_o) / H(mu_o) does not exchange; it is evaluated for the direction
    in which the surface radiates, for which Kirchhoff's law must hold.

    Attributes:
        emissivity: E, hemispherical [face | 1, node | 1].
        diffuse_reflectance: D, hemispherical [face | 1, node | 1].
        lobe_width: e in [1e-4, 1]; the lobe's half width at half maximum is about 1.3 e [rad] [face | 1, node | 1].
        grazing: b in [0, 1]; 0 makes the emissivity the same in every direction [face | 1, node | 1].

    Differentiable in all four.
    """

    emissivity: Float[Array, "face node"] = parameter(fraction)
    diffuse_reflectance: Float[Array, "face node"] = parameter(fraction)
    lobe_width: Float[Array, "face node"] = parameter(width_of_lobe)
    grazing: Float[Array, "face node"] = parameter(fraction)

    @property
    def diffuse(self) -> bool:
        """See `AbstractBrdf.diffuse`."""
        return False

    def eval(
        self, omega_i: Float[Array, " 3"], omega_o: Float[Array, " 3"], normal: Float[Array, " 3"]
    ) -> Float[Array, " node"]:
        """See `AbstractBrdf.eval`."""
        up = facing(omega_o, normal)
        cos_i, cos_o = dot(omega_i, up), dot(omega_o, up)
        fall_i, fall_o = _fall(jnp.maximum(cos_i, 0), self.grazing), _fall(cos_o, self.grazing)
        diffuse = self.diffuse_reflectance * fall_i * fall_o / jnp.pi
        lobe = _lobe(omega_i, _mirror(omega_o, up), self.lobe_width) / (4 * jnp.pi * _norm(cos_o, self.lobe_width))
        return jnp.where(cos_i > 0, diffuse + self._specular(cos_o) * lobe, 0)

    def sample(
        self, u: Float[Array, " 2"], omega_o: Float[Array, " 3"], normal: Float[Array, " 3"]
    ) -> Float[Array, " 3"]:
        """See `AbstractBrdf.sample`; the lobe, folded upwards at the horizon, or a cosine lobe."""
        up = facing(omega_o, normal)
        share = self._share(dot(omega_o, up))
        glossy = u[0] < share
        first = jnp.where(glossy, u[0], u[0] - share) / jnp.where(glossy, share, 1 - share)
        again = jnp.stack([jnp.clip(first, 0, 1), u[1]])
        square = _mean_width(self.lobe_width) ** 2
        drop = 2 * square * (1 - again[0]) / (square + again[0] * (1 - square))  # 1 - cos a
        sine = jnp.sqrt(drop * (2 - drop))
        angle = 2 * jnp.pi * again[1]
        local = jnp.stack([sine * jnp.cos(angle), sine * jnp.sin(angle), 1 - drop])
        lobe = matmul(local, frame_around(_mirror(omega_o, up)))
        folded = lobe - jnp.minimum(2 * dot(lobe, up), 0) * up
        return jnp.where(glossy, folded, cosine_direction(again, up))

    def pdf(
        self, omega_i: Float[Array, " 3"], omega_o: Float[Array, " 3"], normal: Float[Array, " 3"]
    ) -> Float[Array, ""]:
        """See `AbstractBrdf.pdf`."""
        up = facing(omega_o, normal)
        share = self._share(dot(omega_o, up))
        width = _mean_width(self.lobe_width)
        peak = _mirror(omega_o, up)
        lobe = _lobe(omega_i, peak, width) + _lobe(_reflect(omega_i, up), peak, width)
        lobe = jnp.where(dot(omega_i, up) > 0, lobe * width**2 / jnp.pi, 0)
        return share * lobe + (1 - share) * cosine_density(omega_i, up)

    def directional_reflectance(self, cos_o: Float[Array, ""]) -> Float[Array, " node"]:
        """See `AbstractBrdf.directional_reflectance`; 1 - E g / G."""
        return 1 - self.directional_emissivity(cos_o)

    def directional_emissivity(self, cos_o: Float[Array, ""]) -> Float[Array, " node"]:
        """See `AbstractBrdf.directional_emissivity`; E g / G."""
        return self.emissivity * _fall(cos_o, self.grazing)

    def relations(self) -> list[Check]:
        """No direction reflects less than nothing."""
        taken = (self.emissivity + self.diffuse_reflectance) * _fall(as_float(1.0), self.grazing)
        return [
            Check(
                "(emissivity + diffuse_reflectance) * 2 / G(grazing) of SandfordRobertson",
                taken,
                taken <= 1 + _ROUNDING * jnp.finfo(taken.dtype).eps,
                "at most 1 (a lobe that reflects at least nothing at normal incidence)",
            )
        ]

    def _specular(self, cos_o: Float[Array, ""]) -> Float[Array, " node"]:
        """S, the part of reflectance in the lobe."""
        rest = 1 - (self.emissivity + self.diffuse_reflectance) * _fall(cos_o, self.grazing)
        rounded = rest + lax.stop_gradient(jnp.maximum(rest, 0) - rest)  # 0 that may rise has the slope of what rises
        return jnp.where(rest >= -_ROUNDING * jnp.finfo(rest.dtype).eps, rounded, 0)

    def _share(self, cos_o: Float[Array, ""]) -> Float[Array, ""]:
        """Probability of sampling the lobe: its mean part of the reflectance over nodes, kept off 0 and 1."""
        glossy = jnp.mean(self._specular(cos_o))
        diffuse = jnp.mean(self.diffuse_reflectance * _fall(cos_o, self.grazing))
        total = glossy + diffuse
        return jnp.clip(jnp.where(total > 0, glossy / jnp.where(total > 0, total, 1), 0.5), 0.05, 0.95)


def _fall(cos: Float[Array, ""], grazing: Float[Array, "*leaf"]) -> Float[Array, "*leaf"]:
    """g(mu) / G(b): how the emissivity depends on direction; its cosine-weighted mean is 1."""
    square, b2 = cos * cos, grazing * grazing
    below = square + b2 * (1 - square)
    there = below > 1e-12  # beyond: grazing with b = 0, where g is 2 and 1 / below^2 would overflow in the derivative
    g = jnp.where(there, 2 * square / jnp.where(there, below, 1), 2)
    return g / _total(b2)


def _total(b2: Float[Array, "*leaf"]) -> Float[Array, "*leaf"]:
    """G(b) = 2 int_0^1 x / (b2 + (1 - b2) x) dx = (2 / q) (1 + b2 ln b2 / q) with q = 1 - b2."""
    narrow = b2 < _SHALLOW
    r = jnp.where(narrow, b2, 0)
    logarithm = jnp.log(jnp.where(r > 0, r, 1))
    closed = 2 / (1 - r) * (1 + r * logarithm / (1 - r))
    wide = jnp.where(narrow, 1, b2)
    return jnp.where(narrow, closed, 2 * _integral(lambda x: x / (wide + (1 - wide) * x)))


def _integral(integrand: Callable[[float], Array]) -> Array:
    """Over [0, 1], term by term: XLA makes no vector code of sums over an axis so short."""
    points, weights = gauss_legendre(_POINTS)
    each = [weight * integrand(point) for point, weight in zip(points.tolist(), weights.tolist(), strict=True)]
    return sum(each[1:], each[0])


def _mirror(omega: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Float[Array, " 3"]:
    """The direction of specular reflection, on the same side of the surface."""
    return 2 * dot(omega, normal) * normal - omega


def _reflect(omega: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Float[Array, " 3"]:
    """Image of `omega` on the other side of the surface."""
    return omega - 2 * dot(omega, normal) * normal


def _lobe(omega: Float[Array, " 3"], peak: Float[Array, " 3"], width: Float[Array, "*leaf"]) -> Float[Array, "*leaf"]:
    """h; 1 - cos a is half the squared distance of the two unit vectors, free of cancellation in narrow lobes."""
    apart = omega - peak
    square = width * width
    return (2 * square + (1 - square) * (dot(apart, apart) / 2)) ** -2


def _norm(cos: Float[Array, ""], width: Float[Array, " leaf"]) -> Float[Array, " leaf"]:
    """H(mu) = (1 / 4 pi) int h cos_i d omega_i over the hemisphere, the lobe leaning by mu from the normal.

    The integral over azimuth leaves 1/2 int_0^1 c (A - B mu c) / Q^(3/2) dc with A = 1 + e^2, B = 1 - e^2,
    Q = B^2 c^2 - 2 A B mu c + R^2, R^2 = 4 e^2 + B^2 mu^2, which is

        H = [A (B mu + R) - 4 e^2] / (8 e^2 B^2) - mu / (2 B^2) ln[(R + A mu) / (2 e^2 (1 + mu))].
    """
    narrow = width < _WIDE
    e2 = jnp.where(narrow, width, 0.1) ** 2
    a, b = 1 + e2, 1 - e2
    root = jnp.sqrt(4 * e2 + (b * cos) ** 2)
    logarithm = jnp.log((root + a * cos) / (2 * e2 * (1 + cos)))
    closed = (a * (b * cos + root) - 4 * e2) / (8 * e2 * b * b) - cos * logarithm / (2 * b * b)
    e2 = jnp.where(narrow, 1, width) ** 2
    a, b = 1 + e2, 1 - e2

    def over(c: float) -> Array:
        q = (b * c - a * cos) ** 2 + 4 * e2 * (1 - cos * cos)  # as a sum of squares
        return c * (a - b * cos * c) / (q * jnp.sqrt(q))

    return jnp.where(narrow, closed, _integral(over) / 2)


def _mean_width(width: Float[Array, " leaf"]) -> Float[Array, ""]:
    """One width for all nodes to sample by; the widest, so that weights stay bounded."""
    return jnp.max(width)
