"""Which intensity a scene shows: at the sensor or at the target, in contrast to the background or alone.

`render` and `signature` give what a sensor sees: radiance through the air, and intensity in contrast to the empty
image. They give the other quantities of the scenes made here:

    apparent   scene                     sum (L - L_empty) area at the sensor, through the air
    contrast   at_target(scene)          the same without air
    source     alone(at_target(scene))   sum L area of skin and plume alone, without air and background

The three agree where there is neither air nor background. The apparent intensity is the contrast times the
transmittance, node by node; the source exceeds the contrast by the background's radiance times the area that skin and
plume hide of it.
"""

from __future__ import annotations

from jaxir.scene.scene import Scene
from jaxir.transport.reflection import Reflection, reflection_of


def at_target(scene: Scene) -> Scene:
    """The scene without the air between it and the sensor."""
    return Scene(scene.skin, scene.plume, scene.sources, scene.background)


def alone(scene: Scene, reflection: Reflection | None = None) -> Scene:
    """The scene before nothing: its background still lights the skin, as `reflection` has it, but is not seen.

    Args:
        scene: the scene.
        reflection: what `render` or `signature` will be called with.

    Returns:
        The scene; its background, if it lights the skin at all, is among the sources.
    """
    if scene.background is None or reflection_of(scene, reflection) is None:
        return Scene(scene.skin, scene.plume, scene.sources, None, scene.atmosphere)
    return Scene(scene.skin, scene.plume, (*scene.sources, scene.background), None, scene.atmosphere)
