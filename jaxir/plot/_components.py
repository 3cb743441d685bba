"""Radiant intensities by component."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxir.imaging import Image, Signature
from jaxir.plot._figure import figure_of, seen_from
from jaxir.plot._polar import cut_of, states_of

LINEAR = 1e-2  # of the largest value, within which a scale is linear
STATES = 4  # that are drawn side by side


def component_bars(image: Image) -> Any:
    """The radiant intensity of an image by component: a panel for each band, a bar for each component and their sum.

    Whiskers are two standard errors.

    Args:
        image: of `render(..., components=...)`.

    Returns:
        The figure.

    Raises:
        ImportError: matplotlib is not installed.
        ValueError: an image without components.
    """
    value = np.asarray(image.component_intensity(), np.float64)
    error = None if image.parts_error is None else np.asarray(image.component_error(), np.float64)
    names = [*image.components, "sum"]
    figure = figure_of(4.2 * len(image.bands) + 1.2, 0.32 * len(names) + 1.4)
    axes = figure.subplots(1, len(image.bands), squeeze=False, sharey=True)[0]
    for index, (axis, band) in enumerate(zip(axes, image.bands, strict=True)):
        own = np.append(value[:, index], value[:, index].sum())
        colours = ["C3" if x < 0 else "C0" for x in own[:-1]] + ["0.3"]
        spread = None if error is None else 2 * np.append(error[:, index], float(image.intensity_error()[index]))
        bars = axis.barh(np.arange(len(names)), own, color=colours, xerr=spread, error_kw={"linewidth": 0.8})
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

    Of a table with several elevations that nearest to 0 is shown; several states have a column each, four of them at
    most. The scale is linear
    within a hundredth of the largest value and logarithmic beyond, so that what is negative and what is small are seen,
    too. Bands are two standard errors wide to each side.

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
    angle, other, upright = cut_of(table)
    cut = other[np.argmin(np.abs(other))]
    states = states_of(table)
    shown = states[:STATES]
    figure = figure_of(6.0 * len(shown) + 2.0, 3.0 * len(table.bands) + 0.6)
    from matplotlib.ticker import MultipleLocator

    axes = figure.subplots(len(table.bands), len(shown), squeeze=False, sharex=True, sharey="row")
    parts, whole = np.asarray(table.parts, np.float64), np.asarray(table.intensity, np.float64)
    chosen = [np.flatnonzero((other == cut) & own) for _, own in shown]
    chosen = [own[np.argsort(angle[own], kind="stable")] for own in chosen]
    for index, column in np.ndindex(axes.shape):
        axis, views, first = axes[index, column], chosen[column], index == column == 0
        axis.plot(angle[views], whole[views, index], "k-", linewidth=2, label="sum" if first else None)
        for k, name in enumerate(table.components):
            if parts[:, k].any():
                label, own, colour = name if first else None, parts[views, k, index], f"C{k % 10}"
                axis.plot(angle[views], own, marker=".", color=colour, label=label)
                if table.parts_error is not None:
                    spread = 2 * np.asarray(table.parts_error, np.float64)[views, k, index]
                    axis.fill_between(angle[views], own - spread, own + spread, color=colour, alpha=0.2, linewidth=0)
        largest = max(float(np.abs(whole[views, index]).max()) for views in chosen)
        axis.set_yscale("symlog", linthresh=10 ** np.ceil(np.log10(max(LINEAR * largest, 1e-30))), linscale=1.2)
        axis.axhline(0, color="k", linewidth=0.6)
        axis.grid(alpha=0.3)
    for band, axis in zip(table.bands, axes[:, 0], strict=True):
        axis.set_ylabel(f"{band} [W/sr]")
    for (label, _), axis in zip(shown, axes[0], strict=True):
        axis.set_title(label, fontsize="small")
    for axis in axes[-1]:
        if np.ptp(angle[chosen[0]]) > 90:
            axis.xaxis.set_major_locator(MultipleLocator(45))
        axis.set_xlabel(f"{'elevation' if upright else 'azimuth from the nose to the left wing'} [deg]")
    fixed = f"{'azimuth' if upright else 'elevation'} {cut:g}°"
    few = f", {len(shown)} of {len(states)} states" if len(states) > len(shown) else ""
    figure.suptitle(f"radiant intensity by component, {fixed}{few}", fontsize="medium")
    figure.legend(loc="outside right upper", fontsize="small")
    return figure
