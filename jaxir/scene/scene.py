"""The scene: everything that a computation sees. Absent parts cost nothing."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from jaxir._arrays import Check
from jaxir._math import radius_about
from jaxir.geometry import Camera
from jaxir.geometry.search import MARGIN, WIDTH, clear_of, outline
from jaxir.scene.atmosphere import AbstractAtmosphere
from jaxir.scene.background import AbstractBackground
from jaxir.scene.jet import JetPlume
from jaxir.scene.near_source import AbstractAreaSource
from jaxir.scene.plume import GridPlume
from jaxir.scene.skin import Skin
from jaxir.scene.source import AbstractDeltaSource

BOXES = 4096  # most boxes that outline a mesh


class Scene(eqx.Module):
    """A body, its plume, its lights, what is behind it and what is in front of it.

    The structure (which parts are present, of which types and shapes) decides what is compiled; the arrays inside are
    what gradients see. In the scene's frame x points to the nose, y to the left wing, z up [m].

    Attributes:
        skin: opaque surface.
        plume: emitting and absorbing gas.
        sources: lights, without extent (`ParallelSource`, `PointSource`) and with (`DiscSource`, `PolygonSource`,
            `SphereSource`, or a background). They light skin and particles; a camera does not see them, and they cast
            no shadow.
        background: what rays see that meet nothing.
        atmosphere: the path from the target to the sensor.
    """

    skin: Skin | None = None
    plume: GridPlume | JetPlume | None = None
    sources: tuple[AbstractDeltaSource | AbstractAreaSource | AbstractBackground, ...] = ()
    background: AbstractBackground | None = None
    atmosphere: AbstractAtmosphere | None = None

    def __check_init__(self):
        if self.skin is None and self.plume is None:
            raise ValueError("Scene: got neither skin nor plume, expected at least one of them")

    @property
    def delta_sources(self) -> tuple[AbstractDeltaSource, ...]:
        """The sources without extent."""
        return tuple(source for source in self.sources if isinstance(source, AbstractDeltaSource))

    @property
    def area_sources(self) -> tuple[AbstractAreaSource, ...]:
        """The sources with an extent at a finite distance."""
        return tuple(source for source in self.sources if isinstance(source, AbstractAreaSource))

    @property
    def surroundings(self) -> tuple[AbstractBackground, ...]:
        """What can light skin and particles from all around: backgrounds among the sources, and the background."""
        hidden = tuple(source for source in self.sources if isinstance(source, AbstractBackground))
        return hidden if self.background is None else (*hidden, self.background)

    def extent(self) -> Float[Array, "corner 3"]:
        """Points whose convex hull holds skin and plume [corner, 3] [m]: mesh vertices and corners of the plume."""
        points = [] if self.skin is None else [self.skin.mesh.vertices]
        if self.plume is not None:
            points.append(self.plume.extent())
        return jnp.concatenate(points)

    def radius(self, centre: Float[Array, " 3"]) -> Float[Array, ""]:
        """Radius about `centre` of a sphere that holds skin and plume, plus .1 % [m]; without derivative."""
        return lax.stop_gradient(radius_about(self.extent(), centre) * MARGIN)

    def outline(self, most: int = BOXES) -> Float[Array, "row 96"]:
        """Boxes that hold skin and plume, see `jaxir.geometry.search`; at most `most` for the skin, or 16."""
        boxes = [] if self.skin is None else [self.skin.mesh.outline(most)]
        if self.plume is not None:
            corners = self.plume.extent()
            boxes.append(outline(corners.min(axis=0)[None], corners.max(axis=0)[None]))
        return lax.stop_gradient(jnp.concatenate(boxes))

    def start(self, camera: Camera) -> Float[Array, ""]:
        """Height above a camera's target plane at which its rays start, see `clear_of` [m]; without derivative."""
        return lax.stop_gradient(clear_of(self.outline(WIDTH), self.extent(), camera))

    def checks(self) -> list[Check]:
        """The checks of every part present."""
        parts = (self.skin, self.plume, *self.sources, self.background, self.atmosphere)
        return [check for part in parts if part is not None for check in part.checks()]
