"""Sequences of images: as a strip, and as a film."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxir.imaging import Image
from jaxir.plot._figure import figure_of, seen_from
from jaxir.plot._images import (
    QUANTITIES,
    extent_of,
    marked,
    one_extent,
    radiance_panels,
    require_choice,
    shared_norms,
    show,
    values_of,
)

ACROSS = 4  # frames of a strip side by side
MOST = 12  # frames of a strip, evenly taken; a film has all


def film_strip(images: Mapping[str, Image], *, quantity: str = "radiance", scale: str = "auto") -> Any:
    """A sequence of images by name, in lines of four, every band with one scale for all.

    Args:
        images: at least one, of equal bands and shape, in their order; of more than twelve, twelve evenly taken.
        quantity: as `radiance_panels`.
        scale: as `radiance_panels`.

    Returns:
        The figure.

    Raises:
        ImportError: matplotlib is not installed.
        ValueError: as `radiance_panels`; images of different shapes.
    """
    first = _first(images, quantity, scale)
    chosen = list(images.items())
    if len(chosen) > MOST:
        chosen = [chosen[i] for i in np.linspace(0, len(chosen) - 1, MOST).round().astype(int)]
    values = {name: values_of(image, quantity) for name, image in chosen}
    norms = shared_norms(list(values.values()), quantity, scale, "shared")
    across, bands = min(ACROSS, len(chosen)), len(first.bands)
    lines = -(-len(chosen) // across)
    high = 3.6 * first.camera.shape[0] / first.camera.shape[1]
    figure = figure_of(3.6 * across + 0.6, (high + 0.45) * lines * bands + 0.9 * bands)
    figure.set_layout_engine("compressed")
    alike = one_extent(images.values())
    axes = figure.subplots(lines * bands, across, squeeze=False, sharex=alike, sharey=alike)
    for axis in axes.ravel():
        axis.set_visible(False)
    for index, band in reversed(list(enumerate(first.bands))):  # bars stand below one another, the last first
        for place, (name, image) in enumerate(chosen):
            axis = axes[place // across * bands + index, place % across]
            axis.set_visible(True)
            shown = show(axis, image, values[name][:, :, index], norms[index])
            about = f"{name}\n{seen_from(image.camera)}\n" if index == 0 else ""
            axis.set_title(f"{about}{band}", fontsize="small")
            axis.tick_params(labelsize="x-small")
        bar = {"location": "bottom", "shrink": 0.6, "aspect": 50, "label": f"{band} {QUANTITIES[quantity]}"}
        marked(figure.colorbar(shown, ax=axes, **bar), norms[index])
    figure.supylabel("up [m], over metres to the right", fontsize="small")
    return figure


def film(
    images: Mapping[str, Image], *, quantity: str = "radiance", scale: str = "auto", seconds: float = 0.4
) -> bytes:
    """A sequence of images as a GIF, every band with one scale for all frames: `Path(name).write_bytes(film(images))`.

    Args:
        images: as `film_strip`; all of them are frames.
        quantity: as `radiance_panels`.
        scale: as `radiance_panels`.
        seconds: for which a frame is shown, > 0.

    Returns:
        The file.

    Raises:
        ImportError: matplotlib is not installed.
        ValueError: as `film_strip`; seconds that are not > 0.
    """
    first = _first(images, quantity, scale)
    if not 0 < seconds < np.inf:
        raise ValueError(f"seconds: got {seconds}, expected a number > 0")
    figure = radiance_panels({next(iter(images)): first}, quantity=quantity, scale=scale)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image as Picture

    canvas, frames = FigureCanvasAgg(figure), []
    shown = [axis.images[0] for axis in figure.axes if axis.images]
    values = {name: values_of(image, quantity) for name, image in images.items()}
    norms = shared_norms(list(values.values()), quantity, scale, "shared")
    bars = [drawn.colorbar for drawn in shown]
    for drawn, bar, norm in zip(shown, bars, norms, strict=True):
        drawn.set_norm(norm)
        drawn.set_cmap("RdBu_r" if norm.vmin == -norm.vmax else "inferno")
        marked(bar, norm)
    for name, image in images.items():
        for index, (drawn, norm) in enumerate(zip(shown, norms, strict=True)):
            drawn.set_data(np.maximum(values[name][:, :, index], norm.vmin))
            drawn.set_extent(extent_of(image))
            drawn.axes.set_title(f"{image.bands[index]}, {name}\n{seen_from(image.camera)}", fontsize="small")
        canvas.draw()
        figure.set_layout_engine("none")  # frames that do not move
        frames.append(Picture.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB").quantize(256))
    held = io.BytesIO()
    duration = round(1000 * seconds)
    frames[0].save(held, format="GIF", save_all=True, append_images=frames[1:], duration=duration, loop=0)
    return held.getvalue()


def _first(images: Mapping[str, Image], quantity: str, scale: str) -> Image:
    """The first of images that can be frames."""
    kinds = {(image.bands, image.camera.shape) for image in images.values()}
    if len(kinds) != 1:
        raise ValueError(f"images: got {len(images)} of {len(kinds)} kinds, expected some of equal bands and shape")
    require_choice(quantity, scale, "shared")
    return next(iter(images.values()))
