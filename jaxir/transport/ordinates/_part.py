"""What one kind of particles scatters, once the light on its lattice is known: into any direction, or to one eye.

    J = s (sum_lm chi_l L_lm Y_lm(w) + sum_b E_b (p(w_b . w) + what halos change))

All rays of an eye have one direction w through a point. So what depends on directions, the first sum and lobes, can be
found once for every point that is read and interpolated as moments are; rays of the eye then need neither harmonics nor
lobes, which are most of the time. Depths towards sources are interpolated before they are exponents in any case.
Directions to the eye, and to sources, turn between neighbours, by which a harmonic of degree l errs l (l + 1) / 16 of
the squared angle: `NARROW` is the largest.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxir._arrays import as_float
from jaxir._math import dot
from jaxir.geometry import Eye, Rays, harmonics
from jaxir.medium import AbstractMedium, AbstractScatterer, for_active
from jaxir.scene.light import AbstractDeltaSource
from jaxir.transport.ordinates._collected import collected
from jaxir.transport.ordinates._halo import Halo
from jaxir.transport.ordinates._lattice import Between, about, places

NARROW = 5e-3  # between directions from neighbours to an eye or a source [rad]; harmonics of degree 3 err 2e-5
ALIKE = 1e-4  # between a ray's direction and that from its origin to an eye in which it is taken to meet others
SPREAD = 0.05  # of what halos change, which is right where angles are small
POINTS = 32  # of a ray at which it is seen how bright it is


class Beam(eqx.Module):
    """A source without extent as seen from the points that are read.

    Attributes:
        source: the source.
        depth: optical depth towards it [point, node].
        forward: depth of what is scattered forward, which is not in `depth` [point, node].
        aside: what passes more in the mean about the points than `depth` says where it is read there [point, node].
        seen: whether nothing hides it.
        misread: share by which that errs, of what is emitted and scattered of its light, in the worst node.
    """

    source: AbstractDeltaSource
    depth: Float[Array, "point node"]
    forward: Float[Array, "point node"]
    aside: Float[Array, "point node"]
    seen: Float[Array, "point 1"]
    misread: Float[Array, ""]

    def toward(self, point: Float[Array, "ray 3"]) -> Float[Array, "ray 3"]:
        """Directions to the source."""
        return jax.vmap(self.source.toward)(point)[0]

    def read(self, between: Between, point: Float[Array, "ray 3"]) -> Lighting:
        """Its light where nothing but the medium is in its way, by the depths at the points that are read."""
        beam = jax.vmap(self.source.beam)(point)
        return Lighting(beam * jnp.exp(-between.read(self.depth)), beam * between.read(self.aside))

    def found(self, medium: AbstractMedium, point: Float[Array, "ray 3"]) -> Lighting:
        """The same through the medium itself."""
        omega, distance = jax.vmap(self.source.toward)(point)
        light = jax.vmap(self.source.beam)(point) * medium.transmittance(Rays(point, omega), distance)
        return Lighting(light, jnp.zeros_like(light))


class Lighting(NamedTuple):
    """Irradiance, and how much it may err, with its sign [ray, node] [W m-2]."""

    irradiance: Float[Array, "ray node"]
    doubtful: Float[Array, "ray node"]


class Near(NamedTuple):
    """What is needed of a part at points.

    Attributes:
        between: how the lattice is read there.
        scattering: coefficients [m-1].
        lit: by every beam, where nothing but the medium is in its way.
    """

    between: Between
    scattering: Float[Array, "ray node"]
    lit: tuple[Lighting, ...]


class Doubt(NamedTuple):
    """What tells how much moments may err.

    Attributes:
        rough: what they were if there were fewer harmonics [read, few, node].
        reading: how much they may err by how the lattice is read, with signs [read, few, node]: a quarter of what
            changes as it is read by `Lattice.lines`, twice of it where the medium jumps.
    """

    rough: Float[Array, "read few node"]
    reading: Float[Array, "read few node"]


class Aimed(NamedTuple):
    """What a part sends to an eye but for scattering coefficients and irradiances, at the points that are read.

    Attributes:
        eye: the eye.
        narrow: whether it and all sources are so far away that neighbours see each in nearly one direction.
        light: the first sum [read, node].
        rough: that of `Doubt.rough`; None where it is not told.
        reading: and of `Doubt.reading`.
        lobes: of every beam where it is seen, with what halos change [read, node].
        halos: what they change.
    """

    eye: Eye
    narrow: Bool[Array, ""]
    light: Float[Array, "read node"]
    rough: Float[Array, "read node"] | None
    reading: Float[Array, "read node"] | None
    lobes: tuple[Float[Array, "read node"], ...]
    halos: tuple[Float[Array, "read node"], ...]

    def serves(self, rays: Rays) -> Bool[Array, ""]:
        """Whether all rays meet in the eye."""
        apart = rays.direction + self.eye.toward(rays.origin)
        return self.narrow & jnp.all(dot(apart, apart) < ALIKE**2)


class Told(NamedTuple):
    """J [ray, node], J of fewer harmonics, and what J may err by how the lattice is read; by beams, with signs.

    How it is read errs with either sign from point to point, so that this is taken without.
    """

    whole: Float[Array, "ray node"]
    rough: Float[Array, "ray node"]
    reading: Float[Array, "ray node"]
    beams: Float[Array, "ray node"]


class Part(eqx.Module):
    """One of `AbstractMedium.parts_with_particles` and the light in it.

    Attributes:
        medium: without its forward lobe; with it where what the lattice errs is sampled.
        kept: share of its scattering that is in it [node].
        moments: chi_l L_lm [read, harmonic, node] [W m-2 sr-1].
        field: L_lm [read, harmonic, node]; None where what the lattice errs is not sampled.
        doubt: of the moments; None where it is not told.
        glow: emission and scattering in the mean over directions, as shares of the largest of each node [read, 1, 1].
        halo: of what is scattered forward; None without beams.
        beams: of all sources without extent.
        counts: points that are read along each edge.
        aimed: what it sends to an eye; None where it was asked for none.
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
    aimed: Aimed | None = None

    def near(self, point: Float[Array, "ray 3"], medium: AbstractMedium | None = None) -> Near:
        """What is needed at points; of beams through the `medium`, if given, in place of depths at other points."""
        between = about(self.counts, self.medium.to_cube(point))
        scattering = self.medium.scattering_at(point)
        if medium is None or not self.beams:
            return Near(between, scattering, tuple(beam.read(between, point) for beam in self.beams))

        def found() -> tuple[Lighting, ...]:
            return tuple(beam.found(medium, point) for beam in self.beams)

        return Near(between, scattering, _where_some(scattering, found))

    # Into any direction -----------------------------------------------------------------------------------------------

    def source(
        self, near: Near, point: Float[Array, "ray 3"], direction: Float[Array, "ray 3"]
    ) -> Float[Array, "ray node"]:
        """J of rays in `direction` at points [ray, node] [W m-3 sr-1]."""
        scatters = jnp.any(near.scattering > 0, axis=1)[:, None, None]
        share, toward = jnp.where(scatters, near.between.share, 0), harmonics(-direction, self._order)
        found = collected(near.between.point[:, None], share[:, None], near.scattering[:, None], toward, self.moments)
        return found + self.of_beams(near, point, direction)

    def of_beams(
        self, near: Near, point: Float[Array, "ray 3"], direction: Float[Array, "ray 3"]
    ) -> Float[Array, "ray node"]:
        """What of J comes straight from sources without extent [ray, node]."""
        total = jnp.zeros_like(near.scattering)
        for beam, lit in zip(self.beams, near.lit, strict=True):
            cosine = dot(beam.toward(point), direction)
            lobe = sum(self._turned(cosine, near.between.read(beam.forward)))
            irradiance = lit.irradiance * near.between.read(beam.seen)
            total = total + near.scattering / self.kept[None] * irradiance * lobe
        return total

    # To an eye --------------------------------------------------------------------------------------------------------

    def sent_to(self, eye: Eye) -> Aimed:
        """What it sends to an eye. Differentiable in the part, not in where the eye is, as rays are not."""
        eye = lax.stop_gradient(eye)
        point = self.medium.from_cube(as_float(places(self.counts)))
        toward = eye.toward(point)
        lobes = harmonics(toward, self._order)

        def light(moments: Array) -> Array:
            each = [lobes[:, i, None] * moments[:, i] for i in range(moments.shape[1])]
            return sum(each[1:], each[0])

        def turned(own: tuple[Array, Array]) -> tuple[Array, Array]:
            return self._turned(*own)

        def turned_of(beam: Beam, omega: Array) -> tuple[Array, Array]:
            # in a loop, so that what is used twice is not kept number by number of the tables
            own, every = (dot(omega, -toward), beam.forward), jnp.ones(len(point), bool)
            lobe, change = for_active(turned, every, own, 2 * self.kept.shape[0])
            return beam.seen * (lobe + change), beam.seen * change

        omegas = [beam.toward(point) for beam in self.beams]
        lit = [turned_of(*each) for each in zip(self.beams, omegas, strict=True)]
        each = [lax.stop_gradient(x).reshape(*self.counts, 3) for x in (toward, *omegas)]
        apart = [jnp.max(jnp.sum(jnp.diff(x, axis=axis) ** 2, axis=-1)) for x in each for axis in range(3)]
        return Aimed(
            eye,
            jnp.max(jnp.stack(apart)) < NARROW**2,
            light(self.moments),
            None if self.doubt is None else light(self.doubt.rough),
            None if self.doubt is None else light(self.doubt.reading),
            tuple(lobe for lobe, _ in lit),
            tuple(change for _, change in lit),
        )

    def sent(self, near: Near) -> Float[Array, "ray node"]:
        """`source` at points of rays that meet in the eye at which it is aimed."""
        assert self.aimed is not None
        aimed, between = self.aimed, near.between

        def sent() -> Array:
            total = between.read(aimed.light)
            for lit, lobe in zip(near.lit, aimed.lobes, strict=True):
                total = total + lit.irradiance * between.read(lobe) / self.kept[None]
            return near.scattering * total

        return _where_some(near.scattering, sent)

    def told(self, near: Near) -> Told:
        """`sent` with what it may err, where that is not sampled."""
        assert self.aimed is not None
        aimed, between = self.aimed, near.between

        def told() -> Told:
            assert aimed.rough is not None and aimed.reading is not None
            straight, doubt = jnp.zeros_like(near.scattering), jnp.zeros_like(near.scattering)
            for lit, lobe, halo in zip(near.lit, aimed.lobes, aimed.halos, strict=True):
                lobe, change = between.read(lobe), between.read(halo)
                straight = straight + lit.irradiance * lobe / self.kept[None]
                less = SPREAD * lit.irradiance * change + lit.doubtful * (lobe - change)
                doubt = doubt + less / self.kept[None]
            whole, rough, reading = (between.read(x) for x in (aimed.light, aimed.rough, aimed.reading))
            each = (whole + straight, rough + straight, jnp.abs(reading), doubt)
            return Told(*(near.scattering * one for one in each))

        return _where_some(near.scattering, told)

    # What both need ---------------------------------------------------------------------------------------------------

    def brightness(self, rays: Rays) -> Float[Array, " ray"]:
        """How bright rays are in the mean over the nodes if nothing is absorbed on their way."""
        cuts = self.medium.cuts(rays, jnp.full(rays.count, jnp.inf, rays.origin.dtype))
        length = (cuts[:, -1] - cuts[:, 0]) / POINTS
        t = cuts[:, :1] + length[:, None] * as_float(np.arange(POINTS) + 0.5)[None]
        between = about(self.counts, self.medium.to_cube(rays.at(t).reshape(-1, 3)))
        near, share = (x.reshape(*t.shape, *x.shape[1:]) for x in between)
        each = jnp.broadcast_to(length[:, None, None], (*t.shape, 1))
        return collected(near, share, each, jnp.ones_like(length)[:, None], self.glow)[:, 0]

    @property
    def _order(self) -> int:
        """Highest degree of the harmonics."""
        return math.isqrt(self.moments.shape[1]) - 1

    def _turned(self, cosine: Float[Array, " ray"], forward: Float[Array, "ray node"]) -> tuple[Array, Array]:
        """The lobe at cosines, and what halos change of it at depths of forward scattering [ray, node] [sr-1]."""
        assert self.medium.lobe is not None and self.halo is not None
        return jax.vmap(self.medium.lobe.eval)(cosine), self.halo.change(cosine, forward)


def _where_some(scattering: Float[Array, "ray node"], found: Callable[[], Any]) -> Any:
    """What is `found` at points where something scatters; nothing is done where it is none of them.

    XLA fuses no further than a condition: what is read is then one kernel, however often it is used. A loop that asks
    for the largest number of a table is not made native code, one that asks for any is.
    """
    nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(found))
    return lax.cond(jnp.any(scattering > 0), found, lambda: nothing)
