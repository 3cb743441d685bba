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
lattice `FINER` times as fine. Rays to the lattice's points read it twice in each of `PANELS`.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxir._arrays import as_float
from jaxir._math import safe_sqrt, sum_before
from jaxir.geometry import Rays, degrees, harmonics, sphere_rule
from jaxir.geometry.search import any_hit, closest_hit
from jaxir.medium import AbstractMedium, AbstractScatterer, merged_cuts, panel_points, panel_weights
from jaxir.scene import Lit
from jaxir.transport._method import DiscreteOrdinates
from jaxir.transport.ordinates._collected import collected
from jaxir.transport.ordinates._halo import DEGREE, Halo, halo
from jaxir.transport.ordinates._krylov import solved
from jaxir.transport.ordinates._lattice import FINER, Between, Lattice, about, beside, lattice_of, places, refined
from jaxir.transport.ordinates._medium import Scattered
from jaxir.transport.ordinates._part import Beam, Doubt, Part

PANELS = 6  # of a ray between the lattice's points, where the medium is smooth; else twice as many
PROBED = 4  # points of each at which it is seen where they shall lie
MOST = 2**30  # numbers that transport may keep
# Residual at which to end, as a share of the first term, of each node. Light out of the far end of a deep plume whose
# particles absorb next to nothing errs a thousand times as much.
CLOSE = {"float32": 2e-6, "float64": 1e-8}
MOST_STEPS = 200
TOGETHER = 16  # nodes solved for together: little scattering ends sooner than much
CORNERS = ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))  # of cubes, about points that see a beam
FEWER = 2  # degrees of the solution that shows what harmonics do
CLOSE_OF_OTHERS = 1e-4  # residual at which those end that show what the lattice errs


def scattered(lit: Lit, ordinates: DiscreteOrdinates, arriving: Callable[[Lit, Rays], Array]) -> Scattered:
    """Solve for the light in the plumes of a scene.

    Args:
        lit: the scene on the nodes.
        ordinates: how finely.
        arriving: radiance at the origins of rays in a scene whose particles do not scatter [ray, node].

    Returns:
        The medium with its scattered light.

    Raises:
        ValueError: more numbers than `MOST` would be kept.

    Differentiable, in both modes, in all that `lit` is differentiable in: the equation's solution has its own rule.
    """
    assert lit.medium is not None
    order, nodes, given = ordinates.order, lit.nodes.count, lit.medium
    _require_that_it_fits(given, ordinates, nodes)
    moments = [_moments(part, order, nodes) for part in given.parts_with_particles]
    medium = given.less_forward([own.forward for own in moments])
    lit = eqx.tree_at(lambda lit: lit.medium, lit, medium)
    parts, lattices = medium.parts_with_particles, [lattice_of(p, ordinates) for p in medium.parts_with_particles]
    sizes = [math.prod(lattice.solved) for lattice in lattices]
    point = jnp.concatenate([p.from_cube(as_float(places(x.solved))) for p, x in zip(parts, lattices, strict=True)])
    direction, weight = (as_float(x) for x in sphere_rule(2 * order))
    lobes = harmonics(direction, order)
    by_direction = weight[:, None] * lobes

    groups = -(-nodes // TOGETHER)

    def grouped(of_nodes: Array) -> Array:
        """Groups of nodes of a table [group, ..., node]; the last is filled with zeros."""
        many = -(-nodes // groups)
        filled = jnp.pad(of_nodes, [(0, 0)] * (of_nodes.ndim - 1) + [(0, groups * many - nodes)])
        return jnp.moveaxis(filled.reshape(*of_nodes.shape[:-1], groups, many), -2, 0)

    def ahead(total: Array, own: tuple[Array, Array]) -> tuple[Array, list[tuple[Between, Array]]]:
        rays = Rays(point, jnp.broadcast_to(-own[0], point.shape))
        came = own[1][None, :, None] * arriving(lit, rays)[:, None]
        steps = _ahead(medium, list(zip(parts, lattices, strict=True)), rays, _length(lit, rays))
        return total + came, [(between, grouped(passed)) for between, passed in steps]

    none = jnp.zeros((point.shape[0], lobes.shape[1], nodes), point.dtype)
    unscattered, routes = lax.scan(ahead, none, (direction, by_direction))
    where, passed = [route[0] for route in routes], [route[1] for route in routes]

    def split(table: Array) -> list[Array]:
        return jnp.split(table, np.cumsum(sizes)[:-1].tolist())

    def transported(light: list[Array], rest: list[Array], passed: list[Array], readers: Sequence[Callable]) -> Array:
        """K of the light of some nodes [point, harmonic, node].

        Args:
            light: its coefficients, of each part [some, harmonic, node].
            rest: moments of the harmonics that are kept, of each part [harmonic, node].
            passed: what `_ahead` says of each part [direction, point, step, node].
            readers: how it comes to the points that are read, of each part.
        """
        into = [jnp.einsum("dh,phn->dpn", lobes, part * own[None]) for part, own in zip(light, rest, strict=True)]
        once = jnp.ones((point.shape[0], 1), point.dtype)

        def one(_: None, own: tuple) -> tuple[None, Array]:
            came = jnp.zeros((point.shape[0], rest[0].shape[-1]), point.dtype)
            for (place, share), passed, part, read in zip(*own, readers, strict=True):
                place, share = (x.reshape(*passed.shape[:2], *x.shape[1:]) for x in (place, share))
                came = came + collected(place, share, passed, once, read(part)[:, None])
            return None, came

        return jnp.einsum("dh,dpn->phn", by_direction, lax.scan(one, None, (where, passed, into))[1])

    beams = [
        tuple(_beam(lit, medium, given, part, lattice, source) for source in lit.scene.delta_sources)
        for part, lattice in zip(parts, lattices, strict=True)
    ]
    straight = [_of_beams(*each, order) for each in zip(parts, lattices, beams, strict=True) if each[-1]]
    scale = functools.reduce(jnp.maximum, [jnp.max(jnp.abs(light), axis=(0, 1)) for light in (unscattered, *straight)])
    scale = lax.stop_gradient(jnp.where(scale > 0, scale, 1))[None, None]

    degree = degrees(order)
    fewer = degree <= max(order - FEWER, 0)
    every = np.ones_like(fewer)
    errs = ordinates.orders > 0  # and that is sampled, in the medium as it is
    count = 1 if errs else 3
    kept, first = as_float(np.stack([every, fewer, every][:count])), as_float(np.array([1, 0, 0][:count]))
    close = as_float(np.array([CLOSE[str(point.dtype)], CLOSE_OF_OTHERS, CLOSE_OF_OTHERS][:count]))
    ways = [[as_float(np.stack([c, c, p][:count])) for c, p in zip(x.cubics, x.plain, strict=True)] for x in lattices]

    def of_nodes(own: tuple[Array, list[Array], list[Array], list[Array]]) -> tuple[Array, Array]:
        """Solutions of some nodes, with fewer harmonics, and read as by `Lattice.plain`; and what they lack.

        Where what the lattice errs is sampled, the first alone.
        """
        begin, straight, rest, passed = own

        def one(near: Array, own: tuple[Array, Array, list, Array]) -> tuple[Array, tuple[Array, Array]]:
            kept, close, way, first = own
            some = [part * kept[:, None] for part in rest]
            readers = [
                functools.partial(refined, lattice, ways=each) for lattice, each in zip(lattices, way, strict=True)
            ]
            once = transported(straight, some, passed, [lambda light: light] * len(parts)) if straight else 0
            found = solved(
                lambda table: transported(split(table), some, passed, readers), begin + once, close, MOST_STEPS, near
            )
            return near + first * found[0], found  # the others begin at the first

        return lax.scan(one, jnp.zeros_like(begin), (kept, close, ways, first))[1]

    asked = (
        grouped(unscattered / scale),
        [grouped(light / scale) for light in straight],
        [grouped(own.rest) for own in moments],
        [jnp.moveaxis(x, 1, 0) for x in passed],
    )
    solutions, rests = lax.map(of_nodes, asked)
    solutions = jnp.moveaxis(solutions, 0, -2)
    solutions = solutions.reshape(*solutions.shape[:-2], -1)[..., :nodes]
    each, *others = (split(x * scale) for x in solutions)  # without beams, which are scattered with the whole lobe
    rough, other = others or (each, each)

    def of_few(own: _Moments, table: Array) -> Array:
        return (table * own.rest[None])[:, fewer]

    held = tuple(
        Part(
            medium=whole if errs else part,
            kept=jnp.ones_like(own.forward) if errs else 1 - own.forward,
            moments=refined(lattice, table * (own.all if errs else own.rest)[None]),
            field=refined(lattice, table) if errs else None,
            doubt=None
            if errs
            else lax.stop_gradient(_doubt(part, lattice, *(of_few(own, found) for found in (table, few, plain)))),
            glow=lax.stop_gradient(_glow(part, lattice, table)),
            halo=_halo(part, shining, own.forward, order),
            beams=shining,
            counts=lattice.read,
        )
        for whole, part, lattice, table, few, plain, shining, own in zip(
            given.parts_with_particles, parts, lattices, each, rough, other, beams, moments, strict=True
        )
    )
    step = jnp.max(jnp.stack([_step(*x) for x in zip(parts, lattices, strict=True)]))
    backward = jnp.max(jnp.stack([own.beyond for own in moments]))
    return Scattered(given if errs else medium, held, order, *lax.stop_gradient((jnp.max(rests[:, 0]), step, backward)))


def _require_that_it_fits(medium: AbstractMedium, ordinates: DiscreteOrdinates, nodes: int) -> None:
    parts = medium.parts_with_particles
    counts = [part.lattice(ordinates.along, ordinates.across) for part in parts]
    points, splines = sum(map(math.prod, counts)), sum(FINER * count**2 for own in counts for count in own)
    directions = (2 * ordinates.order + 2) * (2 * ordinates.order + 3)  # of the rule for twice the degree
    need = directions * points * 2 * sum(map(_panels, parts)) * nodes * len(parts) + splines
    if need > MOST:
        raise ValueError(
            f"DiscreteOrdinates: got {need:.2g} numbers to keep, expected at most {MOST:.2g}; take fewer points "
            "(along, across), a lower order or fewer spectral nodes"
        )


def _doubt(medium: AbstractScatterer, lattice: Lattice, table: Array, few: Array, plain: Array) -> Doubt:
    """Of moments [point, few, node] that were solved for, also with fewer harmonics and as read by `Lattice.plain`."""
    change = refined(lattice, table) - refined(lattice, plain, lattice.plain)
    return Doubt(refined(lattice, few), change / 2 if medium.smooth else change)


def _step(medium: AbstractScatterer, lattice: Lattice) -> Float[Array, ""]:
    """See `Scattered.step`."""
    point = medium.from_cube(as_float(places(lattice.solved)))
    scattering = medium.scattering_at(point).max(axis=1).reshape(lattice.solved)
    point = point.reshape(*lattice.solved, 3)
    found = []
    for axis in range(3):
        apart = safe_sqrt(jnp.sum(jnp.diff(point, axis=axis) ** 2, axis=-1))
        last = scattering.shape[axis]
        both = [lax.slice_in_dim(scattering, k, last - 1 + k, axis=axis) for k in (0, 1)]
        found.append(jnp.max(apart * jnp.maximum(*both)))
    return jnp.min(jnp.stack(found))


def _glow(medium: AbstractScatterer, lattice: Lattice, table: Float[Array, "point harmonic node"]) -> Array:
    """See `Part.glow`."""
    point = medium.from_cube(as_float(places(lattice.read)))
    mean = jnp.maximum(refined(lattice, table[:, 0]), 0)
    each = medium.coefficients(point)[1] + medium.scattering_at(point) * mean
    most = each.max(axis=0)
    return jnp.mean(each / jnp.where(most > 0, most, 1)[None], axis=1)[:, None, None]


class _Moments(NamedTuple):
    """Legendre moments of a lobe, by harmonic.

    `forward` is the share that is scattered straight on [node], `rest` and `all` are the moments of the rest and of the
    whole lobe [harmonic, node], `beyond` is the largest of the rest that no harmonic holds [].
    """

    forward: Array
    rest: Array
    all: Array
    beyond: Array


def _moments(medium: AbstractScatterer, order: int, nodes: int) -> _Moments:
    assert medium.lobe is not None
    chi = jnp.broadcast_to(medium.lobe.moments(order + 1), (order + 2, nodes))
    forward = jnp.maximum(jnp.minimum(chi[-2], chi[-1]), 0)  # moments of a lobe backward change their sign
    rest = (chi - forward[None]) / (1 - forward)[None]
    return _Moments(forward, rest[degrees(order)], chi[degrees(order)], jnp.max(jnp.abs(rest[-1])))


def _length(lit: Lit, rays: Rays) -> Float[Array, " ray"]:
    """How far rays from the lattice go [ray] [m]."""
    if lit.scene.skin is None:
        return jnp.full(rays.count, jnp.inf, rays.origin.dtype)
    return closest_hit(lit.scene.skin.mesh, lax.stop_gradient(rays)).t


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
        middle = rays.at((t[:, 1:] + t[:, :-1]) / 2).reshape(-1, 3)
        extinction = medium.coefficients(middle)[0].reshape(rays.count, PROBED * panels, -1)
        passed = jnp.exp(-jnp.cumsum(extinction * jnp.diff(t)[..., None], axis=1))
        hidden = jnp.concatenate([jnp.zeros_like(t[:, :1]), jnp.mean(1 - passed, axis=2)], axis=1)
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
    place, aside = places(lattice.read), beside(lattice.read)
    many = part.from_cube(as_float(np.concatenate([place, *(place + aside * np.array(corner) for corner in CORNERS)])))
    omega, distance = jax.vmap(source.toward)(many)
    each = [one.transmittance(Rays(many, omega), distance) for one in (medium, given)]
    each = [-jnp.log(jnp.maximum(x, jnp.finfo(x.dtype).tiny)) for x in each]  # beyond it nothing is left
    own, whole = (x.reshape(1 + len(CORNERS), len(place), -1) for x in each)
    weight = lax.stop_gradient(part.scattering_at(many).max(axis=1)).reshape(*own.shape[:2], 1)[1:]
    total = weight.sum(axis=0, keepdims=True)
    weight = jnp.where(total > 0, weight, 1) / jnp.where(total > 0, total, len(CORNERS))
    depth, whole = ((weight * x[1:]).sum(axis=0) for x in (own, whole))
    point, omega, distance = (x[: len(place)] for x in (many, omega, distance))
    seen = jnp.ones((point.shape[0], 1), point.dtype)
    if lit.scene.skin is not None:
        hidden = any_hit(lit.scene.skin.mesh, lax.stop_gradient(Rays(point, omega)), t_max=lax.stop_gradient(distance))
        seen = jnp.where(hidden[:, None], 0, seen)
    return Beam(
        source, depth, jnp.maximum(whole - depth, 0), lax.stop_gradient(jnp.exp(-own[0]) - jnp.exp(-depth)), seen
    )


def _halo(part: AbstractScatterer, beams: tuple[Beam, ...], forward: Float[Array, " node"], order: int) -> Halo | None:
    if not beams:
        return None
    assert part.lobe is not None
    chi = jnp.broadcast_to(part.lobe.moments(DEGREE), (DEGREE + 1, len(forward)))
    deepest = functools.reduce(jnp.maximum, [lax.stop_gradient(beam.forward).max(axis=0) for beam in beams])
    return halo(chi, forward, order, deepest)


def _of_beams(part: AbstractScatterer, lattice: Lattice, beams: tuple[Beam, ...], order: int) -> Array:
    """Coefficients of the light that comes straight from sources without extent [read, harmonic, node]."""
    point = part.from_cube(as_float(places(lattice.read)))

    def one(beam: Beam) -> Array:
        light = jax.vmap(beam.source.beam)(point) * jnp.exp(-beam.depth) * beam.seen
        return harmonics(-beam.toward(point), order)[:, :, None] * light[:, None]

    return functools.reduce(jnp.add, map(one, beams))
