"""What is looked at before anything is computed, beyond the ranges of each field."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxir._arrays import Check
from jaxir._fields import require_part
from jaxir._plausible import doubt
from jaxir.geometry import Camera
from jaxir.scene import Scene
from jaxir.transport import Method

PATH = 0.1  # of the distance of an eye by which the path through the air may differ from it as a rule


def require_parts(scene: Any, method: Any) -> None:
    """`ValueError` unless they are what they are called."""
    require_part("scene", scene, Scene, "a scene, e.g. jaxir.Scene(skin)")
    require_part("method", method, Method, "a method, e.g. jaxir.Method(bounces=2)")


def require_camera(camera: Any) -> None:
    """`ValueError` unless it is one."""
    require_part("camera", camera, Camera, "a camera, e.g. of jaxir.perspective_camera")


def path_doubts(scene: Scene, inverse_range: Any) -> list[Check]:
    """The path through the air is about as long as the way to an eye at so many metres."""
    distance = getattr(scene.atmosphere, "distance", None)
    if distance is None:
        return []
    name = f"{type(scene.atmosphere).__name__}.distance"
    expected = "about the distance of the eye from its target"
    return [doubt(name, lambda d, near: (near == 0) | (np.abs(d * near - 1) < PATH), expected, distance, inverse_range)]
