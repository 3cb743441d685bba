"""Which intensity is meant, of which scene, and under what conditions."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax

from jaxir._version import __version__
from jaxir.io.result import Conditions
from jaxir.io.scene_file import SceneFile, load_scene
from jaxir.quantity import alone, at_target
from jaxir.scene import Scene

QUANTITIES = {
    "apparent": "at the sensor, through the air, in contrast to the background",
    "contrast": "at the target, without air, in contrast to the background",
    "source": "of skin and plume alone, at the target, without air and background",
}


def scene_of(read: SceneFile, quantity: str) -> Scene:
    """The scene whose contrast through the air is the quantity."""
    if quantity == "apparent":
        return read.scene
    scene = at_target(read.scene)
    return scene if quantity == "contrast" else alone(scene)


def quantities_of(arguments: argparse.Namespace) -> dict[str, str]:
    """The quantities asked for, each with what it adds to a file's name."""
    asked = list(dict.fromkeys(arguments.quantity or ["apparent"]))
    return {quantity: f"_{quantity}" if len(asked) > 1 else "" for quantity in asked}


def conditions_of(read: SceneFile, quantity: str, began: float, **more: str | int | float) -> Conditions:
    return {
        "scene": read.file.name,
        "quantity": f"{quantity}: {QUANTITIES[quantity]}",
        **more,
        "jaxir": __version__,
        "jax": jax.__version__,
        "seconds": round(time.perf_counter() - began, 3),
    }


def named(path: Path, *parts: str) -> Path:
    """The path with parts added to its name in front of the ending."""
    return path.with_name(path.stem + "".join(parts) + path.suffix)


def read_scene(path: Path) -> SceneFile:
    read = load_scene(path)
    for note in read.notes:
        print(note)
    return read


def naming(read: SceneFile, compute: Callable[[], Any]) -> Any:
    """What `compute` returns; its errors name the file, once."""
    try:
        return compute()
    except (ValueError, RuntimeError) as error:
        said = str(error).replace(f"{read.file}: ", "")
        raise ValueError(f"{read.file}: {said}") from error
