"""Particles whose extinction and albedo are given."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from jaxir._arrays import as_float, finite, fraction, non_negative
from jaxir._fields import per_node, quantity, spectral
from jaxir.optics.particle._particles import AbstractParticles, ParticleOptics, exact_difference
from jaxir.optics.particle._phase import AbstractPhase
from jaxir.optics.spectrum import Nodes


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

    extinction: Float[Array, "*cell node"] = quantity("m-1", ("*cell", "node"), non_negative, per_node)
    albedo: Float[Array, " node"] = spectral("1", fraction)
    rest: Float[Array, " node"] = spectral("1", finite)
    phase: AbstractPhase

    def __init__(self, extinction: Any, albedo: Any, phase: AbstractPhase):
        """Keep what the albedo loses; a number of `extinction` is the same in every cell and node."""
        self.extinction, self.phase = extinction, phase
        self.albedo = as_float(albedo, "GrayParticles.albedo")
        self.rest = exact_difference(albedo, self.albedo)

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
    def amount(self) -> Any:
        """See `AbstractParticles.amount`: the extinction."""
        return self.extinction

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

    def proposal(self) -> tuple[Float[Array, "*cell"], AbstractPhase]:
        """See `AbstractParticles.proposal`: the mean over the nodes."""
        return jnp.mean(self.extinction, axis=-1), self.phase
