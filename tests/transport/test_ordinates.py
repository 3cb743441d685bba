"""Scattered light solved on a lattice: a furnace, symmetries, forced collision, derivatives."""

import dataclasses
import functools
import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from scipy.special import eval_legendre

import jaxir
from jaxir import DiscreteOrdinates, Method
from jaxir._arrays import as_float
from jaxir.geometry import Eye, degrees, harmonics, sphere_rule
from jaxir.optics.spectrum import gray_nodes
from jaxir.transport import aimed, lattice_error, lattice_lacks, with_scattered
from jaxir.transport.evaluation import _scattered
from jaxir.transport.ordinates._lattice import places
from jaxir.transport.ordinates._medium import chosen_rays

optimised = pytest.mark.optimised
COARSE = Method(scattering=DiscreteOrdinates(5, 4, 2))
BALL = DiscreteOrdinates(9, 9, 1)


def box(extinction, albedo, phase, temperature=600.0, absorption=0.0, cells=4):
    """A cube of 2 m."""
    grid = jaxir.Grid((-1.0, -1.0, -1.0), (2 / cells,) * 3, (cells,) * 3)
    return jaxir.GridPlume(grid, temperature, jaxir.GrayGas(absorption), jaxir.GrayParticles(extinction, albedo, phase))


def jet(exit_temperature=900.0, nozzle=(0.0, 0.0, 0.0), absorption=0.3, extinction=2.0):
    particles = jaxir.GrayParticles(extinction, 0.9, jaxir.HenyeyGreenstein(0.5))
    axis, gas = (-1.0, 0.0, 0.0), jaxir.GrayGas(absorption)
    return jaxir.JetPlume(nozzle, axis, 0.6, exit_temperature, 250.0, gas, length=12.0, panels=6, particles=particles)


def rays_through(count, towards=(0.3, 0.9, -0.2), about=(0.0, 0.0, 0.0), width=1.6, seed=0):
    """Parallel rays through a square about a point."""
    w = np.asarray(towards) / np.linalg.norm(towards)
    side = np.linalg.svd(w[None])[2][1:]
    place = (np.random.default_rng(seed).uniform(size=(count, 2)) - 0.5) * width
    origin = np.asarray(about) - 20 * w + place @ side
    return jaxir.Rays(jnp.asarray(origin), jnp.broadcast_to(jnp.asarray(w), origin.shape))


@eqx.filter_jit
def seen_by(lit, rays, method, key):
    return jaxir.evaluate(lit, jaxir.trace(lit.scene, rays, method, key))


def look(scene, rays, method, key=None):
    """Radiance of rays; solved and seen by programs that other tests share, where values are known."""
    lit = with_scattered(scene.on(gray_nodes((jaxir.MWIR,))), method)
    assert with_scattered(lit, method) is lit  # solving once serves all paths
    return seen_by(lit, rays, method, key)


@pytest.mark.parametrize("order", [1, 4])
def test_harmonics_are_orthonormal_and_add(x64, order):
    """integral Y_i Y_j = delta_ij, and sum_m Y_lm(a) Y_lm(b) = (2 l + 1) / 4 pi P_l(a . b)."""
    direction, weight = sphere_rule(2 * order)
    values = np.asarray(harmonics(jnp.asarray(direction), order))
    np.testing.assert_allclose(values.T * weight @ values, np.eye((order + 1) ** 2), atol=1e-12)
    a, b = values[:3], values[3:6]
    cosine = np.sum(direction[:3] * direction[3:6], axis=1)
    for degree in range(order + 1):
        own = degrees(order) == degree
        expected = (2 * degree + 1) / (4 * np.pi) * eval_legendre(degree, cosine)
        np.testing.assert_allclose((a * b)[:, own].sum(axis=1), expected, atol=1e-12)


@pytest.mark.parametrize("g", [0.0, 0.5, 0.95, -0.9])
def test_moments_of_henyey_and_greenstein_are_powers(precision, g):
    got = np.asarray(jaxir.HenyeyGreenstein(g).moments(6))[:, 0]
    np.testing.assert_allclose(got, g ** np.arange(7), rtol=1e-5, atol=2e-6)


def test_moments_of_a_table(x64):
    """Against the trapezoidal rule between its samples, a thousand points each."""
    cosine = np.cos(np.linspace(np.pi, 0, 91))
    phase = jaxir.TabulatedPhase(cosine, np.exp(3 * cosine))
    fine = np.unique(np.concatenate([np.linspace(a, b, 1001) for a, b in itertools.pairwise(cosine)]))
    value = np.interp(fine, cosine, np.asarray(phase.value)[0])
    exact = [2 * np.pi * np.trapezoid(value * eval_legendre(degree, fine), fine) for degree in range(5)]
    np.testing.assert_allclose(np.asarray(phase.moments(4))[:, 0], exact, rtol=1e-4)


def block(size, temperature, height=0.0):
    """Black skin."""
    mesh = trimesh.creation.box(size)
    return jaxir.Skin(jaxir.Mesh(mesh.vertices + [0.0, 0.0, height], mesh.faces), temperature, jaxir.Lambert(1.0))


@pytest.mark.parametrize("asymmetry, walls", [(0.0, False), (0.8, False), (0.8, True)])
def test_furnace(x64, asymmetry, walls):
    """Gas and particles as warm as all around them look like a black body, however light is scattered."""
    black = jaxir.band_radiance(jnp.asarray(600.0), gray_nodes((jaxir.MWIR,)))
    scene = jaxir.Scene(
        block((60.0, 60.0, 60.0), 600.0) if walls else None,
        box(2.0, 0.9, jaxir.HenyeyGreenstein(asymmetry), absorption=0.3),
        jaxir.ParallelSource((0.0, 0.0, -1.0), 0.0) if walls else (),  # for the programs of what skin shades
        background=None if walls else jaxir.UniformBackground(black),
    )
    got = look(scene, rays_through(50), COARSE)
    np.testing.assert_allclose(got, np.broadcast_to(black, got.shape), rtol=1e-4)


def test_a_sky_that_is_not_seen_is_scattered_forward_too(x64):
    """All that does not pass straight was scattered out of it; of a lobe forward, 1 to 66 % of that were missing."""
    plume = box(2.0, 1.0, jaxir.HenyeyGreenstein(0.8), 3.0)
    scene, rays = jaxir.Scene(None, plume, jaxir.UniformBackground(1.0)), rays_through(50)
    passed = scene.on(gray_nodes((jaxir.MWIR,))).medium.transmittance(rays, jnp.full(50, jnp.inf))
    np.testing.assert_allclose(look(scene, rays, COARSE), 1 - passed, rtol=1e-4)


def in_the_sun():
    """A warm jet with a forward lobe in the sun, and parallel rays through it."""
    scene = jaxir.Scene(None, jet(450.0), jaxir.ParallelSource((0.0, 0.0, -1.0), 30.0))
    return scene, rays_through(2000, about=(-3.0, 0.0, 0.0), width=4.0)


def lattice(orders):
    """Of few points, so that what it errs shows."""
    return Method(scattering=DiscreteOrdinates(5, 4, orders=orders))


def seen(method, keys):
    """Radiance in the sun by random key [key, ray], of one solution."""
    scene, rays = in_the_sun()
    lit = with_scattered(scene.on(gray_nodes((jaxir.MWIR,))), method)
    each = [seen_by(lit, rays, method, key)[:, 0] for key in jax.random.split(jax.random.key(7), keys)]
    return np.asarray(each, np.float64)


@functools.cache
def forced():
    """Radiance by forced collision [key, ray], and the mean over rays with its standard error."""
    each = seen(Method(orders=12), 48)
    return each, each.mean(), each.mean(axis=1).std(ddof=1) / np.sqrt(len(each))


@optimised
def test_agrees_with_forced_collision():
    """The mean over rays, within errors and 2 % of the lattice's."""
    _, mean, error = forced()
    solved = seen(Method(scattering=DiscreteOrdinates(17, 7)), 1).mean()
    assert error < 0.01 * solved
    assert abs(solved - mean) < 3 * error + 0.02 * solved


@optimised
def test_what_the_lattice_errs_is_sampled_without_bias_and_with_little_noise():
    """Against forced collision."""
    each, mean, own = forced()
    both = seen(lattice(6), 24)
    error = np.hypot(own, both.mean(axis=1).std(ddof=1) / np.sqrt(len(both)))
    assert abs(both.mean() - mean) < 3 * error and error < 0.005 * mean
    assert both.var(axis=0, ddof=1).mean() < each.var(axis=0, ddof=1).mean() / 4
    assert abs(seen(lattice(0), 1).mean() - mean) > 5 * error  # the lattice alone errs by more than the test allows


@optimised
@pytest.mark.parametrize("away", [0.0, 5.0, 70.0])
@pytest.mark.parametrize("depth", [0.3, 1.0])
def test_the_sun_is_seen_through_particles_with_its_halo(depth, away):
    """Against forced collision: scattered once with the whole lobe the sun is 8 to 30 % too bright, aside right."""
    angle = np.deg2rad(away)
    plume = box(depth / 2, 0.95, jaxir.HenyeyGreenstein(0.8), 200.0)
    scene = jaxir.Scene(plumes=plume, sources=(jaxir.ParallelSource((0.0, 0.0, -1.0), 100.0),))
    rays = rays_through(8192, (np.sin(angle), 0.0, np.cos(angle)))
    every = np.stack([look(scene, rays, Method(orders=8), jax.random.key(k))[:, 0] for k in range(4)]).mean(axis=1)
    known, error = every.mean(), every.std(ddof=1) / 2
    found = look(scene, rays, Method(scattering=DiscreteOrdinates(9, 9, 3)))[:, 0].mean()
    np.testing.assert_allclose(found, known, atol=4 * error + 0.025 * known)


def test_a_deep_jet_is_lit_by_the_sun_on_its_side():
    """Between the lattice's points, by sums of E s p exp(-to and from); by depths read there 8 % are missing."""
    particles = jaxir.GrayParticles(60.0, 1e-3, jaxir.HenyeyGreenstein(0.5))
    plume = eqx.tree_at(lambda plume: plume.particles, jet(50.0, absorption=0.3), particles)
    scene = jaxir.Scene(None, plume, jaxir.ParallelSource((0.0, 0.0, -1.0), 1e4))
    rays = rays_through(60, about=(-3.0, 0.0, 0.0), width=4.0)
    found = look(scene, rays, lattice(0)).mean()

    @jax.jit
    def sums(medium, rays):
        t, step = np.linspace(17.0, 23.0, 2000, retstep=True)
        along = jax.tree.map(lambda x: jnp.repeat(x, len(t), axis=0), rays)
        t = as_float(np.tile(t, rays.count))
        point, up = along.at(t), jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0]), along.origin.shape)
        left = medium.transmittance(along, t) * medium.transmittance(jaxir.Rays(point, up), jnp.full(len(t), jnp.inf))
        once = 1e4 * medium.scattering(point, along.direction[:, 2]) * left * step
        dark = medium.radiance(rays, jnp.full(rays.count, jnp.inf), jnp.zeros((rays.count, 1))).mean()
        return dark, once.sum() / rays.count

    dark, once = map(float, sums(scene.on(gray_nodes((jaxir.MWIR,))).medium, rays))
    np.testing.assert_allclose(float(found) - dark, once, rtol=3e-3)


def ball_in_the_sun(extinction, albedo):
    """A ball of cells: points of the lattice lie near sides of cells, across which the way to the sun jumps."""
    side = (np.arange(16) + 0.5) / 8 - 1
    inside = np.sum(np.stack(np.meshgrid(side, side, side)) ** 2, axis=0)[..., None] < 1
    grid = jaxir.Grid((-1.0, -1.0, -1.0), (1 / 8,) * 3, (16,) * 3)
    particles = jaxir.GrayParticles(inside * extinction, albedo, jaxir.Isotropic())
    plume = jaxir.GridPlume(grid, 50.0, jaxir.GrayGas(0.0), particles)
    scene = jaxir.Scene(None, plume, jaxir.ParallelSource((-0.6, 0.0, -0.8), 100.0))
    return scene, rays_through(2000, (0.0, -1.0, 0.0), width=2.2)


THICK = jaxir.GrayParticles(6.0, 0.99, jaxir.HenyeyGreenstein(0.6))
ball = functools.partial(ball_in_the_sun, 1.0, 0.1)


def test_the_sun_in_cells_that_lie_along_its_light():
    scene, rays = ball()
    known = look(scene, rays, Method(orders=2), jax.random.key(1)).mean()
    found = look(scene, rays, Method(scattering=BALL)).mean()
    np.testing.assert_allclose(found, known, rtol=0.012)  # -.02 where only the points themselves see the sun


def test_hot_cells_that_meet_in_the_lattice_shine_alike_to_all_sides():
    """No direction to a point runs along the sides of cells on which it lies; one that did sees one of both for all."""
    side = (np.arange(6) + 0.5) / 3 - 1
    square = np.sum(np.stack(np.meshgrid(side, side, side)) ** 2, axis=0)
    inside = (square < 0.8)[..., None]
    particles = jaxir.GrayParticles(inside * 2.0, 0.9, jaxir.HenyeyGreenstein(0.3))
    grid = jaxir.Grid((-1.0, -1.0, -1.0), (1 / 3,) * 3, (6,) * 3)
    scene = jaxir.Scene(
        None, jaxir.GridPlume(grid, 600.0 * np.exp(-square / 4), jaxir.GrayGas(inside * 0.4), particles)
    )
    method = Method(scattering=DiscreteOrdinates(7, 7))
    lit = with_scattered(scene.on(gray_nodes((jaxir.MWIR,))), method)
    place = (np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2) + 0.01) * 0.9
    mean = []
    for axis, sign in np.ndindex(3, 2):
        origin = np.insert(np.concatenate([place, -place]), axis, 9.0 * (2 * sign - 1), axis=1)
        toward = np.broadcast_to(np.eye(3)[axis] * (1 - 2 * sign), origin.shape)
        rays = jaxir.Rays(jnp.asarray(origin, jnp.float32), jnp.asarray(toward, jnp.float32))
        mean.append(float(seen_by(lit, rays, method, None).mean()))
    assert max(mean[:4]) < 1.001 * min(mean[:4])  # x and y
    assert max(mean) < 1.01 * min(mean)


@optimised
def test_light_out_of_the_end_of_a_jet_is_seen():
    """From behind a thick jet shines by a free path of light at its end, far less than what lies between stations."""
    made = dataclasses.replace(jet(), length=40.0, gas=jaxir.GrayGas(0.05), particles=THICK)
    scene = jaxir.Scene(None, made)
    frame = jaxir.fitted_camera(180.0, 0.0, scene.extent(), (1, 1))
    screen = frame.half_size()[None] * as_float(np.random.default_rng(0).uniform(-1, 1, (2000, 2)))
    rays, mean = frame.bundle(screen, scene.start(frame)).rays(), []
    for kind in (DiscreteOrdinates(61, 9), DiscreteOrdinates(21, 7)):
        lit = with_scattered(scene.on(gray_nodes((jaxir.MWIR,))), Method(scattering=kind))
        mean.append(float(seen_by(lit, rays, Method(scattering=kind), None).mean()))
    fine, coarse = mean
    told = float(lattice_error(lit, lattice_lacks(lit.in_vacuum(), frame))[0]) / float(frame.pixel_area().sum())
    assert abs(coarse - fine) < min(0.03 * fine, told)


@optimised
def test_what_a_lattice_errs_in_cells_in_the_sun_is_told():
    """Where light is scattered often, to a fifth, against the same lattice with what it errs sampled."""
    scene, rays = ball_in_the_sun(2.0, 0.95)
    sampled = Method(scattering=DiscreteOrdinates(9, 9, 1, orders=6))
    each = np.asarray([look(scene, rays, sampled, key).mean() for key in jax.random.split(jax.random.key(2), 6)])
    known, error = each.mean(), each.std(ddof=1) / np.sqrt(len(each))
    lit = with_scattered(scene.on(gray_nodes((jaxir.MWIR,))), Method(scattering=BALL))
    whole, rough, reading, beams, pieces = (np.asarray(part).mean() for part in lacking(lit, rays))
    told = reading + abs(beams) + pieces + abs(whole - rough)
    assert error < 0.003 * known < abs(whole - known) < 1.2 * told + 3 * error
    assert told < 0.04 * known


@eqx.filter_jit
def lacking(lit, rays):
    eye = Eye(jnp.zeros(3), -rays.direction[0], jnp.zeros(()))  # which they share
    return lit.medium.aimed_at(eye).lacking(rays, jnp.full(rays.count, jnp.inf), 0)


@eqx.filter_jit
def to_an_eye(medium, aimed_one, rays):
    """Radiance of rays by what was found once for an eye, with whether that serves; and without."""
    far, dark = jnp.full(rays.count, jnp.inf), jnp.zeros((rays.count, medium.nodes))
    serves = aimed_one.parts[0].aimed.serves(rays)
    return aimed_one.radiance(rays, far, dark), serves, medium.radiance(rays, far, dark)


BANDS = (jaxir.MWIR, jaxir.LWIR)


@pytest.mark.parametrize(
    "made, method, bands", [(in_the_sun, lattice(0), BANDS[:1]), (ball, Method(scattering=BALL), BANDS)]
)
def test_what_is_found_for_an_eye_is_what_its_rays_see(made, method, bands):
    """Other rays, and those whose directions turn by much between the lattice's points, are looked along one by one."""
    scene, others = made()
    lit = with_scattered(scene.on(gray_nodes(bands)), method)
    for distance, meets in ((np.inf, True), (5e3, True), (20.0, False), (None, False)):
        camera = jaxir.fitted_camera(70.0, 20.0, scene.extent(), (8, 8), distance or np.inf)
        screen = camera.half_size()[None] * as_float(np.random.default_rng(0).uniform(-1, 1, (500, 2)))
        rays = (
            camera.bundle(screen, scene.start(camera)).rays() if distance else jax.tree.map(lambda x: x[:500], others)
        )
        found, serves, known = to_an_eye(lit.medium, aimed(lit, camera).medium, rays)
        assert bool(serves) is meets
        np.testing.assert_allclose(found, known, rtol=1e-4, atol=2e-5 * float(known.max()))


@pytest.mark.parametrize("away, narrow", [(5.0, False), (5e3, True)])
def test_lobes_of_lamps_nearby_are_looked_up_along_rays(away, narrow):
    lamp = jaxir.PointSource((0.0, 0.0, away), 50.0)
    lit = with_scattered(
        jaxir.Scene(None, box(1.0, 0.9, jaxir.Isotropic()), lamp).on(gray_nodes((jaxir.MWIR,))), COARSE
    )
    ready = aimed(lit, jaxir.orthographic_camera(0, 0, 0.3, (8, 8))).medium
    assert bool(ready.parts[0].aimed.narrow) is narrow


def test_derivatives_of_what_an_eye_sees():
    """In the light and in the depth towards the sun where that is read, as without it, in both modes."""
    scene, _ = in_the_sun()
    lit = with_scattered(scene.on(gray_nodes((jaxir.MWIR,))), lattice(0))
    lit = eqx.tree_at(lambda lit: lit.medium.parts[0].beams[0].misread, lit, jnp.zeros(()))
    camera = jaxir.fitted_camera(70.0, 20.0, scene.extent(), (8, 8))
    screen = camera.half_size()[None] * as_float(np.random.default_rng(0).uniform(-1, 1, (200, 2)))
    rays = camera.bundle(screen, scene.start(camera)).rays()
    parts = lambda lit: (lit.medium.parts[0].moments, lit.medium.parts[0].beams[0].depth)  # noqa: E731

    @jax.jit
    def both(values, along):
        def mean(values, once):
            own = eqx.tree_at(parts, lit, [x * value for x, value in zip(parts(lit), values, strict=True)])
            own = aimed(own, camera) if once else own
            return own.medium.radiance(rays, jnp.full(200, jnp.inf), jnp.zeros((200, 1))).mean()

        once = functools.partial(mean, once=True)
        return jax.grad(once)(values), jax.jvp(once, (values,), (along,))[1], jax.grad(mean)(values, False)

    reverse, forward, known = map(np.asarray, both(jnp.ones(2), jnp.array([1.0, 0.1])))
    assert abs(known[1]) > 0.01 * abs(known[0]) > 0
    np.testing.assert_allclose(reverse, known, rtol=1e-3)
    np.testing.assert_allclose(forward, known @ [1.0, 0.1], rtol=1e-3)


def test_an_image_tells_what_the_last_order_changed():
    scene, _ = in_the_sun()
    camera = jaxir.fitted_camera(90, 0, scene.extent(), (16, 32))
    image = jaxir.render(scene, camera, [jaxir.MWIR], samples=4, method=lattice(6))
    assert image.orders is not None and image.unresolved is not None
    intensity, changed = float(image.radiant_intensity()[0]), np.abs(image.orders)
    assert 0 < float(changed[0, 0]) < 0.05 * intensity
    np.testing.assert_allclose(image.truncation, (image.unresolved + changed[0]) / intensity, rtol=1e-6)


def test_what_a_lattice_lacks_is_told_of_the_plume_and_not_of_the_contrast():
    """A cold plate beside a jet before a warm sky takes most of the contrast, and nothing of what is lacking."""
    scene = jaxir.Scene(None, jet(450.0))
    camera = jaxir.orthographic_camera(90, 0, 0.5, (16, 64), target=(-3.0, 0.0, 0.0))

    def told(depth, sky):
        """Of a plate so many metres deep: intensity, and what is lacking."""
        plate = jaxir.Mesh(
            [[-12.0, 0, -1], [-11, 0, -1], [-11, 0, -1 + depth], [-12, 0, -1 + depth]], [[0, 1, 2], [0, 2, 3]]
        )
        skin = jaxir.Skin(plate, 3.0, jaxir.Lambert(1.0))
        seen = dataclasses.replace(scene, skin=skin, background=jaxir.UniformBackground(sky))
        image = jaxir.render(seen, camera, [jaxir.MWIR], samples=2, method=lattice(0))
        return float(image.radiant_intensity()[0]), float(image.error_budget(look=False).truncation[0])

    sky = told(1e-3, 0.0)[0] / 10.0
    (bright, much), (dark, same) = told(1e-3, sky), told(4.5, sky)
    assert abs(dark) < abs(bright) / 2 and much > 0
    np.testing.assert_allclose(same, much, rtol=0.05)


def test_derivatives_of_what_is_sampled_are_those_of_the_expected_value(x64):
    """By temperature, loading and albedo: those of a finer lattice, within the errors of keys."""
    rays, at = rays_through(200), jnp.array([600.0, 1.5, 0.8])

    def mean(values, method, key=None):
        temperature, extinction, albedo = values
        plume = box(extinction, albedo, jaxir.HenyeyGreenstein(0.5), temperature, absorption=0.2, cells=2)
        return look(jaxir.Scene(None, plume), rays, method, key).mean()

    finer, steps = Method(scattering=DiscreteOrdinates(7, 7, 2)), 1e-3 * jnp.diag(at)
    fine = np.asarray([float(mean(at + step, finer) - mean(at - step, finer)) / 2e-3 for step in steps])
    coarse = Method(scattering=DiscreteOrdinates(5, 5, 2, orders=3))
    sloped = jax.jit(jax.grad(lambda values, key: mean(values, coarse, key)))
    each = np.asarray([sloped(at, key) * at for key in jax.random.split(jax.random.key(0), 8)])
    error = each.std(axis=0, ddof=1) / np.sqrt(8)
    assert np.all(error < 0.02 * np.abs(fine))
    assert np.all(np.abs(each.mean(axis=0) - fine) < 3 * error + 0.01 * np.abs(fine))


def jet_of(temperature, extinction, albedo):
    particles = jaxir.GrayParticles(extinction, albedo, jaxir.HenyeyGreenstein(0.5))
    return dataclasses.replace(jet(temperature), particles=particles)


def cube_of(temperature, extinction, albedo):
    return box(extinction, albedo, jaxir.HenyeyGreenstein(0.5), temperature, absorption=0.2, cells=2)


@pytest.mark.parametrize("plume_of, about", [(cube_of, (0.0, 0.0, 0.0)), (jet_of, (-6.0, 0.0, 0.0))])
def test_derivatives_are_those_of_the_solution(x64, plume_of, about):
    """By temperature, loading and albedo, in both modes, against central differences; a jet's lattice moves with them.

    Where it was held, slopes were off by 1 to 13 %.
    """
    rays = rays_through(12, about=about)

    def mean(values):
        return look(jaxir.Scene(None, plume_of(*values)), rays, Method(scattering=DiscreteOrdinates(4, 4, 2))).mean()

    at, along = np.array([600.0, 1.5, 0.8]), np.array([1.0, 0.1, -0.2])
    forward = jax.jit(lambda at, along: jax.jvp(mean, (at,), (along,)))
    reverse = np.asarray(jax.jit(jax.grad(mean))(at))
    np.testing.assert_allclose(forward(at, along)[1], reverse @ along, rtol=1e-5)
    for i, step in enumerate((0.1, 2e-5, 2e-5)):  # which pass no place where pieces of rays change their order
        apart = step * np.eye(3)[i]
        more, less = (float(forward(at + sign * apart, along)[0]) for sign in (1, -1))
        np.testing.assert_allclose(reverse[i], (more - less) / (2 * step), rtol=1e-4)


def test_a_solution_serves_other_cameras_and_air_and_no_other_scene(monkeypatch):
    """Of known values: what is differentiated is solved for anew, else derivatives would end at what was kept."""
    solved = []
    monkeypatch.setattr(_scattered, "_solved", lambda lit, *_: solved.append(lit) or lit.medium)
    monkeypatch.setattr(_scattered, "_held", {})
    nodes, plume = gray_nodes((jaxir.MWIR,)), box(1.0, 0.9, jaxir.Isotropic())
    clear = with_scattered(jaxir.Scene(None, plume).on(nodes), COARSE)
    hazy = with_scattered(
        jaxir.Scene(None, plume, atmosphere=jaxir.UniformAtmosphere(0.5, 1.0)).on(nodes),
        dataclasses.replace(COARSE, bounces=2),
    )
    assert len(solved) == 1 and clear.air is None and hazy.air is not None
    for again in range(2):
        with_scattered(jaxir.Scene(None, box(1.1, 0.9, jaxir.Isotropic())).on(nodes), COARSE)
        assert len(solved) == 2, again

    for orders in (2, 5):  # what the lattice errs is sampled so often; the solution is the same
        sampled = Method(scattering=dataclasses.replace(COARSE.scattering, orders=orders))
        with_scattered(jaxir.Scene(None, plume).on(nodes), sampled)
        assert len(solved) == 3

    def brightest(temperature):
        scene = jaxir.Scene(None, box(1.1, 0.9, jaxir.Isotropic(), temperature))
        return with_scattered(scene.on(nodes), COARSE).medium.emission.max()

    assert float(jax.grad(brightest)(600.0)) > 0 and len(solved) == 4


def test_plumes_apart_do_not_disturb_one_another():
    """So far apart that no ordinate of one meets the other; beside one that is clear a plume is as good as alone."""
    place = (0.0, 400.0, 90.0)
    far, clear = jet(nozzle=place), jet(nozzle=place, absorption=0.0, extinction=0.0)
    rays = rays_through(100, (0.0, 0.1, -1.0), about=(-2.0, 0.0, 0.0))
    pairs = ((jet(), clear), (jet(), far), (far, jet()))
    alone, *both = (look(jaxir.Scene(None, plumes), rays, COARSE) for plumes in pairs)
    assert np.asarray(alone).max() > 0
    for found in both:
        np.testing.assert_allclose(found, alone, rtol=3e-3, atol=1e-4 * float(alone.max()))


def test_two_plumes_in_one_place_lack_what_one_does():
    """What each of them lacks is told once: as often as there were plumes, it was."""
    whole, half, clear = jet(), jet(absorption=0.15, extinction=1.0), jet(absorption=0.0, extinction=0.0)
    told = []
    for plumes in ((whole, clear), (half, half)):
        lit = with_scattered(jaxir.Scene(None, plumes).on(gray_nodes((jaxir.MWIR,))), COARSE)
        frame = jaxir.fitted_camera(90.0, 0.0, lit.scene.extent(), (1, 1))
        told.append(float(lattice_error(lit, lattice_lacks(lit.in_vacuum(), frame))[0]))
    assert told[0] > 0
    np.testing.assert_allclose(told[1], told[0], rtol=0.25)


def test_of_what_skin_hides_nothing_is_lacking():
    """A plate between eye and plume: from the nose an aircraft's plume was told to lack ten times what it does."""
    scene = jaxir.Scene(block((18.0, 18.0, 0.1), 50.0, 3.0), box(1.0, 0.9, jaxir.Isotropic()))
    lit = with_scattered(scene.on(gray_nodes((jaxir.MWIR,))), COARSE)
    frames = [jaxir.fitted_camera(0.0, elevation, scene.extent(), (1, 1)) for elevation in (-90.0, 90.0)]
    below, above = (float(lattice_error(lit, lattice_lacks(lit.in_vacuum(), frame))[0]) for frame in frames)
    assert below > 0 and above == 0


def arriving(scene):
    """Mean radiance at the points that are read, of light that nothing scatters: where they are, and it [point]."""
    lit = with_scattered(scene.on(gray_nodes((jaxir.MWIR,))), lattice(1))
    part = lit.medium.parts[0]
    return part.medium.from_cube(as_float(places(part.counts))), part.field[:, 0, 0] / np.sqrt(4 * np.pi)


def test_light_of_a_narrow_plume_comes_along_it_too():
    """In a transparent one emission times the mean distance to its sides; 64 directions alone meet 6 % too little."""
    size, gas = np.array([4.0, 0.2, 0.2]), jaxir.GrayGas(1e-4)
    particles = jaxir.GrayParticles(1e-6, 0.9, jaxir.Isotropic())
    plume = jaxir.GridPlume(jaxir.Grid((0.0, 0.0, 0.0), size, (1, 1, 1)), 600.0, gas, particles)
    points, mean = arriving(jaxir.Scene(None, plume))
    points, mean = (np.asarray(x).reshape(9, 9, 9, -1)[::2, ::2, ::2].reshape(125, -1) for x in (points, mean))
    toward = np.random.default_rng(0).normal(size=(20000, 3))
    toward /= np.linalg.norm(toward, axis=1)[:, None]
    ahead = (np.where(toward > 0, size, 0.0) - np.asarray(points, float)[:, None]) / toward
    black = float(jaxir.band_radiance(jnp.asarray(600.0), gray_nodes((jaxir.MWIR,)))[0])
    exact = 1e-4 * black * ahead.min(axis=2).mean(axis=1)
    np.testing.assert_allclose(np.mean(mean), exact.mean(), rtol=4e-3)


def solid_angle(points, corners):
    """Of triangles as seen from points [point, triangle] [sr] (van Oosterom and Strackee)."""
    a, b, c = (corners[None, :, k] - points[:, None] for k in range(3))
    x, y, z = (np.linalg.norm(side, axis=-1) for side in (a, b, c))
    below = x * y * z + (a * b).sum(-1) * z + (b * c).sum(-1) * x + (c * a).sum(-1) * y
    return 2 * np.abs(np.arctan2((a * np.cross(b, c)).sum(-1), below))


@pytest.mark.parametrize("width, height", [(9.0, -1.2), (0.4, -7.0)])
def test_light_of_a_plate_comes_from_all_of_it(width, height):
    """Near, large and small, far: as from its solid angle, though few directions of a rule meet it."""
    corner = width / 2 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) + [0.0, 0.0, height]
    mesh = jaxir.Mesh(corner, [[0, 1, 2], [0, 2, 3]])
    plume = box(1e-6, 0.9, jaxir.Isotropic(), 50.0)
    points, mean = arriving(jaxir.Scene(jaxir.Skin(mesh, 700.0, jaxir.Lambert(1.0)), plume))
    black = float(jaxir.band_radiance(jnp.asarray(700.0), gray_nodes((jaxir.MWIR,)))[0])
    exact = black * solid_angle(np.asarray(points, float), corner[[[0, 1, 2], [0, 2, 3]]]).sum(1) / (4 * np.pi)
    np.testing.assert_allclose(np.mean(mean), exact.mean(), rtol=5e-3)
    assert np.std(mean / exact) < 0.05


def test_skin_shades_the_plume(x64):
    """A cold plate between sun and plume or behind the plume: only in the first place it takes the light away."""
    sun = jaxir.ParallelSource((0.0, 0.0, -1.0), 100.0)
    rays = rays_through(50, (1.0, 0.2, 0.0))

    def mean(height):
        skin, plume = block((18.0, 18.0, 0.1), 50.0, height), box(1.0, 0.9, jaxir.HenyeyGreenstein(0.0), 50.0)
        return float(look(jaxir.Scene(skin, plume, sun), rays, COARSE).mean())

    assert mean(3.0) < 1e-3 * mean(-3.0)


def test_images_have_no_noise_of_it_and_tell_what_is_left():
    """Rays of one pixel differ by where they are alone; the estimate of the lattice's error stands in the budget."""
    scene = jaxir.Scene(None, box(1.0, 0.9, jaxir.Isotropic()))
    camera = jaxir.orthographic_camera(0, 0, 0.15, (8, 8))  # amid the cube; by forced collision the error is .01
    image = jaxir.render(scene, camera, [jaxir.MWIR], samples=8, method=COARSE)
    assert float(image.intensity_error()[0] / image.radiant_intensity()[0]) < 5e-4
    assert image.orders is None
    assert 0 < float(image.truncation[0]) < 0.05
    budget = image.error_budget()
    np.testing.assert_allclose(budget.truncation, image.truncation * image.radiant_intensity(), rtol=1e-6)


@eqx.filter_jit
def plume_intensity(lit, camera, start):
    """Of the rays on which the lattice's error is found."""
    rays, weight = chosen_rays(lit.medium.parts[0], camera, start)
    far = jnp.full(rays.count, jnp.inf)
    return weight @ lit.nodes.in_band(lit.medium.aimed_at(camera.eye).lacking(rays, far, 0)[0])


@optimised
@pytest.mark.parametrize("azimuth", [90.0, 150.0, 180.0])
def test_the_error_is_looked_for_where_a_narrow_jet_is_bright(azimuth):
    """The rays on which it is found make up the intensity of the image."""
    scene = jaxir.Scene(None, dataclasses.replace(jet(), length=30.0), jaxir.ParallelSource((0.0, 0.0, -1.0), 30.0))
    method = Method(scattering=DiscreteOrdinates(17, 7))  # of which there are programs
    lit = with_scattered(scene.on(gray_nodes((jaxir.MWIR,))), method.resolved(scene))
    camera = jaxir.orthographic_camera(azimuth, 0, 0.1, (64, 320), target=(-15.0, 0.0, 0.0))
    image = jaxir.render(scene, camera, [jaxir.MWIR], samples=2, method=method)
    found = plume_intensity(lit, camera, scene.start(camera))
    np.testing.assert_allclose(found, image.radiant_intensity(), rtol=0.05)


def along_the_axis(panels, albedo=0.99, absorption=0.05):
    """Radiance of rays straight up a jet, many optical depths long."""
    particles = jaxir.GrayParticles(8.0, albedo, jaxir.HenyeyGreenstein(0.5))
    made = dataclasses.replace(jet(), gas=jaxir.GrayGas(absorption), particles=particles, panels=panels)
    origin = jnp.asarray([[-40.0, 0.0, y] for y in (0.0, 0.1, 0.2, 0.3, 0.5)])
    rays = jaxir.Rays(origin, jnp.broadcast_to(jnp.asarray([1.0, 0.0, 0.0]), origin.shape))
    return look(jaxir.Scene(None, made), rays, Method(scattering=DiscreteOrdinates(25, 5, 1)))


@optimised
@pytest.mark.skipif(jax.default_backend() != "cpu", reason="native loops are a matter of the CPU compiler")
@pytest.mark.skipif("set by jaxir" not in jaxir.compiler_options(), reason="another owner of the process")
@pytest.mark.parametrize("made", [box(1.0, 0.9, jaxir.Isotropic()), jet()], ids=["cells", "jet"])
def test_loops_along_rays_are_native(made):
    """Operation by operation they take five times as long."""
    scene = jaxir.Scene(None, made, jaxir.ParallelSource((0.0, 0.0, -1.0), 10.0))
    lit = with_scattered(scene.on(gray_nodes((jaxir.MWIR,))), COARSE)
    medium = aimed(lit, jaxir.orthographic_camera(90, 0, 0.15, (8, 8))).medium
    rays = jax.tree.map(as_float, rays_through(2048))

    def seen(medium, rays):
        return medium.radiance(rays, jnp.full(rays.count, jnp.inf), jnp.zeros((rays.count, 1)))

    lines = jax.jit(seen).lower(medium, rays).compile().as_text().splitlines()
    loops = [line.strip() for line in lines if " while(" in line and "checkpoint" in line]
    assert len(loops) >= 3  # what comes from where, to the eye, and elsewhere
    assert all(line.startswith("ROOT") for line in loops)  # each the whole of what is called as native code


@pytest.mark.parametrize("kelvins, through", [(250.0, True), (2500.0, False)])
def test_depths_are_looked_for_along_rays_only_where_light_shows(kelvins, through):
    """Between the lattice's points a jet misreads the sun; where it glows ten thousand times brighter, who cares."""
    lit = jaxir.Scene(None, jet(kelvins), jaxir.ParallelSource((0.0, 0.0, -1.0), 10.0)).on(gray_nodes((jaxir.MWIR,)))
    assert with_scattered(lit, COARSE).medium.through is through


def test_light_along_a_jet_is_summed_where_it_comes_from():
    """A core many optical depths long is one panel, and what shines out of it comes from its end."""
    np.testing.assert_allclose(along_the_axis(2), along_the_axis(12), rtol=0.04)


def test_single_precision_solves_as_far_as_double():
    """Where next to nothing is absorbed, what the equation lacks comes back a thousand times."""
    single = along_the_axis(2, 1.0, 0.003)
    with jax.enable_x64(True):
        double = along_the_axis(2, 1.0, 0.003)
    np.testing.assert_allclose(single, double, rtol=3e-4)


def test_what_harmonics_lack_is_told():
    def seen(order):
        method = Method(scattering=DiscreteOrdinates(13, 5, order))
        aspects = [[90.0, 0.0], [180.0, 0.0]]
        return jaxir.signature(
            jaxir.Scene(None, jet()), aspects, [jaxir.MWIR], shape=(16, 32), samples=2, method=method
        )

    finest, rough = seen(5), seen(1)
    apart = np.abs(np.asarray(rough.intensity / finest.intensity) - 1)
    assert np.all(apart < np.asarray(rough.truncation))
    assert np.all(apart > 1e-4)


def test_what_it_is_not_for_is_refused():
    plume = box(1.0, 0.9, jaxir.Isotropic())
    disc = jaxir.DiscSource((0.0, 0.0, 5.0), (0.0, 0.0, -1.0), 1.0, 10.0)
    camera = jaxir.orthographic_camera(0, 0, 0.15, (8, 8))  # of a cube as before, so that its programs serve
    with pytest.raises(ValueError, match="DiscreteOrdinates: got a DiscSource, expected sources without extent"):
        jaxir.render(jaxir.Scene(None, plume, disc), camera, [jaxir.MWIR], method=COARSE)
    for extinction, asymmetry, field in ((20.0, 0.0, "optical depth between points"), (1.0, -0.9, "moment of a lobe")):
        unfit = jaxir.Scene(None, box(extinction, 0.9, jaxir.HenyeyGreenstein(asymmetry)))
        with pytest.raises(ValueError, match=f"DiscreteOrdinates: {field}.*: got .*, expected <="):
            jaxir.render(unfit, camera, [jaxir.MWIR], method=COARSE)
    for huge in (DiscreteOrdinates(10**7, 10**5), DiscreteOrdinates(order=10**7), DiscreteOrdinates(10**5, 4, 1)):
        with pytest.raises(ValueError, match="DiscreteOrdinates: got .* numbers to keep, expected at most"):
            jaxir.render(jaxir.Scene(None, plume), camera, [jaxir.MWIR], method=Method(scattering=huge))
    with pytest.raises(ValueError, match="DiscreteOrdinates.along: got 3, expected an integer >= 4"):
        DiscreteOrdinates(along=3)


def seen_of_slab(depth, albedo, asymmetry, along=17, half=20.0, temperature=600.0, below=0.0, above=0.0):
    """Radiance down at cosines 1 and .5 of a slab 1 m thick, amid its width, and its mean by flux.

    Even light comes from `below` and from `above`.
    """
    cosine, weight = (x / 2 for x in np.polynomial.legendre.leggauss(12))
    cosines = np.concatenate([[1.0, 0.5], cosine + 0.5])
    down = np.stack([np.sqrt(1 - cosines**2), 0 * cosines, -cosines], axis=1)
    rays = jaxir.Rays(jnp.asarray(np.array([[0.0, 0.0, 0.5]]) - 2 * down / cosines[:, None]), jnp.asarray(down))
    grid = jaxir.Grid((-half, -half, 0.0), (2 * half, 2 * half, 1 / 32), (1, 1, 32))
    around = jaxir.ElevationTable([-90.0, -0.001, 0.001, 90.0], [below, below, above, above])
    particles = jaxir.GrayParticles(depth, albedo, jaxir.HenyeyGreenstein(asymmetry))
    plume = jaxir.GridPlume(grid, temperature, jaxir.GrayGas(0.0), particles)
    method = Method(scattering=DiscreteOrdinates(along, 9))
    lit = with_scattered(jaxir.Scene(None, plume, background=around).on(gray_nodes((jaxir.MWIR,))), method)
    assert lit.medium.residual < 2e-5
    own = np.asarray(seen_by(lit, rays, method, None))[:, 0]
    return own[0], own[1], 2 * np.sum(weight * cosines[2:] * own[2:])


@optimised
@pytest.mark.parametrize(
    "slab, exact, error",
    [
        ((1.0, 0.5, 0.0), (0.454822, 0.619961, 0.559126), 5e-4),
        ((1.0, 0.9, 0.0), (0.140965, 0.191498, 0.172542), 1.5e-3),
        ((1.0, 0.9, 0.5), (None, None, 0.1734992), 1e-3),
        ((20.0, 0.5, 0.0, 41), (0.884774, None, 0.853456), 8e-3),  # as thick as a half-space
        ((20.0, 0.9, 0.0, 41, 1.0), (0.585053, None, None), 8e-3),  # wider, it needs more points across
    ],
)
def test_slabs_emit_what_is_known(x64, slab, exact, error):
    """Chandrasekhar's H functions and doubling; the thick ones change within a step or two of the lattice."""
    black = float(jaxir.band_radiance(jnp.asarray(600.0), gray_nodes((jaxir.MWIR,)))[0])
    for got, known in zip(seen_of_slab(*slab), exact, strict=True):
        if known is not None:
            assert abs(got / black / known - 1) < error, (got / black, known)


@optimised
@pytest.mark.parametrize("below, above, exact", [(0.0, 1.0, 0.227953), (1.0, 0.0, 0.598548)])
def test_slabs_send_back_and_let_through_what_is_known(x64, below, above, exact):
    """Even light from one side, by the lattice alone."""
    got = seen_of_slab(1.0, 0.9, 0.5, temperature=3.0, below=below, above=above)[2]
    assert abs(got / exact - 1) < 1e-3, (got, exact)


@optimised
def test_what_is_scattered_of_the_sun_is_what_is_taken_from_it():
    """R + T = 1: a cube that absorbs nothing, its light summed over all directions."""
    direction, weight = sphere_rule(14)
    half, side = 1.75, (np.arange(30) + 0.5) / 30 * 3.5 - 1.75
    plume = box(0.5, 1.0, jaxir.HenyeyGreenstein(0.0), 50.0)  # as it is seen through particles, whose programs serve
    place = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    across = np.stack([np.linalg.svd(one[None])[2][1:] for one in direction])
    origin = place @ across - 20 * direction[:, None]
    toward = np.broadcast_to(direction[:, None], origin.shape)
    rays = jaxir.Rays(as_float(origin.reshape(-1, 3)), as_float(toward.reshape(-1, 3)))
    scene = jaxir.Scene(None, plume, jaxir.ParallelSource((0.0, 0.0, -1.0), 1.0))
    seen = np.asarray(look(scene, rays, Method(scattering=DiscreteOrdinates(9, 9)))).reshape(len(direction), -1)
    scattered = np.sum(weight * seen.mean(axis=1)) * (2 * half) ** 2
    np.testing.assert_allclose(scattered, 4 * (1 - np.exp(-1.0)), rtol=4e-3)


@optimised
@pytest.mark.parametrize("depth", [0.3, 1.0])
def test_what_a_slab_reflects_and_transmits_of_the_sun_is_all_of_it(x64, depth):
    """R + T = 1 by the lattice alone: a slab 1 m thick and 4 km wide that absorbs nothing."""
    cosine, weight = (x / 2 for x in np.polynomial.legendre.leggauss(32))
    cosine = np.concatenate([cosine + 0.5, -cosine - 0.5])
    toward = np.stack([np.sqrt(1 - cosine**2), 0 * cosine, cosine], axis=1)
    origin = np.array([[0.0, 0.0, 0.5]]) - 5 * toward / np.abs(cosine)[:, None]
    grid = jaxir.Grid((-2e3, -2e3, 0.0), (4e3, 4e3, 1 / 32), (1, 1, 32))
    particles = jaxir.GrayParticles(depth, 1.0, jaxir.Isotropic())
    plume = jaxir.GridPlume(grid, 50.0, jaxir.GrayGas(0.0), particles)
    scene = jaxir.Scene(None, plume, jaxir.ParallelSource((0.0, 0.0, -1.0), 1.0))
    method = Method(scattering=DiscreteOrdinates(33, 7, 5))
    seen = np.asarray(look(scene, jaxir.Rays(jnp.asarray(origin), jnp.asarray(toward)), method))[:, 0]
    leaves = 2 * np.pi * np.sum(np.tile(weight, 2) * np.abs(cosine) * seen)
    assert abs(leaves / (1 - np.exp(-depth)) - 1) < 1e-4
