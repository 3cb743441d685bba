"""Files written whole or not at all, and text read with every error naming its file and line."""

from __future__ import annotations

import codecs
import csv
import json
import os
import re
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from jaxir._arrays import float_dtype

LARGEST_TEXT = 2**30  # bytes of a file that is read as text
_LONGEST_PART = 200  # bytes of a name in that of its temporary file
_CUT_AFTER = 3  # lines of one form that show how the last number of a file must look
_FORM = re.compile(r"[+-]?\d*(?:\.(?P<decimals>\d*))?(?:[eEdD][+-]?(?P<exponent>\d*))?")


@contextmanager
def written_whole(path: str | os.PathLike) -> Iterator[Path]:
    """A temporary path beside `path` that takes its name when the block ends without an error, else vanishes.

    Raises:
        ValueError: the folder of `path` does not exist or may not be written, or `path` is a folder.
    """
    final = Path(path)
    if final.is_dir():
        raise ValueError(f"{final}: is a folder, expected the name of a file")
    if not final.parent.is_dir():
        raise ValueError(f"{final}: the folder {final.parent} does not exist")
    short = os.fsencode(final.name)[:_LONGEST_PART].decode(errors="ignore")  # file systems bound the whole name
    try:
        handle, name = tempfile.mkstemp(dir=final.parent, prefix=f".{short}.", suffix=final.suffix)
    except OSError as error:
        raise ValueError(f"{final}: the folder may not be written ({error.strerror})") from error
    os.close(handle)
    part = Path(name)
    try:
        yield part
        part.chmod(0o666 & ~_umask())
        part.replace(final)
    finally:
        part.unlink(missing_ok=True)


def remove_parts(folder: Path, names: str) -> None:
    """Remove what `written_whole` left of files called `names` (a pattern) when its process was killed."""
    for part in folder.glob(f".{names}.*{Path(names).suffix}"):
        part.unlink(missing_ok=True)


def require_file(path: str | os.PathLike) -> Path:
    """`path`.

    Raises:
        ValueError: it is no file.
    """
    file = Path(path)
    if not file.is_file():
        raise ValueError(f"{file}: is a folder, expected a file" if file.is_dir() else f"{file}: no such file")
    return file


def read_text(path: str | os.PathLike, encoding: str = "utf-8") -> str:
    """The whole of a text file, without the mark that some editors begin it with.

    Raises:
        ValueError: no such file, one that is too large or holds bytes that are no text; names file and line.
    """
    file = require_file(path)
    if file.stat().st_size > LARGEST_TEXT:
        raise ValueError(f"{file}: got {file.stat().st_size} bytes, expected a text of at most {LARGEST_TEXT}")
    raw = file.read_bytes().removeprefix(codecs.BOM_UTF8)
    try:
        return raw.decode(encoding)
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise ValueError(f"{file}:{line}: got the byte {raw[error.start]:#04x}, expected {encoding.upper()}") from error


def read_json(file: Path, expected: str) -> Any:
    """What a JSON file holds.

    Raises:
        ValueError: it is none, with what was `expected`.
    """
    try:
        return json.loads(read_text(file))
    except (ValueError, RecursionError) as error:
        said = str(error) if str(error).startswith(f"{file}:") else f"{file}: {error}"
        raise ValueError(f"{said}, expected {expected}") from error


def csv_rows(path: str | os.PathLike) -> list[tuple[int, list[str]]]:
    """Number and cells of every line of a CSV file that is neither empty nor a comment (#).

    A file whose last line has no end may be cut inside its last number. It is refused where the lines before show that:
    they end in numbers with equally many decimals and digits of the exponent, and the last has fewer.

    Raises:
        ValueError: no such file, not UTF-8, not CSV, a last line that is cut; names file and line.
    """
    text = read_text(path).replace("\r\n", "\n").replace("\r", "\n")
    kept = [(n, line) for n, line in enumerate(text.split("\n"), 1) if line.strip() and line.lstrip()[0] != "#"]
    reader = csv.reader((line for _, line in kept), strict=True)
    try:
        rows = [(kept[reader.line_num - 1][0], cells) for cells in reader if "".join(cells).strip()]
    except csv.Error as error:
        line = kept[reader.line_num - 1][0]
        raise ValueError(f"{path}:{line}: not readable as CSV ({error}), expected cells between commas") from error
    if not text.endswith("\n"):
        _require_whole_number(Path(path), rows)
    return rows


def _require_whole_number(file: Path, rows: list[tuple[int, list[str]]]) -> None:
    forms = [_form(cells[-1]) for _, cells in rows]
    known = [form for form in forms[:-1] if form is not None]
    if len(known) < _CUT_AFTER or len(set(known)) > 1 or known[0] == (0, 0):
        return
    last = forms[-1]
    if last is None or last[0] < known[0][0] or last[1] < known[0][1]:
        line, cells = rows[-1]
        raise ValueError(
            f"{file}:{line}: got {cells[-1].strip()!r} without a line end, expected as many digits as in the lines "
            "before: the file is cut (or end its last line)"
        )


def _form(cell: str) -> tuple[int, int] | None:
    """Numbers of decimals and of digits of the exponent; None for what is no number."""
    match = _FORM.fullmatch(cell.strip())
    return None if match is None else (len(match["decimals"] or ""), len(match["exponent"] or ""))


def to_number(text: str) -> float:
    """A number as files write it.

    Raises:
        ValueError: the text is none.
    """
    if "_" in text:  # which Python takes for a separator of digits
        raise ValueError(f"could not convert string to float: {text!r}")
    return float(text)


def labels(values: Sequence[float], digits: int) -> dict[float, str]:
    """Values as text, with so many digits, or with as many more as tell different ones apart."""
    every = dict.fromkeys(values)
    while len({f"{value:.{digits}g}" for value in every}) < len(every):
        digits += 1
    return {value: f"{value:.{digits}g}" for value in every}


def largest_number() -> float:
    """Beyond it numbers are infinite in the floating dtype in force."""
    return float(np.finfo(float_dtype()).max)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
