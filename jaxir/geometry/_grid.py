"""A regular grid of cells."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxir._arrays import Check, as_float, finite, positive, require_shape, told_apart
from jaxir._fields import require_counts
from jaxir._plausible import EXTENT


class Grid(eqx.Module):
    """A box of equal cells, axes along the scene's axes.

    Attributes:
        origin: corner of cell (0, 0, 0) with the smallest coordinates [3] [m].
        spacing: cell size along x, y, z [3] [m].
        shape: number of cells along x, y, z.
    """

    origin: Float[Array, " 3"]
    spacing: Float[Array, " 3"]
    shape: tuple[int, int, int] = eqx.field(static=True)

    def __init__(self, origin: Any, spacing: Any, shape: tuple[int, int, int]):
        self.origin = as_float(origin, "Grid.origin")
        self.spacing = as_float(spacing, "Grid.spacing")
        require_shape("Grid.origin", self.origin, (3,))
        require_shape("Grid.spacing", self.spacing, (3,))
        x, y, z = require_counts("Grid.shape", shape, "three numbers of cells", 3)
        self.shape = (x, y, z)

    def centres(self) -> Float[Array, "nx ny nz 3"]:
        """Cell centres [nx, ny, nz, 3] [m]."""
        axes = [self.origin[a] + self.spacing[a] * (as_float(np.arange(n)) + 0.5) for a, n in enumerate(self.shape)]
        return jnp.stack(jnp.meshgrid(*axes, indexing="ij"), axis=-1)

    def corners(self) -> Float[Array, "8 3"]:
        """The eight corners of the box [8, 3] [m]."""
        unit = as_float(np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)]))
        return self.origin[None, :] + unit * self.size[None, :]

    def entry(self, origin: Float[Array, " 3"], direction: Float[Array, " 3"]) -> Float[Array, ""]:
        """Where a ray enters the box, if it does; 0 from inside [m]."""
        moving = direction != 0
        safe = jnp.where(moving, direction, 1)
        near, far = ((corner - origin) / safe for corner in (self.origin, self.origin + self.size))
        return jnp.max(jnp.where(moving, jnp.minimum(near, far), 0), initial=0)

    @property
    def size(self) -> Float[Array, " 3"]:
        """Edges of the box [3] [m]."""
        return self.spacing * as_float(np.array(self.shape))

    def checks(self) -> list[Check]:
        """The corner is finite, cells have positive size; the box is as large as a plume is."""
        return [
            finite("Grid.origin", self.origin),
            positive("Grid.spacing", self.spacing),
            told_apart("Grid.origin", self.origin, self.spacing, "cells"),
            EXTENT("Grid: longest side", self.spacing, lambda cell: (cell * np.array(self.shape)).max(axis=-1)),
        ]
