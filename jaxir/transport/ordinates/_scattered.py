"""Scattered light without samples: the radiance in a plume on a lattice, by discrete ordinates.

In a plume with scattering coefficient s and phase function p light of radiance L(x, w') is scattered into w by

    J(x, w) = s integral p(w . w') L(x, w') dw' = s sum_l chi_l sum_m L_lm(x) Y_lm(w),

L_lm being the coefficients of L in spherical harmonics and chi_l the Legendre moments of p. They solve

    L_lm = L0_lm + K L_lm,

L0 being what arrives at x without having been scattered in the plume, sources without extent too, and K the transport
of J along rays from the lattice's points, in the directions of a rule over the sphere. A Krylov method solves it,
however often light is scattered. L is then known along every other ray by one integral, `Scattered.radiance`.

Of a forward lobe the share f = chi_(order + 1) is taken as not scattered (Wiscombe, "The delta-M method", J. Atmos.
Sci. 34, 1977), and light of sources without extent is scattered once with the whole phase function (Nakajima and
Tanaka, JQSRT 40, 1988). Between the lattice's points L_lm is interpolated by cubics, and the optical depth towards
sources linearly on a lattice `FINER` times as fine. Rays to the lattice's points read it `STEPS` + 1 times each.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxir._arrays import Check, as_float, on_host
from jaxir._math import safe_sqrt, sum_before
from jaxir.geometry import Camera, Rays, degrees, harmonics, sphere_rule
from jaxir.geometry.search import any_hit, closest_hit
from jaxir.medium import AbstractMedium, AbstractScatterer, Capsules, merged_cuts, radiance_between
from jaxir.optics import phi1, thinning
from jaxir.scene import Lit
from jaxir.scene.light import AbstractDeltaSource
from jaxir.transport._method import DiscreteOrdinates
from jaxir.transport.ordinates._collected import collected
from jaxir.transport.ordinates._krylov import solved
from jaxir.transport.ordinates._lattice import Between, Lattice, about, lattice_of, places, refined, unresolved

STEPS = 12  # points of a ray between the lattice's points, nearer to one another near its own
MOST = 2**30  # numbers that transport may keep
CLOSE = {"float32": 1e-4, "float64": 1e-6}  # residual at which to end, as a share of the first term, of each node
SOLVED = 1e-2  # residual of a solution at most
THICK = 4.0  # optical depth of scattering between neighbours of the lattice across a plume at most
LOBE = 0.2  # moment beyond the harmonics that is neglected at most
MOST_STEPS = 200
SLOW = 2.0  # times the change as pieces are halved, which leaves up to half of the error where they are thick
SIDE = 24  # of the grid of rays on which an image's error is found


class _Beam(eqx.Module):
    """A source without extent as seen from the points that are read: optical depth [point, node], and whether."""

    source: AbstractDeltaSource
    depth: Float[Array, "point node"]
    seen: Float[Array, "point 1"]

    def arriving(self, between: Between, point: Float[Array, "ray 3"]) -> tuple[Array, Array]:
        """Irradiance [ray, node] [W m-2] and the direction towards the source [ray, 3]."""
        omega, _ = jax.vmap(self.source.toward)(point)
        passed = jnp.exp(-between.read(self.depth)) * between.read(self.seen)
        return jax.vmap(self.source.beam)(point) * passed, omega


class _Part(eqx.Module):
    """One of `AbstractMedium.parts_with_particles` and the light in it.

    Attributes:
        medium: without its forward lobe.
        kept: share of scattering that is not forward [node].
        moments: chi_l L_lm [read, harmonic, node] [W m-2 sr-1].
        lacking: what `unresolved` says that their mean over all directions lacks [read, 1, node].
        beams: of all sources without extent.
    """

    medium: AbstractScatterer
    kept: Float[Array, " node"]
    moments: Float[Array, "read harmonic node"]
    lacking: Float[Array, "read 1 node"]
    beams: tuple[_Beam, ...]
    counts: tuple[int, int, int] = eqx.field(static=True)

    def read(self, point: Array, toward: Float[Array, "ray harmonic"], table: Array) -> tuple[Array, Between, Array]:
        """Coefficients at points, with `toward` as harmonics and scattered [ray, node]; where that is; scattering."""
        between, scattering = about(self.counts, self.medium.to_cube(point)), self.medium.scattering_at(point)
        near = jnp.where(jnp.any(scattering > 0, axis=1, keepdims=True), between.share, 0)
        return collected(between.point[:, None], near[:, None], scattering[:, None], toward, table), between, scattering

    def source(self, point: Array, direction: Array, toward: Float[Array, "ray harmonic"]) -> Float[Array, "ray node"]:
        """J of rays in `direction` at points [ray, node] [W m-3 sr-1]; `toward` are harmonics of where light goes."""
        found, between, scattering = self.read(point, toward, self.moments)
        phase = self.medium.lobe
        assert phase is not None
        for beam in self.beams:
            irradiance, omega = beam.arriving(between, point)
            lobe = jax.vmap(phase.eval)(jnp.sum(omega * direction, axis=-1))
            found = found + scattering * lobe / self.kept[None] * irradiance
        return found


class Scattered(AbstractMedium):
    """A medium with the light that its particles scatter, however often, as part of its emission.

    Attributes:
        medium: without forward lobes.
        parts: what scatters in it.
        order: highest degree of harmonics.
        residual: what the solution lacks of the equation, as a share of its first term, at most.
        step: largest optical depth of scattering between neighbours of the lattice on that of its axes on which it is
            least: light leaves a long plume across, and along it little changes from one depth to the next.
        backward: largest Legendre moment beyond the harmonics that is none of a forward lobe.
    """

    medium: AbstractMedium
    parts: tuple[_Part, ...]
    order: int = eqx.field(static=True)
    residual: Float[Array, ""]
    step: Float[Array, ""]
    backward: Float[Array, ""]

    def radiance(
        self, rays: Rays, t_max: Float[Array, " ray"], behind: Float[Array, "ray node"], route: Any = None
    ) -> Float[Array, "ray node"]:
        """See `AbstractMedium.radiance`, of emission and scattered light."""
        return self._between(self.cuts(rays, t_max), rays, behind)

    def _between(self, cuts: Float[Array, "ray cut"], rays: Rays, behind: Array) -> Float[Array, "ray node"]:
        def coefficients(rays: Rays, t: Array) -> tuple[Array, Array]:
            point, toward = rays.at(t), harmonics(-rays.direction, self.order)
            extinction, source = self.medium.coefficients(point)
            for part in self.parts:
                source = source + part.source(point, rays.direction, toward)
            return extinction, source

        return radiance_between(cuts, rays, behind, coefficients)

    def lacking(self, rays: Rays) -> tuple[Float[Array, "ray node"], Float[Array, "ray node"]]:
        """Radiance of the plumes alone [ray, node], and what it may lack [ray, node].

        That is what `unresolved` sees for the lattice's coarseness, the harmonics of highest degree for what lies
        beyond them, and `SLOW` times what changes as every piece of a ray between cuts is halved.
        """
        cuts = self.cuts(rays, jnp.full(rays.count, jnp.inf, rays.origin.dtype))
        dark = jnp.zeros((rays.count, self.parts[0].lacking.shape[2]), rays.origin.dtype)
        last = jnp.asarray(degrees(self.order) == self.order, dark.dtype)

        def coefficients(rays: Rays, t: Array) -> tuple[Array, Array]:
            point, toward = rays.at(t), harmonics(-rays.direction, self.order)
            extinction, _ = self.medium.coefficients(point)
            missing = jnp.zeros_like(extinction)
            for part in self.parts:
                missing = missing + part.read(point, toward[:, :1], part.lacking)[0]
                missing = missing + jnp.abs(part.read(point, toward * last[None], part.moments)[0])
            return extinction, missing

        whole = self._between(cuts, rays, dark)
        halved = jnp.stack([cuts[:, :-1], (cuts[:, :-1] + cuts[:, 1:]) / 2], axis=2).reshape(rays.count, -1)
        finer = self._between(jnp.concatenate([halved, cuts[:, -1:]], axis=1), rays, dark)
        return finer, SLOW * jnp.abs(finer - whole) + radiance_between(cuts, rays, dark, coefficients)

    def transmittance(self, rays: Rays, t_max: Float[Array, " ray"]) -> Float[Array, "ray node"]:
        """See `AbstractMedium.transmittance`; what is scattered forward passes."""
        return self.medium.transmittance(rays, t_max)

    def scattering(self, point: Float[Array, "ray 3"], cosine: Float[Array, " ray"]) -> Float[Array, "ray node"]:
        """See `AbstractMedium.scattering`."""
        return self.medium.scattering(point, cosine)

    def cuts(self, rays: Rays, t_max: Float[Array, " ray"]) -> Float[Array, "ray cut"]:
        """See `AbstractMedium.cuts`."""
        return self.medium.cuts(rays, t_max)

    def coefficients(self, point: Float[Array, "ray 3"]) -> tuple[Float[Array, "ray node"], Float[Array, "ray node"]]:
        """See `AbstractMedium.coefficients`, without scattered light."""
        return self.medium.coefficients(point)

    def capsules(self) -> Capsules:
        """See `AbstractMedium.capsules`."""
        return self.medium.capsules()

    @property
    def scatters(self) -> bool:
        """See `AbstractMedium.scatters`: by itself."""
        return False

    @property
    def parts_with_particles(self) -> tuple[AbstractScatterer, ...]:
        """See `AbstractMedium.parts_with_particles`: none that has not been dealt with."""
        return ()

    def brightened(self, factors: Any) -> AbstractMedium:
        """See `AbstractMedium.brightened`: not of light that was solved for; what shines is dimmed before."""
        raise NotImplementedError("Scattered: it was solved for all light together")

    def less_forward(self, shares: Any) -> AbstractMedium:
        """See `AbstractMedium.less_forward`."""
        return self


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
    order, nodes = ordinates.order, lit.nodes.count
    moments = [_moments(part, order, nodes) for part in lit.medium.parts_with_particles]
    medium = lit.medium.less_forward([forward for forward, *_ in moments])
    lit = eqx.tree_at(lambda lit: lit.medium, lit, medium)
    parts, lattices = medium.parts_with_particles, [lattice_of(p, ordinates) for p in medium.parts_with_particles]
    sizes = [math.prod(lattice.solved) for lattice in lattices]
    point = jnp.concatenate([p.from_cube(as_float(places(x.solved))) for p, x in zip(parts, lattices, strict=True)])
    direction, weight = (as_float(x) for x in sphere_rule(2 * order))
    need = len(direction) * sum(sizes) * (STEPS + 1) * nodes * len(parts) ** 2
    if need > MOST:
        raise ValueError(
            f"DiscreteOrdinates: got {need:.2g} numbers to keep, expected at most {MOST:.2g}; take fewer points "
            "(along, across), a lower order or fewer spectral nodes"
        )
    lobes = harmonics(direction, order)
    by_direction = weight[:, None] * lobes

    def ahead(total: Array, own: tuple[Array, Array]) -> tuple[Array, list[tuple[Between, Array]]]:
        rays = Rays(point, jnp.broadcast_to(-own[0], point.shape))
        came = own[1][None, :, None] * arriving(lit, rays)[:, None]
        return total + came, _ahead(medium, list(zip(parts, lattices, strict=True)), rays, _length(lit, rays))

    none = jnp.zeros((point.shape[0], lobes.shape[1], nodes), point.dtype)
    unscattered, routes = lax.scan(ahead, none, (direction, by_direction))

    def split(table: Array) -> list[Array]:
        return jnp.split(table, np.cumsum(sizes)[:-1].tolist())

    def transported(table: Array) -> Array:
        """K of coefficients [point, harmonic, node]."""
        sent = [part * chi[None] for part, (_, chi, _) in zip(split(table), moments, strict=True)]
        into = [jnp.einsum("dh,phn->dpn", lobes, part) for part in sent]
        once = jnp.ones((point.shape[0], 1), table.dtype)

        def one(_: None, own: tuple) -> tuple[None, Array]:
            came = jnp.zeros_like(table[:, 0])
            for (between, passed), lattice, part in zip(own[0], lattices, own[1], strict=True):
                place, near = (x.reshape(*passed.shape[:2], -1) for x in between)
                came = came + collected(place, near, passed, once, refined(lattice, part)[:, None])
            return None, came

        return jnp.einsum("dh,dpn->phn", by_direction, lax.scan(one, None, (routes, into))[1])

    beams = [
        tuple(_beam(lit, medium, part, lattice, source) for source in lit.scene.delta_sources)
        for part, lattice in zip(parts, lattices, strict=True)
    ]
    straight = jnp.zeros_like(unscattered)
    if lit.scene.delta_sources:
        straight = jnp.concatenate([_of_beams(*each, order) for each in zip(parts, lattices, beams, strict=True)])
    begin = unscattered + straight
    scale = jnp.max(jnp.abs(begin), axis=(0, 1))
    scale = lax.stop_gradient(jnp.where(scale > 0, scale, 1))[None, None]

    solution, rest = solved(transported, begin / scale, CLOSE[str(begin.dtype)], MOST_STEPS)
    each = split(solution * scale - straight)  # beams are scattered with the whole lobe
    held = tuple(
        _Part(
            part,
            1 - forward,
            refined(lattice, table * chi[None]),
            lax.stop_gradient(unresolved(lattice, table)),
            own,
            lattice.read,
        )
        for part, lattice, table, own, (forward, chi, _) in zip(parts, lattices, each, beams, moments, strict=True)
    )
    step = jnp.max(jnp.stack([_step(*x) for x in zip(parts, lattices, strict=True)]))
    backward = jnp.max(jnp.stack([beyond for *_, beyond in moments]))
    return Scattered(medium, held, order, *lax.stop_gradient((rest, step, backward)))


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


def _moments(medium: AbstractScatterer, order: int, nodes: int) -> tuple[Float[Array, " node"], Array, Array]:
    """The share that is scattered straight on [node], the moments of the rest [harmonic, node], what lies beyond []."""
    assert medium.lobe is not None
    chi = jnp.broadcast_to(medium.lobe.moments(order + 1), (order + 2, nodes))
    forward = jnp.maximum(jnp.minimum(chi[-2], chi[-1]), 0)  # moments of a lobe backward change their sign
    rest = (chi - forward[None]) / (1 - forward)[None]
    return forward, rest[degrees(order)], jnp.max(jnp.abs(rest[-1]))


def _length(lit: Lit, rays: Rays) -> Float[Array, " ray"]:
    """How far rays from the lattice go [ray] [m]."""
    if lit.scene.skin is None:
        return jnp.full(rays.count, jnp.inf, rays.origin.dtype)
    return closest_hit(lit.scene.skin.mesh, lax.stop_gradient(rays)).t


def _ahead(
    medium: AbstractMedium, parts: list[tuple[AbstractScatterer, Lattice]], rays: Rays, length: Array
) -> list[tuple[Between, Array]]:
    """How rays from the lattice's points read what is scattered on their way: where, and with which weight.

    In each step the medium is as in its middle, and light goes linearly from one end to the other.
    """
    share = as_float((np.arange(STEPS + 1) / STEPS) ** 2)
    cuts = [part.cuts(rays, length) for part, _ in parts]
    edge = merged_cuts([own[:, :1] + (own[:, -1:] - own[:, :1]) * share[None] for own in cuts])
    step = jnp.diff(edge, axis=1)

    def points(t: Array) -> Array:
        return (rays.origin[:, None] + t[..., None] * rays.direction[:, None]).reshape(-1, 3)

    middle, ends = points((edge[:, 1:] + edge[:, :-1]) / 2), points(edge)
    layer = medium.coefficients(middle)[0].reshape(*step.shape, -1) * step[..., None]
    before, at_end = jnp.exp(-sum_before(layer, 1)) * step[..., None], thinning(layer)
    sent = jnp.stack([before * (phi1(layer) - at_end), before * at_end])

    def weights(part: AbstractScatterer) -> Array:
        near, far = sent * part.scattering_at(middle).reshape(layer.shape)[None]
        none = jnp.zeros_like(near[:, :1])
        return jnp.concatenate([near, none], axis=1) + jnp.concatenate([none, far], axis=1)

    return [(about(lattice.read, part.to_cube(ends)), weights(part)) for part, lattice in parts]


def _beam(lit: Lit, medium: AbstractMedium, part: AbstractScatterer, lattice: Lattice, source: Any) -> _Beam:
    """A source as seen from the points that are read."""
    point = part.from_cube(as_float(places(lattice.read)))
    omega, distance = jax.vmap(source.toward)(point)
    passed = medium.transmittance(Rays(point, omega), distance)
    depth = -jnp.log(jnp.maximum(passed, jnp.finfo(passed.dtype).tiny))  # beyond it nothing is left
    seen = jnp.ones((point.shape[0], 1), point.dtype)
    if lit.scene.skin is not None:
        hidden = any_hit(lit.scene.skin.mesh, lax.stop_gradient(Rays(point, omega)), t_max=lax.stop_gradient(distance))
        seen = jnp.where(hidden[:, None], 0, seen)
    return _Beam(source, depth, seen)


def _of_beams(part: AbstractScatterer, lattice: Lattice, beams: tuple[_Beam, ...], order: int) -> Array:
    """Coefficients of the light that comes straight from sources without extent [point, harmonic, node]."""
    place = as_float(places(lattice.solved))
    point, between = part.from_cube(place), about(lattice.read, place)
    each = [beam.arriving(between, point) for beam in beams]
    return functools.reduce(jnp.add, [harmonics(-omega, order)[:, :, None] * light[:, None] for light, omega in each])


def solution_checks(lit: Lit) -> list[Check]:
    """The light in the plumes was found, where it was solved for."""
    if not isinstance(lit.medium, Scattered):
        return []
    _, step, backward, residual = on_host(lit.medium.step, lit.medium.backward, lit.medium.residual)
    name, sample = "DiscreteOrdinates", "or sample what particles scatter"
    return [
        Check(f"{name}: optical depth between points", step, step <= THICK, f"<= {THICK}: more points, {sample}"),
        Check(f"{name}: moment of a lobe backward", backward, backward <= LOBE, f"<= {LOBE}: more order, {sample}"),
        Check(f"{name}: residual", residual, residual <= SOLVED, f"<= {SOLVED}, {sample}"),
    ]


def lattice_error(lit: Lit, camera: Camera) -> Float[Array, " band"] | None:
    """Share of the intensity of plumes in a camera's image that the lattice lacks [band], see `Scattered.lacking`.

    None where nothing was solved for. What is in front of plumes is not looked for.
    """
    if not isinstance(lit.medium, Scattered):
        return None
    start, edges = lit.scene.start(camera), as_float(np.array(list(np.ndindex(2, 2, 2))))
    missing = whole = jnp.zeros(lit.nodes.count, camera.pixel.dtype)
    for part in lit.medium.parts:
        screen, weight = camera.spread_over(part.medium.from_cube(edges), SIDE)
        rays = camera.bundle(screen, start).rays()
        own, lacking = lit.medium.lacking(rays)
        missing, whole = missing + weight @ lacking, whole + weight @ own
    missing, whole = lit.nodes.in_band(missing), lit.nodes.in_band(whole)
    return missing / jnp.where(whole > 0, whole, 1)
