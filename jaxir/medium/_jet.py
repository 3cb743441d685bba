"""A medium whose state is a function of a jet's mixture fraction, integrated by quadrature and without a grid.

Extinction and emission are tabulated over the mixture fraction once for all rays: computed at some knots, and by cubics
at the knots between them. Rays are cut in panels by `_jet_shape` and crossed by `_jet_layers`.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxir._arrays import as_float
from jaxir._math import dot, frame_around
from jaxir.geometry import Rays
from jaxir.medium._active import for_active
from jaxir.medium._jet_layers import BETWEEN, COMPUTED, KNOTS, across_panels, at_both, between_knots, both
from jaxir.medium._jet_shape import Chord, JetShape, chords, gauss_points, panel_edges
from jaxir.medium._medium import AbstractScatterer, Capsules, MediumOptics, less_forward, scattered_at
from jaxir.optics import phi1
from jaxir.optics.particle import AbstractPhase

AT_ONCE = 64  # knots computed at once
STATIONS = 48  # capsules along the axis
RINGS = 4  # and across it


class JetMedium(AbstractScatterer):
    """A jet with its optics tabulated over the mixture fraction, 0 to 1 in equal steps.

    Attributes:
        shape: the jet.
        extinction: [knot, node] [m-1].
        emission: absorption times blackbody radiance [knot, node] [W m-3 sr-1].
        scattering_coefficient: [knot, node] [m-1]; None without particles.
        phase: phase function of the particles; None without.
        path: free path of scattered light where the jet ends, its length if that is less [m]; None without particles.
    """

    shape: JetShape
    extinction: Float[Array, "knot node"]
    emission: Float[Array, "knot node"]
    scattering_coefficient: Float[Array, "knot node"] | None
    phase: AbstractPhase | None
    path: Float[Array, ""] | None

    def radiance(
        self, rays: Rays, t_max: Float[Array, " ray"], behind: Float[Array, "ray node"], route: Any = None
    ) -> Float[Array, "ray node"]:
        """See `AbstractMedium.radiance`. Differentiable in the jet, the rays, `t_max` and `behind`."""

        def along(some: tuple[Chord, Array]) -> Array:
            return across_panels(some[1], self.extinction, self.emission, *gauss_points(self.shape, some[0]))

        chord = chords(self.shape, rays, t_max)
        meets = chord.meets()
        found = for_active(along, meets, (chord, behind), self.extinction.shape[1])
        return jnp.where(meets[:, None], found, behind)

    def transmittance(self, rays: Rays, t_max: Float[Array, " ray"]) -> Float[Array, "ray node"]:
        """See `AbstractMedium.transmittance`. Differentiable in the jet, the rays and `t_max`."""

        def along(chord: Chord) -> Array:
            def panel(depth: Array, points: tuple[Array, Array]) -> tuple[Array, None]:
                fraction, length = points
                near, far = jnp.split(at_both(self.extinction, fraction) * both(length), 2)
                return depth + near + far, None

            points = gauss_points(self.shape, chord)
            none = jnp.zeros((chord.cuts.shape[0], self.extinction.shape[1]), self.extinction.dtype)
            return lax.scan(panel, none, points, reverse=True)[0]

        chord = chords(self.shape, rays, t_max)
        return jnp.exp(-for_active(along, chord.meets(), chord, self.extinction.shape[1]))

    def scattering(self, point: Float[Array, "ray 3"], cosine: Float[Array, " ray"]) -> Float[Array, "ray node"]:
        """See `AbstractMedium.scattering`. Differentiable in the jet and the points."""
        assert self.scattering_coefficient is not None and self.phase is not None
        return scattered_at(between_knots(self.scattering_coefficient, self.shape.at(point)), self.phase, cosine)

    @property
    def lobe(self) -> AbstractPhase | None:
        """See `AbstractScatterer.lobe`."""
        return self.phase

    def less(self, share: Float[Array, " node"]) -> JetMedium:
        """See `AbstractScatterer.less`."""
        extinction, scattering = less_forward(self.extinction, self.scattering_coefficient, share)
        return dataclasses.replace(self, extinction=extinction, scattering_coefficient=scattering)

    def brightened(self, factors: Sequence[Float[Array, ""]]) -> JetMedium:
        """See `AbstractMedium.brightened`."""
        (factor,) = factors
        return dataclasses.replace(self, emission=self.emission * factor)

    def scattering_at(self, point: Float[Array, "ray 3"]) -> Float[Array, "ray node"]:
        """See `AbstractScatterer.scattering_at`. Differentiable in the jet and the points."""
        assert self.scattering_coefficient is not None
        fraction = self.shape.at(point)
        return jnp.where((fraction > 0)[:, None], between_knots(self.scattering_coefficient, fraction), 0)

    def from_cube(self, place: Float[Array, "point 3"]) -> Float[Array, "point 3"]:
        """See `AbstractScatterer.from_cube`: along the axis by `_Stations`, across it as wide as the jet."""
        shape, (u, v, w) = self.shape, frame_around(self.shape.direction)
        z = self._stations().place(place[:, 0])
        across = shape.edge(z)[:, None] * (2 * place[:, 1:] - 1)
        return shape.nozzle[None] + z[:, None] * w[None] + across[:, :1] * u[None] + across[:, 1:] * v[None]

    def to_cube(self, point: Float[Array, "ray 3"]) -> Float[Array, "ray 3"]:
        """See `AbstractScatterer.to_cube`."""
        shape = self.shape
        apart = point - shape.nozzle[None]
        x, y, z = (dot(apart, axis[None]) for axis in frame_around(shape.direction))
        z = jnp.clip(z, 0, shape.end)
        return jnp.stack([self._stations().share(z), (x / shape.edge(z) + 1) / 2, (y / shape.edge(z) + 1) / 2], axis=1)

    def _stations(self) -> _Stations:
        """Stations for light, which changes behind the nozzle as the jet does, and before its end within a path."""
        assert self.path is not None
        return _Stations(self.shape.diameter / 2, self.path, self.shape.end)

    @property
    def frame(self) -> Float[Array, "3 3"]:
        """See `AbstractScatterer.frame`: about the jet's axis."""
        return frame_around(self.shape.direction)

    @property
    def smooth(self) -> bool:
        """See `AbstractScatterer.smooth`."""
        return True

    def lattice(self, along: int, across: int) -> tuple[int, int, int]:
        """See `AbstractScatterer.lattice`."""
        return along, across, across

    def cuts(self, rays: Rays, t_max: Float[Array, " ray"]) -> Float[Array, "ray cut"]:
        """See `AbstractMedium.cuts`: the panels."""
        return panel_edges(self.shape, rays, t_max)

    def coefficients(self, point: Float[Array, "ray 3"]) -> tuple[Float[Array, "ray node"], Float[Array, "ray node"]]:
        """See `AbstractMedium.coefficients`."""
        fraction = self.shape.at(point)
        inside = (fraction > 0)[:, None]
        extinction, emission = (between_knots(table, fraction) for table in (self.extinction, self.emission))
        return jnp.where(inside, extinction, 0), jnp.where(inside, emission, 0)

    def capsules(self) -> Capsules:
        """See `AbstractMedium.capsules`: rings about pieces of the axis."""
        shape = self.shape
        z = shape.stations(as_float(np.linspace(0, 1, STATIONS + 1)))
        low, high = z[:-1], z[1:]
        middle = (low + high) / 2
        edge = shape.edge(middle)
        outer = edge[:, None] * as_float(np.arange(1, RINGS + 1) / RINGS)[None, :]
        inner = outer - edge[:, None] / RINGS
        volume = np.pi * (outer**2 - inner**2) * (high - low)[:, None]
        fraction = shape.mixture_fraction(jnp.broadcast_to(middle[:, None], outer.shape), ((inner + outer) / 2) ** 2)
        knot = jnp.round(fraction * KNOTS).astype(jnp.int32)
        escaping = phi1(self.extinction[knot] * edge[:, None, None])
        emitted = self.emission[knot] * escaping * volume[..., None]
        ends = shape.nozzle[None, None] + jnp.stack([low, high], axis=1)[:, :, None] * shape.direction[None, None]
        return Capsules(jnp.repeat(ends, RINGS, axis=0), outer.reshape(-1), emitted.reshape(STATIONS * RINGS, -1))


class _Stations(NamedTuple):
    """Distances z from a nozzle, even in ln((z + begins) / (end + ends - z)): crowded at both ends, by what they are.

    Attributes:
        begins: length on which light changes at the nozzle [m].
        ends: and at the jet's end [m].
        end: where that is [m].
    """

    begins: Float[Array, ""]
    ends: Float[Array, ""]
    end: Float[Array, ""]

    def share(self, z: Float[Array, " point"]) -> Float[Array, " point"]:
        """Share of the stations before distances z, from 0 to `end`."""
        return (jnp.log1p(z / self.begins) - jnp.log1p(-z / (self.end + self.ends))) / self._all()

    def place(self, share: Float[Array, " point"]) -> Float[Array, " point"]:
        """Its inverse."""
        grown = jnp.expm1(share * self._all())
        return grown / (1 / self.begins + (1 + grown) / (self.end + self.ends))

    def _all(self) -> Float[Array, ""]:
        return jnp.log1p(self.end / self.begins) + jnp.log1p(self.end / self.ends)


def tabulated_jet(
    shape: JetShape, optics: Callable[[Float[Array, " knot"]], MediumOptics], phase: AbstractPhase | None
) -> JetMedium:
    """A jet on the nodes.

    Interpolation errs by 2e-5 of the largest emission of a node and 4e-5 of its largest extinction, up to 2500 K;
    where the gas is above 500 K by 2e-4 of its own emission beyond 3 um and 2e-3 at shorter wavelengths.

    Args:
        shape: the jet.
        optics: of mixture fractions.
        phase: phase function of the particles; None without.

    Differentiable in `shape` and in what `optics` holds.
    """
    # Some knots at a time: in one loop with what interpolates between them they would be computed four times each.
    some = lax.map(lambda f: optics(f)[:3], as_float(np.linspace(0, 1, COMPUTED).reshape(-1, AT_ONCE)))
    extinction, emission, scattering = jax.tree.map(lambda table: _refined(table.reshape(COMPUTED, -1)), some)
    return JetMedium(shape, extinction, emission, scattering, phase, _path_at_end(shape, scattering))


def _path_at_end(shape: JetShape, scattering: Float[Array, "knot node"] | None) -> Float[Array, ""] | None:
    """See `JetMedium.path`, of the node that scatters most."""
    if scattering is None:
        return None
    fraction = shape.mixture_fraction(shape.end, jnp.zeros_like(shape.end))
    return 1 / jnp.maximum(jnp.max(between_knots(scattering, fraction[None])), 1 / shape.end)


def _refined(table: Float[Array, "computed node"]) -> Float[Array, "knot node"]:
    """A table >= 0 at all knots, by cubics through the four nearest of those computed.

    Where values grow so fast that a cubic falls below 0, tenfold from one to the next, it is no use: a straight line.
    """
    place = np.arange(KNOTS + 1) / BETWEEN
    low = np.minimum(place.astype(int), COMPUTED - 2)
    first = np.clip(low - 1, 0, COMPUTED - 4)
    at, share = place - first, as_float(place - low)[:, None]
    weights = [math.prod((at - j) / (k - j) for j in range(4) if j != k) for k in range(4)]
    cubic = functools.reduce(jnp.add, [as_float(w)[:, None] * table[first + k] for k, w in enumerate(weights)])
    return jnp.where(cubic > 0, cubic, (1 - share) * table[low] + share * table[low + 1])
