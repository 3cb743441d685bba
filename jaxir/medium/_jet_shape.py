"""The shape of a jet: how much exhaust is where, and where rays run through it.

A ray is cut where it enters and leaves the cone of the jet's edge and the cone of its core, and in each shear layer
where it passes the end of the core, at which the jet's decay begins. In the core the mixture fraction is 1. In every
other piece it is smooth, and equal panels in ln(z + d / 2) suit both the growth of the shear layer and the decay.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxir._arrays import as_float, as_one_program
from jaxir._math import dot, safe_sqrt
from jaxir.geometry import FLAT, AxisView, Rays, inside_cone, view_from_axis
from jaxir.medium._jet_layers import GAUSS


class JetShape(eqx.Module):
    """A round turbulent jet, see `jaxir.JetPlume`.

    Attributes:
        nozzle: centre of the nozzle's exit [3] [m].
        direction: in which exhaust flows, unit length [3].
        diameter: of the nozzle [m].
        core_end: distance from the nozzle to the core's end [m].
        end: distance from the nozzle to the jet's end [m].
        spreading: slope of the edge.
        panels: quadrature panels in each of the four pieces of a ray.
    """

    nozzle: Float[Array, " 3"]
    direction: Float[Array, " 3"]
    diameter: Float[Array, ""]
    core_end: Float[Array, ""]
    end: Float[Array, ""]
    spreading: Float[Array, ""]
    panels: int = eqx.field(static=True)

    def stations(self, share: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Distances from the nozzle [*batch] [m] at shares [*batch] of the jet's length, even in ln(z + d / 2)."""
        lip = self.diameter / 2
        return lip * jnp.expm1(share * jnp.log1p(self.end / lip))

    def edge(self, along: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Radius of the jet [*batch] [m] at distances downstream [*batch] [m]."""
        return self.diameter / 2 + self.spreading * along

    def mixture_fraction(
        self, along: Float[Array, "*batch"], across_squared: Float[Array, "*batch"]
    ) -> Float[Array, "*batch"]:
        """Mole fraction of exhaust at distances z downstream [*batch] [m] and r^2 from the axis [*batch] [m2]."""
        inside = (along > 0) & (along <= self.end)
        # Nearer to the lip than a millionth of a diameter the shear layer stays as thin as there.
        z = jnp.maximum(jnp.where(inside, along, self.core_end), 1e-6 * self.diameter)
        r, radius = safe_sqrt(across_squared), self.diameter / 2
        core = radius * jnp.maximum(1 - z / self.core_end, 0)
        layer = self.spreading * z + radius * jnp.minimum(z / self.core_end, 1)
        eta = jnp.clip((r - core) / layer, 0, 1)
        fraction = jnp.minimum(self.core_end / z, 1) * (1 - eta * safe_sqrt(eta))
        return jnp.where(inside, fraction, 0)

    @as_one_program
    def at(self, points: Float[Array, "*batch 3"]) -> Float[Array, "*batch"]:
        """Mixture fraction at points [*batch, 3] [m]."""
        lead = (None,) * (points.ndim - 1)
        offset, axis = points - self.nozzle[lead], self.direction[lead]
        along = dot(offset, axis)
        across = offset - along[..., None] * axis
        return self.mixture_fraction(along, dot(across, across))


class Chord(NamedTuple):
    """One ray in the jet: `cuts` [6] are s of the edge, a cut, the core, the core's other side, a cut, the edge."""

    view: AxisView
    cuts: Array

    def meets(self) -> Array:
        """Whether the ray enters the jet."""
        return self.cuts[..., 0] < self.cuts[..., -1]


def chords(shape: JetShape, rays: Rays, t_max: Float[Array, " ray"]) -> Chord:
    """Chords of rays, every leaf with a leading axis [ray]."""
    return jax.vmap(_chord, in_axes=(None, 0, 0, 0))(shape, rays.origin, rays.direction, t_max)


def _chord(
    shape: JetShape, origin: Float[Array, " 3"], direction: Float[Array, " 3"], t_max: Float[Array, ""]
) -> Chord:
    """Where one ray runs in the jet; a miss has six equal cuts."""
    view = view_from_axis(shape.nozzle, shape.direction, shape.end, origin, direction)
    radius = shape.diameter / 2
    low, high = inside_cone(view, radius, shape.spreading, shape.end)
    low, high = jnp.maximum(low, -view.start), jnp.minimum(high, t_max - view.start)
    hit = low < high
    low, high = jnp.where(hit, low, 0), jnp.where(hit, high, 0)
    core_low, core_high = inside_cone(view, radius, -radius / shape.core_end, jnp.minimum(shape.core_end, shape.end))
    core_low, core_high = jnp.maximum(core_low, low), jnp.minimum(core_high, high)
    cored = core_low < core_high
    nearest = jnp.clip(view.nearest, low, high)  # a ray that misses the core is cut where f has its ridge
    core_low, core_high = jnp.where(cored, core_low, nearest), jnp.where(cored, core_high, nearest)
    oblique = jnp.abs(view.slope) >= FLAT
    beyond = 2 * low - high  # far before either layer
    decay = jnp.where(oblique, (shape.core_end - view.along) / jnp.where(oblique, view.slope, 1), beyond)
    first, second = (_cut(shape, view, *piece, decay) for piece in ((low, core_low), (core_high, high)))
    return Chord(view, jnp.stack([low, first, core_low, core_high, second, high]))


def meets_jet(shape: JetShape, rays: Rays, t_max: Float[Array, " ray"]) -> Bool[Array, " ray"]:
    """Whether rays enter the jet before `t_max` [ray] [m]; the jet changes nothing on any other."""
    return chords(shape, rays, t_max).meets()


def _cut(shape: JetShape, view: AxisView, begin: Array, end: Array, decay: Array) -> Array:
    """Where a shear layer is cut in two: where the decay begins; far from there, in its middle.

    From an end of the layer the cut moves back to the middle as far as the decay's beginning moves beyond, so that
    the quadrature is a continuous function of the jet: else its derivatives would lack what jumps.
    """
    middle = _spread(shape, view, begin, end).place(jnp.asarray(0.5, begin.dtype))[0]
    before, behind = jnp.minimum(2 * begin - decay, middle), jnp.maximum(2 * end - decay, middle)
    return jnp.where(decay < begin, before, jnp.where(decay > end, behind, decay))


class _Spread(NamedTuple):
    """Equal steps of ln(z + d / 2) over a piece of a ray, or of s where z hardly changes."""

    begin: Array
    span: Array
    growth: Array
    even: Array

    def place(self, share: Array) -> tuple[Array, Array]:
        """The point s at `share` in [0, 1] of the piece, and ds / dshare."""
        scale = self.span / jnp.expm1(self.growth)
        power = share * self.growth
        s = self.begin + jnp.where(self.even, share * self.span, scale * jnp.expm1(power))
        return s, jnp.where(self.even, self.span, scale * self.growth * jnp.exp(power))


def _spread(shape: JetShape, view: AxisView, begin: Array, end: Array) -> _Spread:
    lip = shape.diameter / 2
    at_begin, at_end = (jnp.maximum(view.z(s), 0) + lip for s in (begin, end))  # z >= 0 but for rounding
    growth = jnp.log(at_end / at_begin)
    even = jnp.abs(growth) < 1e-3
    return _Spread(begin, end - begin, jnp.where(even, 1, growth), even)


def panel_edges(shape: JetShape, rays: Rays, t_max: Float[Array, " ray"]) -> Float[Array, "ray edge"]:
    """Distances between which the panels of rays lie, rising [ray, edge] [m]; equal on a miss.

    The core is one panel.
    """
    places = as_float(np.arange(1, shape.panels + 1) / shape.panels)

    def one(chord: Chord) -> Array:
        ends = [chord.cuts[:1]]
        for first in range(5):
            if first == 2:
                ends.append(chord.cuts[3:4])
                continue
            spread = _spread(shape, chord.view, chord.cuts[first], chord.cuts[first + 1])
            ends.append(jax.vmap(spread.place)(places)[0])
        return chord.view.start + jnp.concatenate(ends)

    return jax.vmap(one)(chords(shape, rays, t_max))


def gauss_points(shape: JetShape, chord: Chord) -> tuple[Float[Array, "panel 2 ray"], Float[Array, "panel 2 ray"]]:
    """Exhaust fractions at both points of all panels of chords, near to far, and half the panels' lengths [m].

    The core is one panel.
    """
    shares = as_float((np.arange(shape.panels)[:, None] + np.array(GAUSS)[None, :]) / shape.panels)

    def piece(begin: Array, end: Array) -> tuple[Array, Array]:
        spread = _spread(shape, chord.view, begin, end)

        def at(share: Array) -> tuple[Array, Array]:
            s, stretch = spread.place(share)
            return shape.mixture_fraction(chord.view.z(s), chord.view.r_squared(s)), stretch / (2 * shape.panels)

        return jax.vmap(jax.vmap(at))(shares)

    cuts = chord.cuts.T
    pieces = jax.vmap(piece)(cuts[np.array([0, 1, 3, 4])], cuts[np.array([1, 2, 4, 5])])
    fraction, length = (x.reshape(4 * shape.panels, 2, -1) for x in pieces)
    half = jnp.broadcast_to((cuts[3] - cuts[2]) / 2, (1, *fraction.shape[1:]))
    core = 2 * shape.panels
    fraction = jnp.concatenate([fraction[:core], jnp.ones_like(half), fraction[core:]])
    return fraction, jnp.concatenate([length[:core], half, length[core:]])
