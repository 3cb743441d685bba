"""A line-by-line truth that needs no database: the nu3 bands of 12C16O2 around 4.3 um from published constants.

Term values to second order in the vibrational quanta, Hoenl-London factors of parallel bands, strengths that grow with
v3 + 1, populations of harmonic oscillators; the means over 20 cm-1 lie within 1-5 % of HITRAN at 2380-2400 cm-1 and
within 7 % of CDSD-HITEMP.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxir import StandardAtmosphere
from jaxir.io.spectra import Spectra
from jaxir.optics.air import altitude_along
from jaxir.optics.gas import BOLTZMANN
from jaxir.optics.spectrum import FIRST_RADIATION
from jaxir.optics.spectrum import SECOND_RADIATION as C2

STEP = 0.004  # cm-1
GRID = 1900 + STEP * np.arange(150000)
"""Wavenumbers of all spectra [cm-1]."""
ATMOSPHERE = 101325.0  # Pa
FREQUENCIES = (1388.2, 667.4, 667.4, 2349.02)  # of the modes, the bend twice [cm-1]
WIDTH = 0.07  # Lorentz half-width at 273 K and 1 atm of any mixture, falls with sqrt(T) [cm-1]
GROUND_STRENGTH = 9.98e-17  # sum of the ground state's lines at the temperature of the list [cm / molecule]


class Lines(NamedTuple):
    """Lines between v3 and v3 + 1, each an array [line].

    Attributes:
        wavenumber: [cm-1].
        strength: [cm / molecule].
        energy: of the lower state [cm-1].
        quanta: v1, v2, l, v3, J of the lower state and the change of J [6, line].
    """

    wavenumber: np.ndarray
    strength: np.ndarray
    energy: np.ndarray
    quanta: np.ndarray


def partition(temperature: float) -> float:
    """Vibrational partition function of harmonic oscillators."""
    return float(1 / np.prod([1 - np.exp(-C2 * w / temperature) for w in FREQUENCIES]))


@functools.cache
def nu3_lines(temperature: float, faintest: float = 1e-10) -> Lines:
    """Lines at a temperature [K], those below `faintest` times the strongest left out."""
    rotational, a1, a2, a3, distortion = 0.391635, 0.00124, -0.00072, 0.0030875, 1.333e-7
    w1, w2, _, w3 = FREQUENCIES
    lines = []
    levels = ((v1, v2, v3) for v3 in range(7) for v1 in range(9) for v2 in range(18))
    for v1, v2, v3 in levels:
        energy = w1 * v1 + w2 * v2 + w3 * v3
        if energy > 12 * temperature + 500:
            continue
        centre = 2396.49 - 12.63 * (2 * v3 + 2) - 19.37 * (v1 + 0.5) - 12.53 * (v2 + 1)
        low = rotational - a1 * v1 - a2 * v2 - a3 * v3
        for angular in range(v2 % 2, v2 + 1, 2):
            j = np.arange(v3 % 2, 200, 2.0) if angular == 0 else np.arange(angular, 200.0)
            term = low * j * (j + 1) - distortion * (j * (j + 1)) ** 2
            population = (2 * j + 1) * np.exp(-C2 * (energy + term) / temperature) * 2 * C2 * low
            for step in (-1, 1):
                upper = j + step
                larger = np.maximum(j, upper)
                honl_london = (larger**2 - angular**2) / np.maximum(larger, 1) / (2 * j + 1)
                nu = centre + (low - a3) * upper * (upper + 1) - distortion * (upper * (upper + 1)) ** 2 - term
                strength = GROUND_STRENGTH * (v3 + 1) * population / (partition(temperature) * temperature)
                strength = strength * honl_london * -np.expm1(-C2 * nu / temperature)
                states = [np.full_like(j, n) for n in (v1, v2, angular, v3)]
                rows = [nu, strength, energy + term, *states, j, np.full_like(j, step)]
                lines.append(np.stack(rows)[:, upper >= angular])
    table = np.concatenate(lines, axis=1)
    table = table[:, table[1] > faintest * table[1].max()]
    return Lines(table[0], table[1], table[2], table[3:].astype(int))


@functools.cache
def spectrum(temperature: float, width: float) -> tuple[np.ndarray, np.ndarray]:
    """`GRID` and the cross-section on it [sample] [m2] at a temperature [K] and a Lorentz half-width [cm-1].

    All lines have one width, so the spectrum is one convolution with a Voigt profile.
    """
    lines, count = nu3_lines(temperature), GRID.size
    place = (lines.wavenumber - GRID[0]) / STEP
    first = np.floor(place).astype(int)
    inside = (first >= 0) & (first < count - 1)
    first, share, strength = first[inside], (place - first)[inside], lines.strength[inside]
    sticks = np.bincount(first, strength * (1 - share), count) + np.bincount(first + 1, strength * share, count)
    time = 2 * np.pi * np.fft.rfftfreq(2 * count, STEP)
    gauss = 3.581163e-7 * 2325 * np.sqrt(temperature / 44.01) / np.sqrt(2 * np.log(2))
    profile = np.exp(-width * time - (gauss * time) ** 2 / 2)
    smooth = np.maximum(np.fft.irfft(np.fft.rfft(sticks, 2 * count) * profile)[:count] / STEP, 0)
    return GRID, 1e-4 * smooth


def half_width(temperature: float, pressure: float) -> float:
    """Lorentz half-width [cm-1] at a temperature [K] and a pressure [Pa]."""
    return WIDTH * pressure / ATMOSPHERE * (273 / temperature) ** 0.5


def cross_section(temperature: float, pressure: float, mole_fraction: float = 0.0) -> np.ndarray:
    """On `GRID` [sample] [m2]; temperatures are rounded to 0.1 K. Own and foreign broadening are equal here."""
    rounded = round(float(temperature), 1)
    return spectrum(rounded, round(half_width(rounded, float(pressure)), 5))[1]


SPECTRA = Spectra(GRID, {"CO2": cross_section}, "nu3 bands of CO2 from published constants")


def absorption(temperature: float, pressure: float, mole_fraction: float) -> np.ndarray:
    """Absorption coefficient on `GRID` [sample] [m-1]."""
    return cross_section(temperature, pressure) * mole_fraction * pressure / (BOLTZMANN * temperature)


def air_depth(air: StandardAtmosphere, mole_fraction: float, segments: int = 24) -> np.ndarray:
    """Optical depth of the CO2 along a path on `GRID` [sample]."""
    edge = np.linspace(0, 1, segments + 1) ** 2
    middle = jnp.asarray((edge[1:] + edge[:-1]) / 2, jnp.result_type(float))
    state = air.profile.at(altitude_along(air.sensor_altitude, air.target_altitude, air.distance, middle))
    pieces = zip(np.asarray(state.temperature, float), np.asarray(state.pressure, float), np.diff(edge), strict=True)
    return float(air.distance) * sum(share * absorption(t, p, mole_fraction) for t, p, share in pieces)


def planck(temperature: float) -> np.ndarray:
    """Spectral radiance of a blackbody on `GRID` [sample] [W m-2 sr-1 / cm-1]."""
    return FIRST_RADIATION * GRID**3 / np.expm1(C2 * GRID / temperature)


def radiance(layers: Sequence[tuple[float, float, float, float]], depth_in_front: np.ndarray | float) -> np.ndarray:
    """Spectral radiance on `GRID` [sample] [W m-2 sr-1 / cm-1] of layers behind absorbing air, from the eye on.

    Args:
        layers: temperature [K], pressure [Pa], mole fraction, thickness [m] of each.
        depth_in_front: optical depth of the air.
    """
    seen, total = np.exp(-np.broadcast_to(depth_in_front, GRID.shape)), np.zeros(GRID.shape)
    for temperature, pressure, amount, thickness in layers:
        depth = thickness * absorption(temperature, pressure, amount)
        total += seen * -np.expm1(-depth) * planck(temperature)
        seen = seen * np.exp(-depth)
    return total
