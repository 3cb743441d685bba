"""What a plume does to a ray: the one interface between paths and every way a plume can be given."""

from __future__ import annotations

import abc

import equinox as eqx
from jaxtyping import Array, Float, Key

from jaxir.geometry.grid import Grid
from jaxir.geometry.ray import Rays
from jaxir.geometry.walk import Crossings
from jaxir.optics.band import Nodes
from jaxir.optics.planck import band_radiance
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


class GridMedium(AbstractMedium):
    """Cells.

    Attributes:
        grid: the cells.
        extinction: [nx, ny, nz, node] [m-1].
        emission: absorption times blackbody radiance [nx, ny, nz, node] [W m-3 sr-1].
    """

    grid: Grid
    extinction: Float[Array, "nx ny nz node"]
    emission: Float[Array, "nx ny nz node"]

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


def grid_medium(plume: GridPlume, nodes: Nodes) -> GridMedium:
    """A gridded plume on the nodes. Differentiable in its temperature and gas."""
    extinction = plume.gas.absorption(nodes, plume.temperature)
    return GridMedium(plume.grid, extinction, extinction * band_radiance(plume.temperature, nodes))
