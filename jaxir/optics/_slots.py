"""Lines of hot and of cold CO2 at 4.3 um that coincide: the embedded tables, and which of their cells nodes stand for.

Between 2000 and 2400 cm-1 what a plume of CO2 emits is what CO2 in the air absorbs. A node of quantile g stands for the
wavenumbers of its bin with this rank of absorption, its slot. The tables (`studies.co2_tables`) hold for every 50 cm-1

- ln of the cross-section of hot CO2 at 32 quantiles, over temperature and pressure;
- for 16 slots of the rank of CO2 at eight reference temperatures, each in 8 parts by the rank of cold CO2, ln of the
  cold cross-section over temperature and pressure.

All cells are even in s, where the share of a bin below is 1 - (1 - s)^3.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from importlib import resources
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxir._arrays import as_float, as_one_program
from jaxir._math import matmul
from jaxir.optics._tables import overlap_matrix
from jaxir.optics.spectrum import Nodes

_RANKED_AT = (4, 2)  # of the levels of temperature and pressure: how the quantiles of several bins are ordered, 900 K


class Co2Slots(NamedTuple):
    """The embedded tables.

    Attributes:
        edges: of the bins [bin + 1] [cm-1].
        hot_temperature, hot_pressure: levels [K], [Pa].
        hot: ln of the cross-section at the quantiles [temperature, pressure, bin, quantile] [m2].
        reference: temperatures whose rank makes slots [reference] [K].
        rank: ln of the hot cross-section of each slot [reference, bin, slot].
        cold_temperature, cold_pressure: levels [K], [Pa].
        cold: ln of the cold cross-section [reference, temperature, pressure, bin, slot, part] [m2].
    """

    edges: np.ndarray
    hot_temperature: np.ndarray
    hot_pressure: np.ndarray
    hot: np.ndarray
    reference: np.ndarray
    rank: np.ndarray
    cold_temperature: np.ndarray
    cold_pressure: np.ndarray
    cold: np.ndarray


@functools.cache
def co2_slots() -> Co2Slots:
    """The embedded tables, read once."""
    with resources.files("jaxir").joinpath("data", "co2_slots.npz").open("rb") as stream, np.load(stream) as found:
        return Co2Slots(*(found[name].astype(np.float64) for name in Co2Slots._fields))


def cell_shares(count: int) -> np.ndarray:
    """Shares of a bin that its cells take [count]."""
    return np.diff(1 - (1 - np.linspace(0, 1, count + 1)) ** 3)


def tabled(nodes: Nodes) -> Bool[Array, " node"]:
    """Nodes whose bin lies inside the tables."""
    edges, grain = co2_slots().edges, 1e-6
    return (nodes.lower > edges[0] * (1 - grain)) & (nodes.upper < edges[-1] * (1 + grain))


@as_one_program
def hot_cross_sections(nodes: Nodes) -> Float[Array, "temperature pressure node"]:
    """ln of the cross-section of hot CO2 at the first quantile of nodes inside the tables [m2]; others get some value.

    In a bin that several of the tables' bins share, quantiles are ordered as at 900 K. Between cells ln of the
    cross-section is linear in s.
    """
    table = co2_slots()
    order = np.argsort(table.hot[_RANKED_AT].ravel(), kind="stable")
    values = table.hot.reshape(*table.hot.shape[:2], -1)[..., order]
    share = _cell_weights(nodes, table.hot.shape[-1])[:, order]
    above = _summed(share, np.tril) - share / 2
    place = 1 - jnp.cbrt(above)
    wanted = (1 - jnp.cbrt(1 - nodes.g[:, 0]))[:, None]
    lower, upper = (share > 0) & (place <= wanted), (share > 0) & (place > wanted)
    left, right = jnp.argmax(jnp.where(lower, place, -1), axis=1), jnp.argmin(jnp.where(upper, place, 2), axis=1)
    left, right = jnp.where(lower.any(axis=1), left, right), jnp.where(upper.any(axis=1), right, left)
    at = jnp.take_along_axis(place, jnp.stack([left, right], axis=1), axis=1)
    gap = at[:, 1] - at[:, 0]
    part = jnp.where(gap > 0, (wanted[:, 0] - at[:, 0]) / jnp.where(gap > 0, gap, 1), 0)
    constants = as_float(values)
    part = part[None, None, :]
    return constants[..., left] * (1 - part) + constants[..., right] * part


class ColdCells(NamedTuple):
    """Cold CO2 in the slots of hot CO2 at a temperature, between two references.

    Attributes:
        blend: weights of the two references [2].
        cold: ln of the cross-section [2, temperature, pressure, bin, slot, part] [m2].
        share: of each slot's cells in what a node stands for [2, node, bin * slot]; sums to 1 for nodes inside.
    """

    blend: Float[Array, " 2"]
    cold: Float[Array, "2 temperature pressure bin slot part"]
    share: Float[Array, "2 node cell"]


def cold_cells(nodes: Nodes, hottest: Float[Array, ""]) -> ColdCells:
    """Which cells the nodes stand for where the gas behind is as hot as `hottest` [K].

    Differentiable in `hottest`; its derivative jumps at the references, between which the blend is linear in ln T.
    """
    table = co2_slots()
    levels = as_float(np.log(table.reference))
    place = jnp.clip(jnp.log(jnp.maximum(hottest, 1.0)), levels[0], levels[-1])
    first = jnp.clip(jnp.searchsorted(levels, place, side="right") - 1, 0, levels.size - 2)
    part = (place - levels[first]) / (levels[first + 1] - levels[first])
    order = np.argsort(table.rank.reshape(table.reference.size, -1), axis=1, kind="stable")
    weight = _cell_weights(nodes, table.rank.shape[-1])
    start, end = nodes.slot[:, 0, 0], nodes.slot[:, 0].sum(axis=1)

    def share(ranked: Array) -> Array:
        own = weight[:, ranked]
        upper = _summed(own, np.triu)
        inside = jnp.minimum(upper, end[:, None]) - jnp.maximum(upper - own, start[:, None])
        total = jnp.maximum(inside, 0)
        sums = total.sum(axis=1, keepdims=True)
        return jnp.zeros_like(own).at[:, ranked].set(jnp.where(sums > 0, total / jnp.where(sums > 0, sums, 1), own))

    pair = jnp.stack([first, first + 1])
    orders = jnp.asarray(order)[pair]
    return ColdCells(
        jnp.stack([1 - part, part]), as_float(table.cold)[pair], jnp.stack([share(orders[i]) for i in (0, 1)])
    )


def _summed(share: Float[Array, "node cell"], half: Callable[[np.ndarray], np.ndarray]) -> Float[Array, "node cell"]:
    """Sums up to each cell (`np.triu`) or from it on (`np.tril`), as a product that compiles faster than a scan."""
    ones = as_float(half(np.ones((share.shape[1],) * 2)))
    return matmul(share, ones)


def _cell_weights(nodes: Nodes, count: int) -> Float[Array, "node cell"]:
    """Share of each cell, bin by bin, in the nodes' bins."""
    bins = overlap_matrix(nodes.lower, nodes.upper, as_float(co2_slots().edges))
    return (bins[:, :, None] * as_float(cell_shares(count))[None, None, :]).reshape(bins.shape[0], -1)
