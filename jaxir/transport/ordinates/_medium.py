"""A medium with the light that its particles scatter, once that is known on a lattice; and what it may lack."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxir._arrays import Check, as_float, is_traced, on_host
from jaxir._math import dot, matmul, safe_divide, scan_anew
from jaxir._programs import program
from jaxir.geometry import Camera, Eye, Rays, harmonics
from jaxir.medium import (
    AbstractMedium,
    AbstractScatterer,
    Capsules,
    across_pieces,
    for_active,
    mean_transmittance,
    panel_points,
    panel_weights,
    radiance_between,
)
from jaxir.scene import Lit
from jaxir.transport.ordinates._collected import collected
from jaxir.transport.ordinates._entering import length_of
from jaxir.transport.ordinates._lattice import about
from jaxir.transport.ordinates._part import Aimed, Part, Told

SOLVED = 2e-5  # residual of a solution at most
THICK = 4.0  # optical depth of scattering between neighbours of the lattice across a plume at most
MISREAD = 0.01  # of what a plume emits and scatters of a source's light may err by how depths are read between points
LOBE = 0.2  # moment beyond the harmonics that is neglected at most
SLOW = 2.0  # times the change as pieces are halved, which leaves up to half of the error where they are thick
MORE = 12  # cuts of a ray where light that reaches it comes from
SIDE = 64  # of the grid of rays of which those are chosen on which an image's error is found
CHOSEN = 256  # of them

T = TypeVar("T")


class Scattered(AbstractMedium):
    """A medium with the light that its particles scatter, however often, as part of its emission.

    Attributes:
        medium: without forward lobes; with them where what the lattice errs is sampled.
        parts: what scatters in it.
        order: highest degree of harmonics.
        residual: what the solution lacks of the equation, as a share of its first term, at most.
        step: largest optical depth of scattering between neighbours of the lattice on that of its axes on which it is
            least: light leaves a long plume across, and along it little changes from one depth to the next.
        backward: largest Legendre moment beyond the harmonics that is none of a forward lobe.
        through: whether beams are found through the medium along rays, as depths at points of the lattice are too far
            apart; None where that is seen while a program runs. Never where what the lattice errs is sampled.
    """

    medium: AbstractMedium
    parts: tuple[Part, ...]
    order: int = eqx.field(static=True)
    residual: Float[Array, ""]
    step: Float[Array, ""]
    backward: Float[Array, ""]
    through: bool | None = eqx.field(static=True)

    def radiance(
        self, rays: Rays, t_max: Float[Array, " ray"], behind: Float[Array, "ray node"], route: Any = None
    ) -> Float[Array, "ray node"]:
        """See `AbstractMedium.radiance`, of emission and scattered light."""
        cuts = self._pieces(rays, t_max)
        return self._between(cuts, rays, behind)

    def aimed_at(self, eye: Eye) -> Scattered:
        """The same, ready for many rays that meet in an eye."""
        each = zip(self.parts, _sent_to(self.parts, eye), strict=True)
        return dataclasses.replace(self, parts=tuple(dataclasses.replace(part, aimed=aimed) for part, aimed in each))

    def _pieces(self, rays: Rays, t_max: Float[Array, " ray"]) -> Float[Array, "ray cut"]:
        """`cuts` and `MORE` between them, from which on equal shares of a ray's light come.

        The medium is smooth between its cuts, scattered light need not be: along a jet's core it fades with depth.
        """
        cuts = self.cuts(rays, t_max)
        left = mean_transmittance(self.medium, rays, cuts)
        wanted = 1 - as_float((np.arange(MORE) + 0.5) / MORE)[None] * (1 - left[:, -1:])
        depth, at = (-jnp.log(jnp.maximum(x, jnp.finfo(x.dtype).tiny)) for x in (left, wanted))
        return jnp.sort(jnp.concatenate([cuts, jax.vmap(jnp.interp)(at, depth, cuts)], axis=1), axis=1)

    def _between(
        self, cuts: Float[Array, "ray cut"], rays: Rays, behind: Array, alone: int | None = None
    ) -> Float[Array, "ray node"]:
        """Radiance between cuts [ray, node]; with what one part `alone` scatters, of rays of the eye it is aimed at."""

        def between(through: bool) -> Array:
            def coefficients(to_eye: bool, rays: Rays, t: Array) -> tuple[Array, Array]:
                point = rays.at(t)
                extinction, source = self.medium.coefficients(point)
                for place, part in enumerate(self.parts):
                    if alone is None or place == alone:
                        near = part.near(point, self.medium if through else None)
                        source = source + (part.sent(near) if to_eye else part.source(near, point, rays.direction))
                return extinction, source

            def across(cuts: Array, rays: Rays, behind: Array) -> Array:
                def found(to_eye: bool) -> Array:
                    return across_pieces(cuts, rays, behind, partial(coefficients, to_eye))

                aimed = [part.aimed for part in self.parts if part.aimed is not None]
                if alone is not None or len(aimed) < len(self.parts):
                    return found(alone is not None)
                served = jnp.all(jnp.stack([own.serves(rays) for own in aimed]))  # those of the eye are neighbours
                return lax.cond(served, lambda: found(True), lambda: found(False))

            return radiance_between(cuts, rays, behind, across)

        return self._with_beams(between)

    def settled(self) -> Scattered:
        """The same with what its values decide about programs, where these are known, as by `jax.grad` outside jit."""
        if self.through is not None:
            return self
        misreads = self._misreads
        return self if is_traced(misreads) else dataclasses.replace(self, through=bool(np.asarray(misreads)))

    @property
    def _misreads(self) -> Bool[Array, ""]:
        """Whether depths towards a source err by more than `MISREAD` where they are read between points."""
        return jnp.any(jnp.stack([beam.misread > MISREAD for part in self.parts for beam in part.beams]))

    def _with_beams(self, found: Callable[[bool], T]) -> T:
        """What is `found` with beams through the medium, or else by depths that are read.

        Decided for all rays: in the loop along them a search through the medium would keep it from native code.
        """
        if self.through is None:
            return lax.cond(self._misreads, lambda: found(True), lambda: found(False))
        return found(self.through)

    @property
    def nodes(self) -> int:
        """How many spectral nodes there are."""
        return self.parts[0].moments.shape[2]

    def lacking(self, rays: Rays, t_max: Float[Array, " ray"], place: int) -> tuple[Float[Array, "ray node"], ...]:
        """What rays of the eye at which it is aimed see of one of the parts before they end, and what that may lack.

        Radiances [ray, node]: those of `Told` summed along rays, with what all parts emit, and `SLOW` times what
        changes as every piece of a ray is halved. Where what the lattice errs is sampled, that is all of it.
        """
        cuts = self._pieces(rays, t_max)
        dark = jnp.zeros((rays.count, self.nodes), rays.origin.dtype)
        part = self.parts[place]

        def told(point: Array, through: bool) -> tuple[Array, list[Array]]:
            extinction, emission = self.medium.coefficients(point)
            whole, rough, *others = part.told(part.near(point, self.medium if through else None))
            return extinction, [emission + whole, emission + rough, *others]

        halved = jnp.stack([cuts[:, :-1], (cuts[:, :-1] + cuts[:, 1:]) / 2], axis=2).reshape(rays.count, -1)
        halved = jnp.concatenate([halved, cuts[:, -1:]], axis=1)
        if self.parts[0].doubt is None:
            whole = self._between(halved, rays, dark, place)
            found = Told(whole, whole, dark, dark)
        else:
            found = Told(*self._with_beams(lambda through: summed(halved, rays, partial(told, through=through))))
        return *found, SLOW * jnp.abs(found.whole - self._between(cuts, rays, dark, place))

    def expected(
        self, point: Float[Array, "ray 3"], along: Float[Array, "ray 3"], omega: Float[Array, "ray 3"]
    ) -> Float[Array, "ray node"]:
        """scattering * phase * L of light from `omega` that is scattered into rays `along` [ray, node].

        Its integral over all directions is the part of J that `moments` hold. Light that comes straight from sources
        without extent is not in it.
        """
        total = jnp.zeros((point.shape[0], self.nodes), point.dtype)
        toward = harmonics(-omega, self.order)
        for part in self.parts:
            assert part.field is not None
            between = about(part.counts, part.medium.to_cube(point))
            one = jnp.ones_like(total)[:, None]
            field = collected(between.point[:, None], between.share[:, None], one, toward, part.field)
            total = total + part.medium.scattering(point, dot(along, omega)) * field
        return total

    def expected_beams(self, point: Float[Array, "ray 3"], along: Float[Array, "ray 3"]) -> Float[Array, "ray node"]:
        """The part of J of rays `along` that comes straight from sources without extent [ray, node]."""
        total = jnp.zeros((point.shape[0], self.nodes), point.dtype)
        for part in self.parts:
            total = total + part.of_beams(part.near(point), point, along)
        return total

    def transmittance(self, rays: Rays, t_max: Float[Array, " ray"]) -> Float[Array, "ray node"]:
        """See `AbstractMedium.transmittance`; what is scattered forward passes."""
        return self.medium.transmittance(rays, t_max)

    @property
    def given(self) -> AbstractMedium:
        """The medium with its forward lobes."""
        return self.medium.less_forward([1 - 1 / part.kept for part in self.parts])

    def unscattered(self, rays: Rays, t_max: Float[Array, " ray"]) -> Float[Array, "ray node"]:
        """Share of what passes that was not scattered forward either [ray, node]; 1 where nothing passes."""
        straight, passed = (medium.transmittance(rays, t_max) for medium in (self.given, self.medium))
        return jnp.where(passed > 0, safe_divide(straight, passed), 1)

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


def summed(
    cuts: Float[Array, "ray cut"], rays: Rays, coefficients: Callable[[Array], tuple[Array, list[Array]]]
) -> list[Array]:
    """Radiances [ray, node] at the origins of rays of several sources in one medium, smooth between cuts.

    What passes is found once for all of them: .8 of the time of `radiance_between` with each beside the others.

    Args:
        cuts: as `AbstractMedium.cuts`.
        rays: the rays.
        coefficients: extinction [ray, node] [m-1] and sources, each [ray, node] [W m-3 sr-1], at points [ray, 3] [m].
    """
    shape, sources = jax.eval_shape(coefficients, rays.origin)
    nodes = shape.shape[1]

    def along(some: tuple[Array, Rays]) -> Array:
        cuts, rays = some
        twice = jax.tree.map(lambda x: jnp.concatenate([x, x]), rays)
        dark = jnp.zeros((rays.count, nodes), cuts.dtype)

        def panel(state: tuple[Array, list[Array]], points: tuple[Array, Array]) -> tuple[Any, None]:
            (passed, totals), (t, half) = state, points
            extinction, sources = coefficients(twice.at(t.reshape(-1)))
            near, far = jnp.split(extinction * jnp.concatenate([half, half])[:, None], 2)
            shares = [share * passed * half[:, None] for share in panel_weights(near, far)]
            sent = [[share * own for share, own in zip(shares, jnp.split(x, 2), strict=True)] for x in sources]
            totals = [total + a + b for total, (a, b) in zip(totals, sent, strict=True)]
            return (passed * jnp.exp(-near - far), totals), None

        found = scan_anew(panel, (jnp.ones_like(dark), [dark] * len(sources)), panel_points(cuts))[0][1]
        return jnp.concatenate(found, axis=1)

    found = for_active(along, cuts[:, 0] < cuts[:, -1], (cuts, rays), nodes * len(sources))
    return jnp.split(found, len(sources), axis=1)


@program
def _sent_to(parts: tuple[Part, ...], eye: Eye) -> tuple[Aimed, ...]:
    return tuple(part.sent_to(eye) for part in parts)


def solution_checks(lit: Lit) -> list[Check]:
    """The light in the plumes was found, where it was solved for."""
    if not isinstance(lit.medium, Scattered):
        return []
    _, step, backward, residual = on_host(lit.medium.step, lit.medium.backward, lit.medium.residual)
    name, sample = "DiscreteOrdinates", "or sample what particles scatter"
    return [
        Check(f"{name}: optical depth between points", step, step <= THICK, f"<= {THICK}: more points, {sample}"),
        Check(f"{name}: moment of a lobe backward", backward, backward <= LOBE, f"<= {LOBE}: more order, {sample}"),
        Check(f"{name}: residual", residual, residual <= SOLVED, f"<= {SOLVED}: more points along plumes, {sample}"),
    ]


def chosen_rays(part: Part, camera: Camera, start: Float[Array, ""]) -> tuple[Rays, Float[Array, " ray"]]:
    """Rays of a camera through a plume and their weights: sum weight L is the plume's intensity I of `spread_over`.

    A jet is narrow where it is brightest. Of `SIDE`^2 even rays `CHOSEN` are taken, at even quantiles of the sum of how
    bright they are if nothing is absorbed; something is, so half of the sum is that of equal shares.
    """
    edges = as_float(np.array(list(np.ndindex(2, 2, 2))))
    screen, weight = camera.spread_over(part.medium.from_cube(edges), SIDE)
    rays = camera.bundle(screen, start).rays()
    bright = part.brightness(rays)
    mean = jnp.mean(bright)
    share = (bright / jnp.where(mean > 0, mean, 1) + 1) / 2
    below = jnp.cumsum(share)
    quantile = below[-1] * as_float((np.arange(CHOSEN) + 0.5) / CHOSEN)
    taken = jnp.minimum(jnp.searchsorted(below, quantile), SIDE**2 - 1)
    chosen = jax.tree.map(lambda of_all: of_all[taken], rays)
    return chosen, weight[taken] * below[-1] / (CHOSEN * share[taken])


@program
def lattice_lacks(bare: Lit, camera: Camera) -> Float[Array, "part kind node"] | None:
    """What `Scattered.lacking` sees of each plume, summed over a camera's image; None where nothing was solved for.

    Of a scene `Lit.in_vacuum`, before it is aimed at: a program that images and tables share, through any air and in
    any bands.
    """
    if not isinstance(bare.medium, Scattered):
        return None
    medium, found = bare.medium.aimed_at(camera.eye), []
    for place, part in enumerate(medium.parts):
        rays, weight = chosen_rays(part, camera, bare.scene.start(camera))
        lacks = medium.lacking(rays, length_of(bare.scene, rays), place)
        found.append(jnp.stack([matmul(weight, radiance) for radiance in lacks]))
    return jnp.stack(found)


@program
def lattice_error(lit: Lit, lacks: Float[Array, "*view part kind node"] | None) -> Float[Array, "*view band"] | None:
    """What the lattice lacks of the intensity of plumes in an image [band] [W sr-1]; None where it lacks none.

    It is what `lattice_lacks` found, and what changed from fewer harmonics to those there are, through the air.
    """
    if lacks is None:
        return None
    whole, rough, reading, beams, pieces = jnp.moveaxis(lit.nodes.in_band(lit.dimmed_by_air(lacks)), -2, 0)
    return jnp.sum(reading + jnp.abs(beams) + pieces + jnp.abs(whole - rough), axis=-2)
