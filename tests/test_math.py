"""Guarded operations: values and derivatives at the singular place."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxir._math import gauss_legendre, safe_divide, safe_sqrt


def test_square_root_and_quotient_are_finite_at_zero(precision):
    value, slope = jax.vmap(jax.value_and_grad(safe_sqrt))(jnp.asarray([0.0, 4.0, -1.0]))
    assert value.tolist() == [0.0, 2.0, 0.0] and slope.tolist() == [0.0, 0.25, 0.0]
    for b, expected in ((0.0, (0.0, 0.0, 0.0)), (2.0, (1.5, 0.5, -0.75))):
        value, slopes = jax.value_and_grad(safe_divide, argnums=(0, 1))(jnp.asarray(3.0), jnp.asarray(b))
        assert (float(value), *map(float, slopes)) == pytest.approx(expected)


def test_gauss_legendre_is_exact_for_polynomials():
    node, weight = gauss_legendre(4)
    np.testing.assert_allclose([weight @ node**k for k in range(8)], 1 / np.arange(1, 9), rtol=1e-14)
