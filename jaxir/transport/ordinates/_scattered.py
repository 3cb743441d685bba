"""The solution of the equations of scattered light, and the medium that holds it; see `_posed`."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from jaxir._arrays import as_float
from jaxir._math import einsum, safe_sqrt
from jaxir.geometry import degrees
from jaxir.medium import AbstractScatterer
from jaxir.transport._method import DiscreteOrdinates
from jaxir.transport.ordinates._collected import collected
from jaxir.transport.ordinates._halo import DEGREE, Halo, halo
from jaxir.transport.ordinates._krylov import solved
from jaxir.transport.ordinates._lattice import Lattice, at_solved, places, refined
from jaxir.transport.ordinates._medium import Scattered
from jaxir.transport.ordinates._part import Beam, Doubt, Part
from jaxir.transport.ordinates._posed import Moments, Posed, lattices_of, rule

# Residual at which to end, as a share of the first term, of each node. Light out of the far end of a deep plume whose
# particles absorb next to nothing errs a thousand times as much.
CLOSE = {"float32": 2e-6, "float64": 1e-8}
MOST_STEPS = 200
FEWER = 2  # degrees of the solution that shows what harmonics do
FINE, JUMPS = 0.25, 2.0  # times the change by `Lattice.lines` that moments err where a medium is smooth, and else
CLOSE_OF_OTHERS = 1e-4  # residual at which those end that show what the lattice errs


class Solution(NamedTuple):
    """L_lm [some, point, harmonic, node] as it is, with fewer harmonics, and read as by `Lattice.lines`; what it lacks.

    Where what the lattice errs is not told, the first alone.
    """

    light: Float[Array, "some point harmonic node"]
    residual: Float[Array, " some"]


def solution(given: Posed, ordinates: DiscreteOrdinates, group: Int[Array, ""], told: bool) -> Solution:
    """The solution of one of the groups of equations, and two more where what the lattice errs shall be `told`."""
    own = given.groups.of(group)
    lattices, (_, lobes, by_direction) = lattices_of(given.medium, ordinates), rule(ordinates.order, given.medium)

    def transported(light: list[Array], rest: list[Array], readers: Sequence[Callable]) -> Array:
        """K of light [point, harmonic, node].

        Args:
            light: its coefficients, of each part [some, harmonic, node].
            rest: moments of the harmonics that are kept, of each part [harmonic, node].
            readers: how it comes to the points that are read, of each part.
        """
        into = [einsum("dh,phn->dpn", lobes, part * own[None]) for part, own in zip(light, rest, strict=True)]
        count, _, nodes = own.unscattered.shape
        once = jnp.ones((count, 1), lobes.dtype)

        def one(_: None, own: tuple) -> tuple[None, Array]:
            came = jnp.zeros((count, nodes), lobes.dtype)
            for (place, share), passed, part, read in zip(*own, readers, strict=True):
                place, share = (x.reshape(*passed.shape[:2], *x.shape[1:]) for x in (place, share))
                came = came + collected(place, share, passed, once, read(part)[:, None])
            return None, came

        came = einsum("dh,dpn->phn", by_direction, lax.scan(one, None, (given.where, own.passed, into))[1])
        return came + own.unseen * _alike(light, own.albedo, lattices)[:, None]

    degree = degrees(ordinates.order)
    every, fewer = np.ones_like(degree, dtype=bool), _fewer(ordinates.order)
    count = 3 if told else 1
    kept, first = as_float(np.stack([every, fewer, every][:count])), as_float(np.array([1, 0, 0][:count]))
    close = as_float(np.array([CLOSE[str(lobes.dtype)], CLOSE_OF_OTHERS, CLOSE_OF_OTHERS][:count]))
    ways = [[as_float(np.stack([c, c, p][:count])) for c, p in zip(x.cubics, x.lines, strict=True)] for x in lattices]

    def one(near: Array, asked: tuple[Array, Array, list, Array]) -> tuple[Array, tuple[Array, Array]]:
        kept, close, way, first = asked
        some = [part * kept[:, None] for part in own.rest]
        readers = [functools.partial(refined, lattice, ways=each) for lattice, each in zip(lattices, way, strict=True)]
        once = transported(own.straight, some, [lambda light: light] * len(lattices)) if own.straight else 0
        found = solved(
            lambda table: transported(_split(table, lattices), some, readers),
            own.unscattered + once,
            close,
            MOST_STEPS,
            near,
        )
        return near + first * found[0], found  # the others begin at the first

    return Solution(*lax.scan(one, jnp.zeros_like(own.unscattered), (kept, close, ways, first))[1])


def finished(given: Posed, ordinates: DiscreteOrdinates, solutions: Solution) -> Scattered:
    """The medium with its scattered light, of the solutions of all groups [group, ...]."""
    order, nodes = ordinates.order, given.scale.shape[-1]
    parts, lattices = given.medium.parts_with_particles, lattices_of(given.medium, ordinates)
    light = jnp.moveaxis(solutions.light, 0, -2)
    light = light.reshape(*light.shape[:-2], -1)[..., :nodes]
    each, *others = (_split(x * given.scale, lattices) for x in light)  # beams are scattered with the whole lobe
    rough, other = others or (each, each)
    doubtful, fewer = bool(others), _fewer(order)
    errs = ordinates.orders > 0  # errors are sampled, in the medium as it is

    def of_few(own: Moments, table: Array) -> Array:
        return (table * own.rest[None])[:, fewer]

    held = tuple(
        Part(
            medium=whole if errs else part,
            kept=jnp.ones_like(own.forward) if errs else 1 - own.forward,
            moments=refined(lattice, table * (own.all if errs else own.rest)[None]),
            field=refined(lattice, table) if errs else None,
            doubt=lax.stop_gradient(_doubt(part, lattice, *(of_few(own, found) for found in (table, few, lined))))
            if doubtful
            else None,
            glow=lax.stop_gradient(_glow(part, lattice, table)),
            halo=_halo(part, shining, own.forward, order),
            beams=shining,
            counts=lattice.read,
        )
        for whole, part, lattice, table, few, lined, shining, own in zip(
            given.given.parts_with_particles,
            parts,
            lattices,
            each,
            rough,
            other,
            given.beams,
            given.moments,
            strict=True,
        )
    )
    step = jnp.max(jnp.stack([_step(*x) for x in zip(parts, lattices, strict=True)]))
    backward = jnp.max(jnp.stack([own.beyond for own in given.moments]))
    told = lax.stop_gradient((jnp.max(solutions.residual[:, 0]), step, backward))
    through = None if any(given.beams) and not errs else False
    return Scattered(given.given if errs else given.medium, held, order, *told, through)


def _alike(light: list[Array], albedo: list[Array], lattices: list[Lattice]) -> Float[Array, "point node"]:
    """What all parts scatter of light that is the same from all sides, as at each point, in other parts as in the mean.

    Args:
        light: its coefficients, of each part at the points that are solved for or read [some, harmonic, node].
        albedo: of each part seen from all points [point, node].
        lattices: of the parts.
    """
    total, counts = jnp.zeros_like(albedo[0]), [math.prod(lattice.solved) for lattice in lattices]
    for k, (own, share, lattice) in enumerate(zip(light, albedo, lattices, strict=True)):
        mean = own[:, 0] / math.sqrt(4 * math.pi)
        if len(mean) > counts[k]:
            mean = at_solved(lattice, mean)
        others = jnp.broadcast_to(jnp.mean(mean, axis=0)[None], total.shape)
        total = total + share * lax.dynamic_update_slice_in_dim(others, mean, sum(counts[:k]), 0)
    return total


def _fewer(order: int) -> np.ndarray:
    """Which harmonics the solution has that shows what they do [harmonic]."""
    return degrees(order) <= max(order - FEWER, 0)


def _split(table: Float[Array, "point *more"], lattices: list[Lattice]) -> list[Array]:
    """A table of the points of all parts, by parts."""
    return jnp.split(table, np.cumsum([math.prod(lattice.solved) for lattice in lattices])[:-1].tolist())


def _doubt(medium: AbstractScatterer, lattice: Lattice, table: Array, few: Array, lined: Array) -> Doubt:
    """Of moments [point, few, node] that were solved for, also with fewer harmonics and as read by `Lattice.lines`."""
    change = refined(lattice, table) - refined(lattice, lined, lattice.lines)
    return Doubt(refined(lattice, few), change * (FINE if medium.smooth else JUMPS))


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


def _halo(part: AbstractScatterer, beams: tuple[Beam, ...], forward: Float[Array, " node"], order: int) -> Halo | None:
    if not beams:
        return None
    assert part.lobe is not None
    chi = jnp.broadcast_to(part.lobe.moments(DEGREE), (DEGREE + 1, len(forward)))
    deepest = functools.reduce(jnp.maximum, [lax.stop_gradient(beam.forward).max(axis=0) for beam in beams])
    return halo(chi, forward, order, deepest)
