"""A figure that belongs to nobody, and what is said of a view."""

from __future__ import annotations

from typing import Any

from jaxir.geometry import Camera, view_angles


def figure_of(width: float, height: float) -> Any:
    """An empty figure of a size in inches.

    Raises:
        ImportError: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError('plots need matplotlib: pip install "jaxir[plot]"') from error
    return Figure(figsize=(width, height), layout="constrained")


def seen_from(camera: Camera) -> str:
    """Aspect and range of a camera in words."""
    azimuth, elevation = view_angles(camera.frame)
    away = float(camera.inverse_range)
    how_far = "from afar" if away == 0 else f"{1 / away:.4g} m" if away > 1e-3 else f"{1e-3 / away:.4g} km"
    return f"azimuth {azimuth + 0.0:.4g}°, elevation {elevation + 0.0:.4g}°, {how_far}"
