"""Optics of spheres by Mie's theory, on the host. Needs miepython: `pip install jaxir[mie]`.

miepython computes some fifty times faster with MIEPYTHON_USE_JIT=1 in the environment, after ten seconds of compiling.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from tqdm import tqdm

from jaxir._arrays import fingerprint
from jaxir._cache import keep, kept
from jaxir.optics.particle._tabulated import ParticleTable

ANGLES = 361  # of a phase function at least
FINER = 9  # sizes with cross-sections for each with a phase function; odd, so that that is the middle one
REACH = 4.0  # spreads from the sizes that weigh most as far as which they count
PER_SIZE = 6  # angles for each unit of the size parameter


def mie_table(
    diameter: float,
    index: Any,
    wavelength: Any = None,
    spread: float = 0.0,
    angles: int | None = None,
    sizes: int = 24,
    progress: bool = False,
) -> ParticleTable:
    """Cross-sections and phase functions of homogeneous spheres.

    Args:
        diameter: of every sphere, or the median by number of a lognormal distribution [um].
        index: refractive index n - ik, one number or one per wavelength [sample].
        wavelength: increasing, at least two [sample] [um]; without it 121 in equal ratios from 1 to 12.5 um.
        spread: standard deviation of ln diameter; 0 gives equal spheres, whose spectrum ripples.
        angles: samples of the scattering angle in equal steps; by default `ANGLES`, or six for each unit of the
            largest size parameter pi diameter / wavelength, whose diffraction peak is as wide as its inverse.
        sizes: even steps of ln diameter with a phase function of their own, each with `FINER` sizes for cross-sections:
            what absorbs little ripples with its size. The default errs by .1 % in cross-sections and .01 in mean
            cosines, up to a spread of .7.
        progress: show a bar.

    Returns:
        The table; its cross-sections and volume are means over the distribution. What was computed once is kept with
        the compiled programs.

    Raises:
        ImportError: miepython is not installed.
        ValueError: a diameter, spread, wavelength or index out of range.
    """
    try:
        import miepython
    except ImportError as error:
        raise ImportError("mie_table needs miepython: pip install 'jaxir[mie]'") from error
    given = np.geomspace(1.0, 12.5, 121) if wavelength is None else np.asarray(wavelength, np.float64)
    if given.ndim != 1 or given.size < 2 or not (np.all(np.diff(given) > 0) and given[0] > 0 and given[-1] < np.inf):
        raise ValueError("wavelength: expected at least two increasing values > 0 [um]")
    refraction = np.asarray(index, np.complex128)
    if refraction.shape not in ((), given.shape):
        raise ValueError(f"index: got shape {refraction.shape}, expected one number or {given.shape}")
    if not (np.all(np.isfinite(refraction)) and np.all(refraction.real > 0) and np.all(refraction.imag <= 0)):
        raise ValueError("index: expected n - ik with n > 0 and k >= 0")
    if not (math.isfinite(diameter) and diameter > 0 and math.isfinite(spread) and spread >= 0):
        raise ValueError(f"diameter, spread: got {diameter}, {spread}, expected diameter > 0 and spread >= 0")
    if (angles is not None and angles < 3) or sizes < 1:
        raise ValueError(f"angles, sizes: got {angles}, {sizes}, expected at least 3 and 1")

    refraction = np.broadcast_to(refraction, given.shape)
    diameters, share = _lognormal(diameter, spread, sizes * FINER if spread > 0 else 1)
    if angles is None:
        largest = np.pi * diameters.max() / given[0]
        angles = int(max(ANGLES, 2 * math.ceil(PER_SIZE * largest / 2) + 1))
    cosine = np.cos(np.linspace(np.pi, 0, angles))
    asked = given, refraction, diameters, share, cosine
    key = f"mie {miepython.__version__} {fingerprint(asked).hex()}"
    held = kept(key)
    if held is None:
        held = _sums(*asked, progress).tobytes()
        keep(key, held)
    found = np.frombuffer(held).reshape(given.size, -1)
    extinction, scattering, phase = found[:, 0], found[:, 1], found[:, 2:]
    volume = np.pi / 6 * (diameter * 1e-6) ** 3 * math.exp(4.5 * spread**2)
    back = np.argsort(1e4 / given)
    phase = phase / scattering[:, None]
    return ParticleTable(1e4 / given[back], extinction[back], scattering[back], volume, cosine, phase[back])


def _lognormal(diameter: float, spread: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Diameters [um], and the share of the particles that each stands for."""
    if count == 1:
        return np.array([float(diameter)]), np.ones(1)
    z = 2 * spread + REACH * (2 * (np.arange(count) + 0.5) / count - 1)  # areas weigh as d^2
    return diameter * np.exp(spread * z), np.exp(-z * z / 2) * 2 * REACH / (count * math.sqrt(2 * math.pi))


def _sums(
    wavelength: np.ndarray,
    refraction: np.ndarray,
    diameters: np.ndarray,
    share: np.ndarray,
    cosine: np.ndarray,
    progress: bool,
) -> np.ndarray:
    """Sums over sizes [wavelength, 2 + angle] [m2]: of extinction, of scattering, and by angle."""
    import miepython

    extinction, scattering = np.zeros((2, wavelength.size))
    phase = np.zeros((wavelength.size, cosine.size))
    step = min(diameters.size, FINER)
    for begin in tqdm(range(0, diameters.size, step), desc="sizes", disable=not progress):
        alike = np.zeros(wavelength.size)
        for d, part in zip(diameters[begin : begin + step], share[begin : begin + step], strict=True):
            q_extinction, q_scattering, _, _ = miepython.efficiencies_mx(refraction, np.pi * d / wavelength)
            area = part * np.pi / 4 * (d * 1e-6) ** 2
            extinction += area * q_extinction
            alike += area * q_scattering
        scattering += alike
        for i, size in enumerate(np.pi * diameters[begin + step // 2] / wavelength):
            phase[i] += alike[i] * miepython.i_unpolarized(refraction[i], size, cosine, norm="one")
    return np.concatenate([extinction[:, None], scattering[:, None], phase], axis=1)
