"""A gray slab before one pixel: the smallest scene with something to fit."""

import numpy as np

import jaxir
from jaxir.fit import Factor, measured_image
from tests.scenes import gray_box

PIXEL = jaxir.orthographic_camera(0.0, 0.0, 0.1, (1, 1))
TEMPERATURE = Factor("temperature", lambda s: s.plume.temperature)
DEPTH = Factor("depth", lambda s: s.plume.gas.coefficient)


def slab(temperature, depth):
    return jaxir.Scene(plumes=gray_box((1.0, 1.0, 1.0), depth, (1, 1, 1), temperature))


def looked_at(scene, bands, relative=0.01):
    camera = jaxir.orthographic_camera(0.0, 0.0, 0.1, (1, 1))  # in the precision of the test
    radiance = np.asarray(jaxir.render(scene, camera, bands, samples=2).radiance)
    return measured_image(camera, bands, radiance, relative * radiance)
