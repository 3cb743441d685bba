"""The quadratic heuristic (9)."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxir import transport

mis_weight = jax.jit(transport.mis_weight, static_argnums=(0, 2))


def test_weights_share_every_direction(precision):
    p = jnp.asarray([0.0, 1e-30, 0.3, 2.0, 1e30, 0.0])
    q = jnp.asarray([1.0, 1e-30, 0.7, 0.0, 1e30, 0.0])
    a, b = mis_weight(3, p, 2, q), mis_weight(2, q, 3, p)
    np.testing.assert_allclose((a + b)[:5], 1, rtol=1e-6)
    np.testing.assert_allclose(a[2], 0.81 / (0.81 + 1.96), rtol=1e-6)
    np.testing.assert_allclose(a[1], 9 / 13, rtol=1e-6)
    assert a[5] == 0 and b[5] == 0
    assert np.all(np.isfinite(jax.grad(lambda p: mis_weight(3, p, 2, q + 1e-12).sum())(jnp.clip(p, 0, 1e9))))
