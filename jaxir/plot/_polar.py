"""Signatures in polar coordinates."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxir.imaging import Signature
from jaxir.plot._figure import figure_of

SCALES = {"log": "W/sr", "linear": "W/sr", "dB": "dB over 1 W/sr"}
DECADES = 4  # from the rim of a logarithmic plot to its middle at most
ERRORS = 2  # standard errors of a band around a curve
STYLES = ("-", "--", ":", "-.")
POINTS = 40  # of a curve at most, if they are marked


def polar_signature(table: Signature, *, scale: str = "log") -> Any:
    """Radiant intensity over the angle of a signature, one curve per band with two standard errors around it.

    The angle is the azimuth, with a curve for every elevation, the nose on top and the left wing on the left, as seen
    from above; where the table has one azimuth only, it is the elevation, 0 on the right: the nose at azimuth 0, the
    tail at 180. Where the intensity is negative, a contrast darker than its background, the curve is dotted. Of more
    than four elevations every band has a panel. So it has of a table of several states (`Signature.axes`), with a curve
    for each state at the elevation nearest to 0.

    Args:
        table: the signature.
        scale: of the radius: "log", "linear" or "dB", 10 log10 of the intensity in W/sr. The first and the last show
            four decades at most.

    Returns:
        The figure.

    Raises:
        ImportError: matplotlib is not installed.
        ValueError: another scale.
    """
    if scale not in SCALES:
        raise ValueError(f"scale: got {scale!r}, expected {', '.join(SCALES)}")
    angle, other, upright = cut_of(table)
    over, name = ("elevation", "azimuth") if upright else ("azimuth, nose up", "elevation")
    cuts = np.unique(other)
    if table.state is None and len(cuts) <= len(STYLES):
        figure = figure_of(6.4, 7.2)
        axes = [figure.subplots(subplot_kw={"projection": "polar"})]
        over += f" at azimuth {cuts[0]:g}°" if upright else ""
        curves = [
            (0, k, other == cut, band if len(cuts) == 1 else f"{band}, {name} {cut:g}°", f"C{k % 10}", style)
            for k, band in enumerate(table.bands)
            for cut, style in zip(cuts.tolist(), STYLES, strict=False)
        ]
    else:
        figure = figure_of(5.2 * len(table.bands) + 1, 7.0)
        axes = list(figure.subplots(1, len(table.bands), subplot_kw={"projection": "polar"}, squeeze=False)[0])
        if table.state is None:
            shown = [(f"{name} {cut:g}°", other == cut) for cut in cuts.tolist()]
        else:
            near = other[np.argmin(np.abs(other))]
            shown = [(label, own & (other == near)) for label, own in states_of(table)]
            over += f" at {name} {near:g}°"
        curves = [
            (k, k, own, label if k == 0 else None, f"C{i % 10}", STYLES[i // 10 % len(STYLES)])
            for k in range(len(table.bands))
            for i, (label, own) in enumerate(shown)
        ]
        for axis, band in zip(axes, table.bands, strict=True):
            axis.set_title(band)
    for place, axis in enumerate(axes):
        _draw(axis, table, angle, [curve[1:] for curve in curves if curve[0] == place], upright, scale)
    figure.suptitle(f"radiant intensity [{SCALES[scale]}] over {over}")
    columns = min(3, len(table.bands)) if len(axes) == 1 else len(table.bands)
    figure.legend(loc="outside lower center", ncols=columns, fontsize="small")
    return figure


def states_of(table: Signature) -> list[tuple[str, np.ndarray]]:
    """The states of a table in words, each with which views are of it [view]; one without words where it has none."""
    if table.state is None:
        return [("", np.ones(len(table.azimuth), bool))]
    states, first, which = np.unique(np.asarray(table.state), axis=0, return_index=True, return_inverse=True)
    named = [", ".join(f"{x} {v:g}" for x, v in zip(table.axes, own, strict=True)) for own in states.tolist()]
    return [(named[i], which.reshape(-1) == i) for i in np.argsort(first)]


def cut_of(table: Signature) -> tuple[np.ndarray, np.ndarray, bool]:
    """The angle that runs [view], the other [view], and whether the first is the elevation."""
    azimuth, elevation = np.asarray(table.azimuth), np.asarray(table.elevation)
    upright = np.unique(azimuth).size == 1 and np.unique(elevation).size > 1
    return (elevation, azimuth, True) if upright else (azimuth, elevation, False)


def _draw(axis: Any, table: Signature, angle: np.ndarray, curves: list[tuple], upright: bool, scale: str) -> None:
    """Draw curves, each of a band, some views, a label, a colour and a style, to one scale."""
    from matplotlib.ticker import LogLocator, NullLocator

    held = [np.s_[chosen, place] for place, chosen, *_ in curves]
    every, errors = np.asarray(table.intensity, np.float64), np.asarray(table.standard_error, np.float64)
    intensity, error = (np.concatenate([values[one] for one in held]) for values in (every, errors))
    size = np.abs(intensity)
    rim = float(size.max()) if (size > 0).any() else 1.0
    low = np.where(size > ERRORS * error, size - ERRORS * error, size)
    floor = max(float(low[low > 0].min(initial=rim)), rim / 10**DECADES)

    def radius(value: np.ndarray) -> np.ndarray:
        held = np.where(value > 0, value, np.nan)
        return 10 * np.log10(np.maximum(held, floor)) if scale == "dB" else held

    for place, some, label, colour, style in curves:
        chosen = np.flatnonzero(some)
        chosen = chosen[np.argsort(angle[chosen], kind="stable")]
        turn, value, spread = np.deg2rad(angle[chosen]), every[chosen, place], ERRORS * errors[chosen, place]
        if not upright and chosen.size > 2 and turn[-1] - turn[0] < 2 * np.pi:
            gap = 2 * np.pi - (turn[-1] - turn[0])
            if gap < 1.5 * np.diff(turn).max():  # the last step of a circle
                turn = np.append(turn, turn[0] + 2 * np.pi)
                value, spread = np.append(value, value[0]), np.append(spread, spread[0])
        marker = "." if chosen.size <= POINTS else ""  # few views are seen as such, and alone
        axis.plot(turn, radius(value), style, marker=marker, color=colour, label=label)
        if (spread > 0).any():
            ends = (np.maximum(np.abs(value) + sign * spread, floor) for sign in (-1, 1))
            axis.fill_between(turn, *(radius(end) for end in ends), color=colour, alpha=0.2, linewidth=0)
        if (value < 0).any():
            below = None if label is None else f"{label}, negative"
            axis.plot(turn, radius(-value), linestyle=(0, (1, 2)), marker=marker, color=colour, label=below)
    if not upright:
        axis.set_theta_zero_location("N")
    if scale == "log" and (intensity != 0).any():
        axis.set_rscale("log")
    if scale != "linear":
        axis.set_rlim(*(10 * np.log10(x) if scale == "dB" else x for x in (floor / 1.3, rim * 1.3)))
    if scale == "log":
        axis.yaxis.set_major_locator(LogLocator(subs=(1.0,) if rim > 100 * floor else (1.0, 2.0, 5.0)))
        axis.yaxis.set_minor_locator(NullLocator())
        axis.yaxis.set_major_formatter("{x:g}")
    axis.set_rlabel_position(105)
    for label in axis.get_yticklabels():
        label.set(fontsize="x-small", bbox={"facecolor": "white", "alpha": 0.7, "edgecolor": "none", "pad": 0.5})
    axis.set_thetagrids(range(0, 360, 30))
    axis.set_xlabel(" ")  # room between the last angle and the legend
