"""How well do shipped tables of hot CO2, and of cold CO2 in the slots of hot CO2, stand for their lines?

The tables lie in `jaxir/data/co2_slots.npz` and hold, for each 50 cm-1 bin of 2000-2400 cm-1, what `studies.co2_lines`
says. Two kinds of cells cut a bin. Those of hot gas are the quantiles of its spectrum at each temperature and pressure.
Those of cold air are sets of wavenumbers: slots of the rank of hot CO2 at a reference temperature, each cut by the
rank of cold CO2; a cell holds the geometric mean of the cold cross-section, so that lines that coincide stay together.
All cuts are even in s, where the share below is 1 - (1 - s)^3.
"""

import argparse
from pathlib import Path

import numpy as np
from tqdm import tqdm

import jaxir
from studies import co2_lines as lines
from studies._study import Run, study

PATH = Path(jaxir.__file__).parent / "data" / "co2_slots.npz"
EDGES = np.arange(2000.0, 2401.0, 50.0)  # cm-1
HOT_TEMPERATURE = np.array([250.0, 300.0, 400.0, 600.0, 900.0, 1300.0, 1800.0, 2400.0, 3200.0])  # K
HOT_PRESSURE = np.array([5e3, 15e3, 40e3, 1e5, 2.5e5])  # Pa
COLD_TEMPERATURE = np.array([200.0, 250.0, 310.0])  # K
COLD_PRESSURE = np.array([3e3, 1e4, 3e4, 1e5])  # Pa
REFERENCE = np.array(
    [400.0, 500.0, 650.0, 800.0, 1000.0, 1250.0, 1600.0, 2200.0]
)  # temperatures of hot CO2 whose rank makes slots [K]
REFERENCE_PRESSURE, COLD_REFERENCE = 3e4, (250.0, 3e4)
QUANTILES, SLOTS, PARTS = 32, 16, 8
FAINTEST = 1e-32  # m2; stands for less: no path through air or plume shows it


def cuts(count: int) -> np.ndarray:
    """Shares of a bin between cells [count + 1]."""
    return 1 - (1 - np.linspace(0, 1, count + 1)) ** 3


def quantiles(spectrum: np.ndarray) -> np.ndarray:
    """ln of a spectrum's quantiles in the middle, in s, of each cell [QUANTILES]."""
    middle = 1 - (1 - (np.arange(QUANTILES) + 0.5) / QUANTILES) ** 3
    place = (np.arange(spectrum.size) + 0.5) / spectrum.size
    return np.interp(middle, place, np.log(np.maximum(np.sort(spectrum), FAINTEST)))


def cells(hot: np.ndarray, cold: np.ndarray) -> list[np.ndarray]:
    """Indices of the wavenumbers of a bin in each of SLOTS x PARTS cells, slots by rank of `hot`, parts by `cold`."""
    found = []
    for slot in np.split(np.argsort(hot, kind="stable"), np.round(cuts(SLOTS)[1:-1] * hot.size).astype(int)):
        ranked = slot[np.argsort(cold[slot], kind="stable")]
        inner = np.round(cuts(PARTS)[1:-1] * ranked.size).astype(int)
        found += np.split(ranked, np.clip(inner, 1, None)) if ranked.size else [ranked] * PARTS
    return found


def cell_means(spectrum: np.ndarray, sets: list[np.ndarray]) -> np.ndarray:
    """ln of the geometric mean of a spectrum over each cell, and of the cell before where one is empty."""
    logs, result = np.log(np.maximum(spectrum, FAINTEST)), []
    for one in sets:
        result.append(logs[one].mean() if one.size else result[-1])
    return np.array(result)


def tables(edges: np.ndarray) -> dict[str, np.ndarray]:
    """The arrays of the file for the bins between `edges` [cm-1]."""
    bins = [slice(*np.searchsorted(lines.GRID, np.array(pair) - 1e-6)) for pair in zip(edges, edges[1:], strict=False)]
    hot = np.empty((HOT_TEMPERATURE.size, HOT_PRESSURE.size, len(bins), QUANTILES))
    for i, j in tqdm(list(np.ndindex(hot.shape[:2])), desc="hot"):
        spectrum = lines.cross_section(HOT_TEMPERATURE[i], HOT_PRESSURE[j])
        hot[i, j] = [quantiles(spectrum[one]) for one in bins]
    ranks = [lines.cross_section(t, REFERENCE_PRESSURE) for t in REFERENCE]
    rank = np.empty((REFERENCE.size, len(bins), SLOTS))
    first = lines.cross_section(*COLD_REFERENCE)
    sets = {}
    for r, k in np.ndindex(rank.shape[:2]):
        sets[r, k] = cells(ranks[r][bins[k]], first[bins[k]])
        own = [np.concatenate(sets[r, k][PARTS * s : PARTS * (s + 1)]) for s in range(SLOTS)]
        rank[r, k] = cell_means(ranks[r][bins[k]], own)
    cold = np.empty((REFERENCE.size, COLD_TEMPERATURE.size, COLD_PRESSURE.size, len(bins), SLOTS * PARTS))
    for i, j in tqdm(list(np.ndindex(cold.shape[1:3])), desc="cold"):
        spectrum = lines.cross_section(COLD_TEMPERATURE[i], COLD_PRESSURE[j])
        for r, k in np.ndindex(rank.shape[:2]):
            cold[r, i, j, k] = cell_means(spectrum[bins[k]], sets[r, k])
    return {
        "edges": edges,
        "hot_temperature": HOT_TEMPERATURE,
        "hot_pressure": HOT_PRESSURE,
        "hot": np.round(hot, 4).astype(np.float32),
        "reference": REFERENCE,
        "rank": np.round(rank, 4).astype(np.float32),
        "cold_temperature": COLD_TEMPERATURE,
        "cold_pressure": COLD_PRESSURE,
        "cold": np.round(cold, 3).astype(np.float32).reshape(*cold.shape[:4], SLOTS, PARTS),
    }


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--write", action="store_true", help=f"write {PATH.name} anew")


def main(run: Run) -> str:
    made = tables(EDGES)
    if run.options.write:
        np.savez_compressed(PATH, **made)
    held = dict(np.load(PATH))
    apart = {name: float(np.abs(made[name] - held[name]).max()) for name in made}
    return f"written, {PATH.stat().st_size // 1024} KiB; largest difference {max(apart.values()):.2g}"


if __name__ == "__main__":
    study(main, options)
