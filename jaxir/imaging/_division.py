"""How an image is cut: pixels into strata, tiles into chunks.

What traces a chunk is compiled for so many tiles and strata. So on a CPU there are few sizes of chunks, and images of
many shapes are made by one program; where an image does not fill its chunks, blocks of them hold nothing and are left
out.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxir._arrays import placed
from jaxir._math import on_cpu
from jaxir.geometry import pixel_strata

TILES = 256  # of a chunk at most
SIZES = (8, 64, TILES)  # of chunks on a CPU
BLOCKS = 16  # in which the tiles of a chunk are traced at least on a CPU, so that those that see nothing are left out
TOGETHER = (1, 2, 4, 6, 8)  # strata whose rays may be traced side by side: bundles then cover fewer pixels and faces


class Division(NamedTuple):
    """How every pixel is cut.

    Attributes:
        cells: columns and rows of strata: an array where all is known, so that more of them compile nothing anew, and
            numbers below transformations of JAX, which cannot turn round a loop whose end is data.
        together: strata whose rays are traced side by side, where these are few enough.
    """

    cells: tuple[int, int] | Int[Array, "2"]
    together: int

    @property
    def count(self) -> Any:
        """Strata of a pixel."""
        return self.cells[0] * self.cells[1]


def division(samples: int, known: bool) -> Division:
    """Pixels cut for so many rays, two in each stratum; `known` as in `Division`.

    As many strata are traced together as cost least, if rays side by side cost as much as their number and one more;
    the last time some may lie beyond the last stratum.
    """
    cells = pixel_strata(samples)
    together = min(TOGETHER, key=lambda some: -(-cells[0] * cells[1] // some) * (some + 1))
    return Division(placed(np.array(cells, np.int32)) if known else cells, together)


class Chunk(NamedTuple):
    """Tiles of an image, or stacked ones.

    Attributes:
        number: of the chunk, which decides its random numbers.
        edges: of the pixels of each, see `Camera.tile_edges`.
        there: whether each lies in the image.
    """

    number: Int[Any, "*chunk"]
    edges: Float[Any, "*chunk tile 2 17"]
    there: Bool[Any, "*chunk tile"]

    def each(self) -> list[Chunk]:
        """Stacked ones one by one."""
        return list(map(Chunk, *self))


def chunk_size(share: int, most: int, together: int) -> int:
    """Tiles of a chunk: `share`, `most` at most; rounded up to one of `SIZES`, on a card to blocks of `together`."""
    if on_cpu():
        allowed = [size for size in SIZES if size <= most] or [1]
        return next((size for size in allowed if size >= share), allowed[-1])
    share = min(most, share)
    block = min(together, share)
    return block * -(-share // block)


def block_size(size: int, together: int) -> int:
    """Tiles of a chunk of so many that are traced together, `together` at most: a divisor of its size."""
    if on_cpu():
        return 1 << min(together, max(size // BLOCKS, 1)).bit_length() - 1
    return min(together, size)
