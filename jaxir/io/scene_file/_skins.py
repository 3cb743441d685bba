"""The skin of a scene file: a mesh, what its faces are made of and how hot they are, part by part."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxir.geometry.search import Mesh
from jaxir.geometry.selection import Intersection, new_part
from jaxir.io.field import load_face_values, load_surface_field
from jaxir.io.mesh import Axes, Body, load_mesh, split_bodies, zero_area_faces
from jaxir.io.scene_file._entries import (
    Entry,
    Reader,
    build,
    construct,
    existing_file,
    integer,
    numbers,
    one_of,
    text,
)
from jaxir.optics.surface import AbstractBrdf, joined_brdf
from jaxir.scene import Skin


def read_skin(entry: Entry, readers: Mapping[str, Reader]) -> tuple[Skin, tuple[str, ...]]:
    """The table `skin`.

    `temperature` and `brdf` hold for all faces, and `[[skin.parts]]`, in order, replace them: for the part that the
    mesh file calls by the given `name`, or, with `faces`, for a new part of that name. Faces are indices, or what one
    selection holds, or what every one of several does, see `jaxir.geometry.selection`.

    Args:
        entry: the table.
        readers: of parameters by name, that of `brdf` among them.

    Returns:
        The skin, and what transferring computed surfaces did to them, and which parts take faces of others.

    Raises:
        ValueError: a key or value that does not fit, a part that the mesh has not, or that is left without faces, faces
            without a temperature or brdf; names file and key.
    """
    keys = entry.only(["mesh", "temperature", "brdf", "parts"], ["mesh"])
    body = _body(keys["mesh"], readers)
    everywhere = Entry(entry.file, entry.key, {k: v for k, v in entry.value.items() if k in ("temperature", "brdf")})
    temperature = np.full(body.mesh.count, np.nan)
    kind = np.full(body.mesh.count, -1)
    brdfs: list[AbstractBrdf] = []
    notes: list[str] = []
    changes = keys["parts"].items() if "parts" in keys else []
    changed: list[Entry] = []
    for change in [everywhere, *changes]:
        faces, given = np.arange(body.mesh.count), change.children()
        if change is not everywhere:
            before, (faces, body) = body, _faces(change, body, readers)
            notes += _taken(change, faces, before, changed)
            changed.append(change)
        if "temperature" in given:
            temperature[faces] = face_temperature(given["temperature"], body.mesh, faces, readers, notes)
        if "brdf" in given:
            brdf = readers["brdf"](given["brdf"])
            if brdf.shape()[0] not in (1, faces.size if change is everywhere else 1):
                raise given["brdf"].wrong(f"parameters of one face{' or all' if change is everywhere else ''}")
            kind[faces] = len(brdfs)
            brdfs.append(brdf)
    for what, missing in (("temperature", np.isnan(temperature)), ("brdf", kind < 0)):
        if missing.any():
            face = int(np.argmax(missing))
            part = body.part_names[body.part[face]]
            raise ValueError(f"{entry.file}: {entry.key}: got no {what} for face {face}, of part {part!r}")
    try:
        skin = Skin(body.mesh, temperature, joined_brdf(brdfs, kind), body.part, body.part_names)
    except ValueError as error:
        raise entry.failed(error) from error
    return skin, tuple(notes)


def _body(entry: Entry, readers: Mapping[str, Reader]) -> Body:
    def bodies(path: Path, *, unit: Any, axes: Axes | None = None) -> Body:
        return split_bodies(load_mesh(path, unit=unit, axes=axes))

    def inline(vertices: Any, faces: Any) -> Body:
        mesh = Mesh(vertices, faces)
        zero_area_faces(np.asarray(vertices, np.float64), faces)
        return Body(mesh, np.zeros(mesh.count, np.int32), ("skin",))

    kinds: dict[str, Callable] = {"load_mesh": load_mesh, "split_bodies": bodies, "Mesh": inline}
    return build(entry, kinds, {**readers, "faces": _indices}, default="load_mesh")


def _faces(change: Entry, body: Body, readers: Mapping[str, Reader]) -> tuple[np.ndarray, Body]:
    """The faces that an entry of `parts` is about, and the body with them as a part if it is a new one."""
    keys = change.only(["name", "faces", "temperature", "brdf"], ["name"])
    name = text(keys["name"])
    names = body.part_names
    if "faces" not in keys:
        if name not in names:
            one_of(names)(keys["name"])
        return np.flatnonzero(body.part == names.index(name)), body
    if name in names:
        raise keys["name"].wrong(f"a new name for the faces; {', '.join(names)} are taken")
    faces = _face_list(keys["faces"], body, readers)
    return faces, body._replace(**new_part(name, faces, body.part, names))


def _taken(change: Entry, faces: np.ndarray, body: Body, before: list[Entry]) -> list[str]:
    """What an entry takes of the parts that entries before it changed, of the body that these left.

    Raises:
        ValueError: it leaves such a part no face, or changes again what one of them did.
    """
    given, notes = change.children(), []
    for earlier in before:
        key, its = earlier.key, earlier.children()
        name = its["name"].value
        if "faces" not in given and given["name"].value == name:
            if twice := {"temperature", "brdf"} & set(its) & set(given):
                raise given["name"].wrong(f"another part: {key} has its {' and '.join(sorted(twice))}")
            continue
        part = body.part == body.part_names.index(name)
        taken, whole = int(part[faces].sum()), int(part.sum())
        if taken == whole:
            raise given["faces"].wrong(f"faces that leave some to part {name!r} of {key}")
        if taken:
            notes.append(f"{change.key}: takes {taken} of the {whole} faces of part {name!r} of {key}")
    return notes


def _indices(entry: Entry) -> np.ndarray:
    """Integers that may be indices."""
    value = np.asarray(numbers(entry))
    if not ((value == np.floor(value)) & (value >= 0) & (value < 2**31)).all():
        raise entry.wrong("integers >= 0 of 32 bits")
    return value.astype(np.int64)


def _face_list(entry: Entry, body: Body, readers: Mapping[str, Reader]) -> np.ndarray:
    """Indices of faces: a list, `{ start, stop }` with stop one past the last, or what one or all selections hold."""
    value, count = entry.value, body.part.size
    tables = isinstance(value, list) and value != [] and all(isinstance(one, dict) for one in value)
    if tables or isinstance(value, dict) and "type" in value:
        held = readers["of"](entry)
        try:
            return body.select(Intersection(held) if tables else held)
        except ValueError as error:
            raise entry.failed(error) from error
    if isinstance(value, dict) and "path" not in value:
        ends = entry.only(["start", "stop"], ["start", "stop"])
        faces = np.arange(integer(ends["start"]), min(integer(ends["stop"]), count + 1))
    else:
        faces = np.atleast_1d(_indices(entry))
    if faces.ndim != 1 or faces.size == 0 or faces.min() < 0 or faces.max() >= count:
        raise entry.wrong(f"faces 0 to {count - 1}, at least one")
    if np.unique(faces).size < faces.size:
        raise entry.wrong("every face once")
    return faces


def face_temperature(
    entry: Entry, mesh: Mesh, faces: np.ndarray, readers: Mapping[str, Reader], notes: list[str]
) -> np.ndarray:
    """Temperatures of some faces [face]: a number, a list, a file with a value per face, or a computed surface.

    What transferring a surface did is added to the notes.
    """
    if isinstance(entry.value, dict) and "path" in entry.value:
        if existing_file(entry.children()["path"]).suffix.lower() in (".csv", ".npz", ".npy", ".txt", ".dat"):
            value = construct(entry, load_face_values, {**readers, "column": text}, count=faces.size)
        else:
            found = construct(entry, load_surface_field, {**readers, "field": text}, mesh=mesh)
            notes.append(f"{entry.key}: {found.describe()}")
            value = found.value[faces]
        if not (coldest := float(np.min(value))) > 0:
            raise entry.failed(ValueError(f"got {coldest:g}, expected temperatures > 0 K (are they in Celsius?)"))
        return value
    value = np.asarray(numbers(entry))
    if value.shape not in ((), (faces.size,)):
        raise entry.wrong(f"one number or {faces.size}, one per face")
    if not (value > 0).all():
        raise entry.wrong("temperatures > 0 K")
    return np.broadcast_to(value, faces.shape)
