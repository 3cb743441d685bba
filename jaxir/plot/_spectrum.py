"""Spectra."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxir.optics.spectrum import Nodes
from jaxir.plot._figure import figure_of


def spectrum(nodes: Nodes, radiance: Mapping[str, Any]) -> Any:
    """Spectral radiance over wavelength from radiances on nodes, summed over the nodes of each bin.

    Args:
        nodes: the spectral axis.
        radiance: by label, on every node [node] [W m-2 sr-1], as `evaluate` gives it for one ray.

    Returns:
        The figure.

    Raises:
        ImportError: matplotlib is not installed.
        ValueError: a radiance of another shape; nodes that stand for others, as those of `optimal_nodes`.
    """
    figure = figure_of(8, 4)
    axis = figure.subplots()
    lower, upper = np.asarray(nodes.lower, np.float64), np.asarray(nodes.upper, np.float64)
    bins, place = np.unique(np.stack([lower, upper], axis=1), axis=0, return_inverse=True)
    weight = np.asarray(nodes.weight)
    whole = np.bincount(place.reshape(-1), weight)
    if np.any(np.abs(whole - 1) > 1e-3):
        raise ValueError(f"nodes: got weights of {whole.min():.3g} to {whole.max():.3g} in bins, expected 1 in each")
    for label, value in radiance.items():
        value = np.asarray(value, np.float64)
        if value.shape != lower.shape:
            raise ValueError(f"radiance {label!r}: got shape {value.shape}, expected {lower.shape}, one value per node")
        total = np.bincount(place.reshape(-1), value * weight)
        density = total / (bins[:, 1] - bins[:, 0])
        edges: list[float] = []
        heights: list[float] = []
        for (low, high), height in zip(bins.tolist(), density.tolist(), strict=True):
            if edges and abs(edges[-1] - low) > 1e-6 * low:  # between two bands
                edges += [edges[-1], low]
                heights += [np.nan, np.nan]
            edges += [low, high]
            heights += [height, height]
        axis.plot(1e4 / np.array(edges), heights, label=label)
    axis.set_xlabel("wavelength [µm]")
    axis.set_ylabel("spectral radiance [W m$^{-2}$ sr$^{-1}$ / cm$^{-1}$]")
    axis.legend()
    return figure
