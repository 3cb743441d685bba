"""Lights as they are sampled from one point: sources and surroundings, and the skin and the plume as two more lights.

Each light answers four questions: a direction towards it, the density of a direction that was drawn otherwise, whether
it is seen there, and the radiance that arrives.
"""

from __future__ import annotations

import abc
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxir._math import dot
from jaxir.geometry import Pieces, pdf_from_area, pdf_pieces, pdf_triangle, sample_pieces, sample_triangle, sight_of
from jaxir.geometry.search import face_normal
from jaxir.scene import Lit, Scene, Skin
from jaxir.scene.light import AbstractExtendedLight
from jaxir.transport._method import Method
from jaxir.transport._paths import LightSamples
from jaxir.transport._through import Answer, Through

Draw = Callable[[int], Float[Array, "count 2"]]


class Drawn(NamedTuple):
    """Samples of one light from one point [sample, ...]: direction, distance, density, face or -1."""

    omega: Float[Array, "*batch 3"]
    distance: Float[Array, "*batch"]
    pdf: Float[Array, "*batch"]
    face: Int[Array, "*batch"]


class Met(NamedTuple):
    """What directions met of the skin first: face or -1, distance or inf."""

    face: Int[Array, "*batch"]
    t: Float[Array, "*batch"]


class SampledLight(abc.ABC):
    """A light as it is sampled from one point; functions of one direction unless they say otherwise."""

    needs_face: bool  # whether the first face met decides what is seen, not just whether anything is in between
    keeps_face: bool  # whether samples record the face seen

    @abc.abstractmethod
    def sample(self, draw: Draw, point: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Drawn:
        """Samples [sample, ...]; `draw` gives the uniform numbers of a decision for all of them."""

    @abc.abstractmethod
    def meet(
        self, omega: Float[Array, " 3"], point: Float[Array, " 3"], normal: Float[Array, " 3"], met: Met
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Distance at which a direction meets the light, inf where it does not, and the density of `sample` for it."""

    @abc.abstractmethod
    def seen(self, drawn: Drawn, met: Met) -> tuple[Bool[Array, "*batch"], Float[Array, "*batch"]]:
        """Whether the light is seen in drawn directions, and how far it is, from what they met first."""

    @abc.abstractmethod
    def incident(
        self, lit: Lit, samples: LightSamples, point: Float[Array, "sample ray 3"], through: Through
    ) -> Answer:
        """Radiance that arrives at points from samples [sample, ray, node] [W m-2 sr-1]. Differentiable."""


class _Source(SampledLight):
    """A source with an extent, or surroundings."""

    needs_face = False
    keeps_face = False

    def __init__(self, light: AbstractExtendedLight):
        self.light = light

    def sample(self, draw: Draw, point: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Drawn:
        arrival = jax.vmap(lambda u: self.light.sample(u, point, normal))(draw(0))
        return Drawn(*arrival, jnp.full(arrival.pdf.shape, -1, jnp.int32))

    def meet(self, omega, point, normal, met):
        _, distance, pdf = self.light.meet(omega, point, normal)
        return distance, pdf

    def seen(self, drawn: Drawn, met: Met) -> tuple[Array, Array]:
        return met.t >= drawn.distance, drawn.distance

    def incident(self, lit: Lit, samples: LightSamples, point: Array, through: Through) -> Answer:
        passed = through.passed(point, samples.omega, _reach(samples))
        return lambda: self.light.arriving(samples.omega) * passed()


class _Skin(SampledLight):
    """Warm skin: a face by area and temperature, a point of it uniformly."""

    needs_face = True
    keeps_face = True

    def __init__(self, skin: Skin, exponent: Array):
        self.skin, self.exponent = skin, exponent

    def _odds(self) -> Float[Array, " face"]:
        """Probability that the face drawn is this one or one before it [face].

        Steps below the rounding of 1 (6e-8 in float32) are lost: such a face is drawn a little too often, or never.
        """
        vector = self.skin.mesh.area_vectors()
        area = jnp.sqrt(jnp.sum(vector * vector, axis=-1))
        warmth = (self.skin.temperature / jnp.max(self.skin.temperature)) ** self.exponent
        below = lax.cummax(jnp.cumsum(area * warmth))  # a sum in parallel may fall by its rounding
        return below / jnp.where(below[-1] > 0, below[-1], 1)

    def sample(self, draw: Draw, point: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Drawn:
        mesh, odds = self.skin.mesh, self._odds()
        face = jnp.searchsorted(odds, draw(0)[:, 0], side="right").astype(jnp.int32)
        face = jnp.minimum(face, mesh.count - 1)
        weights = jax.vmap(sample_triangle)(draw(1))
        offset = jnp.sum(weights[:, :, None] * mesh.vertices[mesh.faces[face]], axis=1) - point[None]
        distance = jnp.sqrt(dot(offset, offset))
        omega = offset / jnp.where(distance > 0, distance, 1)[..., None]
        return Drawn(omega, distance, self._pdf(odds, face, omega, distance), face)

    def _pdf(self, odds: Array, face: Array, omega: Array, distance: Array) -> Array:
        """Density of points of faces at a distance [*batch] [sr-1]; 0 for face -1."""
        mesh, at = self.skin.mesh, jnp.maximum(face, 0).reshape(-1)
        chance = odds[at] - jnp.where(at > 0, odds[at - 1], 0)
        density = jax.vmap(pdf_triangle)(mesh.vertices[mesh.faces[at]])
        reach = jnp.where(face >= 0, distance, 0).reshape(-1)
        pdf = jax.vmap(pdf_from_area)(chance * density, omega.reshape(-1, 3), reach, face_normal(mesh, at))
        return pdf.reshape(face.shape)

    def meet(self, omega, point, normal, met):
        return jnp.where(met.face >= 0, met.t, jnp.inf), self._pdf(self._odds(), met.face, omega, met.t)

    def seen(self, drawn: Drawn, met: Met) -> tuple[Array, Array]:
        return (met.face == drawn.face) & (drawn.face >= 0), drawn.distance

    def incident(self, lit: Lit, samples: LightSamples, point: Array, through: Through) -> Answer:
        assert samples.face is not None
        normal = face_normal(self.skin.mesh, jnp.maximum(samples.face, 0).reshape(-1)).reshape(samples.omega.shape)
        glow = jax.vmap(partial(emitted, lit))(samples.face, jnp.abs(dot(normal, samples.omega)))
        passed = through.passed(point, samples.omega, _reach(samples))
        return lambda: glow * passed()


class _Plume(SampledLight):
    """The plume's own emission up to where a direction meets skin."""

    needs_face = True
    keeps_face = False

    def __init__(self, pieces: Callable[[], Pieces]):
        self.pieces = pieces

    def sample(self, draw: Draw, point: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Drawn:
        pieces = self.pieces()
        sight = sight_of(pieces, point, normal)
        omega = sample_pieces(pieces, sight, draw)
        pdf = jax.vmap(partial(pdf_pieces, pieces, sight))(omega)
        return Drawn(omega, jnp.full_like(pdf, jnp.inf), pdf, jnp.full(pdf.shape, -1, jnp.int32))

    def meet(self, omega, point, normal, met):
        pieces = self.pieces()
        return met.t, pdf_pieces(pieces, sight_of(pieces, point, normal), omega)

    def seen(self, drawn: Drawn, met: Met) -> tuple[Array, Array]:
        return jnp.ones(met.t.shape, bool), met.t

    def incident(self, lit: Lit, samples: LightSamples, point: Array, through: Through) -> Answer:
        return through.emitted(point, samples.omega, _reach(samples))


def _reach(samples: LightSamples) -> Float[Array, "sample ray"]:
    """How far samples must be followed [m]."""
    return jnp.where(samples.weight > 0, samples.distance, 0)


def lights_at_skin(scene: Scene, method: Method) -> tuple[SampledLight, ...]:
    """What is sampled from points of the skin, in the order in which `Vertex.lights` has it."""
    plume, light = scene.plume, method.plume_light
    found = _with_skin(scene, method, scene.extended_lights)
    if plume is None or light is None:
        return found
    return (*found, _Plume(lambda: plume.pieces(light.exponent)))


def lights_at_particles(scene: Scene, method: Method) -> tuple[SampledLight, ...]:
    """What is sampled where particles scatter: surroundings and plume are met by the segments that leave there."""
    return _with_skin(scene, method, scene.area_sources)


def _with_skin(scene: Scene, method: Method, sources: tuple[AbstractExtendedLight, ...]) -> tuple[SampledLight, ...]:
    """Sources, and the skin where it is looked for; nothing where nothing is sampled."""
    if sum(method.counts) == 0:
        return ()
    found = tuple(_Source(light) for light in sources)
    if method.skin_light is None or scene.skin is None:
        return found
    return (*found, _Skin(scene.skin, method.skin_light.exponent))


def emitted(lit: Lit, face: Int[Array, " ray"], cos_o: Float[Array, " ray"]) -> Float[Array, "ray node"]:
    """emissivity(theta_o) B(T) [ray, node]."""
    assert lit.scene.skin is not None and lit.blackbody is not None
    face = jnp.maximum(face, 0)
    return jax.vmap(lambda b, c: b.directional_emissivity(c))(lit.scene.skin.brdf.at(face), cos_o) * lit.blackbody[face]
