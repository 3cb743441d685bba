"""Weights of levels, against scipy's splines."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from jaxir.optics.gas._spline import spline_slopes, spline_weights


@pytest.mark.parametrize("count", [1, 2, 3, 4, 12, 23])
def test_weights_are_those_of_a_spline_with_tangents_at_its_ends(precision, count):
    """Single precision errs in the last places, however many levels there are."""
    levels = -1000.0 / np.linspace(250.0, 3000.0, count)
    slopes = spline_slopes(levels)
    place = np.linspace(-6.0, 0.2, 801).astype(precision)
    both = jax.jit(
        lambda p: jax.jvp(lambda p: spline_weights(jnp.asarray(levels), slopes, p), (p,), (jnp.ones_like(p),))
    )
    own, slope = both(jnp.asarray(place))
    held = np.clip(place.astype(float), levels[0], levels[-1])
    if count == 1:
        expected, known = np.ones((801, 1)), np.zeros((801, 1))
    else:
        spline = make_interp_spline(levels, np.eye(count), k=min(3, count - 1))
        known = spline(held, nu=1)
        expected = spline(held) + (place - held)[:, None] * known
    assert own.dtype == slope.dtype == precision
    error = 32 * np.finfo(precision).eps + (1e-9 if count > 20 else 1e-12)  # of the slopes, found on the host
    for found, exact in ((own, expected), (slope, known)):
        assert np.all(np.abs(found - exact).max(axis=1) <= error * np.abs(exact).sum(axis=1))


def test_second_derivatives_are_right_at_the_levels(x64):
    """The piece ends there, and the next begins with the same one."""
    levels = -1000.0 / np.linspace(250.0, 3000.0, 12)
    slopes, place = spline_slopes(levels), np.sort(np.concatenate([levels[1:-1], levels[1:] - 0.01]))
    weights = lambda p: spline_weights(jnp.asarray(levels), slopes, p)  # noqa: E731
    found = jax.jit(jax.vmap(jax.jacfwd(jax.jacfwd(weights))))(jnp.asarray(place))
    exact = make_interp_spline(levels, np.eye(12))(place, nu=2)
    np.testing.assert_allclose(found, exact, atol=1e-9 * np.abs(exact).max())
