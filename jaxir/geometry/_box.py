"""Points of boxes, and how densely they lie in a direction."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

LEAST_SLOPE = 1e-12  # of a ray against the sides of a box: 1 / slope and any length over it stay finite


def sample_box(u: Float[Array, " 3"], half: Float[Array, " 3"]) -> Float[Array, " 3"]:
    """A point uniform in the volume of a box about the origin with half edges `half` [3] [m]."""
    return (2 * u - 1) * half


def pdf_box(half: Float[Array, "3 box"]) -> Float[Array, " box"]:
    """Density of `sample_box` for boxes side by side [box]: 1 / volume [m-3]."""
    return 1 / (8 * half[0] * half[1] * half[2])


def box_chord(
    offset: Float[Array, "3 box"], half: Float[Array, "3 box"], direction: Float[Array, " 3"]
) -> tuple[Float[Array, " box"], Float[Array, " box"]]:
    """Where a ray is inside boxes.

    Args:
        offset: from the ray's origin to the boxes' centres, along the boxes' edges [3, box] [m].
        half: half edges [3, box] [m].
        direction: unit vector in the same frame [3].

    Returns:
        Distances at which the ray enters and leaves, not before its origin [box] [m]; equal on a miss.
    """
    near, far = jnp.zeros_like(offset[0]), jnp.full_like(offset[0], jnp.inf)
    for axis in range(3):
        slope = direction[axis]
        inverse = 1 / jnp.where(jnp.abs(slope) < LEAST_SLOPE, LEAST_SLOPE, slope)
        middle, reach = offset[axis] * inverse, half[axis] * jnp.abs(inverse)
        near, far = jnp.maximum(near, middle - reach), jnp.minimum(far, middle + reach)
    return near, jnp.maximum(near, far)


def pdf_from_volume(
    pdf_volume: Float[Array, "*box"], near: Float[Array, "*box"], far: Float[Array, "*box"]
) -> Float[Array, "*box"]:
    """Density per solid angle of points drawn per volume from a convex body.

    integral from near to far of pdf_volume t^2 dt, in a form that keeps its digits where the chord is short.

    Args:
        pdf_volume: inside the body [*box] [m-3].
        near: where the ray enters it [*box] [m].
        far: where the ray leaves it [*box] [m]; `near` on a miss.

    Returns:
        [*box] [sr-1].
    """
    return pdf_volume * (far - near) * (far * far + far * near + near * near) / 3
