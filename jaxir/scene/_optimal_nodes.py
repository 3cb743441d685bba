"""Few spectral nodes that stand for many, by optimal spectral sampling.

The spectra that rays bring from one scene are alike: thousands of nodes of fine bins differ in a few dozens of ways. Of
the nodes n of a fine resolution those with factors f_n > 0 are taken,

    sum_n response[band, n] weight[n] L_n = sum_n response[band, n] weight[n] f_n L_n,

for all spectra L of a training set (Moncet, Uymin, Lipton and Snell, "Infrared radiance modeling by optimal spectral
sampling", J. Atmos. Sci. 65, 2008, 3917). No more of them are needed than there are independent spectra, the singular
vectors of the set; those with small singular values are left out, first many, then fewer, until rays that are not in
the set agree.

The set: rays through places in the plumes, to all sides and nearly along them, seen through the air from outside and
without it from these places; what they show of the plumes, also with what particles scatter, and what passes of skin,
of every light and of light that is the same at all wavenumbers; what plumes are more than the background that they
hide; skin of temperatures from its lowest to its highest, every other of which is not in the set, through the air, and
what it is more than the background.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxir._arrays import as_float, fingerprint, is_traced, remembered, require
from jaxir._programs import program
from jaxir.optics.spectrum import Band, Nodes, as_bands, gray_nodes, padded_nodes, some_of, told_apart, with_error
from jaxir.scene._probes import RAYS, behind, brought, draws, from_outside, joined, scattered, through, warmth
from jaxir.scene._resolution import (
    GRAIN,
    KEPT,
    finest_nodes,
    kept_choice,
    scene_nodes,
    spectral,
    with_few_cells,
)
from jaxir.scene._scene import Scene, on_nodes

TOLERANCES = tuple(10.0 ** (-k / 4) for k in range(5, 21))  # singular values left out, as shares of the largest
INSIDE = 0.3  # of an error of light inside the scene counts: of what is seen, that light is a part
FAINT = 1e-3  # of the brightest spectrum of a kind: fainter ones do not count
BLOCK = 256  # spectra whose singular vectors are found at a time
SHARE = 0.1  # of an error asked for that nodes may make up: before a bright background what is seen is a difference
MOST, LEAST = 0.1, 1e-4  # what they may err whatever is asked
STEP = 2**0.5  # by which counts of nodes for an error differ, so that other values mostly find their programs compiled

Chosen = tuple[np.ndarray, np.ndarray, np.ndarray]  # which nodes, their factors, what they err in each band


def optimal_nodes(scenes: Scene | Sequence[Scene], bands: Band | Sequence[Band], rtol: float = 0.02) -> Nodes:
    """The least spectral nodes with which all that is seen of scenes is right within `rtol`.

    Where hot gas shines through cold air a twentieth of those of `scene_nodes`, at the same error: an exhaust of 2000 K
    in three bands takes some 70 to 90 in place of 1785. Each stands for what others bring, so that by themselves they
    are no spectrum. They fit these scenes: choose them anew for others. Derivatives are those with the nodes held.

    Args:
        scenes: one, or several that shall share nodes, as an aircraft through the air of several places.
        bands: at least one band.
        rtol: what rays that were not used to choose nodes may err at most, as a share of their in-band radiance,
            against bins of 50 cm-1 with 12 quantiles (32 where bands are narrow); those fainter than a thousandth of
            the brightest do not count, and light inside plumes, which is seen once it is scattered or reflected, may
            err by three times that.

    Returns:
        Nodes with `Nodes.error`: what such rays err at most. Those they are compared with if none of fewer do; gray
        ones where nothing depends on the wavenumber. Choices are kept, on disk, too.

    Raises:
        ValueError: an rtol that is not > 0, no scene, values that are not known (inside `jax.jit`), a gas with values
            for given nodes, as `CorrelatedK`, or as `Scene.checks`.
    """
    if not (np.isfinite(rtol) and rtol > 0):
        raise ValueError(f"optimal_nodes: got rtol {rtol}, expected a number > 0")
    several, wanted = (scenes,) if isinstance(scenes, Scene) else tuple(scenes), as_bands(bands)
    if not several or not all(isinstance(scene, Scene) for scene in several):
        raise ValueError(f"optimal_nodes: got {scenes!r}, expected one Scene or several")
    if is_traced(several):
        raise ValueError("optimal_nodes: got values that are not known yet, expected a call outside of transformations")
    for scene in several:
        if any(plume.has_quantiles for plume in scene.plumes):
            raise ValueError("optimal_nodes: got a gas with values for given nodes, expected one for any nodes")
    return _best(several, wanted, rtol, rtol) if spectral(several, wanted) else gray_nodes(wanted)


def nodes_within(scene: Scene, bands: Nodes | Band | Sequence[Band], rtol: float | None) -> Nodes:
    """The spectral nodes on which a scene is computed where intensities may err by `rtol`.

    As by `optimal_nodes` for `SHARE` of it, from `LEAST` to `MOST`, or the best below it, and some of weight 0, so that
    few counts occur; `scene_nodes` where no such error is asked for or a gas has values for given nodes.
    """
    if isinstance(bands, Nodes):
        return bands
    wanted = as_bands(bands)
    if not rtol or not spectral((scene,), wanted) or any(plume.has_quantiles for plume in scene.plumes):
        return scene_nodes(scene, wanted)
    nodes = _best((scene,), wanted, min(max(SHARE * rtol, LEAST), MOST), rtol)
    if nodes.count <= len(wanted) or not np.asarray(nodes.error).any():  # the finest are of few counts as they are
        return nodes
    count = 1
    while count < nodes.count or count == len(wanted):  # as many as bands would be taken for them
        count = math.ceil(count * STEP)
    return with_error(padded_nodes(nodes, count), np.asarray(nodes.error))


_held: dict[tuple, Nodes] = {}


def _best(scenes: tuple[Scene, ...], bands: tuple[Band, ...], rtol: float, most: float) -> Nodes:
    """The fewest nodes that err by at most `rtol`, or those that err least; the finest if by over `most`."""
    for scene in scenes:
        require(scene.checks())
    asked = (jax.tree.structure(scenes), str(bands), fingerprint(scenes), float(rtol))
    nodes = remembered(_held, asked, lambda: _choice(scenes, bands, rtol, asked), KEPT)
    if np.all(np.asarray(nodes.error) <= most):
        return nodes
    return finest_nodes(scenes, bands, most)


def _choice(scenes: tuple[Scene, ...], bands: tuple[Band, ...], rtol: float, asked: tuple) -> Nodes:
    """The nodes as an earlier process chose them, or chosen now."""
    fine = finest_nodes(scenes, bands, rtol)
    left = np.asarray(fine.error, np.float64)

    def found() -> list[Any]:
        spectra = [_spectra(with_few_cells(scene), fine, as_float(draws())) for scene in scenes]
        return [each.tolist() for each in _chosen(spectra, fine, rtol - left.max())]

    place, factor, error = kept_choice("optimal nodes", asked, found)
    return _taken(fine, np.array(place, int), np.array(factor), error + left)


def _taken(fine: Nodes, place: np.ndarray, factor: np.ndarray, error: np.ndarray) -> Nodes:
    """Some of the nodes, with factors on their weights."""
    order, apart = told_apart(np.asarray(fine.response)[:, place])
    place, factor = place[order], factor[order] * apart
    weight = as_float(np.asarray(fine.weight, np.float64)[place] * factor)
    return with_error(dataclasses.replace(some_of(fine, place), weight=weight), error)


class Spectra(eqx.Module):
    """What may be seen of a scene, without plumes and along rays from outside through the air, and from inside.

    Without plumes: skin from its lowest to its highest temperature [warm], the background, and lights.
    """

    warm: Float[Array, "warm node"]
    around: Float[Array, "around node"]
    fixed: Float[Array, "spectrum node"]
    outside: Float[Array, "kind ray node"]
    inside: Float[Array, "kind ray node"]


@program
def _spectra(scene: Scene, nodes: Nodes, draws: Float[Array, "ray 6"]) -> Spectra:
    lit = on_nodes(scene, nodes)
    flat = (nodes.upper - nodes.lower)[None]
    warm = flat[:0] if scene.skin is None else warmth(scene.skin, nodes)
    sky = () if lit.scene.background is None else (lit.scene.background,)
    around = jnp.concatenate([flat[:0], *brought(sky, nodes)])
    others = jnp.concatenate([flat, behind(warm), *brought(lit.scene.sources, nodes), around])
    fixed = jnp.concatenate([warm, others, lit.dimmed_by_air(others), lit.through_air(jnp.zeros_like(flat))])
    known = lit.dimmed_by_air(warm), lit.dimmed_by_air(around), fixed
    if lit.medium is None:
        none = jnp.zeros((0, RAYS, nodes.count), flat.dtype)
        return Spectra(*known, none, none)
    inside = through(scene, draws)
    rays = joined([from_outside(scene, inside), inside])
    far, dark = jnp.full(rays.count, jnp.inf, flat.dtype), jnp.zeros((rays.count, nodes.count), flat.dtype)
    passed = lit.medium.transmittance(rays, far)
    shine = [lit.medium.radiance(rays, far, dark)]
    if lit.medium.scatters:
        shine.append(shine[0] + scattered(lit, rays, passed))
    along = jnp.stack([*shine, *(passed * own[None] for own in others)])
    seen = along[:, : inside.count]
    if sky:
        hidden = (1 - passed[: inside.count]) * around.mean(axis=0)[None]
        seen = jnp.concatenate([seen, (seen[0] - hidden)[None]])
    return Spectra(*known, lit.dimmed_by_air(seen), along[:, inside.count :])


def _chosen(spectra: Sequence[Spectra], fine: Nodes, rtol: float) -> Chosen:
    """Which nodes, with which factors, and what they err [band], at most `rtol` if the set allows it."""
    known = np.arange(RAYS) % 3 != 2  # of each plume; every third is not in the set
    share = np.asarray(fine.response, np.float64) * np.asarray(fine.weight, np.float64)
    used = [own > 0 for own in share]
    own, others = [], []
    for of_band, some in zip(share, used, strict=True):
        each = [_of_band(seen, known, of_band, some) for seen in spectra]
        own.append(_independent(np.concatenate([x for x, _ in each]), TOLERANCES[-1]))
        others.append(np.concatenate([x for _, x in each]))

    def err(factor: np.ndarray) -> np.ndarray:
        each = [np.abs(x @ factor[some] - x.sum(axis=1)).max() for x, some in zip(others, used, strict=True)]
        return np.array(each)

    best = None
    for tolerance in TOLERANCES:
        factor = _factors([_independent(x, tolerance) for x in own], used)
        if factor is not None and (best is None or err(factor).max() < err(best).max()):
            best = factor
            if np.all(err(best) <= rtol):
                break
    best = np.ones(fine.count) if best is None else best
    return np.flatnonzero(best), best[best > 0], err(best)


def _of_band(seen: Spectra, known: np.ndarray, share: np.ndarray, some: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shares that nodes of a band have in radiances [spectrum, node]: in those of the set, and in those to agree."""
    in_band = jax.tree.map(lambda x: np.asarray(x, np.float64)[..., some] * share[some], seen)
    warm, around, fixed, outside, inside = jax.tree.leaves(in_band)
    known = np.resize(known, outside.shape[1])
    own = [_normal(rows) for rows in (fixed, warm[::2], _contrasts(warm[::2], around))]  # those between have to agree
    others = [_normal(rows) for rows in (fixed, warm, _contrasts(warm, around))]
    for kinds, counts in ((outside, 1.0), (inside, INSIDE)):
        for kind in kinds:
            total = np.abs(kind[~known]).sum(axis=1)
            own.append(counts * _normal(kind[known]))
            others.append(counts * _normal(kind[~known][total > FAINT * total.max()]))
    return np.concatenate(own), np.concatenate(others)


def _contrasts(warm: np.ndarray, around: np.ndarray) -> np.ndarray:
    """What skin and the background are more or less than the background, where that is more than rounding."""
    each = np.concatenate([warm, around])[:, None] - around[None]
    some = np.abs(each).sum(axis=2) > GRAIN * around.sum(axis=1)
    return each[some]


def _normal(rows: np.ndarray) -> np.ndarray:
    total = np.abs(rows).sum(axis=1)
    return rows[total > 0] / total[total > 0, None]


def _independent(rows: np.ndarray, tolerance: float) -> np.ndarray:
    """Combinations of rows, by singular vectors, without those of values below a share of the largest."""
    found = rows[:0]
    for begin in range(0, len(rows), BLOCK):
        block = np.concatenate([found, rows[begin : begin + BLOCK]])
        square, vector = np.linalg.eigh(block @ block.T)
        found = vector[:, square > tolerance**2 * square[-1]].T @ block
    return found


def _factors(rows: Sequence[np.ndarray], used: Sequence[np.ndarray]) -> np.ndarray | None:
    """Factors >= 0 on nodes, most of them 0, that leave the sums of rows of every band as they are; None if none."""
    from scipy.optimize import nnls  # which takes long to import

    whole = np.zeros((sum(map(len, rows)), used[0].size))
    begin = 0
    for own, some in zip(rows, used, strict=True):
        whole[begin : begin + len(own), some] = own
        begin += len(own)
    try:
        return nnls(whole, whole.sum(axis=1), maxiter=20 * len(whole))[0]
    except RuntimeError:  # as many steps did not do
        return None
