"""Thin emission of CO and NO from their constants: what else shines at 4.5-5.3 um.

    power of a line = n x p_v (2J + 1) exp(-c2 B J (J + 1) / T) / Q_rot  A_v H h c nu / (4 pi),
    A_v = v A_1 (nu_v / nu_1)^3

Anharmonic levels, harmonic moments, a rotor without spin: that of NO matters below the .01 um that spectra are binned
to.
"""

from typing import NamedTuple

import numpy as np

from jaxir.optics.gas import BOLTZMANN
from jaxir.optics.spectrum import SECOND_RADIATION as C2

HC = 6.62607015e-34 * 2.99792458e10  # J cm


class Diatomic(NamedTuple):
    """Constants of a molecule [cm-1] (Huber and Herzberg 1979), and its Einstein coefficient of 1-0 [1/s]."""

    w: float
    wx: float
    b: float
    a: float
    d: float
    einstein: float


CO = Diatomic(2169.8136, 13.2883, 1.931281, 0.017504, 6.1215e-6, 34.4)  # moment .1055 D
NO = Diatomic(1904.20, 14.075, 1.70427, 0.01728, 5.4e-7, 12.1)  # moment .0764 D


def thin_emission(molecule: Diatomic, temperature: float, highest: int = 13) -> tuple[np.ndarray, np.ndarray]:
    """Wavenumbers of lines [cm-1] and what a molecule emits in each [W / sr], both [line]."""
    v, j = np.arange(highest + 1), np.arange(150.0)
    energy = molecule.w * v - molecule.wx * v * (v + 1)
    populated = np.exp(-C2 * energy / temperature)
    populated, origin = populated / populated.sum(), np.diff(energy)
    found = []
    for upper in range(1, highest + 1):
        b1, b0 = (molecule.b - molecule.a * (n + 0.5) for n in (upper, upper - 1))
        rotating = (2 * j + 1) * np.exp(-C2 * b1 * j * (j + 1) / temperature)
        rotating /= rotating.sum()
        einstein = upper * molecule.einstein * (origin[upper - 1] / origin[0]) ** 3
        for step in (-1, 1):
            low = j + step
            terms = [b * k * (k + 1) - molecule.d * (k * (k + 1)) ** 2 for b, k in ((b1, j), (b0, low))]
            nu = origin[upper - 1] + terms[0] - terms[1]
            share = np.maximum(j, low) / (2 * j + 1)
            power = populated[upper] * rotating * einstein * share * HC * nu / (4 * np.pi)
            found.append(np.stack([nu, power])[:, low >= 0])
    return tuple(np.concatenate(found, axis=1))


def layer_emission(
    molecule: Diatomic, temperature: float, pressure: float, mole_fraction: float, thickness: float, edges: np.ndarray
) -> np.ndarray:
    """Radiance of a thin layer between wavenumbers `edges` [bin] [W m-2 sr-1]; K, Pa and m."""
    nu, power = thin_emission(molecule, temperature)
    column = mole_fraction * pressure / (BOLTZMANN * temperature) * thickness
    return column * np.histogram(nu, edges, weights=power)[0]
