"""Distribution of the absorption coefficient in a narrow band of Malkmus' statistical model.

Malkmus' mean transmittance of a path of mean optical depth X through lines of mean overlap b,

    -ln T(X) = (b / 2) (sqrt(1 + 4 X / b) - 1),

is the Laplace transform of an inverse Gaussian distribution: k = k_mean y, where y has mean 1, shape b / 2 and

    g(y) = Phi(sqrt(b / 2y) (y - 1)) + e^b Phi(-sqrt(b / 2y) (y + 1)).

Its inverse ln y(g, b) has no closed form. It is a polynomial in Phi^-1(g) and ln b, interpolated once on the
host; it errs by less than 1e-3 (rms 2e-4) for 1e-5 < b < 1e4.
"""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtri
from jaxtyping import Array, Float

from jaxir._arrays import as_float, as_one_program
from jaxir._math import matmul

_PROBIT = (-3.1, 5.6)  # Phi^-1 of g = 0.001 ... 1 - 1e-8
_LOG_B = (-12.0, 9.5)
_TERMS = (40, 22)


def inverse_gaussian_cdf(y: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """g(y) and 1 - g(y) of the distribution at the head of this file, on the host in double precision."""
    from scipy.special import erfcx, ndtr  # here, because fits to tables ask for it alone

    root = np.sqrt(b / (2 * y))
    near, far = root * (y - 1), root * (y + 1)
    # e^b Phi(-far) overflows times underflows; far^2 / 2 - b = near^2 / 2 joins the exponents.
    reflected = 0.5 * erfcx(far / np.sqrt(2)) * np.exp(-(near**2) / 2)
    return ndtr(near) + reflected, ndtr(-near) - reflected


def log_quantile_exact(probit: np.ndarray, log_b: np.ndarray) -> np.ndarray:
    """ln y where the distribution function is Phi(probit), by bisection on the host."""
    from scipy.special import ndtr

    probit, log_b = np.broadcast_arrays(probit, log_b)
    low, high = np.full(probit.shape, -40.0), np.full(probit.shape, 20.0)
    for _ in range(60):
        middle = (low + high) / 2
        below, above = inverse_gaussian_cdf(np.exp(middle), np.exp(log_b))
        too_low = np.where(probit < 0, below < ndtr(probit), above > ndtr(-probit))
        low, high = np.where(too_low, middle, low), np.where(too_low, high, middle)
    return (low + high) / 2


@functools.cache
def _series() -> np.ndarray:
    """Chebyshev coefficients of ln y in the scaled probit [term], at the points of `_newton` in scaled ln b [point]."""
    chebyshev = np.polynomial.chebyshev
    angle = np.cos(np.pi * (np.arange(_TERMS[0]) + 0.5) / _TERMS[0])
    point = _newton()[0]
    value = log_quantile_exact(_unscale(angle, _PROBIT)[:, None], _unscale(point, _LOG_B)[None, :])
    return np.linalg.solve(chebyshev.chebvander(angle, _TERMS[0] - 1), value)


@functools.cache
def _newton() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of Newton's interpolation in Leja's order, values -> coefficients, coefficients -> their derivative's."""
    count = _TERMS[1]
    left = list(np.cos(np.pi * (np.arange(count) + 0.5) / count))
    point = [left.pop(0)]
    while left:
        distance = [np.prod(np.abs(x - np.array(point))) for x in left]
        point.append(left.pop(int(np.argmax(distance))))
    x = np.array(point)
    basis = np.cumprod(np.concatenate([np.ones((count, 1)), x[:, None] - x[None, :-1]], axis=1), axis=1)
    slope = np.zeros((count, count))  # d/dt of prod (t - x_j), by the product rule
    for k in range(1, count):
        slope[:, k] = slope[:, k - 1] * (x - x[k - 1]) + basis[:, k - 1]
    to_coefficient = np.linalg.inv(basis)
    return x, to_coefficient, to_coefficient @ slope


def _unscale(t: np.ndarray, limits: tuple[float, float]) -> np.ndarray:
    return limits[0] + (limits[1] - limits[0]) * (t + 1) / 2


@as_one_program
def quantile_series(g: Float[Array, " node"]) -> Float[Array, "term node"]:
    """Newton coefficients of ln y as a function of ln b, for quantiles `g` inside (0.001, 1 - 1e-8)."""
    scaled = (2 * ndtri(g) - (_PROBIT[0] + _PROBIT[1])) / (_PROBIT[1] - _PROBIT[0])
    order = jnp.arange(_TERMS[0], dtype=g.dtype)
    polynomial = jnp.cos(order[:, None] * jnp.arccos(jnp.clip(scaled, -1, 1))[None, :])
    table = as_float((_series() @ _newton()[1].T).T)
    return matmul(table, polynomial)


@as_one_program
def log_quantile(series: Float[Array, "term node"], log_b: Float[Array, "*cell node"]) -> Float[Array, "*cell node"]:
    """ln y at ln b, the same in every cell but for b.

    Args:
        series: `quantile_series` of the nodes.
        log_b: ln b; beyond -12 and 9.5 the distribution is that of the limit (there y is 0.99-1.01 or the lines are
            so narrow that only their wings act).

    Returns:
        ln y.

    Differentiable in `log_b`; not in the series, which belongs to the quadrature.
    """
    scale = 2 / (_LOG_B[1] - _LOG_B[0])
    return _polynomial(series, jnp.clip(scale * (log_b - _LOG_B[0]) - 1, -1, 1))


# Newton's form in Leja's order is as stable as Chebyshev's and, unlike Clenshaw's recurrence, one chain of
# multiply-adds, which compiles into a single loop over cells and nodes. The derivative is a polynomial of its own;
# differentiating the chain would keep every link for every cell.
@jax.custom_jvp
def _polynomial(series: Array, t: Array) -> Array:
    node = (1,) * (t.ndim - 1) + series.shape[1:]
    point = _newton()[0].tolist()
    value = jnp.zeros_like(t)
    for k in range(_TERMS[1] - 1, -1, -1):
        value = value * (t - point[k]) + series[k].reshape(node)
    return value


@_polynomial.defjvp
def _polynomial_jvp(primals: tuple, tangents: tuple) -> tuple:
    series, t = primals
    derivative = matmul(as_float(_newton()[2]), series)
    return _polynomial(series, t), _polynomial(derivative, t) * tangents[1]
