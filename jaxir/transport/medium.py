"""What a plume does to a ray: the one interface between paths and every way a plume can be given.

With particles, extinction = absorption of the gas + extinction of the particles, scattering = albedo * extinction of
the particles, and gas and particles emit at one temperature: emission = absorption of both * blackbody radiance.
"""

from __future__ import annotations

import abc
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from jaxir.geometry import Crossings, Grid, Rays
from jaxir.optics.gas import AbstractGas
from jaxir.optics.particle import AbstractParticles, AbstractPhase
from jaxir.optics.spectrum import Nodes, band_radiance
from jaxir.scene.plume import GridPlume
from jaxir.transport.crossing_sum import crossing_sum
from jaxir.transport.march import march, transmittance
from jaxir.transport.path_estimator import AbstractPathEstimator, sampled_march


class AbstractMedium(eqx.Module):
    """A plume on the spectral nodes."""

    @abc.abstractmethod
    def leg(
        self, rays: Rays, t_max: Float[Array, " ray"], behind: Float[Array, "ray node"]
    ) -> Float[Array, "ray node"]:
        """Radiance [ray, node] at the rays' origins of the plume in front of `behind`, met at `t_max` [ray] [m]."""

    @abc.abstractmethod
    def transmittance(self, rays: Rays, t_max: Float[Array, " ray"]) -> Float[Array, "ray node"]:
        """Transmittance [ray, node] of the plume along rays up to `t_max` [ray] [m]; inf allowed."""

    @abc.abstractmethod
    def scattering_at(self, point: Float[Array, "ray 3"]) -> Float[Array, "ray node"]:
        """Scattering coefficient [ray, node] [m-1] at points [ray, 3] [m] of a plume with particles."""


class PlumeOptics(NamedTuple):
    """Gas and particles together, each field [*cell, node]; `scattering` and `phase` are None without particles."""

    extinction: Float[Array, "*cell node"]
    emission: Float[Array, "*cell node"]
    scattering: Float[Array, "*cell node"] | None
    phase: AbstractPhase | None


def plume_optics(
    gas: AbstractGas, particles: AbstractParticles | None, nodes: Nodes, temperature: Float[Array, "*cell"]
) -> PlumeOptics:
    """Optics of gas with particles at `temperature` [*cell] [K]. Differentiable in all but the nodes."""
    absorption, source = gas.absorption(nodes, temperature), band_radiance(temperature, nodes)
    if particles is None:
        return PlumeOptics(absorption, absorption * source, None, None)
    optics = particles.optics(nodes)
    extinction = jnp.broadcast_to(optics.extinction, absorption.shape)
    albedo, absorbed = (share.reshape((1,) * temperature.ndim + (-1,)) for share in (optics.albedo, optics.absorbed))
    emission = (absorption + absorbed * extinction) * source
    return PlumeOptics(absorption + extinction, emission, albedo * extinction, optics.phase)


class GridMedium(AbstractMedium):
    """Cells.

    Attributes:
        grid: the cells.
        extinction: [nx, ny, nz, node] [m-1].
        emission: absorption times blackbody radiance [nx, ny, nz, node] [W m-3 sr-1].
        scattering: [nx, ny, nz, node] [m-1]; None without particles.
        phase: phase function of the particles; None without.
    """

    grid: Grid
    extinction: Float[Array, "nx ny nz node"]
    emission: Float[Array, "nx ny nz node"]
    scattering: Float[Array, "nx ny nz node"] | None
    phase: AbstractPhase | None

    def leg(
        self, rays: Rays, t_max: Float[Array, " ray"], behind: Float[Array, "ray node"]
    ) -> Float[Array, "ray node"]:
        """See `AbstractMedium.leg`; the exact sum over the cells crossed."""
        return march(self.grid, self.extinction, self.emission, rays, t_max, behind)

    def listed_leg(self, crossings: Crossings, behind: Float[Array, "ray node"]) -> Float[Array, "ray node"]:
        """`leg` over cells that were listed before."""
        cells = (-1, self.extinction.shape[-1])
        return crossing_sum(crossings, self.extinction.reshape(cells), self.emission.reshape(cells), behind)

    def sampled_leg(
        self,
        path: AbstractPathEstimator,
        rays: Rays,
        t_max: Float[Array, " ray"],
        behind: Float[Array, "ray node"],
        key: Key[Array, ""],
    ) -> Float[Array, "ray node"]:
        """`leg` by an estimator that samples a place on every ray."""
        cells = (-1, self.extinction.shape[-1])
        extinction, emission = self.extinction.reshape(cells), self.emission.reshape(cells)
        return sampled_march(path, self.grid, extinction, emission, rays, t_max, behind, key)

    def transmittance(self, rays: Rays, t_max: Float[Array, " ray"]) -> Float[Array, "ray node"]:
        """See `AbstractMedium.transmittance`."""
        return transmittance(self.grid, self.extinction, rays, t_max)

    def scattering_at(self, point: Float[Array, "ray 3"]) -> Float[Array, "ray node"]:
        """See `AbstractMedium.scattering_at`; beside the grid by rounding, the nearest cell's."""
        assert self.scattering is not None
        place = jnp.floor((point - self.grid.origin[None]) / self.grid.spacing[None]).astype(jnp.int32)
        x, y, z = (jnp.clip(place[:, axis], 0, count - 1) for axis, count in enumerate(self.grid.shape))
        return self.scattering[x, y, z]

    def in_scattered(
        self,
        irradiance: Float[Array, "nx ny nz node"],
        cosine: Float[Array, " ray"],
        rays: Rays,
        t_max: Float[Array, " ray"],
    ) -> Float[Array, "ray node"]:
        """Light of a beam scattered once towards the rays' origins [ray, node] [W m-2 sr-1].

        integral exp(-depth) scattering phase(cosine) irradiance dt, with one irradiance in each cell.

        Args:
            irradiance: across the beam in each cell [nx, ny, nz, node] [W m-2].
            cosine: between the beam and the light sent back along each ray [ray].
            rays: the rays.
            t_max: where they end [ray] [m].
        """
        assert self.scattering is not None and self.phase is not None
        dark = jnp.zeros((rays.count, self.extinction.shape[-1]), self.extinction.dtype)
        sent = march(self.grid, self.extinction, self.scattering * irradiance, rays, t_max, dark)
        return sent * jax.vmap(self.phase.eval)(cosine)


def grid_medium(plume: GridPlume, nodes: Nodes) -> GridMedium:
    """A gridded plume on the nodes. Differentiable in its temperature, gas and particles."""
    return GridMedium(plume.grid, *plume_optics(plume.gas, plume.particles, nodes, plume.temperature))
