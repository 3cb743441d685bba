"""Rays on which something acts, computed apart from those on which nothing does."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool

from jaxir._math import at_once
from jaxir.geometry import varying

BLOCK = (64, 4096)  # least and most rays that are computed together
BLOCK_FLOATS = 1 << 13  # values per ray and node in a block: what a processor's cache holds


def for_active(function: Callable[[Any], Any], active: Bool[Array, " ray"], rays: Any, nodes: int) -> Any:
    """`function(rays)` [ray, node] where rays are active, 0 elsewhere; its time is that of the active rays.

    Rays are sorted into blocks, active ones first, and blocks without an active ray are left out. Differentiable as
    `function`, which is computed again for a gradient.

    Args:
        function: of rays that do not depend on one another; 0 for those that are not active.
        active: whether something acts on a ray.
        rays: arrays [ray, ...].
        nodes: values per ray that `function` returns.
    """
    count = active.shape[0]
    most = min(max(at_once(BLOCK_FLOATS, 1024) // max(nodes, 1), BLOCK[0]), at_once(BLOCK[1]), count)
    upto = jnp.cumsum(active, dtype=jnp.int32)
    number = jnp.arange(count, dtype=jnp.int32)
    place = jnp.where(active, upto - 1, upto[-1] + number - upto)
    blocks = -(-count // most)
    size = -(-count // blocks)
    order = jnp.zeros(blocks * size, jnp.int32).at[place].set(number, unique_indices=True)
    sorted_rays = jax.tree.map(lambda x: x[order].reshape((blocks, size) + x.shape[1:]), rays)
    function = jax.checkpoint(function)
    shape = jax.eval_shape(function, jax.tree.map(lambda x: x[0], sorted_rays))

    def block(some: tuple[Array, Any]) -> Any:
        nothing = varying(jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shape), some[0])
        return lax.cond(some[0] < upto[-1], function, lambda _: nothing, some[1])

    found = lax.map(block, (jnp.arange(blocks, dtype=jnp.int32) * size, sorted_rays))
    return jax.tree.map(lambda x: x.reshape((-1,) + x.shape[2:])[place], found)
