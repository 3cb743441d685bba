"""What a plume does to rays on the spectral nodes: the interface, and the optics of gas with particles.

With particles, extinction = absorption of the gas + extinction of the particles, scattering = albedo * extinction of
the particles, and gas and particles emit at one temperature: emission = absorption of both * blackbody radiance.
"""

from __future__ import annotations

import abc
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxir.geometry import Rays
from jaxir.optics.gas import AbstractGas
from jaxir.optics.particle import AbstractParticles, AbstractPhase
from jaxir.optics.spectrum import Nodes, band_radiance


class Capsules(NamedTuple):
    """Rough pieces of a medium: where it is, and how bright.

    Attributes:
        ends: of their axes [capsule, 2, 3] [m].
        radius: [capsule] [m].
        intensity: [capsule, node] [W sr-1].
    """

    ends: Float[Array, "capsule 2 3"]
    radius: Float[Array, " capsule"]
    intensity: Float[Array, "capsule node"]


class AbstractMedium(eqx.Module):
    """A plume on the spectral nodes."""

    @abc.abstractmethod
    def radiance(
        self, rays: Rays, t_max: Float[Array, " ray"], behind: Float[Array, "ray node"], route: Any = None
    ) -> Float[Array, "ray node"]:
        """Radiance at the rays' origins of the medium in front of `behind`.

        Args:
            rays: the rays.
            t_max: where they end [ray] [m]; inf allowed.
            behind: radiance that enters them there [ray, node] [W m-2 sr-1].
            route: what `AbstractPlume.route` stored of the same rays; None to walk them.

        Returns:
            Radiance [ray, node] [W m-2 sr-1].
        """

    @abc.abstractmethod
    def transmittance(self, rays: Rays, t_max: Float[Array, " ray"]) -> Float[Array, "ray node"]:
        """Transmittance [ray, node] along rays up to `t_max` [ray] [m]; inf allowed."""

    @abc.abstractmethod
    def scattering(self, point: Float[Array, "ray 3"], cosine: Float[Array, " ray"]) -> Float[Array, "ray node"]:
        """Scattering coefficient times phase function [ray, node] [m-1 sr-1] at points [ray, 3] [m]."""

    @abc.abstractmethod
    def cuts(self, rays: Rays, t_max: Float[Array, " ray"]) -> Float[Array, "ray cut"]:
        """Distances, rising, between which the coefficients are smooth along rays [ray, cut] [m]; equal on a miss."""

    @abc.abstractmethod
    def coefficients(self, point: Float[Array, "ray 3"]) -> tuple[Float[Array, "ray node"], Float[Array, "ray node"]]:
        """Extinction [ray, node] [m-1] and emission [ray, node] [W m-3 sr-1] at points [ray, 3] [m]; 0 outside."""

    @abc.abstractmethod
    def capsules(self) -> Capsules:
        """Rough pieces that tell where it shines, each dimmed by itself."""

    @property
    @abc.abstractmethod
    def scatters(self) -> bool:
        """Whether there are particles in it."""

    @property
    @abc.abstractmethod
    def parts_with_particles(self) -> tuple[AbstractScatterer, ...]:
        """The media with particles of which it is made."""

    @abc.abstractmethod
    def less_forward(self, shares: Sequence[Float[Array, " node"]]) -> AbstractMedium:
        """The same, taking a share [node] of what each of `parts_with_particles` scatters as not scattered at all."""

    @abc.abstractmethod
    def brightened(self, factors: Sequence[Float[Array, ""]]) -> AbstractMedium:
        """The same with a factor on the emission of each plume of which it is made, a single one's in a list of one."""

    @property
    def beam_points(self) -> tuple[Float[Array, "point 3"], Bool[Array, " point"]]:
        """Where `in_scattered` asks for the irradiance of a beam [point, 3] [m], and where that matters [point]."""
        raise NotImplementedError(f"{type(self).__name__}: beams are sampled where paths are scattered")

    def in_scattered(
        self,
        irradiance: Float[Array, "point node"],
        cosine: Float[Array, " ray"],
        rays: Rays,
        t_max: Float[Array, " ray"],
    ) -> Float[Array, "ray node"]:
        """Light of a beam scattered once towards the rays' origins [ray, node] [W m-2 sr-1], summed without samples.

        Media of plumes with `AbstractPlume.sums_beams` alone have it and `beam_points`, and are asked for them.

        integral exp(-depth) scattering phase(cosine) irradiance dt

        Args:
            irradiance: across the beam at `beam_points` [point, node] [W m-2].
            cosine: between the beam and the light sent back along each ray [ray].
            rays: the rays.
            t_max: where they end [ray] [m].
        """
        raise NotImplementedError(f"{type(self).__name__}: beams are sampled where paths are scattered")

    def missed(
        self, irradiance: Float[Array, "point node"], travel: Float[Array, " 3"], direction: Float[Array, " 3"]
    ) -> Float[Array, "point node"]:
        """About what `in_scattered` lacks of the irradiance of a beam that travels so, for rays of a direction."""
        raise NotImplementedError(f"{type(self).__name__}: beams are sampled where paths are scattered")


class AbstractScatterer(AbstractMedium):
    """A medium that may have particles, all of one kind, in a space that a unit cube is mapped to."""

    @property
    @abc.abstractmethod
    def lobe(self) -> AbstractPhase | None:
        """Phase function of the particles; None without."""

    @abc.abstractmethod
    def less(self, share: Float[Array, " node"]) -> AbstractScatterer:
        """See `AbstractMedium.less_forward`."""

    @abc.abstractmethod
    def scattering_at(self, point: Float[Array, "ray 3"]) -> Float[Array, "ray node"]:
        """Scattering coefficient [ray, node] [m-1] at points [ray, 3] [m]; 0 outside."""

    @abc.abstractmethod
    def from_cube(self, place: Float[Array, "point 3"]) -> Float[Array, "point 3"]:
        """Points [point, 3] [m] of places in the unit cube; the medium lies in its image."""

    @abc.abstractmethod
    def to_cube(self, point: Float[Array, "ray 3"]) -> Float[Array, "ray 3"]:
        """The inverse of `from_cube`, of points in the medium."""

    @abc.abstractmethod
    def lattice(self, along: int, across: int) -> tuple[int, int, int]:
        """How many points the edges of the cube take, `along` the longest and at least `across` the others."""

    @property
    @abc.abstractmethod
    def frame(self) -> Float[Array, "3 3"]:
        """Rows are directions about which light in it is most alike, of unit length; the last is its axis."""

    @property
    @abc.abstractmethod
    def smooth(self) -> bool:
        """Whether it varies smoothly between its bounds."""

    @property
    def scatters(self) -> bool:
        """See `AbstractMedium.scatters`."""
        return self.lobe is not None

    @property
    def parts_with_particles(self) -> tuple[AbstractScatterer, ...]:
        """See `AbstractMedium.parts_with_particles`."""
        return (self,) if self.scatters else ()

    def less_forward(self, shares: Sequence[Float[Array, " node"]]) -> AbstractScatterer:
        """See `AbstractMedium.less_forward`."""
        return self.less(shares[0]) if self.scatters else self


class MediumOptics(NamedTuple):
    """Gas and particles together, each field [*cell, node]; `scattering` and `phase` are None without particles."""

    extinction: Float[Array, "*cell node"]
    emission: Float[Array, "*cell node"]
    scattering: Float[Array, "*cell node"] | None
    phase: AbstractPhase | None


def medium_optics(
    gas: AbstractGas, particles: AbstractParticles | None, nodes: Nodes, temperature: Float[Array, "*cell"]
) -> MediumOptics:
    """Optics of gas with particles at `temperature` [*cell] [K]. Differentiable in all but the nodes."""
    absorption, source = gas.absorption(nodes, temperature), band_radiance(temperature, nodes)
    if particles is None:
        return MediumOptics(absorption, absorption * source, None, None)
    optics = particles.optics(nodes)
    extinction = jnp.broadcast_to(optics.extinction, absorption.shape)
    albedo, absorbed = (share.reshape((1,) * temperature.ndim + (-1,)) for share in (optics.albedo, optics.absorbed))
    emission = (absorption + absorbed * extinction) * source
    return MediumOptics(absorption + extinction, emission, albedo * extinction, optics.phase)


def less_forward(
    extinction: Float[Array, "*state node"],
    scattering_coefficient: Float[Array, "*state node"] | None,
    share: Float[Array, " node"],
) -> tuple[Array, Array]:
    """Both coefficients where a share [node] of what is scattered is taken as not scattered at all."""
    assert scattering_coefficient is not None
    forward = scattering_coefficient * share.reshape((1,) * (extinction.ndim - 1) + (-1,))
    return extinction - forward, scattering_coefficient - forward


def scattered_at(
    scattering: Float[Array, "ray node"], phase: AbstractPhase, cosine: Float[Array, " ray"]
) -> Float[Array, "ray node"]:
    """Scattering coefficient times phase function [ray, node] [m-1 sr-1], one direction each."""
    return scattering * jax.vmap(phase.eval)(cosine)
