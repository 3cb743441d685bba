"""Small tools that light and geometry both need: vectors, guarded operations, quadrature."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float


def on_platform(*operands: Any, cpu: Callable[..., Any], default: Callable[..., Any]) -> Any:
    """`cpu` of the operands where JAX computes on processors, `default` elsewhere: the same numbers in another order.

    Decided while tracing, by the default device: `lax.platform_dependent` would trace both. A program that is sent to
    another kind of device than the default one is right and slower.
    """
    return (cpu if on_cpu() else default)(*operands)


def on_cpu() -> bool:
    """Whether JAX computes on processors, by the default device."""
    device = getattr(jax.config, "jax_default_device", None)
    return (jax.default_backend() if device is None else getattr(device, "platform", device)) == "cpu"


def at_once(count: int, more: int = 32) -> int:
    """`count` things, whose data a processor's cache holds, or `more` times as many for a card's many threads."""
    return count if on_cpu() else more * count


def safe_sqrt(value: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """Square root with value and derivative 0 where `value` is not positive. Differentiable."""
    return jnp.where(value > 0, jnp.sqrt(jnp.where(value > 0, value, 1)), 0)


def safe_divide(a: Float[Array, "..."], b: Float[Array, "..."]) -> Float[Array, "..."]:
    """a / b, with value and derivatives 0 where b is 0. Differentiable in both."""
    return jnp.where(b != 0, a / jnp.where(b != 0, b, 1), 0)


def scan_anew(step: Callable, init: Any, items: Any, reverse: bool = False) -> tuple[Any, Any]:
    """`lax.scan` whose steps are computed again for a gradient, from what was carried into each.

    To keep every number of a step that its derivative needs makes a program of several times as many kernels.
    """
    return lax.scan(jax.checkpoint(step, prevent_cse=False), init, items, reverse=reverse)


# Products in full precision on every device: by default graphics cards round each factor to 11 bits, which is .0005.
matmul = functools.partial(jnp.matmul, precision=lax.Precision.HIGHEST)
einsum = functools.partial(jnp.einsum, precision=lax.Precision.HIGHEST)
tensordot = functools.partial(jnp.tensordot, precision=lax.Precision.HIGHEST)


INSIDE: dict[str, Any] = {"mode": "promise_in_bounds", "wrap_negative_indices": False}
"""Of places known to lie in a table, for `.at[place].get` and `.add`: neither checked nor counted from its end."""


@functools.cache
def gauss_legendre(points: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights [point] of Gauss-Legendre quadrature on [0, 1], on the host in double precision."""
    node, weight = np.polynomial.legendre.leggauss(points)
    return (node + 1) / 2, weight / 2


def middles(count: int) -> np.ndarray:
    """Those of the count^2 equal parts of a square of side 1 [part, 2]."""
    return (np.indices((count, count)).reshape(2, -1).T + 0.5) / count


def in_kernels(value: Float[Array, "ray *more"]) -> Float[Array, "ray *more"]:
    """`value` as it is, on a CPU in a way that keeps XLA from making one function of the loop around it.

    A loop of small arrays is best one native function. Of one that holds a whole image's work the compiler makes a
    function of some ten thousand lines, on one core, which takes as long as all else and runs no faster; it does not
    where a loop sorts, nor, for the transpose, where it scatters. So two numbers are sorted by their places.
    """
    if not on_cpu():
        return value
    first = lax.slice_in_dim(value, 0, min(2, value.shape[0]))
    flat = first.reshape(first.shape[0], -1)[:, 0]
    again = lax.sort((jnp.arange(flat.shape[0], dtype=jnp.int32), flat), num_keys=1)[1]
    kept = again.reshape((-1,) + (1,) * (value.ndim - 1))
    return lax.dynamic_update_slice(value, kept, (0,) * value.ndim)


def sum_before(layers: Float[Array, "..."], axis: int) -> Float[Array, "..."]:
    """Sum of the layers in front of each along an axis.

    Not the sum up to it less its own, which an opaque layer would swallow.
    """
    sums = jnp.cumsum(layers, axis=axis)
    first = jnp.zeros_like(lax.slice_in_dim(sums, 0, 1, axis=axis))
    return jnp.concatenate([first, lax.slice_in_dim(sums, 0, -1, axis=axis)], axis=axis)


def dot(a: Float[Array, "*#batch 3"], b: Float[Array, "*#batch 3"]) -> Float[Array, "*batch"]:
    """Scalar product of vectors [*batch]."""
    # written out: XLA's CPU code for a sum over a last axis of length 3 takes eight times as long
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


@jax.jit
def radius_about(points: Float[Array, "point 3"], centre: Float[Array, " 3"]) -> Float[Array, ""]:
    """Largest distance of points from a centre."""
    offset = points - centre[None, :]
    return jnp.sqrt(jnp.max(dot(offset, offset)))


def frame_around(normal: Float[Array, " 3"]) -> Float[Array, "3 3"]:
    """Right-handed orthonormal frame whose third row is `normal`.

    The construction of Duff et al., "Building an orthonormal basis, revisited" (JCGT 6(1), 2017): no direction is
    singular, and rows are orthonormal to rounding; the tangents jump once, where normal z changes sign.

    Args:
        normal: unit vector [3].

    Returns:
        Rows tangent, bitangent, normal [3, 3]; `local @ frame` carries local coordinates to the scene and
        `frame @ vector` carries back.

    Differentiable in normal away from the jump.
    """
    x, y, z = normal[0], normal[1], normal[2]
    sign = jnp.where(z >= 0, 1, -1).astype(normal.dtype)
    a = -1 / (sign + z)
    b = x * y * a
    tangent = jnp.stack([1 + sign * x * x * a, sign * b, -sign * x])
    bitangent = jnp.stack([b, sign + y * y * a, -y])
    return jnp.stack([tangent, bitangent, normal])
