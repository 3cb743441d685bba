"""Directions towards a plume, drawn because it lights the skin, and the density with which they are.

A plume is covered by boxes. From a point of the skin a box is drawn by what it would send there if it were thin, and
a point uniform in its volume. What counts is the direction alone, so its density is a sum over all boxes,

    pdf(omega) = sum_i P_i / V_i integral t^2 dt over the chord through box i,

exactly. Far away it is proportional to the emission of a thin plume along omega, if the boxes resolve it.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Key

from jaxir._arrays import as_float
from jaxir._math import frame_around
from jaxir.geometry import AbstractSampler, box_chord, pdf_box, pdf_from_volume, sample_box
from jaxir.scene.jet import JetPlume
from jaxir.scene.plume import GridPlume
from jaxir.transport.reflection import PlumeLight

MOST_BRICKS = 32  # of a grid
SLABS, LEVELS = 10, 3  # of a jet: along its axis, and boxes within one another across it
EVEN = 0.05  # of the draws, for pieces that emit more than their temperature tells


class PlumePieces(NamedTuple):
    """Boxes that cover a plume.

    Attributes:
        frame: directions of their edges, rows [3, 3].
        centre: along the frame [3, piece] [m].
        half: half edges [3, piece] [m].
        power: proportional to what each emits, about [piece].
    """

    frame: Float[Array, "3 3"]
    centre: Float[Array, "3 piece"]
    half: Float[Array, "3 piece"]
    power: Float[Array, " piece"]


class Sight(NamedTuple):
    """Pieces seen from one point.

    Attributes:
        offset: of their centres, along the frame [3, piece] [m].
        chance: with which each is drawn [piece]; 0 for all where none is above the horizon.
    """

    offset: Float[Array, "3 piece"]
    chance: Float[Array, " piece"]


def plume_pieces(plume: GridPlume | JetPlume, light: PlumeLight) -> PlumePieces:
    """Boxes that cover a plume, each with volume * temperature^exponent as its power."""
    return _grid_pieces(plume, light) if isinstance(plume, GridPlume) else _jet_pieces(plume, light)


def sight_of(pieces: PlumePieces, point: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Sight:
    """Draw pieces by what they send to a surface, about: power * cos / distance^2, cos that of the highest point.

    One draw in 20 is even among the pieces above the horizon, whatever their power.
    """
    offset = pieces.centre - (pieces.frame @ point)[:, None]
    up = (pieces.frame @ normal)[:, None]
    height = jnp.maximum(jnp.sum(offset * up + pieces.half * jnp.abs(up), axis=0), 0)
    square = jnp.maximum(jnp.sum(offset**2, axis=0), jnp.sum(pieces.half**2, axis=0))
    sent = pieces.power * height / (square * jnp.sqrt(square))
    above = (height > 0).astype(sent.dtype)
    return Sight(offset, (1 - EVEN) * _shares(sent) + EVEN * _shares(above))


def _shares(weight: Float[Array, " piece"]) -> Float[Array, " piece"]:
    total = jnp.sum(weight)
    return weight / jnp.where(total > 0, total, 1)


def draw_towards(
    pieces: PlumePieces, sight: Sight, sampler: AbstractSampler, key: Key[Array, ""], count: int
) -> Float[Array, "count 3"]:
    """Unit vectors towards points drawn in the pieces [count, 3]."""
    first, second = (sampler.draw(k, count) for k in jax.random.split(key))
    number = sight.chance.shape[0]
    upto = sight.chance @ np.triu(np.ones((number, number), sight.chance.dtype))  # a sum over few is no scan's work
    chosen = jnp.minimum(jnp.sum((first[:, :1] >= upto[None]).astype(jnp.int32), axis=-1), number - 1)
    u = jnp.concatenate([first[:, 1:], second], axis=-1)
    offset = (sight.offset.T[chosen] + jax.vmap(sample_box)(u, pieces.half.T[chosen])) @ pieces.frame
    square = jnp.sum(offset * offset, axis=-1, keepdims=True)
    return offset * lax.rsqrt(jnp.where(square > 0, square, 1))


def pdf_towards(pieces: PlumePieces, sight: Sight, omega: Float[Array, " 3"]) -> Float[Array, ""]:
    """Density [] [sr-1] of `draw_towards` for a direction."""
    near, far = box_chord(sight.offset, pieces.half, pieces.frame @ omega)
    return jnp.sum(pdf_from_volume(sight.chance * pdf_box(pieces.half), near, far))


def _grid_pieces(plume: GridPlume, light: PlumeLight) -> PlumePieces:
    """Bricks of cells; the hottest cell of each stands for it."""
    grid, parts = plume.grid, [1, 1, 1]
    while 2 * np.prod(parts) <= MOST_BRICKS:
        axis = int(np.argmax(np.array(grid.shape) / parts))
        if 2 * parts[axis] > grid.shape[axis]:
            break
        parts[axis] *= 2
    cells = [-(-n // part) for n, part in zip(grid.shape, parts, strict=True)]
    edges = [np.append(np.arange(0, n, cell), n) for n, cell in zip(grid.shape, cells, strict=True)]
    bricks = [len(edge) - 1 for edge in edges]
    fill = [(0, brick * cell - n) for n, brick, cell in zip(grid.shape, bricks, cells, strict=True)]
    apart = jnp.pad(plume.temperature, fill, mode="edge").reshape(
        tuple(itertools.chain.from_iterable(zip(bricks, cells, strict=True)))
    )
    hottest = jnp.max(apart, axis=(1, 3, 5)).reshape(-1)

    def at(fields: list[np.ndarray]) -> Array:
        mesh = np.stack(np.meshgrid(*fields, indexing="ij")).reshape(3, -1)
        return as_float(mesh) * grid.spacing[:, None]

    centre = at([(edge[1:] + edge[:-1]) / 2 for edge in edges]) + grid.origin[:, None]
    half = at([np.diff(edge) / 2 for edge in edges])
    warmth = (hottest / jnp.max(hottest)) ** light.exponent
    return PlumePieces(jnp.eye(3, dtype=half.dtype), centre, half, warmth / pdf_box(half))


def _jet_pieces(jet: JetPlume, light: PlumeLight) -> PlumePieces:
    """Slabs along the axis, each of boxes within one another whose densities add up to the exhaust's emission."""
    lip = jet.diameter / 2
    z = jet.stations(as_float(np.arange(2 * SLABS + 1) / (2 * SLABS)))  # slabs as long as they are wide, about
    begin, middle, end = z[:-1:2], z[1::2], z[2::2]
    level = as_float((np.arange(LEVELS) + 0.5) / LEVELS)
    r = level[None] * (lip + jet.spreading * middle)[:, None]
    fraction = jet.fraction(jnp.broadcast_to(middle[:, None], r.shape), r * r)
    temperature = jet.temperature(fraction)
    emitted = fraction * (jet.exit_temperature / temperature) * (temperature / jet.exit_temperature) ** light.exponent
    step = jnp.maximum(emitted - jnp.pad(emitted[:, 1:], ((0, 0), (0, 1))), 0)
    width = as_float((np.arange(LEVELS) + 1) / LEVELS)[None] * (lip + jet.spreading * end)[:, None]
    along = jnp.broadcast_to((end - begin)[:, None] / 2, width.shape)
    half = jnp.stack([width, width, along]).reshape(3, -1)
    frame = frame_around(jet.direction)
    place = jnp.broadcast_to((begin + end)[:, None] / 2, width.shape).reshape(1, -1)
    centre = (frame @ jet.nozzle)[:, None] + jnp.pad(place, ((2, 0), (0, 0)))
    return PlumePieces(frame, centre, half, step.reshape(-1) / pdf_box(half))
