"""A line-by-line truth that needs no database: the nu3 bands of CO2 from published constants."""

import functools

import numpy as np
import pytest

C2 = 1.4387768775
LOSCHMIDT = 2.686780111e19  # cm-3 atm-1 at 273 K


@functools.cache
def nu3_lines(temperature, strongest=1e-10):
    """Wavenumber, strength [cm / molecule], lower energy [cm-1] of 12C16O2 lines between v3 and v3 + 1."""
    w1, w2, w3 = 1388.2, 667.4, 2349.02
    rotational, a1, a2, a3, distortion = 0.391635, 0.00124, -0.00072, 0.0030875, 1.333e-7
    partition = 1 / np.prod([1 - np.exp(-C2 * w / temperature) for w in (w1, w2, w2, w3)])
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
                strength = 9.98e-17 * (v3 + 1) * population / (partition * temperature) * honl_london
                strength = strength * -np.expm1(-C2 * nu / temperature)
                lines.append(np.stack([nu, strength, energy + term])[:, upper >= angular])
    table = np.concatenate(lines, axis=1)
    return table[:, table[1] > strongest * table[1].max()]


@pytest.fixture(scope="session")
def co2_lines():
    """(temperature, partial pressure [atm], Lorentz half-width [cm-1]) -> wavenumber, absorption [m-1].

    All lines have the same width, so the spectrum is one convolution with a Voigt profile.
    """

    @functools.cache
    def absorption(temperature, partial, width, low=1900.0, high=2500.0, step=0.004):
        wavenumber, strength, _ = nu3_lines(temperature)
        count = int(round((high - low) / step))
        place = (wavenumber - low) / step
        first = np.floor(place).astype(int)
        inside = (first >= 0) & (first < count - 1)
        first, share, strength = first[inside], (place - first)[inside], strength[inside]
        sticks = np.bincount(first, strength * (1 - share), count) + np.bincount(first + 1, strength * share, count)
        time = 2 * np.pi * np.fft.rfftfreq(2 * count, step)
        gauss = 3.581163e-7 * 2325 * np.sqrt(temperature / 44.01) / np.sqrt(2 * np.log(2))
        profile = np.exp(-width * time - (gauss * time) ** 2 / 2)
        spectrum = np.maximum(np.fft.irfft(np.fft.rfft(sticks, 2 * count) * profile)[:count] / step, 0)
        return low + step * np.arange(count), 100 * LOSCHMIDT * partial * 273 / temperature * spectrum

    return absorption
