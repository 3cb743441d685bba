"""Atmospheric paths from files: CSV and MODTRAN's tape7."""

from __future__ import annotations

import math
import os
import re
from pathlib import Path

import numpy as np

from jaxir._arrays import as_float, float_dtype
from jaxir.io._files import csv_rows, largest_number, read_text, to_number
from jaxir.scene.air import TableAtmosphere

_W_PER_CM2 = 1e4  # W cm-2 in W m-2


def load_atmosphere_csv(path: str | os.PathLike) -> TableAtmosphere:
    """Read a path from CSV.

    The first line that is neither empty nor a comment (#) names the columns: `wavenumber_cm-1` or `wavelength_um`,
    `transmittance`, and optionally `path_radiance` [W m-2 sr-1 / cm-1, whatever the first column]. Other columns are
    ignored.

    Args:
        path: the file.

    Returns:
        The path, in ascending wavenumber.

    Raises:
        ValueError: a column is missing, a line is not numeric, has another number of columns or is cut, wavenumbers
            do not change in one direction, a transmittance lies outside [0, 1] or a radiance is negative; names file
            and line.
    """
    file = Path(path)
    lines = csv_rows(file)
    if not lines:
        raise ValueError(f"{file}: got no lines, expected a header and samples")
    header = [name.strip() for name in lines[0][1]]
    spectral = next((name for name in ("wavenumber_cm-1", "wavelength_um") if name in header), None)
    if spectral is None or "transmittance" not in header:
        raise ValueError(
            f"{file}:{lines[0][0]}: got columns {header}, expected wavenumber_cm-1 or wavelength_um, and transmittance"
        )
    wanted = [spectral, "transmittance", *(["path_radiance"] if "path_radiance" in header else [])]
    table = _Table(file)
    for number, cells in lines[1:]:
        if len(cells) != len(header):
            raise ValueError(f"{file}:{number}: got {len(cells)} columns, expected {len(header)}")
        values = [table.number(number, name, cells[header.index(name)]) for name in wanted]
        if spectral == "wavelength_um":
            if values[0] <= 0:
                raise ValueError(f"{file}:{number}: got wavelength {values[0]}, expected > 0 um")
            values[0] = 1e4 / values[0]
        table.add(number, values[0], values[1], values[2] if len(values) > 2 else 0.0)
    return table.atmosphere()


def load_tape7(path: str | os.PathLike) -> TableAtmosphere:
    """Read the path between sensor and target from MODTRAN's tape7 (.tp7, .7sc) in wavenumbers.

    A value belongs to the column under whose name it ends: blank columns occur, so position counts, not order. The
    path radiance is `PTH THRML` (which contains `THRML SCT`) plus `SOL SCAT` (which contains `SING SCAT`) of IEMSCT 1
    and 2, in W cm-2 sr-1 / cm-1; IEMSCT 0 and 3 tell the transmittance only. Radiance from the ground is not part of
    the path. Of several runs in a file the first is read.

    Args:
        path: the file.

    Returns:
        The path, in ascending wavenumber.

    Raises:
        ValueError: no header line whose first word is FREQ, no -9999 at the end, a line that is cut or not numeric,
            wavenumbers that do not change in one direction, a transmittance outside [0, 1], a negative radiance;
            names file and line.
    """
    file = Path(path)
    lines = read_text(file, "latin-1").splitlines()
    start = next((i for i, line in enumerate(lines) if line.split()[:1] == ["FREQ"]), None)
    if start is None:
        raise ValueError(f"{file}: got no header line that starts with FREQ, expected MODTRAN's tape7 in wavenumbers")
    found = {name: _column_end(lines[start], name) for name in ("FREQ", *_TRANSMITTANCE, *_ADDED)}
    total = next((name for name in _TRANSMITTANCE if found[name] is not None), None)
    if total is None:
        raise ValueError(f"{file}:{start + 1}: got no column {' or '.join(_TRANSMITTANCE)}, expected one")
    added = [name for name in _ADDED if found[name] is not None]
    first = start + (2 if lines[start + 1 : start + 2] and lines[start + 1].split()[:1] == ["CM-1"] else 1)

    table = _Table(file)
    length = len(lines[first].rstrip()) if first < len(lines) else 0
    for number, line in enumerate(lines[first:], first + 1):
        if line.strip().startswith("-9999"):
            return table.atmosphere()
        if len(line.rstrip()) != length:
            raise ValueError(f"{file}:{number}: got a line of {len(line.rstrip())} characters, expected {length}")
        values = {name: table.number(number, name, _cell(line, found[name])) for name in ("FREQ", total)}
        parts = [table.number(number, name, _cell(line, found[name]), blank=True) for name in added]
        table.add(number, values["FREQ"], values[total], _W_PER_CM2 * math.fsum(parts))
    raise ValueError(f"{file}:{len(lines)}: got the end of the file, expected a line with -9999: the file is cut")


_TRANSMITTANCE = ("TOT TRANS", "COMBIN", "TRANS")
_ADDED = ("PTH THRML", "SOL SCAT")


def _column_end(header: str, name: str) -> int | None:
    """Where the column `name` ends; the words of a name are joined by a blank or an underscore."""
    match = re.search(rf"(?<!\S){name.replace(' ', '[ _]')}(?!\S)", header)
    return match.end() if match else None


def _cell(line: str, end: int | None) -> str:
    """The word that ends nearest to `end`, up to three characters away; versions differ by one or two."""
    words = sorted((abs(word.end() - (end or 0)), word.group()) for word in re.finditer(r"\S+", line))
    return words[0][1] if words and words[0][0] <= 3 else ""


class _Table:
    """Samples of one file, checked one by one so that an error can name its line."""

    def __init__(self, file: Path):
        self.file = file
        self.samples: list[tuple[int, float, float, float]] = []

    def number(self, line: int, name: str, text: str, blank: bool = False) -> float:
        if blank and not text.strip():
            return 0.0
        try:
            value = to_number(text)
        except ValueError:
            raise ValueError(f"{self.file}:{line}: got {text.strip()[:60]!r} for {name}, expected a number") from None
        if not math.isfinite(value):
            raise ValueError(f"{self.file}:{line}: got {value} for {name}, expected a finite number")
        return value

    def add(self, line: int, wavenumber: float, transmittance: float, radiance: float) -> None:
        for name, value in (("wavenumber", wavenumber), ("path radiance", radiance)):
            if not abs(value) <= largest_number():
                raise ValueError(f"{self.file}:{line}: got {name} {value}, expected a finite number in {float_dtype()}")
        if not -1e-9 <= transmittance <= 1 + 1e-9:
            raise ValueError(f"{self.file}:{line}: got transmittance {transmittance}, expected one in [0, 1]")
        if radiance < 0:
            raise ValueError(f"{self.file}:{line}: got path radiance {radiance}, expected one >= 0")
        if _rounded(wavenumber) <= 0:
            raise ValueError(f"{self.file}:{line}: got wavenumber {wavenumber}, expected one > 0")
        before = self.samples
        if len(before) > 1 and (wavenumber - before[-1][1]) * (before[-1][1] - before[-2][1]) <= 0:
            raise ValueError(
                f"{self.file}:{line}: got wavenumber {wavenumber} after {before[-1][1]}, expected a monotonic column"
            )
        if before and _rounded(wavenumber) == _rounded(before[-1][1]):
            raise ValueError(
                f"{self.file}:{line}: got wavenumber {wavenumber} twice (in {float_dtype()}), expected different ones"
            )
        before.append((line, wavenumber, min(max(transmittance, 0.0), 1.0), radiance))

    def atmosphere(self) -> TableAtmosphere:
        if len(self.samples) < 2:
            raise ValueError(f"{self.file}: got {len(self.samples)} samples, expected at least two")
        table = np.array([sample[1:] for sample in self.samples])
        table = table if table[-1, 0] > table[0, 0] else table[::-1]
        return TableAtmosphere(*(as_float(column) for column in table.T))


def _rounded(value: float) -> float:
    """A number as it is in the floating dtype in force."""
    return float(float_dtype().type(value))
