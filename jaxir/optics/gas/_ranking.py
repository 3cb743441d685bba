"""Spectra inside bins, ranked by absorption, on the host: quantiles of one spectrum and slots of another.

The k-distribution of a bin is the absorption spectrum in ascending order. A node's quantile g picks one value of it;
the node's weight is the share of the bin that it stands for, its slot (`Nodes.slot`): from the sum of the weights below
to that sum plus its own. (The point of a Gauss quadrature lies inside its slot: Chebyshev, Markov, Stieltjes.) Another
spectrum, above all the transmittance of cold air in front, is averaged over the wavenumbers whose rank in the first
spectrum falls into the slot, so that what coincides line by line stays together.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxir.optics.spectrum import Nodes, bin_edges


class Bin(NamedTuple):
    """One bin of nodes on a grid of wavenumbers.

    Attributes:
        nodes: indices of its nodes.
        samples: those of its wavenumbers.
    """

    nodes: np.ndarray
    samples: slice


def bins_of(nodes: Nodes, wavenumber: Float[np.ndarray, " sample"]) -> Iterator[Bin]:
    """The bins of `nodes` on increasing wavenumbers [sample] [cm-1].

    Raises:
        ValueError: a bin is not covered by the grid, or none of its wavenumbers lies in it.
    """
    lower, upper = bin_edges(nodes)
    order = np.argsort(lower, kind="stable")
    first = np.unique(lower[order], return_index=True)[1]
    step = np.median(np.diff(wavenumber)) if wavenumber.size > 1 else 0.0
    for own in np.split(order, first[1:]):
        low, high = float(lower[own[0]]), float(upper[own[0]])
        inside = np.searchsorted(wavenumber, np.array([low, high]) * (1 - 1e-9))
        if inside[0] == inside[1] or abs((inside[1] - inside[0]) * step - (high - low)) > 1.01 * step:
            raise ValueError(
                f"wavenumber: got {inside[1] - inside[0]} samples every {step:.3g} cm-1 in the bin {low:.7g}-{high:.7g}"
                " cm-1, expected samples all over it"
            )
        yield Bin(own, slice(int(inside[0]), int(inside[1])))


def at_quantiles(
    nodes: Nodes, index: int, wavenumber: Float[np.ndarray, " sample"], value: Float[np.ndarray, " sample"]
) -> Float[np.ndarray, " node"]:
    """Quantiles of a spectrum in the nodes' bins.

    Args:
        nodes: bins and quantiles.
        index: which of the two quantiles of a node counts.
        wavenumber: increasing, evenly spaced [cm-1].
        value: spectrum >= 0 at them.

    Returns:
        The value that the share g of the bin lies below, for each node; between samples ln value is linear in g.
    """
    g = np.asarray(nodes.g, np.float64)[:, index]
    result = np.empty(nodes.count)
    for each in bins_of(nodes, wavenumber):
        ranked = np.sort(value[each.samples])
        place = (np.arange(ranked.size) + 0.5) / ranked.size
        floor = np.finfo(np.float64).tiny
        result[each.nodes] = np.exp(np.interp(g[each.nodes], place, np.log(np.maximum(ranked, floor))))
    return result


def slot_means(
    nodes: Nodes,
    wavenumber: Float[np.ndarray, " sample"],
    ranked_by: Float[np.ndarray, "2 sample"],
    depth: Float[np.ndarray, "2 sample"],
) -> Float[np.ndarray, " node"]:
    """Transmittance averaged over the nodes' slots.

    In bins whose nodes have equal quantiles all species share one rank, that of the sum of `ranked_by`. In bins with
    squares of quantiles the mean over a node's slot is the product of the means for the species of each quantile,
    whose lines lie at random to one another.

    Args:
        nodes: bins and quantiles.
        wavenumber: increasing, evenly spaced [cm-1].
        ranked_by: absorption of the species that take the first and the second quantile of a node, in the state whose
            radiance counts most: the hottest.
        depth: optical depth whose transmittance is averaged, of the same two groups of species.

    Returns:
        Transmittance for each node.
    """
    g, slot = np.asarray(nodes.g), np.asarray(nodes.slot, np.float64)
    result = np.empty(nodes.count)
    for each in bins_of(nodes, wavenumber):
        own, inside = each
        if np.array_equal(g[own, 0], g[own, 1]):
            total = ranked_by[:, inside].sum(axis=0)
            result[own] = _in_slots(slot[own, 0], total, np.exp(-depth[:, inside].sum(axis=0)))
        else:
            first, second = (_in_slots(slot[own, i], ranked_by[i, inside], np.exp(-depth[i, inside])) for i in (0, 1))
            result[own] = first * second
    return result


def _in_slots(slot: np.ndarray, ranked_by: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Mean of `value` over slots, given by where each begins and how large it is [slot, 2]."""
    below = np.concatenate([[0.0], np.cumsum(value[np.argsort(ranked_by, kind="stable")])]) / value.size
    ends = np.stack([slot[:, 0], slot.sum(axis=1)], axis=1)
    return np.diff(np.interp(ends, np.arange(value.size + 1) / value.size, below), axis=1)[:, 0] / slot[:, 1]
