"""What a fit says of its limits: combinations not determined, noise of its rays, drift, solvers that fail."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest
import scipy.stats

import jaxir
from jaxir.fit import (
    THERE,
    Bounds,
    Leaf,
    NormalPrior,
    SmoothPrior,
    _observation,
    at_values,
    expected_uncertainty,
    fit,
    linearised,
    look,
    measured_image,
    measured_intensity,
    part_emissivity,
    part_temperature,
    particle_loading,
    prepare,
    sensitivity,
    solve,
    stay,
)
from jaxir.fit._drift import density_ratio, effective_share
from jaxir.fit._surrogate import applies, predicted_by
from jaxir.transport import trace
from jaxir.transport.evaluation import _scattered
from tests.fit.lamps import plate_intensity
from tests.fit.slabs import DEPTH, PIXEL, TEMPERATURE, looked_at, slab
from tests.scenes import box_mesh, plate

THREE = (jaxir.SWIR, jaxir.MWIR, jaxir.LWIR)


LAMP = jaxir.DiscSource((1.0, 0.5, 0.5), (-1.0, 0.0, 0.0), 0.6, 2000.0)
FRONT = [(-60, 0), (-30, 20), (0, 0), (0, 40), (30, -20), (60, 10)]


def lit_plate(brdf):
    return jaxir.Scene(jaxir.Skin(plate().mesh, 400.0, brdf), sources=(LAMP,))


def exact_values():
    """What a plate of emissivity 0.4 shows."""
    return plate_intensity(0.4, 400.0, LAMP, FRONT, jaxir.MWIR)


def test_ten_keys_end_as_far_apart_as_the_fit_says():
    method = jaxir.Method()  # samples lights and brdf
    value, start = exact_values(), lit_plate(jaxir.Lambert(0.7))
    measured = measured_intensity(start, FRONT, jaxir.MWIR, value, 0.01 * value, shape=(16, 16), method=method)
    skin = [part_emissivity("skin")]
    found = [fit(start, skin, [measured], key=jax.random.key(k), max_samples=2) for k in range(10)]
    got = np.array([float(f.uncertainty.value[0]) for f in found])
    said = np.array([float(f.sampling_error[0]) for f in found])
    assert 0 < said.max() < 0.02  # power: the ten would notice an error of a few per cent
    # variances of ten values and of ten times six rows of eight blocks: 9 and up to 480 degrees of freedom
    low, high = scipy.stats.f(9, 300).ppf([5e-4, 1 - 5e-4])
    assert said.std() < 0.2 * said.mean()  # of one difference in each row it would be about .3
    assert low < np.var(got, ddof=1) / np.mean(said**2) < high
    assert abs(got.mean() - 0.4) < 4 * np.sqrt(np.mean(said**2) / 10)


def test_forty_fits_with_noise_and_rays_of_their_own_miss_the_truth_as_far_as_they_say():
    start, skin = lit_plate(jaxir.Lambert(0.7)), [part_emissivity("skin")]
    value, rng, found = exact_values(), np.random.default_rng(2), []
    for draw in range(40):
        noisy = value * (1 + 0.01 * rng.normal(size=value.shape))
        measured = measured_intensity(start, FRONT, jaxir.MWIR, noisy, 0.01 * value, shape=(16, 16))
        found.append(fit(start, skin, [measured], key=jax.random.key(draw), max_samples=2))
    off = np.array([float(f.uncertainty.value[0]) - 0.4 for f in found])
    noise = np.array([float(f.uncertainty.standard_deviation[0]) for f in found])
    total = np.array([f.standard_deviation[0] for f in found])
    low, high = scipy.stats.chi2(40).ppf([5e-4, 1 - 5e-4])
    assert low < np.sum((off / total) ** 2) < high < np.sum((off / noise) ** 2)  # the noise alone is too little
    assert scipy.stats.binom(40, 0.683).cdf(np.sum(np.abs(off) < total)) > 1e-3


def test_rays_louder_than_the_data_are_traced_once_more_up_to_a_bound():
    value, skin, start = exact_values(), [part_emissivity("skin")], lit_plate(jaxir.Lambert(0.7))

    def found(relative, **more):
        measured = measured_intensity(start, FRONT, jaxir.MWIR, value, relative * value, shape=(16, 16))
        return fit(start, skin, [measured], **more)

    loud, bounded, quiet = found(0.002), found(0.002, max_samples=2), found(0.1)
    ratio = float(bounded.sampling_error[0] / bounded.uncertainty.standard_deviation[0])
    assert ratio > 1 and "; give more samples, max_samples or larger shapes" in str(bounded)
    assert (bounded.rounds, bounded.samples, quiet.rounds, quiet.samples) == (1, ((2, 2),), 1, ((2, 2),))
    assert "more were traced" not in str(bounded) + str(quiet)
    taken = loud.samples[0][1]
    assert loud.rounds == 2 and taken == min(16, 2 * 2 ** np.ceil(np.log2(4 * ratio**2)))
    assert f"more were traced, per pixel: measurement 0 2 to {taken}" in str(loud)
    assert float(loud.sampling_error[0]) < 0.7 * float(bounded.sampling_error[0])
    assert abs(float(loud.uncertainty.value[0]) - 0.4) < 4 * loud.standard_deviation[0]
    assert found(0.002, rounds=1).rounds == 1


def test_the_effective_share_of_directions_is_kish_s():
    first, second = (lit_plate(jaxir.RoughConductor(2.0, 10.0, a)) for a in (0.3, 0.6))
    method = jaxir.Method(jaxir.DirectSampling(0, 4))

    def bundled():
        return jaxir.orthographic_camera(20.0, 10.0, 0.1, (4, 4)).bundle(jnp.zeros((64, 2)), jnp.asarray(2.0)).rays()

    @eqx.filter_jit
    def ratios(paths, *scenes):
        found = [density_ratio(paths, first, scene) for scene in scenes]
        return found, [effective_share(ratio) for ratio in found]

    paths = eqx.filter_jit(lambda key: trace(first, bundled(), method, key))(jax.random.key(1))
    (same, other), shares = ratios(paths, first, second)
    drawn = np.asarray(same) > 0
    np.testing.assert_allclose(np.asarray(same)[drawn], 1)
    assert 10 < drawn.sum() and float(shares[0]) == pytest.approx(1)
    w = np.asarray(other)[drawn]
    share = float(shares[1])
    assert share == pytest.approx(w.sum() ** 2 / (w.size * (w**2).sum()), rel=1e-5) and 0 < share < 0.95
    lights = jaxir.Method(jaxir.DirectSampling(1, 0))
    traced = eqx.filter_eval_shape(lambda key: trace(first, bundled(), lights, key), jax.random.key(1))
    assert eqx.filter_eval_shape(density_ratio, traced, first, second).size == 0
    assert float(effective_share(jnp.zeros(0))) == 1


def jet(temperature, length):
    return jaxir.Scene(
        plumes=jaxir.JetPlume(
            (0, 0, 0), (-1, 0, 0), 0.5, temperature, 250.0, jaxir.GrayGas(0.5), length=length, panels=2
        )
    )


AROUND = [(20, 0), (90, 0), (140, 30), (200, -20)]
TWO = (jaxir.MWIR, jaxir.LWIR)
JET = [
    Leaf("exit temperature", lambda s: s.plume.exit_temperature, Bounds(0.0), "K"),
    Leaf("length", lambda s: s.plume.length, Bounds(0.0), "diameters"),
]


def test_a_jet_that_outgrows_its_images_is_traced_again():
    value = np.asarray(jaxir.signature(jet(1200.0, 16.0), AROUND, TWO, shape=(64, 64)).intensity)
    start = jet(1100.0, 10.0)
    measured = measured_intensity(start, AROUND, TWO, value, 0.01 * value, shape=(64, 64))
    problem = prepare(start, JET, [measured])
    assert applies(problem)
    once, often = solve(problem, rounds=1), solve(problem)
    assert once.rounds == 1 and once.drifted and "allow more rounds" in str(once)
    assert often.rounds > 1 and not often.drifted
    np.testing.assert_allclose(often.uncertainty.value, [1200.0, 16.0], rtol=0.02)
    # rays of their own made the measured values, so what rays put in comes twice
    assert float(often.chi_squared) < often.degrees_of_freedom + 3 * often.sampling_chi_squared
    assert float(often.chi_squared) < float(once.chi_squared)


def test_a_lattice_is_solved_once_for_all_rays_of_a_measurement(monkeypatch):
    """And not for what it errs, which fits do not ask."""
    particles = jaxir.GrayParticles(0.5, 0.8, jaxir.Isotropic())
    cube = jaxir.Grid((-1.0, -1.0, -1.0), (2.0, 2.0, 2.0), (1, 1, 1))
    scene = jaxir.Scene(None, jaxir.GridPlume(cube, 700.0, jaxir.GrayGas(0.2), particles))
    method = jaxir.Method(scattering=jaxir.DiscreteOrdinates(4, 4, 1))
    views, value = [(0.0, 0.0), (90.0, 30.0)], np.full((2, 1), 100.0)
    measured = measured_intensity(scene, views, jaxir.MWIR, value, 1.0, shape=(24, 24), method=method)
    problem = prepare(scene, [particle_loading()], [measured])
    asked, ready = [], []
    solution, evaluate = _scattered.solution, _observation.evaluate
    monkeypatch.setattr(_scattered, "solution", lambda *given: asked.append(given[-1]) or solution(*given))
    monkeypatch.setattr(
        _observation, "evaluate", lambda lit, paths: ready.append(not lit.medium.scatters) or evaluate(lit, paths)
    )
    jax.make_jaxpr(lambda z: problem.residual(z))(problem.coordinates.origin())
    assert asked == [False] and ready and all(ready)


def test_fewer_rays_stand_for_all_that_meet_a_jet():
    scene = jet(1200.0, 16.0)
    value = np.asarray(jaxir.signature(scene, AROUND, TWO, shape=(64, 64)).intensity)
    measured = measured_intensity(scene, AROUND, TWO, value, 0.01 * value, shape=(64, 64))
    problem = prepare(scene, JET, [measured])
    observed = problem.observations[0]
    kept = problem.surrogate
    sums = *kept.leading, *kept.steering, observed.through
    few, more, all_rays = (int((rays.weight > 0).sum()) for rays in sums)
    assert few < 0.02 * all_rays and more < 0.2 * all_rays
    z = problem.coordinates.origin()
    problems = *(predicted_by(problem, rays) for rays in (kept.leading, kept.steering)), problem
    leading, steering, exact = (np.asarray(linearised(p, z)[1]) for p in problems)
    np.testing.assert_allclose(leading[:, 0], exact[:, 0], rtol=0.1)  # by so few rays to 3 % rms
    assert np.std(leading[:, 0] / exact[:, 0]) < 0.05
    spread = [np.sqrt(np.diag(np.linalg.inv(j.T @ j))) for j in (steering, exact)]
    np.testing.assert_allclose(*spread, rtol=0.02)
    found = solve(problem)
    there = at_values(problem.coordinates, found.uncertainty.value)
    every = look(problem, there)
    assert stay(problem, there).distance < 2 * THERE  # by the slopes of all rays
    assert float(found.chi_squared) == pytest.approx(float(every.loss), abs=0.05)  # of 6 degrees of freedom


def test_a_jet_that_fills_little_of_its_images_has_others_made():
    """Of which few rays met it: of a jet 2.5 times too wide at first values were off by up to ten of what was told."""
    value = np.asarray(jaxir.signature(jet(1200.0, 12.0), AROUND, TWO, shape=(64, 64), samples=32).intensity)
    start = jet(900.0, 40.0)
    found = solve(prepare(start, JET, [measured_intensity(start, AROUND, TWO, value, 0.01 * value, shape=(64, 64))]))
    assert found.rounds > 1 and not found.drifted
    assert (np.abs(np.asarray(found.uncertainty.value) - [1200.0, 12.0]) < 3 * found.standard_deviation).all()
    assert (found.standard_deviation < [20.0, 0.6]).all()


@pytest.mark.parametrize("solver", [optimistix.LBFGS(1e-5, 1e-5), optimistix.LevenbergMarquardt(1e-5, 1e-5)])
def test_solvers_of_optimistix(solver):
    bands = (jaxir.SWIR, jaxir.MWIR, jaxir.LWIR)
    start = (990.0, 1.2)
    problem = prepare(slab(*start), [TEMPERATURE, DEPTH], [looked_at(slab(1000.0, 1.0), bands)])
    found = solve(problem, solver=solver, max_steps=256)
    assert bool(found.converged)
    np.testing.assert_allclose(np.asarray(found.uncertainty.value) * start, [1000.0, 1.0], rtol=3e-3)


@pytest.mark.parametrize("start", [(990.0, 20.0), (1100.0, 12.0), (900.0, 30.0)])
def test_a_parameter_that_hardly_acts_at_the_start_stops_no_other(start):
    """Through a thick slab the depth acts by exp(-20): steps in it were all there was, and none was taken."""
    bands = (jaxir.SWIR, jaxir.MWIR, jaxir.LWIR)
    found = solve(prepare(slab(*start), [TEMPERATURE, DEPTH], [looked_at(slab(1000.0, 10.0), bands)]))
    assert bool(found.converged)
    assert float(found.uncertainty.value[0]) * start[0] == pytest.approx(1000.0, abs=0.5)


@pytest.fixture(scope="module")
def cube():
    """A cube of six temperatures from all sides: sides by name, a scene of temperatures, the true ones, a measurement.

    In each band the hottest sides hide the coldest: walked by columns of one size, these get lost.
    """
    mesh = box_mesh((1.0, 1.0, 1.0))
    part = np.unique(np.round(4 * np.asarray(mesh.area_vectors())), axis=0, return_inverse=True)[1].astype(np.int32)
    names = [f"side {k}" for k in range(6)]
    views = [(azimuth, elevation) for azimuth in (20, 110, 200, 290) for elevation in (-35, 25)]
    brdf = jaxir.Lambert(np.array([0.9, 0.8, 0.7, 0.6, 0.5, 0.4])[part])

    def scene(temperature):
        return jaxir.Scene(jaxir.Skin(mesh, np.broadcast_to(temperature, 6)[part].astype(float), brdf, part, names))

    truth = np.array([350.0, 450, 550, 500, 400, 300])
    exact = np.stack([jaxir.unoccluded_intensity(scene(truth), *view, THREE) for view in views])
    noise = np.random.default_rng(1).standard_normal(exact.shape)
    measured = measured_intensity(scene(truth), views, THREE, exact * (1 + 0.01 * noise), 0.01 * exact, shape=(16, 16))
    return names, scene, truth, measured


@pytest.mark.parametrize("start", [250.0, 420.0, 900.0])
def test_cold_sides_are_found_beside_hot_ones(cube, start):
    names, scene, truth, measured = cube
    found = fit(scene(start), [part_temperature(name) for name in names], [measured], key=jax.random.key(1))
    assert found.probability > 1e-2
    assert (np.abs(np.asarray(found.uncertainty.value) - truth) < 4 * found.standard_deviation).all()


def test_data_that_nothing_explains_end_where_values_are_numbers(cube):
    """Negative ones: sides grow as cold as temperatures may be."""
    names, scene, truth, measured = cube
    negative = dataclasses.replace(measured, value=-measured.value)
    lost = fit(scene(420.0), [part_temperature(name) for name in names], [negative])
    assert np.isfinite(lost.uncertainty.value).all() and "DOES NOT EXPLAIN" in str(lost)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda m: fit(slab(900, 1), [DEPTH], [m], max_steps=0), "max_steps: got 0, expected an integer >= 1"),
        (lambda m: fit(slab(900, 1), [DEPTH], [m], rounds=0), "rounds: got 0, expected an integer >= 1"),
        (lambda m: fit(slab(900, 1), [DEPTH], [m], max_samples=1), "max_samples: got 1, expected an integer >= 2"),
        (lambda m: measured_image(PIXEL, THREE, np.ones((1, 1, 3)), -1.0), "standard_deviation: got -1.0"),
        (lambda m: NormalPrior([1.0], 1.0), r"NormalPrior.mean: got shape \(1,\)"),
        (lambda m: SmoothPrior((2, 2), np.nan), "SmoothPrior.standard_deviation: got nan"),
        (
            lambda m: fit(slab(900, 1), [DEPTH], [m], priors={"depth": SmoothPrior((2, 2), 1.0)}),
            r"SmoothPrior.shape: got \(2, 2\), expected a field of the parameter's 1 numbers",
        ),
        (lambda m: sensitivity(slab(900, 1), m, "MWIR"), "got band 'MWIR' and no skin"),
        (lambda m: sensitivity(jaxir.Scene(plate()), m, "UV"), "got band 'UV' and Lambert skin"),
        (
            lambda m: sensitivity(lit_plate(jaxir.RoughConductor(2.0, 10.0, 0.3)), m, "MWIR"),
            "RoughConductor skin; expected one of",
        ),
    ],
)
def test_wrong_input_is_named(build, message):
    with pytest.raises(ValueError, match=message):
        build(measured_image(PIXEL, THREE, np.ones((1, 1, 3)), 0.1))


def test_a_smooth_prior_fills_what_the_data_leave_open():
    prior = SmoothPrior((2, 3), 2.0)
    value = jnp.arange(6.0) ** 2
    assert prior.count(6) == prior.residual(value).size == 7
    field = np.arange(6.0).reshape(2, 3) ** 2
    steps = np.concatenate([np.diff(field, axis=0).ravel(), np.diff(field, axis=1).ravel()])
    np.testing.assert_allclose(prior.residual(value), steps / 2)
    assert eqx.tree_equal(prior.residual(jnp.full(6, 3.0)), jnp.zeros(7))


def test_values_known_only_inside_transformations_are_refused():
    """They were told that an array of JAX is none of numpy."""
    scene = lit_plate(jaxir.Lambert(0.7))
    measured = measured_intensity(scene, [(0, 0)], jaxir.MWIR, [[1.0]], 0.1, shape=(4, 4))

    def warm(kelvin):
        return eqx.tree_at(lambda s: s.skin.temperature, scene, jnp.full(2, kelvin))

    with pytest.raises(ValueError, match=r"scene: got traced values \(inside jit\), expected a call outside it"):
        jax.jit(lambda kelvin: sensitivity(warm(kelvin), measured, "MWIR"))(400.0)
    with pytest.raises(ValueError, match=r"uncertainty: got traced values .*, expected a call outside it"):
        jax.jacfwd(lambda kelvin: expected_uncertainty(warm(kelvin), [part_emissivity("skin")], [measured]))(400.0)
