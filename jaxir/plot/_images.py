"""Images, side by side and split into components."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxir.imaging import Image
from jaxir.plot._figure import figure_of, seen_from

QUANTITIES = {
    "radiance": "radiance [W m$^{-2}$ sr$^{-1}$]",
    "contrast": "radiance - that without the scene [W m$^{-2}$ sr$^{-1}$]",
}
SCALES = ("auto", "log", "linear")
SPAN = 1e5  # from the brightest to the darkest colour of a logarithmic scale


def radiance_panels(
    images: Mapping[str, Image],
    *,
    quantity: str = "radiance",
    scale: str = "auto",
    limits: tuple[float, float] | str = "shared",
) -> Any:
    """Images by name: one row per image, one column per band, each panel with band, name, aspect and range.

    By default every band has one logarithmic scale over five decades at most, with a colour bar in W m-2 sr-1; where a
    band's values span less than a factor of 3 or are not positive, a linear one. Axes are metres in the plane through
    the target, as the camera sees it: to the right and up.

    Args:
        images: at least one, all of the same bands.
        quantity: "radiance", or "contrast", to what would be seen without the scene.
        scale: "auto" as above, "log" or "linear".
        limits: "shared", of all images of a band; "own", of each image; or the lowest and the highest value of all.

    Returns:
        The figure.

    Raises:
        ImportError: matplotlib is not installed.
        ValueError: no image, images of different bands, another quantity or scale, limits that do not rise, a
            logarithmic scale of values none of which is positive.
    """
    if not images or len({image.bands for image in images.values()}) > 1:
        raise ValueError(f"images: got {len(images)} of different bands or none, expected at least one, of equal bands")
    _require(quantity, scale, limits)
    bands = next(iter(images.values())).bands
    highest = max(image.camera.shape[0] / image.camera.shape[1] for image in images.values())
    figure = figure_of(4.8 * len(bands) + 0.4, (min(4.4 * highest, 4.8) + 0.9) * len(images) + 0.6)
    figure.set_layout_engine("compressed", h_pad=0.1)  # of panels whose aspect is fixed
    axes = figure.subplots(len(images), len(bands), squeeze=False)
    for column, band in enumerate(bands):
        values = {name: _values(image, quantity)[:, :, column] for name, image in images.items()}
        both = [float(f([f(v) for v in values.values()])) for f in (np.min, np.max)]
        for row, (name, image) in enumerate(images.items()):
            axis, held = axes[row, column], values[name]
            low, high = both if limits == "shared" else [float(held.min()), float(held.max())]
            if not isinstance(limits, str):
                low, high = limits
            norm = _scale(low, high, scale)
            shown = axis.imshow(
                np.maximum(held, norm.vmin), norm=norm, cmap="inferno", extent=_extent(image), aspect="equal"
            )
            axis.set_title(f"{f'{band}, {name}' if name else band}\n{seen_from(image.camera)}", fontsize="small")
            axis.set_ylabel("up [m]" if column == 0 else "")
            axis.set_xlabel("to the right [m]" if row == len(images) - 1 else "")
            if limits != "shared":
                _marked(figure.colorbar(shown, ax=axis, location="right", shrink=0.8), norm)
        if limits == "shared":
            below = {"location": "bottom", "shrink": 0.9, "aspect": 40}
            _marked(figure.colorbar(shown, ax=axes[:, column], label=QUANTITIES[quantity], **below), norm)
    if limits != "shared":
        figure.suptitle(QUANTITIES[quantity])
    return figure


def radiance_image(image: Image, **options: Any) -> Any:
    """One image, its bands side by side; see `radiance_panels`, whose options it takes."""
    return radiance_panels({"": image}, **options)


def component_panels(image: Image, *, scale: str = "auto") -> Any:
    """An image and its components, each with limits of its own; those alike in all pixels are left out, as the air's.

    Args:
        image: of `render(..., components=...)`.
        scale: as `radiance_panels`.

    Returns:
        The figure.

    Raises:
        ImportError: matplotlib is not installed.
        ValueError: an image without components; as `radiance_panels`.
    """
    if image.parts is None:
        raise ValueError('image.parts: got none, expected render(..., components="sources")')
    every = {name: image.parts[:, :, k] for k, name in enumerate(image.components)}
    each = {name: value for name, value in every.items() if np.ptp(np.asarray(value), axis=(0, 1)).any()}
    shown = {name: dataclasses.replace(image, radiance=value) for name, value in each.items()}
    return radiance_panels({"all": image, **shown}, scale=scale, limits="own")


def _marked(bar: Any, norm: Any) -> None:
    """Ticks at 1, 2 and 5 where a logarithmic scale spans less than two decades."""
    from matplotlib.colors import LogNorm
    from matplotlib.ticker import FormatStrFormatter, LogLocator

    if isinstance(norm, LogNorm) and float(norm.vmax or 0) < 100 * float(norm.vmin or 0):
        bar.set_ticks(LogLocator(subs=(1.0, 2.0, 5.0)))
        bar.formatter = FormatStrFormatter("%g")
        bar.minorticks_off()


def _values(image: Image, quantity: str) -> np.ndarray:
    radiance = np.asarray(image.radiance)
    return radiance if quantity == "radiance" else radiance - np.asarray(image.empty)


def _extent(image: Image) -> tuple[float, float, float, float]:
    rows, columns = image.camera.shape
    x, y = (0.5 * n * float(p) for n, p in zip((columns, rows), image.camera.pixel, strict=True))
    return (-x, x, -y, y)


def _require(quantity: str, scale: str, limits: Any) -> None:
    if quantity not in QUANTITIES:
        raise ValueError(f"quantity: got {quantity!r}, expected {' or '.join(QUANTITIES)}")
    if scale not in SCALES:
        raise ValueError(f"scale: got {scale!r}, expected {', '.join(SCALES)}")
    if isinstance(limits, str) and limits not in ("shared", "own"):
        raise ValueError(f"limits: got {limits!r}, expected shared, own, or the lowest and the highest value")
    if not isinstance(limits, str) and not limits[0] < limits[1]:
        raise ValueError(f"limits: got {limits!r}, expected the lower value first")


def _scale(low: float, high: float, scale: str) -> Any:
    from matplotlib.colors import LogNorm, Normalize

    if scale == "log" and not high > 0:
        raise ValueError(f"scale: got log for values up to {high:.3g}, expected some above 0")
    floor = max(low, high / SPAN)
    if scale == "linear" or (scale == "auto" and (not high > 0 or floor * 3 > high)):
        return Normalize(low, high if high > low else low + 1)
    return LogNorm(floor if floor < high else high / SPAN, high)
