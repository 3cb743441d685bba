"""Which spectral nodes a scene needs, when bands are asked for."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxir._arrays import as_float, fingerprint, is_traced, remembered, require
from jaxir._cache import keep, kept
from jaxir._math import frame_around, matmul
from jaxir._programs import program
from jaxir.geometry import Rays
from jaxir.optics.spectrum import (
    RESOLUTIONS,
    Band,
    Nodes,
    Resolution,
    as_bands,
    band_radiance,
    finer_nodes,
    gray_nodes,
    padded_nodes,
    resolved_nodes,
    with_error,
)
from jaxir.scene._scene import Lit, Scene, on_nodes
from jaxir.scene._skin import Skin
from jaxir.scene.light import AbstractLight, area_sources, backgrounds, delta_sources

RTOL = 0.02  # of the in-band results of probing rays, against the finest nodes
*TRIED, FINEST = RESOLUTIONS  # the finest, of 12 quantiles, is what others are compared with
FEW_BINS = 12  # of which the means of few quantiles err too much, and many cost little
*MORE, FINER = Resolution(50.0, 16, 10), Resolution(50.0, 32, 12)  # tried for so few, and what they are compared with
UNKNOWN = RESOLUTIONS[4]  # where the scene's values are not known yet
KEPT = 32  # choices
_ACROSS = 6  # rows and columns of probing rays in each direction
_DIRECTIONS = np.array([[1.0, 0.0, 0.0], [0.6, 0.0, 0.8], [0.0, 0.28, 0.96], [0.12, 0.09, 0.98868]])  # z along plumes


def scene_nodes(scene: Scene, bands: Nodes | Band | Sequence[Band]) -> Nodes:
    """The spectral nodes on which a scene is computed.

    Nodes are taken as they are. Bands become one gray node each where neither their response nor anything in the scene
    depends on the wavenumber inside them (`Physical.has_spectrum`). Else they become the fewest of `RESOLUTIONS` with
    which 36 rays in each of four directions through the plumes, from across to nearly along them, before darkness and
    before the skin's mean and highest temperature, through the air, give every band's mean radiance within `RTOL` of
    that on the finest; `Nodes.error` keeps what they err. Bands of at most `FEW_BINS` bins are compared with nodes of
    32 quantiles.
    All candidates are tried by one program: coarser ones are padded with nodes of weight 0. A grid of more than some
    thousand cells is probed on every few of them.

    Args:
        scene: the scene; where `jax.jit` has its values not yet, or `jax.vmap` has several, the resolution is
            `UNKNOWN` instead.
        bands: bands or nodes. `gray_nodes(bands)` asks for gray nodes whatever the scene.

    Returns:
        The nodes. Other values of the scene may ask for others: choose them once before an optimisation, whose
        gradients would else compile anew where their number changes. The last `KEPT` choices are kept, and
        on disk with the compiled programs.

    Raises:
        ValueError: as `resolved_nodes` and `Scene.checks`.
    """
    if isinstance(bands, Nodes):
        return bands
    several = as_bands(bands)
    if not spectral((scene,), several):
        return gray_nodes(several)
    scene = jax.tree.map(_value, scene)
    if is_traced(scene):
        return resolved_nodes(several, *UNKNOWN)
    require(scene.checks())
    asked = (jax.tree.structure(scene), str(several), fingerprint(scene))
    return remembered(_chosen, asked, lambda: _choice(scene, several, asked), KEPT)


def spectral(scenes: Sequence[Scene], bands: tuple[Band, ...]) -> bool:
    """Whether anything depends on the wavenumber inside of bands."""
    return any(scene.has_spectrum for scene in scenes) or any(band.response is not None for band in bands)


def _choice(scene: Scene, bands: tuple[Band, ...], asked: tuple) -> Nodes:
    """The fewest nodes that do, as an earlier process found or anew."""
    candidates = _candidates(bands)

    def found() -> list[Any]:
        place, error = _fewest(scene, candidates, finest_nodes(bands))
        return [place, error.tolist()]

    place, error = kept_choice("nodes", asked, found)
    return with_error(candidates[place], np.asarray(error))


def kept_choice(what: str, asked: tuple, find: Callable[[], list[Any]]) -> list[Any]:
    """What `find` says, or said in an earlier process that was `asked` the same, by a scene's structure first."""
    key, own = f"{what} {asked}", _is_own(asked[0])
    held = kept(key) if own else None
    if held is not None:
        return json.loads(held)
    found = find()
    if own:
        keep(key, json.dumps(found).encode())
    return found


def _is_own(structure: jax.tree_util.PyTreeDef) -> bool:
    """Whether all parts of a scene are of kinds that this package defines: others may change behind a name."""
    node = structure.node_data()
    own = node is None or node[0].__module__.split(".")[0] in ("jaxir", "builtins")
    return own and all(_is_own(child) for child in structure.children())


_chosen: dict[tuple, Nodes] = {}


def nodes_error(scene: Scene, nodes: Nodes) -> Float[Array, " band"] | None:
    """What nodes err in the bands of a scene, as a share [band]: `Nodes.error`, or as `scene_nodes` finds it.

    Nodes that were given are compared with finer ones, `finer_nodes`. 0 where nothing in the scene depends on the
    wavenumber inside a band. None where the scene holds values for just these nodes, as of correlated-k, or a response
    acts by its mean over a whole band.
    """
    if nodes.error is not None:
        return nodes.error
    response = np.asarray(nodes.response)
    if nodes.count == len(response) and ((response != 0) & (response != 1)).any():
        return None
    if any(plume.has_quantiles for plume in scene.plumes):
        return None
    if not scene.has_spectrum:
        return jnp.zeros(len(response), nodes.weight.dtype)
    fine, coarse = finer_nodes(nodes), with_few_cells(scene)
    try:
        finest, own = (_results(coarse, axis, max(fine.count, nodes.count)) for axis in (fine, nodes))
    except ValueError:  # light or air given for each of the nodes
        return None
    return jnp.asarray(_apart(finest, own), nodes.weight.dtype)  # in units of what they find


def with_few_cells(scene: Scene) -> Scene:
    """The same scene with grids of few cells: enough to choose nodes with."""
    return eqx.tree_at(lambda s: s.plumes, scene, tuple(plume.thinned() for plume in scene.plumes))


def _results(scene: Scene, nodes: Nodes, count: int) -> np.ndarray:
    return np.asarray(_probed(scene, padded_nodes(nodes, count)), np.float64)


def _apart(results: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Largest difference of all results, relative to the others [band]."""
    return np.max(np.abs(results - others) / np.where(np.abs(others) > 0, np.abs(others), 1), axis=0)


def _candidates(bands: tuple[Band, ...]) -> list[Nodes]:
    """From few nodes to many, gray ones first."""
    tries = [resolved_nodes(bands, *each) for each in ((*TRIED, FINEST, *MORE) if _narrow(bands) else TRIED)]
    return [gray_nodes(bands), *sorted(tries, key=lambda n: n.count)]


def finest_nodes(bands: tuple[Band, ...]) -> Nodes:
    """What others are compared with."""
    return resolved_nodes(bands, *(FINER if _narrow(bands) else FINEST))


def _narrow(bands: tuple[Band, ...]) -> bool:
    return resolved_nodes(bands, FINEST.width, 1, 0).count <= FEW_BINS


def _fewest(scene: Scene, candidates: list[Nodes], finest: Nodes) -> tuple[int, np.ndarray]:
    """`scene_nodes` of known values: which of `_candidates`, and its error [band]."""
    coarse = with_few_cells(scene)
    true = _results(coarse, finest, finest.count)
    errors: list[np.ndarray] = []
    for nodes in candidates:
        errors.append(_apart(_results(coarse, nodes, finest.count), true))
        if np.all(errors[-1] <= RTOL):
            break
    return len(errors) - 1, errors[-1]


def _value(leaf: Array) -> Array:
    """A leaf without the tangents of `jax.grad`; as it is below `jax.jit` and `jax.vmap`."""
    while isinstance(leaf, jax.core.Tracer) and hasattr(leaf, "primal"):
        leaf = leaf.primal
    return leaf


@program
def _probed(scene: Scene, nodes: Nodes) -> Float[Array, "result band"]:
    """In-band radiance, means of the probing rays of a direction, of what lies behind them, and of the skin alone."""
    lit = on_nodes(scene, nodes)
    dark = jnp.zeros((1, nodes.count), nodes.weight.dtype)
    behind, lights = dark, _lights(scene, lit)
    if scene.skin is not None:
        behind = jnp.concatenate([dark, warmth(scene.skin, nodes)])
    if lit.medium is None:
        return nodes.in_band(lit.dimmed_by_air(jnp.concatenate([behind[1:] if len(behind) > 1 else behind, *lights])))
    frame = about_plumes(scene)
    corners = matmul(scene.extent(), frame.T)
    low, high = corners.min(axis=0), corners.max(axis=0)
    place = (np.indices((_ACROSS, _ACROSS)).reshape(2, -1).T + 0.5) / _ACROSS
    through = np.full((len(_DIRECTIONS), len(place), 3), 0.5)
    for own, toward in zip(through, _DIRECTIONS, strict=True):
        own[:, np.arange(3) != np.argmax(np.abs(toward))] = place
    direction = as_float(np.repeat(np.asarray(_DIRECTIONS), len(place), axis=0))
    back = jnp.sqrt(jnp.sum((high - low) ** 2))
    origin = low[None] + as_float(through.reshape(-1, 3)) * (high - low)[None] - back * direction
    rays = Rays(matmul(origin, frame), matmul(direction, frame))
    far = jnp.full(rays.count, jnp.inf, low.dtype)
    unlit = jnp.broadcast_to(dark, (rays.count, nodes.count))
    each = (lit.medium.transmittance(rays, far), lit.medium.radiance(rays, far, unlit))
    passed, shine = (x.reshape(len(_DIRECTIONS), -1, nodes.count).mean(axis=1)[:, None] for x in each)
    seen = (shine + passed * behind[None]).reshape(-1, nodes.count)
    return nodes.in_band(lit.dimmed_by_air(jnp.concatenate([*lights, seen])))


def about_plumes(scene: Scene) -> Float[Array, "3 3"]:
    """Unit vectors as rows, the last along the plumes: that in which their corners are farthest apart."""
    corners = jnp.concatenate([plume.extent() for plume in scene.plumes])
    apart = corners - corners.mean(axis=0, keepdims=True)
    spread = matmul(apart.T, apart)
    for _ in range(6):  # of its powers the largest direction is left
        spread = spread / jnp.trace(spread)
        spread = matmul(spread, spread)
    axis = spread[jnp.argmax(jnp.diagonal(spread))]
    return frame_around(axis / jnp.sqrt(jnp.sum(axis**2)))


def warmth(skin: Skin, nodes: Nodes) -> Float[Array, "2 node"]:
    """Blackbodies as warm as skin in the mean and where it is warmest."""
    warm = jnp.stack([skin.temperature.mean(), skin.temperature.max()])
    return jax.vmap(lambda t: band_radiance(t, nodes))(warm)


def _lights(scene: Scene, lit: Lit) -> list[Float[Array, "_light node"]]:
    """What lights bring of those that depend on the wavenumber in a band."""
    behind = [(scene.background, lit.scene.background)] if scene.background is not None else []
    both: list[Any] = [*zip(scene.sources, lit.scene.sources, strict=True), *behind]
    return brought(tuple(own for given, own in both if given.has_spectrum), lit.nodes)


def brought(lights: tuple[AbstractLight, ...], nodes: Nodes) -> list[Float[Array, "_light node"]]:
    """What lights on the nodes bring from above, from below and from the side."""
    omega = jnp.asarray([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]], nodes.weight.dtype)
    found = [source.beam(omega[0])[None] for source in delta_sources(lights)]
    return found + [light.arriving(omega) for light in (*area_sources(lights), *backgrounds(lights))]
