"""Measured spectra from CSV, checked, and the slit through which they were measured.

Lines that begin with # are the citation. The first other line names the columns with their units.
"""

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

SPECTRUM = ("wavelength_um", "spectral_radiance_W_m-2_sr-1_um-1")
PROFILE = ("radius_cm", "temperature_K", "two_dT_K", "CO", "CO2", "H2O", "NO", "OH")


def read_rows(text: str) -> list[dict[str, str]]:
    """Rows of a CSV by column name; lines with # are its citation."""
    return list(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))


def read_columns(path: Path, columns: Sequence[str], gap: float = 3.0) -> np.ndarray:
    """Numbers of a CSV with just these columns, of which the first rises without gaps [column, row].

    Args:
        path: the file.
        columns: their names, which hold the units.
        gap: the largest step of the first column, in median steps.

    Raises:
        ValueError: no such file, other columns (so other units), a cell that is no finite number, a first column that
            does not rise or has a gap; names file and line.
    """
    if not path.is_file():
        raise ValueError(f"{path}: got no file, expected a CSV with the columns {', '.join(columns)}")
    lines = [(i, text) for i, text in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)]
    lines = [(i, text) for i, text in lines if text.strip() and not text.startswith("#")]
    names = next(csv.reader([lines[0][1]])) if lines else []
    if names != list(columns):
        raise ValueError(f"{path}: got columns {', '.join(names) or 'none'}, expected {', '.join(columns)}")
    rows = []
    for number, text in lines[1:]:
        cells = next(csv.reader([text]))
        try:
            row = [float(cell) for cell in cells]
        except ValueError:
            row = []
        if len(row) != len(columns) or not all(math.isfinite(x) for x in row):
            raise ValueError(f"{path}:{number}: got {text[:60]!r}, expected {len(columns)} finite numbers")
        rows.append(row)
    if len(rows) < 3:
        raise ValueError(f"{path}: got {len(rows)} rows, expected at least 3")
    table = np.array(rows)
    step = np.diff(table[:, 0])
    for i in np.flatnonzero((step <= 0) | (step > gap * np.median(step)))[:1]:
        where, found = f"{path}:{lines[i + 2][0]}", f"{table[i + 1, 0]:g} after {table[i, 0]:g}"
        raise ValueError(f"{where}: got {columns[0]} {found}, expected one that rises by some {np.median(step):.3g}")
    return table.T


def through_slit(wavelength: np.ndarray, spectrum: np.ndarray, top: float, base: float, at: np.ndarray) -> np.ndarray:
    """Mean of a spectrum over a trapezoidal slit around each of the wavelengths `at`.

    The trapezoid is the convolution of two boxes, of widths (base + top) / 2 and (base - top) / 2.

    Args:
        wavelength: increasing [sample].
        spectrum: at them, linear between [sample].
        top: width of the slit where all passes, in the unit of the wavelengths.
        base: its width where anything passes.
        at: centres, at least base / 2 inside the spectrum.
    """
    value = spectrum
    for width in ((base + top) / 2, (base - top) / 2):
        steps = np.diff(wavelength) * (value[1:] + value[:-1]) / 2
        integral = np.concatenate([[0.0], np.cumsum(steps)])
        upper, lower = (np.interp(wavelength + s * width / 2, wavelength, integral) for s in (1, -1))
        value = (upper - lower) / width
    return np.interp(at, wavelength, value)
