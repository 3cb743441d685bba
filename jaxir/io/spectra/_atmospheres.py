"""Atmospheric paths from files: CSV and MODTRAN's tape7."""

from __future__ import annotations

import math
import os
import re
import warnings
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxir._arrays import as_float, float_dtype
from jaxir.io._files import csv_rows, largest_number, read_text, to_number
from jaxir.optics.spectrum import TabulatedSpectrum
from jaxir.scene.air import TableAtmosphere

GAP, WIDE = 10.0, 0.01  # times as far apart as their neighbours, and share of the range, are samples beside a gap
_W_PER_CM2 = 1e4  # W cm-2 in W m-2


def load_atmosphere_csv(path: str | os.PathLike) -> TableAtmosphere:
    """Read a path from CSV.

    The first line that is neither empty nor a comment (#) names the columns: `wavenumber_cm-1` or `wavelength_um`,
    `transmittance`, and optionally `path_radiance` [W m-2 sr-1 / cm-1, whatever the first column]. Other columns are
    ignored, but for those that seem to hold a path radiance under another name, which are refused. Where samples are
    over ten times as far apart as those on either side, and over a hundredth of the range, there is a gap, and a band
    that reaches into it is refused.

    Args:
        path: the file.

    Returns:
        The path, in ascending wavenumber.

    Raises:
        ValueError: a column is missing or there twice, a line is not numeric, has another number of columns or is cut,
            wavenumbers do not change in one direction, a transmittance lies outside [0, 1] or a radiance is negative;
            names file and line.
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
    shines = "path_radiance" in header
    near = [name for name in header if _seems_radiance(name)]
    if near and not shines:
        raise ValueError(
            f"{file}:{lines[0][0]}: got the column {near[0]}, expected path_radiance in W m-2 sr-1 / cm-1, or none"
        )
    wanted = [spectral, "transmittance", *(["path_radiance"] if shines else [])]
    if twice := [name for name in wanted if header.count(name) > 1]:
        raise ValueError(f"{file}:{lines[0][0]}: got the column {twice[0]} twice, expected every column once")
    table = _Table(file)
    for number, cells in lines[1:]:
        if len(cells) != len(header):
            raise ValueError(f"{file}:{number}: got {len(cells)} columns, expected {len(header)}")
        values = [table.number(number, name, cells[header.index(name)]) for name in wanted]
        if spectral == "wavelength_um":
            if values[0] <= 0:
                raise ValueError(f"{file}:{number}: got wavelength {values[0]}, expected > 0 um")
            values[0] = 1e4 / values[0]
        table.add(number, values[0], values[1], values[2] if shines else 0.0)
    return _joined([_Piece(file, table.sorted(), shines)])


def _seems_radiance(column: str) -> bool:
    name = column.lower()
    return any(word in name for word in ("radiance", "emission", "emitted", "path_rad", "l_path", "lpath"))


def load_tape7(path: str | os.PathLike | Sequence[str | os.PathLike]) -> TableAtmosphere:
    """Read the path between sensor and target from MODTRAN's tape7 (.tp7, .7sc), of one file or several.

    In wavenumbers (column `FREQ`) or, as scanned files may be, in um (column `WAVLEN MCRN`, radiance per um).

    A value belongs to the column under whose name it ends: blank columns occur, so position counts, not order. The
    path radiance is `PTH THRML` (which contains `THRML SCT`) plus `SOL SCAT` (which contains `SING SCAT`) of IEMSCT 1
    and 2, in W cm-2 sr-1 / cm-1 or / um; IEMSCT 0 and 3 tell the transmittance only, which is warned of. Radiance from
    the ground is not part of the path. Of several runs in a file the first is read.

    Several files are joined in the order of their wavenumbers, one for each band, say. Where they leave a gap wider
    than their steps, or one of them a gap of ten, the table has none of it, and a band that reaches into it is refused.

    Args:
        path: the file, or several.

    Returns:
        The path, in ascending wavenumber; without path radiance where no file holds one.

    Raises:
        ValueError: no header line that begins with FREQ or WAVLEN MCRN, values that do not end below the names of their
            columns, no -9999 at the end, a line that is cut or not numeric, wavenumbers that do not change in one
            direction, a transmittance outside [0, 1], a negative radiance; names file and line. Files that overlap, or
            only some of which hold path radiances; names both.
    """
    files = [Path(path)] if isinstance(path, (str, os.PathLike)) else [Path(one) for one in path]
    if not files:
        raise ValueError("path: got no file, expected at least one")
    pieces = []
    for file in files:
        lines = _Tape7(file)
        total = next((name for name in _TRANSMITTANCE if lines.has(name)), None)
        if total is None:
            raise ValueError(f"{file}:{lines.header}: got no column {' or '.join(_TRANSMITTANCE)}, expected one")
        added = [name for name in _ADDED if lines.has(name)]
        table = _Table(file)
        for number, line in lines.rows([lines.axis, total, *added]):
            wavenumber, width = lines.place(table, number, line)
            passed = table.number(number, total, lines.cell(line, total))
            parts = [table.number(number, name, lines.cell(line, name), blank=True) for name in added]
            table.add(number, wavenumber, passed, width * _W_PER_CM2 * math.fsum(parts))
        pieces.append(_Piece(file, table.sorted(), bool(added)))
    if not any(piece.shines for piece in pieces):
        names = ", ".join(str(file) for file in files)
        warnings.warn(f"{names}: got no path radiance (IEMSCT 1 or 2 tell it); the air adds none", stacklevel=2)
    return _joined(pieces)


def load_tape7_sun(path: str | os.PathLike) -> TabulatedSpectrum:
    """Read the Sun's irradiance at the end of a path from MODTRAN's tape7 of IEMSCT 3, for `Sun` and `ParallelSource`.

    The column `SOL TR`, transmitted sunlight in W cm-2 / cm-1 or / um. It is that at the target already, so it goes
    with `Sun(elevation, azimuth, irradiance, FixedPath(1.0))`.

    Args:
        path: the file.

    Returns:
        The irradiance over wavelength [W m-2 um-1].

    Raises:
        ValueError: as `load_tape7`, or no column SOL TR.
    """
    file = Path(path)
    lines = _Tape7(file)
    if not lines.has(_SUNLIGHT):
        raise ValueError(f"{file}:{lines.header}: got no column {_SUNLIGHT}, expected MODTRAN's tape7 of IEMSCT 3")
    table = _Table(file)
    for number, line in lines.rows([lines.axis, _SUNLIGHT]):
        wavenumber, width = lines.place(table, number, line)
        light = table.number(number, _SUNLIGHT, lines.cell(line, _SUNLIGHT))
        table.add(number, wavenumber, 0.0, width * _W_PER_CM2 * light, what="irradiance")
    wavenumber, _, light = table.sorted().T
    per_um = light * wavenumber**2 / 1e4  # d(wavenumber) = 1e4 / wavelength^2 d(wavelength)
    return TabulatedSpectrum(as_float(1e4 / wavenumber[::-1]), as_float(per_um[::-1]))


class _Piece(NamedTuple):
    """Samples of one file [sample, 3], and whether it holds path radiances."""

    file: Path
    samples: np.ndarray
    shines: bool


def _joined(pieces: list[_Piece]) -> TableAtmosphere:
    """One table of several files in the order of their wavenumbers."""
    pieces = sorted(pieces, key=lambda piece: piece.samples[0, 0])
    dark = [piece.file for piece in pieces if not piece.shines]
    if dark and len(dark) < len(pieces):
        raise ValueError(f"{dark[0]}: got no path radiance, expected one as in the other files, or none in all")
    gaps = [gap for piece in pieces for gap in _gaps(piece.samples[:, 0])]
    for one, other in pairwise(pieces):
        end, start = float(one.samples[-1, 0]), float(other.samples[0, 0])
        if start <= end:
            raise ValueError(
                f"{other.file}: begins at {_both(start)}, inside {one.file}, which ends at {_both(end)}; expected "
                "files that do not overlap"
            )
        step = max(end - float(one.samples[-2, 0]), float(other.samples[1, 0]) - start)
        if start - end > 1.5 * step:
            gaps.append((end, start))
    wavenumber, transmittance, radiance = (as_float(column) for column in np.concatenate([p.samples for p in pieces]).T)
    return TableAtmosphere(
        wavenumber, transmittance, None if dark else radiance, as_float(sorted(gaps)) if gaps else None
    )


def _gaps(wavenumber: np.ndarray) -> list[tuple[float, float]]:
    """Ranges between two samples that are `GAP` times as far apart as those on either side; `WIDE` ones."""
    step = np.diff(wavenumber)
    least = np.maximum(GAP * np.maximum(step[:-2], step[2:]), WIDE * (wavenumber[-1] - wavenumber[0]))
    far = np.flatnonzero(step[1:-1] > least) + 1
    return [(float(wavenumber[place]), float(wavenumber[place + 1])) for place in far]


def _both(wavenumber: float) -> str:
    return f"{wavenumber:.6g} cm-1 ({1e4 / wavenumber:.4g} um)"


_SUNLIGHT = "SOL TR"
_TRANSMITTANCE = ("TOT TRANS", "COMBIN", "TRANS")
_ADDED = ("PTH THRML", "SOL SCAT")
_ASIDE = 3  # characters by which a value may end beside its column's name; versions differ by one or two
_WAVENUMBER, _WAVELENGTH = "FREQ", "WAVLEN MCRN"


class _Tape7:
    """The lines of a file's first run, and where its columns end."""

    def __init__(self, file: Path):
        self.file, self.lines = file, read_text(file, "latin-1").splitlines()
        heads = {i: tuple(line.upper().replace("_", " ").split()[:2]) for i, line in enumerate(self.lines)}
        start = next((i for i, head in heads.items() if head[:1] in (("FREQ",), ("WAVLEN",))), None)
        if start is None:
            raise ValueError(f"{file}: got no header line that starts with FREQ, expected MODTRAN's tape7")
        self.header, self.head = start + 1, self.lines[start].upper()  # its number from 1, and its words
        self.axis = _WAVENUMBER if heads[start][0] == "FREQ" else _WAVELENGTH
        if not self.has(self.axis):
            raise ValueError(f"{file}:{start + 1}: got {' '.join(heads[start])}, expected FREQ or {_WAVELENGTH}")
        below = self.lines[start + 1 : start + 2]
        self.first = start + (2 if below and below[0].split()[:1] == ["CM-1"] else 1)

    def has(self, name: str) -> bool:
        """Whether there is a column of that name."""
        return self._end(name) is not None

    def place(self, table: _Table, number: int, line: str) -> tuple[float, float]:
        """Wavenumber [cm-1] of a line, and the width that its densities are per unit of, per cm-1."""
        value = table.number(number, self.axis, self.cell(line, self.axis))
        if self.axis == _WAVENUMBER:
            return value, 1.0
        if not value > 0:
            raise ValueError(f"{self.file}:{number}: got wavelength {value}, expected > 0 um")
        return 1e4 / value, value**2 / 1e4  # d(wavelength) = wavelength^2 / 1e4 d(wavenumber)

    def _end(self, name: str) -> int | None:
        """Where the column `name` ends; the words of a name are joined by a blank or an underscore."""
        match = re.search(rf"(?<!\S){name.replace(' ', '[ _]')}(?!\S)", self.head)
        return match.end() if match else None

    def cell(self, line: str, name: str) -> str:
        """The value of a column; "" where it is blank."""
        word = self._word(line, name)
        return "" if word is None else line[slice(*word)]

    def _word(self, line: str, name: str) -> tuple[int, int] | None:
        """Where the word is that ends nearest to a column's end, up to `_ASIDE` away."""
        end = self._end(name) or 0
        words = sorted((abs(word.end() - end), word.span()) for word in re.finditer(r"\S+", line))
        return words[0][1] if words and words[0][0] <= _ASIDE else None

    def _require_below(self, number: int, line: str, names: Sequence[str]) -> None:
        """Up to the last of columns `names` every value ends below a name, and none of theirs is another's, too."""
        ends = np.array([word.end() for word in re.finditer(r"\S+", self.head)])
        last = max(self._end(name) or 0 for name in names)
        own = [word for word in (self._word(line, name) for name in names) if word]
        every = (word.end() for word in re.finditer(r"\S+", line))
        aside = any(np.min(np.abs(ends - end)) > _ASIDE for end in every if end <= last + _ASIDE)
        if aside or len(own) != len(set(own)) or "\t" in self.head + line:
            raise ValueError(
                f"{self.file}:{number}: got values that do not end below the names of their columns, expected "
                "them in columns as MODTRAN writes them, without tabs"
            )

    def rows(self, names: Sequence[str]) -> Iterator[tuple[int, str]]:
        """Number and text of every line of values, those of columns `names` below these."""
        length = len(self.lines[self.first].rstrip()) if self.first < len(self.lines) else 0
        for number, line in enumerate(self.lines[self.first :], self.first + 1):
            if line.strip().startswith("-9999"):
                return
            if len(line.rstrip()) != length:
                raise ValueError(
                    f"{self.file}:{number}: got a line of {len(line.rstrip())} characters, expected {length}"
                )
            self._require_below(number, line, names)
            yield number, line
        raise ValueError(
            f"{self.file}:{len(self.lines)}: got the end of the file, expected a line with -9999: the file is cut"
        )


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

    def add(
        self, line: int, wavenumber: float, transmittance: float, radiance: float, what: str = "path radiance"
    ) -> None:
        for name, value in (("wavenumber", wavenumber), (what, radiance)):
            if not abs(value) <= largest_number():
                raise ValueError(f"{self.file}:{line}: got {name} {value}, expected a finite number in {float_dtype()}")
        if not -1e-9 <= transmittance <= 1 + 1e-9:
            raise ValueError(f"{self.file}:{line}: got transmittance {transmittance}, expected one in [0, 1]")
        if radiance < 0:
            raise ValueError(f"{self.file}:{line}: got {what} {radiance}, expected one >= 0")
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

    def sorted(self) -> np.ndarray:
        """Wavenumber, transmittance and radiance [sample, 3], in ascending wavenumber."""
        if len(self.samples) < 2:
            raise ValueError(f"{self.file}: got {len(self.samples)} samples, expected at least two")
        table = np.array([sample[1:] for sample in self.samples])
        return table if table[-1, 0] > table[0, 0] else table[::-1]


def _rounded(value: float) -> float:
    """A number as it is in the floating dtype in force."""
    return float(float_dtype().type(value))
