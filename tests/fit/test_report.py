"""A fit's report: whether the model explains the data, what stands out, what is at a bound, what is open."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

import jaxir
from jaxir.fit import Bounds, Factor, NormalPrior, fit, measured_image, prepare, solve
from tests.fit.slabs import DEPTH, TEMPERATURE, looked_at, slab

THREE = (jaxir.SWIR, jaxir.MWIR, jaxir.LWIR)


def with_value(measurement, change):
    value = np.array(measurement.value)
    return eqx.tree_at(lambda m: m.value, measurement, jnp.asarray(change(value)))


def test_two_equal_numbers_leave_both_unknowns_open(precision):
    # the solver runs to great depth, where nothing depends on it and the temperature looks determined
    one = looked_at(slab(1000.0, 1.0), (jaxir.MWIR,))
    found = fit(slab(600.0, 3.0), [TEMPERATURE, DEPTH], [one, one])
    assert found.uncertainty.standard_deviation[0] < 0.01
    true = 1000.0 / 600.0
    low, high = np.asarray(found.reach)[:, 0]
    assert low < true < high
    assert found.standard_deviation[0] > 0.1 and np.isinf(found.standard_deviation[1])
    assert "not determined: temperature from" in str(found) and "depth" in found.uncertainty.undetermined()[0]


def test_a_good_fit_says_so_and_an_outlier_is_named():
    measured = looked_at(slab(1000.0, 1.0), THREE)
    good = fit(slab(800.0, 0.5), [TEMPERATURE, DEPTH], [measured])
    assert good.probability > 0.9 and "the data are explained" in str(good)
    bad = fit(slab(800.0, 0.5), [TEMPERATURE], [with_value(measured, lambda v: v * np.array([[1.0, 1.0, 3.0]]))])
    assert bad.probability < 1e-6
    said = str(bad)
    assert "THE MODEL DOES NOT EXPLAIN THE DATA" in said and "measurement 0, row 0, LWIR" in said


def test_a_prior_that_contradicts_the_data_is_named():
    measured = looked_at(slab(1000.0, 1.0), THREE)
    found = fit(slab(800.0, 0.5), [TEMPERATURE, DEPTH], [measured], priors={"depth": NormalPrior(9.0, 0.5)})
    np.testing.assert_allclose(found.prior_residual["depth"], (found.uncertainty.value[1:] - 9.0) / 0.5, rtol=1e-3)
    assert "THE MODEL DOES NOT EXPLAIN THE DATA" in str(found) and "prior of depth" in str(found)


def test_bands_may_have_standard_deviations_of_their_own():
    each = measured_image(jaxir.orthographic_camera(0.0, 0.0, 0.1, (2, 2)), THREE, np.ones((2, 2, 3)), [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(each.standard_deviation, np.tile(np.float32([0.1, 0.2, 0.3]), (4, 1)))


def test_few_outliers_suggest_a_robust_loss():
    value = np.tile(looked_at(slab(1000.0, 1.0), THREE).value.reshape(1, 1, 3), (7, 1, 1))
    spread = 0.01 * value
    value[6, 0, 2] *= 1.4
    among = [measured_image(jaxir.orthographic_camera(0.0, 0.0, 0.1, (7, 1)), THREE, value, spread)]
    squares = fit(slab(800.0, 1.0), [TEMPERATURE], among)
    assert "try robust=3" in str(squares) and "measurement 0, row 6, LWIR" in str(squares)
    robust = fit(slab(800.0, 1.0), [TEMPERATURE], among, robust=3.0)
    assert "try robust=3" not in str(robust)
    assert abs(float(robust.uncertainty.value[0]) - 1.25) < abs(float(squares.uncertainty.value[0]) - 1.25) + 1e-4


def test_standard_deviations_of_a_robust_fit_cover_what_outliers_do():
    rng, truth = np.random.default_rng(3), float(looked_at(slab(1000.0, 1.0), THREE[:1]).value[0, 0])
    value = truth * (1 + 0.01 * rng.normal(size=(50, 48)))
    value[:, ::8] += 0.1 * truth * rng.choice([-1, 1], (50, 6))  # an eighth, ten standard deviations off
    value = value[:, :, None, None]
    eye = jaxir.orthographic_camera(0.0, 0.0, 0.01, (48, 1))
    problem = prepare(
        slab(1000.0, 1.0), [TEMPERATURE], [measured_image(eye, THREE[:1], value[0], 0.01 * truth)], robust=3.0
    )
    found = [solve(problem.with_values([each])).uncertainty for each in value]
    z = np.array([(float(u.value[0]) - 1.0) / float(u.standard_deviation[0]) for u in found])
    assert 0.75 < np.sqrt(np.mean(z**2)) < 1.25


@pytest.mark.parametrize("bound", ["upper", "lower"])
def test_a_value_at_its_bound_is_named(bound):
    measured = looked_at(slab(1000.0, 1.0), THREE)
    limits = Bounds(0.9, 1.1)
    start = slab(800.0 if bound == "upper" else 1250.0, 1.0)  # the truth is at 1.25 or .8
    found = fit(start, [Factor("temperature", lambda s: s.plume.temperature, limits)], [measured])
    assert f"temperature is at its {bound} bound" in str(found) and found.at_bounds


def test_the_total_standard_deviation_counts_the_rays():
    measured = looked_at(slab(1000.0, 1.0), THREE)
    found = fit(slab(800.0, 0.5), [TEMPERATURE, DEPTH], [measured])
    noisy = eqx.tree_at(lambda f: f.sampling_error, found, jnp.asarray([0.3, 0.4]))
    expected = np.hypot(np.asarray(found.uncertainty.standard_deviation), [0.3, 0.4])
    np.testing.assert_allclose(noisy.standard_deviation, expected, rtol=1e-6)


@pytest.mark.parametrize("rays", [0.0, 0.3, 3.0])
def test_the_noise_of_rays_is_not_taken_for_a_wrong_model(rays):
    # twelve rows of two bands that share their rays, whose noise has eight blocks; ray variances differ between rows
    shape, rng = (8, 12, 2), np.random.default_rng(1)
    spread = np.sqrt(rays / 8 * np.linspace(0.5, 1.5, 12))[None, :, None]
    any_fit = fit(slab(800.0, 0.5), [TEMPERATURE], [looked_at(slab(1000.0, 1.0), THREE)])
    found = []
    for _ in range(1000):
        noise = rng.normal(size=shape[1:])
        moved, told = (spread * rng.normal(size=(*shape[:2], 1)) * np.ones(2) for _ in range(2))
        residual = noise + moved.sum(axis=0)
        held = {"sampling_residual": told, "residual": residual, "chi_squared": np.sum(residual**2)}
        one = {name: jnp.asarray(value, jnp.float32) for name, value in held.items()}
        one |= {name: (one[name],) for name in ("sampling_residual", "residual")}
        found.append(dataclasses.replace(any_fit, degrees_of_freedom=24, **one).probability)
    for level in (0.01, 0.1, 0.5):
        share = np.mean(np.array(found) < level)
        assert abs(share - level) < 0.01 + 4 * np.sqrt(level * (1 - level) / 1000)
    if rays == 0:
        assert found[-1] == pytest.approx(scipy.stats.chi2(24).sf(np.sum(residual**2)), rel=1e-4)
