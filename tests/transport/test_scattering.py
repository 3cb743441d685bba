"""Scattering by particles against radiative transfer's closed forms, energy, furnaces, and other ways to the same."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir import Method, PlumeLight, SkinLight
from jaxir.geometry import Rays
from jaxir.medium import medium_optics
from jaxir.optics.particle import ParticleTable
from jaxir.optics.spectrum import gray_nodes
from jaxir.transport import _trace, evaluate, trace
from tests.scenes import box_mesh

NODES = gray_nodes((jaxir.LWIR,))
WARM, COLD = 400.0, 3.0
BLACK = float(jaxir.band_radiance(jnp.asarray(WARM), NODES)[0])
WIDE = 1e3  # a slab of thickness 1 is infinite to 1e-6: no path of some orders leaves by its sides


@eqx.filter_jit
def traced(scene, rays, key, method):
    """The paths alone."""
    return trace(scene, rays, method, key)


@eqx.filter_jit
def evaluated(scene, paths):
    """Radiance of each path [ray]."""
    return evaluate(scene.on(NODES), paths)[:, 0]


def look(scene, rays, key, method):
    """Radiance of each ray [ray]."""
    return evaluated(scene, traced(scene, rays, key, method))


RAYS, ORDERS = 20_000, Method(orders=25)  # the same wherever they will do: every other number is another compilation


def slab(depth, albedo, asymmetry=0.0, temperature=WARM, cells=6, sources=(), around=(0.0, 0.0)):
    """A slab 0 < z < 1 of particles alone, in `cells` layers, and what is around, below the horizon and above it."""
    grid = jaxir.Grid((-WIDE / 2, -WIDE / 2, 0.0), (WIDE, WIDE, 1 / cells), (1, 1, cells))
    particles = jaxir.GrayParticles(depth, albedo, jaxir.HenyeyGreenstein(asymmetry))
    below, above = around
    sky = jaxir.ElevationTable([-90.0, -0.001, 0.001, 90.0], [below, below, above, above])
    return jaxir.Scene(None, jaxir.GridPlume(grid, temperature, jaxir.GrayGas(0.0), particles), sources, sky)


def alike(origin, direction, count):
    """The same ray again and again."""
    return Rays(*(jnp.asarray(np.broadcast_to(np.asarray(x, np.float32), (count, 3))) for x in (origin, direction)))


def down(cosine, count):
    """Rays from above at one angle with the normal."""
    return alike([0.0, 0.0, 2.0], [np.sqrt(1 - cosine**2), 0.0, -cosine], count)


def from_above(count, side=1.0):
    """Rays whose origin sees the slab with density cos / pi: their mean is the flux over pi; from below if -1."""
    u = np.random.default_rng(7).uniform(size=(count, 2))
    cosine, turn, sine = np.sqrt(1 - u[:, 0]), 2 * np.pi * u[:, 1], np.sqrt(u[:, 0])
    direction = np.stack([sine * np.cos(turn), sine * np.sin(turn), -side * cosine], axis=-1)
    origin = np.broadcast_to([0.0, 0.0, 0.5 + 0.501 * side], (count, 3))
    return Rays(*(jnp.asarray(x.astype(np.float32)) for x in (origin, direction)))


def agrees(values, expected, tolerance, bias=0.0):
    """The mean is right within 4 standard errors, themselves below a quarter of the tolerance."""
    values = np.asarray(values, float)
    error = values.std(ddof=1) / np.sqrt(values.size)
    assert error < tolerance / 4 * abs(expected), (error, expected)
    assert abs(values.mean() - expected) < 4 * error + bias * abs(expected), (values.mean(), expected, error)


# Isothermal slabs (O9) ------------------------------------------------------------------------------------------------


@pytest.mark.optimised
@pytest.mark.parametrize(
    ("depth", "albedo", "cosine", "expected"),
    [
        (1, 0.5, 1.0, 0.454822),
        (1, 0.5, 0.5, 0.619961),
        (1, 0.9, 1.0, 0.140965),
        (1, 0.9, 0.5, 0.191498),
        (40, 0.5, 1.0, 0.884774),
        (40, 0.9, 1.0, 0.585053),
    ],
)
def test_emissivity_of_a_scattering_slab(depth, albedo, cosine, expected):
    """O9; what is left out beyond order n is below albedo^(n + 1), and falls faster where light soon gets out."""
    rays, orders = (2 * RAYS, Method(orders=60)) if depth * albedo > 30 else (RAYS, ORDERS)
    got = look(slab(depth, albedo), down(cosine, rays), jax.random.key(1), orders)
    agrees(np.asarray(got) / BLACK, expected, 0.01, bias=2e-4)


@pytest.mark.optimised
def test_hemispherical_emissivity_reflectance_and_transmittance():
    """O9 for Henyey and Greenstein's phase function: light from one side sent back, let through, and emitted."""
    emitted = look(slab(1.0, 0.9, 0.5), from_above(RAYS), jax.random.key(2), ORDERS)
    agrees(np.asarray(emitted) / BLACK, 0.1734992, 0.02)
    lit = slab(1.0, 0.9, 0.5, temperature=COLD, around=(0.0, 1.0))
    agrees(look(lit, from_above(RAYS), jax.random.key(3), ORDERS), 0.227953, 0.05)
    lit = slab(1.0, 0.9, 0.5, temperature=COLD, around=(1.0, 0.0))
    agrees(look(lit, from_above(RAYS), jax.random.key(4), ORDERS), 0.598548, 0.02)


@pytest.mark.optimised
def test_particles_that_absorb_nothing_conserve_energy():
    """Under an even sky every direction shows it, whatever is scattered how often: R + T = 1."""
    scene = slab(1.0, 1.0, 0.3, COLD, around=(5.0, 5.0))
    agrees(look(scene, down(0.7, RAYS), jax.random.key(5), ORDERS), 5.0, 0.01, bias=1e-4)


@pytest.mark.parametrize("lost", [1e-2, 1e-6, 1e-9])
def test_particles_that_absorb_next_to_nothing_emit_that(lost):
    """Absorption is never the rounded difference of extinction and scattering."""
    section = np.array([3e-12, 3e-12])
    table = ParticleTable([500.0, 3000.0], section, section * (1 - lost), 1e-18, [-1.0, 1.0], np.ones((2, 2)))
    for particles in (jaxir.GrayParticles(0.5, 1 - lost, jaxir.Isotropic()), jaxir.Particles(0.5 / 3e-12, table)):
        seen = medium_optics(jaxir.GrayGas(0.0), particles, NODES, jnp.asarray(WARM))
        np.testing.assert_allclose(seen.emission / BLACK, 0.5 * lost, rtol=1e-6)
        np.testing.assert_allclose(seen.extinction, 0.5, rtol=1e-6)


# Beams and lights -----------------------------------------------------------------------------------------------------

SUN = jaxir.ParallelSource([0.6, 0.0, -0.8], 100.0)


def test_sunlight_scattered_once_is_summed_exactly():
    """Chandrasekhar, Radiative Transfer (1960): E w / (4 pi) mu0 / (mu0 + mu) (1 - exp(-t / mu0 - t / mu)).

    Lighting each cell as its centre is leaves out u0 (u0 + 2 u) / 24, u0 and u its depths towards sun and eye.
    """
    depth, albedo, mu, mu0 = 1.3, 0.7, 0.5, 0.8
    scene = slab(depth, albedo, 0.0, COLD, cells=64, sources=(SUN,))
    got = look(scene, down(mu, 3), jax.random.key(1), Method(orders=0))
    path = depth / mu + depth / mu0
    want = 100.0 * albedo / (4 * np.pi) * mu0 / (mu0 + mu) * -np.expm1(-path)
    own, seen = depth / 64 / mu0, depth / 64 / mu
    np.testing.assert_allclose(1 - np.asarray(got, float) / want, own * (own + 2 * seen) / 24, rtol=0.03)


@pytest.mark.optimised
def test_sunlight_is_conserved():
    """Particles that absorb nothing: what leaves above, below, and straight through is what falls in."""
    depth, count = 1.0, 10_000
    scene = slab(depth, 1.0, 0.4, COLD, cells=16, sources=(SUN,))
    both = (from_above(count, side) for side in (1.0, -1.0))
    flux = [np.pi * np.asarray(look(scene, rays, jax.random.key(3), ORDERS), float) for rays in both]
    direct = 80.0 * np.exp(-depth / 0.8)
    agrees(flux[0] + flux[1] + direct, 80.0, 0.02, bias=3e-4)


def cloud(skin=None, sources=(), extinction=0.02, cell=0.02):
    """One small thin cell of particles about the point (0, 0, .5), cold, and rays through its middle."""
    grid = jaxir.Grid((-cell / 2, -cell / 2, 0.5 - cell / 2), (cell, cell, cell), (1, 1, 1))
    particles = jaxir.GrayParticles(extinction, 1.0, jaxir.Isotropic())
    plume = jaxir.GridPlume(grid, COLD, jaxir.GrayGas(0.0), particles)
    rays = alike([-3.0, 0.0, 0.5], [1.0, 0.0, 0.0], 4096)
    return jaxir.Scene(skin, plume, sources), rays, extinction * cell / (4 * np.pi)


def plate(temperature):
    vertices = np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]])
    mesh = jaxir.Mesh(vertices, np.array([[0, 1, 2], [0, 2, 3]]))
    return jaxir.Skin(mesh, temperature, jaxir.Lambert(1.0))


def test_skin_lights_particles_and_shades_them():
    """A black unit square .5 below: solid angle 4 asin(1/2), and no sun from underneath."""
    below = jaxir.ParallelSource([0.0, 0.0, 1.0], 1e6)
    scene, rays, share = cloud(skin=plate(WARM), sources=(below,))
    got = np.asarray(look(scene, rays, jax.random.key(4), Method(orders=1)), float)
    agrees(got, share * BLACK * 4 * np.arcsin(0.5), 0.2, bias=1e-3)


def lit_by(lamp=""):
    """The cloud below every kind of light, of which one is lit."""
    on = {name: float(name == lamp) for name in ("point", "disc", "sphere", "parallel", "sky that is not seen")}
    sources = (
        jaxir.PointSource([0.0, 0.0, 2.5], 8.0 * on["point"]),
        jaxir.DiscSource([0.0, 0.0, 1.5], [0.0, 0.0, -1.0], 1.0, on["disc"]),
        jaxir.SphereSource([0.0, 0.0, 2.5], 1.0, on["sphere"]),
        jaxir.ParallelSource([0.0, 0.0, -1.0], on["parallel"]),
        jaxir.UniformBackground(on["sky that is not seen"]),
    )
    return cloud(sources=sources)


@pytest.mark.parametrize(
    ("lamp", "arriving"),
    [
        ("point", 8.0 / 2.0**2),
        ("disc", 2 * np.pi * (1 - np.sqrt(0.5))),
        ("sphere", 2 * np.pi * (1 - np.sqrt(0.75))),
        ("parallel", 1.0),
        ("sky that is not seen", 4 * np.pi),
    ],
)
def test_lights_reach_particles(lamp, arriving):
    """A thin cloud sends on irradiance, or radiance times solid angle, evenly; 1e-3 for its size."""
    scene, rays, share = lit_by(lamp)
    got = np.asarray(look(scene, rays, jax.random.key(5), Method(orders=1)), float)
    agrees(got, share * arriving, 0.05, bias=2e-3)


# Together -------------------------------------------------------------------------------------------------------------


def furnace(emissivity, albedo, asymmetry=0.4):
    """Skin, gas and particles at one temperature under a sky as warm."""
    grid = jaxir.Grid((-1.5, -0.8, -0.7), (0.5, 0.4, 0.35), (4, 4, 4))
    particles = jaxir.GrayParticles(2.0, albedo, jaxir.HenyeyGreenstein(asymmetry))
    plume = jaxir.GridPlume(grid, WARM, jaxir.GrayGas(0.3), particles)
    skin = jaxir.Skin(box_mesh((1.0, 1.0, 0.6), (0.6, 0.0, 0.0)), WARM, jaxir.Lambert(emissivity))
    return jaxir.Scene(skin, plume, background=jaxir.BlackbodyBackground(WARM))


def across():
    """Rays that meet skin through the plume, skin alone, plume alone, and nothing."""
    y = np.linspace(-1.0, 1.0, 4096)
    origin = np.stack([np.full_like(y, -3.0), y, 0.3 * np.sin(9 * y)], axis=-1)
    direction = np.array([1.0, 0.0, 0.0]) + 0.3 * np.stack([0 * y, -y, np.cos(5 * y)], axis=-1)
    direction = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    return Rays(*(jnp.asarray(x.astype(np.float32)) for x in (origin, direction)))


MET = Method(bounces=8, orders=8)
DRAWN = Method(bounces=8, orders=8, skin_light=SkinLight(), plume_light=PlumeLight())


@pytest.mark.parametrize("method", [MET, DRAWN], ids=["met", "drawn"])
def test_furnace_with_particles_and_reflecting_skin(method):
    """O10: everything at one temperature is one radiance; beyond 8 bounces and orders .4^9 is left out."""
    got = np.asarray(look(furnace(0.7, 0.4), across(), jax.random.key(6), method))
    assert np.isfinite(got).all()
    agrees(got / BLACK, 1.0, 0.01, bias=5e-4)


def test_nothing_changes_a_furnace():
    """O10: derivatives in emissivity, albedo and phase vanish, in both modes alike, on the paths kept."""
    values = np.array([0.7, 0.4, 0.4], np.float32)
    kept = traced(furnace(*values), across(), jax.random.key(7), MET)

    def seen(values, paths):
        return evaluate(furnace(*values).on(NODES), paths)[:, 0] / BLACK

    along = eqx.filter_jit(lambda paths, tangent: jax.jvp(lambda v: seen(v, paths), (values,), (tangent,))[1])
    jacobian = [along(kept, tangent) for tangent in np.eye(3, dtype=np.float32)]  # columns apart compile fastest
    for name, row, least in zip(("emissivity", "albedo", "asymmetry"), jacobian, (0.05, 0.05, 0.02), strict=True):
        row = np.asarray(row, float)
        error = row.std() / np.sqrt(row.size)
        assert least > error > 0, (name, error)
        assert abs(row.mean()) < 4 * error + 5e-3, (name, row.mean(), error)
    reverse = eqx.filter_jit(lambda paths: jax.grad(lambda v: seen(v, paths).mean())(values))(kept)
    np.testing.assert_allclose(reverse, [np.mean(row) for row in jacobian], rtol=2e-3, atol=2e-5)


@pytest.mark.optimised
def test_derivative_in_the_albedo_is_that_of_the_expected_value():
    """Held paths: d/d albedo of independent samples against differences of others."""
    rays = down(0.7, RAYS)
    kept = traced(slab(1.0, 0.6), rays, jax.random.key(8), ORDERS)
    along = eqx.filter_jit(
        lambda paths: jax.jvp(lambda albedo: evaluated(slab(1.0, albedo), paths) / BLACK, (0.6,), (1.0,))[1]
    )
    derivative, step = np.asarray(along(kept), float), 0.05
    scenes = (slab(1.0, 0.6 + s * step) for s in (1, -1))
    high, low = (np.asarray(look(scene, rays, jax.random.key(9), ORDERS), float) / BLACK for scene in scenes)
    difference = (high - low) / (2 * step)
    error = np.sqrt((derivative.var() + difference.var()) / derivative.size)
    # the slope's own third derivative adds step^2 / 6 of it, .2 % here
    assert error < 0.005 * abs(derivative.mean())
    assert abs(derivative.mean() - difference.mean()) < 4 * error + 5e-3 * abs(derivative.mean())


def test_a_jet_scatters_as_its_cells_do():
    """Emission, scattering twice, a beam: quadrature against .04 m cells, whose emission alone errs by some percent."""
    particles = jaxir.GrayParticles(4.0, 0.95, jaxir.HenyeyGreenstein(0.5))
    jet = jaxir.JetPlume((0, 0, 0), (-1, 0, 0), 0.5, 900.0, 250.0, jaxir.GrayGas(0.4), length=6.0, particles=particles)
    grid = jaxir.Grid((-3.0, -0.96, -0.96), (0.04, 0.04, 0.04), (75, 48, 48))
    begin = np.stack([-2.8 * np.linspace(0.01, 0.99, 4000), np.full(4000, -2.0), np.full(4000, 0.2)], axis=-1)
    rays = Rays(jnp.asarray(begin.astype(np.float32)), alike([0.0] * 3, [0.0, 1.0, 0.0], 4000).direction)
    sun = (jaxir.ParallelSource([0.0, 0.6, -0.8], 2000.0),)
    found = []
    for plume in (jet, jet.to_grid(grid)):
        got = look(jaxir.Scene(plumes=plume, sources=sun), rays, jax.random.key(10), Method(orders=3))
        found.append(np.asarray(got, float))
    error = np.sqrt(sum(values.var() for values in found) / 4000)
    assert error < 0.011 * found[0].mean()
    assert abs(found[0].mean() - found[1].mean()) < 4 * error + 0.02 * found[0].mean()


def test_narrow_lobes_in_the_sun_err_what_is_told(monkeypatch):
    """Paths that turn towards the sun bring light that others seldom meet: without them told are 26 % of a mean."""
    scene = slab(1.0, 0.9, 0.95, 3.0, sources=(jaxir.ParallelSource((0.8, 0.0, -0.6), 100.0),))
    rays = alike([0.0, 0.0, 2.0], [0.0, 0.6, -0.8], 2000)

    def means(traced):
        keys = [jax.random.key(k) for k in range(16)]
        return np.array([np.asarray(evaluated(scene, traced(scene, rays, key, Method(orders=8)))) for key in keys])

    found = means(traced)
    mean, told = found.mean(), np.sqrt(found.var(axis=1).mean() / 2000)
    apart = found.mean(axis=1).std(ddof=1)
    assert told < 0.08 * mean
    assert 0.6 < apart / told < 1.6
    monkeypatch.setattr(_trace, "TOWARD_SOURCES", 0.7)  # the same mean by other paths
    others = means(eqx.filter_jit(traced.__wrapped__)).mean(axis=1)
    assert abs(others.mean() - mean) < 4 * np.hypot(apart, others.std(ddof=1)) / 4


# What is left out, and what is refused --------------------------------------------------------------------------------


def in_the_sun():
    """A cold jet, whose light from the sun a path brings as the order after that of its last segment."""
    particles = jaxir.GrayParticles(3.0, 1.0, jaxir.Isotropic())
    jet = jaxir.JetPlume(
        (0.5, 0, 0), (-1, 0, 0), 0.5, 251.0, 250.0, jaxir.GrayGas(0.0), length=2.0, particles=particles
    )
    return jaxir.Scene(plumes=jet, sources=(jaxir.ParallelSource((0.0, 0.6, -0.8), 1e4),))


@pytest.mark.parametrize("lit", [lambda: jaxir.Scene(plumes=furnace(0.5, 0.9, 0.0).plume), in_the_sun])
def test_truncation_is_what_more_orders_add(lit):
    scene = lit()
    camera = jaxir.orthographic_camera(30, 20, 0.3, (6, 6))
    few, many = (jaxir.render(scene, camera, NODES, samples=32, method=Method(orders=orders)) for orders in (3, 12))
    grown = float((many.radiant_intensity() / few.radiant_intensity() - 1)[0])
    assert 0.005 < grown < 0.2
    assert abs(float(few.truncation[0]) / grown - 1) < 0.3
    assert float(many.truncation[0]) < 1e-3


def test_scattering_needs_a_key_and_the_exact_sum():
    scene, rays, _ = lit_by()
    with pytest.raises(ValueError, match="trace: got no key"):
        trace(scene, rays)
    with pytest.raises(
        ValueError, match="estimate: got CellMedium and 2 segments a path, expected .* without particles"
    ):
        paths = traced(scene, rays, jax.random.key(1), Method(orders=1))
        jaxir.estimate(scene.on(NODES), paths, jaxir.PointIntegration(), jax.random.key(2))


@pytest.mark.parametrize("orders", [-1, True])
def test_orders_must_be_a_count(orders):
    with pytest.raises(ValueError, match="Method.orders: got"):
        Method(orders=orders)


def test_particles_must_fit_the_grid():
    grid = jaxir.Grid((0, 0, 0), (1, 1, 1), (2, 3, 4))
    with pytest.raises(ValueError, match=r"GridPlume.particles: got cells \(3,\), expected none or \(2, 3, 4\)"):
        particles = jaxir.GrayParticles(np.ones((3, 1)), 0.5, jaxir.Isotropic())
        jaxir.GridPlume(grid, 300.0, jaxir.GrayGas(0.1), particles)
