"""Scenes from TOML: what the objects of `jaxir` say, with the same names.

Every table describes one object: `type` names the class or function, the other keys are its parameters. The parts:

    bands         ["MWIR", "LWIR"], with bands of one's own as tables; or a table whose type is `resolved_nodes`,
                  `optimal_nodes`, `gray_nodes` or `k_nodes`
    [skin]        mesh (`load_mesh`), temperature, brdf, and [[skin.parts]] that differ
    [plumes]      GridPlume or JetPlume, with a gas; [[plumes]] for several
    [[sources]]   lights
    [background]  what lies behind
    [atmosphere]  the air in front
    [camera]      for `render`; [[camera]] with names for several
    [method]      how light is found
    [resolve_jet] tolerance to which jets are integrated
    [render]      parameters of `jaxir.render`
    [signature]   parameters of `jaxir.signature`, its `views` among them
    [over]        values that vary, see `jaxir.io.scene_file.States`

Paths are relative to the folder of the file.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxir._arrays import as_float, enforce
from jaxir.geometry import Camera
from jaxir.imaging import render, signature
from jaxir.io.field import load_flow
from jaxir.io.scene_file._entries import (
    Entry,
    arguments,
    build,
    construct,
    number,
    numbers,
    one_of,
    positive_or_infinite,
    read_toml,
    text,
)
from jaxir.io.scene_file._skins import read_skin
from jaxir.io.scene_file._states import States, read_states
from jaxir.io.scene_file._vocabulary import (
    ATMOSPHERES,
    BACKGROUNDS,
    CAMERAS,
    PLUMES,
    READERS,
    RENDER_READERS,
    SOURCES,
    band_list,
    k_nodes,
)
from jaxir.optics.spectrum import Band, Nodes, as_nodes, gray_nodes, resolved_nodes
from jaxir.scene import Scene, Skin, optimal_nodes
from jaxir.scene.plume import AbstractPlume, GridPlume, resolve_jet
from jaxir.transport import Method


class SceneFile(NamedTuple):
    """What a scene file says.

    Attributes:
        file: the file.
        scene: the scene.
        bands: bands, or spectral nodes.
        cameras: by name.
        method: how light is found; None for the default.
        render: other parameters of `jaxir.render`.
        signature: other parameters of `jaxir.signature`, `views` among them.
        notes: what reading computed fields did to them.
        states: what varies; None without `over`, beside which all else is as the file has it.
    """

    file: Path
    scene: Scene
    bands: Nodes | tuple[Band, ...]
    cameras: dict[str, Camera]
    method: Method | None
    render: dict[str, Any]
    signature: dict[str, Any]
    notes: tuple[str, ...]
    states: States | None = None

    def at(self, /, **state: float) -> SceneFile:
        """The file in a state, of a value of every axis of `over` by its name; errors as `load_scene`."""
        if self.states is None:
            raise ValueError(f"{self.file}: got no section over, expected it for {', '.join(state)}")
        return _read(self.states.at(**state))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the bands."""
        return self.bands.names if isinstance(self.bands, Nodes) else tuple(band.name for band in self.bands)

    def describe(self) -> str:
        """What the file says, a line for each part."""
        scene = self.scene
        lines = [] if scene.skin is None else _describe_skin(scene.skin)
        lines += [_describe_plume(plume) for plume in scene.plumes]
        lines += [f"source: {type(source).__name__}" for source in scene.sources]
        lines.append(f"background: {'none' if scene.background is None else type(scene.background).__name__}")
        lines.append(f"atmosphere: {'none' if scene.atmosphere is None else scene.atmosphere.described}")
        chosen = scene.has_spectrum and not isinstance(self.bands, Nodes)
        nodes = "as many nodes as gas and air need" if chosen else f"{as_nodes(self.bands).count} nodes"
        lines.append(f"bands: {', '.join(self.names)} on {nodes}")
        for name, camera in self.cameras.items():
            rows, columns = camera.shape
            width, height = (float(size) for size in camera.pixel)
            pixels = f"{rows} x {columns} pixels of {height:.4g} x {width:.4g} m at the target"
            lines.append(f"camera{f' {name}' if name else ''}: {pixels}")
            lines += [f"  {part}: {_pixels(points, camera)}" for part, points in _outlines(scene).items()]
        if "views" in self.signature:
            lines.append(f"signature: {len(self.signature['views'])} views")
        if self.states is not None:
            axes = ", ".join(f"{name} {' '.join(own.values())}" for name, own in self.states.labels.items())
            lines.append(f"over {axes}: {len(self.states.every)} states")
        return "\n".join(lines)


def _describe_plume(plume: AbstractPlume) -> str:
    parts = [getattr(plume, name, None) for name in ("gas", "particles")]
    made_of = " with ".join(type(part).__name__ for part in parts if part is not None)
    hottest = f"up to {float(plume.hottest()):.4g} K"
    return f"plume: {type(plume).__name__} of {made_of}, {hottest}, {_ranges(np.asarray(plume.extent()))}"


def _outlines(scene: Scene) -> dict[str, np.ndarray]:
    """Points [point, 3] whose outline is that of the skin, of its parts, and of each plume."""
    found = {}
    if scene.skin is not None:
        corners = np.asarray(scene.skin.mesh.corners(), np.float64)
        found["skin"] = corners.reshape(-1, 3)
        part = np.asarray(scene.skin.part)
        parts = {f"part {name}": corners[part == i].reshape(-1, 3) for i, name in enumerate(scene.skin.part_names)}
        found |= {name: points for name, points in parts.items() if points.size and len(parts) > 1}
    several = len(scene.plumes) > 1
    return found | {
        f"plume {i}" if several else "plume": np.asarray(p.extent(), np.float64) for i, p in enumerate(scene.plumes)
    }


def _ranges(points: np.ndarray) -> str:
    """Where points [point, 3] lie."""
    ends = zip("xyz", points.min(axis=0), points.max(axis=0), strict=True)
    return ", ".join(f"{axis} {low:.4g} to {high:.4g}" for axis, low, high in ends) + " m"


def _pixels(points: np.ndarray, camera: Camera) -> str:
    """What points [point, 3] span in an image."""
    screen = np.asarray(camera.project(as_float(points)), np.float64) / np.asarray(camera.pixel)
    columns, rows = np.ptp(screen, axis=0)
    beyond = (np.abs(screen) > np.array(camera.shape[::-1]) / 2).any()
    return f"{rows:.3g} x {columns:.3g} pixels{', beyond the frame' if beyond else ''}"


def _describe_skin(skin: Skin) -> list[str]:
    mesh, part, temperature = skin.mesh, np.asarray(skin.part), np.asarray(skin.temperature)
    size = " x ".join(f"{s:.4g}" for s in np.ptp(np.asarray(mesh.vertices, np.float64), axis=0))
    closed = "closed" if mesh.closed else "not closed or not outward"
    lines = [f"skin: {mesh.count} faces, {size} m, {closed}, {_ranges(np.asarray(mesh.vertices))}"]
    corners = np.asarray(mesh.corners())
    for index, name in enumerate(skin.part_names):
        own = temperature[part == index]
        if own.size:
            held = f"{own.size} faces, {own.min():.4g} to {own.max():.4g} K"
            lines.append(f"  part {name}: {held}, {_ranges(corners[part == index].reshape(-1, 3))}")
    return lines


ELSEWHERE = ("scene", "camera", "bands", "method", "devices")  # parameters with a section of their own, or for Python
RENAMED = {  # keys of version 0.1, with those that say the same now
    "plume": "plumes",
    "reflection": "method",
    "scattering": "method, with its key orders",
}
SECTIONS = (
    "bands",
    "skin",
    "plumes",
    "sources",
    "background",
    "atmosphere",
    "camera",
    "method",
    "resolve_jet",
    "render",
    "signature",
    "over",
)


def load_scene(path: str | os.PathLike) -> SceneFile:
    """Read a scene file.

    Args:
        path: a TOML file; this module's head lists its parts.

    Returns:
        The scene with what to compute of it. All values are checked, those of the files it names included.

    Raises:
        ValueError: a file that is missing, cut or not readable, a key that is unknown or missing, a value of another
            type or out of range; one line that names file, key, what was got and what was expected.
    """
    read = _read(read_toml(Path(path)))
    if read.states is not None and read.states.new_keys:
        read.at(**read.states.every[0])
    return read


def _read(whole: Entry) -> SceneFile:
    for old, new in RENAMED.items():
        if old in whole.children():
            raise whole.children()[old].wrong(f"the key {new}, which took its place in version 0.2")
    parts = whole.only(SECTIONS, ["bands"])
    bands = _bands(parts["bands"])
    plumes, notes = _plumes(parts["plumes"]) if "plumes" in parts else ((), ())
    if "resolve_jet" in parts:
        plumes = _resolved(parts["resolve_jet"], plumes, bands)
    skin, about_skin = read_skin(parts["skin"], READERS) if "skin" in parts else (None, ())
    sources = parts["sources"].items() if "sources" in parts else []
    try:
        scene = Scene(
            skin=skin,
            plumes=plumes,
            sources=tuple(build(entry, {**SOURCES, **BACKGROUNDS}, READERS) for entry in sources),
            background=build(parts["background"], BACKGROUNDS, READERS) if "background" in parts else None,
            atmosphere=build(parts["atmosphere"], ATMOSPHERES, READERS) if "atmosphere" in parts else None,
        )
    except ValueError as error:
        raise whole.failed(error) from error
    method = _method(parts["method"], scene) if "method" in parts else None
    if _few(parts["bands"]) and "over" in parts:
        raise parts["bands"].wrong("bands, or nodes that do not depend on the scene, beside over")
    return SceneFile(
        file=whole.file,
        scene=scene,
        bands=construct(parts["bands"], optimal_nodes, READERS, scenes=scene) if _few(parts["bands"]) else bands,
        cameras=_cameras(parts["camera"]) if "camera" in parts else {},
        method=method,
        render=arguments(parts["render"], render, RENDER_READERS, ELSEWHERE) if "render" in parts else {},
        signature=_signature(parts["signature"]) if "signature" in parts else {},
        notes=(*about_skin, *notes),
        states=read_states(parts["over"], whole) if "over" in parts else None,
    )


FEW = "optimal_nodes"
NODES: dict[str, Callable] = {
    "resolved_nodes": resolved_nodes,
    FEW: optimal_nodes,
    "gray_nodes": gray_nodes,
    "k_nodes": k_nodes,
}


def _bands(entry: Entry) -> Nodes | tuple[Band, ...]:
    """Bands or nodes; bands where the scene that is still to be made decides, see `_few`."""
    if isinstance(entry.value, list):
        return tuple(band_list(entry))
    if not isinstance(entry.value, dict):
        raise entry.wrong("a list of bands, or a table of spectral nodes")
    if _few(entry):
        return tuple(band_list(entry.only(["type", "bands", "rtol"], ["bands"])["bands"]))
    return build(entry, NODES, READERS)


def _few(entry: Entry) -> bool:
    """Whether the fewest nodes for the scene are asked for."""
    return isinstance(entry.value, dict) and entry.value.get("type") == FEW


def _plumes(entry: Entry) -> tuple[tuple[AbstractPlume, ...], tuple[str, ...]]:
    """One plume or several, and what reading fields did to them."""
    each = [_plume(item) for item in (entry.items() if isinstance(entry.value, list) else [entry])]
    return tuple(plume for plume, _ in each), tuple(note for _, notes in each for note in notes)


def _plume(entry: Entry) -> tuple[AbstractPlume, tuple[str, ...]]:
    children = entry.children()
    if "flow" not in children:
        return build(entry, PLUMES, READERS), ()
    one_of(["GridPlume"])(children.get("type", entry))
    flow = construct(children["flow"], load_flow, READERS)
    rest = {name: value for name, value in entry.value.items() if name != "flow"}
    gridded = entry._replace(value=rest, fields=flow.fields)
    notes = tuple(f"{children['flow'].key}: {line}" for line in flow.describe().splitlines())
    return construct(gridded, GridPlume, READERS, grid=flow.grid), notes


def _resolved(
    entry: Entry, plumes: tuple[AbstractPlume, ...], bands: Nodes | tuple[Band, ...]
) -> tuple[AbstractPlume, ...]:
    """The plumes, with jets integrated to a tolerance."""
    if not any(plume.parametric for plume in plumes):
        raise entry.wrong("it only beside a plume of type JetPlume")

    def own(plume: AbstractPlume) -> AbstractPlume:
        return construct(entry, resolve_jet, READERS, jet=plume, bands=bands) if plume.parametric else plume

    return tuple(own(plume) for plume in plumes)


def _method(entry: Entry, scene: Scene) -> Method:
    given = arguments(entry, Method, READERS)
    try:
        method = Method(**given)
        return enforce((method, scene), method.checks_for(scene))[0]
    except ValueError as error:
        raise entry.failed(error) from error


def _cameras(entry: Entry) -> dict[str, Camera]:
    if isinstance(entry.value, dict):
        return {"": build(entry, CAMERAS, READERS)}
    cameras = {}
    for item in entry.items():
        children = item.children()
        if "name" not in children:
            raise ValueError(f"{item.file}: {item.key}: got no key name, which each of several cameras needs")
        name = text(children["name"])
        if name in cameras or not name.replace("_", "").replace("-", "").isalnum():
            raise children["name"].wrong("a new name of letters, digits, - and _")
        cameras[name] = build(
            item._replace(value={k: v for k, v in item.value.items() if k != "name"}), CAMERAS, READERS
        )
    return cameras


def _signature(entry: Entry) -> dict[str, Any]:
    readers = {**RENDER_READERS, "views": _views, "distance": positive_or_infinite}
    return arguments(entry, signature, readers, ELSEWHERE)


def _views(entry: Entry) -> np.ndarray:
    """Aspects [view, 2]: pairs, or all combinations of azimuths and elevations."""
    if isinstance(entry.value, dict):
        keys = entry.only(["azimuth", "elevation"], ["azimuth", "elevation"])
        azimuth, elevation = (_steps(keys[name]) for name in ("azimuth", "elevation"))
        return np.stack(np.meshgrid(azimuth, elevation, indexing="ij"), axis=-1).reshape(-1, 2)
    value = np.asarray(numbers(entry))
    if value.ndim != 2 or value.shape[1] != 2:
        raise entry.wrong("pairs of azimuth and elevation, or a table of both")
    return value


def _steps(entry: Entry) -> np.ndarray:
    """Angles: a list, or `{ start, stop, step }`, the stop included where a step meets it."""
    if not isinstance(entry.value, dict):
        return np.atleast_1d(np.asarray(numbers(entry)))
    keys = entry.only(["start", "stop", "step"], ["start", "stop", "step"])
    start, stop, step = (number(keys[name]) for name in ("start", "stop", "step"))
    if not step > 0 or stop < start or (stop - start) / step > 1e5:
        raise entry.wrong("start <= stop and step > 0, at most 100000 steps")
    return start + step * np.arange(int(np.floor((stop - start) / step + 1e-6)) + 1)
