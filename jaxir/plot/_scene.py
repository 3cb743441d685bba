"""A scene and its cameras."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxir.geometry import Camera
from jaxir.plot._figure import figure_of
from jaxir.scene import Scene, Skin
from jaxir.scene.plume import AbstractPlume

MOST_FACES = 100_000  # drawn of a mesh
COLOURS = ("part", "temperature")


def scene_view(scene: Scene, cameras: Mapping[str, Camera] | None = None, colour: str = "part") -> Any:
    """Mesh, outline of the plume, directions of lights and cameras in three dimensions, to check a set-up.

    Parts of the skin have different colours, or faces the colour of their temperature. A camera is drawn as the frame
    of its image in the plane through its target with an arrow towards the eye; its distance is not to scale.

    Args:
        scene: the scene.
        cameras: by name.
        colour: of the faces: "part" or "temperature".

    Returns:
        The figure.

    Raises:
        ImportError: matplotlib is not installed.
        ValueError: another colour.
    """
    if colour not in COLOURS:
        raise ValueError(f"colour: got {colour!r}, expected {' or '.join(COLOURS)}")
    figure = figure_of(10, 7)
    axis = figure.subplots(subplot_kw={"projection": "3d"})
    extent = scene.extent()
    middle = (extent.max(axis=0) + extent.min(axis=0)) / 2
    points, centre = np.asarray(extent, np.float64), np.asarray(middle, np.float64)
    reach = 0.5 * float(np.ptp(points, axis=0).max())
    corners = [points]
    if scene.skin is not None:
        _draw_skin(figure, axis, scene.skin, colour)
    for index, plume in enumerate(scene.plumes):
        _draw_plume(axis, plume, f"plume {index}, " if len(scene.plumes) > 1 else "")
    for name, camera in (cameras or {}).items():
        corners.append(_draw_camera(axis, name, camera, reach))
    for source in scene.delta_sources:
        omega = np.asarray(source.toward(middle)[0], np.float64)
        begin = centre + reach * omega
        axis.quiver(*begin, *(-0.3 * reach * omega), color="goldenrod")
        axis.text(*begin, type(source).__name__, color="goldenrod")
        corners.append(begin[None])
    low, high = np.concatenate(corners).min(axis=0), np.concatenate(corners).max(axis=0)
    least = max(float((high - low).max()) / 4, 1e-6)  # of a box whose sides are to one scale
    size = np.maximum(high - low, least)
    for setter, value, side in zip((axis.set_xlim, axis.set_ylim, axis.set_zlim), (low + high) / 2, size, strict=True):
        setter(value - side / 2, value + side / 2)
    axis.set_box_aspect(size, zoom=1.05)
    axis.set_xlabel("x, to the nose [m]")
    axis.set_ylabel("y, to the left wing [m]")
    axis.set_zlabel("z, up [m]")
    if axis.get_legend_handles_labels()[0]:
        figure.legend(loc="outside right upper", fontsize="small")
    return figure


def _draw_skin(figure: Any, axis: Any, skin: Skin, colour: str) -> None:
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    corners, part = np.asarray(skin.mesh.corners(), np.float64), np.asarray(skin.part)
    names = [name for index, name in enumerate(skin.part_names) if (part == index).any()]
    rank = {skin.part_names.index(name): place for place, name in enumerate(names)}
    if colour == "part":
        of_part = colormaps["tab10" if len(names) <= 10 else "tab20"]
        colours = of_part(np.array([rank[index] for index in part.tolist()]) % of_part.N)
        for place, name in enumerate(names):
            held = np.count_nonzero(part == skin.part_names.index(name))
            axis.plot([], [], [], "s", color=of_part(place % of_part.N), label=f"{name}, {held} faces")
    else:
        temperature = np.asarray(skin.temperature, np.float64)
        scale = LogNorm(temperature.min(), max(temperature.max(), temperature.min() + 1))
        colours = colormaps["turbo"](scale(temperature))
        bar = figure.colorbar(
            ScalarMappable(scale, "turbo"), ax=axis, label="temperature [K]", shrink=0.5, location="bottom", format="%g"
        )
        bar.ax.xaxis.set_minor_formatter("{x:g}")
    front = np.arange(len(corners))
    if skin.mesh.closed:  # backs would be drawn over fronts where a body is thin
        up, around = np.deg2rad([axis.elev, axis.azim])
        eye = np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
        front = np.flatnonzero(np.asarray(skin.mesh.area_vectors(), np.float64) @ eye > 0)
    front = front[:: -(-front.size // MOST_FACES)]
    axis.add_collection3d(
        Poly3DCollection(corners[front], facecolors=colours[front], shade=True, edgecolor="none", antialiased=False)
    )


def _draw_plume(axis: Any, plume: AbstractPlume, name: str) -> None:
    for line in plume.outlines():
        axis.plot(*line.T, color="firebrick", linewidth=0.8)
    axis.plot([], [], [], color="firebrick", label=f"{name}{plume.described()}")


def _draw_camera(axis: Any, name: str, camera: Camera, reach: float) -> np.ndarray:
    """Draw it and return the corners of its frame."""
    target, (u, v, w) = np.asarray(camera.target, np.float64), np.asarray(camera.frame, np.float64)
    rows, columns = camera.shape
    x, y = (0.5 * n * float(p) for n, p in zip((columns, rows), camera.pixel, strict=True))
    frame = np.array([target + a * x * u + b * y * v for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1))])
    axis.plot(*frame.T, color="royalblue", linewidth=1)
    axis.quiver(*target, *(reach * w), color="royalblue")
    range_ = 1 / float(camera.inverse_range) if float(camera.inverse_range) > 0 else np.inf
    axis.text(*frame[3], f"{name or 'camera'}, {range_:g} m", color="royalblue", ha="right", va="bottom")
    return frame
