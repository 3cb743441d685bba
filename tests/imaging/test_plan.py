"""A plan names every term, foretells the error, and is followed."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir.geometry import pixel_strata
from jaxir.imaging import ErrorLaw, Pilot, _choices, error_law, estimate_chunk, pilot, well_shaped, whole_image
from jaxir.imaging._chunks import as_number, first_pass
from jaxir.imaging._devices import stacked
from jaxir.imaging._pilot import OF_PILOTS
from tests.scenes import gray_box, plate

CAMERA = jaxir.orthographic_camera(30.0, 20.0, 0.06, (48, 48))
SUN = jaxir.ParallelSource((-1.0, 0.0, 0.0), 100.0)
SUNLIT = jaxir.Scene(plate(), sources=(SUN,), background=jaxir.BlackbodyBackground(250.0))


pytestmark = pytest.mark.usefixtures("one_program")


def test_a_plan_has_a_sentence_for_every_term():
    scene = jaxir.Scene(
        plate(), gray_box((1.0, 1.0, 1.0), 0.5), (SUN,), jaxir.BlackbodyBackground(250.0), jaxir.FixedPath(0.9, 0.1)
    )
    names = ["Plume", "Emission", "Sources", "Reflected light", "Bounces", "Background", "Air", "Pixels"]
    lit = jaxir.plan(scene, CAMERA, jaxir.LWIR, 0.02)
    assert [(term.name, term.exact) for term in lit.terms] == [(n, n not in (*names[3:5], "Pixels")) for n in names]
    assert lit.method == jaxir.Method(bounces=1).resolved(scene) and lit.bounces < 0.01  # the plume lights the plate
    assert "DirectSampling(1 of each light, 1 of the brdf) with Independent points, as by default" in str(lit)
    bare = jaxir.plan(SUNLIT, CAMERA, jaxir.LWIR, 0.02)
    in_vacuum = ["Emission", "Sources", "Reflected light", "Background", "Pixels"]
    assert [term.name for term in bare.terms] == in_vacuum
    found = jaxir.plan(SUNLIT, CAMERA, jaxir.LWIR, 0.02, method=jaxir.Method(direct=None))
    assert [(term.name, term.exact) for term in found.terms] == [
        (name, name != "Pixels") for name in in_vacuum if name != "Reflected light"
    ]
    for told in (lit, bare, found):
        lines, terms = str(told).splitlines(), told.terms
        assert all(x.startswith(f"{term.name}: ") and x.endswith(".") for term, x in zip(terms, lines, strict=True))
    depth = 0.5 * 1.0 / (np.cos(np.deg2rad(30.0)) * np.cos(np.deg2rad(20.0)))  # through two opposite faces
    depth_told = f"integrated along every ray, no sampling; the largest optical depth is {depth:.2g}."
    assert str(lit).splitlines()[0].endswith(depth_told)
    assert found.method.direct is None
    assert all(told.seconds > 0 and told.compile_seconds > 0 for told in (lit, found))


@pytest.mark.parametrize("rtol", [2e-2, 1.5e-3])
def test_render_follows_the_plan_which_foretells_its_error(rtol):
    key = jax.random.key(3)
    found = jaxir.plan(SUNLIT, CAMERA, jaxir.LWIR, rtol, key=key)
    image = jaxir.render(SUNLIT, CAMERA, jaxir.LWIR, rtol=rtol, key=key)
    assert image.outcome == jaxir.Outcome.tolerance_met
    assert int(image.samples) == found.samples
    reached = float(image.intensity_error()[0] / image.radiant_intensity()[0])
    assert 0.7 < reached / found.expected < 1.4
    assert reached <= rtol and found.expected <= rtol
    assert (found.samples > 2) == (rtol < 0.01)


def test_a_closed_form_is_chosen_where_it_holds_and_samples_would_vary():
    """A plate close to a disc larger than itself, which sampled points of the disc light unevenly."""
    disc = jaxir.DiscSource((0.3, 0.0, 0.0), (-1.0, 0.0, 0.0), 2.0, 1000.0)
    scene = jaxir.Scene(plate(temperature=3.0), sources=(disc,))
    found = jaxir.plan(scene, CAMERA, jaxir.LWIR, 0.012)
    assert isinstance(found.method.direct, jaxir.ClosedForm)
    assert {term.name: term.exact for term in found.terms}["Reflected light"]
    asked = jaxir.Method(jaxir.DirectSampling(1, 0))
    kept = jaxir.plan(scene, CAMERA, jaxir.LWIR, 0.5, method=asked)
    assert kept.method == asked.resolved(scene)
    assert "as asked" in str(kept)


def test_light_without_a_closed_form_is_sampled_within_the_tolerance():
    lamp = jaxir.SphereSource((3.0, 0.0, 0.0), 0.4, 1e4)
    scene = jaxir.Scene(plate(temperature=3.0), sources=(lamp,))
    image = jaxir.render(scene, CAMERA, jaxir.LWIR, rtol=2e-2)
    found = jaxir.plan(scene, CAMERA, jaxir.LWIR, 2e-2)
    assert "sampled by" in str(found) and "the cheapest of 4 in pilots" in str(found)
    assert image.outcome == jaxir.Outcome.tolerance_met


def test_samples_that_do_not_suffice_are_said_so():
    found = jaxir.plan(SUNLIT, CAMERA, jaxir.LWIR, 1e-5, max_samples=32)
    assert found.samples <= 32 and found.expected > 1e-5
    assert "which is all that is allowed" in str(found)


def test_an_absolute_error_is_enough_for_a_band_that_is_faint():
    """The plate sends a fifth of its LWIR in the MWIR, and its edges vary as much."""
    bands, key = (jaxir.MWIR, jaxir.LWIR), jax.random.key(3)
    lit = jaxir.Scene(plate(), sources=(jaxir.ParallelSource((-1.0, 0.0, 0.0), [1.0, 100.0]),))
    every = jaxir.plan(lit, CAMERA, bands, 2e-3, key=key)
    intensity = np.asarray(jaxir.render(lit, CAMERA, bands, samples=8, rtol=0.5).radiant_intensity())
    assert intensity[0] < intensity[1] / 5
    alike = jaxir.plan(lit, CAMERA, bands, atol=2e-3 * float(intensity[1]), key=key)
    larger = jaxir.plan(lit, CAMERA, bands, 1e-5, atol=2e-3 * float(intensity[1]), key=key)
    assert alike.samples == larger.samples <= every.samples
    assert str(every).count("of the 0.002 asked") == 1 and "W/sr asked" in str(alike) and " or " in str(larger)
    image = jaxir.render(lit, CAMERA, bands, atol=2e-3 * float(intensity[1]), key=key)
    assert image.outcome == jaxir.Outcome.tolerance_met and int(image.samples) == alike.samples
    assert (np.asarray(image.intensity_error()) <= 2e-3 * intensity[1] * 1.01).all()
    coarse = jaxir.plan(lit, CAMERA, bands, atol=0.2 * float(intensity[0]), key=key)
    assert coarse.samples < every.samples
    with pytest.raises(ValueError, match="rtol: got None, expected rtol or atol"):
        jaxir.plan(lit, CAMERA, bands)


def test_seconds_bound_the_rays_of_a_plan():
    free = jaxir.plan(SUNLIT, CAMERA, jaxir.LWIR, 1e-5, max_samples=512)
    short = jaxir.plan(SUNLIT, CAMERA, jaxir.LWIR, 1e-5, max_samples=512, max_seconds=free.seconds / 8)
    assert short.samples < free.samples / 2 and short.seconds <= free.seconds / 8
    assert "which is all that is allowed" in str(short)
    ended = jaxir.render(SUNLIT, CAMERA, jaxir.LWIR, rtol=1e-5, max_samples=512, max_seconds=1e-9)
    assert ended.outcome == jaxir.Outcome.samples_spent and int(ended.samples) == 2
    passes = jaxir.render(SUNLIT, CAMERA, jaxir.LWIR, rtol=1e-5, samples=2, max_samples=512, max_seconds=1e-9)
    assert passes.outcome == jaxir.Outcome.samples_spent and int(passes.samples) == 2


def test_a_pilot_of_all_chunks_is_the_image():
    taken = first_pass(SUNLIT, CAMERA, jaxir.LWIR, jax.random.key(5), 24, jaxir.Method())
    seen = pilot(taken)
    same = taken._replace(number=as_number(OF_PILOTS))
    image = whole_image(same, stacked(estimate_chunk, same.of_chunks(), same.chunks(), "image"))
    np.testing.assert_allclose(seen.intensity, image.radiant_intensity(), rtol=1e-5)
    np.testing.assert_allclose(seen.variance, image.intensity_error() ** 2, rtol=1e-4)


def test_the_error_law_is_recovered_and_inverted():
    law = ErrorLaw(np.array([3.0, 0.0, 0.0, 0.0]), np.array([0.5, 2.0, 0.3, 0.0]), np.array([0.0, 0.0, 4.0, 5.0]))
    pilots = [(n, Pilot(np.ones(4), law.variance(n), 1.0, 1.0, np.zeros(4))) for n in (2, 12)]
    found = error_law(*pilots)
    for name in law._fields:
        np.testing.assert_allclose(getattr(found, name), getattr(law, name), rtol=1e-9, atol=1e-12, err_msg=name)
    allowed = np.full(4, 0.1)
    samples = found.samples(allowed, 4096)
    fewer = well_shaped(samples)[-2]
    assert (law.variance(samples) <= allowed).all() and (law.variance(fewer) > allowed).any()
    assert all(abs(np.subtract(*pixel_strata(count))) <= 1 for count in well_shaped(4096))
    for power in (-0.5, 0.5, 4.0):  # beyond the law's powers: through the second pilot, no part below 0
        pair = [(n, Pilot(np.ones(1), np.array([n**-power]), 1.0, 1.0, np.zeros(1))) for n in (2, 12)]
        assert min(float(part[0]) for part in error_law(*pair)) >= 0
        np.testing.assert_allclose(error_law(*pair).variance(12), 12.0**-power, rtol=1e-12)


def test_a_smooth_field_is_foretold_between_the_pilots():
    """Its error falls much from two rays to four: by the law of edges alone two would seem to do."""
    grid = jaxir.Grid((-4.0, -0.5, -0.5), (0.25, 0.25, 0.25), (16, 4, 4))
    plume = jaxir.GridPlume(grid, 1200.0 + 150.0 * grid.centres()[..., 0], jaxir.GrayGas(1e-3))
    scene, camera = jaxir.Scene(plumes=plume), jaxir.orthographic_camera(40.0, 15.0, 0.15, (48, 48), (-1.0, 0.0, 0.0))
    image = jaxir.render(scene, camera, jaxir.LWIR, samples=4, rtol=0.5)
    rtol = float(image.intensity_error()[0] / image.radiant_intensity()[0])
    for key in range(3):
        found = jaxir.plan(scene, camera, jaxir.LWIR, rtol, key=jax.random.key(key))
        image = jaxir.render(scene, camera, jaxir.LWIR, samples=found.samples, rtol=0.5, key=jax.random.key(9))
        reached = float(image.intensity_error()[0] / image.radiant_intensity()[0])
        assert found.samples in (4, 6, 8) and 0.7 < reached / found.expected < 1.4


@pytest.mark.parametrize("entry", [jaxir.plan, lambda *rest: jaxir.render(*rest[:3], rtol=rest[3])])
def test_a_tolerance_out_of_reach_is_refused(entry):
    ask = (SUNLIT, CAMERA, jaxir.LWIR)
    for bad in (0.0, -1.0, float("nan")):
        with pytest.raises(ValueError, match=r"rtol: got .*, expected > 0"):
            entry(*ask, bad)
    with pytest.raises(ValueError, match=r"rtol: got 1e-08, expected at least 9.5e-07 in float32; .* needs float64"):
        entry(*ask, 1e-8)
    with pytest.raises(ValueError, match="needs more than float64"):
        entry(*ask, 1e-17)
    with pytest.raises(ValueError, match="got traced values"):
        jax.jit(lambda t: jnp.asarray(entry(jaxir.Scene(plate(temperature=t)), *ask[1:], 0.1)))(300.0)


def cloud(extinction):
    """A warm cube of particles of albedo .95."""
    grid = jaxir.Grid((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5), (2, 2, 2))
    particles = jaxir.GrayParticles(extinction, 0.95, jaxir.Isotropic())
    return jaxir.Scene(plumes=jaxir.GridPlume(grid, 600.0, jaxir.GrayGas(0.01), particles))


def test_particles_get_orders_where_those_leave_out_little_and_else_a_lattice(monkeypatch):
    """The image tells what the plan told."""
    monkeypatch.setattr(_choices, "LATTICES", (jaxir.DiscreteOrdinates(7, 7, 1),))
    monkeypatch.setattr(_choices, "SAMPLED", 2)
    monkeypatch.setattr(_choices, "FEW_ORDERS", 10)  # fewer are one program more
    camera = jaxir.orthographic_camera(30.0, 20.0, 0.06, (16, 16))
    thin = jaxir.plan(cloud(0.02), camera, jaxir.MWIR, 0.05)
    assert [term.name for term in thin.terms] == ["Plume", "Particles", "Pixels"]
    assert thin.method.orders == 10 and thin.method.scattering is None and thin.truncation < 1e-3
    image = jaxir.render(cloud(6.0), camera, jaxir.MWIR, rtol=0.07)
    thick = image.asked.method
    assert thick.scattering == jaxir.DiscreteOrdinates(7, 7, 1)
    again = jaxir.plan(cloud(6.0), camera, jaxir.MWIR, 0.07)
    assert again.method == thick
    np.testing.assert_allclose(image.truncation[0], again.truncation, rtol=2e-3)  # of intensities by other rays
    strict = jaxir.plan(cloud(6.0), camera, jaxir.MWIR, 0.01)  # less than this lattice errs
    assert strict.method.scattering == jaxir.DiscreteOrdinates(7, 7, 1, 2) and not strict.terms[1].exact
    assert strict.truncation < again.truncation
    assert "what it errs sampled up to 2 times" in strict.terms[1].sentence
    told = str(again).splitlines()[1]
    assert told.startswith("Particles: light scattered however often, by a lattice of 7 x 7 points")
    assert "forced collision up to 10 times would lack" in told
    table = jaxir.signature(cloud(6.0), [(30.0, 20.0), (0.0, 90.0)], jaxir.MWIR, shape=(16, 16), rtol=0.07)
    assert table.asked.method == thick and table.meets(0.07).all() and not table.meets(0.01).any()
