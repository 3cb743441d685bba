"""What a selection of faces answers, and sets of selections. On the host, once for a mesh."""

from __future__ import annotations

import abc
import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np


class LabelledFaces(NamedTuple):
    """The triangles of a mesh in body axes with the names that they have.

    Attributes:
        corners: [face, 3, 3] [m].
        part: index of each face's part [face].
        part_names: names of the parts.
        material: index of each face's material [face]; empty where none is known.
        material_names: names of the materials.
    """

    corners: np.ndarray
    part: np.ndarray
    part_names: tuple[str, ...]
    material: np.ndarray
    material_names: tuple[str, ...]

    @property
    def centre(self) -> np.ndarray:
        """Mean of the corners of each face [face, 3] [m]."""
        return self.corners.mean(axis=1)

    @property
    def normal(self) -> np.ndarray:
        """Unit normals by the right-hand rule [face, 3]; 0 for faces without area."""
        edge = self.corners[:, 1:] - self.corners[:, :1]
        vector = np.cross(edge[:, 0], edge[:, 1])
        length = np.linalg.norm(vector, axis=1, keepdims=True)
        return vector / np.where(length > 0, length, 1)


class AbstractSelection(abc.ABC):
    """Some faces of a mesh. `a & b`, `a | b` and `~a` are the faces of both, of either, and the others."""

    @abc.abstractmethod
    def holds(self, faces: LabelledFaces) -> np.ndarray:
        """Which faces are selected, booleans [face].

        Raises:
            ValueError: what it refers to is not there.
        """

    def __and__(self, other: AbstractSelection) -> Intersection:
        return Intersection((self, other))

    def __or__(self, other: AbstractSelection) -> Union:
        return Union((self, other))

    def __invert__(self) -> Complement:
        return Complement(self)


@dataclass(frozen=True)
class Intersection(AbstractSelection):
    """Faces that every one of several selections holds.

    Attributes:
        of: the selections, at least one.
    """

    of: Sequence[AbstractSelection]

    def __post_init__(self) -> None:
        """Check that there is one."""
        _require_some(self, self.of)

    def holds(self, faces: LabelledFaces) -> np.ndarray:
        """See `AbstractSelection.holds`."""
        return functools.reduce(np.logical_and, [one.holds(faces) for one in self.of])


@dataclass(frozen=True)
class Union(AbstractSelection):
    """Faces that at least one of several selections holds.

    Attributes:
        of: the selections, at least one.
    """

    of: Sequence[AbstractSelection]

    def __post_init__(self) -> None:
        """Check that there is one."""
        _require_some(self, self.of)

    def holds(self, faces: LabelledFaces) -> np.ndarray:
        """See `AbstractSelection.holds`."""
        return functools.reduce(np.logical_or, [one.holds(faces) for one in self.of])


@dataclass(frozen=True)
class Complement(AbstractSelection):
    """Faces that a selection does not hold.

    Attributes:
        of: the selection.
    """

    of: Any

    def __post_init__(self) -> None:
        """Check that it is one."""
        _require_some(self, (self.of,))

    def holds(self, faces: LabelledFaces) -> np.ndarray:
        """See `AbstractSelection.holds`."""
        return ~self.of.holds(faces)


def selected_faces(selection: AbstractSelection, faces: LabelledFaces) -> np.ndarray:
    """Indices of the faces that a selection holds, in order.

    Args:
        selection: the selection.
        faces: those to choose from.

    Raises:
        ValueError: it holds no face or all of them, or refers to what is not there.
    """
    require_selection("selection", selection)
    held = selection.holds(faces)
    found, count = np.flatnonzero(held), held.size
    if 0 < found.size < count:
        return found
    low, high = faces.corners.min(axis=(0, 1)), faces.corners.max(axis=(0, 1))
    where = ", ".join(f"{axis} {a:.4g} to {b:.4g}" for axis, a, b in zip("xyz", low, high, strict=True))
    caught = "no face" if found.size == 0 else "every face"
    raise ValueError(f"{selection}: catches {caught} of {count}, which span {where} m; expected some of them")


def new_part(name: str, faces: np.ndarray, part: np.ndarray, names: tuple[str, ...]) -> dict[str, Any]:
    """`part` [face] and `part_names` with faces as a part of a new name.

    Raises:
        ValueError: a name that is taken.
    """
    if name in names:
        raise ValueError(f"with_part: got the name {name!r}, expected a new one; {', '.join(names)} are taken")
    changed = np.array(part, np.int32)
    changed[faces] = len(names)
    return {"part": changed, "part_names": (*names, name)}


def require_selection(field: str, value: object) -> None:
    """Raise `ValueError` for what is no selection."""
    if not isinstance(value, AbstractSelection):
        raise ValueError(f"{field}: got {value!r}, expected a selection of faces, e.g. InBox(x=(0, 1))")


def _require_some(owner: AbstractSelection, of: object) -> None:
    name = type(owner).__name__
    if not isinstance(of, Sequence) or len(of) == 0:
        raise ValueError(f"{name}.of: got {of!r}, expected at least one selection")
    for one in of:
        require_selection(f"{name}.of", one)
