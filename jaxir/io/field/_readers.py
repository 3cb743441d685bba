"""Readers of computed data sets, all of pyvista, by the times that their files hold."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

from jaxir.io.field._tecplot import require_coordinates, zone_times


class Steps:
    """A file whose times VTK tells.

    Attributes:
        times: rising; none of a file without.
    """

    def __init__(self, reader: Any):
        self._reader = reader
        steps = reader.reader.GetExecutive().TIME_STEPS()
        self.times: list[float] = list(reader.reader.GetOutputInformation(0).Get(steps) or ())

    def read(self, time: float | None) -> Any:
        """The data set at one of the times, or that of a file without."""
        if time is not None:
            self._reader.reader.UpdateTimeStep(time)
        return self._reader.read()


class Listed:
    """A file that names one of each time, which pyvista reads itself; likewise."""

    def __init__(self, reader: Any):
        self._reader = reader
        self.times: list[float] = list(getattr(reader, "time_values", ()))

    def read(self, time: float | None) -> Any:
        """Likewise."""
        if time is not None:
            self._reader.set_active_time_value(time)
        return self._reader.read()


class Zones:
    """A Tecplot file, of which VTK reads the zones of all times at once; likewise."""

    def __init__(self, reader: Any, pyvista: ModuleType, file: Path):
        self._reader, self._pyvista, self._file = reader, pyvista, file
        self._zones = zone_times(file)
        self.times = sorted({time for time in self._zones if time is not None})

    def read(self, time: float | None) -> Any:
        """Likewise."""
        data = self._reader.read()
        require_coordinates(self._file, self._reader.reader)
        if time is None:
            return data
        if len(self._zones) != data.n_blocks:
            raise ValueError(f"{self._file}: got {data.n_blocks} readable zones, expected {len(self._zones)}")
        held = [block for block, at in zip(data, self._zones, strict=True) if at in (None, time)]
        return self._pyvista.MultiBlock(held)


def open_reader(pyvista: ModuleType, file: Path) -> Steps | Listed | Zones | None:
    """The reader of a file; None where there is none for its extension."""
    if file.suffix.lower() == ".xdmf":  # pyvista's asks for the first of the times, which need not be
        kind = type("Xdmf", (pyvista.XdmfReader,), {"_set_defaults_post": lambda self: None})
        return Steps(kind(str(file)))
    try:
        reader = pyvista.get_reader(str(file))
    except ValueError:
        return None
    if isinstance(reader, pyvista.TecplotReader):
        return Zones(reader, pyvista, file)
    return Steps(reader) if hasattr(reader.reader, "GetExecutive") else Listed(reader)
