"""One skin, several kinds of surface."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxir.optics.surface._brdf import AbstractBrdf, at_face


class BrdfPerFace(AbstractBrdf):
    """Another brdf for every face: paint on the wings, bare metal at the nozzle.

    Every kind present is computed for every hit and one is kept, which is what a vector machine does anyway; a kind
    that is not in the list compiles nothing.

    Attributes:
        kinds: the brdfs, each with parameters for all faces alike or one per face.
        kind: which of them each face has [face].

    Differentiable in the leaves of `kinds`.
    """

    kinds: tuple[AbstractBrdf, ...]
    kind: Int[Array, "..."]

    def __init__(self, kinds: Sequence[AbstractBrdf], kind: Any):
        """Join brdfs.

        Args:
            kinds: at least one brdf.
            kind: index into `kinds` of each face [face].

        Raises:
            ValueError: no brdf, indices out of range, or brdfs that span different numbers of faces.
        """
        index = np.asarray(kind)
        if not kinds:
            raise ValueError("BrdfPerFace.kinds: got none, expected at least one brdf")
        if index.ndim != 1 or not np.issubdtype(index.dtype, np.integer):
            raise ValueError(f"BrdfPerFace.kind: got {index.dtype} of shape {index.shape}, expected integers (face,)")
        if index.size == 0 or index.min() < 0 or index.max() >= len(kinds):
            raise ValueError(f"BrdfPerFace.kind: got {index}, expected indices 0 to {len(kinds) - 1}")
        for place, one in enumerate(kinds):
            if one.shape()[0] not in (1, index.size):
                raise ValueError(
                    f"BrdfPerFace.kinds[{place}]: got parameters of {one.shape()[0]} faces, expected 1 or {index.size}"
                )
        self.kinds = tuple(kinds)
        self.kind = jax.device_put(index.astype(np.int32))
        self.shape()

    def at(self, face: Int[Array, "*batch"]) -> BrdfPerFace:
        """See `AbstractBrdf.at`."""
        own = tuple(brdf.at(face) for brdf in self.kinds), at_face(self.kind, face)
        return eqx.tree_at(lambda b: (b.kinds, b.kind), self, own)

    @property
    def diffuse(self) -> bool:
        """See `AbstractBrdf.diffuse`: whether every kind is."""
        return all(brdf.diffuse for brdf in self.kinds)

    def eval(
        self, omega_i: Float[Array, " 3"], omega_o: Float[Array, " 3"], normal: Float[Array, " 3"]
    ) -> Float[Array, " node"]:
        """See `AbstractBrdf.eval`."""
        return self._own(lambda brdf: brdf.eval(omega_i, omega_o, normal))

    def sample(
        self, u: Float[Array, " 2"], omega_o: Float[Array, " 3"], normal: Float[Array, " 3"]
    ) -> Float[Array, " 3"]:
        """See `AbstractBrdf.sample`."""
        return self._own(lambda brdf: brdf.sample(u, omega_o, normal))

    def pdf(
        self, omega_i: Float[Array, " 3"], omega_o: Float[Array, " 3"], normal: Float[Array, " 3"]
    ) -> Float[Array, ""]:
        """See `AbstractBrdf.pdf`."""
        return self._own(lambda brdf: brdf.pdf(omega_i, omega_o, normal))

    def directional_reflectance(self, cos_o: Float[Array, ""]) -> Float[Array, " node"]:
        """See `AbstractBrdf.directional_reflectance`."""
        return self._own(lambda brdf: brdf.directional_reflectance(cos_o))

    def directional_emissivity(self, cos_o: Float[Array, ""]) -> Float[Array, " node"]:
        """See `AbstractBrdf.directional_emissivity`."""
        return self._own(lambda brdf: brdf.directional_emissivity(cos_o))

    def _own(self, of: Callable[[AbstractBrdf], Array]) -> Array:
        """The value of this hit's kind."""
        chosen = of(self.kinds[0])
        for place, brdf in enumerate(self.kinds[1:], start=1):
            chosen = jnp.where(self.kind == place, of(brdf), chosen)
        return chosen


def painted_brdf(brdf: AbstractBrdf, paint: AbstractBrdf, faces: Int[np.ndarray, " some"], count: int) -> AbstractBrdf:
    """A brdf of `count` faces with another one on some of them.

    Raises:
        ValueError: a paint with parameters of more than one face.
    """
    if paint.shape()[0] != 1:
        raise ValueError(
            f"brdf: got parameters of {paint.shape()[0]} faces, expected those of one for all faces painted"
        )
    kinds = list(brdf.kinds) if isinstance(brdf, BrdfPerFace) else [brdf]
    kind = np.array(brdf.kind) if isinstance(brdf, BrdfPerFace) else np.zeros(count, np.int32)
    kind[faces] = len(kinds)
    return joined_brdf([*kinds, paint], kind)


def joined_brdf(brdfs: Sequence[AbstractBrdf], kind: np.ndarray) -> AbstractBrdf:
    """One brdf of all faces: those of one class become one with parameters per face.

    Args:
        brdfs: with parameters for all faces alike, or one per face.
        kind: index into them of each face [face].
    """
    used = sorted(set(kind.tolist()))
    classes = list(dict.fromkeys(_class(brdfs[i], i) for i in used))
    merged = [_merged([(i, brdfs[i]) for i in used if _class(brdfs[i], i) == one], kind) for one in classes]
    if len(merged) == 1:
        return merged[0]
    place = {i: classes.index(_class(brdfs[i], i)) for i in used}
    return BrdfPerFace(merged, np.array([place[i] for i in kind.tolist()]))


def _class(brdf: AbstractBrdf, index: int) -> Any:
    """What may be merged: tables are too large to be repeated for every face, so each stands alone."""
    small = all(leaf.ndim <= 2 for leaf in jax.tree.leaves(brdf))
    return type(brdf), -1 if small else index


def _merged(brdfs: Sequence[tuple[int, AbstractBrdf]], kind: np.ndarray) -> AbstractBrdf:
    if len(brdfs) == 1:
        return brdfs[0][1]

    def per_face(*leaves: Any) -> Any:
        width = max(leaf.shape[1] for leaf in leaves)
        value = jnp.zeros((kind.size, width), leaves[0].dtype)
        for (index, _), leaf in zip(brdfs, leaves, strict=True):
            value = jnp.where(jnp.asarray(kind == index)[:, None], leaf, value)
        return value

    return jax.tree.map(per_face, *(brdf for _, brdf in brdfs))
