import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

from jaxir._arrays import as_float
from jaxir.optics import attenuate, phi1, phi2, through_layer

DEPTHS = np.concatenate([[0.0], np.logspace(-37, 30, 135), np.linspace(0.3, 0.7, 41)])


def exact(function, u):
    with mpmath.workdps(60):
        return np.array([float(function(mpmath.mpf(float(x)))) for x in u])


def exact_phi1(u):
    return mpmath.mpf(1) if u == 0 else -mpmath.expm1(-u) / u


def exact_phi2(u):
    return mpmath.mpf(1) / 2 if u < 1e-20 else (1 - exact_phi1(u)) / u


@pytest.mark.parametrize("ours, theirs, digits", [(phi1, exact_phi1, 4), (phi2, exact_phi2, 8)])
def test_phi_functions_keep_full_precision_from_zero_to_1e30(ours, theirs, digits, precision):
    u = as_float(DEPTHS)
    np.testing.assert_allclose(ours(u), exact(theirs, np.asarray(u)), rtol=digits * float(jnp.finfo(precision).eps))


def test_derivative_of_phi1_is_phi2_minus_phi1(precision):
    u = as_float(DEPTHS)
    slope, want = jax.jit(lambda u: (jax.vmap(jax.grad(phi1))(u), phi2(u) - phi1(u)))(u)
    thin, thick = DEPTHS < 30, (DEPTHS > 1e3) & (DEPTHS < 1e17)
    np.testing.assert_allclose(slope[thin], want[thin], rtol=3e-5 if precision == "float32" else 1e-13)
    np.testing.assert_allclose(slope[thick], -1 / u[thick] ** 2, rtol=1e-6)
    assert DEPTHS[0] == 0 and float(slope[0]) == -0.5
    assert np.isfinite(slope).all()


def test_attenuation_neither_drifts_nor_cancels(precision):
    u = as_float(np.logspace(-30, 1.9, 65))
    eps = float(jnp.finfo(precision).eps)
    np.testing.assert_allclose(attenuate(jnp.ones_like(u), u), np.exp(-np.asarray(u, float)), rtol=130 * eps)
    thin = as_float(1e-6)
    passed = jax.lax.fori_loop(0, 100000, lambda _, r: attenuate(r, thin), as_float(1.0))
    np.testing.assert_allclose(passed, np.exp(-0.1), rtol=2e-4 if precision == "float32" else 1e-9)


@jax.jit
def both_jacobians(*primals):
    return [jacobian(through_layer, argnums=(0, 1, 2, 3))(*primals) for jacobian in (jax.jacfwd, jax.jacrev)]


@pytest.mark.parametrize("depth", [0.0, 1e-30, 1e-8, 0.1, 0.4999, 0.5, 3.0, 1e4, 1e30])
def test_layer_derivatives_both_modes_are_finite_and_equal_at_any_depth(depth, precision):
    primals = tuple(as_float(x) for x in (0.7, depth, 2.0 * depth, 1.3))
    forward, reverse = both_jacobians(*primals)
    np.testing.assert_allclose(forward, reverse, rtol=1e-6)
    assert np.isfinite(np.asarray(forward)).all()
    behind, mu, j, length = (mpmath.mpf(float(x)) for x in primals)
    with mpmath.workdps(80):
        u = mu * length
        value = mpmath.exp(-u) * behind + length * exact_phi1(u) * j
        by_mu = length * (length * exact_phi2(u) * j - value)
        want = [mpmath.exp(-u), by_mu, length * exact_phi1(u), mpmath.exp(-u) * (j - mu * behind)]
    tolerance = 1e-5 if precision == "float32" else 1e-12
    scale = 1.0 + abs(float(length * value))
    np.testing.assert_allclose(through_layer(*primals), float(value), rtol=tolerance)
    np.testing.assert_allclose(forward, [float(x) for x in want], rtol=tolerance, atol=tolerance * scale)


def test_second_derivative_of_a_layer(x64):
    def radiance(mu):
        return through_layer(as_float(0.7), mu, as_float(2.0), as_float(1.3))

    slope = jax.jit(jax.grad(radiance))
    second = jax.jit(lambda mu: (jax.grad(jax.grad(radiance))(mu), jax.hessian(radiance)(mu)))
    for mu in (0.0, 0.2, 4.0):
        step = 1e-4
        want = (slope(as_float(mu + step)) - slope(as_float(mu - step))) / (2 * step)
        np.testing.assert_allclose(second(as_float(mu)), [want, want], rtol=1e-6)
