"""Plumes: where the gas is, how hot it is, and which gas it is."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._arrays import Check, as_float, positive
from jaxir.geometry import Grid
from jaxir.optics.gas import AbstractGas
from jaxir.optics.particle import AbstractParticles


class GridPlume(eqx.Module):
    """A plume given cell by cell, as computed flow fields are.

    Attributes:
        grid: the cells.
        temperature: [nx, ny, nz] [K].
        gas: what absorbs and emits in the cells.
        particles: what scatters in them, and absorbs and emits at the gas's temperature; None for none.

    Differentiable in `temperature` and in the leaves of `gas` and `particles`; not in the grid.
    """

    grid: Grid
    temperature: Float[Array, "nx ny nz"]
    gas: AbstractGas
    particles: AbstractParticles | None

    def __init__(self, grid: Grid, temperature: Any, gas: AbstractGas, particles: AbstractParticles | None = None):
        """Join a grid with its fields; `temperature` may be one value for all cells [K]."""
        value = as_float(temperature, "GridPlume.temperature")
        if value.shape not in ((), grid.shape):
            raise ValueError(f"GridPlume.temperature: got shape {value.shape}, expected one value or {grid.shape}")
        self.grid = grid
        self.temperature = jnp.broadcast_to(value, grid.shape)
        self.gas = gas
        if particles is not None and particles.cells not in ((), grid.shape):
            raise ValueError(f"GridPlume.particles: got cells {particles.cells}, expected none or {grid.shape}")
        self.particles = particles

    def extent(self) -> Float[Array, "8 3"]:
        """Points whose convex hull holds the plume [8, 3] [m]: corners of the grid."""
        return self.grid.corners()

    def checks(self) -> list[Check]:
        """Cells have positive size, temperatures are positive, the fields of gas and particles in range."""
        particles = [] if self.particles is None else self.particles.checks()
        temperature = positive("GridPlume.temperature", self.temperature)
        return [*self.grid.checks(), temperature, *self.gas.checks(), *particles]
