"""Signatures in polar coordinates."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxir.imaging import Signature
from jaxir.plot._figure import figure_of

SCALES = {"log": "W/sr", "linear": "W/sr", "dB": "dB over 1 W/sr"}
DECADES = 4  # from the rim of a logarithmic plot to its middle at most
ERRORS = 2  # standard errors of a band around a curve


def polar_signature(table: Signature, *, scale: str = "log") -> Any:
    """Radiant intensity over the angle of a signature, one curve per band with two standard errors around it.

    The angle is the azimuth, with a curve for every elevation, the nose on top and the left wing on the left, as seen
    from above; where the table has one azimuth only, it is the elevation, the nose on the right. Where the intensity is
    negative, a contrast darker than its background, the curve is dotted.

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
    figure = figure_of(6.4, 7.2)
    axis = figure.subplots(subplot_kw={"projection": "polar"})
    azimuth, elevation = np.asarray(table.azimuth), np.asarray(table.elevation)
    upright = np.unique(azimuth).size == 1 and np.unique(elevation).size > 1
    angle, other = (elevation, azimuth) if upright else (azimuth, elevation)
    cuts = np.unique(other)
    intensity, error = np.asarray(table.intensity, np.float64), np.asarray(table.standard_error, np.float64)
    size = np.abs(intensity)
    rim = float(size.max()) if (size > 0).any() else 1.0
    low = np.where(size > ERRORS * error, size - ERRORS * error, size)
    floor = max(float(low[low > 0].min(initial=rim)), rim / 10**DECADES)

    def radius(value: np.ndarray) -> np.ndarray:
        held = np.where(value > 0, value, np.nan)
        return 10 * np.log10(np.maximum(held, floor)) if scale == "dB" else held

    for place, band in enumerate(table.bands):
        for cut, style in zip(cuts.tolist(), ["-", "--", ":", "-."] * (cuts.size // 4 + 1), strict=False):
            chosen = np.flatnonzero(other == cut)
            chosen = chosen[np.argsort(angle[chosen], kind="stable")]
            turn, value, spread = np.deg2rad(angle[chosen]), intensity[chosen, place], ERRORS * error[chosen, place]
            if not upright and chosen.size > 2 and turn[-1] - turn[0] < 2 * np.pi:
                gap = 2 * np.pi - (turn[-1] - turn[0])
                if gap < 1.5 * np.diff(turn).max():  # the last step of a circle
                    turn = np.append(turn, turn[0] + 2 * np.pi)
                    value, spread = np.append(value, value[0]), np.append(spread, spread[0])
            label = band if cuts.size == 1 else f"{band}, {'azimuth' if upright else 'elevation'} {cut:g}°"
            colour = f"C{place}"
            axis.plot(turn, radius(value), style, color=colour, label=label)
            if (spread > 0).any():
                ends = (np.maximum(np.abs(value) + sign * spread, floor) for sign in (-1, 1))
                axis.fill_between(turn, *(radius(end) for end in ends), color=colour, alpha=0.2, linewidth=0)
            if (value < 0).any():
                axis.plot(turn, radius(-value), linestyle=(0, (1, 2)), color=colour, label=f"{label}, negative")
    if not upright:
        axis.set_theta_zero_location("N")
    if scale == "log" and (intensity != 0).any():
        axis.set_rscale("log")
    if scale != "linear":
        axis.set_rlim(*(10 * np.log10(x) if scale == "dB" else x for x in (floor / 1.3, rim * 1.3)))
    axis.set_rlabel_position(112.5)
    axis.set_xlabel(" ")  # room between the last angle and the legend
    figure.suptitle(f"radiant intensity [{SCALES[scale]}] over {'elevation' if upright else 'azimuth, nose up'}")
    figure.legend(loc="outside lower center", ncols=min(3, len(table.bands)), fontsize="small")
    return figure
