"""What a lit plate shows, in closed form."""

import numpy as np

import jaxir
from jaxir.optics.spectrum import gray_nodes


def plate_intensity(emissivity, temperature, lamp, views, band):
    """Intensity of the square of `tests.scenes.plate` before a disc parallel to it [view, 1] [W sr-1].

    The form factor from a point to a disc parallel to its plane is (1 - (h^2 + a^2 - r^2) / s) / 2, where
    s^2 = (h^2 + a^2 + r^2)^2 - 4 r^2 a^2, for a point h before the disc and a beside its axis.
    """
    place, weight = np.polynomial.legendre.leggauss(40)
    height, y, z = np.asarray(lamp.centre, float)
    h2, r2 = height**2, float(lamp.radius) ** 2
    a2 = (place[:, None] / 2 - y) ** 2 + (place[None, :] / 2 - z) ** 2
    factor = (1 - (h2 + a2 - r2) / np.sqrt((h2 + a2 + r2) ** 2 - 4 * r2 * a2)) / 2
    reflected = (1 - emissivity) * (weight @ factor @ weight / 4) * np.asarray(lamp.radiance)
    radiance = emissivity * np.asarray(jaxir.band_radiance(np.float32(temperature), gray_nodes((band,)))) + reflected
    return np.cos(np.deg2rad(views)).prod(axis=1)[:, None] * radiance
