"""Fits of a gray slab before one pixel, whose uncertainty has a closed form."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest

import jaxir
from jaxir.fit import Bounds, Leaf, expected_uncertainty, fit, particle_loading, prepare, solve
from jaxir.optics.particle import Isotropic
from tests.fit.slabs import DEPTH, TEMPERATURE, looked_at, slab

TWO = (jaxir.MWIR, jaxir.LWIR)
THREE = (jaxir.SWIR, *TWO)


def expected(temperature, depth, bands):
    scene = slab(temperature, depth)
    return expected_uncertainty(scene, [TEMPERATURE, DEPTH], [looked_at(scene, bands)])


# relative standard deviations of (T, optical depth) for 1 % noise per band, from the linearised problem in closed form
@pytest.mark.parametrize(
    ("temperature", "depth", "bands", "relative"),
    [
        (1000.0, 1.0, TWO, (0.00738, 0.0388)),
        (1000.0, 1.0, THREE, (0.00311, 0.0240)),
        (1000.0, 5.0, TWO, (0.00738, 0.666)),
    ],
)
def test_standard_deviations_of_a_gray_slab(temperature, depth, bands, relative):
    got = expected(temperature, depth, bands)
    np.testing.assert_allclose(got.standard_deviation, relative, rtol=0.01)
    assert bool(got.undetermined()) == (depth > 2)
    assert ("depth" in str(got.undetermined())) == (depth > 2)


@pytest.mark.parametrize("scales", [(None, None), (1.0, 1.0), (100.0, 1e-3)], ids=str)
def test_standard_deviations_do_not_depend_on_the_units_of_parameters(scales):
    """Columns of a Jacobian of single precision differ by 3e5; the temperature was told inf, the gas 2.4 times less."""
    scene = slab(1000.0, 1e-3)
    kelvin, gas = (Bounds(scale=scale) for scale in scales)
    parameters = [
        Leaf("temperature", lambda s: s.plume.temperature, kelvin),
        Leaf("gas", lambda s: s.plume.gas.coefficient, gas),
    ]
    got = expected_uncertainty(scene, parameters, [looked_at(scene, THREE)])
    np.testing.assert_allclose(got.standard_deviation, [3.11, 1.402e-5], rtol=0.01)
    found = fit(slab(900.0, 1.1e-3), parameters, [looked_at(scene, THREE)])
    np.testing.assert_allclose(found.uncertainty.standard_deviation, got.standard_deviation, rtol=0.01)
    np.testing.assert_allclose(found.uncertainty.value, [1000.0, 1e-3], rtol=1e-3)
    assert found.converged and found.steps < 30


@pytest.mark.parametrize("seed", range(8))
def test_a_solution_at_a_bound_is_one(x64, seed):
    """Towards it the temperature's column fades, and what is left of the residual cannot be reached."""
    exact = looked_at(slab(1000.0, 1.0), (*THREE, jaxir.Band("more", 5.0, 8.0)), 0.02)
    noise = 0.02 * np.random.default_rng(seed).normal(size=exact.value.shape)
    below = dataclasses.replace(TEMPERATURE, bounds=Bounds(0.2, 1.25))
    problem = prepare(slab(800.0, 2.0), [below, DEPTH], [exact]).with_values([exact.value * (1 + noise)])
    assert solve(problem).converged


@pytest.mark.parametrize("start", [(0.34, 3.0), (3.0, 0.34), (0.5, 0.34), (2.0, 3.0)])
def test_a_slab_is_found_from_far_off(start):
    truth = slab(1000.0, 1.0)
    problem = prepare(slab(1000.0 * start[0], start[1]), [TEMPERATURE, DEPTH], [looked_at(truth, TWO)])
    found = solve(problem)
    assert found.converged and found.steps <= 30
    np.testing.assert_allclose(found.uncertainty.value, [1 / start[0], 1 / start[1]], rtol=2e-3)
    assert float(found.chi_squared) < 1e-2


def test_the_loading_of_particles_is_found():
    measured = looked_at(slab(1000.0, 1.0), TWO)  # particles that only absorb act as so much more gas
    clean = slab(800.0, 0.4)
    soot = jaxir.GrayParticles(0.2, 0.0, Isotropic())
    start = eqx.tree_at(lambda s: s.plume.particles, clean, soot, is_leaf=lambda x: x is None)
    exact = dataclasses.replace(measured, method=jaxir.Method(orders=0))
    found = fit(start, [TEMPERATURE, particle_loading()], [exact])
    assert found.converged
    np.testing.assert_allclose(found.uncertainty.value, [1000 / 800, (1.0 - 0.4) / 0.2], rtol=5e-3)


def test_one_sigma_covers_two_thirds():
    truth = slab(1000.0, 1.0)
    measured = looked_at(truth, THREE)
    problem = prepare(truth, [TEMPERATURE, DEPTH], [measured])
    rng = np.random.default_rng(3)
    value, spread = np.asarray(measured.value), np.asarray(measured.standard_deviation)
    inside = []
    for _ in range(200):
        found = solve(problem.with_values([value + spread * rng.normal(size=value.shape)])).uncertainty
        inside.append(np.abs(np.asarray(found.value) - 1) < np.asarray(found.standard_deviation))
    share = np.mean(inside, axis=0)
    assert ((0.58 < share) & (share < 0.78)).all()  # .683 +- 3 binomial standard deviations of 200 draws


def test_what_is_not_determined_is_always_flagged():
    # one band gives one number for two unknowns; beyond depth 5 the closed form gives the depth 67 % and more
    one_band = [(t, d, (jaxir.MWIR,)) for t in (600.0, 800.0, 1000.0, 1400.0, 1800.0) for d in (0.01, 1.0)]
    thick = [(t, d, TWO) for t in (800.0, 1000.0, 1200.0, 1500.0, 1800.0) for d in (6.0, 8.0)]
    got = [expected(*case) for case in one_band + thick]
    assert [len(uncertain.undetermined()) for uncertain in got] == 20 * [1]
    assert all(np.isinf(uncertain.standard_deviation).all() for uncertain in got[:10])


def test_what_is_determined_is_never_flagged():
    cases = [(t, d, THREE) for t in (700.0, 900.0, 1100.0, 1400.0, 1800.0) for d in (0.1, 0.3, 1.0, 1.5)]
    assert [expected(*case).undetermined() for case in cases] == 20 * [[]]


def test_a_solver_that_fails_keeps_the_best_point_and_says_so():
    truth = slab(1000.0, 1.0)
    problem = prepare(slab(400.0, 3.0), [TEMPERATURE, DEPTH], [looked_at(truth, THREE)])
    before = float(jax.jit(lambda z: jnp.sum(problem.residual(z) ** 2))(problem.coordinates.origin()))
    found = solve(problem, max_steps=1)
    assert not found.converged and "converged" not in str(found).splitlines()[-1]
    assert float(found.chi_squared) <= before
    wild = solve(problem, solver=optx.GradientDescent(1e9, 1e-6, 1e-6), max_steps=5)
    assert np.isfinite(np.asarray(wild.uncertainty.value)).all() and float(wild.chi_squared) <= before
