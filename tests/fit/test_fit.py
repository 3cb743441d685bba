"""Fits recover planted truths, their standard deviations are those of theory, and what is not determined is said."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest

import jaxir
from jaxir.fit import (
    Bounds,
    Factor,
    Leaf,
    NormalPrior,
    fit,
    jet_parameter,
    measured_image,
    measured_intensity,
    mole_fraction_scale,
    part_emissivity,
    part_temperature,
    particle_loading,
    prepare,
    sensitivity,
    temperature_scale,
)
from jaxir.optics.particle import Isotropic, ParticleTable
from jaxir.optics.spectrum import gray_nodes
from tests.fit.lamps import plate_intensity
from tests.fit.slabs import DEPTH, PIXEL, TEMPERATURE, slab
from tests.scenes import box_mesh, plate

VIEWS = [(a, e) for a in (0, 40, 90, 160, 230, 300) for e in (-30, 10, 50)]
BANDS = (jaxir.MWIR, jaxir.LWIR)


def body(emissivity, temperature):
    part = np.repeat(np.arange(3), 4)
    brdf = jaxir.Lambert(np.repeat(np.asarray(emissivity, float), 4))
    return jaxir.Scene(
        jaxir.Skin(
            box_mesh((2, 1, 1)), np.repeat(np.asarray(temperature, float), 4), brdf, part, ("front", "side", "top")
        )
    )


@pytest.fixture(scope="module")
def survey():
    truth = body([0.3, 0.6, 0.9], [300, 320, 350])
    intensity = np.stack([jaxir.unoccluded_intensity(truth, *view, BANDS) for view in VIEWS])  # it is convex
    spread = 0.01 * intensity
    noisy = intensity + spread * np.random.default_rng(0).normal(size=intensity.shape)
    return truth, noisy, spread


PARTS = [part_emissivity(p) for p in ("front", "side", "top")] + [part_temperature(p) for p in ("front", "side", "top")]
TRUTH = np.array([0.3, 0.6, 0.9, 300, 320, 350])


@pytest.mark.parametrize("solver", [None, optx.BFGS(rtol=1e-5, atol=1e-5)], ids=["levenberg_marquardt", "bfgs"])
def test_emissivities_and_temperatures_of_parts(survey, solver):
    _, noisy, spread = survey
    start = body([0.6, 0.6, 0.6], [330, 330, 330])
    measured = measured_intensity(start, VIEWS, BANDS, noisy, spread, shape=(32, 32))
    found = fit(start, PARTS, [measured], solver=solver, max_steps=200)
    off = (np.asarray(found.uncertainty.value) - TRUTH) / np.asarray(found.uncertainty.standard_deviation)
    assert (np.abs(off) < 3.5).all()
    assert found.degrees_of_freedom == 30 and 10 < float(found.chi_squared) < 60
    assert not found.uncertainty.undetermined()
    assert "emissivity of front" in str(found) and "converged" in str(found)
    np.testing.assert_allclose(found.scene.skin.temperature[0], found.uncertainty.value[3], rtol=1e-6)


def test_starts_priors_and_a_robust_loss(survey):
    _, noisy, spread = survey
    spoiled = noisy.copy()
    spoiled[2, 0] *= 3.0  # one gross error
    start = body([0.6, 0.6, 0.6], [330, 330, 330])
    measured = measured_intensity(start, VIEWS, BANDS, spoiled, spread, shape=(32, 32))
    prior = {"emissivity of front": NormalPrior(0.3, 0.02)}
    starts = [[0.2, 0.8, 0.5, 250, 400, 300]]
    robust = fit(start, PARTS, [measured], robust=2.0, priors=prior, starts=starts, max_steps=100)
    squares = fit(start, PARTS, [measured], priors=prior, starts=starts, max_steps=100)
    assert robust.starts.shape == (2,)
    assert robust.degrees_of_freedom == squares.degrees_of_freedom == 31

    def off(found):
        return np.abs((np.asarray(found.uncertainty.value) - TRUTH) / np.asarray(found.uncertainty.standard_deviation))

    assert off(robust).max() < 4 < off(squares).max()


def test_one_gross_error_does_not_lead_a_robust_fit_astray():
    """On a logarithmic scale it draws ten times as much as in the loss: to where the body is black, or white."""
    bands = (jaxir.SWIR, *BANDS)
    sun = jaxir.ParallelSource((-0.6, 0.0, -0.8), [300.0, 20.0, 1.5])

    def box(temperature, emissivity):
        return jaxir.Scene(jaxir.Skin(box_mesh((2, 4, 1)), temperature, jaxir.Lambert(emissivity)), sources=sun)

    views, truth, start = [(0, 0), (45, 30), (90, 60), (200, -20)], box(420.0, 0.65), box(350.0, 0.5)
    intensity = np.stack([jaxir.unoccluded_intensity(truth, *view, bands) for view in views])
    spread = 0.03 * intensity
    spoiled = intensity.copy()
    spoiled[0, 1] *= 10
    measured = measured_intensity(start, views, bands, spoiled, spread, shape=(16, 16))
    found = fit(start, [part_temperature("skin"), part_emissivity("skin")], [measured], robust=3.0)
    np.testing.assert_allclose(found.uncertainty.value, [420.0, 0.65], rtol=0.05)


def test_an_image_fits_a_field_of_many_numbers_in_reverse_mode():
    rng = np.random.default_rng(5)
    shape = (1, 12, 10)
    field = 900 + 300 * rng.uniform(size=shape)
    grid = jaxir.Grid((-0.5, -0.6, -0.5), (1.0, 0.1, 0.1), shape)

    def scene(temperature):
        return jaxir.Scene(plumes=jaxir.GridPlume(grid, temperature, jaxir.GrayGas(0.5)))

    camera = jaxir.orthographic_camera(0.0, 0.0, 0.1, (10, 12))
    black = jaxir.band_radiance(jnp.asarray(field[0].T[::-1], jnp.float32), gray_nodes((jaxir.MWIR,)))
    image = -np.expm1(-0.5) * np.asarray(black)  # each pixel is a cell
    measured = measured_image(camera, jaxir.MWIR, image, 0.01 * image.mean())
    parameter = Leaf("temperature", lambda s: s.plume.temperature, Bounds(0.0), "K")
    found = fit(scene(1000.0), [parameter], [measured], solver=optx.BFGS(rtol=1e-6, atol=1e-6), max_steps=300)
    assert found.uncertainty.value.shape == (120,)
    off = (np.asarray(found.uncertainty.value) - field.ravel()) / np.asarray(found.uncertainty.standard_deviation)
    assert np.abs(off).max() < 1


def test_sensitivity_is_the_derivative_of_the_sum(x64):
    truth = body([0.3, 0.6, 0.9], [300, 320, 350])
    views = VIEWS[:3]
    measured = measured_intensity(truth, views, BANDS, np.ones((3, 2)), 1.0, shape=(32, 32))
    by_emissivity, by_temperature = sensitivity(truth, measured, "LWIR")

    exact = [jax.jacrev(_face_sum)(truth.skin.temperature, truth, a, e) for a, e in views]
    np.testing.assert_allclose(by_temperature.sum(), np.sum(exact), rtol=5e-3)
    black = jaxir.band_radiance(truth.skin.temperature, jaxir.gray_nodes((jaxir.LWIR,)))[:, 0]
    assert by_emissivity.shape == black.shape and (by_emissivity >= 0).all()
    seen = np.asarray(by_emissivity) > 0
    slope = jax.jvp(
        lambda t: jaxir.band_radiance(t, jaxir.gray_nodes((jaxir.LWIR,)))[:, 0],
        (truth.skin.temperature,),
        (jnp.ones(12),),
    )[1]
    emissivity = np.repeat([0.3, 0.6, 0.9], 4)
    np.testing.assert_allclose(
        np.asarray(by_temperature / by_emissivity)[seen], np.asarray(emissivity * slope / black)[seen], rtol=1e-9
    )


def _face_sum(temperature, scene, azimuth, elevation):
    changed = eqx.tree_at(lambda s: s.skin.temperature, scene, temperature)
    return jaxir.unoccluded_intensity(changed, azimuth, elevation, jaxir.LWIR)[0]


def test_bands_of_an_image_take_the_nodes_that_the_scene_needs():
    grid, gas = jaxir.Grid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (1, 1, 1)), jaxir.NarrowBandGas(101325.0, co2=0.1)
    hot = jaxir.Scene(None, jaxir.GridPlume(grid, 1000.0, gas))
    whole, given = (
        measured_image(PIXEL, bands, np.ones((1, 1, 1)), 0.1).resolved(hot).nodes
        for bands in (jaxir.MWIR, gray_nodes(jaxir.MWIR))
    )
    assert whole.count == jaxir.scene_nodes(hot, jaxir.MWIR).count > given.count == 1


def test_light_that_changes_over_a_face_is_predicted_ray_by_ray():
    """In closed form no ray is random, and yet no two of a face are alike."""
    disc = jaxir.DiscSource((0.2, 0.3, 0.2), (-1.0, 0.0, 0.0), 0.15, 400.0)
    scene = jaxir.Scene(plate(0.6, 300.0), (), disc)
    views, shape = [(0.0, 0.0), (40.0, 20.0)], (64, 64)
    asked = {"shape": shape, "method": jaxir.Method(jaxir.ClosedForm())}
    known = plate_intensity(0.6, 300.0, disc, views, jaxir.MWIR)
    measured = measured_intensity(scene, views, jaxir.MWIR, known, 0.01 * known, **asked)
    predicted = prepare(scene, [part_emissivity("skin")], [measured]).observations[0].predict_halves(scene)
    np.testing.assert_allclose(predicted.mean(axis=(0, 1)), known, rtol=0.02)


ONE_NUMBER = measured_image(PIXEL, jaxir.MWIR, np.ones((1, 1, 1)), 0.1)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda m: fit(slab(900, 1), [], [m]), "parameters: got names"),
        (lambda m: fit(slab(900, 1), [DEPTH, DEPTH], [m]), "no name twice"),
        (lambda m: fit(slab(900, 1), [DEPTH], []), "measurements: got none"),
        (lambda m: fit(slab(900, 1), [DEPTH], [m], robust=0.0), "robust: got 0.0"),
        (lambda m: fit(slab(900, 1), [DEPTH], [m], priors={"x": NormalPrior(1, 1)}), "priors: got 'x'"),
        (
            lambda m: fit(slab(900, 1), [DEPTH], [m], priors={"depth": NormalPrior(1, 0)}),
            "NormalPrior.standard_deviation: got 0",
        ),
        (lambda m: fit(slab(900, 1), [DEPTH], [m], starts=[[-1.0]]), "starts: got depth outside its bounds"),
        (lambda m: fit(slab(900, 1), [DEPTH], [m], starts=[1.0]), r"starts: got shape \(1,\)"),
        (
            lambda m: fit(slab(900, 1), [Factor("d", DEPTH.where, Bounds(2.0, 3.0))], [m]),
            "d: got start 1, .*inside its bounds",
        ),
        (
            lambda m: fit(
                slab(900, 1), [TEMPERATURE, DEPTH], [measured_image(PIXEL, jaxir.MWIR, np.ones((1, 1, 1)), 0.1)]
            ),
            "got 1 measured numbers and priors for 2 parameters",
        ),
        (lambda m: measured_image(PIXEL, BANDS, np.ones((1, 1, 3)), 1.0), r"measurement.value: got shape \(1, 1, 3\)"),
        (lambda m: measured_image(PIXEL, BANDS, np.ones((1, 1, 2)), 0.0), "standard_deviation: got 0.0"),
        (
            lambda m: measured_image(PIXEL, BANDS, [[[1.0, np.nan]]], 1.0),
            r"measurement.value: got nan at index \[0, 0, 1\]",
        ),
        (lambda m: measured_intensity(slab(900, 1), [(0, 0)], BANDS, [[1.0]], 1.0), "measurement.value: got shape"),
        (lambda m: Bounds(1.0, 0.0), "Bounds: got 1.0, 0.0"),
        (lambda m: Bounds(upper=1.0), "got an upper bound 1.0 without a lower"),
        (lambda m: fit(body([0.5] * 3, [300] * 3), [part_emissivity("tail")], [m]), "got part 'tail', expected one of"),
        (
            lambda m: jet_parameter("panels"),
            "jet_parameter: got 'panels', expected one of .*'nozzle', 'exit_temperature'",
        ),
        (
            lambda m: fit(slab(900, 1), [jet_parameter("length")], [m]),
            "jet_parameter: got GridPlume as the scene's plume, expected a JetPlume",
        ),
        (lambda m: fit(slab(900, 1), [mole_fraction_scale()], [m]), "mole_fraction_scale: got GrayGas in the plume"),
        (lambda m: fit(slab(900, 1), [particle_loading()], [m]), "particle_loading: got nothing in the plume"),
        (
            lambda m: fit(slab(900, 1), [Leaf("skin", lambda s: s.skin.temperature)], [m]),
            "skin: where: 'NoneType' object has no attribute 'temperature', expected arrays that the scene has",
        ),
        (lambda m: fit(slab(900, 1), [Factor("air", lambda s: s.atmosphere)], [m]), "air: where: got no leaf"),
        (
            lambda m: fit(body([0.5] * 3, [300] * 3), [temperature_scale()], [m]),
            "temperature_scale: got nothing as the scene's plume, expected a GridPlume",
        ),
    ],
)
def test_wrong_input_is_named(build, message):
    with pytest.raises(ValueError, match=message):
        build(measured_image(PIXEL, BANDS, np.ones((1, 1, 2)), 0.1))


def test_named_parameters_change_what_they_name():
    gas = jaxir.NarrowBandGas(2e4, 0.1, 0.05)
    soot = jaxir.GrayParticles(2.0, 0.1, Isotropic())
    jet = jaxir.Scene(plumes=jaxir.JetPlume((0, 0, 0), (1, 0, 0), 0.5, 900.0, 250.0, gas, particles=soot))
    grid = jaxir.Grid((0, 0, 0), (1, 1, 1), (1, 2, 1))
    table = ParticleTable([1e3, 9e3], [2e-12, 2e-12], [1e-12, 1e-12], 1e-18, [-1, 1], np.full((2, 2), 0.08))
    cells = jaxir.Scene(plumes=jaxir.GridPlume(grid, 500.0, gas, jaxir.Particles(np.full((1, 2, 1), 1e9), table)))
    two = jnp.asarray([2.0])
    for field, unit in (("exit_temperature", "K"), ("spreading", ""), ("core_length", "diameters")):
        parameter = jet_parameter(field)
        assert parameter.unit == unit and parameter.bounds.lower == (1e-3 if unit == "K" else 0)
        assert float(getattr(parameter.write(jet, two).plume, field)) == 2
    assert jet_parameter("nozzle").read(jet).shape == (3,)
    for scene in (jet, cells):
        mixed = mole_fraction_scale().write(scene, two).plume.gas
        assert (float(mixed.h2o), float(mixed.co2), mixed.co) == pytest.approx((0.2, 0.1, None))
    assert float(particle_loading().write(jet, two).plume.particles.extinction[0]) == 4
    assert (particle_loading().write(cells, two).plume.particles.number_density == 2e9).all()
    assert (temperature_scale().write(cells, two).plume.temperature == 1000).all()


def test_a_parameter_that_touches_nothing_in_view_is_named():
    truth = body([0.3, 0.6, 0.9], [300, 320, 350])
    measured = measured_intensity(truth, [(0, 0)] * len(VIEWS), BANDS, np.ones((18, 2)), 0.1, shape=(32, 32))
    hidden = "emissivity of side, emissivity of top, temperature of side, temperature of top"
    with pytest.raises(ValueError, match=f"parameters: {hidden} changes nothing in the measured views"):
        fit(truth, PARTS, [measured])


@pytest.mark.parametrize(
    "make", [lambda: jet_parameter("diameter", 1), temperature_scale, mole_fraction_scale, particle_loading]
)
def test_parameters_made_anew_are_the_same_to_a_compiler(make):
    one, other = (jax.tree.structure(make()) for _ in range(2))
    assert one == other and hash(one) == hash(other)
    assert jax.tree.structure(jet_parameter("diameter")) != jax.tree.structure(jet_parameter("diameter", 1))
