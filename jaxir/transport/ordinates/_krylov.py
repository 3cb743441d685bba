"""Linear equations of many nodes at once, solved by a method in whose program the operator stands once.

    x = b + K x

is solved for each node by itself by generalised conjugate residuals (Eisenstat, Elman and Schultz, SIAM J. Numer.
Anal. 20, 1983, 345), truncated: each new direction is made orthogonal, in what 1 - K makes of it, to the last `KEPT`
ones. The residual never grows, and nodes in which little is scattered end with the first steps.
"""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Shaped

KEPT = 3  # more take as many steps: K is nearly its own transpose
PATIENCE = 16  # steps in which the residual has to fall, in one node at least


def solved(
    applied: Callable[[Array], Array],
    begin: Float[Array, "*part node"],
    close: Float[Array, ""] | float,
    most: int,
    near: Float[Array, "*part node"] | None = None,
) -> tuple[Float[Array, "*part node"], Float[Array, ""]]:
    """The solution of x = begin + K x, with what it lacks.

    Args:
        applied: K, a linear operator of tables that acts on each node by itself.
        begin: b.
        close: residual at which to end, as a share of b: root mean square, in the worst node.
        most: applications of K at most; fewer where `PATIENCE` of them no longer halve the squared residual.
        near: a table that the solution may be near to, which is the first direction; zeros where there is none.

    Returns:
        x, and its residual in those terms. Differentiable in b and in what `applied` holds, in both modes.
    """
    guess = jnp.zeros_like(begin) if near is None else lax.stop_gradient(near)
    guessed = _shaped(jnp.any((guess != 0).reshape(-1, guess.shape[-1]), axis=0), guess)

    def lacking(table: Array) -> Array:
        return table - applied(table)

    def solve(operator: Callable, b: Array) -> tuple[Array, Array]:
        squared = _dot(b, b)
        size = jnp.where(squared > 0, squared, 1)
        none = jnp.zeros((KEPT, *b.shape), b.dtype)
        sizes = jnp.ones((KEPT, size.shape[0]), b.dtype)
        state = jnp.int32(0), jnp.zeros_like(b), b, none, none, sizes, squared, 4 * size

        def going_on(state: tuple) -> Array:
            count, *_, left, before = state
            falls = (count % PATIENCE != 0) | (left < before / 2)
            return (count < most) & jnp.any((left > close**2 * size) & falls)

        def step(state: tuple) -> tuple:
            count, x, residual, ways, images, sizes, left, before = state
            way = jnp.where(guessed & (count == 0), guess, residual)
            image = operator(way)
            for k in range(KEPT):
                share = _dot(image, images[k]) / sizes[k]
                way, image = way - _along(share, ways[k]), image - _along(share, images[k])
            long = _dot(image, image)
            long = jnp.where(long > 0, long, 1)
            share = _dot(residual, image) / long
            place = count % KEPT
            residual = residual - _along(share, image)
            return (
                count + 1,
                x + _along(share, way),
                residual,
                lax.dynamic_update_index_in_dim(ways, way, place, 0),
                lax.dynamic_update_index_in_dim(images, image, place, 0),
                lax.dynamic_update_index_in_dim(sizes, long, place, 0),
                _dot(residual, residual),
                jnp.where(count % PATIENCE == 0, left, before),
            )

        _, x, *_, left, _ = lax.while_loop(going_on, step, state)
        return x, jnp.max(jnp.sqrt(left / size))

    return lax.custom_linear_solve(lacking, begin, solve, solve, has_aux=True)


def _dot(a: Float[Array, "*part node"], b: Float[Array, "*part node"]) -> Float[Array, " node"]:
    return jnp.sum((a * b).reshape(-1, a.shape[-1]), axis=0)


def _along(share: Float[Array, " node"], table: Float[Array, "*part node"]) -> Array:
    return _shaped(share, table) * table


def _shaped(share: Shaped[Array, " node"], table: Float[Array, "*part node"]) -> Array:
    return share.reshape((1,) * (table.ndim - 1) + (-1,))
