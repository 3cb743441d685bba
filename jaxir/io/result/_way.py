"""How light was found, kept beside the views of a sweep, so that it goes on in the same way."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

from jaxir.geometry import Independent, Lattice, Sobol, Stratified
from jaxir.io._files import read_json, written_whole
from jaxir.transport import ClosedForm, DirectSampling, DiscreteOrdinates, Method

WAY = "method.json"
_KINDS = (Method, DirectSampling, ClosedForm, DiscreteOrdinates, Independent, Lattice, Sobol, Stratified)
_BY_NAME: dict[str, Any] = {kind.__name__: kind for kind in _KINDS}


def write_way(folder: Path, method: Method) -> None:
    """Keep a method of `jaxir.plan` in a folder: one without arrays."""
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


def _table(part: Any) -> Any:
    if not dataclasses.is_dataclass(part):
        return part
    own = {field.name: _table(getattr(part, field.name)) for field in dataclasses.fields(part)}
    return {"type": type(part).__name__, **own}


def _part(table: Any) -> Any:
    if not isinstance(table, dict):
        return table
    return _BY_NAME[table["type"]](**{name: _part(value) for name, value in table.items() if name != "type"})
