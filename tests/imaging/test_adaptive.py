"""Rays where the error is: unbiased, as exact as was asked, and fewer."""

import jax
import numpy as np
import pytest

import jaxir
from jaxir.imaging import _choices
from jaxir.imaging._adaptive import strata_of
from jaxir.imaging._placement import MARGIN, Law, well_shaped_strata
from tests.scenes import box_mesh

CAMERA = jaxir.orthographic_camera(35.0, 25.0, 0.08, (32, 32))
WARM = np.repeat([310.0, 320, 330, 315, 335, 325], 2)  # sides that differ
PLUME = jaxir.GridPlume(jaxir.Grid((-1.5, -0.4, -0.4), (0.4, 0.4, 0.4), (2, 2, 2)), 500.0, jaxir.GrayGas(0.8))
SCENE = jaxir.Scene(jaxir.Skin(box_mesh(), WARM, jaxir.Lambert(0.7)), PLUME)


def rendered(key, camera=CAMERA, **asked):
    return jaxir.render(SCENE, camera, jaxir.MWIR, key=jax.random.key(key), method=jaxir.Method(), **asked)


def test_neither_the_pixels_nor_their_sum_are_biased_and_the_errors_are_those_told():
    truth = rendered(1000, pixel_rtol=1e-3, max_samples=2**16)
    contrast = np.asarray(truth.radiance - truth.empty)[..., 0]
    images = [rendered(key, pixel_rtol=1e-2) for key in range(40)]
    assert all(bool(image.outcome == jaxir.Outcome.tolerance_met) for image in images)
    intensity = np.array([image.radiant_intensity()[0] for image in images], float)
    error = np.array([image.intensity_error()[0] for image in images], float)
    known = float(truth.intensity_error()[0])
    off = intensity.mean() - float(truth.radiant_intensity()[0])
    assert abs(off) < 4 * np.hypot(intensity.std(ddof=1) / len(images) ** 0.5, known)
    assert 0.75 < intensity.std(ddof=1) / np.sqrt(np.mean(error**2)) < 1.3  # 40 keys: standard deviation .11
    apart = np.array([np.asarray(image.radiance)[..., 0] for image in images]) - np.asarray(truth.radiance)[..., 0]
    obtained = np.sqrt((apart**2)[:, contrast > 0].mean()) / contrast[contrast > 0].mean()
    assert 0.5e-2 < obtained < 1e-2
    spread = apart.std(axis=0, ddof=1)
    varied = spread > 1e-4 * contrast[contrast > 0].mean()
    told = np.asarray(truth.standard_error, float)[..., 0]
    z = apart.mean(axis=0)[varied] / np.hypot(spread[varied] / len(images) ** 0.5, told[varied])
    assert varied.sum() > 150 and 0.6 < np.mean(z**2) < 1.4 and np.abs(z).max() < 5  # .71 to 1.05 by keys


def test_an_intensity_to_a_small_error_takes_rays_where_pixels_vary(monkeypatch, one_program):
    """As the plan says, without bias, as exact as asked, and with a part of the rays of an even image."""
    even = jaxir.plan(SCENE, CAMERA, jaxir.MWIR, 3e-4, method=jaxir.Method())
    monkeypatch.setattr(_choices, "LITTLE", 0)
    monkeypatch.setattr(_choices, "MORE", (12, 32))  # of a pilot that every image takes
    plan = jaxir.plan(SCENE, CAMERA, jaxir.MWIR, 3e-4, method=jaxir.Method())
    assert even.samples > 8 * _choices.EVEN and plan.samples < even.samples / 3
    assert "rays each in the mean, 8 of them to find where the others are needed" in str(plan)
    images = [rendered(key, rtol=3e-4) for key in range(24)]
    assert all(bool(image.outcome == jaxir.Outcome.tolerance_met) for image in images)
    assert plan.samples / 2 < np.mean([int(image.samples) for image in images]) + 8 < plan.samples + 3
    truth = rendered(1000, pixel_rtol=1e-3, max_samples=2**16)
    intensity = np.array([image.radiant_intensity()[0] for image in images], float)
    known = float(truth.radiant_intensity()[0])
    spread, told = intensity.std(ddof=1), np.sqrt(np.mean([float(i.intensity_error()[0]) ** 2 for i in images]))
    assert 0.7 < spread / told < 1.35 and told <= 3e-4 * known  # 24 keys: standard deviation .15
    assert told > 0.5 * 3e-4 * known
    apart = np.hypot(spread / len(images) ** 0.5, float(truth.intensity_error()[0]))
    assert abs(intensity.mean() - known) < 4 * apart
    split = rendered(1, rtol=3e-4, components="sources")
    assert bool(split.outcome == jaxir.Outcome.tolerance_met)
    np.testing.assert_allclose(split.component_intensity().sum(axis=0), split.radiant_intensity(), rtol=1e-3)


def test_an_intensity_of_a_distant_target_takes_rays_in_its_pixels(monkeypatch, one_program):
    """Thirty in the mean, of which an even image takes 4000."""
    monkeypatch.setattr(_choices, "LITTLE", 0)
    monkeypatch.setattr(_choices, "MORE", (12, 32))
    far = jaxir.orthographic_camera(30.0, 20.0, 0.6, CAMERA.shape)
    images = [rendered(key, far, rtol=2e-3) for key in range(12)]
    assert all(bool(image.outcome == jaxir.Outcome.tolerance_met) for image in images)
    assert np.mean([int(image.samples) for image in images]) < 50
    intensity = np.array([image.radiant_intensity()[0] for image in images], float)
    assert 0.6e-3 < intensity.std(ddof=1) / intensity.mean() < 2.6e-3  # 12 keys: standard deviation .2


def test_edges_that_lie_along_pixels_are_not_missed():
    """A box whose edge takes a fifth of every pixel of a column: eight rays of a pilot miss it in some, two in most."""
    scene = jaxir.Scene(jaxir.Skin(box_mesh(), 320.0, jaxir.Lambert(0.7)))
    camera = jaxir.orthographic_camera(0.0, 0.0, 1 / 14.4, (16, 16))  # square to the eye, 14.4 pixels wide
    exact = float(jaxir.unoccluded_intensity(scene, 0.0, 0.0, jaxir.MWIR)[0])
    images = [jaxir.render(scene, camera, jaxir.MWIR, pixel_rtol=3e-3, key=jax.random.key(key)) for key in range(30)]
    apart = np.array([float(image.radiant_intensity()[0]) / exact - 1 for image in images])
    told = np.sqrt(np.mean([(float(image.intensity_error()[0]) / exact) ** 2 for image in images]))
    assert np.sqrt(np.mean(apart**2)) < 1.3 * told  # twice as much where edges that were not seen count for nothing
    assert abs(apart.mean()) < 4 * apart.std() / len(images) ** 0.5


def test_rays_lie_where_the_error_is(one_program):
    adaptive, even = rendered(1, pixel_rtol=1e-2), rendered(1, samples=72, rtol=0.1)
    error = [np.sqrt((np.asarray(i.standard_error) ** 2).sum()) for i in (adaptive, even)]
    assert error[0] < 0.5 * error[1] and int(adaptive.samples) <= 72 / 3.5


def test_a_scene_without_variance_takes_no_more_than_the_pilot():
    clear = jaxir.GridPlume(PLUME.grid, 500.0, jaxir.GrayGas(0.0))
    close = jaxir.orthographic_camera(35.0, 25.0, 1e-3, (32, 32), target=(0.5, 0.0, 0.0))  # one face fills the frame
    asked = {"pixel_rtol": 1e-3, "method": jaxir.Method()}
    image = jaxir.render(jaxir.Scene(SCENE.skin, clear), close, jaxir.MWIR, **asked)
    assert bool(image.outcome == jaxir.Outcome.tolerance_met) and int(image.samples) == 8
    assert float(np.min(image.radiance)) > 0
    cold = jaxir.Skin(SCENE.skin.mesh, np.ones(12), jaxir.Lambert(0.7))  # nothing at all in the MWIR
    assert float(np.max(jaxir.render(jaxir.Scene(cold, clear), CAMERA, jaxir.MWIR, **asked).radiance)) == 0


def test_what_comes_with_the_radiance_is_averaged_by_the_same_rays():
    """A sky that is not even, and orders of scattering."""
    sky = jaxir.ElevationTable([-90.0, 0.0, 90.0], [[5.0], [4.0], [1.0]])
    cloud = jaxir.GrayParticles(0.5, 0.8, jaxir.Isotropic())
    scene = jaxir.Scene(None, jaxir.GridPlume(PLUME.grid, 500.0, PLUME.gas, cloud), (), sky)
    camera = jaxir.perspective_camera(35.0, 25.0, 20.0, 5e-3, (32, 32))
    asked = dict(method=jaxir.Method(orders=2))
    image = jaxir.render(scene, camera, jaxir.MWIR, pixel_rtol=2e-2, **asked)
    even = jaxir.render(scene, camera, jaxir.MWIR, samples=2, rtol=1e-5, max_samples=64, **asked)
    assert int(image.samples) > 2
    np.testing.assert_allclose(image.empty, even.empty, rtol=0.02)
    np.testing.assert_allclose(image.orders, even.orders, rtol=0.2)
    error = float(np.hypot(image.intensity_error()[0], even.intensity_error()[0]))
    assert abs(float((image.radiant_intensity() - even.radiant_intensity())[0])) < 4 * error


def test_seconds_end_it_with_what_they_allowed():
    """Where they suffice they change nothing; where there are none the pilot is the answer."""
    asked = {"pixel_rtol": 1e-2}
    free, ample, none = (rendered(3, **asked, max_seconds=seconds) for seconds in (None, 1e9, 1e-9))
    assert bool(ample.outcome == jaxir.Outcome.tolerance_met) and bool(none.outcome == jaxir.Outcome.samples_spent)
    np.testing.assert_array_equal(np.asarray(ample.radiance), np.asarray(free.radiance))
    assert int(none.samples) == 8 and float(none.intensity_error()[0]) > float(free.intensity_error()[0])
    split = rendered(3, **asked, max_seconds=1e-9, components="sources")
    np.testing.assert_allclose(split.component_intensity().sum(axis=0), none.radiant_intensity(), rtol=1e-5)


@pytest.mark.parametrize("powers", [(1.0, 1.0), (1.5, 2.2)])
def test_one_more_ray_is_worth_the_same_in_every_pixel(powers):
    rng = np.random.default_rng(3)
    power = rng.choice(powers, (30, 40))
    constant = np.exp(rng.normal(-3.0, 3.0, (30, 40))) * (rng.uniform(size=(30, 40)) < 0.4)
    law = Law(constant, power)
    count = law.strata(2**40)
    assert (count[constant == 0] == 1).all()
    left = (constant[constant > 0] / (2.0 * count[constant > 0]) ** power[constant > 0]).sum()
    assert 0.97 * MARGIN**2 < left <= MARGIN**2
    many = count > 100
    worth = power[many] * constant[many] / (2.0 * count[many]) ** (power[many] + 1)
    assert worth.std() < 0.1 * worth.mean()
    capped = law.strata(64)
    assert capped.max() <= 32
    rays = 2 * (count - 1).sum()
    short = law.strata(2**40, rays / 10)
    assert 0.9 * rays / 10 < 2 * (short - 1).sum() <= rays / 10
    assert (short <= count).all()
    strata = strata_of(count, CAMERA)
    assert (strata.count == count[strata.row, strata.column]).all() and strata.count.min() > 1


def test_strata_are_nearly_square_and_near_what_is_wanted():
    wanted = np.linspace(0, 300, 3001)
    got = well_shaped_strata(wanted)
    steps = np.array([k * (k + more) for k in range(1, 20) for more in (0, 1)])
    assert (np.abs(got - wanted) <= np.abs(steps[:, None] - wanted).min(axis=0) + 1e-9).all()


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"pixel_rtol": 0.0}, "pixel_rtol: got 0.0, expected > 0"),
        ({"pixel_rtol": 1e-9}, "pixel_rtol: got 1e-09, expected at least"),
        ({"pixel_rtol": 0.1, "atol": 0.0}, "atol: got 0.0, expected a finite value > 0"),
        ({"pixel_rtol": 0.1, "max_seconds": -1.0}, "max_seconds: got -1.0, expected > 0"),
        ({"max_seconds": 1.0}, "max_seconds: got 1.0 alone, expected rtol, atol or pixel_rtol beside it"),
        ({"pixel_rtol": 1e-2, "samples": 8}, "samples: got 8 beside pixel_rtol"),
    ],
)
def test_what_cannot_be_asked_is_refused(asked, message):
    with pytest.raises(ValueError, match=message):
        rendered(0, **asked)
    with pytest.raises(ValueError, match="pixel_rtol: got traced values"):
        jax.jit(lambda key: jaxir.render(SCENE, CAMERA, jaxir.MWIR, key=key, pixel_rtol=1e-2).radiance)(
            jax.random.key(0)
        )


@pytest.mark.parametrize("asked", [{"rtol": 0.1}, {"pixel_rtol": 0.1}, {"rtol": 0.1, "samples": 8}], ids=str)
def test_a_target_smaller_than_a_pixel_is_found(asked, request):
    """Amid four pixels of which it takes a twentieth each: of few rays most keys have none that meets it."""
    if "samples" not in asked:
        request.getfixturevalue("one_program")
    scene = jaxir.Scene(jaxir.Skin(box_mesh(), 320.0, jaxir.Lambert(0.7)))
    camera = jaxir.orthographic_camera(35.0, 25.0, 2.3, (6, 6))
    exact = float(jaxir.unoccluded_intensity(scene, 35.0, 25.0, jaxir.MWIR)[0])
    images = [jaxir.render(scene, camera, jaxir.MWIR, key=jax.random.key(key), **asked) for key in range(24)]
    apart = np.array([float(image.radiant_intensity()[0]) / exact - 1 for image in images])
    assert all(bool(image.outcome == jaxir.Outcome.tolerance_met) for image in images)
    assert np.sqrt(np.mean(apart**2)) < 0.1 and np.abs(apart).max() < 0.3
    assert abs(apart.mean()) < 4 * apart.std(ddof=1) / len(apart) ** 0.5
    few = jaxir.render(scene, camera, jaxir.MWIR, max_samples=16, **asked)
    assert bool(few.outcome == jaxir.Outcome.samples_spent)  # which may miss it
    beside = jaxir.orthographic_camera(35.0, 25.0, 2.3, (6, 6), target=(0.0, 90.0, 0.0))
    image = jaxir.render(scene, beside, jaxir.MWIR, **asked)
    assert bool(image.outcome == jaxir.Outcome.tolerance_met) and int(image.samples) <= 8
    assert float(image.radiant_intensity()[0]) == 0
