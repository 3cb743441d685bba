"""Particles in a gas: extinction, albedo and phase function per node.

A plume with particles has, in a cell, extinction = absorption of the gas + extinction of the particles, scattering =
albedo * extinction of the particles, and the particles' phase function.
"""

from __future__ import annotations

import abc
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from jaxir._arrays import as_float
from jaxir._fields import Physical
from jaxir.optics.particle._phase import AbstractPhase
from jaxir.optics.spectrum import Nodes


class ParticleOptics(eqx.Module):
    """Particles on spectral nodes.

    Attributes:
        extinction: [*cell, node] [m-1].
        albedo: share of the extinction that is scattering [node].
        absorbed: share that is absorption, 1 - albedo but not its rounding [node].
        phase: phase function.
    """

    extinction: Float[Array, "*cell node"]
    albedo: Float[Array, " node"]
    absorbed: Float[Array, " node"]
    phase: AbstractPhase


EXAMPLE = "particles, e.g. jaxir.GrayParticles(extinction, albedo, jaxir.Isotropic())"  # for errors


class AbstractParticles(Physical):
    """Particles of one kind, more or fewer of them in each cell."""

    @property
    @abc.abstractmethod
    def cells(self) -> tuple[int, ...]:
        """Shape of the cell axes; () for the same everywhere."""

    @property
    @abc.abstractmethod
    def amount(self) -> Any:
        """The leaf that scales with the number of particles; of any kind, as those of `AbstractGas.amounts`."""

    @abc.abstractmethod
    def optics(self, nodes: Nodes) -> ParticleOptics:
        """Extinction, albedo and phase function on `nodes`."""

    @abc.abstractmethod
    def diluted(self, amount: Float[Array, "*cell"]) -> AbstractParticles:
        """These particles, the same everywhere, `amount` [*cell] times as many; with fields per cell."""

    @abc.abstractmethod
    def proposal(self) -> tuple[Float[Array, "*cell"], AbstractPhase]:
        """A typical extinction [*cell] [m-1] and phase function, by which places and directions are drawn.

        They decide the variance of what is scattered and nothing else: it is the optics on the nodes that counts.
        """


def exact_difference(whole: Any, part: Any) -> Array:
    """`whole` - `part`, in float64 if both are known: no digit of a small difference of large numbers is lost."""
    try:
        return as_float(np.asarray(whole, np.float64) - np.asarray(part, np.float64))
    except TypeError:  # traced
        return as_float(whole) - as_float(part)


def number_density(
    mass_flow: Any, material_density: Any, speed: Any, cross_section: Any, volume: Any
) -> Float[Array, "*batch"]:
    """Particles per volume of a stream, mass_flow / (material_density * volume * speed * cross_section).

    Args:
        mass_flow: of particles [kg/s].
        material_density: of the particles' substance [kg/m3].
        speed: of the stream [m/s].
        cross_section: of the stream [m2].
        volume: mean volume of a particle [m3], `ParticleTable.volume`.

    Returns:
        Number density [m-3].

    Differentiable in all.
    """
    flow, density, speed, area, volume = (
        as_float(value, name)
        for name, value in (
            ("mass_flow", mass_flow),
            ("material_density", material_density),
            ("speed", speed),
            ("cross_section", cross_section),
            ("volume", volume),
        )
    )
    return flow / (density * speed * area) / volume
