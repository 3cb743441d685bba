"""How light was found, and on which nodes, kept beside the views of a sweep, so that it goes on in the same way."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np

from jaxir._arrays import as_float
from jaxir.geometry import Independent, Lattice, Sobol, Stratified
from jaxir.io._array_files import load_arrays
from jaxir.io._files import read_json, written_whole
from jaxir.optics.spectrum import Nodes
from jaxir.transport import ClosedForm, DirectSampling, DiscreteOrdinates, Method, SkinLight

WAY = "method.json"
NODES = "nodes.npz"
_KINDS = (Method, DirectSampling, ClosedForm, DiscreteOrdinates, SkinLight, Independent, Lattice, Sobol, Stratified)
_BY_NAME: dict[str, Any] = {kind.__name__: kind for kind in _KINDS}


def write_way(folder: Path, method: Method) -> None:
    """Keep a method of `jaxir.plan` in a folder: one of whole numbers, and of single ones."""
    with written_whole(folder / WAY) as part:
        part.write_text(json.dumps(_table(method), indent=1))


def read_way(folder: Path) -> Method | None:
    """The method that was kept in a folder; None where none was.

    Raises:
        ValueError: the file is damaged.
    """
    file = folder / WAY
    if not file.is_file():
        return None
    table = read_json(file, "a method; use another folder")
    try:
        method = _part(table)
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"{file}: got a damaged file ({error}), expected a method; use another folder") from error
    if not isinstance(method, Method):
        raise ValueError(f"{file}: got {method!r}, expected a method; use another folder")
    return method


def write_nodes(folder: Path, nodes: Nodes) -> None:
    """Keep nodes in a folder."""
    every = {field.name: getattr(nodes, field.name) for field in dataclasses.fields(nodes)}
    arrays: dict[str, Any] = {name: np.asarray(value) for name, value in every.items() if value is not None}
    with written_whole(folder / NODES) as part, part.open("wb") as stream:
        np.savez(stream, **arrays)


def read_nodes(folder: Path) -> Nodes | None:
    """The nodes that were kept in a folder; None where none were.

    Raises:
        ValueError: the file is damaged.
    """
    file = folder / NODES
    if not file.is_file():
        return None
    try:
        held = load_arrays(file)
        names = tuple(str(name) for name in held.pop("names"))
        (count,), bands = held["weight"].shape, len(names)
        shapes = {"edge": (count, 2, 2), "g": (count, 2), "slot": (count, 2, 2), "response": (bands, count)}
        for name, value in held.items():
            if value.shape != shapes.get(name, (bands,) if name == "error" else (count,)):
                raise ValueError(f"{name} of shape {value.shape}")
        return Nodes(**{name: as_float(value) for name, value in held.items()}, names=names)
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{file}: got a damaged file ({error}), expected nodes; use another folder") from error


def _table(part: Any) -> Any:
    if not dataclasses.is_dataclass(part):
        return part if part is None or isinstance(part, int) else float(part)
    own = {field.name: _table(getattr(part, field.name)) for field in dataclasses.fields(part)}
    return {"type": type(part).__name__, **own}


def _part(table: Any) -> Any:
    if not isinstance(table, dict):
        return table
    return _BY_NAME[table["type"]](**{name: _part(value) for name, value in table.items() if name != "type"})
