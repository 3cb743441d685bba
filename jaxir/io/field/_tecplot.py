"""What VTK's reader of Tecplot's ASCII files does not tell or would get wrong."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from jaxir.io._files import to_number

_KEYS = "SOLUTIONTIME|STRANDID|ZONETYPE|DATAPACKING|F"
_WORD = re.compile(rf'"[^"]*"|#.*|\b(ZONE)\b|\b({_KEYS})\s*=\s*([^\s,]+)', re.IGNORECASE)
_COORDINATES = [name for axis in ("XxI", "YyJ", "ZzK") for name in (*axis, f"Coordinate{axis[0]}")]


def zone_times(file: Path) -> list[float | None]:
    """The SOLUTIONTIME of every zone; None of one that is there at all times, without it or of STRANDID 0.

    Raises:
        ValueError: a time that is no number, or a zone whose values VTK would take for others; names the file.
    """
    zones: list[dict[str, str]] = []
    with file.open(encoding="latin-1") as stream:
        for number, line in enumerate(stream, 1):
            if "=" not in line and "zone" not in line.lower():  # numbers, of which there are many lines
                continue
            for zone, key, value in _WORD.findall(line):
                if zone:
                    zones.append({})
                elif key and zones:
                    zones[-1]["DATAPACKING" if key.upper() == "F" else key.upper()] = value.upper()
                    if zones[-1].get("ZONETYPE") == "ORDERED" and zones[-1].get("DATAPACKING") == "BLOCK":
                        raise ValueError(
                            f"{file}:{number}: got a zone with ZONETYPE=ORDERED and DATAPACKING=BLOCK, which VTK "
                            f"reads as POINT, expected it without ZONETYPE"
                        )
    return [None if zone.get("STRANDID") == "0" else _time(file, zone.get("SOLUTIONTIME")) for zone in zones]


def _time(file: Path, text: str | None) -> float | None:
    try:
        return None if text is None else to_number(text)
    except ValueError as error:
        raise ValueError(f"{file}: SOLUTIONTIME: got {text!r}, expected a number") from error


def require_coordinates(file: Path, reader: Any) -> None:
    """Raise `ValueError` where VTK, having read the file, took none or others of its variables for coordinates."""
    fields = [reader.GetDataAttributeName(i) for i in range(reader.GetNumberOfDataAttributes())]
    wrong = [name for name in fields if name.strip() in _COORDINATES]
    if wrong or len(fields) == reader.GetNumberOfVariables():
        raise ValueError(
            f"{file}: VARIABLES: got {', '.join(wrong or fields)} as fields, expected X, Y and Z before all fields and "
            f"no other coordinates"
        )
