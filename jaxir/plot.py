"""Looking at things: images, signatures, spectra, fits, and a scene with its cameras before a long run.

Every function returns a `matplotlib.figure.Figure` that belongs to nobody: `figure.savefig("name.png")` writes it, a
notebook shows it. matplotlib is imported on the first call and is an optional extra: `pip install "jaxir[plot]"`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxir.fit import Fit
from jaxir.geometry import Camera
from jaxir.imaging import ErrorBudget, Image, Signature
from jaxir.optics.spectrum import Nodes
from jaxir.scene import Scene
from jaxir.scene.plume import AbstractPlume

RADIANCE = "radiance [W m$^{-2}$ sr$^{-1}$]"
SPAN = 1e5  # from the brightest to the darkest colour of a logarithmic scale
MOST_FACES = 20_000  # drawn of a mesh


def _figure(width: float, height: float) -> Any:
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError('plots need matplotlib: pip install "jaxir[plot]"') from error
    return Figure(figsize=(width, height), layout="constrained")


def radiance_panels(images: Mapping[str, Image]) -> Any:
    """Images by name: one row per image, one column per band.

    Every band has one logarithmic scale over five decades at most, with a colour bar in W m-2 sr-1; where a band's
    values span less than a factor of 3 or are not positive, a linear one. Axes are metres in the plane through the
    target.

    Args:
        images: at least one, all of the same bands.

    Returns:
        The figure.

    Raises:
        ImportError: matplotlib is not installed.
        ValueError: no image, or images of different bands.
    """
    if not images or len({image.bands for image in images.values()}) > 1:
        raise ValueError(f"images: got {len(images)} of different bands or none, expected at least one, of equal bands")
    bands = next(iter(images.values())).bands
    highest = max(image.camera.shape[0] / image.camera.shape[1] for image in images.values())
    figure = _figure(4.4 * len(bands), min(4.0 * highest, 4.4) * len(images) + 1.3)
    axes = figure.subplots(len(images), len(bands), squeeze=False)
    for column, band in enumerate(bands):
        values = {name: np.asarray(image.radiance)[:, :, column] for name, image in images.items()}
        scale = _scale(*(float(f([f(v) for v in values.values()])) for f in (np.min, np.max)))
        for row, (name, image) in enumerate(images.items()):
            axis = axes[row, column]
            rows, columns = image.camera.shape
            x, y = (0.5 * n * float(p) for n, p in zip((columns, rows), image.camera.pixel, strict=True))
            shown = axis.imshow(
                np.maximum(values[name], scale.vmin), norm=scale, cmap="inferno", extent=(-x, x, -y, y), aspect="equal"
            )
            axis.set_title(f"{band}, {name}" if name else band)
            axis.set_ylabel("m" if column == 0 else "")
        figure.colorbar(shown, ax=axes[:, column], location="bottom", label=RADIANCE, shrink=0.9, aspect=40)
    return figure


def radiance_image(image: Image) -> Any:
    """One image, its bands side by side; see `radiance_panels`."""
    return radiance_panels({"": image})


def _scale(low: float, high: float) -> Any:
    from matplotlib.colors import LogNorm, Normalize

    floor = max(low, high / SPAN)
    if not high > 0 or floor * 3 > high:
        return Normalize(low, high if high > low else low + 1)
    return LogNorm(floor, high)


def polar_signature(table: Signature) -> Any:
    """Radiant intensity over the angle of a signature, logarithmic radius, one curve per band.

    The angle is the azimuth, with a curve for every elevation; where the table has one azimuth only, it is the
    elevation. Where the intensity is negative, a contrast darker than its background, the curve is dashed.

    Args:
        table: the signature.

    Returns:
        The figure.

    Raises:
        ImportError: matplotlib is not installed.
    """
    figure = _figure(6.4, 6.4)
    axis = figure.subplots(subplot_kw={"projection": "polar"})
    azimuth, elevation = np.asarray(table.azimuth), np.asarray(table.elevation)
    upright = np.unique(azimuth).size == 1 and np.unique(elevation).size > 1
    angle, other = (elevation, azimuth) if upright else (azimuth, elevation)
    cuts = np.unique(other)
    intensity = np.asarray(table.intensity)
    for place, band in enumerate(table.bands):
        for cut, style in zip(cuts.tolist(), ["-", "--", ":", "-."] * (cuts.size // 4 + 1), strict=False):
            chosen = np.flatnonzero(other == cut)
            chosen = chosen[np.argsort(angle[chosen], kind="stable")]
            turn, value = np.deg2rad(angle[chosen]), intensity[chosen, place]
            if not upright and chosen.size > 2 and turn[-1] - turn[0] < 2 * np.pi:
                gap = 2 * np.pi - (turn[-1] - turn[0])
                if gap < 1.5 * np.diff(turn).max():  # the last step of a circle
                    turn, value = np.append(turn, turn[0] + 2 * np.pi), np.append(value, value[0])
            label = band if cuts.size == 1 else f"{band}, {'azimuth' if upright else 'elevation'} {cut:g}°"
            colour = f"C{place}"
            above = np.where(value > 0, value, np.nan)
            axis.plot(turn, above, style, color=colour, label=label)
            if (value < 0).any():
                below, dotted = np.where(value < 0, -value, np.nan), (0, (1, 2))
                axis.plot(turn, below, linestyle=dotted, color=colour, label=f"{label}, negative")
    if (intensity != 0).any():
        axis.set_rscale("log")
    axis.set_title(f"radiant intensity [W/sr] over {'elevation' if upright else 'azimuth from the nose'}")
    axis.legend(loc="lower left")
    return figure


def spectrum(nodes: Nodes, radiance: Mapping[str, Any]) -> Any:
    """Spectral radiance over wavelength from radiances on nodes, summed over the nodes of each bin.

    Args:
        nodes: the spectral axis.
        radiance: by label, on every node [node] [W m-2 sr-1], as `evaluate` gives it for one ray.

    Returns:
        The figure.

    Raises:
        ImportError: matplotlib is not installed.
        ValueError: a radiance of another shape.
    """
    figure = _figure(8, 4)
    axis = figure.subplots()
    lower, upper = np.asarray(nodes.lower, np.float64), np.asarray(nodes.upper, np.float64)
    bins, place = np.unique(np.stack([lower, upper], axis=1), axis=0, return_inverse=True)
    for label, value in radiance.items():
        value = np.asarray(value, np.float64)
        if value.shape != lower.shape:
            raise ValueError(f"radiance {label!r}: got shape {value.shape}, expected {lower.shape}, one value per node")
        total = np.bincount(place.reshape(-1), value * np.asarray(nodes.weight))
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
    figure = _figure(2.5 + 0.5 * len(bars), 4.4)
    axis = figure.subplots()
    place = np.arange(len(bars))
    for k, part in enumerate(parts):
        axis.bar(place, height[:, k], bottom=top[:, k] - height[:, k], label=part)
    for x, values, y in zip(place.tolist(), size, top[:, -1].tolist(), strict=True):
        missing = [(part, v) for part, v in zip(parts, values, strict=True) if not np.isfinite(v)]
        said = [f"{part}: {'not known' if np.isnan(v) else 'inf'}" for part, v in missing]
        axis.annotate(", ".join(said), (x, y), rotation=90, ha="center", va="bottom", fontsize="x-small")
    labels = [f"{name}, {one.bands[index]}" if name else one.bands[index] for name, one, index in bars]
    axis.set_xticks(place, labels, rotation=60, ha="right")
    axis.set_ylabel("error [% of the intensity]")
    axis.legend()
    return figure


def fit_report(fit: Fit) -> Any:
    """A fit at a glance: values with standard deviations, residuals against a normal law, correlations.

    Args:
        fit: the result of `jaxir.fit.fit`.

    Returns:
        The figure.

    Raises:
        ImportError: matplotlib is not installed.
    """
    figure = _figure(13, 4.2)
    values, residuals, correlations = figure.subplots(1, 3)
    found = fit.uncertainty
    value, spread = np.asarray(found.value, np.float64), np.asarray(found.standard_deviation, np.float64)
    place = np.arange(value.size)
    share = np.divide(spread, np.abs(value), out=np.full_like(spread, np.inf), where=value != 0)
    known = np.isfinite(share)
    values.barh(place[known], share[known])
    values.set_xscale("log" if (share[known] > 0).any() else "linear")
    units = [f" {unit}" if unit else "" for unit in found.units]
    said = [
        f"{label}\n{number:.5g} ± {error:.2g}{unit}"
        for label, number, error, unit in zip(found.labels, value, spread, units, strict=True)
    ]
    values.set_yticks(place, said)
    values.invert_yaxis()
    values.set_xlabel("standard deviation / value")
    values.set_title("parameters")

    every = np.concatenate([np.asarray(residual).ravel() for residual in fit.residual])
    span = max(4.0, float(np.abs(every).max(initial=0)))
    residuals.hist(every, bins=np.linspace(-span, span, 41), density=True)
    x = np.linspace(-span, span, 400)
    residuals.plot(x, np.exp(-x * x / 2) / np.sqrt(2 * np.pi), label="normal law")
    residuals.set_xlabel("(prediction - measured) / standard deviation")
    chi = f"chi-squared {float(fit.chi_squared):.4g} for {fit.degrees_of_freedom} degrees of freedom"
    residuals.set_title(f"{'converged' if fit.converged else 'not converged'}, {chi}", fontsize="small")
    residuals.legend()

    shown = correlations.imshow(np.asarray(found.correlation), vmin=-1, vmax=1, cmap="RdBu")
    correlations.set_xticks(place, found.labels, rotation=45, ha="right")
    correlations.set_yticks(place, found.labels)
    correlations.set_title("correlation")
    figure.colorbar(shown, ax=correlations)
    return figure


def scene_view(scene: Scene, cameras: Mapping[str, Camera] | None = None) -> Any:
    """Mesh, outline of the plume, directions of lights and cameras in three dimensions, to check a set-up.

    Parts of the skin have different colours. A camera is drawn as the frame of its image in the plane through its
    target with an arrow towards the eye; its distance is not to scale.

    Args:
        scene: the scene.
        cameras: by name.

    Returns:
        The figure.

    Raises:
        ImportError: matplotlib is not installed.
    """
    figure = _figure(9, 7)
    axis = figure.subplots(subplot_kw={"projection": "3d"})
    extent = scene.extent()
    middle = (extent.max(axis=0) + extent.min(axis=0)) / 2
    points, centre = np.asarray(extent, np.float64), np.asarray(middle, np.float64)
    reach = 0.5 * float(np.ptp(points, axis=0).max())
    corners = [points]
    if scene.skin is not None:
        _draw_skin(axis, scene)
    for plume in scene.plumes:
        _draw_plume(axis, plume)
    for name, camera in (cameras or {}).items():
        corners.append(_draw_camera(axis, name, camera, reach))
    for source in scene.delta_sources:
        omega = np.asarray(source.toward(middle)[0], np.float64)
        begin = centre + 1.4 * reach * omega
        axis.quiver(*begin, *(-0.4 * reach * omega), color="goldenrod")
        axis.text(*begin, type(source).__name__, color="goldenrod")
        corners.append(begin[None])
    low, high = np.concatenate(corners).min(axis=0), np.concatenate(corners).max(axis=0)
    half = max(float((high - low).max()) / 2, 1e-6)
    for setter, value in zip((axis.set_xlim, axis.set_ylim, axis.set_zlim), (low + high) / 2, strict=True):
        setter(value - half, value + half)
    axis.set_box_aspect((1, 1, 1))
    axis.set_xlabel("x, to the nose [m]")
    axis.set_ylabel("y, to the left wing [m]")
    axis.set_zlabel("z, up [m]")
    if axis.get_legend_handles_labels()[0]:
        axis.legend(loc="upper left")
    return figure


def _draw_skin(axis: Any, scene: Scene) -> None:
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    assert scene.skin is not None
    corners, part = np.asarray(scene.skin.mesh.corners(), np.float64), np.asarray(scene.skin.part)
    step = -(-len(corners) // MOST_FACES)
    for index, name in enumerate(scene.skin.part_names):
        faces = corners[part == index][::step]
        if faces.size:
            colour = f"C{index % 10}"
            axis.add_collection3d(Poly3DCollection(faces, facecolor=colour, edgecolor="k", linewidth=0.05, alpha=0.6))
            axis.plot([], [], [], "s", color=colour, label=f"{name}, {np.count_nonzero(part == index)} faces")


def _draw_plume(axis: Any, plume: AbstractPlume) -> None:
    for line in plume.outlines():
        axis.plot(*line.T, color="firebrick", linewidth=0.8)
    axis.plot([], [], [], color="firebrick", label=plume.described())


def _draw_camera(axis: Any, name: str, camera: Camera, reach: float) -> np.ndarray:
    """Draw it and return the corners of its frame."""
    target, (u, v, w) = np.asarray(camera.target, np.float64), np.asarray(camera.frame, np.float64)
    rows, columns = camera.shape
    x, y = (0.5 * n * float(p) for n, p in zip((columns, rows), camera.pixel, strict=True))
    frame = np.array([target + a * x * u + b * y * v for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1))])
    axis.plot(*frame.T, color="royalblue", linewidth=1)
    axis.quiver(*target, *(reach * w), color="royalblue")
    range_ = 1 / float(camera.inverse_range) if float(camera.inverse_range) > 0 else np.inf
    axis.text(*(target + 1.05 * reach * w), f"{name or 'camera'}, {range_:g} m", color="royalblue")
    return frame
