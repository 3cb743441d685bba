"""Error budgets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxir.imaging import ErrorBudget
from jaxir.plot._figure import figure_of


def error_bars(budgets: Mapping[str, ErrorBudget]) -> Any:
    """Error budgets by name: a bar for each band, as high as the total, stacked from the shares of its square.

    In units of the intensity, of the view that is brightest in the first band. A part that is not known, and one
    without end, is left out and named over the bar.

    Args:
        budgets: at least one.

    Returns:
        The figure.

    Raises:
        ImportError: matplotlib is not installed.
    """
    bars = [(name, budget.brightest, index) for name, budget in budgets.items() for index in range(len(budget.bands))]
    parts = list(bars[0][1].parts)
    every = [[np.nan if v is None else float(v[index]) for v in one.counted.values()] for _, one, index in bars]
    size = np.array(every)  # [bar, part]
    drawn = np.where(np.isfinite(size), size, 0)
    scale = np.sqrt(np.sum(drawn**2, axis=1)) * [abs(float(one.intensity[index])) for _, one, index in bars]
    height = 100 * drawn**2 / np.where(scale > 0, scale, 1)[:, None]
    top = np.cumsum(height, axis=1)
    figure = figure_of(3.6 + 0.5 * len(bars), 4.4)
    axis = figure.subplots()
    place = np.arange(len(bars))
    for k, part in enumerate(parts):
        axis.bar(place, height[:, k], bottom=top[:, k] - height[:, k], label=part)
    for x, values, y in zip(place.tolist(), size, top[:, -1].tolist(), strict=True):
        missing = [(part, v) for part, v in zip(parts, values, strict=True) if not np.isfinite(v)]
        said = [f"{part}: {'not known' if np.isnan(v) else 'inf'}" for part, v in missing]
        axis.annotate("\n".join(said), (x, y), rotation=90, ha="center", va="bottom", fontsize="x-small")
    labels = [f"{name}, {one.bands[index]}" if name else one.bands[index] for name, one, index in bars]
    axis.set_ylim(0, 1.5 * float(top.max(initial=0)) or 1)  # with room for what is said over bars
    axis.set_xticks(place, labels, rotation=60, ha="right")
    axis.set_ylabel("error [% of the intensity]")
    figure.legend(loc="outside right upper", fontsize="small")
    return figure
