import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxir.optics.gas import combustion_products


@pytest.mark.parametrize(("phi", "co2", "h2o"), [(0.25, 0.0321, 0.0385), (0.5, 0.0630, 0.0754), (0.75, 0.0905, 0.1089)])
def test_pentane_in_air(phi, co2, h2o):
    # equilibrium composition at the adiabatic flame temperature from 650 K, 2 bar
    got = combustion_products(5, 12, phi)
    assert float(got.co2) == pytest.approx(co2, rel=0.03) and float(got.h2o) == pytest.approx(h2o, rel=0.03)
    assert float(got.h2o / got.co2) == pytest.approx(6 / 5)
    assert float(sum(got)) == pytest.approx(1)


def test_ends_of_the_range_and_fields(precision):
    got = combustion_products(12, 23, jnp.asarray([0.0, 1.0]))
    assert np.allclose(got.o2, [0.20947, 0.0], atol=1e-4) and float(got.co2[0]) == 0
    assert got.h2o.dtype == np.dtype(precision) and np.allclose(sum(got), 1)


def test_gradient(x64):
    slope = jax.grad(lambda phi: combustion_products(5, 12, phi).co2)(0.5)
    step = 1e-6
    central = [combustion_products(5, 12, 0.5 + d).co2 for d in (step, -step)]
    assert float(slope) == pytest.approx(float(central[0] - central[1]) / (2 * step), rel=1e-8)


@pytest.mark.parametrize("arguments", [(0, 0, 0.5), (-1, 4, 0.5), (5, 12, 1.2), (5, 12, [0.1, -0.1])])
def test_bad_input_is_refused(arguments):
    with pytest.raises(ValueError, match="got"):
        combustion_products(*arguments)
