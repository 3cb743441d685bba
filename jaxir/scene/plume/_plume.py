"""What every plume answers, so that nobody asks which one it is."""

from __future__ import annotations

import abc
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxir._fields import Physical
from jaxir._math import safe_divide
from jaxir.geometry import Pieces, Rays, turned
from jaxir.medium import AbstractMedium, Distance, sample_in_panels
from jaxir.optics.particle import AbstractPhase
from jaxir.optics.spectrum import Nodes


class Proposal(NamedTuple):
    """A typical extinction at points [ray] [m-1] and phase function, by which distances and directions are drawn."""

    extinction: Float[Array, " ray"]
    phase: AbstractPhase


class AbstractPlume(Physical):
    """Gas, and particles perhaps, that emit, absorb and scatter."""

    @abc.abstractmethod
    def extent(self) -> Float[Array, "corner 3"]:
        """Points whose convex hull holds the plume [corner, 3] [m]."""

    @abc.abstractmethod
    def medium(self, nodes: Nodes) -> AbstractMedium:
        """The plume on the nodes. Differentiable in its radiometric fields."""

    @abc.abstractmethod
    def meets(self, rays: Rays, t_max: Float[Array, " ray"]) -> Bool[Array, " ray"]:
        """Whether rays enter the plume before `t_max` [ray] [m]; the plume changes nothing on any other."""

    @abc.abstractmethod
    def route(self, rays: Rays, t_max: Float[Array, " ray"]) -> Any:
        """What `AbstractMedium.radiance` may be told of rays that are evaluated often; None if that gains nothing."""

    @abc.abstractmethod
    def cuts(self, rays: Rays, t_max: Float[Array, " ray"]) -> Float[Array, "ray cut"]:
        """As `AbstractMedium.cuts`."""

    @abc.abstractmethod
    def pieces(self, exponent: Float[Array, ""]) -> Pieces:
        """Boxes that cover the plume, each with about volume * temperature^exponent as its power."""

    @property
    @abc.abstractmethod
    def parametric(self) -> bool:
        """Whether a few parameters say all of it, its place included, so that each of them acts on all of its rays."""

    @property
    @abc.abstractmethod
    def scatters(self) -> bool:
        """Whether there are particles in it."""

    @property
    @abc.abstractmethod
    def sums_beams(self) -> bool:
        """Whether parallel light scattered once is summed along rays by its medium instead of sampled."""

    @abc.abstractmethod
    def proposals(self, point: Float[Array, "ray 3"]) -> tuple[Proposal, ...]:
        """How particles at points [ray, 3] [m] are drawn from, for each kind of them; none without particles."""

    @abc.abstractmethod
    def sample_distance(
        self, rays: Rays, t_max: Float[Array, " ray"], u: Float[Array, " ray"], forced: Bool[Array, " ray"]
    ) -> Distance:
        """The place where each ray is scattered before `t_max`.

        Args:
            rays: the rays.
            t_max: where they end [ray] [m]; inf allowed.
            u: uniform numbers in [0, 1) [ray].
            forced: rays that are scattered for certain if they cross particles; the others may pass [ray].
        """

    def carried(self, rays: Rays) -> tuple[Rays, Float[Array, " ray"]]:
        """Parallel rays, where they are, that move with the plume under differentiation, and what areas grow by.

        So that none goes over to another side of where the plume ends; a sum over rays that stay lacks what that adds.
        By default they stay.
        """
        return rays, jnp.ones(rays.count, rays.origin.dtype)

    def thinned(self) -> AbstractPlume:
        """About the same plume, made of few parts where it is made of many: enough to choose spectral nodes with."""
        return self

    def refined(self) -> AbstractPlume | None:
        """The same plume with a quadrature twice as fine; None where its sums along rays are exact."""
        return None

    @abc.abstractmethod
    def hottest(self) -> Float[Array, ""]:
        """Its highest temperature [K]."""

    @abc.abstractmethod
    def described(self) -> str:
        """What it is, in a few words."""

    @abc.abstractmethod
    def outlines(self) -> list[np.ndarray]:
        """Lines that show where it is, each of points [point, 3] [m]; on the host."""


def sample_direction(
    plume: AbstractPlume, u: Float[Array, "ray 2"], point: Float[Array, "ray 3"], direction: Float[Array, "ray 3"]
) -> Float[Array, "ray 3"]:
    """Directions drawn from the proposed phase functions about those in which rays run [ray, 3].

    Not to be differentiated.
    """
    proposals = plume.proposals(point)
    first, turn = u[:, 0], u[:, 1]
    if len(proposals) == 1:
        cosine = jax.vmap(proposals[0].phase.sample)(first)
        return jax.vmap(turned)(cosine, turn, direction)
    begin, cosine = jnp.zeros_like(first), jnp.zeros_like(first)
    for proposal, share in zip(proposals, _shares(proposals), strict=True):  # what is left of a number is uniform again
        inside = (first >= begin) & (share > 0)
        left = jnp.clip(safe_divide(first - begin, share), 0, 1 - jnp.finfo(first.dtype).epsneg)
        cosine = jnp.where(inside, jax.vmap(proposal.phase.sample)(left), cosine)
        begin = begin + share
    return jax.vmap(turned)(cosine, turn, direction)


def pdf_direction(
    plume: AbstractPlume, cosine: Float[Array, " ray"], point: Float[Array, "ray 3"]
) -> Float[Array, " ray"]:
    """Density [ray] [sr-1] of `sample_direction` for cosines with the directions in which rays run."""
    proposals = plume.proposals(point)
    if len(proposals) == 1:
        return jax.vmap(proposals[0].phase.pdf)(cosine)
    shares = _shares(proposals)
    parts = [share * jax.vmap(p.phase.pdf)(cosine) for p, share in zip(proposals, shares, strict=True)]
    return jnp.sum(jnp.stack(parts), axis=0)


def _shares(proposals: tuple[Proposal, ...]) -> list[Float[Array, " ray"]]:
    """Share of each in their extinction; all of it for the first where there is none."""
    total = jnp.sum(jnp.stack([proposal.extinction for proposal in proposals]), axis=0)
    shares = [safe_divide(proposal.extinction, total) for proposal in proposals]
    return [jnp.where(total > 0, shares[0], 1), *shares[1:]]


def sample_between(
    plume: AbstractPlume,
    rays: Rays,
    t_max: Float[Array, " ray"],
    u: Float[Array, " ray"],
    forced: Bool[Array, " ray"],
) -> Distance:
    """`AbstractPlume.sample_distance` by what the plume proposes in the middle of each panel between its cuts."""
    cuts = plume.cuts(rays, t_max)
    middle = (cuts[:, 1:] + cuts[:, :-1]) / 2
    point = rays.at(middle)
    proposed = [proposal.extinction for proposal in plume.proposals(point.reshape(-1, 3))]
    extinction = jnp.sum(jnp.stack(proposed), axis=0).reshape(middle.shape)
    return sample_in_panels(cuts, extinction, u, forced)
