"""A gray slab before one pixel: the smallest scene with something to fit."""

import numpy as np

import jaxir
from jaxir.fit import Factor, measured_image
from jaxir.optics.spectrum import gray_nodes
from tests.scenes import gray_box

PIXEL = jaxir.orthographic_camera(0.0, 0.0, 0.1, (1, 1))
TEMPERATURE = Factor("temperature", lambda s: s.plume.temperature)
DEPTH = Factor("depth", lambda s: s.plume.gas.coefficient)


def slab(temperature, depth):
    return jaxir.Scene(plumes=gray_box((1.0, 1.0, 1.0), depth, (1, 1, 1), temperature))


def looked_at(scene, bands, relative=0.01):
    """The radiance of a slab in closed form."""
    camera = jaxir.orthographic_camera(0.0, 0.0, 0.1, (1, 1))  # in the precision of the test
    black = np.asarray(jaxir.band_radiance(scene.plume.temperature.reshape(1), gray_nodes(bands)))
    radiance = -np.expm1(-np.asarray(scene.plume.gas.coefficient).reshape(-1)) * black.reshape(1, 1, -1)
    return measured_image(camera, bands, radiance, relative * radiance)
