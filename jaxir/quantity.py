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

from jaxir.scene import Scene


def at_target(scene: Scene) -> Scene:
    """The scene without the air between it and the sensor."""
    return Scene(scene.skin, scene.plumes, scene.sources, scene.background)


def alone(scene: Scene) -> Scene:
    """The scene before nothing: its background lights what it lights, but is not seen."""
    hidden = () if scene.background is None else (scene.background,)
    return Scene(scene.skin, scene.plumes, (*scene.sources, *hidden), None, scene.atmosphere)
