"""Phase functions: how a scattering event spreads light over the angle between the old and the new direction.

`cosine` is that of the scattering angle, 1 for light that goes straight on. A phase function has the unit sr-1 and
integrates to 1 over the sphere; the azimuth about the old direction is uniform. Leaves are [node | 1, ...]; one
direction is sampled for all nodes, from the mean of their phase functions, so that eval / pdf stays at most the number
of nodes.
"""

from __future__ import annotations

import abc
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxir._arrays import Check, as_float, as_one_program, increasing, non_negative, positive, require_shape
from jaxir._fields import Physical, quantity, spectral
from jaxir._math import gauss_legendre, matmul, safe_divide

MOMENT_POINTS = 512


class AbstractPhase(Physical):
    """A phase function [sr-1] with its sampler."""

    @abc.abstractmethod
    def eval(self, cosine: Float[Array, ""]) -> Float[Array, " node"]:
        """The phase function [node | 1] [sr-1]. Differentiable in parameters and cosine."""

    @abc.abstractmethod
    def sample(self, u: Float[Array, ""]) -> Float[Array, ""]:
        """A cosine from a uniform number in [0, 1). Not to be differentiated."""

    @abc.abstractmethod
    def pdf(self, cosine: Float[Array, ""]) -> Float[Array, ""]:
        """Density [sr-1] of the direction with the cosine that `sample` returns and a uniform azimuth."""

    def moments(self, order: int) -> Float[Array, "degree node"]:
        """Legendre moments 2 pi integral p(c) P_l(c) dc for l = 0 .. `order` [degree, node or 1]; the first is 1.

        By `MOMENT_POINTS` points of Gauss and Legendre, crowded at 0 and 180 degrees: lobes down to half a degree.
        Differentiable in parameters.
        """
        share, weight = gauss_legendre(MOMENT_POINTS)
        angle = np.pi * (share - np.sin(2 * np.pi * share) / (2 * np.pi))
        weight = weight * 2 * np.pi**2 * np.sin(angle) * (1 - np.cos(2 * np.pi * share))
        legendre = np.polynomial.legendre.legvander(np.cos(angle), order) * weight[:, None]
        found = matmul(as_float(legendre.T), jax.vmap(self.eval)(as_float(np.cos(angle))))
        return found / found[:1]


class Isotropic(AbstractPhase):
    """Equal scattering into all directions: 1 / 4 pi."""

    @as_one_program
    def eval(self, cosine: Float[Array, ""]) -> Float[Array, " node"]:
        """See `AbstractPhase.eval`."""
        return jnp.full((1,), 1 / (4 * jnp.pi), cosine.dtype)

    @as_one_program
    def sample(self, u: Float[Array, ""]) -> Float[Array, ""]:
        """See `AbstractPhase.sample`."""
        return 2 * u - 1

    def pdf(self, cosine: Float[Array, ""]) -> Float[Array, ""]:
        """See `AbstractPhase.pdf`."""
        return jnp.full_like(cosine, 1 / (4 * jnp.pi))


def _inside(field: str, value: Array) -> Check:
    return Check(field, value, jnp.abs(value) < 1, "values inside (-1, 1)")


class HenyeyGreenstein(AbstractPhase):
    """Henyey and Greenstein's phase function (1941), (1 - a^2) / (4 pi (1 + a^2 - 2 a cosine)^(3/2)).

    For particles as large as the wavelength it is wrong by factors of 5-27 in backscatter: use `TabulatedPhase`.

    Attributes:
        asymmetry: mean cosine a [node or 1], -1 < a < 1.

    Differentiable in `asymmetry`.
    """

    asymmetry: Float[Array, " node"] = spectral("1", _inside)

    @as_one_program
    def eval(self, cosine: Float[Array, ""]) -> Float[Array, " node"]:
        """See `AbstractPhase.eval`."""
        a = self.asymmetry
        # 1 + a^2 - 2 a cosine, without cancellation in the peak
        forward, backward = (1 - a) ** 2 + 2 * a * (1 - cosine), (1 + a) ** 2 - 2 * a * (1 + cosine)
        square = jnp.where(a >= 0, forward, backward)
        return (1 - a) * (1 + a) / (4 * jnp.pi * square * jnp.sqrt(square))

    @as_one_program
    def sample(self, u: Float[Array, ""]) -> Float[Array, ""]:
        """See `AbstractPhase.sample`: one node is drawn, then its distribution function is inverted."""
        count = self.asymmetry.shape[0]
        chosen = jnp.minimum((u * count).astype(jnp.int32), count - 1)
        rest = jnp.clip(u * count - chosen.astype(u.dtype), 0, 1)
        a = self.asymmetry[chosen]
        s = 2 * rest - 1
        # (1 + a^2 - ((1 - a^2) / (1 + a s))^2) / 2a, multiplied out: a cancels and may be 0.
        return jnp.clip((s + a * (1.5 + s * s / 2) + a * a * s + a**3 * (s * s - 1) / 2) / (1 + a * s) ** 2, -1, 1)

    def pdf(self, cosine: Float[Array, ""]) -> Float[Array, ""]:
        """See `AbstractPhase.pdf`."""
        return jnp.mean(self.eval(cosine))


def from_minus_one_to_one(field: str, value: Array) -> Check:
    """`value` [sample] begins with -1 and ends with 1."""
    ends = jnp.array([0, -1])
    reached = jnp.abs(value[ends] - jnp.array([-1, 1], value.dtype)) < 1e-6
    return Check(f"{field}: ends", value[ends], reached, "cosines from -1 to 1")


class TabulatedPhase(AbstractPhase):
    """A phase function tabulated over the cosine, linear between samples and normalised.

    Attributes:
        cosine: increasing from -1 to 1 [angle]; crowd samples in the forward peak, e.g. equal steps of the angle.
        value: phase function [node or 1, angle] [sr-1], scaled to integrate to 1 over the sphere.

    Differentiable in `value`.
    """

    cosine: Float[Array, " angle"] = quantity("1", ("angle",), (increasing, from_minus_one_to_one), least=2)
    value: Float[Array, "node angle"] = quantity("sr-1", ("node", "angle"), non_negative)

    def __init__(self, cosine: Any, value: Any):
        """Normalise; `value` is [angle] or [node or 1, angle], in any unit."""
        self.cosine = as_float(cosine, "TabulatedPhase.cosine")
        given = as_float(value, "TabulatedPhase.value")
        given = given[None] if given.ndim == 1 else given
        require_shape("TabulatedPhase.cosine", self.cosine, ("angle",))
        require_shape("TabulatedPhase.value", given, ("node", self.cosine.shape[0]))
        whole = 2 * jnp.pi * jnp.sum(_pieces(self.cosine, given), axis=-1, keepdims=True)
        self.value = safe_divide(given, whole)  # 0 is refused by `relations`

    @as_one_program
    def eval(self, cosine: Float[Array, ""]) -> Float[Array, " node"]:
        """See `AbstractPhase.eval`."""
        below, share = self._place(cosine)
        return self.value[:, below] * (1 - share) + self.value[:, below + 1] * share

    @as_one_program
    def sample(self, u: Float[Array, ""]) -> Float[Array, ""]:
        """See `AbstractPhase.sample`: the distribution function, quadratic between samples, is inverted exactly."""
        mean = jnp.mean(self.value, axis=0)
        pieces = _pieces(self.cosine, mean)
        upto = jnp.concatenate([jnp.zeros_like(pieces[:1]), jnp.cumsum(pieces)])
        target = u * upto[-1]
        below = jnp.clip(jnp.searchsorted(upto, target, side="right") - 1, 0, pieces.shape[0] - 1).astype(jnp.int32)
        low, high = mean[below], mean[below + 1]
        piece = pieces[below]
        rest = jnp.clip(safe_divide(target - upto[below], piece), 0, 1)
        # low t + (high - low) t^2 / 2 = rest (low + high) / 2, by the root without cancellation
        root = jnp.sqrt(low * low + rest * (high - low) * (high + low))
        t = safe_divide(rest * (low + high), low + root)
        return self.cosine[below] + (self.cosine[below + 1] - self.cosine[below]) * jnp.clip(t, 0, 1)

    def pdf(self, cosine: Float[Array, ""]) -> Float[Array, ""]:
        """See `AbstractPhase.pdf`."""
        return jnp.mean(self.eval(cosine))

    def _place(self, cosine: Float[Array, ""]) -> tuple[Array, Array]:
        last = self.cosine.shape[0] - 2
        below = jnp.clip(jnp.searchsorted(self.cosine, cosine, side="right") - 1, 0, last).astype(jnp.int32)
        share = (cosine - self.cosine[below]) / (self.cosine[below + 1] - self.cosine[below])
        return below, jnp.clip(share, 0, 1)

    def relations(self) -> list[Check]:
        """The values are not all 0."""
        return [positive("TabulatedPhase.value: sum over angles", jnp.sum(self.value, axis=-1))]


def _pieces(cosine: Float[Array, " angle"], value: Float[Array, "*batch angle"]) -> Float[Array, "*batch piece"]:
    """Integrals of `value` over the cosine between neighbouring samples."""
    mean = (value[..., 1:] + value[..., :-1]) / 2
    return mean * jnp.diff(cosine).reshape((1,) * (value.ndim - 1) + (-1,))
