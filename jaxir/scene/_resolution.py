"""Which spectral nodes a scene needs, when bands are asked for."""

from __future__ import annotations

import functools
import itertools
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
from jaxir._fields import AbstractSpectrum
from jaxir._programs import program
from jaxir.optics.spectrum import (
    RESOLUTIONS,
    SECOND_RADIATION,
    Band,
    BlackbodySpectrum,
    Nodes,
    Resolution,
    Table,
    TabulatedSpectrum,
    as_bands,
    bin_edges,
    cuts_for,
    finer_nodes,
    gray_nodes,
    padded_nodes,
    resolved_nodes,
    spectral_radiance_on_host,
    with_error,
)
from jaxir.scene._probes import (
    ACROSS,
    RAYS,
    across,
    behind,
    between,
    brought,
    draws,
    from_outside,
    joined,
    scattered,
    through,
    warmth,
)
from jaxir.scene._scene import Lit, Scene, on_nodes
from jaxir.scene.air import TableAtmosphere

RTOL = 0.02  # of the in-band results of probing rays, against the finest nodes
*TRIED, FINEST = RESOLUTIONS  # the finest, of 12 quantiles, is what others are compared with
FEW_BINS = 12  # of which the means of few quantiles err too much, and many cost little
*MORE, FINER = Resolution(50.0, 16, 10), Resolution(50.0, 32, 12)  # tried for so few, and what they are compared with
UNKNOWN = RESOLUTIONS[4]  # where the scene's values are not known yet
KEPT = 32  # choices
DARK = 20.0  # of -ln is a blackbody beside the hottest that does not count
GRAIN = 1e-4  # of a background that a difference from it errs by rounding, with room


def scene_nodes(scene: Scene, bands: Nodes | Band | Sequence[Band]) -> Nodes:
    """The spectral nodes on which a scene is computed.

    Nodes are taken as they are. Bands become one gray node each where neither their response nor anything in the scene
    depends on the wavenumber inside them (`Physical.has_spectrum`). Else they become the fewest of `RESOLUTIONS` with
    which all that is seen is within `RTOL` of that on the finest, through the air: the mean radiance of 36 rays
    each in four directions through every plume, from across to nearly along it, and four times through what is hot in
    it, before darkness, with what particles scatter, and before skin; skin from its lowest to its highest temperature;
    lights; and what contrasts with the background. `Nodes.error` keeps what they err. Bands of at most `FEW_BINS` bins
    are compared with nodes of 32 quantiles.
    All candidates are tried by one program: coarser ones are padded with nodes of weight 0, the finest are tried in
    parts. A grid of more than some thousand cells is probed on every few of them.

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
    cuts, left = _cuts((scene,), bands)
    candidates = _candidates(bands, cuts)

    def found() -> list[Any]:
        place, error = _fewest(scene, candidates, _finest(bands, cuts))
        return [place, error.tolist()]

    place, error = kept_choice("nodes", asked, found)
    return with_error(candidates[place], np.asarray(error) + left)


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
    cuts, left = _cuts((scene,), _reach(nodes))
    fine, coarse = finer_nodes(nodes, cuts), with_few_cells(scene)
    together = max(fine.count, nodes.count)  # values for one count of nodes are refused on the other
    try:
        finest, own = (_results(coarse, axis, together) for axis in (fine, nodes))
    except ValueError:  # light or air given for each of the nodes
        return None
    return jnp.asarray(_apart(finest, own) + left, nodes.weight.dtype)  # in units of what they find


def _reach(nodes: Nodes) -> tuple[Band, ...]:
    """The bands of nodes as far as these reach, without their responses, which act by their means over bins."""
    lower, upper = bin_edges(nodes)
    some = [row > 0 if row.any() else row == 0 for row in np.asarray(nodes.response)]
    each = zip(nodes.names, some, strict=True)
    return tuple(Band(name, 1e4 / upper[own].max(), 1e4 / lower[own].min()) for name, own in each)


def with_few_cells(scene: Scene) -> Scene:
    """The same scene with grids of few cells: enough to choose nodes with."""
    return eqx.tree_at(lambda s: s.plumes, scene, tuple(plume.thinned() for plume in scene.plumes))


def _results(scene: Scene, nodes: Nodes, together: int) -> np.ndarray:
    """Sums over nodes, so many at a time, on nodes like those that `scene_nodes` returns: their programs serve."""
    told, each = np.zeros(len(nodes.names)), []
    for begin in range(0, nodes.count, together):
        lit = on_nodes(scene, with_error(padded_nodes(nodes, together, begin), told))
        each.append(np.asarray(_probed(scene, lit), np.float64))
    return np.sum(each, axis=0)


def _apart(results: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Largest difference of all results, as a share of the others' sizes [band]."""
    return np.max(np.abs(results[0] - others[0]) / np.where(others[1] > 0, others[1], 1), axis=0)


def _candidates(bands: tuple[Band, ...], cuts: list[float]) -> list[Nodes]:
    """From few nodes to many, gray ones first."""
    widths = (*TRIED, FINEST, *MORE) if _narrow(bands) else TRIED
    tries = [resolved_nodes(bands, *each, cuts=cuts) for each in widths]
    return [gray_nodes(bands), *sorted(tries, key=lambda n: n.count)]


def finest_nodes(scenes: Sequence[Scene], bands: tuple[Band, ...], rtol: float) -> Nodes:
    """What others are compared with that may err by `rtol`; their error is what tables leave, half of that at most."""
    cuts, left = _cuts(scenes, bands, rtol / 2)
    return with_error(_finest(bands, cuts), left)


def _finest(bands: tuple[Band, ...], cuts: list[float]) -> Nodes:
    return resolved_nodes(bands, *(FINER if _narrow(bands) else FINEST), cuts=cuts)


def _cuts(scenes: Sequence[Scene], bands: tuple[Band, ...], rtol: float = RTOL) -> tuple[list[float], np.ndarray]:
    """Where bins have to end because of what varies in scenes, and what that leaves [band], see `cuts_for`.

    Light, bodies, and air before both.
    """
    lights, airs, paths = [], [], []
    for scene in scenes:
        parts = jax.tree.leaves((scene.sources, scene.background), is_leaf=lambda x: isinstance(x, AbstractSpectrum))
        lights += [light for part in parts if isinstance(part, AbstractSpectrum) for light in _of_light(part)]
        if isinstance(scene.atmosphere, TableAtmosphere):
            air = scene.atmosphere
            airs.append(_tabulated(air.wavenumber, air.transmittance))
            if air.spectral_path_radiance is not None:
                paths.append(_tabulated(air.wavenumber, air.spectral_path_radiance))
    found: set[float] = set()
    left = np.zeros(len(bands))
    for k, band in enumerate(bands):
        if airs or band.response is not None:
            every = [*lights, *(table for scene in scenes for table in _bodies(scene, band))]
            pairs = list(itertools.product(every, airs))
            cuts, left[k] = cuts_for(band, [*every, *airs, *paths], pairs, FINEST.width, rtol)
            found.update(cuts)
    return sorted(found), left


def _tabulated(wavenumber: Array, value: Array) -> Table:
    places, values = np.asarray(wavenumber, np.float64), np.asarray(value, np.float64)
    return Table(places, functools.partial(np.interp, xp=places, fp=values))


def _of_light(light: AbstractSpectrum) -> list[Table]:
    if isinstance(light, TabulatedSpectrum):
        wavelength, value = (np.asarray(x, np.float64) for x in (light.wavelength, light.value))
        total = value.reshape(-1, wavelength.size).sum(axis=0)
        return [Table(1e4 / wavelength[::-1], lambda x: np.interp(1e4 / x, wavelength, total) * 1e4 / x**2)]
    if isinstance(light, BlackbodySpectrum):
        kelvins = np.asarray(light.temperature, np.float64)
        return [_blackbody(kelvin) for kelvin in {float(kelvins.min()), float(kelvins.max())}]
    return []


def _bodies(scene: Scene, band: Band) -> list[Table]:
    """Blackbodies as cold as the coldest skin, as hot as the hottest and as the plumes, but for those next to dark."""
    skins = [] if scene.skin is None else [scene.skin.temperature.min(), scene.skin.temperature.max()]
    kelvins = np.unique(np.asarray([*skins, *(plume.hottest() for plume in scene.plumes)], np.float64))
    least = 1e4 / band.upper
    x = SECOND_RADIATION * least * (1 / kelvins - 1 / kelvins.max(initial=1.0))
    return [_blackbody(kelvin) for kelvin in kelvins[x < DARK].tolist()]


def _blackbody(kelvin: float) -> Table:
    return Table(np.zeros(0), functools.partial(spectral_radiance_on_host, temperature=kelvin))


def _narrow(bands: tuple[Band, ...]) -> bool:
    return resolved_nodes(bands, FINEST.width, 1, 0).count <= FEW_BINS


def _fewest(scene: Scene, candidates: list[Nodes], finest: Nodes) -> tuple[int, np.ndarray]:
    """`scene_nodes` of known values: which of `_candidates`, and its error [band]."""
    coarse, together = with_few_cells(scene), max(nodes.count for nodes in candidates)
    true = _results(coarse, finest, together)
    errors: list[np.ndarray] = []
    for nodes in candidates:
        errors.append(_apart(_results(coarse, nodes, together), true))
        if np.all(errors[-1] <= RTOL):
            break
    return len(errors) - 1, errors[-1]


def _value(leaf: Array) -> Array:
    """A leaf without the tangents of `jax.grad`; as it is below `jax.jit` and `jax.vmap`."""
    while isinstance(leaf, jax.core.Tracer) and hasattr(leaf, "primal"):
        leaf = leaf.primal
    return leaf


@program
def _probed(scene: Scene, lit: Lit) -> Float[Array, "2 result band"]:
    """In-band radiances that may be seen of a scene, and what their errors are shares of: they may be differences.

    Means of rays through each plume in like directions, evenly spread and through what is hot, before darkness, with
    what particles scatter, before skin and less the background; skin, and skin less the background; lights.
    """
    nodes = lit.nodes
    dark = jnp.zeros((1, nodes.count), nodes.weight.dtype)
    warm = dark if scene.skin is None else warmth(scene.skin, nodes)
    around = () if lit.scene.background is None else (lit.scene.background,)
    sky = jnp.concatenate(brought(around, nodes) or [dark])
    seen = [warm, *brought(lit.scene.sources, nodes)]
    if scene.background is not None and scene.background.has_spectrum:
        seen.append(sky)
    less = [_each_less(warm, sky)] if around and scene.skin is not None else []
    if lit.medium is not None:
        even, hot = joined([across(scene), *between(scene)]), from_outside(scene, through(scene, as_float(draws())))
        rays = joined([even, hot])
        far = jnp.full(rays.count, jnp.inf, dark.dtype)
        unlit = jnp.broadcast_to(dark, (rays.count, nodes.count))
        each = lit.medium.transmittance(rays, far), lit.medium.radiance(rays, far, unlit)
        passed, shine = (_means(x, even.count)[:, None] for x in each)
        if lit.medium.scatters:
            seen.append(_means(each[1] + scattered(lit, rays, each[0]), even.count))
        seen.append((shine + passed * jnp.concatenate([dark, behind(warm)])[None]).reshape(-1, nodes.count))
        if around:
            hidden = (1 - passed) * sky.mean(axis=0)[None, None]
            less.append(jnp.stack([shine - hidden, hidden]).reshape(2, -1, nodes.count))
    positive = jnp.concatenate(seen)
    values = jnp.concatenate([positive, *(x[0] for x in less)])
    sizes = jnp.concatenate([positive, *(jnp.abs(x[0]) + GRAIN * x[1] for x in less)])
    return nodes.in_band(lit.dimmed_by_air(jnp.stack([values, sizes])))


def _means(of_rays: Float[Array, "ray node"], even: int) -> Float[Array, "direction node"]:
    """Of rays in like directions, of which those evenly spread come first; of the others every fourth are alike."""
    nodes, few = of_rays.shape[1], ACROSS**2
    first, others = of_rays[:even].reshape(-1, few, nodes), of_rays[even:].reshape(-1, few, RAYS // few, nodes)
    return jnp.concatenate([first.mean(axis=1), others.mean(axis=1).reshape(-1, nodes)])


def _each_less(warm: Float[Array, "warm node"], sky: Float[Array, "sky node"]) -> Float[Array, "2 result node"]:
    """Every one less every other, and the latter."""
    both = jnp.broadcast_arrays(warm[:, None] - sky[None], sky[None])
    return jnp.stack(both).reshape(2, -1, warm.shape[1])
