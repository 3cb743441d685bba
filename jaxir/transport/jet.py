"""The path integral through a jet, by quadrature and without a grid.

The state of a jet is a function of one number, the exhaust fraction f, so its extinction and emission are tabulated
over f once for all rays: computed at some knots, and by cubics at the knots between them. A ray is cut where it enters
and leaves the cone of the jet's edge and the cone of its core, and in each shear layer where it passes the end of the
core, at which the jet's decay begins. In the core f is 1: one homogeneous layer. In every other piece f is smooth, and
equal panels in ln(z + d / 2), which suits both the growth of the shear layer and the decay of the jet, are integrated
by two points of Gauss and Legendre each:

    R <- E1 E2 R,    E: through a homogeneous layer,    A1 = a1 - x (a2 - a1),  A2 = a2 + x (a2 - a1),

with a = (extinction, emission) times half the panel's length at the two points and x = 1/sqrt(3) - 1/2: the
commutator-free Magnus integrator of fourth order (Blanes and Moan, "Fourth- and sixth-order commutator-free Magnus
integrators for linear and non-linear dynamical systems", Appl. Numer. Math. 56, 2006). Where a1 and a2 differ much, x
is reduced so that no layer becomes negative: however thick the jet, its radiance lies between 0 and that of its
brightest point.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxir._arrays import as_float, enforce
from jaxir._math import frame_around
from jaxir.geometry import FLAT, AxisView, Rays, inside_cone, view_from_axis
from jaxir.optics import across_layer, thinning
from jaxir.optics.particle import AbstractPhase
from jaxir.optics.spectrum import Band, Nodes, as_nodes
from jaxir.scene.jet import JetPlume
from jaxir.transport.active import for_active
from jaxir.transport.medium import AbstractMedium, plume_optics

COMPUTED = 256  # knots at which the optics are computed, 7 K apart between 300 and 2000 K
BETWEEN = 4  # knots of the table for each interval of those
KNOTS = BETWEEN * (COMPUTED - 1)  # intervals of the table; see `jet_medium` for what they err
AT_ONCE = 64  # knots computed at once
MOST_PANELS = 256
_DARK = 1e-18  # the inverse square of what is smaller overflows in float32
_EXTRAPOLATE = 3**-0.5 - 0.5
_GAUSS = np.array([0.5 - 3**-0.5 / 2, 0.5 + 3**-0.5 / 2])


class JetMedium(AbstractMedium):
    """A jet with its optics tabulated over the exhaust fraction, 0 to 1 in equal steps.

    Attributes:
        jet: the jet.
        extinction: [knot, node] [m-1].
        emission: absorption times blackbody radiance [knot, node] [W m-3 sr-1].
        scattering: [knot, node] [m-1]; None without particles.
        phase: phase function of the particles; None without.
    """

    jet: JetPlume
    extinction: Float[Array, "knot node"]
    emission: Float[Array, "knot node"]
    scattering: Float[Array, "knot node"] | None
    phase: AbstractPhase | None

    def leg(
        self, rays: Rays, t_max: Float[Array, " ray"], behind: Float[Array, "ray node"]
    ) -> Float[Array, "ray node"]:
        """See `AbstractMedium.leg`. Differentiable in the jet, the rays, `t_max` and `behind`."""
        return _radiance(self, rays, t_max, behind)

    def transmittance(self, rays: Rays, t_max: Float[Array, " ray"]) -> Float[Array, "ray node"]:
        """See `AbstractMedium.transmittance`. Differentiable in the jet, the rays and `t_max`."""
        return jnp.exp(-_depth(self, rays, t_max))

    def scattering_at(self, point: Float[Array, "ray 3"]) -> Float[Array, "ray node"]:
        """See `AbstractMedium.scattering_at`. Differentiable in the jet and the points."""
        assert self.scattering is not None
        return _between(self.scattering, self.jet.state(point)[1])


def jet_medium(jet: JetPlume, nodes: Nodes) -> JetMedium:
    """A jet on the nodes.

    Interpolation errs by 2e-5 of the largest emission of a node and 4e-5 of its largest extinction, up to 2500 K;
    where the gas is above 500 K by 2e-4 of its own emission beyond 3 um and 2e-3 at shorter wavelengths.

    Differentiable in the jet's fields.
    """

    def computed(fraction: Array) -> tuple[Array, Array, Array | None]:
        gas, particles = jet.mixture(fraction), jet.suspension(fraction)
        return plume_optics(gas, particles, nodes, jet.temperature(fraction))[:3]

    # Some knots at a time: in one loop with what interpolates between them they would be computed four times each.
    some = lax.map(computed, as_float(np.linspace(0, 1, COMPUTED).reshape(-1, AT_ONCE)))
    extinction, emission, scattering = jax.tree.map(lambda table: _refined(table.reshape(COMPUTED, -1)), some)
    phase = None if jet.particles is None else jet.particles.optics(nodes).phase
    return JetMedium(jet, extinction, emission, scattering, phase)


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


class _Chord(NamedTuple):
    """One ray in the jet: `cuts` [6] are s of the edge, a cut, the core, the core's other side, a cut, the edge."""

    view: AxisView
    cuts: Array

    def meets(self) -> Array:
        """Whether the ray enters the jet."""
        return self.cuts[..., 0] < self.cuts[..., -1]


def _chords(jet: JetPlume, rays: Rays, t_max: Float[Array, " ray"]) -> _Chord:
    """Chords of rays, every leaf with a leading axis [ray]."""
    return jax.vmap(_chord, in_axes=(None, 0, 0, 0))(jet, rays.origin, rays.direction, t_max)


def _chord(jet: JetPlume, origin: Float[Array, " 3"], direction: Float[Array, " 3"], t_max: Float[Array, ""]) -> _Chord:
    """Where one ray runs in the jet; a miss has six equal cuts."""
    view = view_from_axis(jet.nozzle, jet.direction, jet.end, origin, direction)
    radius = jet.diameter / 2
    low, high = inside_cone(view, radius, jet.spreading, jet.end)
    low, high = jnp.maximum(low, -view.start), jnp.minimum(high, t_max - view.start)
    hit = low < high
    low, high = jnp.where(hit, low, 0), jnp.where(hit, high, 0)
    core_low, core_high = inside_cone(view, radius, -radius / jet.core_end, jnp.minimum(jet.core_end, jet.end))
    core_low, core_high = jnp.maximum(core_low, low), jnp.minimum(core_high, high)
    cored = core_low < core_high
    nearest = jnp.clip(view.nearest, low, high)  # a ray that misses the core is cut where f has its ridge
    core_low, core_high = jnp.where(cored, core_low, nearest), jnp.where(cored, core_high, nearest)
    oblique = jnp.abs(view.slope) >= FLAT
    beyond = 2 * low - high  # far before either layer
    decay = jnp.where(oblique, (jet.core_end - view.along) / jnp.where(oblique, view.slope, 1), beyond)
    first, second = (_cut(jet, view, *piece, decay) for piece in ((low, core_low), (core_high, high)))
    return _Chord(view, jnp.stack([low, first, core_low, core_high, second, high]))


def meets_jet(jet: JetPlume, rays: Rays, t_max: Float[Array, " ray"]) -> Bool[Array, " ray"]:
    """Whether rays enter the jet before `t_max` [ray] [m]; the jet changes nothing on any other."""
    return _chords(jet, rays, t_max).meets()


def _cut(jet: JetPlume, view: AxisView, begin: Array, end: Array, decay: Array) -> Array:
    """Where a shear layer is cut in two: where the decay begins; far from there, in its middle.

    From an end of the layer the cut moves back to the middle as far as the decay's beginning moves beyond, so that
    the quadrature is a continuous function of the jet: else its derivatives would lack what jumps.
    """
    middle = _spread(jet, view, begin, end).place(jnp.asarray(0.5, begin.dtype))[0]
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


def _spread(jet: JetPlume, view: AxisView, begin: Array, end: Array) -> _Spread:
    lip = jet.diameter / 2
    at_begin, at_end = (jnp.maximum(view.z(s), 0) + lip for s in (begin, end))  # z >= 0 but for rounding
    growth = jnp.log(at_end / at_begin)
    even = jnp.abs(growth) < 1e-3
    return _Spread(begin, end - begin, jnp.where(even, 1, growth), even)


def jet_panels(
    jet: JetPlume, origin: Float[Array, " 3"], direction: Float[Array, " 3"], t_max: Float[Array, ""]
) -> tuple[Float[Array, ""], Float[Array, " panel"], Float[Array, " panel"]]:
    """The panels of one ray, near to far, and the exhaust fraction in the middle of each.

    Returns:
        Where the first begins [m], lengths [panel] [m], exhaust fractions [panel]. A miss has panels of no length.
    """
    chord = _chord(jet, origin, direction, t_max)
    lengths, fractions = [], []
    edges, middles = (
        as_float((np.arange(n) + shift) / jet.panels) for n, shift in ((jet.panels + 1, 0), (jet.panels, 0.5))
    )
    for first in range(5):
        begin, end = chord.cuts[first], chord.cuts[first + 1]
        if first == 2:
            lengths.append((end - begin)[None])
            fractions.append(jnp.ones(1, begin.dtype))
            continue
        spread = _spread(jet, chord.view, begin, end)
        middle = jax.vmap(spread.place)(middles)[0]
        lengths.append(jnp.diff(jax.vmap(spread.place)(edges)[0]))
        fractions.append(jet.fraction(chord.view.z(middle), chord.view.r_squared(middle)))
    return chord.cuts[0] + chord.view.start, jnp.concatenate(lengths), jnp.concatenate(fractions)


def _radiance(medium: JetMedium, rays: Rays, t_max: Array, behind: Array) -> Float[Array, "ray node"]:
    """Radiance of the jet in front of `behind`."""

    def along(some: tuple[_Chord, Array]) -> Array:
        return _across(some[1], medium.extinction, medium.emission, *_points(medium.jet, some[0]))

    chord = _chords(medium.jet, rays, t_max)
    meets = chord.meets()
    found = for_active(along, meets, (chord, behind), medium.extinction.shape[1])
    return jnp.where(meets[:, None], found, behind)


def _depth(medium: JetMedium, rays: Rays, t_max: Array) -> Float[Array, "ray node"]:
    """Optical depth."""

    def along(chord: _Chord) -> Array:
        def panel(depth: Array, points: tuple[Array, Array]) -> tuple[Array, None]:
            (near, far), (near_length, far_length) = points
            near, far = _between(medium.extinction, near), _between(medium.extinction, far)
            return depth + (near * near_length[:, None] + far * far_length[:, None]), None

        points = _points(medium.jet, chord)
        none = jnp.zeros((chord.cuts.shape[0], medium.extinction.shape[1]), medium.extinction.dtype)
        return lax.scan(panel, none, points, reverse=True)[0]

    chord = _chords(medium.jet, rays, t_max)
    return for_active(along, chord.meets(), chord, medium.extinction.shape[1])


def _points(jet: JetPlume, chord: _Chord) -> tuple[Float[Array, "panel 2 ray"], Float[Array, "panel 2 ray"]]:
    """Exhaust fractions at both points of all panels of chords, near to far, and half the panels' lengths [m].

    The core is one panel.
    """
    shares = as_float((np.arange(jet.panels)[:, None] + _GAUSS[None, :]) / jet.panels)

    def piece(begin: Array, end: Array) -> tuple[Array, Array]:
        spread = _spread(jet, chord.view, begin, end)

        def at(share: Array) -> tuple[Array, Array]:
            s, stretch = spread.place(share)
            return jet.fraction(chord.view.z(s), chord.view.r_squared(s)), stretch / (2 * jet.panels)

        return jax.vmap(jax.vmap(at))(shares)

    cuts = chord.cuts.T
    pieces = jax.vmap(piece)(cuts[np.array([0, 1, 3, 4])], cuts[np.array([1, 2, 4, 5])])
    fraction, length = (x.reshape(4 * jet.panels, 2, -1) for x in pieces)
    half = jnp.broadcast_to((cuts[3] - cuts[2]) / 2, (1, *fraction.shape[1:]))
    core = 2 * jet.panels
    fraction = jnp.concatenate([fraction[:core], jnp.ones_like(half), fraction[core:]])
    return fraction, jnp.concatenate([length[:core], half, length[core:]])


@jax.custom_jvp
def _across(
    behind: Float[Array, "ray node"],
    extinction: Float[Array, "knot node"],
    emission: Float[Array, "knot node"],
    fraction: Float[Array, "panel 2 ray"],
    length: Float[Array, "panel 2 ray"],
) -> Float[Array, "ray node"]:
    """The radiance in front of panels, each of which is A2 and before it A1 of this file's head.

    What is found in the tables lies in rows of one ray, what follows in one long row, because loops over a few nodes
    are slow; and each is a computation of its own, because XLA would join the loops. A panel that none of the rays
    crosses, as the core behind its end, is left out.
    """
    none = jnp.zeros_like(behind)

    def panel(radiance: Array, each: tuple[Array, Array]) -> tuple[Array, None]:
        fraction, length = each
        crossed = (length > 0).any()

        def look_up() -> list[Array]:
            return [
                _between(table, fraction[i]) * length[i][:, None] for table in (extinction, emission) for i in (0, 1)
            ]

        layers = [x.reshape(-1) for x in lax.cond(crossed, look_up, lambda: [none] * 4)]
        return lax.cond(crossed, lambda: _front(radiance, *layers), lambda: radiance), None

    return lax.scan(panel, behind.reshape(-1), (fraction, length), reverse=True)[0].reshape(behind.shape)


@_across.defjvp
def _across_jvp(primals, tangents):
    """As the value, with factors for the tangents, which are found once for all of them."""
    behind, extinction, emission, fraction, length = primals
    d_behind, d_extinction, d_emission, d_fraction, d_length = tangents
    none = jnp.zeros_like(behind)

    def panel(state: tuple[Array, Array], each: tuple[Array, ...]) -> tuple[tuple[Array, Array], None]:
        radiance, change = state
        fraction, length, d_fraction, d_length = each
        crossed = (length > 0).any()

        def look_up() -> list[tuple[Array, Array]]:
            return [(_between(table, f), _slope(table, f)) for table in (extinction, emission) for f in fraction]

        found = lax.cond(crossed, look_up, lambda: [(none, none)] * 4)
        halves, d_halves, d_places = ([x[i][:, None] for i in (0, 1, 0, 1)] for x in (length, d_length, d_fraction))
        layers = [(value * half).reshape(-1) for (value, _), half in zip(found, halves, strict=True)]
        passing = radiance, jnp.ones_like(radiance), [jnp.zeros_like(radiance)] * 4
        front, kept, factors = lax.cond(crossed, lambda: _factors(radiance, *layers), lambda: passing)
        change = kept.reshape(none.shape) * change
        for i, (value, slope) in enumerate(found):
            table, place = (d_extinction, d_emission)[i // 2], fraction[i % 2]
            moved = halves[i] * (_between(table, place) + slope * d_places[i]) + value * d_halves[i]
            change = change + factors[i].reshape(none.shape) * moved
        return (front, change), None

    panels = fraction, length, d_fraction, d_length
    front, change = lax.scan(panel, (behind.reshape(-1), d_behind), panels, reverse=True)[0]
    return front.reshape(behind.shape), change


def _front(behind: Array, near_u: Array, far_u: Array, near_j: Array, far_j: Array) -> Array:
    """The radiance in front of a panel."""
    shift_u, shift_j = _shift(near_u, far_u)[0], _shift(near_j, far_j)[0]
    unit = jnp.ones_like(behind)
    between = across_layer(behind, far_u + shift_u, far_j + shift_j, unit)
    return across_layer(between, near_u - shift_u, near_j - shift_j, unit)


def _factors(behind: Array, near_u: Array, far_u: Array, near_j: Array, far_j: Array) -> tuple[Array, Array, list]:
    """The radiance in front of a panel, and its derivatives by that behind and by each of the other arguments.

    A layer has dR' = exp(-u) dR + phi1 dj - (exp(-u) R + thinning j) du, with phi1 = exp(-u) + u thinning.
    """
    shift_u, by_near_u, by_far_u = _shift(near_u, far_u)
    shift_j, by_near_j, by_far_j = _shift(near_j, far_j)

    def layer(behind: Array, u: Array, j: Array) -> tuple[Array, Array, Array, Array]:
        kept, bend = jnp.exp(-u), thinning(u)
        mean = kept + u * bend
        return kept * behind + mean * j, kept, mean, -(kept * behind + bend * j)

    between, far_kept, far_mean, far_slope = layer(behind, far_u + shift_u, far_j + shift_j)
    front, kept, mean, slope = layer(between, near_u - shift_u, near_j - shift_j)
    far_mean, far_slope = kept * far_mean, kept * far_slope
    by_u = slope + (far_slope - slope) * by_near_u, far_slope + (far_slope - slope) * by_far_u
    by_j = mean + (far_mean - mean) * by_near_j, far_mean + (far_mean - mean) * by_far_j
    return front, kept * far_kept, [*by_u, *by_j]


def _shift(near: Array, far: Array) -> tuple[Array, Array, Array]:
    """By how much A1 is less than `near` and A2 more than `far`, and the derivatives of that by both.

    It is x (far - near), times 2 q / (1 + q^2) with the ratio q <= 1 of the two, so that neither layer is negative.
    """
    large = jnp.maximum(near, far)
    there = large > _DARK
    ratio = jnp.where(there, jnp.minimum(near, far) / jnp.where(there, large, 1), 0)
    inverse = jnp.where(there, 2 / (1 + ratio * ratio), 0)
    alike = inverse * ratio
    a, b = jnp.where(near < far, ratio, 1), jnp.where(near < far, 1, ratio)
    steep = alike * (b - a)
    by_near, by_far = inverse * (b * (b - 2 * a) - a * steep), inverse * (a * (2 * b - a) - b * steep)
    return _EXTRAPOLATE * alike * (far - near), _EXTRAPOLATE * by_near, _EXTRAPOLATE * by_far


def _between(table: Float[Array, "knot node"], fraction: Float[Array, " ray"]) -> Float[Array, "ray node"]:
    """A table over the exhaust fraction, linear between knots."""
    low, high, part = _neighbours(table, fraction)
    return low + part * (high - low)


def _slope(table: Float[Array, "knot node"], fraction: Float[Array, " ray"]) -> Float[Array, "ray node"]:
    """The derivative of a table by the exhaust fraction."""
    low, high, _ = _neighbours(table, fraction)
    return KNOTS * (high - low)


def _neighbours(table: Float[Array, "knot node"], fraction: Float[Array, " ray"]) -> tuple[Array, Array, Array]:
    """The values of a table at the knots below and above [ray, node], and where between them [ray, 1]."""
    place = fraction * KNOTS
    knot = jnp.clip(place.astype(jnp.int32), 0, KNOTS - 1)
    low, high = (table.at[k].get(mode="promise_in_bounds") for k in (knot, knot + 1))
    return low, high, (place - knot.astype(place.dtype))[:, None]


_SAMPLE_ANGLES = np.deg2rad([0.0, 3.0, 15.0, 45.0, 90.0, 135.0, 165.0, 177.0, 180.0])
_SAMPLE_RAYS = 128


@eqx.filter_jit
def _sampled(medium: JetMedium) -> tuple[Array, Array]:
    """Radiance and transmittance of rays through points spread over the jet, at angles with its axis [view, ray, node].

    Points are spread evenly in ln(z + d / 2), in area and in azimuth by a Kronecker sequence.
    """
    jet = medium.jet
    ray = np.arange(1, _SAMPLE_RAYS + 1)[:, None]
    u = as_float(np.modf(ray * np.array([[0.8191725134, 0.6710436067, 0.5497004779]]))[0])
    frame = frame_around(jet.direction)
    lip = jet.diameter / 2
    z = jet.stations(u[:, 0])
    r = (lip + jet.spreading * z) * jnp.sqrt(u[:, 1])
    turn = 2 * jnp.pi * u[:, 2]
    point = jnp.stack([r * jnp.cos(turn), r * jnp.sin(turn), z], axis=-1) @ frame + jet.nozzle[None, :]
    back = 2 * (jet.end + lip + jet.spreading * jet.end)

    def view(angle: Array) -> tuple[Array, Array]:
        direction = jnp.cos(angle) * frame[2] + jnp.sin(angle) * frame[0]
        rays = Rays(point - back * direction[None, :], jnp.broadcast_to(direction, point.shape))
        t_max = jnp.full((_SAMPLE_RAYS,), jnp.inf, point.dtype)
        dark = jnp.zeros((_SAMPLE_RAYS, medium.extinction.shape[1]), point.dtype)
        return medium.leg(rays, t_max, dark), medium.transmittance(rays, t_max)

    return lax.map(view, as_float(_SAMPLE_ANGLES))


def resolve_jet(
    jet: JetPlume, bands: Nodes | Band | tuple[Band, ...] | list[Band], tolerance: float = 1e-3
) -> JetPlume:
    """The jet with the fewest panels, a power of two, that keep its quadrature within a tolerance.

    Panels are doubled until doubling changes, on 128 rays from each of 9 angles between head-on and tail-on, no
    radiance by more than `tolerance` times the largest of its angle and node, and no transmittance by more than
    `tolerance`. On the host; the number of panels is structure, so ask once and not inside a fit.

    Args:
        jet: the jet.
        bands: bands or nodes.
        tolerance: > 0. Interpolation between the states of the jet adds about 1e-4 that no panel removes.

    Returns:
        The jet with its `panels` replaced.

    Raises:
        ValueError: the tolerance is not a positive number, is not reached with 256 panels, or the jet's values are
            out of range.
    """
    if not (np.isfinite(tolerance) and tolerance > 0):
        raise ValueError(f"tolerance: got {tolerance}, expected a number > 0")
    nodes = enforce(as_nodes(bands), jet.checks())

    def at(panels: int) -> tuple[np.ndarray, np.ndarray]:
        sampled = _sampled(jet_medium(jet.with_panels(panels), nodes))
        return np.asarray(sampled[0], np.float64), np.asarray(sampled[1], np.float64)

    panels, coarse = 1, at(1)
    while True:
        fine = at(2 * panels)
        largest = np.maximum(fine[0].max(axis=1, keepdims=True), np.finfo(np.float32).tiny)
        change = max(float(np.max(np.abs(fine[0] - coarse[0]) / largest)), float(np.max(np.abs(fine[1] - coarse[1]))))
        if change <= tolerance:
            return jet.with_panels(panels)
        panels, coarse = 2 * panels, fine
        if panels > MOST_PANELS:
            raise ValueError(
                f"tolerance: got {tolerance}, expected one that {MOST_PANELS} panels reach; the last doubling changed "
                f"radiance by {change:.1e}"
            )
