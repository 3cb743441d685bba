"""Several plumes as one: what transport sees of a scene with two engines."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxir.geometry import Pieces, Rays
from jaxir.medium import AbstractMedium, Distance, MediumSum, merged_cuts
from jaxir.optics.spectrum import Nodes
from jaxir.scene.plume._plume import AbstractPlume, Proposal, sample_between


class PlumeSum(AbstractPlume):
    """Plumes whose absorption, emission and scattering add, overlapping or not; see `jaxir.medium.MediumSum`.

    Attributes:
        parts: at least two plumes.
    """

    parts: tuple[AbstractPlume, ...]

    def extent(self) -> Float[Array, "corner 3"]:
        """See `AbstractPlume.extent`."""
        return jnp.concatenate([part.extent() for part in self.parts])

    def medium(self, nodes: Nodes) -> AbstractMedium:
        """See `AbstractPlume.medium`."""
        return MediumSum(tuple(part.medium(nodes) for part in self.parts))

    def meets(self, rays: Rays, t_max: Float[Array, " ray"]) -> Bool[Array, " ray"]:
        """See `AbstractPlume.meets`: any of them."""
        return functools.reduce(jnp.logical_or, [part.meets(rays, t_max) for part in self.parts])

    def route(self, rays: Rays, t_max: Float[Array, " ray"]) -> None:
        """See `AbstractPlume.route`."""
        return None

    def cuts(self, rays: Rays, t_max: Float[Array, " ray"]) -> Float[Array, "ray cut"]:
        """See `AbstractPlume.cuts`."""
        return merged_cuts([part.cuts(rays, t_max) for part in self.parts])

    def pieces(self, exponent: Float[Array, ""]) -> Pieces:
        """See `AbstractPlume.pieces`: those of all, along the edges of the first's."""
        each = [part.pieces(exponent) for part in self.parts]
        frame = each[0].frame
        turned = [each[0], *(pieces.turned_to(frame) for pieces in each[1:])]
        centre, half = (jnp.concatenate(parts, axis=1) for parts in zip(*(p[1:3] for p in turned), strict=True))
        return Pieces(frame, centre, half, jnp.concatenate([pieces.power for pieces in turned]))

    @property
    def parametric(self) -> bool:
        """See `AbstractPlume.parametric`."""
        return all(part.parametric for part in self.parts)

    @property
    def scatters(self) -> bool:
        """See `AbstractPlume.scatters`."""
        return any(part.scatters for part in self.parts)

    @property
    def sums_beams(self) -> bool:
        """See `AbstractPlume.sums_beams`."""
        return False

    def proposals(self, point: Float[Array, "ray 3"]) -> tuple[Proposal, ...]:
        """See `AbstractPlume.proposals`: those of all."""
        return tuple(proposal for part in self.parts for proposal in part.proposals(point))

    def sample_distance(
        self, rays: Rays, t_max: Float[Array, " ray"], u: Float[Array, " ray"], forced: Bool[Array, " ray"]
    ) -> Distance:
        """See `AbstractPlume.sample_distance`."""
        return sample_between(self, rays, t_max, u, forced)

    def hottest(self) -> Float[Array, ""]:
        """See `AbstractPlume.hottest`."""
        return jnp.max(jnp.stack([part.hottest() for part in self.parts]))

    def described(self) -> str:
        """See `AbstractPlume.described`."""
        return ", ".join(part.described() for part in self.parts)

    def outlines(self) -> list[np.ndarray]:
        """See `AbstractPlume.outlines`."""
        return [line for part in self.parts for line in part.outlines()]


def together(plumes: Sequence[AbstractPlume]) -> AbstractPlume | None:
    """One plume that stands for all; None for none."""
    if len(plumes) > 1:
        return PlumeSum(tuple(plumes))
    return plumes[0] if plumes else None
