"""A line-by-line truth that needs no database: the nu3 bands of 12C16O2 around 4.3 um from published constants.

Levels, mixing and transition moments are those of `studies.co2_levels`, which fits a polyad Hamiltonian to published
levels and lines; Hoenl-London factors of parallel bands; all carbon dioxide counts as 12C16O2. Its partition function
is that of TIPS to 0.2 % up to 2000 K and 0.6 % up to 2500 K.
"""

import functools
import math
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxir import StandardAtmosphere
from jaxir.io.spectra import Spectra
from jaxir.optics.air import altitude_along
from jaxir.optics.gas import BOLTZMANN
from jaxir.optics.spectrum import SECOND_RADIATION as C2
from jaxir.optics.spectrum import spectral_radiance_on_host
from studies import co2_levels as levels

STEP = 0.004  # cm-1
GRID = 1900 + STEP * np.arange(150000)
"""Wavenumbers of all spectra [cm-1]."""
ATMOSPHERE = 101325.0  # Pa
WIDTH = 0.07  # Lorentz half-width at 273 K and 1 atm of any mixture, falls with sqrt(T) [cm-1]
REACH = 500.0  # steps of temperature for which lines are looked up together [K]
UNIT = 400 * levels.CONSTANTS[33] / (8 * np.pi * levels.SPEED_OF_LIGHT * levels.NU3**2)  # A0 / (8 pi c nu3^2) [cm]
WEAKEST = 1e-3  # transitions between polyads whose squared moment is less than this share of (v3 + 1) are left out


class Lines(NamedTuple):
    """Lines between v3 and v3 + 1, each an array [line].

    Attributes:
        wavenumber: [cm-1].
        strength: [cm / molecule].
        energy: of the lower state [cm-1].
        quanta: v1, v2, l, v3, J of the lower state and the change of J [6, line]; HITRAN's v1 and v2 of its polyad.
    """

    wavenumber: np.ndarray
    strength: np.ndarray
    energy: np.ndarray
    quanta: np.ndarray


@functools.lru_cache(maxsize=2)
def nu3_lines(temperature: float, faintest: float = 1e-8) -> Lines:
    """Lines at a temperature [K], those below `faintest` times the strongest left out.

    The strength of a line is (Rothman et al., JQSRT 60, 1998, 665)

        S = A0 / (8 pi c nu3^2) m (nu / nu3) (2J + 1) H / Q exp(-c2 E / T) (1 - exp(-c2 nu / T)),

    with the squared moment m relative to the ground state's and the share H of the branch.
    """
    nu, weight, energy, quanta = _transitions(REACH * math.ceil(temperature / REACH), faintest)
    unit = UNIT / levels.NU3 / levels.partition(temperature)
    strength = unit * weight * np.exp(-C2 * energy / temperature) * -np.expm1(-C2 * nu / temperature)
    seen = (strength > 0.01 * faintest * UNIT) & (strength > faintest * strength.max())
    return Lines(nu[seen], strength[seen], energy[seen], quanta[:, seen].astype(int))


@functools.lru_cache(maxsize=4)
def _transitions(hottest: float, faintest: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Wavenumber [cm-1], m nu (2J + 1) H [cm-1], lower energy [cm-1] and quanta of lines seen up to `hottest` [K]."""
    found = []
    for (total, angular, v3), lower in levels.polyads().items():
        upper = levels.polyads().get((total, angular, v3 + 1))
        if upper is None:
            continue
        j = levels.rotations(angular, v3)
        moment = levels.moments(levels.CONSTANTS, lower, upper, v3)
        bright = np.exp(-C2 * lower.energy / hottest)[:, None] * moment > 1e-3 * faintest
        i, k = np.nonzero(bright & (moment > WEAKEST * (v3 + 1)) & (lower.energy < levels.HIGHEST)[:, None])
        energy = lower.energy[i, None] + levels.term(lower.rotational[i, None], j)
        for step in (-1, 0, 1) if angular else (-1, 1):
            up = j + step
            nu = upper.energy[k, None] + levels.term(upper.rotational[k, None], up) - energy
            weight = moment[i, k, None] * (2 * j + 1) * nu * levels.honl_london(angular, j, step)
            # Over the partition sum, which is 1 at least.
            kept = (weight * np.exp(-C2 * energy / hottest) > 0.01 * faintest * levels.NU3) & (up >= angular)
            states = ((total - angular) // 2, angular, angular, v3, j, step)
            quanta = [np.broadcast_to(n, nu.shape)[kept] for n in states]
            found.append((np.stack([nu[kept], weight[kept], energy[kept]]), np.stack(quanta).astype(np.int16)))
    table, quanta = (np.concatenate(parts, axis=1) for parts in zip(*found, strict=True))
    return *table, quanta


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
    return spectral_radiance_on_host(GRID, temperature)


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
