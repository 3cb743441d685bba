"""Small pieces of the search loops, in forms that XLA compiles to native code.

An index is never counted from the end of a table: to ask whether it is below 0 is a tenth of a search's operations.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Shaped

from jaxir._math import on_platform

T = TypeVar("T")


def row(table: Array, index: Int[Array, ""]) -> Array:
    """Row `index` of a table [row, ...]."""
    return lax.dynamic_index_in_dim(table, index, keepdims=False, allow_negative_indices=False)


def with_row(table: Array, index: Int[Array, ""], value: Array) -> Array:
    """The table with another row `index`."""
    return lax.dynamic_update_index_in_dim(table, value, index, 0, allow_negative_indices=False)


def item(table: Array, *index: Int[Array, ""]) -> Array:
    """One element of a table, as a slice rather than a gather."""
    return lax.dynamic_slice(table, index, (1,) * table.ndim, allow_negative_indices=False).reshape(())


def lowest_bit(mask: Int[Array, ""]) -> Int[Array, ""]:
    """Position of the lowest set bit."""
    return lax.population_count((mask & -mask) - 1)


def bits(flags: Array) -> Int[Array, ""]:
    """Flags [16] as the bits of one integer."""
    value = jnp.left_shift(jnp.int32(1), jnp.arange(flags.shape[0], dtype=jnp.int32))
    return jnp.sum(jnp.where(flags, value, jnp.int32(0)), dtype=jnp.int32)


def lesser(one: Array, other: Array | float) -> Array:
    """The lesser of two numbers in one instruction, where `jnp.minimum` takes three to keep NaN; `other` beside NaN."""
    return jnp.where(one < other, one, other)


def greater(one: Array, other: Array | float) -> Array:
    """The greater of two numbers, as `lesser`."""
    return jnp.where(one > other, one, other)


def within(value: Array, low: Array | float, high: Array | float) -> Array:
    """`value` moved to the nearer end of [low, high] if outside, as `lesser`; `low` instead of NaN."""
    return lesser(greater(value, low), high)


def smallest(values: Float[Array, " lane"]) -> Float[Array, ""]:
    """Minimum by halving, then as integers of the same order: a reduction of floats is compiled to a scalar chain."""
    while values.shape[0] > 16 and values.shape[0] % 2 == 0:
        half = values.shape[0] // 2
        values = lesser(values[:half], values[half:])
    kind = jnp.int32 if values.dtype == jnp.float32 else jnp.int64
    number = lax.bitcast_convert_type(values, kind)
    return lax.bitcast_convert_type(_turned(jnp.min(_turned(number))), values.dtype)


def _turned(number: Array) -> Array:
    """Bits of floats as integers of the same order, and back."""
    return number ^ (jnp.right_shift(number, jnp.iinfo(number.dtype).bits - 1) & jnp.iinfo(number.dtype).max)


def largest(values: Float[Array, " lane"]) -> Float[Array, ""]:
    """Maximum by halving, as `smallest`."""
    return -smallest(-values)


def octant(direction: Float[Array, " 3"]) -> Int[Array, ""]:
    """Number of the octant of a direction, as the tree's tables are sorted."""
    return jnp.sum(jnp.where(direction < 0, jnp.asarray([1, 2, 4], jnp.int32), jnp.int32(0)), dtype=jnp.int32)


def for_each(flags: Bool[Array, " item"], update: Callable[[Array, T], T], value: T) -> T:
    """`update(k, value)` for every k with a flag, one after another."""
    count = flags.shape[0]

    def advance(k: Array) -> Array:
        return lax.while_loop(lambda k: (k < count) & ~item(flags, k), lambda k: k + 1, k)

    def step(carry: tuple[Array, T]) -> tuple[Array, T]:
        return advance(carry[0] + 1), update(*carry)

    first = advance(varying(jnp.zeros((), jnp.int32), flags))
    return lax.while_loop(lambda carry: carry[0] < count, step, (first, value))[1]


def in_blocks(array: Array, size: int) -> Array:
    """Rows [ray, ...] as [block, size, ...], filled up with zeros."""
    filling = [(0, -array.shape[0] % size)] + [(0, 0)] * (array.ndim - 1)
    return jnp.pad(array, filling).reshape(-1, size, *array.shape[1:])


BLOCK = 256  # rays that `where_some` looks through at a time


def where_some(
    function: Callable[[Any], Array], some: Bool[Array, " ray"], value: Shaped[Array, " ray"], rays: Any, most: int
) -> Shaped[Array, " ray"]:
    """`value` [ray] with `function` of one ray's rows of `rays` where `some`; costs little where few are.

    On graphics cards so many as `most` rays are taken at once.
    """
    count = value.shape[0]

    def one_by_one(some: Array, value: Array, rays: Any) -> Array:
        """Blocks with any such ray one after another, and in them ray after ray."""
        flags, values = (in_blocks(x, BLOCK) for x in (some, value))

        def block(k: Array, values: Array) -> Array:
            def ray(at: Array, values: Array) -> Array:
                mine = jax.tree.map(lambda x: row(x, k * BLOCK + at), rays)
                return with_row(values, at, function(mine))

            return with_row(values, k, for_each(row(flags, k), ray, row(values, k)))

        return for_each(jnp.any(flags, axis=1), block, varying(values, value)).reshape(-1)[:count]

    def by_blocks(some: Array, value: Array, rays: Any) -> Array:
        """All such rays gathered to full blocks, whose rays go in lockstep."""
        size = min(BLOCK, most)
        order = jnp.pad(jnp.argsort(~some, stable=False).astype(jnp.int32), (0, -count % size))

        def block(k: Array, value: Array) -> Array:
            at = lax.dynamic_slice(order, (k * size,), (size,))
            found = jax.vmap(function)(jax.tree.map(lambda x: x[at], rays))
            return value.at[at].set(jnp.where(some[at], found, value[at]))

        zero = jnp.zeros((), jnp.int32)
        stop = (jnp.sum(some, dtype=jnp.int32) + (size - 1)) // size
        return lax.fori_loop(zero, stop, block, varying(value, some))

    return on_platform(some, value, rays, cpu=one_by_one, default=by_blocks)


def varying(value: T, like: Array) -> T:
    """`value` marked as varying over the mesh axes of `shard_map` that `like` varies over, as loop carries must be."""
    axes = _varying_axes(like)

    def mark(leaf: Array) -> Array:
        missing = tuple(axes - _varying_axes(leaf))
        return lax.pcast(leaf, missing, to="varying") if missing else leaf

    return jax.tree.map(mark, value) if axes else value


def _varying_axes(array: Array) -> frozenset[str]:
    kind = jax.typeof(array)
    if hasattr(kind, "mat"):
        return frozenset(kind.mat.varying)
    return frozenset(getattr(kind, "vma", ()))
