"""Line lists in HITRAN's format of 160 characters a line, checked before anything else reads them."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from jaxir.io._files import require_file

MOLECULES = (
    "H2O CO2 O3 N2O CO CH4 O2 NO SO2 NO2 NH3 HNO3 OH HF HCl HBr HI ClO OCS H2CO HOCl N2 HCN CH3Cl H2O2 C2H2 C2H6 PH3"
).split()
"""Names by HITRAN's molecule number, which starts at 1."""

_LENGTH = 160
_ISOTOPES = b"1234567890AB"  # in HITRAN's order: 0, A, B are 10, 11, 12
# Characters of the fields that a spectrum needs, and whether they must not be negative.
_FIELDS = (
    ("wavenumber", 3, 15, True),
    ("intensity", 15, 25, True),
    ("air-broadened width", 35, 40, True),
    ("self-broadened width", 40, 45, True),
    ("lower-state energy", 45, 55, False),  # -1 marks unknown ones
    ("temperature exponent", 55, 59, False),
    ("pressure shift", 59, 67, False),
)
_BLOCK = 1 << 25  # bytes


class LineFile(NamedTuple):
    """A file that passed.

    Attributes:
        path: the file.
        species: its molecule.
        isotopes: numbers of its isotopologues, ascending.
        lines: how many.
        digest: SHA-256 of its bytes.
    """

    path: Path
    species: str
    isotopes: tuple[int, ...]
    lines: int
    digest: str


def check_line_file(path: str | os.PathLike, progress: bool = True) -> LineFile:
    """Read a list of lines (.par of HITRAN or HITEMP, unpacked) from end to end.

    Args:
        path: the file.
        progress: show a bar.

    Returns:
        What the file holds.

    Raises:
        ValueError: no such file, no lines, a line of another length or without an end, a molecule that is unknown or
            differs from the first line's, an isotopologue or a number that is not one; names file and line.
    """
    file = require_file(path)
    digest, count, molecule = hashlib.sha256(), 0, -1
    isotopes: set[int] = set()
    with (
        open(file, "rb") as stream,
        tqdm(total=file.stat().st_size, unit="B", unit_scale=True, desc=file.name, disable=not progress) as bar,
    ):
        end = b"\r\n" if stream.readline().endswith(b"\r\n") else b"\n"
        stream.seek(0)
        while block := stream.readlines(_BLOCK):
            characters = _characters(file, count, block, end)
            molecule = _molecule(file, count, characters, molecule)
            isotopes |= _isotopes(file, count, characters)
            for name, first, last, positive in _FIELDS:
                _numbers(file, count, characters[:, first:last], name, positive)
            for line in block:
                digest.update(line)
            count += len(block)
            bar.update(characters.size)
    if count == 0:
        raise ValueError(f"{file}: got no lines, expected HITRAN's format of {_LENGTH} characters")
    return LineFile(file, MOLECULES[molecule - 1], tuple(sorted(isotopes)), count, digest.hexdigest())


def _characters(file: Path, before: int, block: list[bytes], end: bytes) -> np.ndarray:
    """The lines as a matrix of bytes [line, character]; all must be of one length."""
    length = _LENGTH + len(end)
    for number, line in enumerate(block, before + 1):
        if len(line) != length or not line.endswith(end):
            text = line.rstrip(b"\r\n")
            cut = " and no line end: the file is cut" if not line.endswith(b"\n") else ""
            raise ValueError(f"{file}:{number}: got {len(text)} characters{cut}, expected {_LENGTH}")
    return np.frombuffer(b"".join(block), "S1").reshape(len(block), length)


def _words(columns: np.ndarray) -> np.ndarray:
    """Neighbouring characters as one word [line]."""
    return np.ascontiguousarray(columns).view(f"S{columns.shape[1]}").ravel()


def _molecule(file: Path, before: int, characters: np.ndarray, expected: int) -> int:
    words = _words(characters[:, :2])
    first = words[0].strip()
    known = first.isdigit() and 1 <= int(first) <= len(MOLECULES)
    if expected < 0 and not known:
        raise ValueError(f"{file}:{before + 1}: got molecule {first.decode('ascii', 'replace')!r}, expected 1 ... 28")
    number = expected if expected > 0 else int(first)
    wrong = np.flatnonzero(words != b"%2d" % number)
    if wrong.size:
        got, line = words[wrong[0]].decode("ascii", "replace"), before + int(wrong[0]) + 1
        raise ValueError(f"{file}:{line}: got molecule {got!r}, expected {number} ({MOLECULES[number - 1]}) all over")
    return number


def _isotopes(file: Path, before: int, characters: np.ndarray) -> set[int]:
    found = {bytes(value) for value in np.unique(characters[:, 2])}
    unknown = sorted(value for value in found if value not in {b"%c" % c for c in _ISOTOPES})
    if unknown:
        line = before + int(np.flatnonzero(characters[:, 2] == unknown[0])[0]) + 1
        raise ValueError(f"{file}:{line}: got isotopologue {unknown[0].decode('ascii', 'replace')!r}, expected 1 ... 9")
    return {_ISOTOPES.index(value) + 1 for value in found}


def _numbers(file: Path, before: int, columns: np.ndarray, name: str, positive: bool) -> None:
    words = _words(columns)
    try:
        value = words.astype(np.float64)
    except ValueError:
        value = np.array([_number(word) for word in words])
    wrong = np.flatnonzero(~np.isfinite(value) | ((value < 0) & positive))
    if wrong.size:
        got = words[wrong[0]].decode("ascii", "replace")
        kind = "a number >= 0" if positive else "a number"
        raise ValueError(f"{file}:{before + wrong[0] + 1}: got {got!r} for the {name}, expected {kind}")


def _number(word: bytes) -> float:
    try:
        return float(word)
    except ValueError:
        return np.nan
