"""The path integral through a jet, by quadrature and without a grid.

The state of a jet is a function of one number, the exhaust fraction f, so its extinction and emission are tabulated
over f once for all rays. A ray is cut where it enters and leaves the cone of the jet's edge and the cone of its core,
and in each shear layer where it passes the end of the core, at which the jet's decay begins. In the core f is 1: one
homogeneous layer. In every other piece f is smooth, and equal panels in ln(z + d / 2), which suits both the growth of
the shear layer and the decay of the jet, are integrated by two points of Gauss and Legendre each:

    R <- E1 E2 R,    E: through a homogeneous layer,    A1 = a1 - x (a2 - a1),  A2 = a2 + x (a2 - a1),

with a = (extinction, emission) times half the panel's length at the two points and x = 1/sqrt(3) - 1/2: the
commutator-free Magnus integrator of fourth order (Blanes and Moan, "Fourth- and sixth-order commutator-free Magnus
integrators for linear and non-linear dynamical systems", Appl. Numer. Math. 56, 2006). Where a1 and a2 differ much, x
is reduced so that no layer becomes negative: however thick the jet, its radiance lies between 0 and that of its
brightest point.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxir._arrays import as_float, enforce
from jaxir._vector import frame_around
from jaxir.geometry.cone import FLAT, AxisView, inside_cone, view_from_axis
from jaxir.geometry.ray import Rays
from jaxir.optics.band import Band, Nodes, as_nodes
from jaxir.optics.layer import across_layer, thinning, through_layer
from jaxir.optics.phase import AbstractPhase
from jaxir.scene.jet import JetPlume
from jaxir.transport.active import for_active
from jaxir.transport.medium import AbstractMedium, plume_optics

KNOTS = 1024  # 1.7 K apart between 300 and 2000 K: linear interpolation errs by 1e-4 where the gas is above 500 K
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
        emitted, depth = _integrate(self, rays, t_max)
        return emitted + jnp.exp(-depth) * behind

    def transmittance(self, rays: Rays, t_max: Float[Array, " ray"]) -> Float[Array, "ray node"]:
        """See `AbstractMedium.transmittance`. Differentiable in the jet, the rays and `t_max`."""
        return jnp.exp(-_integrate(self, rays, t_max)[1])

    def scattering_at(self, point: Float[Array, "ray 3"]) -> Float[Array, "ray node"]:
        """See `AbstractMedium.scattering_at`. Differentiable in the jet and the points."""
        assert self.scattering is not None
        return _between(self.scattering, self.jet.state(point)[1])


def jet_medium(jet: JetPlume, nodes: Nodes) -> JetMedium:
    """A jet on the nodes. Differentiable in the jet's fields."""
    fraction = as_float(np.linspace(0, 1, KNOTS + 1))
    temperature = jet.temperature(fraction)
    return JetMedium(jet, *plume_optics(jet.mixture(fraction), jet.suspension(fraction), nodes, temperature))


class _Chord(NamedTuple):
    """One ray in the jet: `cuts` [6] are s of the edge, a cut, the core, the core's other side, a cut, the edge."""

    view: AxisView
    cuts: Array


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
    cuts = jax.vmap(_chord, in_axes=(None, 0, 0, 0))(jet, rays.origin, rays.direction, t_max).cuts
    return cuts[:, 0] < cuts[:, -1]


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


State = tuple[Array, Array]


def _integrate(medium: JetMedium, rays: Rays, t_max: Array) -> State:
    """Emitted radiance and optical depth [ray, node]."""
    chord = jax.vmap(_chord, in_axes=(None, 0, 0, 0))(medium.jet, rays.origin, rays.direction, t_max)
    meets = chord.cuts[:, 0] < chord.cuts[:, -1]
    return for_active(lambda chord: _along(medium, chord), meets, chord, medium.extinction.shape[1])


def _along(medium: JetMedium, chord: _Chord) -> State:
    """Emitted radiance and optical depth of chords [ray, node]."""
    jet = medium.jet
    shares = as_float((np.arange(jet.panels)[:, None] + _GAUSS[None, :]) / jet.panels)

    def piece(state: State, bounds: tuple[Array, Array, Array]) -> tuple[State, None]:
        begin, end, core = bounds
        spread = _spread(jet, chord.view, begin, end)

        def at(share: Array) -> tuple[Array, Array]:
            s, stretch = spread.place(share)
            return jet.fraction(chord.view.z(s), chord.view.r_squared(s)), stretch / (2 * jet.panels)

        def panel(state: State, points: tuple[Array, Array]) -> tuple[State, None]:
            emitted, passed = state
            (near_u, near_j), (far_u, far_j) = (_layer(medium, points[0][i], points[1][i]) for i in (0, 1))
            return (_across(emitted, near_u, near_j, far_u, far_j), passed + (near_u + far_u)), None

        points = jax.vmap(jax.vmap(at))(shares)  # of all panels first: else each node would find them anew
        state, _ = lax.scan(panel, state, points, reverse=True)
        full = medium.extinction[-1][None, :], medium.emission[-1][None, :]
        return _through(state, core[:, None] * full[0], core[:, None] * full[1]), None

    # The core lies in front of the second piece from the far end; the other pieces end in a layer of no length.
    cuts = chord.cuts.T
    none = jnp.zeros_like(cuts[0])
    core = jnp.stack([none, cuts[3] - cuts[2], none, none])
    begins, ends = (jnp.stack([cuts[i] for i in order]) for order in ((4, 3, 1, 0), (5, 4, 2, 1)))
    dark = jnp.zeros((none.shape[0], medium.extinction.shape[1]), medium.extinction.dtype)
    return lax.scan(piece, (dark, dark), (begins, ends, core))[0]


@jax.custom_jvp
def _across(emitted: Array, near_u: Array, near_j: Array, far_u: Array, far_j: Array) -> Array:
    """The radiance in front of a panel, which is A2 and before it A1 of this file's head [ray, node]."""
    shift_u, shift_j = _shift(near_u, far_u)[0], _shift(near_j, far_j)[0]
    length = jnp.ones_like(emitted)
    behind = across_layer(emitted, far_u + shift_u, far_j + shift_j, length)
    return across_layer(behind, near_u - shift_u, near_j - shift_j, length)


@_across.defjvp
def _across_jvp(primals, tangents):
    """Five factors of the tangents, computed once for all tangents; a compiler left alone repeats them for each.

    A layer has dR' = exp(-u) dR + phi1 dj - (exp(-u) R + thinning j) du, with phi1 = exp(-u) + u thinning.
    """
    emitted, near_u, near_j, far_u, far_j = primals
    shift_u, by_near_u, by_far_u = _shift(near_u, far_u)
    shift_j, by_near_j, by_far_j = _shift(near_j, far_j)

    def layer(behind: Array, u: Array, j: Array) -> tuple[Array, Array, Array, Array]:
        kept, bend = jnp.exp(-u), thinning(u)
        mean = kept + u * bend
        return kept * behind + mean * j, kept, mean, -(kept * behind + bend * j)

    between, far_kept, far_mean, far_slope = lax.optimization_barrier(layer(emitted, far_u + shift_u, far_j + shift_j))
    front, kept, mean, slope = lax.optimization_barrier(layer(between, near_u - shift_u, near_j - shift_j))
    far_mean, far_slope = kept * far_mean, kept * far_slope
    factors = lax.optimization_barrier(
        (
            kept * far_kept,
            slope + (far_slope - slope) * by_near_u,
            mean + (far_mean - mean) * by_near_j,
            far_slope + (far_slope - slope) * by_far_u,
            far_mean + (far_mean - mean) * by_far_j,
        )
    )
    change = jnp.zeros_like(emitted)
    for factor, tangent in zip(factors, tangents, strict=True):
        change = change + factor * tangent
    return front, change


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


def _through(state: State, depth: Array, emission: Array) -> State:
    """One more layer in front; `depth` and `emission` are over its length."""
    emitted, passed = state
    depth, emission = jnp.broadcast_to(depth, emitted.shape), jnp.broadcast_to(emission, emitted.shape)
    return through_layer(emitted, depth, emission, jnp.ones_like(emitted)), passed + depth


def _layer(medium: JetMedium, fraction: Float[Array, " ray"], length: Float[Array, " ray"]) -> tuple[Array, Array]:
    """Extinction and emission times a length [ray, node]."""
    extinction, emission = _between(medium.extinction, fraction), _between(medium.emission, fraction)
    return extinction * length[:, None], emission * length[:, None]


def _between(table: Float[Array, "knot node"], fraction: Float[Array, " ray"]) -> Float[Array, "ray node"]:
    """A table over the exhaust fraction, linear between knots."""
    place = fraction * KNOTS
    knot = jnp.clip(place.astype(jnp.int32), 0, KNOTS - 1)
    part = (place - knot.astype(place.dtype))[:, None]
    low = table.at[knot].get(mode="promise_in_bounds")
    return low + part * (table.at[knot + 1].get(mode="promise_in_bounds") - low)


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
        emitted, depth = _integrate(medium, rays, jnp.full((_SAMPLE_RAYS,), jnp.inf, point.dtype))
        return emitted, jnp.exp(-depth)

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
