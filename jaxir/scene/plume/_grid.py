"""A plume given cell by cell."""

from __future__ import annotations

import itertools
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxir._arrays import Check, as_float, broadcast, thermal
from jaxir._fields import quantity, require_part
from jaxir._plausible import KELVIN
from jaxir.geometry import Crossings, Grid, Pieces, Rays, crossings, pdf_box
from jaxir.medium import CellMedium, Distance, cell_cuts, medium_optics, optical_depth, sample_in_cells
from jaxir.optics.gas import AbstractGas
from jaxir.optics.particle import EXAMPLE, AbstractParticles
from jaxir.optics.spectrum import Nodes
from jaxir.scene.plume._plume import AbstractPlume, Proposal

MOST_BRICKS = 32  # pieces at most
PROBED = 4096  # cells at most with which spectral nodes are chosen
_EDGES = [(a, b) for a in range(8) for b in range(a) if (a ^ b).bit_count() == 1]


class GridPlume(AbstractPlume):
    """A plume given cell by cell, as computed flow fields are.

    Attributes:
        grid: the cells.
        temperature: [nx, ny, nz] [K].
        gas: what absorbs and emits in the cells.
        particles: what scatters in them, and absorbs and emits at the gas's temperature; None for none.

    Differentiable in `temperature` and in the leaves of `gas` and `particles`; not in the grid.
    """

    grid: Grid
    temperature: Float[Array, "nx ny nz"] = quantity("K", ("nx", "ny", "nz"), (thermal, KELVIN))
    gas: AbstractGas
    particles: AbstractParticles | None

    def __init__(self, grid: Grid, temperature: Any, gas: AbstractGas, particles: AbstractParticles | None = None):
        """Join a grid with its fields; `temperature` may be one value for all cells [K]."""
        require_part("GridPlume.grid", grid, Grid, "a grid, e.g. jaxir.Grid(origin, spacing, shape)")
        require_part("GridPlume.gas", gas, AbstractGas, "a gas, e.g. jaxir.GrayGas({})")
        if particles is not None:
            require_part("GridPlume.particles", particles, AbstractParticles, EXAMPLE)
        value = as_float(temperature, "GridPlume.temperature")
        if value.shape not in ((), grid.shape):
            raise ValueError(f"GridPlume.temperature: got shape {value.shape}, expected one value or {grid.shape}")
        self.grid = grid
        self.temperature = broadcast(value, grid.shape)
        self.gas = gas
        if particles is not None and particles.cells not in ((), grid.shape):
            raise ValueError(f"GridPlume.particles: got cells {particles.cells}, expected none or {grid.shape}")
        self.particles = particles

    def doubts(self) -> list[Check]:
        """Temperatures are those that the gas's data reach."""
        return self.gas.reaches("GridPlume.temperature", self.temperature)

    def extent(self) -> Float[Array, "8 3"]:
        """See `AbstractPlume.extent`: corners of the grid."""
        return self.grid.corners()

    def thinned(self) -> GridPlume:
        """See `AbstractPlume.thinned`: every few cells along each axis, so that at most `PROBED` are left."""
        shape = self.grid.shape
        step = math.ceil((math.prod(shape) / PROBED) ** (1 / 3))
        if step <= 1:
            return self
        start = [min(step, n) // 2 for n in shape]
        few = tuple(slice(begin, None, step) for begin in start)

        def some(leaf: Any) -> Any:
            return jax.device_put(np.asarray(leaf)[few]) if leaf.shape[:3] == shape else leaf

        kept = tuple(len(range(begin, n, step)) for begin, n in zip(start, shape, strict=True))
        size = np.asarray(self.grid.size) / kept
        grid = Grid(self.grid.origin, size, (kept[0], kept[1], kept[2]))
        gas, particles = jax.tree.map(some, (self.gas, self.particles))
        return GridPlume(grid, some(self.temperature), gas, particles)

    def medium(self, nodes: Nodes) -> CellMedium:
        """See `AbstractPlume.medium`. Differentiable in temperature, gas and particles."""
        return CellMedium(self.grid, *medium_optics(self.gas, self.particles, nodes, self.temperature))

    def meets(self, rays: Rays, t_max: Float[Array, " ray"]) -> Bool[Array, " ray"]:
        """See `AbstractPlume.meets`: whether rays cross the grid."""
        box = jnp.ones((*self.grid.shape, 1), t_max.dtype)
        return optical_depth(self.grid, box, rays, t_max)[:, 0] > 0

    def route(self, rays: Rays, t_max: Float[Array, " ray"]) -> Crossings:
        """See `AbstractPlume.route`: the cells crossed."""
        return crossings(self.grid, rays, t_max)

    def cuts(self, rays: Rays, t_max: Float[Array, " ray"]) -> Float[Array, "ray cut"]:
        """See `AbstractPlume.cuts`."""
        return cell_cuts(self.grid, rays, t_max)

    def pieces(self, exponent: Float[Array, ""]) -> Pieces:
        """See `AbstractPlume.pieces`: bricks of cells; the hottest cell of each stands for it."""
        grid, parts = self.grid, [1, 1, 1]
        while 2 * np.prod(parts) <= MOST_BRICKS:
            axis = int(np.argmax(np.array(grid.shape) / parts))
            if 2 * parts[axis] > grid.shape[axis]:
                break
            parts[axis] *= 2
        cells = [-(-n // part) for n, part in zip(grid.shape, parts, strict=True)]
        edges = [np.append(np.arange(0, n, cell), n) for n, cell in zip(grid.shape, cells, strict=True)]
        bricks = [len(edge) - 1 for edge in edges]
        fill = [(0, brick * cell - n) for n, brick, cell in zip(grid.shape, bricks, cells, strict=True)]
        apart = jnp.pad(self.temperature, fill, mode="edge").reshape(
            tuple(itertools.chain.from_iterable(zip(bricks, cells, strict=True)))
        )
        hottest = jnp.max(apart, axis=(1, 3, 5)).reshape(-1)

        def at(fields: list[np.ndarray]) -> Array:
            mesh = np.stack(np.meshgrid(*fields, indexing="ij")).reshape(3, -1)
            return as_float(mesh) * grid.spacing[:, None]

        centre = at([(edge[1:] + edge[:-1]) / 2 for edge in edges]) + grid.origin[:, None]
        half = at([np.diff(edge) / 2 for edge in edges])
        warmth = (hottest / jnp.max(hottest)) ** exponent
        return Pieces(jnp.eye(3, dtype=half.dtype), centre, half, warmth / pdf_box(half))

    @property
    def parametric(self) -> bool:
        """See `AbstractPlume.parametric`."""
        return False

    @property
    def scatters(self) -> bool:
        """See `AbstractPlume.scatters`."""
        return self.particles is not None

    @property
    def sums_beams(self) -> bool:
        """See `AbstractPlume.sums_beams`."""
        return self.particles is not None

    def proposals(self, point: Float[Array, "ray 3"]) -> tuple[Proposal, ...]:
        """See `AbstractPlume.proposals`."""
        if self.particles is None:
            return ()
        extinction, phase = self.particles.proposal()
        place = (point - self.grid.origin[None]) / self.grid.spacing[None]
        inside = ((place >= 0) & (place < as_float(np.array(self.grid.shape))[None])).all(axis=1)
        cell = jnp.clip(place.astype(jnp.int32), 0, jnp.asarray(np.array(self.grid.shape) - 1, jnp.int32)[None])
        own = jnp.broadcast_to(extinction, self.grid.shape)[cell[:, 0], cell[:, 1], cell[:, 2]]
        return (Proposal(jnp.where(inside, own, 0), phase),)

    def sample_distance(
        self, rays: Rays, t_max: Float[Array, " ray"], u: Float[Array, " ray"], forced: Bool[Array, " ray"]
    ) -> Distance:
        """See `AbstractPlume.sample_distance`."""
        assert self.particles is not None
        extinction = jnp.broadcast_to(self.particles.proposal()[0], self.grid.shape)
        return sample_in_cells(self.grid, extinction, rays, t_max, u, forced)

    def hottest(self) -> Float[Array, ""]:
        """See `AbstractPlume.hottest`."""
        return jnp.max(self.temperature)

    def described(self) -> str:
        """See `AbstractPlume.described`."""
        return f"plume, {' x '.join(map(str, self.grid.shape))} cells"

    def outlines(self) -> list[np.ndarray]:
        """See `AbstractPlume.outlines`: edges of the grid's box."""
        corner = np.asarray(self.extent(), np.float64)
        return [np.stack([corner[a], corner[b]]) for a, b in _EDGES]
