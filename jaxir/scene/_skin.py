"""Opaque skin: a mesh with a temperature and a reflectance per face."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int

from jaxir._arrays import Check, as_float, broadcast, thermal
from jaxir._fields import require_part
from jaxir._plausible import KELVIN
from jaxir.geometry.search import Mesh
from jaxir.geometry.selection import AbstractSelection, LabelledFaces, new_part, selected_faces
from jaxir.optics.surface import AbstractBrdf, painted_brdf


class Skin(eqx.Module):
    """The opaque surface of a body.

    Attributes:
        mesh: its triangles.
        temperature: of each face [face] [K].
        brdf: reflectance of each face; emissivity follows from it by Kirchhoff's law.
        part: index of each face's part [face].
        part_names: names of the parts.

    Differentiable in `temperature` and in the leaves of `brdf`.
    """

    mesh: Mesh
    temperature: Float[Array, " face"]
    brdf: AbstractBrdf
    part: Int[Array, " face"]
    part_names: tuple[str, ...] = eqx.field(static=True)

    def __init__(
        self,
        mesh: Mesh,
        temperature: Any,
        brdf: AbstractBrdf,
        part: Any = None,
        part_names: Sequence[str] = ("skin",),
    ):
        """Join a mesh with what its faces are.

        Args:
            mesh: the triangles.
            temperature: one value, or one per face [K].
            brdf: parameters for all faces alike, or one per face.
            part: index of each face's part, into `part_names`; all faces are part 0 by default.
            part_names: names of the parts.

        Raises:
            ValueError: a part of another kind, per-face arrays of another length than the mesh, part indices without
                a name, or a name twice.
        """
        require_part(
            "Skin.mesh", mesh, Mesh, "a mesh, e.g. jaxir.Mesh(vertices, faces) or load_mesh(path, unit='m').mesh"
        )
        require_part("Skin.brdf", brdf, AbstractBrdf, "a brdf, e.g. jaxir.Lambert({})")
        count = mesh.count
        value = as_float(temperature, "Skin.temperature")
        if value.shape not in ((), (1,), (count,)):
            raise ValueError(
                f"Skin.temperature: got shape {value.shape}, expected one value or ({count},), one per face"
            )
        self.mesh = mesh
        self.temperature = broadcast(value, (count,))
        if brdf.shape()[0] not in (1, count):
            raise ValueError(
                f"Skin.brdf: got parameters of {brdf.shape()[0]} faces, expected 1 or {count}, one per face"
            )
        self.brdf = brdf
        index = np.zeros(count, np.int32) if part is None else np.asarray(part)
        if index.shape != (count,) or not np.issubdtype(index.dtype, np.integer):
            raise ValueError(f"Skin.part: got {index.dtype} of shape {index.shape}, expected integers ({count},)")
        if index.min() < 0 or index.max() >= len(part_names):
            raise ValueError(
                f"Skin.part: got indices {index.min()} to {index.max()}, expected 0 to {len(part_names) - 1} "
                f"for the names {tuple(part_names)}"
            )
        if len(set(part_names)) < len(part_names):
            raise ValueError(f"Skin.part_names: got {tuple(part_names)}, expected different names")
        self.part = jax.device_put(index.astype(np.int32))
        self.part_names = tuple(part_names)

    def select(self, selection: AbstractSelection) -> np.ndarray:
        """Indices of the faces that a selection holds, see `jaxir.geometry.selection`.

        Raises:
            ValueError: it holds no face or all of them, or refers to what is not there; a skin has no materials.
        """
        corners, none = np.asarray(self.mesh.corners(), np.float64), np.zeros(0, np.int32)
        return selected_faces(selection, LabelledFaces(corners, np.asarray(self.part), self.part_names, none, ()))

    def with_part(
        self, name: str, selection: AbstractSelection, temperature: Any = None, brdf: AbstractBrdf | None = None
    ) -> Skin:
        """The same skin with the faces that a selection holds as a new part, hotter or painted otherwise.

        Args:
            name: of the new part, by which fits and results know it.
            selection: of the faces.
            temperature: of the part, one value or one per face of it in the mesh's order [K]; None keeps what is there.
            brdf: of the part, with parameters of one face; None keeps what is there.

        Raises:
            ValueError: as `select`; a name that is taken; temperatures or a brdf of other shapes.

        Differentiable in `temperature` and in `brdf`.
        """
        faces = self.select(selection)
        held, paint = self.temperature, self.brdf
        if temperature is not None:
            value = as_float(temperature, "Skin.temperature")
            if value.shape not in ((), (faces.size,)):
                raise ValueError(
                    f"Skin.temperature: got shape {value.shape}, expected one value or ({faces.size},), one per face "
                    f"of {name!r}"
                )
            held = held.at[faces].set(value)
        if brdf is not None:
            require_part("Skin.brdf", brdf, AbstractBrdf, "a brdf, e.g. jaxir.Lambert({})")
            paint = painted_brdf(paint, brdf, faces, self.mesh.count)
        return Skin(self.mesh, held, paint, **new_part(name, faces, np.asarray(self.part), self.part_names))

    def checks(self) -> list[Check]:
        """Temperatures are positive, vertices finite, the brdf's parameters in range."""
        name = "Skin.temperature"
        temperature = [thermal(name, self.temperature), KELVIN(name, self.temperature)]
        return [*self.mesh.checks(), *temperature, *self.brdf.checks()]
