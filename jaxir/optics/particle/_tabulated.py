"""Particles with tabulated optics."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxir._arrays import Check, as_float, increasing, non_negative, positive, require, require_shape
from jaxir._fields import Physical, quantity
from jaxir._math import matmul
from jaxir._plausible import WAVENUMBER, doubt, usual
from jaxir.optics._tables import sample_weights
from jaxir.optics.particle._particles import AbstractParticles, ParticleOptics, exact_difference
from jaxir.optics.particle._phase import AbstractPhase, TabulatedPhase, from_minus_one_to_one
from jaxir.optics.spectrum import Nodes, bins_inside


class ParticleTable(Physical):
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

    wavenumber: Float[Array, " sample"] = quantity("cm-1", ("sample",), (positive, increasing, WAVENUMBER), least=2)
    absorption: Float[Array, " sample"] = quantity("m2", ("sample",))
    scattering: Float[Array, " sample"] = quantity("m2", ("sample",), non_negative)
    volume: Float[Array, ""] = quantity("m3", within=positive)
    cosine: Float[Array, " angle"] = quantity("1", ("angle",), (increasing, from_minus_one_to_one), least=2)
    phase: Float[Array, "sample angle"] = quantity("sr-1", ("sample", "angle"), non_negative)

    def __init__(self, wavenumber: Any, extinction: Any, scattering: Any, volume: Any, cosine: Any, phase: Any):
        """Keep the absorption, extinction - scattering; both are cross-sections [sample] [m2]."""
        given = as_float(extinction, "ParticleTable.extinction")
        self.wavenumber = as_float(wavenumber, "ParticleTable.wavenumber")
        self.scattering = as_float(scattering, "ParticleTable.scattering")
        for name, value in (("extinction", given), ("scattering", self.scattering)):
            require_shape(f"ParticleTable.{name}", value, self.wavenumber.shape)
        self.absorption = exact_difference(extinction, scattering)
        self.volume, self.cosine, self.phase = volume, cosine, phase

    @property
    def extinction(self) -> Float[Array, " sample"]:
        """Cross-section [sample] [m2]."""
        return self.absorption + self.scattering

    def relations(self) -> list[Check]:
        """0 <= scattering <= extinction."""
        within = self.absorption >= -1e-5 * self.scattering
        return [
            positive("ParticleTable.extinction", self.extinction),
            Check("ParticleTable.scattering", self.scattering, within, "at most the extinction"),
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

    number_density: Float[Array, "*cell"] = quantity("m-3", ("*cell",), non_negative)
    table: ParticleTable

    @property
    def has_spectrum(self) -> bool:
        """See `Physical.has_spectrum`."""
        return True

    def doubts(self) -> list[Check]:
        """Particles are some in a cubic metre and do not fill a hundredth of it."""
        name, number = "Particles.number_density", self.number_density
        few = usual(1e3, np.inf, "m-3", below="is it in cm-3?")(name, number, np.max)
        filling = "particles that fill at most 1 % of the volume; is it in m-3?"
        return [few, doubt(name, lambda n, volume: n * volume <= 0.01, filling, number, self.table.volume)]

    def node_checks(self, nodes: Nodes) -> list[Check]:
        """See `Physical.node_checks`: bins lie within the table."""
        return bins_inside("Particles", nodes, self.table.wavenumber)

    def optics(self, nodes: Nodes) -> ParticleOptics:
        """See `AbstractParticles.optics`. Bins must lie within the table.

        Raises:
            ValueError: a bin outside the table, where bins are known.
        """
        require(self.node_checks(nodes))
        table = self.table
        weight = sample_weights(nodes.lower, nodes.upper, table.wavenumber)
        # Cross-sections of 1e-10 m2 and the phase peak stay far from the limits of float32 in units of their mean.
        unit = jnp.mean(table.extinction)
        absorption, scattering = matmul(weight, table.absorption / unit), matmul(weight, table.scattering / unit)
        extinction = absorption + scattering
        phase = matmul(weight, table.scattering[:, None] / unit * table.phase)
        spread = (self.number_density * unit)[..., None] * extinction.reshape((1,) * self.number_density.ndim + (-1,))
        lobe = TabulatedPhase(table.cosine, phase)
        return ParticleOptics(spread, scattering / extinction, absorption / extinction, lobe)

    @property
    def amount(self) -> Any:
        """See `AbstractParticles.amount`: the number density."""
        return self.number_density

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

    def proposal(self) -> tuple[Float[Array, "*cell"], AbstractPhase]:
        """See `AbstractParticles.proposal`: the mean over the whole table."""
        table = self.table
        unit = jnp.mean(table.extinction)
        phase = TabulatedPhase(table.cosine, jnp.mean(TabulatedPhase(table.cosine, table.phase).value, axis=0))
        return self.number_density * unit, phase
