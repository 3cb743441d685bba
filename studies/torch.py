"""The plasma torch of Packan et al. (2003) by several models of CO2: what `studies.validation` compares with it.

23 slabs of 0.05 cm at 1 atm, 2200-3409 K, behind 6 m of room air; spectra in W m-2 sr-1 / um.
"""

from importlib import resources
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

import jaxir
from jaxir.optics.air import Profile
from jaxir.optics.spectrum import band_radiance
from studies import co2_lines as lines
from studies.diatomics import CO, NO, layer_emission
from studies.measurements import PROFILE, SPECTRUM, read_columns, read_rows, through_slit

DATA = Path(__file__).parent / "data"
SLAB, ROOM, ROOM_KELVIN = 5e-4, 6.0, 298.0  # m, m, K
ROOM_CO2, ROOM_H2O = 330e-6, 0.014
SLIT = (7.2e-3, 15.2e-3)  # top and base [um]
BINS = np.round(np.arange(4.16, 4.97, 0.04), 2)  # um
NO_BINS = np.round(np.arange(4.96, 5.21, 0.04), 2)
ZONES = (0.225, 0.425)  # radii between core, middle and rim [cm]


class Torch(NamedTuple):
    """The measurement: wavelength [um], spectrum, and the columns of the half profile."""

    wavelength: np.ndarray
    measured: np.ndarray
    radius: np.ndarray
    temperature: np.ndarray
    uncertain: np.ndarray
    co: np.ndarray
    co2: np.ndarray
    no: np.ndarray


def torch() -> Torch:
    """The measurement, read from its files."""
    wavelength, measured = read_columns(DATA / "torch_2003.csv", SPECTRUM)
    radius, kelvin, double, co, co2, _, no, _ = read_columns(DATA / "torch_2003_profile.csv", PROFILE)
    return Torch(wavelength, measured, radius, kelvin, double / 2, co, co2, no)


def crossed(count: int) -> list[int]:
    """Slabs in the order in which the eye meets them."""
    return [*range(count - 1, 0, -1), *range(count)]


def means(wavelength: np.ndarray, spectrum: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Mean of a spectrum in bins [bin]."""
    return np.array(
        [spectrum[(wavelength >= a) & (wavelength < b)].mean() for a, b in zip(edges, edges[1:], strict=False)]
    )


def line_by_line(given: Torch) -> np.ndarray:
    """What each slab of CO2 adds, seen through those in front and the room's air, in the slit [slab, wavelength]."""
    air = ROOM * lines.absorption(ROOM_KELVIN, lines.ATMOSPHERE, ROOM_CO2)
    wide = 1e4 / lines.GRID[::-1]
    jacobian = (lines.GRID**2 / 1e4)[::-1]
    depth = [SLAB * lines.absorption(t, lines.ATMOSPHERE, x) for t, x in zip(given.temperature, given.co2, strict=True)]
    seen, added = np.exp(-air), np.zeros((given.radius.size, given.wavelength.size))
    for i in crossed(given.radius.size):
        emitted = seen * -np.expm1(-depth[i]) * lines.planck(given.temperature[i])
        added[i] += through_slit(wide, emitted[::-1] * jacobian, *SLIT, given.wavelength)
        seen = seen * np.exp(-depth[i])
    return added


def thin(given: Torch, molecule: object, amount: np.ndarray) -> np.ndarray:
    """Thin emission of CO or NO in steps of .01 um, at the measured wavelengths; the room's air is left out."""
    edges = np.arange(3.9, 5.6, 0.01)
    total = np.zeros(edges.size - 1)
    for i in crossed(given.radius.size):
        state = given.temperature[i], lines.ATMOSPHERE, amount[i], SLAB
        total += layer_emission(molecule, *state, 1e4 / edges[::-1])[::-1]
    return through_slit((edges[1:] + edges[:-1]) / 2, total / 0.01, *SLIT, given.wavelength)


def room_water(edges: np.ndarray) -> np.ndarray:
    """Transmittance of the room's water by Malkmus' model in bins of wavelength [bin]."""
    gas, result = jaxir.NarrowBandGas(lines.ATMOSPHERE, h2o=ROOM_H2O, o2=0.2), []
    for low, high in zip(edges, edges[1:], strict=False):
        nodes = jaxir.resolved_nodes(jaxir.Band("bin", low, high), 50.0, 12, 0)
        kappa = np.asarray(gas.absorption(nodes, jnp.asarray(300.0)))
        width = np.asarray(nodes.weight * (nodes.upper - nodes.lower))
        result.append(np.average(np.exp(-ROOM * kappa), weights=width))
    return np.array(result)


def by_default(given: Torch) -> np.ndarray:
    """Means over `BINS` by `NarrowBandGas` and `StandardAtmosphere` on nodes of 50 cm-1 and 8 quantiles [bin].

    The air's profile is the room's. Its transmittance is LOWTRAN's, whose 330 ppm of CO2 are the room's.
    """
    nodes = jaxir.resolved_nodes(jaxir.Band("4.3 um", 1e4 / 2410, 1e4 / 2000), 50.0, 8, 0)
    level = jnp.asarray([-100.0, 100.0])
    even = jnp.ones(2)
    state = (ROOM_KELVIN * even, lines.ATMOSPHERE * even, ROOM_H2O * even, 3e-8 * even)
    air = jaxir.StandardAtmosphere(0.0, 0.0, ROOM, Profile(level, *state))
    seen = np.asarray(air.in_front_of(nodes, jnp.asarray(given.temperature.max())).transmittance, float)
    total = np.zeros(nodes.count)
    gas = jaxir.NarrowBandGas(
        jnp.full(given.radius.size, lines.ATMOSPHERE), co2=given.co2, co=given.co, extrapolate=True
    )
    kappa = np.asarray(gas.absorption(nodes, jnp.asarray(given.temperature)), float)
    for i in crossed(given.radius.size):
        total += (
            seen * -np.expm1(-SLAB * kappa[i]) * np.asarray(band_radiance(jnp.asarray(given.temperature[i]), nodes))
        )
        seen = seen * np.exp(-SLAB * kappa[i])
    return _spread(np.asarray(nodes.lower), np.asarray(nodes.upper), total * np.asarray(nodes.weight))


def by_table(given: Torch) -> np.ndarray:
    """Means over `BINS` by Malkmus' model alone with the embedded table of CO2, behind mean air [bin].

    ln k and ln 1/d go on beyond 2500 K linearly in ln T; a layer's emission is what it takes from the transmittance of
    all before it (Curtis and Godson). The air is the mean of the lines' transmittance in each bin.
    """
    text = resources.files("jaxir").joinpath("data", "hot_gas_narrow_band_50cm.csv").read_text(encoding="utf-8")
    rows = [row for row in read_rows(text) if row["species"] == "CO2"]
    low = np.arange(2000.0, 2400.0, 50.0)
    levels = np.log([1500.0, 2000.0, 2500.0])
    room = np.exp(-ROOM * lines.absorption(ROOM_KELVIN, lines.ATMOSPHERE, ROOM_CO2))
    power = np.zeros(low.size)
    for place, start in enumerate(low):
        own = {float(r["T_K"]): (float(r["k"]), float(r["dinv"])) for r in rows if float(r["nu_lo"]) == start}
        k, d = np.log([own[t] for t in (1500.0, 2000.0, 2500.0)]).T
        slope = np.array([np.diff(k)[-1], np.diff(d)[-1]]) / np.diff(levels)[-1]
        x = strong = 0.0
        before = 1.0
        for i in crossed(given.radius.size):
            hotter = np.log(given.temperature[i]) - levels[-1]
            kt, dt = (
                np.exp(np.array([k[-1], d[-1]]) + slope * hotter)
                if hotter > 0
                else np.exp([np.interp(hotter + levels[-1], levels, y) for y in (k, d)])
            )
            own_x = kt * given.co2[i] * 100 * SLAB * 273 / given.temperature[i]
            width = 0.07 * (273 / given.temperature[i]) ** 0.5
            x, strong = x + own_x, strong + own_x * 4 * width * dt
            b = strong / x
            after = np.exp(-b / 2 * (np.sqrt(1 + 4 * x / b) - 1))
            nodes = jaxir.resolved_nodes(jaxir.Band("bin", 1e4 / (start + 50), 1e4 / start), 50.0, 1, 0)
            power[place] += (before - after) * float(band_radiance(jnp.asarray(given.temperature[i]), nodes)[0])
            before = after
        inside = (lines.GRID >= start) & (lines.GRID < start + 50)
        power[place] *= room[inside].mean()
    return _spread(low, low + 50, power)


def _spread(lower: np.ndarray, upper: np.ndarray, power: np.ndarray) -> np.ndarray:
    """Radiances of bins in wavenumber, even inside them, as means over `BINS` [bin] [W m-2 sr-1 / um]."""
    result = []
    for a, b in zip(BINS, BINS[1:], strict=False):
        share = np.maximum(np.minimum(upper, 1e4 / a) - np.maximum(lower, 1e4 / b), 0) / (upper - lower)
        result.append(float(np.sum(share * power)) / (b - a))
    return np.array(result)


def companions(given: Torch) -> tuple[np.ndarray, np.ndarray]:
    """What CO adds at the measured wavelengths, and NO's means over `NO_BINS` behind the room's water."""
    no = means(given.wavelength, thin(given, NO, given.no), NO_BINS) * room_water(NO_BINS)
    return thin(given, CO, given.co), no
