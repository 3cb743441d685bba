"""The blocks of a computed data set: those of its cells that exist, each once."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

_GHOST = "vtkGhostType"
_ABSENT = 1 | 8 | 32  # bits of a cell that another block has, that finer ones replace, that is hidden
_HIDDEN = 2  # bit of a point


def blocks(pyvista: ModuleType, data: Any) -> list[Any]:
    """Every data set of one or several."""
    every = data.recursive_iterator(skip_none=True) if isinstance(data, pyvista.MultiBlock) else [data]
    return [block for block in every if isinstance(block, pyvista.DataSet)]


def present(block: Any) -> Any:
    """A block without the cells that VTK's marks tell not to be there or to be another block's."""
    absent = np.zeros(block.n_cells, bool)
    if _GHOST in block.cell_data:
        absent |= np.asarray(block.cell_data[_GHOST], np.uint8) & _ABSENT > 0
    if _GHOST in block.point_data:
        corners = block.copy(deep=False)
        corners.clear_data()
        corners.point_data["hidden"] = (np.asarray(block.point_data[_GHOST], np.uint8) & _HIDDEN > 0).astype(float)
        absent |= np.asarray(corners.point_data_to_cell_data().cell_data["hidden"]) > 0
    return block.extract_cells(~absent) if absent.any() else block


def joined(pyvista: ModuleType, file: Path, parts: list[Any], names: Iterable[str]) -> Any:
    """Blocks as one data set.

    Raises:
        ValueError: a field of `names` that not all blocks have, all of them as point or all as cell data, or two blocks
            with the same cells, as of two times; names the file.
    """
    if len(parts) == 1:
        return parts[0]
    for name in names:
        kinds = [{kind for kind in ("point", "cell") if name in getattr(part, f"{kind}_data")} for part in parts]
        if any(kinds) and not set.intersection(*kinds):
            each = sorted({" and ".join(sorted(kind)) or "no" for kind in kinds})
            raise ValueError(f"{file}: field {name!r}: got {', '.join(each)} data by block, expected one kind in all")
    grids = [part.cast_to_unstructured_grid() for part in parts]
    found: dict[int, int] = {}
    for number, grid in enumerate(grids):
        first = found.setdefault(hash((np.asarray(grid.points).tobytes(), grid.cells.tobytes())), number)
        if first != number:
            raise ValueError(
                f"{file}: got the same cells in blocks {first} and {number}, expected them once; those of several "
                f"times need their times, in a Tecplot file SOLUTIONTIME"
            )
    return pyvista.MultiBlock(grids).combine()
