"""Smooth interpolation of tables over a few levels.

Between neighbouring levels a cubic is told by its values and slopes there (Hermite), and the slopes of a spline are a
matrix times the values. So each weight is a sum of terms of order one that live on two pieces, and single precision
errs in the last places; sums of truncated powers (u - u_k)^3, which cancel, err by 1e-5 to 4e-4.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxir._arrays import as_float, as_one_program
from jaxir._math import matmul


def spline_slopes(levels: np.ndarray) -> np.ndarray:
    """Slopes at the levels by values there [level, level], on the host.

    Args:
        levels: increasing [level]. From four levels on of a cubic spline without a break at the second and the last but
            one, below that of one polynomial through all.

    Returns:
        The matrix for `spline_weights`.
    """
    u = levels - levels[0]
    past = np.maximum(u[:, None] - u[2:-2], 0)
    power = np.arange(min(4, u.size))
    value = np.concatenate([u[:, None] ** power, past**3], axis=1)
    slope = np.concatenate([power * u[:, None] ** np.maximum(power - 1, 0), 3 * past**2], axis=1)
    return slope @ np.linalg.inv(value)


@as_one_program
def spline_weights(
    levels: Float[Array, " level"], slopes: Float[Array, "level level"], place: Float[Array, "*cell"]
) -> Float[Array, "*cell level"]:
    """Weights of the levels at `place` [*cell, level]; beyond the ends the spline is continued by its tangents.

    With the distance d from a level and its share s of the way to the next, or to the last,

        w_i = phi_i + sum_j psi_j slope_ji,    phi = (1 + 2 s) (1 - s)^2,    psi = d (1 - s)^2.

    Differentiable in `place`, twice continuously between the ends and once there.
    """
    cell = (1,) * place.ndim + levels.shape
    apart = place[..., None] - levels.reshape(cell)
    step = jnp.diff(levels)
    end = jnp.full_like(levels[:1], jnp.inf)  # beyond it the tangent: s = 0
    after, before = (jnp.concatenate(pair) for pair in ((step, end), (end, step)))
    past = apart > 0
    edge = [(0, 0)] * place.ndim
    next_past = jnp.pad(past[..., 1:], [*edge, (0, 1)])
    last_past = jnp.pad(past[..., :-1], [*edge, (1, 0)], constant_values=True)
    ends = jnp.where(past, ~next_past, last_past)  # of the piece; at its upper end the share of the lower one is 1
    share = jnp.where(ends, apart / jnp.where(past, after.reshape(cell), -before.reshape(cell)), 1)
    falls = (1 - share) ** 2
    tangents = matmul(apart * falls, as_float(slopes))
    return (1 + 2 * share) * falls + tangents
