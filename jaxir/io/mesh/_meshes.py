"""Meshes from files: OBJ, OFF, PLY and STL, and through trimesh whatever else it reads."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from jaxir.geometry.search import Mesh
from jaxir.geometry.selection import AbstractSelection, LabelledFaces, new_part, selected_faces
from jaxir.io._axes import Axes, metres
from jaxir.io._files import require_file
from jaxir.io.mesh._file_mesh import NO_MATERIAL, FileMesh, indices
from jaxir.io.mesh._obj import read_obj
from jaxir.io.mesh._off import read_off
from jaxir.io.mesh._ply import read_ply
from jaxir.io.mesh._polygons import require_corners
from jaxir.io.mesh._stl import read_stl

FARTHEST = 1e9  # [m] of a coordinate, as of `Mesh`
_READERS = {".obj": read_obj, ".off": read_off, ".ply": read_ply, ".stl": read_stl}


class Body(NamedTuple):
    """A mesh with its parts, as a file holds them.

    Attributes:
        mesh: all triangles, in the file's order (of objects, and of faces inside each).
        part: index of each face's part [face].
        part_names: names of the parts, each once.
        material: index of each face's material [face]; empty where the file names none.
        material_names: names of the materials.
    """

    mesh: Mesh
    part: np.ndarray
    part_names: tuple[str, ...]
    material: np.ndarray = NO_MATERIAL
    material_names: tuple[str, ...] = ()

    def select(self, selection: AbstractSelection) -> np.ndarray:
        """Indices of the faces that a selection holds, see `jaxir.geometry.selection`.

        Raises:
            ValueError: it holds no face or all of them, or refers to what is not there.
        """
        corners = np.asarray(self.mesh.corners(), np.float64)
        return selected_faces(selection, LabelledFaces(corners, *self[1:]))

    def with_part(self, name: str, selection: AbstractSelection) -> Body:
        """The same body with the faces that a selection holds as a new part.

        Raises:
            ValueError: as `select`, or a name that is taken.
        """
        return self._replace(**new_part(name, self.select(selection), self.part, self.part_names))


def load_mesh(path: str | os.PathLike, *, unit: Any, axes: Axes | None = None) -> Body:
    """Read STL, OBJ, PLY, GLB or whatever else trimesh reads.

    Nothing is merged, reordered or repaired, so that per-face arrays made for the file keep fitting. Vertices that no
    face uses are no part of the body: they are placed at the first one that a face uses. Faces of zero
    area are kept (they are never hit) and named in a warning. Polygons are cut into triangles, and the faces of an
    object that the file places as its mirror image are turned around, so that they still look outwards.

    Args:
        path: the file.
        unit: length unit of its coordinates: m, cm, mm, km, in, ft, or its metres. There is no default: files do not
            say.
        axes: where the body axes are in the file; those of the file by default.

    Returns:
        The mesh in body axes and metres with its parts: objects of the file, each in all its places, in OBJ its
        objects and groups (`read_obj`), one part for formats without objects (see `split_bodies`).

    Raises:
        ValueError: unknown unit, no such file, unreadable or cut file, fewer or more faces than its header says, a
            face that crosses itself or has a corner that is no vertex, no triangles or only flat ones, coordinates
            that are not finite or 1e9 m or more; the message names the file.
        ImportError: trimesh lacks a package that the format needs.
    """
    file = Path(path)
    length, placed = metres(unit), axes or Axes()
    require_file(file)
    held = _read(file)
    vertices, all_faces = held.vertices, held.faces
    if len(all_faces) == 0:
        raise ValueError(f"{file}: holds no triangles")
    with np.errstate(over="ignore"):
        all_vertices = vertices * length
    bad = np.flatnonzero(~(np.abs(all_vertices) < FARTHEST).all(axis=1))
    if bad.size:
        raise ValueError(
            f"{file}: vertex {bad[0]} is {all_vertices[bad[0]]} m, expected finite coordinates below {FARTHEST:g} m"
        )
    all_vertices = placed.to_body(all_vertices, 1.0)
    used = np.isin(np.arange(len(all_vertices)), all_faces)
    all_vertices = np.where(used[:, None], all_vertices, all_vertices[np.argmax(used)])
    try:
        flat = zero_area_faces(all_vertices, all_faces)
        body = Body(Mesh(all_vertices, all_faces), held.part, held.part_names, held.material, held.material_names)
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error
    if flat.size:
        shown = ", ".join(str(f) for f in flat[:10]) + (", ..." if flat.size > 10 else "")
        warnings.warn(f"{file}: {flat.size} faces have zero area and are never hit: {shown}", stacklevel=2)
    return body


def split_bodies(body: Body) -> Body:
    """The same mesh with one part for each body: faces that hang together by shared or coincident vertices.

    For files that do not name their parts, as STL. Bodies are called `body_0`, `body_1`, ... in the order of their
    first faces.
    """
    vertices, faces = np.asarray(body.mesh.vertices), np.asarray(body.mesh.faces)
    same = np.unique(vertices, axis=0, return_inverse=True)[1].reshape(-1)[faces]
    start, stop = same.ravel(), np.roll(same, 1, axis=1).ravel()
    count = int(same.max()) + 1
    of_vertex = connected_components(coo_array((np.ones(start.size), (start, stop)), shape=(count, count)))[1]
    first, part = np.unique(of_vertex[same[:, 0]], return_index=True, return_inverse=True)[1:]
    rank = np.argsort(np.argsort(first))
    names = tuple(f"body_{i}" for i in range(first.size))
    return body._replace(part=rank[part.reshape(-1)].astype(np.int32), part_names=names)


def _read(file: Path) -> FileMesh:
    """What the file holds, by the ending of its name."""
    ending = file.suffix.lower()
    if ending in _READERS:
        return _READERS[ending](file)
    if ending == ".glb":
        _require_whole_glb(file)
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            return _by_trimesh(file)
    except ImportError as error:
        raise ImportError(f'{file}: reading it needs more packages ({error}): pip install "trimesh[easy]"') from error
    except Exception as error:  # trimesh's readers raise whatever their parsers do
        if isinstance(error, ValueError) and str(error).startswith(f"{file}: "):
            raise
        raise ValueError(f"{file}: not readable as a mesh ({type(error).__name__}: {error})") from error


def _by_trimesh(file: Path) -> FileMesh:
    """Every object in the file's order, wherever it is placed; one placed as its mirror image is turned around."""
    loaded = trimesh.load_scene(str(file), process=False)
    vertices, faces = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)]
    names: list[str] = []
    materials: list[str] = []
    offset = 0
    held = {name: place for place, name in enumerate(loaded.geometry)}
    places = [node for node in _walked(loaded.graph, file) if loaded.graph[node][1] is not None]
    for node in sorted(places, key=lambda node: held[loaded.graph[node][1]]):
        transform, name = loaded.graph[node]
        geometry = loaded.geometry[name]
        if not isinstance(geometry, trimesh.Trimesh) or len(geometry.faces) == 0:
            continue
        points = np.asarray(geometry.vertices, np.float64)
        corners = np.asarray(geometry.faces, np.int64)
        require_corners(corners, len(points), lambda face: f"{file}: face {face}")
        if np.linalg.det(transform[:3, :3]) < 0:
            corners = corners[:, ::-1]
        vertices.append(points @ transform[:3, :3].T + transform[:3, 3])
        faces.append(corners + offset)
        names += [str(name)] * len(corners)
        materials += [str(getattr(getattr(geometry.visual, "material", None), "name", None) or "")] * len(corners)
        offset += len(points)
    kinds = indices(materials) if any(materials) else ()
    return FileMesh(np.concatenate(vertices), np.concatenate(faces), *indices(names), *kinds)


def _walked(graph: Any, file: Path) -> Iterator[Any]:
    """Nodes of a scene, each before those it carries, in the file's order."""
    last_first = file.suffix.lower() in (".glb", ".gltf")  # so trimesh lists what a node of theirs carries
    left = [graph.base_frame]
    while left:
        node = left.pop()
        yield node
        carried = graph.transforms.children.get(node, [])
        left += carried if last_first else reversed(carried)


def _require_whole_glb(file: Path) -> None:
    """Raise `ValueError` for a GLB file that is cut, or whose chunks do not fill it."""
    size = file.stat().st_size
    with file.open("rb") as stream:
        head = stream.read(12)
        said = int.from_bytes(head[8:], "little")
        if head[:4] != b"glTF":
            raise ValueError(f"{file}: not readable as a mesh (got {head[:4]!r} at its start, expected glTF)")
        if said != size:
            raise ValueError(f"{file}: got {size} bytes, expected {said} as its header says: cut or damaged")
        place = 12
        while place < size:
            chunk = stream.read(8)
            place += 8 + int.from_bytes(chunk[:4], "little")
            if len(chunk) < 8 or place > size:
                raise ValueError(f"{file}: got {size} bytes, expected at least {place} as its chunks say: it is cut")
            stream.seek(place)
        stream.seek(12)
        length = int.from_bytes(stream.read(8)[:4], "little")
        told = stream.read(length)
    for accessor in _accessors(told):
        if "bufferView" not in accessor and not 0 <= accessor["count"] <= size:
            raise ValueError(f"{file}: got {accessor['count']} numbers without bytes, expected at most {size}")


def _accessors(told: bytes) -> list[dict[str, Any]]:
    """What the JSON chunk of a GLB file says of its arrays; nothing where it says nothing that trimesh could read."""
    try:
        held = json.loads(told).get("accessors", [])
        return [{**accessor, "count": int(accessor["count"])} for accessor in held]
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError):
        return []


def zero_area_faces(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Indices of faces whose area is below double rounding of their longest edge squared.

    Raises:
        ValueError: all faces are.
    """
    p = vertices[faces]
    edge = p[:, [1, 2, 0]] - p
    area = np.linalg.norm(np.cross(edge[:, 0], edge[:, 1]), axis=1)
    flat = np.flatnonzero(area <= 1e-14 * (edge**2).sum(axis=2).max(axis=1))
    if flat.size == len(faces):
        raise ValueError(f"all {flat.size} faces have zero area")
    return flat
