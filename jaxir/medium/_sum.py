"""Several media in one space: their coefficients add, wherever they overlap.

    dL/ds = sum_m j_m - (sum_m mu_m) L

A ray is cut wherever one of the media cuts it, and every panel is integrated by two points of Gauss and Legendre as
those of a jet are, see `_jet_layers`. Cells are homogeneous in every panel, so between grids the integral is exact;
panels of a jet become shorter, so it errs by no more than it does alone. Adding coefficients says that the gases do not
mix: two jets that share a place are each as hot there as alone.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._math import scan_anew
from jaxir.geometry import Rays
from jaxir.medium._active import for_active
from jaxir.medium._jet_layers import GAUSS, front_of_panel
from jaxir.medium._medium import AbstractMedium, AbstractScatterer, Capsules


class MediumSum(AbstractMedium):
    """Media that overlap or not.

    Attributes:
        parts: at least one.
    """

    parts: tuple[AbstractMedium, ...]

    def radiance(
        self, rays: Rays, t_max: Float[Array, " ray"], behind: Float[Array, "ray node"], route: Any = None
    ) -> Float[Array, "ray node"]:
        """See `AbstractMedium.radiance`. Differentiable in what the media are, to any order."""

        def coefficients(rays: Rays, t: Array) -> tuple[Array, Array]:
            return self.coefficients(rays.at(t))

        def across(cuts: Array, rays: Rays, behind: Array) -> Array:
            return across_pieces(cuts, rays, behind, coefficients)

        return radiance_between(self.cuts(rays, t_max), rays, behind, across)

    def transmittance(self, rays: Rays, t_max: Float[Array, " ray"]) -> Float[Array, "ray node"]:
        """See `AbstractMedium.transmittance`: the product."""
        return functools.reduce(jnp.multiply, [part.transmittance(rays, t_max) for part in self.parts])

    def scattering(self, point: Float[Array, "ray 3"], cosine: Float[Array, " ray"]) -> Float[Array, "ray node"]:
        """See `AbstractMedium.scattering`: the sum of those with particles.

        A point that lies beside a grid by rounding counts as one of it where it lies in no other medium.
        """
        elsewhere = self.coefficients(point)[0] > 0
        each = [
            jnp.where(elsewhere & (part.scattering_at(point) == 0), 0, part.scattering(point, cosine))
            for part in self.parts_with_particles
        ]
        return functools.reduce(jnp.add, each)

    def cuts(self, rays: Rays, t_max: Float[Array, " ray"]) -> Float[Array, "ray cut"]:
        """See `AbstractMedium.cuts`: those of all media, in order."""
        return merged_cuts([part.cuts(rays, t_max) for part in self.parts])

    def coefficients(self, point: Float[Array, "ray 3"]) -> tuple[Float[Array, "ray node"], Float[Array, "ray node"]]:
        """See `AbstractMedium.coefficients`: the sums."""
        return jax.tree.map(lambda *each: functools.reduce(jnp.add, each), *(p.coefficients(point) for p in self.parts))

    def capsules(self) -> Capsules:
        """See `AbstractMedium.capsules`: those of all media."""
        return Capsules(*(jnp.concatenate(each) for each in zip(*(p.capsules() for p in self.parts), strict=True)))

    @property
    def scatters(self) -> bool:
        """See `AbstractMedium.scatters`."""
        return any(part.scatters for part in self.parts)

    @property
    def parts_with_particles(self) -> tuple[AbstractScatterer, ...]:
        """See `AbstractMedium.parts_with_particles`."""
        return tuple(one for part in self.parts for one in part.parts_with_particles)

    def brightened(self, factors: Sequence[Float[Array, ""]]) -> MediumSum:
        """See `AbstractMedium.brightened`: one factor for each part."""
        return MediumSum(tuple(part.brightened((own,)) for part, own in zip(self.parts, factors, strict=True)))

    def less_forward(self, shares: Sequence[Float[Array, " node"]]) -> MediumSum:
        """See `AbstractMedium.less_forward`."""
        left = iter(shares)
        return MediumSum(
            tuple(part.less_forward([next(left) for _ in part.parts_with_particles]) for part in self.parts)
        )


def radiance_between(
    cuts: Float[Array, "ray cut"],
    rays: Rays,
    behind: Float[Array, "ray node"],
    across: Callable[[Array, Rays, Array], Array],
) -> Float[Array, "ray node"]:
    """Radiance at the origins of rays whose extinction and source are smooth between cuts.

    Args:
        cuts: as `AbstractMedium.cuts`.
        rays: the rays.
        behind: radiance that enters them [ray, node] [W m-2 sr-1].
        across: radiance [ray, node] of these for rays that are carried together, see `across_pieces`.
    """
    meets = cuts[:, 0] < cuts[:, -1]
    found = for_active(lambda some: across(*some), meets, (cuts, rays, behind), behind.shape[1])
    return jnp.where(meets[:, None], found, behind)


def across_pieces(
    cuts: Float[Array, "ray cut"],
    rays: Rays,
    behind: Float[Array, "ray node"],
    coefficients: Callable[[Rays, Array], tuple[Array, Array]],
) -> Float[Array, "ray node"]:
    """Radiance [ray, node] at the origins of rays that are carried together.

    Args:
        cuts: as `AbstractMedium.cuts`.
        rays: the rays.
        behind: radiance that enters them [ray, node] [W m-2 sr-1].
        coefficients: extinction [ray, node] [m-1] and source [ray, node] [W m-3 sr-1] of rays at distances [ray] [m].

    Differentiable in what `coefficients` holds and in `behind`, to any order.
    """
    twice = jax.tree.map(lambda x: jnp.concatenate([x, x]), rays)

    def panel(radiance: Array, points: tuple[Array, Array]) -> tuple[Array, None]:
        t, half = points  # both points together are half the operations
        found = coefficients(twice, t.reshape(-1))
        depth, sent = (value.reshape(2, *radiance.shape) * half[None, :, None] for value in found)
        return front_of_panel(radiance, *depth, *sent), None

    return scan_anew(panel, behind, panel_points(cuts), reverse=True)[0]


def mean_transmittance(medium: AbstractMedium, rays: Rays, cuts: Float[Array, "ray cut"]) -> Float[Array, "ray cut"]:
    """Transmittance from the first of a ray's cuts to each of them, in the mean over the nodes [ray, cut].

    By the middle of every piece.
    """
    nodes = jax.eval_shape(medium.coefficients, rays.origin)[0].shape[1]

    def along(some: tuple[Array, Rays]) -> Array:
        cuts, rays = some

        def across(passed: Array, piece: tuple[Array, Array]) -> tuple[Array, Array]:
            middle, length = piece
            left = passed * jnp.exp(-medium.coefficients(rays.at(middle))[0] * length[:, None])
            return left, left  # a mean over nodes in the loop would keep it from native code

        pieces = ((cuts[:, 1:] + cuts[:, :-1]) / 2).T, jnp.diff(cuts).T
        return jnp.mean(scan_anew(across, jnp.ones((rays.count, nodes), cuts.dtype), pieces)[1], axis=2).T

    meets = cuts[:, 0] < cuts[:, -1]
    left = jnp.where(meets[:, None], for_active(along, meets, (cuts, rays), nodes), 1)
    return jnp.concatenate([jnp.ones_like(left[:, :1]), left], axis=1)


def merged_cuts(each: Sequence[Float[Array, "ray _cut"]]) -> Float[Array, "ray cut"]:
    """The cuts of several media along the same rays in order; equal on a miss."""
    met = [cuts[:, :1] < cuts[:, -1:] for cuts in each]
    starts = [jnp.where(hit, cuts[:, :1], jnp.inf) for hit, cuts in zip(met, each, strict=True)]
    start = functools.reduce(jnp.minimum, starts)
    start = jnp.where(jnp.isfinite(start), start, 0)  # what a ray misses is cut where it meets the others first
    held = [jnp.where(hit, cuts, start) for hit, cuts in zip(met, each, strict=True)]
    return jnp.sort(jnp.concatenate(held, axis=1), axis=1)


def panel_points(cuts: Float[Array, "ray cut"]) -> tuple[Float[Array, "panel 2 ray"], Float[Array, "panel ray"]]:
    """Distances of the two points of all panels, near to far, and half the panels' lengths [m]."""
    begin, length = cuts[:, :-1].T, jnp.diff(cuts, axis=1).T
    return begin[:, None] + jnp.stack([length * share for share in GAUSS], axis=1), length / 2
