"""A medium of homogeneous cells."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxir._arrays import as_float
from jaxir.geometry import Crossings, Grid, Rays, crossings
from jaxir.medium._crossing_sum import crossing_sum
from jaxir.medium._march import march, transmittance
from jaxir.medium._medium import AbstractScatterer, Capsules, less_forward, scattered_at
from jaxir.optics import phi1
from jaxir.optics.particle import AbstractPhase

BLOCKS = 24  # most capsules along each axis
OFF = 2  # points more than asked for along an axis at most
BESIDE = 1e-3  # cells by which a scattered point may lie beside the grid by rounding


class CellMedium(AbstractScatterer):
    """Cells of a grid, each homogeneous.

    Attributes:
        grid: the cells.
        extinction: [nx, ny, nz, node] [m-1].
        emission: absorption times blackbody radiance [nx, ny, nz, node] [W m-3 sr-1].
        scattering_coefficient: [nx, ny, nz, node] [m-1]; None without particles.
        phase: phase function of the particles; None without.
    """

    grid: Grid
    extinction: Float[Array, "nx ny nz node"]
    emission: Float[Array, "nx ny nz node"]
    scattering_coefficient: Float[Array, "nx ny nz node"] | None
    phase: AbstractPhase | None

    def radiance(
        self,
        rays: Rays,
        t_max: Float[Array, " ray"],
        behind: Float[Array, "ray node"],
        route: Crossings | None = None,
    ) -> Float[Array, "ray node"]:
        """See `AbstractMedium.radiance`: the exact sum over the cells crossed.

        With a route differentiable to any order, without it once; in all but the geometry.
        """
        if route is None:
            return march(self.grid, self.extinction, self.emission, rays, t_max, behind)
        cells = (-1, self.extinction.shape[-1])
        return crossing_sum(route, self.extinction.reshape(cells), self.emission.reshape(cells), behind)

    def transmittance(self, rays: Rays, t_max: Float[Array, " ray"]) -> Float[Array, "ray node"]:
        """See `AbstractMedium.transmittance`."""
        return transmittance(self.grid, self.extinction, rays, t_max)

    def scattering(self, point: Float[Array, "ray 3"], cosine: Float[Array, " ray"]) -> Float[Array, "ray node"]:
        """See `AbstractMedium.scattering`; beside the grid by rounding, the nearest cell's, and 0 further out."""
        assert self.scattering_coefficient is not None and self.phase is not None
        held, inside = self._cell(point, BESIDE)
        return scattered_at(jnp.where(inside, self.scattering_coefficient[held], 0), self.phase, cosine)

    @property
    def lobe(self) -> AbstractPhase | None:
        """See `AbstractScatterer.lobe`."""
        return self.phase

    def less(self, share: Float[Array, " node"]) -> CellMedium:
        """See `AbstractScatterer.less`."""
        extinction, scattering = less_forward(self.extinction, self.scattering_coefficient, share)
        return dataclasses.replace(self, extinction=extinction, scattering_coefficient=scattering)

    def brightened(self, factors: Sequence[Float[Array, ""]]) -> CellMedium:
        """See `AbstractMedium.brightened`."""
        (factor,) = factors
        return dataclasses.replace(self, emission=self.emission * factor)

    def scattering_at(self, point: Float[Array, "ray 3"]) -> Float[Array, "ray node"]:
        """See `AbstractScatterer.scattering_at`."""
        assert self.scattering_coefficient is not None
        held, inside = self._cell(point, 0.0)
        return jnp.where(inside, self.scattering_coefficient[held], 0)

    def from_cube(self, place: Float[Array, "point 3"]) -> Float[Array, "point 3"]:
        """See `AbstractScatterer.from_cube`: the grid's box."""
        return self.grid.origin[None] + place * self.grid.size[None]

    def to_cube(self, point: Float[Array, "ray 3"]) -> Float[Array, "ray 3"]:
        """See `AbstractScatterer.to_cube`."""
        return (point - self.grid.origin[None]) / self.grid.size[None]

    @property
    def frame(self) -> Float[Array, "3 3"]:
        """See `AbstractScatterer.frame`: edges of the cells, the last that which is least like the others."""
        size = self.grid.size
        short, middle, long = jnp.sort(size)
        from_last = jnp.argmax(jnp.where(middle**2 > short * long, -size, size)[::-1])  # of a cube the last
        return jnp.roll(as_float(np.eye(3)), from_last, axis=0)

    @property
    def smooth(self) -> bool:
        """See `AbstractScatterer.smooth`: it jumps from cell to cell."""
        return False

    def lattice(self, along: int, across: int) -> tuple[int, int, int]:
        """See `AbstractScatterer.lattice`: by the numbers of cells, of which up to `OFF` more leave fewest on sides."""
        most = max(self.grid.shape)
        first, second, third = (_off_sides(max(across, -(-along * cells // most)), cells) for cells in self.grid.shape)
        return first, second, third

    def cuts(self, rays: Rays, t_max: Float[Array, " ray"]) -> Float[Array, "ray cut"]:
        """See `AbstractMedium.cuts`: where rays pass from cell to cell."""
        return cell_cuts(self.grid, rays, t_max)

    def coefficients(self, point: Float[Array, "ray 3"]) -> tuple[Float[Array, "ray node"], Float[Array, "ray node"]]:
        """See `AbstractMedium.coefficients`."""
        held, inside = self._cell(point, 0.0)
        return jnp.where(inside, self.extinction[held], 0), jnp.where(inside, self.emission[held], 0)

    def capsules(self) -> Capsules:
        """See `AbstractMedium.capsules`: blocks of cells as balls, where in them and as large as what emits."""
        grid, shape = self.grid, self.grid.shape
        size = grid.spacing * as_float(np.array(shape))
        emitted = self.emission * phi1(self.extinction * jnp.min(size)) * jnp.prod(grid.spacing)
        step = tuple(-(-count // BLOCKS) for count in shape)
        blocks = tuple(-(-count // each) for count, each in zip(shape, step, strict=True))
        pads = [(0, b * s - n) for b, s, n in zip(blocks, step, shape, strict=True)]

        def in_blocks(value: Float[Array, "nx ny nz some"]) -> Float[Array, "block some"]:
            padded = jnp.pad(value, [*pads, (0, 0)])
            split = padded.reshape(blocks[0], step[0], blocks[1], step[1], blocks[2], step[2], -1)
            return split.sum(axis=(1, 3, 5)).reshape(math.prod(blocks), -1)

        most = emitted.max(axis=(0, 1, 2), keepdims=True)
        share = jnp.mean(emitted / jnp.where(most > 0, most, 1), axis=-1, keepdims=True) + jnp.finfo(most.dtype).tiny
        total = in_blocks(share)
        centre = in_blocks(share * grid.centres()) / total
        # as many cells as would vary so much if they emitted alike
        cells = total[:, 0] ** 2 / jnp.maximum(in_blocks(share**2)[:, 0], jnp.finfo(most.dtype).tiny)
        filled = jnp.clip(cells / math.prod(step), 1 / math.prod(step), 1) ** (1 / 3)
        radius = filled * jnp.max(grid.spacing * as_float(np.array(step))) / 2
        return Capsules(jnp.repeat(centre[:, None], 2, axis=1), radius, in_blocks(emitted))

    @property
    def beam_points(self) -> tuple[Float[Array, "point 3"], Bool[Array, " point"]]:
        """See `AbstractMedium.beam_points`: the centres of all cells, those with particles."""
        assert self.scattering_coefficient is not None
        return self.grid.centres().reshape(-1, 3), jnp.any(self.scattering_coefficient > 0, axis=-1).reshape(-1)

    def in_scattered(
        self,
        irradiance: Float[Array, "point node"],
        cosine: Float[Array, " ray"],
        rays: Rays,
        t_max: Float[Array, " ray"],
    ) -> Float[Array, "ray node"]:
        """See `AbstractMedium.in_scattered`; every cell is lit as its centre is."""
        assert self.scattering_coefficient is not None and self.phase is not None
        dark = jnp.zeros((rays.count, self.extinction.shape[-1]), self.extinction.dtype)
        source = self.scattering_coefficient * irradiance.reshape(self.scattering_coefficient.shape)
        sent = march(self.grid, self.extinction, source, rays, t_max, dark)
        return sent * jax.vmap(self.phase.eval)(cosine)

    def missed(
        self, irradiance: Float[Array, "point node"], travel: Float[Array, " 3"], direction: Float[Array, " 3"]
    ) -> Float[Array, "point node"]:
        """See `AbstractMedium.missed`: sum_i d_i (d_i + 2 u_i) / 24 of every cell's share, by the axes i of the grid.

        To second order: d_i is the step of the beam's optical depth to the next cell, the larger one, or that of the
        cell along the beam where no next one is lit, u_i that of the cell along the ray.
        """
        size, along = self.grid.spacing, jnp.abs(travel)
        alone = self.extinction * jnp.min(jnp.where(along > 0, size / jnp.where(along > 0, along, 1), jnp.inf))
        lit, share = irradiance.reshape(alone.shape), jnp.zeros_like(alone)
        for axis in range(3):
            first, second = (lax.slice_in_dim(lit, *ends, axis=axis) for ends in ((0, -1), (1, None)))
            both = (first > 0) & (second > 0)
            step = jnp.where(both, jnp.abs(jnp.log(jnp.where(both, first / jnp.where(both, second, 1), 1))), -1)
            ends = [[(int(i == axis) * side, int(i == axis) * (1 - side)) for i in range(4)] for side in (0, 1)]
            found = functools.reduce(jnp.maximum, [jnp.pad(step, pads, constant_values=-1) for pads in ends])
            own = jnp.where(found < 0, alone, found)
            share = share + own * (own + 2 * self.extinction * size[axis] * jnp.abs(direction[axis])) / 24
        return irradiance * share.reshape(irradiance.shape)

    def _cell(self, point: Float[Array, "ray 3"], margin: float) -> tuple[tuple[Array, ...], Bool[Array, "ray 1"]]:
        """Indices of the cells of points, and whether these lie inside the grid or within `margin` cells of it.

        Of two grids that share a face its points lie in one alone, as for rays that are walked.
        """
        place, count = (point - self.grid.origin[None]) / self.grid.spacing[None], np.array(self.grid.shape)
        inside = ((place >= -margin) & (place < as_float(count)[None] + margin)).all(axis=1)[:, None]
        cell = jnp.clip(jnp.floor(place).astype(jnp.int32), 0, jnp.asarray(count - 1, jnp.int32)[None])
        return (cell[:, 0], cell[:, 1], cell[:, 2]), inside


def cell_cuts(grid: Grid, rays: Rays, t_max: Float[Array, " ray"]) -> Float[Array, "ray cut"]:
    """Distances at which rays pass from cell to cell, rising [ray, cut] [m]; equal on a miss."""
    length = crossings(grid, rays, t_max).length
    begin = jax.vmap(grid.entry)(rays.origin, rays.direction)[:, None]
    return jnp.concatenate([begin, begin + jnp.cumsum(length, axis=1)], axis=1)


def _off_sides(points: int, cells: int) -> int:
    """So many points along an edge of a lattice, or up to `OFF` more, of which fewest lie between two cells.

    Light bends from cell to cell. Points at every bend see the ends of cells alone, and what is read between them lies
    on the same side of the truth in each.
    """
    return min(range(points, points + OFF + 1), key=lambda count: math.gcd(count - 1, cells))
