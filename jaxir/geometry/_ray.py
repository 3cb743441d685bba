"""Rays, alone or as a bundle of one projective map."""

from __future__ import annotations

import equinox as eqx
from jax import lax
from jaxtyping import Array, Float


class Rays(eqx.Module):
    """A batch of unrelated rays.

    Attributes:
        origin: [ray, 3] [m].
        direction: [ray, 3], unit length.
    """

    origin: Float[Array, "ray 3"]
    direction: Float[Array, "ray 3"]

    @property
    def count(self) -> int:
        """Number of rays."""
        return self.origin.shape[0]

    def at(self, t: Float[Array, "ray *more"]) -> Float[Array, "ray *more 3"]:
        """Points at distances `t` [ray, ...] [m] along the rays."""
        among = (self.count, *(1,) * (t.ndim - 1), 3)
        return self.origin.reshape(among) + t[..., None] * self.direction.reshape(among)


class Bundle(eqx.Module):
    """Rays of one projective map: through an eye at a finite range, or parallel.

    The frame (u, v, w) is orthonormal and w points from the target to the eye. A point with frame coordinates
    (X, Y, Z) about `target` is seen at screen point (X s, Y s) with s = 1 / (1 - Z * inverse_range); so 5 km and
    infinity (`inverse_range` 0, parallel rays) are one code and float32 keeps the grain of the target, not of the
    range. Rays start on the plane Z = `start` and travel towards -w.

    Attributes:
        target: [3] [m].
        frame: rows u, v, w [3, 3].
        inverse_range: 1 / (distance of the eye from the target) [m-1]; 0 for parallel rays.
        start: Z of the plane on which rays start [m]; 0 <= start < range.
        screen: screen points on the plane Z = 0 [ray, 2] [m]; neighbours in this list should be neighbours on the
            screen, because routes test them together.
    """

    target: Float[Array, " 3"]
    frame: Float[Array, "3 3"]
    inverse_range: Float[Array, ""]
    start: Float[Array, ""]
    screen: Float[Array, "ray 2"]

    @property
    def count(self) -> int:
        """Number of rays."""
        return self.screen.shape[0]

    def rays(self) -> Rays:
        """The same rays one by one, target-centred so that float32 serves any range."""
        # [3, ray]: XLA's CPU loops over a last axis of length 3 are slow
        x, y = self.screen.T
        slant = lax.rsqrt(1 + self.inverse_range * self.inverse_range * (x * x + y * y))
        u, v, w = self.frame[:, :, None]
        lateral = x[None] * u + y[None] * v
        shrink = 1 - self.start * self.inverse_range
        origin = self.target[:, None] + (lateral * shrink + self.start * w)
        direction = (self.inverse_range * lateral - w) * slant[None]
        return Rays(origin.T, direction.T)
