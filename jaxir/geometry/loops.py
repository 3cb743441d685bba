"""Small pieces of the search loops, in forms that XLA compiles to native code."""

from __future__ import annotations

from typing import TypeVar

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

T = TypeVar("T")


def row(table: Array, index: Int[Array, ""]) -> Array:
    """Row `index` of a table [row, lane], int32 also where integers default to 64 bits."""
    zero = jnp.zeros((), jnp.int32)
    return lax.dynamic_slice(table, (index, zero), (1, table.shape[1]))[0]


def item(table: Array, *index: Int[Array, ""]) -> Array:
    """One element of a table, as a slice rather than a gather."""
    return lax.dynamic_slice(table, index, (1,) * table.ndim).reshape(())


def lowest_bit(mask: Int[Array, ""]) -> Int[Array, ""]:
    """Position of the lowest set bit."""
    return lax.population_count((mask & -mask) - 1)


def bits(flags: Array) -> Int[Array, ""]:
    """Flags [16] as the bits of one integer."""
    value = jnp.left_shift(jnp.int32(1), jnp.arange(flags.shape[0], dtype=jnp.int32))
    return jnp.sum(jnp.where(flags, value, jnp.int32(0)), dtype=jnp.int32)


def smallest(values: Float[Array, " lane"]) -> Float[Array, ""]:
    """Minimum by halving: a reduction of floats is otherwise compiled to a scalar chain."""
    while values.shape[0] > 16 and values.shape[0] % 2 == 0:
        half = values.shape[0] // 2
        values = jnp.minimum(values[:half], values[half:])
    return jnp.min(values)


def largest(values: Float[Array, " lane"]) -> Float[Array, ""]:
    """Maximum by halving, as `smallest`."""
    return -smallest(-values)


def octant(direction: Float[Array, " 3"]) -> Int[Array, ""]:
    """Number of the octant of a direction, as the tree's tables are sorted."""
    return jnp.sum(jnp.where(direction < 0, jnp.asarray([1, 2, 4], jnp.int32), jnp.int32(0)), dtype=jnp.int32)


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
