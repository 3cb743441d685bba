"""The files that a scene is read from."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from jaxir.io.scene_file import read_toml


def inputs_of(file: Path) -> dict[str, Path]:
    """The scene file and every file that it names, by name as written there."""
    return {file.name: file} | {name: file.parent / name for name in _paths(read_toml(file).value)}


def _paths(value: Any) -> Iterator[str]:
    """Everything under a key `path` or `paths`, also where `over` names one with dots."""
    if isinstance(value, dict):
        for key, child in value.items():
            held = child if isinstance(child, list) else [child]
            if key.rsplit(".")[-1] in ("path", "paths"):
                yield from (one for one in held if isinstance(one, str))
            else:
                yield from _paths(child)
    elif isinstance(value, list):
        for child in value:
            yield from _paths(child)
