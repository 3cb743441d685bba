"""The exact radiance of a gridded medium along rays that were traced before.

Value and first derivatives stream through the lists as `march` streams through the grid, with the same recurrences.
"""

from __future__ import annotations

from jaxtyping import Array, Float

from jaxir.geometry import Crossings
from jaxir.medium._march import listed_sum, radiance_primitive


def crossing_sum(
    crossings: Crossings,
    extinction: Float[Array, "cell node"],
    emission: Float[Array, "cell node"],
    behind: Float[Array, "ray node"],
) -> Float[Array, "ray node"]:
    """Radiance at the origins of traced rays: the same sum as `march`, over stored lists of cells.

    Trace once, evaluate often: a fit that changes the state of the medium, or many spectral nodes, walk the grid
    only once. Beyond the first derivatives memory grows with crossings times nodes.

    Args:
        crossings: the cells of each ray, near to far.
        extinction: [cell, node] [m-1], >= 0; cells in C order.
        emission: absorption times source [cell, node] [W m-3 sr-1].
        behind: radiance that enters each ray at its end [ray, node] [W m-2 sr-1].

    Returns:
        Radiance [ray, node] [W m-2 sr-1].

    Differentiable in extinction, emission, behind, crossings.length, forward and reverse, to any order.
    """
    if 0 in behind.shape or crossings.bound == 0:
        return behind
    return listed_p.bind(extinction, emission, behind, crossings.cell, crossings.length, shape=None)[0]


listed_p = radiance_primitive("crossing_sum", 2, listed_sum)
