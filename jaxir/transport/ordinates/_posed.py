"""Scattered light without samples: the radiance in a plume on a lattice, by discrete ordinates.

In a plume with scattering coefficient s and phase function p light of radiance L(x, w') is scattered into w by

    J(x, w) = s integral p(w . w') L(x, w') dw' = s sum_l chi_l sum_m L_lm(x) Y_lm(w),

L_lm being the coefficients of L in spherical harmonics and chi_l the Legendre moments of p. They solve

    L_lm = L0_lm + K (B_lm + L_lm),

L0 being what arrives at x without having been scattered in the plume, B what comes straight from sources without extent
and K the transport of J along rays from the lattice's points, in the directions of a rule over the sphere. A Krylov
method solves it, however often light is scattered. L is then known along every other ray by one integral,
`Scattered.radiance`.

Of a forward lobe the share f = chi_(order + 1) is taken as not scattered (Wiscombe, "The delta-M method", J. Atmos.
Sci. 34, 1977), and light of sources without extent is scattered once with the whole phase function (Nakajima and
Tanaka, JQSRT 40, 1988), as spread as it is by what was scattered forward before, see `_halo`. Between the lattice's
points L_lm is interpolated by cubics, and B, with its shadows, and the optical depth towards sources linearly on a
lattice `FINER` times as fine; where a plume is too deep for that, light on its way to an eye is scattered once out of
beams that are found through the medium. Rays to the lattice's points read it twice in each of `PANELS`.

Few directions of a rule for harmonics look along a narrow plume: of one twenty times as long as wide they meet 1 to 6 %
too little. L0 is summed over those of a rule for `MORE` degrees more, and K, whose directions are kept, changed by the
share of the surroundings that these find hidden beyond it, as if light at a point were alike from all sides: a furnace
stays one.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.scipy.linalg import block_diag
from jaxtyping import Array, Int

from jaxir._arrays import as_float
from jaxir._math import matmul, scan_anew, sum_before
from jaxir.geometry import Rays, degrees, harmonics, rule_size, sphere_rule
from jaxir.geometry.search import any_hit
from jaxir.medium import (
    AbstractMedium,
    AbstractScatterer,
    mean_transmittance,
    merged_cuts,
    panel_points,
    panel_weights,
)
from jaxir.scene import Lit
from jaxir.transport._method import DiscreteOrdinates, Method
from jaxir.transport._paths import Paths
from jaxir.transport._through import Answer, Through
from jaxir.transport.ordinates._entering import entering, length_of, level_of
from jaxir.transport.ordinates._lattice import FINER, Between, Lattice, about, beside, lattice_of, places
from jaxir.transport.ordinates._part import Beam

PANELS = 6  # of a ray between the lattice's points, where the medium is smooth; else twice as many
PROBED = 4  # points of each at which it is seen where they shall lie
MOST = 2**30  # numbers that transport may keep
TOGETHER = 16  # nodes solved for together: little scattering ends sooner than much
MORE = 3  # degrees of harmonics whose directions show what arrives without having been scattered
CORNERS = ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))  # of cubes, about points that see a beam


class Moments(NamedTuple):
    """Legendre moments of a lobe, by harmonic.

    `forward` is the share that is scattered straight on [node], `rest` and `all` are the moments of the rest and of the
    whole lobe [harmonic, node], `beyond` is the largest of the rest that no harmonic holds [].
    """

    forward: Array
    rest: Array
    all: Array
    beyond: Array


class Groups(NamedTuple):
    """What is known of groups of nodes of their equations, as shares of `Posed.scale`; the last is filled with zeros.

    Attributes:
        unscattered: L0 [group, point, harmonic, node].
        straight: B, of each part that sources without extent light [group, read, harmonic, node].
        rest: moments of the harmonics that are kept, of each part [group, harmonic, node].
        passed: what `_ahead` says of each part [direction, group, point, step, node]: as it was found, because it is
            by far the largest table and another order would be another of that size.
        unseen: what the rule lacks of the share of the surroundings that is hidden [group, point, harmonic, node].
        albedo: share of that which each part scatters [group, point, node].
    """

    unscattered: Array
    straight: list[Array]
    rest: list[Array]
    passed: list[Array]
    unseen: Array
    albedo: list[Array]

    def of(self, group: Int[Array, ""]) -> Groups:
        """One of them, without its axis."""
        passed = [each[:, group] for each in self.passed]
        return jax.tree.map(lambda leaf: leaf[group], self._replace(passed=[]))._replace(passed=passed)


class Posed(NamedTuple):
    """The equations of a scene, not solved yet.

    Attributes:
        given: the medium with its forward lobes.
        medium: without them.
        beams: sources without extent as seen from each of its parts.
        moments: of their lobes.
        where: how rays to the lattice's points read them [direction, ...].
        groups: the equations.
        scale: the largest light of each node [1, 1, node].
    """

    given: AbstractMedium
    medium: AbstractMedium
    beams: list[tuple[Beam, ...]]
    moments: list[Moments]
    where: list[Between]
    groups: Groups
    scale: Array


def posed(lit: Lit, method: Method, behind: Callable[[Lit, Paths, Through], Answer]) -> Posed:
    """The equations of the light in the plumes of a scene.

    Args:
        lit: the scene on the nodes.
        method: how finely, and how light is found that skin sends into the plumes.
        behind: what enters paths of one segment at their far ends [ray, node], see `behind_plumes`.

    Raises:
        ValueError: more numbers than `MOST` would be kept.

    This, `solution` and `finished` are differentiable, in both modes, in all that `lit` is differentiable in: the
    equation's solution has its own rule.
    """
    assert lit.medium is not None and method.scattering is not None
    ordinates = method.scattering
    order, nodes, given = ordinates.order, lit.nodes.count, lit.medium
    _require_that_it_fits(given, ordinates, nodes)
    moments = [_moments(part, order, nodes) for part in given.parts_with_particles]
    medium = given.less_forward([own.forward for own in moments])
    lit = eqx.tree_at(lambda lit: lit.medium, lit, medium)
    parts, lattices = medium.parts_with_particles, lattices_of(medium, ordinates)
    point = jnp.concatenate([p.from_cube(as_float(places(x.solved))) for p, x in zip(parts, lattices, strict=True)])
    direction, _, by_direction = rule(order, medium)
    among, _, by_among = rule(order, medium, MORE)

    def toward(own: Array) -> Rays:
        return Rays(point, jnp.broadcast_to(-own, point.shape))

    groups, every = -(-nodes // TOGETHER), jnp.concatenate([direction, among])
    length = lax.map(lambda own: length_of(lit.scene, toward(own)), every)
    level = level_of(lit, length)
    lobes = block_diag(by_direction, by_among).reshape(len(every), 2, -1)  # what is hidden is summed for either rule

    def hidden_in(total: Array, own: tuple[Array, Array, Array]) -> tuple[Array, None]:
        hidden = 1 - medium.transmittance(toward(own[0]), own[2])
        return total + own[1][:, None, :, None] * hidden[None, :, None], None

    none = jnp.zeros((point.shape[0], by_direction.shape[1], nodes), point.dtype)
    hidden, all_hidden = scan_anew(hidden_in, jnp.stack([none, none]), (every, lobes, length))[0]
    length, length_among = length[: len(direction)], length[len(direction) :]

    def grouped(of_nodes: Array) -> Array:
        """Groups of nodes of a table [group, ..., node]."""
        many = -(-nodes // groups)
        filled = jnp.pad(of_nodes, [(0, 0)] * (of_nodes.ndim - 1) + [(0, groups * many - nodes)])
        return jnp.moveaxis(filled.reshape(*of_nodes.shape[:-1], groups, many), -2, 0)

    def ahead(scattered: list[Array], own: tuple[Array, Array, Array]) -> tuple[list[Array], list]:
        steps = _ahead(medium, list(zip(parts, lattices, strict=True)), toward(own[0]), own[2])
        scattered = [all_ + own[1][0] * passed.sum(axis=1) for all_, (_, passed) in zip(scattered, steps, strict=True)]
        return scattered, [(between, grouped(passed)) for between, passed in steps]

    def beyond(total: Array, own: tuple[Array, Array, Array]) -> tuple[Array, None]:
        rays = toward(own[0])
        came = medium.radiance(rays, own[2], level.toward(lit, rays.direction))
        return total + own[1][None, :, None] * came[:, None], None

    scattered, routes = scan_anew(ahead, [none[:, 0]] * len(parts), (direction, by_direction, length))
    unscattered = scan_anew(beyond, none, (among, by_among, length_among))[0]
    unscattered = unscattered + entering(lit, method, point, order, level, behind)
    some = hidden[:, 0] > 0
    albedo = [jnp.where(some, each / jnp.where(some, hidden[:, 0], 1), 0) for each in scattered]
    where, passed = ([route[k] for route in routes] for k in range(2))
    beams = [
        tuple(_beam(lit, medium, given, part, lattice, source) for source in lit.scene.delta_sources)
        for part, lattice in zip(parts, lattices, strict=True)
    ]
    straight = [_of_beams(*each, order) for each in zip(parts, lattices, beams, strict=True) if each[-1]]
    scale = functools.reduce(jnp.maximum, [jnp.max(jnp.abs(light), axis=(0, 1)) for light in (unscattered, *straight)])
    scale = lax.stop_gradient(jnp.where(scale > 0, scale, 1))[None, None]
    equations = Groups(
        grouped(unscattered / scale),
        [grouped(light / scale) for light in straight],
        [grouped(own.rest) for own in moments],
        passed,
        grouped(all_hidden - hidden),
        [grouped(own) for own in albedo],
    )
    return Posed(given, medium, beams, moments, where, equations, scale)


def lattices_of(medium: AbstractMedium, ordinates: DiscreteOrdinates) -> list[Lattice]:
    return [lattice_of(part, ordinates) for part in medium.parts_with_particles]


def rule(order: int, medium: AbstractMedium, more: int = 0) -> tuple[Array, Array, Array]:
    """Directions to the lattice's points [direction, 3], their harmonics [direction, harmonic], and with weights.

    They lie about the first part's axis: light of a narrow jet comes along it or across. `more` makes them as many as
    those of harmonics of so many degrees more.
    """
    direction, weight = (as_float(x) for x in sphere_rule(2 * (order + more)))
    direction = matmul(direction, lax.stop_gradient(medium.parts_with_particles[0].frame))
    lobes = harmonics(direction, order)
    return direction, lobes, weight[:, None] * lobes


def _require_that_it_fits(medium: AbstractMedium, ordinates: DiscreteOrdinates, nodes: int) -> None:
    parts = medium.parts_with_particles
    counts = [part.lattice(ordinates.along, ordinates.across) for part in parts]
    points, splines = sum(map(math.prod, counts)), sum(FINER * count**2 for own in counts for count in own)
    need = rule_size(2 * ordinates.order) * points * 2 * sum(map(_panels, parts)) * nodes * len(parts) + splines
    if need > MOST:
        raise ValueError(
            f"DiscreteOrdinates: got {need:.2g} numbers to keep, expected at most {MOST:.2g}; take fewer points "
            "(along, across), a lower order or fewer spectral nodes"
        )


def _moments(medium: AbstractScatterer, order: int, nodes: int) -> Moments:
    assert medium.lobe is not None
    chi = jnp.broadcast_to(medium.lobe.moments(order + 1), (order + 2, nodes))
    forward = jnp.maximum(jnp.minimum(chi[-2], chi[-1]), 0)  # moments of a lobe backward change their sign
    rest = (chi - forward[None]) / (1 - forward)[None]
    return Moments(forward, rest[degrees(order)], chi[degrees(order)], jnp.max(jnp.abs(rest[-1])))


def _panels(part: AbstractScatterer) -> int:
    """Panels of a ray through a part: where they do not end where the medium jumps, shorter ones err less."""
    return PANELS if part.smooth else 2 * PANELS


def _ahead(
    medium: AbstractMedium, parts: list[tuple[AbstractScatterer, Lattice]], rays: Rays, length: Array
) -> list[tuple[Between, Array]]:
    """How rays from the lattice's points read what is scattered on their way: where, and with which weight.

    A panel is integrated from two points, see `panel_weights`. Panels are short near the rays' origins, and where what
    is seen from there ends.
    """

    def edges(part: AbstractScatterer) -> Array:
        cuts, panels = part.cuts(rays, length), _panels(part)
        even = as_float(np.arange(PROBED * panels + 1) / (PROBED * panels))
        near = even**2
        t = cuts[:, :1] + (cuts[:, -1:] - cuts[:, :1]) * near[None]
        hidden = 1 - mean_transmittance(medium, rays, t)
        most = hidden[:, -1:]
        share = (hidden / jnp.where(most > 0, most, 1) + even[None]) / 2
        wanted = share[:, -1:] * as_float(np.arange(panels + 1) / panels)[None]
        return jax.vmap(jnp.interp)(wanted, share, t)

    t, half = panel_points(merged_cuts([edges(part) for part, _ in parts]))
    t, half = jnp.moveaxis(t, 2, 0), half.T[:, :, None]
    place = rays.at(t).reshape(-1, 3)
    depth = medium.coefficients(place)[0].reshape(*t.shape, -1) * half[:, :, None]
    before = jnp.exp(-sum_before(depth.sum(axis=2), 1)) * half
    sent = jnp.stack([before * share for share in panel_weights(depth[:, :, 0], depth[:, :, 1])], axis=2)

    def weights(part: AbstractScatterer) -> Array:
        return (sent * part.scattering_at(place).reshape(sent.shape)).reshape(rays.count, 2 * t.shape[1], -1)

    return [(about(lattice.read, part.to_cube(place)), weights(part)) for part, lattice in parts]


def _beam(
    lit: Lit, medium: AbstractMedium, given: AbstractMedium, part: AbstractScatterer, lattice: Lattice, source: Any
) -> Beam:
    """A source as seen from the points that are read, in a medium that was `given` with its forward lobes.

    Depths are means of places about each point, by what is scattered there: across cells that lie along light they
    jump, and points may lie on the cells' sides.
    """
    place, step = places(lattice.read), beside(lattice.read)
    corner = as_float(np.concatenate([place + step * np.array(corner) for corner in CORNERS]))
    many = part.from_cube(corner)
    omega, distance = jax.vmap(source.toward)(many)
    (own, rest), (whole, _) = (eqx.partition(one, eqx.is_array) for one in (medium, given))

    def passing(_: None, one: AbstractMedium) -> tuple[None, Array]:
        return None, eqx.combine(one, rest).transmittance(Rays(many, omega), distance)

    both = jax.tree.map(lambda *two: jnp.stack(two), own, whole)  # one program for both
    passed, of_given = scan_anew(passing, None, both)[1]
    each = lax.stop_gradient(part.scattering_at(many))
    scattering = each.max(axis=1).reshape(len(CORNERS), len(place), 1)
    total = scattering.sum(axis=0, keepdims=True)
    weight = jnp.where(total > 0, scattering, 1) / jnp.where(total > 0, total, len(CORNERS))

    def mean(at_corners: Array) -> Array:
        return (weight * at_corners.reshape(*weight.shape[:2], -1)).sum(axis=0)

    tiny = jnp.finfo(passed.dtype).tiny  # beyond it nothing is left
    depth, whole = (mean(-jnp.log(jnp.maximum(x, tiny))) for x in (passed, of_given))
    aside = mean(passed - jnp.exp(-about(lattice.read, corner).read(depth)))
    point = part.from_cube(as_float(place))
    lit_by = mean(each) * jax.vmap(source.beam)(point) / (4 * math.pi)
    sent = jnp.sum(mean(part.coefficients(many)[1]) + lit_by * mean(passed), axis=0)
    misread = jnp.max(jnp.sum(lit_by * jnp.abs(aside), axis=0) / jnp.where(sent > 0, sent, 1))
    omega, distance = jax.vmap(source.toward)(point)
    seen = jnp.ones((point.shape[0], 1), point.dtype)
    if lit.scene.skin is not None:
        hidden = any_hit(lit.scene.skin.mesh, lax.stop_gradient(Rays(point, omega)), t_max=lax.stop_gradient(distance))
        seen = jnp.where(hidden[:, None], 0, seen)
    forward, aside, misread = jnp.maximum(whole - depth, 0), *lax.stop_gradient((aside, misread))
    return Beam(source, depth, forward, aside, seen, misread)


def _of_beams(part: AbstractScatterer, lattice: Lattice, beams: tuple[Beam, ...], order: int) -> Array:
    """Coefficients of the light that comes straight from sources without extent [read, harmonic, node]."""
    point = part.from_cube(as_float(places(lattice.read)))

    def one(beam: Beam) -> Array:
        light = jax.vmap(beam.source.beam)(point) * jnp.exp(-beam.depth) * beam.seen
        return harmonics(-beam.toward(point), order)[:, :, None] * light[:, None]

    return functools.reduce(jnp.add, map(one, beams))
