"""How light scattered by particles is found: the strategy that `trace`, `render` and `signature` take."""

from __future__ import annotations

import equinox as eqx

from jaxir.scene.scene import Scene


class Scattering(eqx.Module):
    """How often a path may be scattered by particles.

    Along every leg of a path the plume's emission is the exact sum over its cells and, in a gridded plume, light of
    parallel sources scattered once towards the eye is one, too, with each cell lit as its centre is: u0 (u0 + 2 u) / 24
    of a cell's share is left out, u0 and u being its optical depths towards the source and along the leg. What is
    scattered more often is sampled: one place on each leg, always in the plume (forced collision), lit there by sources
    that are near or have an extent, and from there a direction drawn from the phase function, the next leg.

    A path that meets reflecting skin while `Reflection.bounces` allow it goes on either from a particle or from the
    skin, as a photon would; it goes on max(orders, bounces) times at most.

    Attributes:
        orders: how often at most; 0 keeps what is not sampled. Light scattered more often is left out: for particles
            that absorb nothing, about 1e-3 of the light through a plume of optical depth 1 beyond 10 orders, 7 % of
            it at 4; `Image.missing` estimates it.
    """

    orders: int = eqx.field(static=True)

    def __init__(self, orders: int = 10):
        """Keep the number; it is structure."""
        if isinstance(orders, bool) or not isinstance(orders, int) or orders < 0:
            raise ValueError(f"Scattering.orders: got {orders!r}, expected an integer >= 0")
        self.orders = orders


def scattering_of(scene: Scene, given: Scattering | None) -> Scattering | None:
    """What is asked, or `Scattering()`, for a plume with particles; None: nothing scatters."""
    if scene.plume is None or scene.plume.particles is None:
        return None
    return Scattering() if given is None else given
