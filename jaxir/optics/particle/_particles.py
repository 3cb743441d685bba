"""Particles in a gas: extinction, albedo and phase function per node.

A plume with particles has, in a cell, extinction = absorption of the gas + extinction of the particles, scattering =
albedo * extinction of the particles, and the particles' phase function.
"""

from __future__ import annotations

import abc
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxir._arrays import Check, as_float, fraction, non_negative, positive, require_shape
from jaxir.optics._tables import sample_weights
from jaxir.optics.particle._phase import AbstractPhase, TabulatedPhase, cosine_checks
from jaxir.optics.spectrum import Nodes, bins_inside


def _exact_difference(whole: Any, part: Any) -> Array:
    """`whole` - `part`, in float64 if both are known: no digit of a small difference of large numbers is lost."""
    try:
        return as_float(np.asarray(whole, np.float64) - np.asarray(part, np.float64))
    except TypeError:  # traced
        return as_float(whole) - as_float(part)


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


class AbstractParticles(eqx.Module):
    """Particles of one kind, more or fewer of them in each cell."""

    @property
    @abc.abstractmethod
    def cells(self) -> tuple[int, ...]:
        """Shape of the cell axes; () for the same everywhere."""

    @abc.abstractmethod
    def optics(self, nodes: Nodes) -> ParticleOptics:
        """Extinction, albedo and phase function on `nodes`."""

    @abc.abstractmethod
    def diluted(self, amount: Float[Array, "*cell"]) -> AbstractParticles:
        """These particles, the same everywhere, `amount` [*cell] times as many; with fields per cell."""

    @abc.abstractmethod
    def guide(self) -> tuple[Float[Array, "*cell"], AbstractPhase]:
        """A typical extinction [*cell] [m-1] and phase function, by which places and directions are drawn.

        They decide the variance of what is scattered and nothing else: it is the optics on the nodes that counts.
        """

    @abc.abstractmethod
    def checks(self) -> list[Check]:
        """What must hold of the fields' values."""


class GrayParticles(AbstractParticles):
    """Particles whose extinction and albedo are given.

    Attributes:
        extinction: [*cell, node or 1] [m-1].
        albedo: [node or 1].
        rest: what the numbers given as albedo lost by rounding, so that 1 - albedo - rest is right however small it
            is [node or 1]; 0 for an array of the floating dtype in force.
        phase: phase function.

    Differentiable in all but `rest`.
    """

    extinction: Float[Array, "*cell node"]
    albedo: Float[Array, " node"]
    rest: Float[Array, " node"]
    phase: AbstractPhase

    def __init__(self, extinction: Any, albedo: Any, phase: AbstractPhase):
        """Convert; a number of `extinction` is the same in every cell and node."""
        value, share = as_float(extinction, "GrayParticles.extinction"), as_float(albedo, "GrayParticles.albedo")
        self.extinction = value[None] if value.ndim == 0 else value
        self.albedo = share[None] if share.ndim == 0 else share
        self.rest = _exact_difference(albedo, self.albedo)
        require_shape("GrayParticles.albedo", self.albedo, ("node",))
        self.phase = phase

    def optics(self, nodes: Nodes) -> ParticleOptics:
        """See `AbstractParticles.optics`."""
        for field, value in (("extinction", self.extinction), ("albedo", self.albedo)):
            if value.shape[-1] not in (1, nodes.count):
                raise ValueError(f"GrayParticles.{field}: got {value.shape[-1]} nodes, expected {nodes.count} or 1")
        extinction = jnp.broadcast_to(self.extinction, self.extinction.shape[:-1] + (nodes.count,))
        albedo = jnp.broadcast_to(self.albedo, (nodes.count,))
        absorbed = jnp.broadcast_to((1 - self.albedo) - lax.stop_gradient(self.rest), (nodes.count,))
        return ParticleOptics(extinction, albedo, absorbed, self.phase)

    @property
    def cells(self) -> tuple[int, ...]:
        """See `AbstractParticles.cells`."""
        return self.extinction.shape[:-1]

    def diluted(self, amount: Float[Array, "*cell"]) -> GrayParticles:
        """See `AbstractParticles.diluted`.

        Raises:
            ValueError: the extinction already differs from cell to cell.
        """
        if self.cells:
            raise ValueError(
                f"GrayParticles.extinction: got shape {self.extinction.shape}, expected one value or (node,): "
                "particles that are the same everywhere before they are diluted"
            )
        extinction = amount[..., None] * self.extinction.reshape((1,) * amount.ndim + (-1,))
        return eqx.tree_at(lambda particles: particles.extinction, self, extinction)

    def guide(self) -> tuple[Float[Array, "*cell"], AbstractPhase]:
        """See `AbstractParticles.guide`: the mean over the nodes."""
        return jnp.mean(self.extinction, axis=-1), self.phase

    def checks(self) -> list[Check]:
        """Extinction is >= 0, the albedo lies in [0, 1]."""
        return [
            non_negative("GrayParticles.extinction", self.extinction),
            fraction("GrayParticles.albedo", self.albedo),
            *self.phase.checks(),
        ]


class ParticleTable(eqx.Module):
    """Optical properties of one (mean) particle over wavenumber, linear between samples; `mie_table` makes it.

    Attributes:
        wavenumber: increasing [sample] [cm-1].
        absorption: cross-section, the difference of those given, without loss where they are given in float64 [sample]
            [m2].
        scattering: cross-section [sample] [m2].
        volume: mean volume of a particle [m3].
        cosine: of the scattering angle, increasing from -1 to 1 [angle].
        phase: phase function [sample, angle] [sr-1].

    Differentiable in every field but `wavenumber` and `cosine`.
    """

    wavenumber: Float[Array, " sample"]
    absorption: Float[Array, " sample"]
    scattering: Float[Array, " sample"]
    volume: Float[Array, ""]
    cosine: Float[Array, " angle"]
    phase: Float[Array, "sample angle"]

    def __init__(self, wavenumber: Any, extinction: Any, scattering: Any, volume: Any, cosine: Any, phase: Any):
        fields = {"wavenumber": wavenumber, "extinction": extinction, "scattering": scattering}
        fields |= {"volume": volume, "cosine": cosine, "phase": phase}
        fields = {name: as_float(value, f"ParticleTable.{name}") for name, value in fields.items()}
        samples, angles = fields["wavenumber"].shape, fields["cosine"].shape
        shapes = {"wavenumber": ("sample",), "extinction": samples, "scattering": samples}
        shapes |= {"volume": (), "cosine": ("angle",), "phase": samples + angles}
        for name, shape in shapes.items():
            require_shape(f"ParticleTable.{name}", fields[name], shape)
        if samples[0] < 2:
            raise ValueError("ParticleTable.wavenumber: got one sample, expected at least two")
        self.wavenumber, self.volume, self.cosine = fields["wavenumber"], fields["volume"], fields["cosine"]
        self.absorption, self.scattering = _exact_difference(extinction, scattering), fields["scattering"]
        self.phase = fields["phase"]

    @property
    def extinction(self) -> Float[Array, " sample"]:
        """Cross-section [sample] [m2]."""
        return self.absorption + self.scattering

    def checks(self) -> list[Check]:
        """Wavenumbers and cosines increase, 0 <= scattering <= extinction, the phase function is >= 0."""
        rising = jnp.concatenate([jnp.ones(1, bool), jnp.diff(self.wavenumber) > 0])
        within = self.absorption >= -1e-5 * self.scattering
        return [
            positive("ParticleTable.wavenumber", self.wavenumber),
            Check("ParticleTable.wavenumber", self.wavenumber, rising, "increasing wavenumbers"),
            positive("ParticleTable.extinction", self.extinction),
            non_negative("ParticleTable.scattering", self.scattering),
            Check("ParticleTable.scattering", self.scattering, within, "at most the extinction"),
            positive("ParticleTable.volume", self.volume),
            *cosine_checks("ParticleTable.cosine", self.cosine),
            non_negative("ParticleTable.phase", self.phase),
        ]


class Particles(AbstractParticles):
    """Particles with tabulated optics.

    The properties of a node are means over the node's bin: of the cross-sections, and of the phase function weighted
    with the scattering cross-section. The table must be fine enough for the ripple of its spectrum: some ten samples
    per bin for particles of one size, few for a distribution of sizes.

    Attributes:
        number_density: [*cell] [m-3]; see `number_density`.
        table: optics of a particle.

    Differentiable in `number_density` and in the table's cross-sections and phase function.
    """

    number_density: Float[Array, "*cell"]
    table: ParticleTable

    def __init__(self, number_density: Any, table: ParticleTable):
        self.number_density = as_float(number_density, "Particles.number_density")
        self.table = table

    def optics(self, nodes: Nodes) -> ParticleOptics:
        """See `AbstractParticles.optics`. Bins must lie within the table.

        Raises:
            ValueError: a bin outside the table (RuntimeError where bins are known only at run time).
        """
        table = self.table
        nodes = bins_inside("Particles", nodes, table.wavenumber[jnp.array([0, -1])])
        weight = sample_weights(nodes.lower, nodes.upper, table.wavenumber)
        # Cross-sections of 1e-10 m2 and the phase peak stay far from the limits of float32 in units of their mean.
        unit = jnp.mean(table.extinction)
        absorption, scattering = weight @ (table.absorption / unit), weight @ (table.scattering / unit)
        extinction = absorption + scattering
        phase = weight @ (table.scattering[:, None] / unit * table.phase)
        spread = (self.number_density * unit)[..., None] * extinction.reshape((1,) * self.number_density.ndim + (-1,))
        lobe = TabulatedPhase(table.cosine, phase)
        return ParticleOptics(spread, scattering / extinction, absorption / extinction, lobe)

    @property
    def cells(self) -> tuple[int, ...]:
        """See `AbstractParticles.cells`."""
        return self.number_density.shape

    def diluted(self, amount: Float[Array, "*cell"]) -> Particles:
        """See `AbstractParticles.diluted`.

        Raises:
            ValueError: the number density already differs from cell to cell.
        """
        if self.cells:
            raise ValueError(
                f"Particles.number_density: got shape {self.cells}, expected one value: particles that are the same "
                "everywhere before they are diluted"
            )
        return Particles(amount * self.number_density, self.table)

    def guide(self) -> tuple[Float[Array, "*cell"], AbstractPhase]:
        """See `AbstractParticles.guide`: the mean over the whole table."""
        table = self.table
        unit = jnp.mean(table.extinction)
        phase = TabulatedPhase(table.cosine, jnp.mean(TabulatedPhase(table.cosine, table.phase).value, axis=0))
        return self.number_density * unit, phase

    def checks(self) -> list[Check]:
        """The number density is >= 0, the table's values in range."""
        return [non_negative("Particles.number_density", self.number_density), *self.table.checks()]


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
