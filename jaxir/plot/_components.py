"""Radiant intensities by component."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxir.imaging import Image, Signature
from jaxir.plot._figure import figure_of, seen_from

LINEAR = 1e-2  # of the largest value, within which a scale is linear


def component_bars(image: Image) -> Any:
    """The radiant intensity of an image by component: a panel for each band, a bar for each component and their sum.

    Args:
        image: of `render(..., components=...)`.

    Returns:
        The figure.

    Raises:
        ImportError: matplotlib is not installed.
        ValueError: an image without components.
    """
    value = np.asarray(image.component_intensity(), np.float64)
    names = [*image.components, "sum"]
    figure = figure_of(4.2 * len(image.bands) + 1.2, 0.32 * len(names) + 1.4)
    axes = figure.subplots(1, len(image.bands), squeeze=False, sharey=True)[0]
    for index, (axis, band) in enumerate(zip(axes, image.bands, strict=True)):
        own = np.append(value[:, index], value[:, index].sum())
        colours = ["C3" if x < 0 else "C0" for x in own[:-1]] + ["0.3"]
        bars = axis.barh(np.arange(len(names)), own, color=colours)
        axis.bar_label(bars, [f"{x:.4g}" for x in own], padding=3, fontsize="x-small")
        axis.margins(x=0.25)
        axis.axvline(0, color="k", linewidth=0.6)
        axis.set_title(band)
        axis.set_xlabel("W/sr")
    axes[0].set_yticks(np.arange(len(names)), names)
    axes[0].invert_yaxis()
    figure.suptitle(f"radiant intensity by component, {seen_from(image.camera)}", fontsize="medium")
    return figure


def component_signature(table: Signature) -> Any:
    """The radiant intensities of a signature by component: a panel for each band, over azimuth (or elevation).

    Of a table with several elevations that nearest to 0 is shown. The scale is linear within a hundredth of the
    largest value and logarithmic beyond, so that what is negative and what is small are seen, too.

    Args:
        table: of `signature(..., components=...)`.

    Returns:
        The figure.

    Raises:
        ImportError: matplotlib is not installed.
        ValueError: a signature without components.
    """
    if table.parts is None:
        raise ValueError('table.parts: got none, expected signature(..., components="sources")')
    azimuth, elevation = np.asarray(table.azimuth), np.asarray(table.elevation)
    upright = np.unique(azimuth).size == 1 and np.unique(elevation).size > 1
    angle, other = (elevation, azimuth) if upright else (azimuth, elevation)
    cut = other[np.argmin(np.abs(other))]
    chosen = np.flatnonzero(other == cut)
    chosen = chosen[np.argsort(angle[chosen], kind="stable")]
    figure = figure_of(8.0, 3.0 * len(table.bands) + 0.6)
    axes = figure.subplots(len(table.bands), 1, squeeze=False, sharex=True)[:, 0]
    parts, whole = np.asarray(table.parts, np.float64), np.asarray(table.intensity, np.float64)
    for index, (axis, band) in enumerate(zip(axes, table.bands, strict=True)):
        axis.plot(angle[chosen], whole[chosen, index], "k-", linewidth=2, label="sum" if index == 0 else None)
        for k, name in enumerate(table.components):
            if parts[:, k].any():
                label = name if index == 0 else None
                axis.plot(angle[chosen], parts[chosen, k, index], marker=".", color=f"C{k % 10}", label=label)
        axis.set_yscale("symlog", linthresh=max(LINEAR * float(np.abs(whole[:, index]).max()), 1e-30), linscale=1.2)
        axis.axhline(0, color="k", linewidth=0.6)
        axis.set_ylabel(f"{band} [W/sr]")
        axis.grid(alpha=0.3)
    axes[-1].set_xlabel(f"{'elevation' if upright else 'azimuth from the nose to the left wing'} [deg]")
    fixed = f"{'azimuth' if upright else 'elevation'} {cut:g}°"
    axes[0].set_title(f"radiant intensity by component, {fixed}", fontsize="medium")
    figure.legend(loc="outside right upper", fontsize="small")
    return figure
