import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ndtr, ndtri

from jaxir.optics.gas import inverse_gaussian_cdf, log_quantile, log_quantile_exact, quantile_series
from jaxir.optics.spectrum import quantiles


def malkmus(depth, b):
    return np.exp(-b / 2 * np.expm1(0.5 * np.log1p(4 * depth / b)))


@pytest.mark.parametrize("log_b", [-6.0, -2.0, 0.0, 3.0])
def test_distribution_is_the_inverse_laplace_transform_of_malkmus(log_b):
    b = np.exp(log_b)
    y = np.exp(np.linspace(-30, 16, 200001))
    g, _ = inverse_gaussian_cdf(y, np.array(b))
    middle = np.sqrt(y[1:] * y[:-1])
    for depth in (0.01, 1.0, 30.0):
        integral = np.sum(np.exp(-depth * middle) * np.diff(g))
        assert integral == pytest.approx(malkmus(depth, b), rel=1e-5)


def test_both_tails_are_exact():
    b = np.array([1e-3, 1.0, 200.0])
    for probit in (-2.5, 0.0, 4.5):
        y = np.exp(log_quantile_exact(np.full(3, probit), np.log(b)))
        below, above = inverse_gaussian_cdf(y, b)
        assert np.allclose(above if probit > 0 else below, ndtr(-abs(probit)), rtol=1e-8)


def test_series_follows_the_exact_quantile(precision):
    g = quantiles(12)[0]
    log_b = np.linspace(-12, 9.5, 87)
    exact = log_quantile_exact(ndtri(g)[None, :], log_b[:, None])
    dtype = np.dtype(precision)
    series = quantile_series(jnp.asarray(g, dtype))
    got = log_quantile(series, jnp.broadcast_to(jnp.asarray(log_b, dtype)[:, None], exact.shape))
    assert got.dtype == dtype
    error = np.abs(np.asarray(got) - exact)
    # 1 - g of the last quantile is 8e-7: float32 has three digits of it left (and its weight is 3e-5).
    assert error[:, :-1].max() < 1.5e-3 and error[:, -1].max() < (1e-2 if precision == "float32" else 1.5e-3)
    assert np.sqrt(np.mean(error[:, :-1] ** 2)) < 4e-4


@pytest.mark.parametrize(("points", "rms"), [(6, 0.05), (8, 0.02), (12, 0.004)])
def test_few_quantiles_give_malkmus_emissivity(points, rms):
    g, weight = quantiles(points)
    series = quantile_series(jnp.asarray(g, np.float32))
    log_b = np.arange(-6, 4.5, 0.5)
    y = np.exp(log_quantile(series, jnp.broadcast_to(jnp.asarray(log_b, np.float32)[:, None], (21, points))))
    depth = np.exp(np.arange(-4, 6, 0.5))
    exact = 1 - malkmus(depth[:, None], np.exp(log_b)[None, :])
    got = np.einsum("g,xbg->xb", weight, -np.expm1(-depth[:, None, None] * y[None]))
    assert np.sqrt(np.mean((got / exact - 1) ** 2)) < rms


def test_eight_quantiles_are_within_three_per_mille_where_lines_overlap():
    """At any depth for b >= e^-2; narrower lines have a tail that 8 points cannot follow (5-10 % at b = e^-6)."""
    g, weight = quantiles(8)
    series = quantile_series(jnp.asarray(g, np.float32))
    log_b, depth = np.arange(-2, 6.1, 0.5), np.exp(np.arange(-5, 6.1, 0.5))

    def error(log_b):
        y = np.exp(log_quantile(series, jnp.broadcast_to(jnp.asarray(log_b, np.float32)[:, None], (log_b.size, 8))))
        got = np.einsum("g,xbg->xb", weight, -np.expm1(-depth[:, None, None] * y[None]))
        return np.abs(got / (1 - malkmus(depth[:, None], np.exp(log_b)[None, :])) - 1).max()

    assert error(log_b) < 3e-3 < 0.05 < error(np.array([-6.0]))


@pytest.mark.parametrize(("points", "share"), [(8, (0.0025, 0.011, 0.042, 0.24)), (12, (0.001, 0.005, 0.016, 0.1))])
def test_what_passes_a_deep_layer_errs_as_said(points, share):
    """Of the transmittance itself, up to -ln T = 1, 2, 3 and 4.6, for b >= e^-2: no more, and not much less."""
    g, weight = quantiles(points)
    b = np.exp(np.arange(-2, 4.1, 0.5))[:, None]
    y = np.exp(log_quantile_exact(np.broadcast_to(ndtri(g), (b.size, points)), np.log(b)))
    for most, bound in zip((1.0, 2.0, 3.0, 4.6), share, strict=True):
        thick = np.linspace(0.05, most, 60)[None] + 0 * b
        depth = ((2 * thick / b + 1) ** 2 - 1) * b / 4  # of the mean coefficient
        got = np.sum(weight * np.exp(-depth[..., None] * y[:, None]), axis=-1)
        error = np.abs(got / np.exp(-thick) - 1).max()
        assert bound / 4 < error < bound
        assert np.abs(got - np.exp(-thick)).max() < 2.5e-3


def test_slope_and_curvature_match_differences(x64):
    series = quantile_series(jnp.asarray(quantiles(8)[0]))
    t = jnp.linspace(-11.5, 9.0, 30)[:, None] * jnp.ones((1, 8))
    ones = jnp.ones_like(t)

    def slope(x):
        return jax.jvp(lambda b: log_quantile(series, b), (x,), (ones,))[1]

    step = 1e-5
    for function, derivative in (
        (lambda x: log_quantile(series, x), slope),
        (slope, lambda x: jax.jvp(slope, (x,), (ones,))[1]),
    ):
        central = (function(t + step) - function(t - step)) / (2 * step)
        assert np.allclose(derivative(t), central, rtol=1e-6, atol=1e-7)
    reverse = jax.grad(lambda x: log_quantile(series, x).sum())(t)
    assert np.allclose(reverse, slope(t), rtol=1e-12)
