"""Faces by the names that a file gives them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxir.geometry.selection._selection import AbstractSelection, LabelledFaces


@dataclass(frozen=True)
class OfPart(AbstractSelection):
    """Faces of parts: objects, groups or bodies of the file, and parts made before.

    Attributes:
        parts: names, or one name.
    """

    parts: str | Sequence[str]

    def holds(self, faces: LabelledFaces) -> np.ndarray:
        """See `AbstractSelection.holds`."""
        return _named("OfPart.parts", self.parts, faces.part, faces.part_names)


@dataclass(frozen=True)
class OfMaterial(AbstractSelection):
    """Faces of materials, as OBJ (`usemtl`) and GLB name them.

    Attributes:
        materials: names, or one name.
    """

    materials: str | Sequence[str]

    def holds(self, faces: LabelledFaces) -> np.ndarray:
        """See `AbstractSelection.holds`."""
        if faces.material.size == 0:
            raise ValueError("OfMaterial: got a mesh without materials, expected a file that names them, as OBJ or GLB")
        return _named("OfMaterial.materials", self.materials, faces.material, faces.material_names)


def _named(field: str, given: str | Sequence[str], index: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    """Which faces have one of the given names."""
    wanted = [given] if isinstance(given, str) else list(given)
    missing = [name for name in wanted if name not in names]
    if missing or not wanted:
        raise ValueError(f"{field}: got {(missing or wanted)!r}, expected some of {', '.join(names)}")
    return np.isin(index, [names.index(name) for name in wanted])
