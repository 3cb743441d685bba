"""Images, side by side and split into components."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from jaxir._arrays import as_float
from jaxir.imaging import Image
from jaxir.optics.spectrum import band_radiance
from jaxir.plot._figure import figure_of, seen_from

QUANTITIES = {
    "radiance": "radiance [W m$^{-2}$ sr$^{-1}$]",
    "contrast": "radiance - that without the scene [W m$^{-2}$ sr$^{-1}$]",
    "temperature": "brightness temperature [K]",
}
COLDEST, HOTTEST, TEMPERATURES = 20.0, 6000.0, 800  # of a table of Planck's law [K], and its length
SCALES = ("auto", "log", "linear")
NEAR = 100  # from the largest contrast to where a logarithmic scale about 0 becomes linear
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
    band's values span less than a factor of 3 or are not positive, and for temperatures, a linear one; contrasts below
    0 have a scale about 0, linear within a hundredth. Axes are metres in the plane through the target, as the camera
    sees it: to the right and up.

    Args:
        images: at least one, all of the same bands.
        quantity: "radiance"; "contrast", to what would be seen without the scene; or "temperature", that of a blackbody
            as bright in the band [K], which is the apparent one of an image through air.
        scale: "auto" as above, "log" or "linear".
        limits: "shared", of all images of a band; "own", of each image; or the lowest and the highest value of all.

    Returns:
        The figure.

    Raises:
        ImportError: matplotlib is not installed.
        ValueError: no image, images of different bands, another quantity or scale, limits that do not rise, a
            logarithmic scale of values none of which is positive, the temperature of an image that does not know its
            nodes.
    """
    if not images or len({image.bands for image in images.values()}) > 1:
        raise ValueError(f"images: got {len(images)} of different bands or none, expected at least one, of equal bands")
    require_choice(quantity, scale, limits)
    bands = next(iter(images.values())).bands
    highest = max(image.camera.shape[0] / image.camera.shape[1] for image in images.values())
    views = [seen_from(image.camera) for image in images.values()]
    together = len(images) > 1 and len(set(views)) == 1  # said once
    alike = together and one_extent(images.values())
    wide, head = 4.1 if limits == "shared" else 3.5, 0.35 if together else 0.5  # of a panel without its bar
    high = min(wide * highest, 4.8) + head
    figure = figure_of(4.8 * len(bands) + 0.4, (high + 0.15) * len(images) + (1.2 if limits == "shared" else 1.1))
    figure.set_layout_engine("constrained", h_pad=0.03)
    axes = figure.subplots(len(images), len(bands), squeeze=False, sharex=alike, sharey=alike)
    values = [values_of(image, quantity) for image in images.values()]
    norms = shared_norms(values, quantity, scale, limits)
    for column, band in enumerate(bands):
        for row, (name, image) in enumerate(images.items()):
            axis, norm = axes[row, column], norms[column]
            if limits == "own":
                norm = shared_norms(values[row : row + 1], quantity, scale, limits)[column]
            shown = show(axis, image, values[row][:, :, column], norm)
            about = "" if together else f"\n{views[row]}"
            axis.set_title(f"{f'{band}, {name}' if name else band}{about}", fontsize="small")
            axis.set_ylabel("up [m]" if column == 0 else "")
            axis.set_xlabel("to the right [m]" if row == len(images) - 1 else "")
            if limits != "shared":
                marked(figure.colorbar(shown, ax=axis, location="right", shrink=0.8), norm)
        if limits == "shared":
            below = {"location": "bottom", "shrink": 0.9, "aspect": 40}
            marked(figure.colorbar(shown, ax=axes[:, column], label=QUANTITIES[quantity], **below), norm)
    said = ([] if limits == "shared" else [QUANTITIES[quantity]]) + ([views[0]] if together else [])
    if said:
        figure.suptitle(", ".join(said), fontsize="medium")
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


def marked(bar: Any, norm: Any) -> None:
    """Ticks at 1, 2 and 5 where a logarithmic scale spans less than two decades."""
    from matplotlib.colors import LogNorm
    from matplotlib.ticker import FormatStrFormatter, LogLocator

    if isinstance(norm, LogNorm) and float(norm.vmax or 0) < 100 * float(norm.vmin or 0):
        bar.set_ticks(LogLocator(subs=(1.0, 2.0, 5.0)))
        bar.formatter = FormatStrFormatter("%g")
        bar.minorticks_off()


def values_of(image: Image, quantity: str) -> np.ndarray:
    """What an image shows of a quantity [row, column, band]."""
    radiance = np.asarray(image.radiance)
    if quantity == "temperature":
        return _temperatures(image)
    return radiance if quantity == "radiance" else radiance - np.asarray(image.empty)


def _temperatures(image: Image) -> np.ndarray:
    """Brightness temperatures [row, column, band] [K], from a table that is nearly straight in 1/T over ln L."""
    if image.asked is None:
        raise ValueError("quantity: got temperature of an image without nodes (Image.asked), expected one of `render`")
    nodes, radiance = image.asked.nodes, np.asarray(image.radiance, np.float64)
    temperature = np.geomspace(COLDEST, HOTTEST, TEMPERATURES)
    table = np.asarray(nodes.in_band(band_radiance(as_float(temperature), nodes)), np.float64)
    found = np.empty_like(radiance)
    for index in range(radiance.shape[-1]):
        rises = table[:, index] > 0
        bright = np.log(np.maximum(radiance[..., index], table[rises, index].min()))
        found[..., index] = 1 / np.interp(bright, np.log(table[rises, index]), 1 / temperature[rises])
    return found


def show(axis: Any, image: Image, values: np.ndarray, norm: Any) -> Any:
    """Draw values [row, column], those below the scale as its lowest; a scale about 0 has two colours."""
    colours = "RdBu_r" if norm.vmin == -norm.vmax else "inferno"
    held = np.maximum(values, norm.vmin)
    return axis.imshow(held, norm=norm, cmap=colours, extent=extent_of(image), aspect="equal")


def extent_of(image: Image) -> tuple[float, float, float, float]:
    """Left, right, lowest and highest metres of an image."""
    rows, columns = image.camera.shape
    x, y = (0.5 * n * float(p) for n, p in zip((columns, rows), image.camera.pixel, strict=True))
    return -x, x, -y, y


def one_extent(images: Iterable[Image]) -> bool:
    """Whether images are equally large."""
    return len({extent_of(image) for image in images}) == 1


def shared_norms(values: Sequence[np.ndarray], quantity: str, scale: str, limits: Any) -> list[Any]:
    """A scale for each band, of all values [row, column, band], or between limits that are given."""
    norms = []
    for index in range(values[0].shape[-1]):
        low, high = (float(f([f(own[..., index]) for own in values])) for f in (np.min, np.max))
        if not isinstance(limits, str):
            low, high = limits
        norms.append(_scale(low, high, scale, quantity))
    return norms


def require_choice(quantity: str, scale: str, limits: Any) -> None:
    if quantity not in QUANTITIES:
        raise ValueError(f"quantity: got {quantity!r}, expected {', '.join(QUANTITIES)}")
    if scale not in SCALES:
        raise ValueError(f"scale: got {scale!r}, expected {', '.join(SCALES)}")
    if isinstance(limits, str) and limits not in ("shared", "own"):
        raise ValueError(f"limits: got {limits!r}, expected shared, own, or the lowest and the highest value")
    if not isinstance(limits, str) and not limits[0] < limits[1]:
        raise ValueError(f"limits: got {limits!r}, expected the lower value first")


def _scale(low: float, high: float, scale: str, quantity: str) -> Any:
    from matplotlib.colors import LogNorm, Normalize, SymLogNorm

    if scale == "log" and not high > 0:
        raise ValueError(f"scale: got log for values up to {high:.3g}, expected some above 0")
    if quantity == "temperature" and scale == "auto":
        scale = "linear"
    if quantity == "contrast" and low < 0 and scale != "log":  # darker and brighter than what is behind
        most = max(-low, high)
        return Normalize(-most, most) if scale == "linear" else SymLogNorm(most / NEAR, vmin=-most, vmax=most)
    floor = max(low, high / SPAN)
    if scale == "linear" or (scale == "auto" and (not high > 0 or floor * 3 > high)):
        return Normalize(low, high if high > low else low + 1)
    return LogNorm(floor if floor < high else high / SPAN, high)
