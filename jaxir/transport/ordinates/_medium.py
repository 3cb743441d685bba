"""A medium with the light that its particles scatter, once that is known on a lattice; and what it may lack."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxir._arrays import Check, as_float, on_host
from jaxir._math import dot
from jaxir.geometry import Camera, Rays, harmonics
from jaxir.medium import AbstractMedium, AbstractScatterer, Capsules, radiance_between
from jaxir.scene import Lit
from jaxir.scene.light import AbstractDeltaSource
from jaxir.transport.ordinates._collected import collected
from jaxir.transport.ordinates._halo import Halo
from jaxir.transport.ordinates._lattice import Between, about

SOLVED = 2e-5  # residual of a solution at most
THICK = 4.0  # optical depth of scattering between neighbours of the lattice across a plume at most
LOBE = 0.2  # moment beyond the harmonics that is neglected at most
SLOW = 2.0  # times the change as pieces are halved, which leaves up to half of the error where they are thick
SPREAD = 0.05  # of what halos change, which is right where angles are small
MORE = 8  # cuts of a ray where light that reaches it comes from
SIDE = 64  # of the grid of rays of which those are chosen on which an image's error is found
CHOSEN = 256  # of them
POINTS = 32  # of each at which it is seen how bright it is


class Beam(eqx.Module):
    """A source without extent as seen from the points that are read.

    Attributes:
        source: the source.
        depth: optical depth towards it [point, node].
        forward: depth of what is scattered forward, which is not in `depth` [point, node].
        aside: what passes more by the depth at the points alone, where `depth` is the mean about them [point, node].
        seen: whether nothing hides it.
    """

    source: AbstractDeltaSource
    depth: Float[Array, "point node"]
    forward: Float[Array, "point node"]
    aside: Float[Array, "point node"]
    seen: Float[Array, "point 1"]

    def arriving(self, between: Between, point: Float[Array, "ray 3"]) -> tuple[Array, Array]:
        """Irradiance [ray, node] [W m-2] and the direction towards the source [ray, 3]."""
        omega, _ = jax.vmap(self.source.toward)(point)
        passed = jnp.exp(-between.read(self.depth)) * between.read(self.seen)
        return jax.vmap(self.source.beam)(point) * passed, omega

    def doubtful(self, between: Between, point: Float[Array, "ray 3"]) -> Array:
        """How much irradiance may err as it is read between points [ray, node] [W m-2]: half of what `aside` makes."""
        return jax.vmap(self.source.beam)(point) * between.read(self.aside) * between.read(self.seen) / 2


class Doubt(NamedTuple):
    """What tells how much moments may err.

    Attributes:
        rough: what they were if there were fewer harmonics [read, few, node].
        reading: how much of what changes as the lattice is read by `Lattice.plain` they may err [read, few, node]:
            half of it, all where the medium jumps.
    """

    rough: Float[Array, "read few node"]
    reading: Float[Array, "read few node"]


class Part(eqx.Module):
    """One of `AbstractMedium.parts_with_particles` and the light in it.

    Attributes:
        medium: without its forward lobe; with it where what the lattice errs is sampled.
        kept: share of its scattering that is in it [node].
        moments: chi_l L_lm [read, harmonic, node] [W m-2 sr-1].
        field: L_lm [read, harmonic, node]; None where what the lattice errs is not sampled.
        doubt: of the moments; None where what the lattice errs is sampled.
        glow: emission and scattering in the mean over directions, as shares of the largest of each node [read, 1, 1].
        halo: of what is scattered forward; None without beams.
        beams: of all sources without extent.
    """

    medium: AbstractScatterer
    kept: Float[Array, " node"]
    moments: Float[Array, "read harmonic node"]
    field: Float[Array, "read harmonic node"] | None
    doubt: Doubt | None
    glow: Float[Array, "read 1 1"]
    halo: Halo | None
    beams: tuple[Beam, ...]
    counts: tuple[int, int, int] = eqx.field(static=True)

    def read(self, point: Array, toward: Float[Array, "ray harmonic"], table: Array) -> tuple[Array, Between, Array]:
        """Coefficients at points, with `toward` as harmonics and scattered [ray, node]; where that is; scattering."""
        between, scattering = about(self.counts, self.medium.to_cube(point)), self.medium.scattering_at(point)
        near = jnp.where(jnp.any(scattering > 0, axis=1)[:, None, None], between.share, 0)
        return collected(between.point[:, None], near[:, None], scattering[:, None], toward, table), between, scattering

    def brightness(self, rays: Rays) -> Float[Array, " ray"]:
        """How bright rays are in the mean over the nodes if nothing is absorbed on their way."""
        cuts = self.medium.cuts(rays, jnp.full(rays.count, jnp.inf, rays.origin.dtype))
        length = (cuts[:, -1] - cuts[:, 0]) / POINTS
        t = cuts[:, :1] + length[:, None] * as_float(np.arange(POINTS) + 0.5)[None]
        between = about(self.counts, self.medium.to_cube(rays.at(t).reshape(-1, 3)))
        near, share = (x.reshape(*t.shape, *x.shape[1:]) for x in between)
        each = jnp.broadcast_to(length[:, None, None], (*t.shape, 1))
        return collected(near, share, each, jnp.ones_like(length)[:, None], self.glow)[:, 0]

    def source(
        self, point: Array, direction: Array, toward: Array, tables: Sequence[Array]
    ) -> tuple[list[Array], Array]:
        """J of rays in `direction` at points [ray, node] [W m-3 sr-1] by tables of moments, and what beams may err.

        Args:
            point: points [ray, 3] [m].
            direction: of the rays [ray, 3].
            toward: harmonics of where light goes [ray, harmonic].
            tables: moments [read, some, node], of the first of the harmonics.
        """
        read = [self.read(point, toward[:, : table.shape[1]], table) for table in tables]
        straight, doubt = self.of_beams(point, direction, *read[0][1:])
        return [found + straight for found, *_ in read], doubt

    def of_beams(self, point: Array, direction: Array, between: Between, scattering: Array) -> tuple[Array, Array]:
        """What of J comes straight from sources without extent [ray, node], and what it may err.

        That is `SPREAD` of what `halo` changes and `Beam.doubtful`. See `read` for the last two arguments.
        """
        phase = self.medium.lobe
        assert phase is not None
        straight, doubt = jnp.zeros_like(scattering), jnp.zeros_like(scattering)
        for beam in self.beams:
            assert self.halo is not None
            irradiance, omega = beam.arriving(between, point)
            cosine, scatters = dot(omega, direction), scattering / self.kept[None]
            lobe, change = jax.vmap(phase.eval)(cosine), self.halo.change(cosine, between.read(beam.forward))
            straight = straight + scatters * irradiance * (lobe + change)
            doubt = doubt + scatters * (SPREAD * irradiance * change + beam.doubtful(between, point) * lobe)
        return straight, doubt


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
    """

    medium: AbstractMedium
    parts: tuple[Part, ...]
    order: int = eqx.field(static=True)
    residual: Float[Array, ""]
    step: Float[Array, ""]
    backward: Float[Array, ""]

    def radiance(
        self, rays: Rays, t_max: Float[Array, " ray"], behind: Float[Array, "ray node"], route: Any = None
    ) -> Float[Array, "ray node"]:
        """See `AbstractMedium.radiance`, of emission and scattered light."""
        return self._between(self._pieces(rays, t_max), rays, behind)

    def _pieces(self, rays: Rays, t_max: Float[Array, " ray"]) -> Float[Array, "ray cut"]:
        """`cuts` and `MORE` between them, from which on equal shares of a ray's light come.

        The medium is smooth between its cuts, scattered light need not be: along a jet's core it fades with depth.
        """
        cuts = self.cuts(rays, t_max)

        def across(passed: Array, piece: tuple[Array, Array]) -> tuple[Array, Array]:
            middle, length = piece
            left = passed * jnp.exp(-self.medium.coefficients(rays.at(middle))[0] * length[:, None])
            return left, jnp.mean(left, axis=1)

        whole = jnp.ones((rays.count, self.nodes), cuts.dtype)
        left = lax.scan(across, whole, (((cuts[:, 1:] + cuts[:, :-1]) / 2).T, jnp.diff(cuts).T))[1].T
        left = jnp.concatenate([jnp.ones_like(left[:, :1]), left], axis=1)
        wanted = 1 - as_float((np.arange(MORE) + 0.5) / MORE)[None] * (1 - left[:, -1:])
        depth, at = (-jnp.log(jnp.maximum(x, jnp.finfo(x.dtype).tiny)) for x in (left, wanted))
        return jnp.sort(jnp.concatenate([cuts, jax.vmap(jnp.interp)(at, depth, cuts)], axis=1), axis=1)

    def _between(self, cuts: Float[Array, "ray cut"], rays: Rays, behind: Array) -> Float[Array, "ray node"]:
        def coefficients(rays: Rays, t: Array) -> tuple[Array, Array]:
            point, toward = rays.at(t), harmonics(-rays.direction, self.order)
            extinction, source = self.medium.coefficients(point)
            for part in self.parts:
                (found,), _ = part.source(point, rays.direction, toward, [part.moments])
                source = source + found
            return extinction, source

        return radiance_between(cuts, rays, behind, coefficients)

    @property
    def nodes(self) -> int:
        """How many spectral nodes there are."""
        return self.parts[0].moments.shape[2]

    def lacking(self, rays: Rays) -> tuple[Float[Array, "ray node"], ...]:
        """Radiance of the plumes alone [ray, node], that of fewer harmonics, and what else it may lack, of each cause.

        That is what may change with the way in which the lattice is read (`Doubt`) and what beams may err
        (`Part.of_beams`), with their signs, and `SLOW` times what changes as every piece of a ray is halved. Where what
        the lattice errs is sampled, that is all of it.
        """
        cuts = self._pieces(rays, jnp.full(rays.count, jnp.inf, rays.origin.dtype))
        dark = jnp.zeros((rays.count, self.nodes), rays.origin.dtype)
        count = 1 if self.parts[0].doubt is None else 4

        def coefficients(rays: Rays, t: Array) -> tuple[Array, Array]:
            """Of all that are looked for side by side."""
            point, toward = rays.at(t), harmonics(-rays.direction, self.order)
            extinction, emission = self.medium.coefficients(point)
            whole, rough, coarse, beams = emission, emission, jnp.zeros_like(emission), jnp.zeros_like(emission)
            for part in self.parts:
                if part.doubt is None:
                    (found,), _ = part.source(point, rays.direction, toward, [part.moments])
                    whole = whole + found
                    continue
                (found, few), doubt = part.source(point, rays.direction, toward, [part.moments, part.doubt.rough])
                reading = part.doubt.reading
                whole, rough, beams = whole + found, rough + few, beams + doubt
                coarse = coarse + part.read(point, toward[:, : reading.shape[1]], reading)[0]
            return jnp.tile(extinction, count), jnp.concatenate([whole, rough, coarse, beams][:count], axis=1)

        halved = jnp.stack([cuts[:, :-1], (cuts[:, :-1] + cuts[:, 1:]) / 2], axis=2).reshape(rays.count, -1)
        halved = jnp.concatenate([halved, cuts[:, -1:]], axis=1)
        found = radiance_between(halved, rays, jnp.tile(dark, count), coefficients)
        finer, rough, coarse, beams = jnp.split(found, 4, axis=1) if count == 4 else (found, found, dark, dark)
        return finer, rough, coarse, beams, SLOW * jnp.abs(finer - self._between(cuts, rays, dark))

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
            between, scattering = about(part.counts, part.medium.to_cube(point)), part.medium.scattering_at(point)
            total = total + part.of_beams(point, along, between, scattering)[0]
        return total

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


def lattice_error(lit: Lit, camera: Camera) -> Float[Array, " band"] | None:
    """Share of the intensity of plumes in a camera's image that the lattice lacks [band].

    It is what `Scattered.lacking` sees, and what changed from fewer harmonics to those there are. None where nothing
    was solved for. What is in front of plumes is not looked for.
    """
    if not isinstance(lit.medium, Scattered):
        return None
    found = jnp.zeros((5, lit.nodes.count), camera.pixel.dtype)
    for part in lit.medium.parts:
        rays, weight = chosen_rays(part, camera, lit.scene.start(camera))
        found = found + jnp.stack([weight @ radiance for radiance in lit.medium.lacking(rays)])
    whole, rough, coarse, beams, pieces = (lit.nodes.in_band(each) for each in found)
    lacks = jnp.abs(coarse) + jnp.abs(beams) + pieces + jnp.abs(whole - rough)
    return lacks / jnp.where(whole > 0, whole, 1)
