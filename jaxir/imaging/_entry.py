"""What is looked at before anything is computed, beyond the ranges of each field."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from jaxir._arrays import Check, is_traced
from jaxir._fields import require_part
from jaxir._plausible import doubt
from jaxir._programs import program
from jaxir.geometry import Camera
from jaxir.scene import Scene
from jaxir.transport import Method

PATH = 0.1  # of the distance of an eye by which the path through the air may differ from it as a rule
FEW = 64  # vertices that are looked at first
MEET = 8  # rays through the rectangle about a target, of fewer of which none may meet it


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


def miss_doubts(scene: Scene, camera: Camera, samples: int) -> list[Check]:
    """So many rays a pixel are enough for some to meet a target that is small in one.

    Else an image of nothing tells an error of 0. Plumes are looked for where the skin alone is too small.
    """
    if camera.grading is not None or is_traced((scene, camera)):
        return []
    rays = 0.0
    for points in _more_and_more(scene):
        rays = samples * _pixels(camera, points)
        if rays >= MEET:
            return []
    needed = MEET * samples / max(rays, np.finfo(float).tiny)
    expected = f"at least {needed:.2g} rays in pixels of which the target fills {rays / samples:.1g}, or rtol"
    return [doubt("samples", lambda _: rays == 0, expected, samples)]


def _more_and_more(scene: Scene) -> Iterator[Any]:
    """Points of a scene: few vertices, which are mostly enough, all of them, and those of plumes, too."""
    if scene.skin is not None:
        vertices = np.asarray(scene.skin.mesh.vertices)
        yield vertices[:: -(-len(vertices) // FEW)]
        yield vertices
    if scene.plumes:
        yield _extent(scene)


@program
def _extent(scene: Scene) -> Any:
    return scene.extent()


def _pixels(camera: Camera, points: Any) -> float:
    """Pixels of a camera that the rectangle about points fills; 0 of a point, a line or what lies behind."""
    target, frame, near, pixel = map(np.asarray, (camera.target, camera.frame, camera.inverse_range, camera.pixel))
    local = (np.asarray(points, np.float64) - target) @ frame.astype(np.float64).T
    screen = local[:, :2] / (1 - local[:, 2:] * near)
    return float(np.prod(np.ptp(screen, axis=0) / pixel))
