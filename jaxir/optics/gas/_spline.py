"""Smooth interpolation of tables over a few levels."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxir._arrays import as_float, as_one_program


def spline_matrix(levels: np.ndarray) -> np.ndarray:
    """From spline features to weights of the levels [feature, level], on the host.

    Args:
        levels: increasing [level]. From four levels on a cubic spline without a break at the second and the last but
            one, below that one polynomial through all.

    Returns:
        The matrix for `spline_weights`.
    """
    u = levels - levels[0]
    powers = u[:, None] ** np.arange(min(4, u.size))
    return np.linalg.inv(np.concatenate([powers, np.maximum(u[:, None] - u[2:-2], 0) ** 3], axis=1))


@as_one_program
def spline_weights(
    levels: Float[Array, " level"], matrix: Float[Array, "level level"], place: Float[Array, "*cell"]
) -> Float[Array, "*cell level"]:
    """Weights of the levels at `place` [*cell, level]; beyond the ends the spline is continued by its tangents.

    Differentiable in `place`, once continuously at the ends.
    """
    u, last = place - levels[0], levels[-1] - levels[0]
    held = jnp.clip(u, 0, last)
    knots = levels[2:-2] - levels[0]
    past = [jnp.maximum(held - knots[i], 0) for i in range(knots.shape[0])]
    count = min(4, levels.shape[0])
    value = [jnp.ones_like(u), held, held**2, held**3][:count] + [p**3 for p in past]
    slope = [jnp.zeros_like(u), jnp.ones_like(u), 2 * held, 3 * held**2][:count] + [3 * p**2 for p in past]
    features = jnp.stack(value, axis=-1) + (u - held)[..., None] * jnp.stack(slope, axis=-1)
    return jnp.matmul(features, as_float(matrix), precision=jax.lax.Precision.HIGHEST)
