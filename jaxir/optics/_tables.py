"""The embedded tables, read once from package data."""

from __future__ import annotations

import csv
import functools
from importlib import resources
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxir._arrays import as_one_program


def rows(name: str) -> list[dict[str, str]]:
    """The rows of an embedded table by column name; lines with # are its provenance."""
    text = resources.files("jaxir").joinpath("data", name).read_text(encoding="utf-8")
    return list(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))


class HotGas(NamedTuple):
    """Narrow-band parameters of one species.

    Attributes:
        coefficient: mean absorption coefficient at the density of 1 atm and 273 K [temperature, row] [cm-1 atm-1].
        inverse_spacing: effective number of lines per cm-1 [temperature, row] [cm].
    """

    coefficient: np.ndarray
    inverse_spacing: np.ndarray


HOT_GAS_TEMPERATURE = np.array([300.0, 600.0, 1000.0, 1500.0, 2000.0, 2500.0])
HOT_GAS_EDGES = np.arange(800.0, 9301.0, 50.0)
ABSENT = 1e-30  # stands for 0 where a logarithm is taken; no path of any length makes it visible


@functools.cache
def hot_gas(species: str) -> HotGas:
    """The table of H2O, CO2 or CO on all its rows and temperatures.

    Entries that the table leaves out (below about 1e-6 cm-1 atm-1) are continued by the Boltzmann factor: ln k is
    linear in 1/T through the two nearest temperatures, with the nearest spacing.
    """
    shape = HOT_GAS_TEMPERATURE.size, HOT_GAS_EDGES.size - 1
    k, inverse = np.full(shape, np.nan), np.full(shape, np.nan)
    for row in rows("hot_gas_narrow_band_50cm.csv"):
        if row["species"] == species:
            place = (
                int(np.searchsorted(HOT_GAS_TEMPERATURE, float(row["T_K"]))),
                int(np.searchsorted(HOT_GAS_EDGES, float(row["nu_lo"]))),
            )
            k[place], inverse[place] = float(row["k"]), float(row["dinv"])
    for column in range(shape[1]):
        known = np.flatnonzero(~np.isnan(k[:, column]))
        if known.size == 0:
            k[:, column], inverse[:, column] = ABSENT, 1.0
            continue
        for level in range(int(known[0]) - 1, -1, -1):  # only colder entries are missing
            k[level, column] = _continued(k[:, column], level)
            inverse[level, column] = inverse[level + 1, column]
    return HotGas(k, inverse)


def _continued(k: np.ndarray, level: int) -> float:
    cold = 1 / HOT_GAS_TEMPERATURE
    energy = 5000.0  # K; where only the hottest temperature has an entry, a typical one
    if level + 2 < k.size:
        energy = max(-np.log(k[level + 1] / k[level + 2]) / (cold[level + 1] - cold[level + 2]), 0.0)
    return max(k[level + 1] * np.exp(-energy * (cold[level] - cold[level + 1])), 1e-12)


class ColdPath(NamedTuple):
    """The fit to LOWTRAN 7: transmittance = prod exp(-exp(log_strength) W^power) over the rows of a bin.

    Attributes:
        row_bin: index of the row's bin [row].
        species: index of the row's species in `COLD_PATH_SPECIES` [row].
        log_strength, power: parameters [row]; W is a column in km.
        pressure_power, temperature_power: exponents n, m of the column [row].
    """

    row_bin: np.ndarray
    species: np.ndarray
    log_strength: np.ndarray
    power: np.ndarray
    pressure_power: np.ndarray
    temperature_power: np.ndarray


COLD_PATH_EDGES = np.arange(800.0, 10001.0, 50.0)
COLD_PATH_SPECIES = ("h2o", "h2oc", "umix", "o3", "n2")


@functools.cache
def cold_path() -> ColdPath:
    """The embedded fit of the cold atmosphere."""
    table = rows("lowtran7_fit_50cm.csv")
    return ColdPath(
        row_bin=np.searchsorted(COLD_PATH_EDGES, [float(row["nu_lo"]) for row in table]).astype(np.int32),
        species=np.array([COLD_PATH_SPECIES.index(row["species"]) for row in table], np.int32),
        log_strength=np.array([float(row["lnc"]) for row in table]),
        power=np.array([float(row["a"]) for row in table]),
        pressure_power=np.array([float(row["n"]) for row in table]),
        temperature_power=np.array([float(row["m"]) for row in table]),
    )


@as_one_program
def overlap_matrix(
    lower: Float[Array, " node"], upper: Float[Array, " node"], edges: Float[Array, " edge"]
) -> Float[Array, "node row"]:
    """Share of each bin (`lower` to `upper`) that lies in each row of a table (between neighbouring `edges`)."""
    low = jnp.maximum(lower[:, None], edges[None, :-1])
    high = jnp.minimum(upper[:, None], edges[None, 1:])
    return jnp.maximum(high - low, 0) / (upper - lower)[:, None]


@as_one_program
def sample_weights(
    lower: Float[Array, " node"], upper: Float[Array, " node"], wavenumber: Float[Array, " sample"]
) -> Float[Array, "node sample"]:
    """Weights of tabulated samples in the mean over each bin of the piecewise linear function through them.

    Exact, sums of positive parts; the bins lie within the table.
    """
    start, end = wavenumber[None, :-1], wavenumber[None, 1:]
    low = jnp.maximum(lower[:, None], start)
    high = jnp.maximum(jnp.minimum(upper[:, None], end), low)
    share = (high - low) / (upper - lower)[:, None]
    place = ((low - start) + (high - start)) / (2 * (end - start))
    return jnp.pad(share * (1 - place), ((0, 0), (0, 1))) + jnp.pad(share * place, ((0, 0), (1, 0)))
