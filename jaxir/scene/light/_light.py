"""Light from outside the scene: what every light answers, so that nobody asks which one it is."""

from __future__ import annotations

import abc
from typing import Any, NamedTuple, TypeVar

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxir._arrays import Check
from jaxir._fields import Physical, over_nodes
from jaxir._math import dot
from jaxir.geometry.search import Mesh
from jaxir.optics.spectrum import Nodes
from jaxir.optics.surface import cosine_density, cosine_direction
from jaxir.scene.air import AbstractAtmosphere

L = TypeVar("L", bound="AbstractLight")


class Arrival(NamedTuple):
    """A direction in which a light is looked for.

    Attributes:
        omega_i: unit vector towards the light [3].
        distance: to the light [m]; inf where that direction misses it.
        pdf: density of the light's sampler in that direction [sr-1]; 0 where it misses.
    """

    omega_i: Float[Array, " 3"]
    distance: Float[Array, ""]
    pdf: Float[Array, ""]


class AbstractLight(Physical):
    """A light.

    Its spectral fields hold one number for all nodes or one for each; what it shines is asked of `on(nodes)`, which
    holds one for each.
    """

    @abc.abstractmethod
    def on(self, nodes: Nodes) -> AbstractLight:
        """The light on the nodes. Differentiable in its fields."""

    def within(self, atmosphere: AbstractAtmosphere | None, sources: tuple[AbstractLight, ...]) -> AbstractLight:
        """The light in a scene with this air and these sources: what was left open is taken from them.

        `Scene` asks for it when it is made; what was taken stays, also where the scene's air is taken away.
        """
        return self


class AbstractDeltaSource(AbstractLight):
    """A light without extent: its light arrives from one direction, which is evaluated and never sampled."""

    @abc.abstractmethod
    def toward(self, point: Float[Array, " 3"]) -> tuple[Float[Array, " 3"], Float[Array, ""]]:
        """Unit vector to the light [3] and its distance [m]; inf allowed."""

    @abc.abstractmethod
    def beam(self, point: Float[Array, " 3"]) -> Float[Array, " node"]:
        """Irradiance [node] [W m-2] of a surface at `point` that faces the light."""

    @property
    @abc.abstractmethod
    def travel(self) -> Float[Array, " 3"] | None:
        """The one direction in which all of its light travels [3]; None where it differs from place to place."""

    @abc.abstractmethod
    def hidden(
        self, mesh: Mesh, point: Float[Array, "ray 3"], face: Int[Array, " ray"], active: Bool[Array, " ray"]
    ) -> Bool[Array, " ray"]:
        """Whether a mesh hides the light from points on faces (-1 for points in free space); all look together."""


class AbstractExtendedLight(AbstractLight):
    """A light with an extent, at a finite distance or all around."""

    @abc.abstractmethod
    def sample(self, u: Float[Array, " 2"], point: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Arrival:
        """A direction towards the light from two uniform numbers; pdf 0 if the light does not shine on the point."""

    @abc.abstractmethod
    def meet(self, omega_i: Float[Array, " 3"], point: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Arrival:
        """Where a direction meets the light, with the density that `sample` has for it."""

    @abc.abstractmethod
    def arriving(self, omega_i: Float[Array, "*batch 3"]) -> Float[Array, "*batch node"]:
        """Radiance that arrives in directions that meet it [*batch, node] [W m-2 sr-1]."""

    @abc.abstractmethod
    def form_factor_checks(self, corner: Float[Array, "face 3"], normal: Float[Array, "face 3"]) -> list[Check] | None:
        """What must hold for `form_factor` to be exact over faces with a corner and a normal; None: it has none."""

    @abc.abstractmethod
    def form_factor(self, point: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Float[Array, ""]:
        """How much of a surface's view the light fills, weighted by the cosine []."""


class AbstractAreaSource(AbstractExtendedLight):
    """A light with an extent at a finite distance: the same radiance from every point of it in every direction."""


class AbstractBackground(AbstractExtendedLight):
    """Radiance from all around the scene, at the scene."""

    @abc.abstractmethod
    def on(self, nodes: Nodes) -> AbstractBackground:
        """See `AbstractLight.on`."""

    @property
    @abc.abstractmethod
    def uniform(self) -> bool:
        """Whether it is the same in every direction."""

    def sample(self, u: Float[Array, " 2"], point: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Arrival:
        """See `AbstractExtendedLight.sample`; density cos / pi."""
        return self.meet(cosine_direction(u, normal), point, normal)

    def meet(self, omega_i: Float[Array, " 3"], point: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Arrival:
        """See `AbstractExtendedLight.meet`: at infinity, in every direction."""
        return Arrival(omega_i, jnp.full((), jnp.inf, omega_i.dtype), cosine_density(omega_i, normal))


def spread(light: L, nodes: Nodes) -> L:
    """A light with one number for each node in every spectral field."""
    return over_nodes(light, nodes)


def delta_sources(lights: tuple[AbstractLight, ...]) -> tuple[AbstractDeltaSource, ...]:
    """Those without extent."""
    return tuple(light for light in lights if isinstance(light, AbstractDeltaSource))


def area_sources(lights: tuple[AbstractLight, ...]) -> tuple[AbstractAreaSource, ...]:
    """Those with an extent at a finite distance."""
    return tuple(light for light in lights if isinstance(light, AbstractAreaSource))


def backgrounds(lights: tuple[AbstractLight, ...]) -> tuple[AbstractBackground, ...]:
    """Those all around."""
    return tuple(light for light in lights if isinstance(light, AbstractBackground))


def within_scene(sources: tuple[Any, ...], background: Any, atmosphere: Any) -> tuple[tuple[Any, ...], Any]:
    """Lights as they are in a scene, see `AbstractLight.within`; what stands for a light stays.

    Backgrounds, which show what sources light, come after these.
    """

    def own(light: Any, others: tuple[Any, ...]) -> Any:
        return light.within(atmosphere, others) if isinstance(light, AbstractLight) else light

    around = [isinstance(source, AbstractBackground) for source in sources]
    found = [source if last else own(source, ()) for source, last in zip(sources, around, strict=True)]
    lights = tuple(source for source, last in zip(found, around, strict=True) if not last)
    found = [own(source, lights) if last else source for source, last in zip(found, around, strict=True)]
    return tuple(found), own(background, lights)


def towards(offset: Float[Array, " 3"]) -> tuple[Float[Array, " 3"], Float[Array, ""]]:
    """Unit vector and length of an offset; (0, 0, 1) and 0 for no offset, with finite derivatives."""
    square = dot(offset, offset)
    there = square > 0
    inverse = lax.rsqrt(jnp.where(there, square, 1))
    up = jnp.asarray([0, 0, 1], offset.dtype)
    return jnp.where(there, offset * inverse, up), jnp.where(there, square * inverse, 0)


def to_plane(
    point: Float[Array, " 3"], omega_i: Float[Array, " 3"], origin: Float[Array, " 3"], normal: Float[Array, " 3"]
) -> tuple[Float[Array, ""], Bool[Array, ""]]:
    """Distance along a ray to a plane that shines along its normal, and whether the ray meets that side of it."""
    slope = dot(omega_i, normal)
    height = dot(origin - point, normal)
    ahead = (slope < 0) & (height < 0)
    return jnp.where(ahead, height / jnp.where(ahead, slope, 1), 0), ahead
