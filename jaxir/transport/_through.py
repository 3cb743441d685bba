"""Lines through the plumes: asked for one after the other, walked all at once.

A walk through plumes is most of what is compiled for a scene with them, and every light, segment and event wants one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxir.scene import Lit

Answer = Callable[[], Any]
"""Gives [*batch, node] once all has been asked for."""


class Through:
    """Transmittance and emission of a scene's plumes along lines that are asked for before the first answer is read."""

    def __init__(self, lit: Lit):
        self._passed, self._emitted = _Together(lit.transmittance), _Together(lit.emission)

    def passed(
        self, point: Float[Array, "*batch 3"], omega: Float[Array, "*batch 3"], length: Float[Array, "*batch"]
    ) -> Answer:
        """See `Lit.transmittance`."""
        return self._passed(point, omega, length)

    def emitted(
        self, point: Float[Array, "*batch 3"], omega: Float[Array, "*batch 3"], length: Float[Array, "*batch"]
    ) -> Answer:
        """See `Lit.emission`."""
        return self._emitted(point, omega, length)


class _Together:
    """A function of lines, called once for all that were asked for."""

    def __init__(self, function: Callable[[Array, Array, Array], Any]):
        self._function = function
        self._lines: list[tuple[Array, Array, Array]] = []
        self._answers: list[Any] | None = None

    def __call__(self, point: Array, omega: Array, length: Array) -> Answer:
        assert self._answers is None, "asked for after the answers"
        place = len(self._lines)
        self._lines.append((point, omega, length))
        return lambda: self._answered()[place]

    def _answered(self) -> list[Any]:
        if self._answers is None:
            lengths = [length for _, _, length in self._lines]
            point, omega = (jnp.concatenate([line[k].reshape(-1, 3) for line in self._lines]) for k in (0, 1))
            found = self._function(point, omega, jnp.concatenate([length.reshape(-1) for length in lengths]))
            if isinstance(found, float):
                self._answers = [found] * len(lengths)
            else:
                parts = jnp.split(found, np.cumsum([length.size for length in lengths])[:-1].tolist())
                each = zip(parts, lengths, strict=True)
                self._answers = [part.reshape(*length.shape, -1) for part, length in each]
        return self._answers
