"""How light reflected by the skin is found: the strategies that `trace`, `render` and `signature` take."""

from __future__ import annotations

import abc
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._arrays import Check, as_float, finite, non_negative, require_shape
from jaxir.geometry import AbstractSampler, Independent, disc_above
from jaxir.geometry.search import Mesh, face_normal
from jaxir.optics.surface import Lambert
from jaxir.scene.background import AbstractBackground, AbstractUniformBackground
from jaxir.scene.near_source import AbstractAreaSource, DiscSource, PolygonSource
from jaxir.scene.scene import Scene
from jaxir.scene.source import spectral


class AbstractDirect(eqx.Module):
    """How light that reaches the skin straight from lights with an extent is found at every point met."""

    @abc.abstractmethod
    def counts(self) -> tuple[int, int]:
        """Samples at each point: of each light, and of the brdf."""

    @abc.abstractmethod
    def require(self, scene: Scene) -> list[Check]:
        """What must hold of the scene's values; `ValueError` where its structure does not suit."""


class LightSampling(AbstractDirect):
    """Points on every light: best for small lights and dull skin.

    Attributes:
        lights: N_l, samples of each light.
    """

    lights: int = eqx.field(static=True)

    def __init__(self, lights: int = 1):
        """Keep the count; it is structure."""
        self.lights = _count("LightSampling.lights", lights)

    def counts(self) -> tuple[int, int]:
        """See `AbstractDirect.counts`."""
        return self.lights, 0

    def require(self, scene: Scene) -> list[Check]:
        """See `AbstractDirect.require`; suits every scene."""
        return []


class BrdfSampling(AbstractDirect):
    """Directions in which the skin reflects: best for large lights and glossy skin.

    Attributes:
        brdfs: M_f, samples of the brdf, shared by all lights.
    """

    brdfs: int = eqx.field(static=True)

    def __init__(self, brdfs: int = 1):
        """Keep the count; it is structure."""
        self.brdfs = _count("BrdfSampling.brdfs", brdfs)

    def counts(self) -> tuple[int, int]:
        """See `AbstractDirect.counts`."""
        return 0, self.brdfs

    def require(self, scene: Scene) -> list[Check]:
        """See `AbstractDirect.require`; suits every scene."""
        return []


class MultipleImportance(AbstractDirect):
    """Both, each sample weighted by the quadratic heuristic (9): close to the better of the two everywhere.

        L = sum_lights [ 1/N_l sum w_l f cos L_l / p_l  +  1/M_f sum w_f f cos L_l / p_f ]

    Attributes:
        lights: N_l, samples of each light.
        brdfs: M_f, samples of the brdf, shared by all lights.
    """

    lights: int = eqx.field(static=True)
    brdfs: int = eqx.field(static=True)

    def __init__(self, lights: int = 1, brdfs: int = 1):
        """Keep the counts; they are structure."""
        self.lights = _count("MultipleImportance.lights", lights)
        self.brdfs = _count("MultipleImportance.brdfs", brdfs)

    def counts(self) -> tuple[int, int]:
        """See `AbstractDirect.counts`."""
        return self.lights, self.brdfs

    def require(self, scene: Scene) -> list[Check]:
        """See `AbstractDirect.require`; suits every scene."""
        return []


class ClosedForm(AbstractDirect):
    """No samples: form factors of discs, polygons and of a uniform background over convex Lambert skin.

    Applies only where it is exact: each disc lies wholly above or wholly below the plane of every face (polygons may
    cross it), the skin is flat, or closed, convex and seen from outside (so nothing hides a light), and there is no
    plume.
    """

    def counts(self) -> tuple[int, int]:
        """See `AbstractDirect.counts`."""
        return 0, 0

    def require(self, scene: Scene) -> list[Check]:
        """See `AbstractDirect.require`."""
        if scene.skin is None:
            return []
        if not isinstance(scene.skin.brdf, Lambert) or scene.plume is not None:
            raise ValueError(
                f"ClosedForm: got {type(scene.skin.brdf).__name__} skin with{'out' if scene.plume is None else ''} "
                "plume, expected Lambert skin without plume; sample instead"
            )
        lights = (*scene.area_sources, *scene.surroundings)
        for light in lights:
            if not isinstance(light, (DiscSource, PolygonSource, AbstractUniformBackground)):
                raise ValueError(
                    f"ClosedForm: got {type(light).__name__}, expected DiscSources, PolygonSources and a uniform "
                    "background; sample it"
                )
        mesh = scene.skin.mesh
        rise, grain = concavity(mesh)
        normal, corner = face_normal(mesh, jnp.arange(mesh.count, dtype=jnp.int32)), mesh.corners()[:, 0]
        convex = "0: skin closed and convex, or flat"
        checks = [Check("ClosedForm: rise of vertices over a face [m]", rise, rise <= grain, convex)]
        for disc in scene.area_sources:
            if not isinstance(disc, DiscSource):
                continue
            above = jnp.stack([_above(corner, side * normal, disc) for side in (1, -1)])
            checks.append(
                Check(
                    "ClosedForm: DiscSource.radius",
                    jnp.broadcast_to(disc.radius, above.shape[1:]),
                    jnp.any(above, axis=0),
                    "a disc wholly above or wholly below the plane of every face; sample it",
                )
            )
        return checks


def concavity(mesh: Mesh) -> tuple[Float[Array, " face"], Float[Array, ""]]:
    """How far vertices rise over the plane of each face [face] [m], and the rounding of that [] [m].

    Nothing can come between a face and a light above it where none rises. Both sides count on open skin.
    """
    normal = face_normal(mesh, jnp.arange(mesh.count, dtype=jnp.int32))
    height = normal @ mesh.vertices.T - jnp.sum(normal * mesh.corners()[:, 0], axis=-1)[:, None]
    rise = jnp.max(height if mesh.closed else jnp.abs(height), axis=-1)
    return rise, 64 * jnp.finfo(rise.dtype).eps * jnp.max(jnp.abs(mesh.vertices))


def _above(point: Array, normal: Array, disc: DiscSource) -> Array:
    return eqx.filter_vmap(lambda p, n: disc_above(p, n, disc.centre, disc.normal, disc.radius))(point, normal)


class AmbientTerm(eqx.Module):
    """A cheap stand-in for light reflected more often than `bounces`: the same radiance from everywhere.

    The last point of a path reflects reflectance(theta_o) * radiance more.

    Attributes:
        radiance: [node or 1] [W m-2 sr-1]. Differentiable.
    """

    radiance: Float[Array, " node"]

    def __init__(self, radiance: Any):
        """Convert; one value or one per node."""
        self.radiance = spectral("AmbientTerm.radiance", radiance)


class SkinLight(eqx.Module):
    """Warm skin as a light on other skin: worth it where a small part of the skin outshines the rest.

    A face is drawn with a probability that grows as area * temperature^exponent, and a point of it uniformly. Without
    it skin meets the glow of other skin only where a path happens to go on.

    Attributes:
        exponent: 4 suits all wavelengths together; one wavelength, c2 / (wavelength temperature) where that is large.
            It decides how even the samples are; the estimate has no bias for any.
    """

    exponent: Float[Array, ""]

    def __init__(self, exponent: Any = 4.0):
        """Convert to an array."""
        self.exponent = as_float(exponent, "SkinLight.exponent")
        require_shape("SkinLight.exponent", self.exponent, ())


class PlumeLight(eqx.Module):
    """The plume as a light on the skin: worth it where a small hot plume fills little of the skin's view.

    At every point directions are drawn towards pieces of the plume, each with a probability that grows as
    volume * temperature^exponent * cos / distance^2 (and with the exhaust fraction of a jet). Such a direction brings
    the plume's own emission up to where the ray meets the skin, as do those drawn from the brdf, and equation (9)
    weights both. What lies behind the plume is found as without it, dimmed by the plume. Without it skin meets the
    plume only where a path happens to go on through it.

    Attributes:
        exponent: 4 suits all wavelengths together; one wavelength, c2 / (wavelength temperature) where that is large.
            It decides how even the samples are; the estimate has no bias for any.
    """

    exponent: Float[Array, ""]

    def __init__(self, exponent: Any = 4.0):
        """Convert to an array."""
        self.exponent = as_float(exponent, "PlumeLight.exponent")
        require_shape("PlumeLight.exponent", self.exponent, ())


class Reflection(eqx.Module):
    """How reflected light is found.

    At every point that a path meets, delta sources are evaluated, area sources and the background are found by
    `direct`, and, while bounces are left, the path goes on in a direction drawn from the brdf, on which it meets the
    plume's and the skin's own radiance. The estimate of light reflected up to bounces + 1 times has no bias.

    Attributes:
        direct: how lights with an extent and the background are found.
        bounces: from skin to skin; 0 takes light from the lights alone. The error left out is at most
            reflectance^(bounces + 1) of the brightest radiance around.
        sampler: how even the random points of one decision are.
        beyond: what stands for light reflected more often; None for nothing.
        skin: how the skin's own emission is looked for by `direct`, like the lights: then it counts as a light, also
            with 0 bounces, and `beyond` stands for what skin reflects, no longer for what it emits. None: it is met
            where bounces lead.
        plume: how the plume's emission is looked for by `direct`, in the same way; nothing in a scene without plume.
    """

    direct: AbstractDirect
    bounces: int = eqx.field(static=True)
    sampler: AbstractSampler
    beyond: AmbientTerm | None
    skin: SkinLight | None
    plume: PlumeLight | None

    def __init__(
        self,
        direct: AbstractDirect | None = None,
        bounces: int = 0,
        sampler: AbstractSampler | None = None,
        beyond: AmbientTerm | None = None,
        skin: SkinLight | None = None,
        plume: PlumeLight | None = None,
    ):
        """Join the parts; `MultipleImportance(1, 1)` and independent points unless given.

        Raises:
            ValueError: bounces is not an integer >= 0; skin or plume is to be sampled by a strategy without samples.
        """
        self.direct = MultipleImportance() if direct is None else direct
        self.bounces = _count("Reflection.bounces", bounces, least=0)
        self.sampler = Independent() if sampler is None else sampler
        self.beyond = beyond
        for field, light in (("skin", skin), ("plume", plume)):
            if light is not None and sum(self.direct.counts()) == 0:
                raise ValueError(
                    f"Reflection.{field}: got {type(light).__name__} with {type(self.direct).__name__}, expected a "
                    "direct strategy that samples"
                )
        self.skin = skin
        self.plume = plume

    def looks(self, scene: Scene) -> bool:
        """Whether any light is sampled."""
        return self.skin is not None or self.looks_for_plume(scene) or len(self.lights(scene)) > 0

    def looks_for_plume(self, scene: Scene) -> bool:
        """Whether the plume is looked for as a light, so that legs from skin to skin no longer bring its emission."""
        return self.plume is not None and scene.plume is not None

    def lights(self, scene: Scene) -> tuple[AbstractAreaSource | AbstractBackground, ...]:
        """What is sampled beside the skin: every source with an extent, and the background."""
        if sum(self.direct.counts()) == 0:
            return ()
        return (*scene.area_sources, *scene.surroundings)

    def samples(self, scene: Scene) -> int:
        """Directions recorded at each point met."""
        lights = len(self.lights(scene)) + (self.skin is not None) + self.looks_for_plume(scene)
        return max(1, lights * sum(self.direct.counts())) * (1 + self.bounces)

    def checks(self, scene: Scene) -> list[Check]:
        """The strategy suits the scene, the ambient radiance is not negative."""
        beyond = [] if self.beyond is None else [non_negative("AmbientTerm.radiance", self.beyond.radiance)]
        skin = [] if self.skin is None else [finite("SkinLight.exponent", self.skin.exponent)]
        plume = [] if self.plume is None else [finite("PlumeLight.exponent", self.plume.exponent)]
        return [*self.direct.require(scene), *beyond, *skin, *plume]


def reflection_of(scene: Scene, given: Reflection | None) -> Reflection | None:
    """What is asked, or `Reflection()` for a scene with area sources; None: delta sources alone, nothing sampled."""
    if scene.skin is None:
        return None
    return Reflection() if given is None and scene.area_sources else given


def _count(field: str, value: int, least: int = 1) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise ValueError(f"{field}: got {value!r}, expected an integer >= {least}")
    return value
