"""The scene, everything that a computation sees, and the same on the spectral nodes. Absent parts cost nothing."""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from jaxir._arrays import Check, require_precision
from jaxir._fields import by_band
from jaxir._math import radius_about
from jaxir._programs import program
from jaxir.geometry import Camera, Rays
from jaxir.geometry.search import MARGIN, WIDTH, clear_of, outline
from jaxir.medium import AbstractMedium
from jaxir.optics.spectrum import Nodes, band_radiance
from jaxir.scene._skin import Skin
from jaxir.scene.air import AbstractAtmosphere, AirPath
from jaxir.scene.light import (
    AbstractAreaSource,
    AbstractBackground,
    AbstractDeltaSource,
    AbstractExtendedLight,
    AbstractLight,
    area_sources,
    backgrounds,
    delta_sources,
    within_scene,
)
from jaxir.scene.plume import AbstractPlume, together

BOXES = 4096  # most boxes that outline a mesh


class Scene(eqx.Module):
    """A body, its plumes, its lights, what is behind it and what is in front of it.

    The structure (which parts are present, of which types and shapes) decides what is compiled; the arrays inside are
    what gradients see. In the scene's frame x points to the nose, y to the left wing, z up [m].

    Attributes:
        skin: opaque surface.
        plumes: emitting and absorbing gas, with particles or without; where plumes overlap, absorption, emission and
            scattering add.
        sources: lights, without extent (`ParallelSource`, `PointSource`) and with (`DiscSource`, `PolygonSource`,
            `SphereSource`, or a background). They light skin and particles; a camera does not see them, and they cast
            no shadow.
        background: what rays see that meet nothing; it lights skin and particles, too. A `Sun` and a `ClearSky` take
            what they lack, the altitude and the path to the Sun, from `atmosphere` when the scene is made.
        atmosphere: the path from the target to the sensor.
    """

    skin: Skin | None
    plumes: tuple[AbstractPlume, ...]
    sources: tuple[AbstractLight, ...]
    background: AbstractBackground | None
    atmosphere: AbstractAtmosphere | None

    def __init__(
        self,
        skin: Skin | None = None,
        plumes: AbstractPlume | tuple[AbstractPlume, ...] | None = (),
        sources: AbstractLight | tuple[AbstractLight, ...] = (),
        background: AbstractBackground | None = None,
        atmosphere: AbstractAtmosphere | None = None,
    ):
        """Join the parts; one plume or source may stand for a tuple of one.

        Raises:
            ValueError: a part of another kind, or neither skin nor plume.
        """
        self.skin = _part("skin", skin, Skin)
        self.plumes = _parts("plumes", plumes, AbstractPlume)
        self.atmosphere = _part("atmosphere", atmosphere, AbstractAtmosphere)
        lights = _parts("sources", sources, AbstractLight), _part("background", background, AbstractBackground)
        self.sources, self.background = within_scene(*lights, self.atmosphere)
        if self.skin is None and not self.plumes:
            raise ValueError("Scene: got neither skin nor plume, expected at least one of them")

    @property
    def plume(self) -> AbstractPlume | None:
        """All plumes as one; None without."""
        return together(self.plumes)

    @property
    def scatters(self) -> bool:
        """Whether there are particles in a plume."""
        return any(plume.scatters for plume in self.plumes)

    @property
    def has_spectrum(self) -> bool:
        """Whether plumes or air depend on the wavenumber inside a band, so that a band needs more than one node."""
        parts = (*self.plumes, *self.sources, self.background, self.atmosphere)
        return any(part.has_spectrum for part in parts if part is not None)

    @property
    def delta_sources(self) -> tuple[AbstractDeltaSource, ...]:
        """The sources without extent."""
        return delta_sources(self.sources)

    @property
    def area_sources(self) -> tuple[AbstractAreaSource, ...]:
        """The sources with an extent at a finite distance."""
        return area_sources(self.sources)

    @property
    def hidden(self) -> tuple[AbstractBackground, ...]:
        """Backgrounds among the sources, which light the scene and are not seen."""
        return backgrounds(self.sources)

    @property
    def surroundings(self) -> tuple[AbstractBackground, ...]:
        """What lights skin and particles from all around: backgrounds among the sources, and the background."""
        return self.hidden if self.background is None else (*self.hidden, self.background)

    @property
    def extended_lights(self) -> tuple[AbstractExtendedLight, ...]:
        """Lights that are sampled: every source with an extent, and the surroundings."""
        return (*self.area_sources, *self.surroundings)

    @property
    def summed_beams(self) -> tuple[AbstractDeltaSource, ...]:
        """Parallel sources whose light, scattered once, is summed along rays instead of sampled."""
        plume = self.plume
        if plume is None or not plume.sums_beams:
            return ()
        return tuple(source for source in self.delta_sources if source.travel is not None)

    @property
    def sampled_beams(self) -> tuple[AbstractDeltaSource, ...]:
        """Sources without extent whose light is looked for where paths are scattered."""
        plume = self.plume
        summed = plume is not None and plume.sums_beams
        return tuple(source for source in self.delta_sources if not summed or source.travel is None)

    def on(self, nodes: Nodes) -> Lit:
        """The scene on spectral nodes. Differentiable in every radiometric leaf of the scene.

        Raises:
            ValueError: a part has neither one spectral value nor one for each node.
        """
        return on_nodes(self, nodes)

    @program
    def extent(self) -> Float[Array, "corner 3"]:
        """Points whose convex hull holds skin and plumes [corner, 3] [m]: mesh vertices and corners of the plumes."""
        return self._with_vertices([plume.extent() for plume in self.plumes])

    def _with_vertices(self, corners: list[Array]) -> Float[Array, "corner 3"]:
        """`extent` with these corners of plumes."""
        skin = [] if self.skin is None else [self.skin.mesh.vertices]
        return jnp.concatenate([*skin, *corners])

    def radius(self, centre: Float[Array, " 3"]) -> Float[Array, ""]:
        """Radius about `centre` of a sphere that holds skin and plumes, plus .1 % [m]; without derivative."""
        return lax.stop_gradient(radius_about(self.extent(), centre) * MARGIN)

    def outline(self, most: int = BOXES) -> Float[Array, "row 96"]:
        """Boxes that hold skin and plumes, see `jaxir.geometry.search`; at most `most` for the skin, or 16."""
        return self._outline(most, [plume.extent() for plume in self.plumes])

    def _outline(self, most: int, corners: list[Array]) -> Float[Array, "row 96"]:
        """`outline` about plumes with these corners."""
        boxes = [] if self.skin is None else [self.skin.mesh.outline(most)]
        if corners:
            boxes.append(
                outline(jnp.stack([c.min(axis=0) for c in corners]), jnp.stack([c.max(axis=0) for c in corners]))
            )
        return lax.stop_gradient(jnp.concatenate(boxes))

    def start(self, camera: Camera) -> Float[Array, ""]:
        """Height above a camera's target plane at which its rays start, see `clear_of` [m]; without derivative."""
        corners = [plume.extent() for plume in self.plumes]
        return lax.stop_gradient(clear_of(self._outline(WIDTH, corners), self._with_vertices(corners), camera))

    def checks(self) -> list[Check]:
        """The checks of every part present."""
        parts = (self.skin, *self.plumes, *self.sources, self.background, self.atmosphere)
        return [check for part in parts if part is not None for check in part.checks()]

    def checks_on(self, nodes: Nodes) -> list[Check]:
        """`checks`, and what the parts ask of the spectral nodes."""
        brdf = None if self.skin is None else self.skin.brdf
        parts = (brdf, *self.plumes, *self.sources, self.background, self.atmosphere)
        return [*self.checks(), *(check for part in parts if part is not None for check in part.node_checks(nodes))]


def _part(field: str, value: Any, kind: type) -> Any:
    """`value`, or `ValueError` unless it is of its kind, None or something that stands for a leaf."""
    if value is not None and isinstance(value, eqx.Module) and not isinstance(value, kind):
        raise ValueError(f"Scene.{field}: got {type(value).__name__}, expected {_name(kind)}")
    if isinstance(value, (int, float, str, list, dict)):
        raise ValueError(f"Scene.{field}: got {value!r}, expected {_name(kind)}")
    return value


def _parts(field: str, value: Any, kind: type) -> tuple:
    """One part or several as a tuple."""
    if value is None:
        return ()
    every = tuple(value) if isinstance(value, (tuple, list)) else (value,)
    return tuple(_part(field, part, kind) for part in every)


def _name(kind: type) -> str:
    name = kind.__name__
    return f"one of the kind {name.removeprefix('Abstract')}" if name.startswith("Abstract") else name


class Lit(eqx.Module):
    """A scene on the spectral nodes: what is computed once and then looked up by every ray.

    Attributes:
        scene: the scene, its lights on the nodes.
        nodes: the spectral axis.
        blackbody: radiance of a blackbody as warm as each face [face, node] [W m-2 sr-1]; None without skin.
        medium: the plumes; None without.
        air: the path to the sensor; None without.
        beams: irradiance of each of `Scene.summed_beams` at `AbstractMedium.beam_points` [point, node] [W m-2].
    """

    scene: Scene
    nodes: Nodes
    blackbody: Float[Array, "face node"] | None
    medium: AbstractMedium | None
    air: AirPath | None
    beams: tuple[Float[Array, "point node"], ...]

    def background(self, direction: Float[Array, "*batch 3"]) -> Float[Array, "*batch node"]:
        """What rays see that meet nothing [*batch, node] [W m-2 sr-1], before the air."""
        if self.scene.background is None:
            return jnp.zeros(direction.shape[:-1] + (self.nodes.count,), direction.dtype)
        return self.scene.background.arriving(direction)

    def surroundings(self, direction: Float[Array, "*batch 3"]) -> Float[Array, "*batch node"]:
        """What segments that leave the scene find [*batch, node]: the background, and what the eye does not see."""
        found = self.background(direction)
        for hidden in self.scene.hidden:
            found = found + hidden.arriving(direction)
        return found

    def through_plume(self, rays: Rays, length: Float[Array, " ray"], behind: Float[Array, "ray node"]) -> Array:
        """Radiance at the origins of rays that end after `length` [ray], where `behind` [ray, node] enters them."""
        return behind if self.medium is None else self.medium.radiance(rays, length, behind)

    def transmittance(
        self, point: Float[Array, "*batch 3"], omega: Float[Array, "*batch 3"], length: Float[Array, "*batch"]
    ) -> Float[Array, "*batch node"] | float:
        """Transmittance of the plumes [*batch, node] from points along unit vectors for `length` [m]; 1 without."""
        if self.medium is None:
            return 1.0
        rays = Rays(point.reshape(-1, 3), omega.reshape(-1, 3))
        passed = self.medium.transmittance(rays, length.reshape(-1))
        return passed.reshape(length.shape + (self.nodes.count,))

    def emission(
        self, point: Float[Array, "*batch 3"], omega: Float[Array, "*batch 3"], length: Float[Array, "*batch"]
    ) -> Float[Array, "*batch node"]:
        """Radiance [*batch, node] of the plumes alone at points along unit vectors up to `length` [m]."""
        rays = Rays(point.reshape(-1, 3), omega.reshape(-1, 3))
        dark = jnp.zeros((rays.count, self.nodes.count), point.dtype)
        return self.through_plume(rays, length.reshape(-1), dark).reshape(length.shape + (self.nodes.count,))

    def dimmed_by_air(self, radiance: Float[Array, "*batch node"]) -> Float[Array, "*batch node"]:
        """transmittance * L; without air L itself."""
        return radiance if self.air is None else radiance * self.air.transmittance[(None,) * (radiance.ndim - 1)]

    def through_air(self, radiance: Float[Array, "*batch node"]) -> Float[Array, "*batch node"]:
        """Equation (2): transmittance * L + path radiance; without air L itself."""
        dimmed = self.dimmed_by_air(radiance)
        return dimmed if self.air is None else dimmed + self.air.path_radiance[(None,) * (radiance.ndim - 1)]

    def empty(self, direction: Float[Array, "*batch 3"]) -> Float[Array, "*batch node"]:
        """What the sensor sees where the scene is not: the background through the air [*batch, node] [W m-2 sr-1]."""
        return self.through_air(self.background(direction))

    def in_vacuum(self) -> Lit:
        """The same without the air, and with no band told: programs of what asks for neither serve all of them."""
        response = jnp.zeros_like(self.nodes.response[:1])
        nodes = dataclasses.replace(self.nodes, response=response, names=("any",), error=None)
        scene = eqx.tree_at(lambda s: s.atmosphere, self.scene, None, is_leaf=lambda x: x is None)
        return Lit(scene, nodes, self.blackbody, self.medium, None, self.beams)

    def without_plumes(self) -> Lit:
        """The same scene without its plumes, for rays that meet none."""
        bare = eqx.tree_at(lambda s: s.plumes, self.scene, ())
        return Lit(bare, self.nodes, self.blackbody, None, self.air, ())


@program
def on_nodes(scene: Scene, nodes: Nodes) -> Lit:
    """A scene on the nodes. Differentiable in every radiometric leaf of the scene.

    Raises:
        ValueError: a part has neither one spectral value nor one for each node; arrays of another precision than that
            in force.
    """
    require_precision(nodes, scene)
    scene = _by_band(scene, nodes)
    sources = tuple(source.on(nodes) for source in scene.sources)
    background = None if scene.background is None else scene.background.on(nodes)
    plume, skin, air = scene.plume, scene.skin, scene.atmosphere
    if skin is not None and skin.brdf.shape()[1] not in (1, nodes.count):
        raise ValueError(
            f"Skin.brdf: got parameters on {skin.brdf.shape()[1]} nodes, expected 1 or {nodes.count}, one for each "
            f"node of the bands {nodes.names}"
        )
    medium = None if plume is None else plume.medium(nodes)
    own = Scene(skin, scene.plumes, sources, background, air)
    return Lit(
        scene=own,
        nodes=nodes,
        blackbody=None if skin is None else band_radiance(skin.temperature, nodes),
        medium=medium,
        air=None if air is None else air.on(nodes) if plume is None else air.in_front_of(nodes, plume.hottest()),
        beams=tuple(_at_points(own, medium, source) for source in own.summed_beams),
    )


def _by_band(scene: Scene, nodes: Nodes) -> Scene:
    """The scene with what is given for bands spread over their nodes, see `by_band`."""

    def spread(part: Any) -> Any:
        return None if part is None else by_band(part, nodes)

    skin = scene.skin
    if skin is not None:
        skin = eqx.tree_at(lambda s: s.brdf, skin, spread(skin.brdf))
    plumes, sources = (tuple(spread(part) for part in parts) for parts in (scene.plumes, scene.sources))
    return Scene(skin, plumes, sources, spread(scene.background), spread(scene.atmosphere))


def _at_points(scene: Scene, medium: AbstractMedium | None, source: AbstractDeltaSource) -> Float[Array, "point node"]:
    """Irradiance of a beam at the points of a medium, behind skin and plumes."""
    assert medium is not None and source.travel is not None
    point, there = lax.stop_gradient(medium.beam_points)  # a point without particles costs no march
    toward = jnp.broadcast_to(-source.travel, point.shape)
    passed = medium.transmittance(Rays(point, toward), jnp.where(there, jnp.inf, 0).astype(point.dtype))
    if scene.skin is not None:
        free = jnp.full(point.shape[:1], -1, jnp.int32)
        passed = jnp.where(source.hidden(scene.skin.mesh, point, free, there)[:, None], 0, passed)
    return passed * source.beam(point[0])[None]
