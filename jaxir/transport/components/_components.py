"""Radiance split by where its light comes from.

Radiance is linear in everything that shines: in the emission of the skin and of each plume, in every source, in what
surrounds the scene and in the radiance of the air. So on the same paths

    L = sum_c L_c,

with L_c the radiance while all but one of them are dark; the sum holds to rounding, whatever the number of samples.
One program serves all components: they differ by factors alone, and by the light that `DiscreteOrdinates` find in the
plumes, which is solved for once for each of them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxir._arrays import on_host, placed
from jaxir._fields import brightened
from jaxir._programs import program
from jaxir.medium import AbstractMedium
from jaxir.optics.spectrum import Nodes
from jaxir.scene import Lit, Scene
from jaxir.scene import on_nodes as scene_on_nodes
from jaxir.scene.light import AbstractLight, backgrounds
from jaxir.transport._method import Method
from jaxir.transport._paths import Paths
from jaxir.transport.evaluation import on_nodes, radiance_before_air, with_scattered
from jaxir.transport.ordinates import Scattered

KINDS = ("sources", "parts")
BACKGROUND, AIR = "background", "air"


class Components(eqx.Module):
    """Which emission each component keeps: factors 0 or 1.

    Attributes:
        skin: of the faces [component, face].
        sources: of the sources, backgrounds among them, and of the background as a light [component, source].
        plumes: [component, plume].
        ambient: of `Method.ambient` [component].
        names: of these components, and then of what is seen behind the scene and of the air, where they are.
        media: the plumes with the light of each component in them [component]; None where nothing is solved for.
    """

    skin: Float[Array, "component face"]
    sources: Float[Array, "component source"]
    plumes: Float[Array, "component plume"]
    ambient: Float[Array, " component"]
    names: tuple[str, ...] = eqx.field(static=True)
    media: AbstractMedium | None = None

    @property
    def kept(self) -> tuple[Array, ...]:
        """The factors of all components."""
        return self.skin, self.sources, self.plumes, self.ambient


def components_of(scene: Scene, method: Method, kind: str | None) -> Components | None:
    """The components of a scene's radiance; None without a kind.

    The emission of the skin, as "skin", or with the kind "parts" one of each part of it, "skin, nozzle"; the light of
    every source that skin reflects and particles scatter, by the source's class; "surroundings", the same of all
    backgrounds; the emission of every plume; the background as it is seen; the air's own radiance. Several of a class
    are numbered.

    Args:
        scene: the scene.
        method: how light is found.
        kind: "sources" or "parts".

    Raises:
        ValueError: another kind.
    """
    if kind is None:
        return None
    if kind not in KINDS:
        raise ValueError(f"components: got {kind!r}, expected {' or '.join(KINDS)}, or None")
    lights: tuple[AbstractLight, ...] = scene.sources
    around = backgrounds(lights)
    shining = [i for i, light in enumerate(lights) if not any(light is one for one in around)]
    behind = [i for i in range(len(lights)) if i not in shining] + (
        [len(lights)] if scene.background is not None else []
    )
    faces = 0 if scene.skin is None else scene.skin.mesh.count
    count = len(lights) + (scene.background is not None)
    rows: list[tuple[str, Any, np.ndarray, np.ndarray, float]] = []

    def row(name: str, skin: Any = None, sources: Any = (), plumes: Any = (), ambient: float = 0.0) -> None:
        kept = np.zeros(count), np.zeros(len(scene.plumes))
        for values, held in zip(kept, (sources, plumes), strict=True):
            values[np.asarray(held, int)] = 1
        rows.append((name, np.zeros(faces) if skin is None else skin, *kept, ambient))

    xp: Any = np
    if scene.skin is not None:
        xp, part = on_host(scene.skin.part)  # inside jit all names are taken to have faces
        own = [(f"skin, {name}", part == i) for i, name in enumerate(scene.skin.part_names)]
        split = [(name, held) for name, held in own if xp is jnp or held.any()]
        for name, held in split if kind == "parts" else [("skin", np.ones(faces))]:
            row(name, skin=held)
    for name, index in zip(_numbered([type(lights[i]).__name__ for i in shining]), shining, strict=True):
        row(name, sources=[index])
    if behind:
        row("surroundings", sources=behind)
    for name, index in zip(_numbered(["plume"] * len(scene.plumes)), range(len(scene.plumes)), strict=True):
        row(name, plumes=[index])
    if method.ambient is not None:
        row("ambient", ambient=1.0)
    seen = [BACKGROUND] if scene.background is not None else []
    seen += [AIR] if scene.atmosphere is not None else []
    names, *columns = zip(*rows, strict=True)
    skin, sources, plumes, ambient = (
        placed(xp.stack([xp.asarray(value, np.float32) for value in column])) for column in columns
    )
    return Components(skin, sources, plumes, ambient, (*names, *seen))


def _numbered(names: Sequence[str]) -> list[str]:
    """Names, with a number behind those that occur more than once."""
    return [f"{name} {names[:i].count(name)}" if names.count(name) > 1 else name for i, name in enumerate(names)]


def evaluate_components(lit: Lit, paths: Paths, components: Components) -> Float[Array, "ray component node"]:
    """The radiance of `evaluate` by component [ray, component, node] [W m-2 sr-1]; it adds up to that to rounding.

    Differentiable as `evaluate`.
    """

    def one(own: tuple[tuple[Array, ...], AbstractMedium | None]) -> Array:
        dimmed, method = _shining(lit, paths.method, *own)
        return lit.dimmed_by_air(radiance_before_air(dimmed, dataclasses.replace(paths, method=method)))

    parts = [*lax.map(one, (components.kept, components.media))]
    if lit.scene.background is not None:
        parts.append(lit.dimmed_by_air(_background(lit, paths)))
    if lit.air is not None:
        parts.append(jnp.broadcast_to(lit.air.path_radiance[None], (paths.length.shape[0], lit.nodes.count)))
    return jnp.stack(parts, axis=1)


def empty_components(lit: Lit, components: Components, direction: Float[Array, " 3"]) -> Float[Array, "component node"]:
    """What each component shows in a direction in which the scene is not [component, node]."""
    dark = jnp.zeros((len(components.names), lit.nodes.count), lit.nodes.weight.dtype)
    if lit.scene.background is not None:
        dark = dark.at[components.names.index(BACKGROUND)].set(lit.dimmed_by_air(lit.background(direction[None]))[0])
    return dark if lit.air is None else dark.at[components.names.index(AIR)].set(lit.air.path_radiance)


def with_own_media(scene: Scene, nodes: Nodes, method: Method, components: Components | None) -> Components | None:
    """The components with the light of each in the plumes, where the method solves for that; else as they are.

    Args:
        scene: the scene.
        nodes: the spectral axis.
        method: how light is found.
        components: of `components_of`.
    """
    if components is None or method.scattering is None or not scene.scatters:
        return components
    return dataclasses.replace(components, media=_own_media(scene, nodes, method, components))


@program
def _own_media(scene: Scene, nodes: Nodes, method: Method, components: Components) -> AbstractMedium:
    lit = scene_on_nodes(scene, nodes)

    def one(kept: tuple[Array, ...]) -> AbstractMedium:
        dimmed, own = _shining(lit, method, kept, None)
        found = with_scattered(dimmed, own, told=False).medium
        assert found is not None
        return found

    return lax.map(one, components.kept)


def _shining(lit: Lit, method: Method, kept: tuple[Array, ...], solved: AbstractMedium | None) -> tuple[Lit, Method]:
    """Scene and method with factors on all that shines, its background not seen but lighting what it lights."""
    scene = lit.scene
    skin, sources, plumes, ambient = (factor.astype(lit.nodes.weight.dtype) for factor in kept)
    method = on_nodes(method, lit)
    if method.ambient is not None:
        method = dataclasses.replace(method, ambient=method.ambient * ambient)
    every = scene.sources if scene.background is None else (*scene.sources, scene.background)
    lights = tuple(brightened(light, sources[i]) for i, light in enumerate(every))
    order = [next(i for i, one in enumerate(scene.sources) if one is beam) for beam in scene.summed_beams]
    beams = tuple(beam * sources[i] for i, beam in zip(order, lit.beams, strict=True))
    dimmed = Lit(
        scene=Scene(scene.skin, scene.plumes, lights, None, scene.atmosphere),
        nodes=lit.nodes,
        blackbody=None if lit.blackbody is None else lit.blackbody * skin[:, None],
        medium=lit.medium.brightened(tuple(plumes)) if lit.medium is not None and solved is None else solved,
        air=lit.air,
        beams=beams,
    )
    return dimmed, method


def _background(lit: Lit, paths: Paths) -> Float[Array, "ray node"]:
    """The background behind the plumes, where rays meet no skin, before the air."""
    rays = paths.rays
    leaves = jnp.isinf(paths.length)
    seen, reach = jnp.where(leaves[:, None], lit.background(rays.direction), 0), jnp.where(leaves, paths.length, 0)
    if isinstance(lit.medium, Scattered):  # what is scattered forward is of the surroundings
        return seen * lit.medium.given.transmittance(rays, reach)
    return seen * lit.transmittance(rays.origin, rays.direction, reach)
