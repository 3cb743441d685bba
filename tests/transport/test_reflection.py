"""Reflected light against closed forms: area lights, view factors, furnaces, variances, many random scenes."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

import jaxir
from jaxir import ClosedForm, DirectSampling, Method, PlumeLight, SkinLight, Sobol
from jaxir._arrays import enforce
from jaxir.geometry import Rays, disc_vector, polygon_form_factor
from jaxir.optics.spectrum import gray_nodes
from jaxir.transport import evaluate, trace
from tests.scenes import box_mesh, gray_box

NODES = gray_nodes((jaxir.LWIR,))
COLD = 3.0
SQUARE = np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]])
TWO = np.array([[0, 1, 2], [0, 2, 3]])
DISC = jaxir.DiscSource([1.2, 1.2, 1.8], [0.0, 0.0, -1.0], 1.0, 100.0)


@eqx.filter_jit
def look(scene, rays, method, key):
    """Radiance of each ray [ray]; one compilation for every scene of the same structure."""
    return evaluate(scene.on(NODES), trace(scene, rays, method, key))[:, 0]


def black(temperature):
    return float(jaxir.band_radiance(jnp.asarray(temperature), NODES)[0])


def plate(emissivity=0.5, temperature=COLD):
    return jaxir.Skin(jaxir.Mesh(SQUARE, TWO), temperature, jaxir.Lambert(emissivity))


def rays_down(points, height=0.5):
    """Rays that fall on points of the plane z = 0."""
    origin = jnp.asarray(np.column_stack([points, np.full(len(points), height)]))
    return Rays(origin, jnp.broadcast_to(jnp.asarray([0.0, 0.0, -1.0]), origin.shape))


def raster(count):
    x = (np.arange(count) + 0.5) / count - 0.5
    return np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2)


def form_factor(points):
    """O3: Howell, "A catalog of radiation heat transfer configuration factors", B-13, in plain double precision."""
    a = np.hypot(*(np.asarray(points, float) - [1.2, 1.2]).T)
    h, r = 1.8, 1.0
    return 0.5 * (1 - (a**2 + h**2 - r**2) / np.sqrt((a**2 + h**2 + r**2) ** 2 - 4 * r**2 * a**2))


def agrees(values, expected, tolerance):
    """The mean of independent values is right within 4 standard errors, which are small enough to mean something."""
    values = np.asarray(values, float)
    error = values.std(ddof=1) / np.sqrt(values.size)
    assert error < tolerance / 4 * abs(expected), (error, expected)
    assert abs(values.mean() - expected) < 4 * error + 1e-5 * abs(expected), (values.mean(), expected, error)


# The disc-lit plate -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("method", "least", "most"),
    [
        (Method(ClosedForm()), 0.0, 1e-5),
        (Method(DirectSampling(100, 100)), 0.048, 0.052),
        (Method(DirectSampling(64, 64), sampler=Sobol()), 0.0, 0.009),
        (Method(DirectSampling(1024, 0), sampler=Sobol()), 0.0, 0.0008),
    ],
    ids=["closed form", "independent", "sobol", "sobol 1024"],
)
def test_error_of_the_disc_lit_plate(method, least, most):
    points = raster(32 if "1024" not in repr(method) else 12)
    scene = jaxir.Scene(plate(), sources=(DISC,))
    enforce(NODES, method.checks_for(scene))
    expected = 0.5 * 100.0 * form_factor(points)
    got = np.asarray(look(scene, rays_down(points), method, jax.random.key(1)), float)
    error = np.sqrt(np.mean((got / expected - 1) ** 2))
    assert least <= error <= most, error


def light_moments(point, count=400):
    """Per direction of the disc: contribution rho L f cos, both densities, solid angle (midpoints in area)."""
    r = np.sqrt((np.arange(count) + 0.5) / count)
    angle = (np.arange(count) + 0.5) / count * 2 * np.pi
    rr, aa = np.meshgrid(r, angle, indexing="ij")
    offset = np.stack([1.2 + rr * np.cos(aa) - point[0], 1.2 + rr * np.sin(aa) - point[1], 1.8 + 0 * rr], axis=-1)
    square = np.sum(offset**2, axis=-1)
    cos = 1.8 / np.sqrt(square)
    return 0.5 / np.pi * 100.0 * cos, square / cos / np.pi, cos / np.pi, np.pi * cos / square / count**2


@pytest.mark.parametrize("shift", [0.0, 0.3])
def test_a_polygon_of_light_is_the_square_of_heat(shift):
    """A source where the hot square was; shifted, the walls of one reach below the plate, where its horizon cuts."""
    corners = np.array([[0.5, -0.5, 1.0], [0.5, 0.5, 1.0], [0.5, 0.5, -shift], [0.5, -0.5, -shift]])
    points, most = 0.9 * raster(24), raster(128)
    scene = jaxir.Scene(plate(), sources=(jaxir.PolygonSource(corners, 100.0),))
    exact, sampled = Method(ClosedForm()), Method(DirectSampling(32, 32), sampler=Sobol())
    enforce(NODES, exact.checks_for(scene))
    rays = [rays_down(np.resize(p, most.shape)) for p in (most, points)]  # as many of either: one program for both
    whole, want = (np.asarray(look(scene, r, exact, jax.random.key(1)), float) for r in rays)
    want = want[: len(points)]
    difference = np.asarray(look(scene, rays_down(points), sampled, jax.random.key(1)), float) - want
    error = difference.std() / np.sqrt(difference.size)
    assert abs(difference.mean()) < 4 * error
    assert error < 0.005 * want.mean()
    # O4: perpendicular unit squares with a common edge
    assert whole.mean() == pytest.approx(50.0 * 0.200043776075, rel=1e-3)


@pytest.mark.parametrize("way", ["brdf", "light", "both"])
def test_variance_of_each_strategy_is_its_closed_form(way):
    """Brdf sampling: (1 - p) / p of the squared mean with p the chance to hit; the others by quadrature."""
    point, rays, samples = (0.1, -0.2), 4096, 8
    value, from_light, from_brdf, solid = light_moments(point)
    mean = np.sum(value * solid)
    np.testing.assert_allclose(mean, 50.0 * form_factor([point])[0], rtol=1e-4)
    p = form_factor([point])[0]
    if way == "brdf":
        method, variance = DirectSampling(0, samples), mean**2 * (1 - p) / p
    elif way == "light":
        method, variance = DirectSampling(samples, 0), np.sum(value**2 / from_light * solid) - mean**2
    else:
        method = DirectSampling(samples, samples)
        both = from_light**2 + from_brdf**2
        variance = 0.0
        for pdf in (from_light, from_brdf):
            share = pdf**2 / both * value
            variance += np.sum(share**2 / pdf * solid) - np.sum(share * solid) ** 2
    rays = rays_down(np.broadcast_to(point, (rays, 2)))
    got = np.asarray(look(jaxir.Scene(plate(), sources=(DISC,)), rays, Method(method), jax.random.key(3)), float)
    agrees(got, mean, 0.2)
    square = (got - mean) ** 2 * samples / variance
    assert abs(square.mean() - 1) < 4 * square.std() / np.sqrt(square.size)
    assert square.std() / np.sqrt(square.size) < 0.03


# From skin to skin --------------------------------------------------------------------------------------------------


def two_squares(second, hot_emissivity=1.0):
    mesh = jaxir.Mesh(np.concatenate([SQUARE, second]), np.concatenate([TWO, TWO + 4]))
    emissivity = [0.5, 0.5, hot_emissivity, hot_emissivity]
    return jaxir.Skin(mesh, [COLD, COLD, 500.0, 500.0], jaxir.Lambert(emissivity))


ABOVE = SQUARE + np.array([0.0, 0.0, 1.0])
WALL = np.array([[0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [0.5, 0.5, 1.0], [0.5, -0.5, 1.0]])
ONE_BOUNCE = Method(DirectSampling(0, 1), bounces=1)


@pytest.mark.parametrize(("second", "factor"), [(ABOVE, 0.199824895698), (WALL, 0.200043776075)])
def test_a_hot_square_lights_a_cold_one_by_its_view_factor(second, factor):
    """O4: unit squares, facing at distance 1 and perpendicular with a common edge."""
    got = look(jaxir.Scene(two_squares(second)), rays_down(raster(128)), ONE_BOUNCE, jax.random.key(3))
    agrees(got, 0.5 * black(500.0) * factor, 0.1)


def test_a_hot_plume_lights_the_skin():
    """An opaque box of gas is a black body; its underside faces the plate like the hot square."""
    gas = gray_box((1.0, 1.0, 1.0), 1e3, temperature=500.0)
    grid = eqx.tree_at(lambda g: g.origin, gas.grid, jnp.asarray([-0.5, -0.5, 1.0]))
    scene = jaxir.Scene(plate(), jaxir.GridPlume(grid, 500.0, gas.gas))
    got = look(scene, rays_down(raster(96)), Method(plume_light=PlumeLight()), jax.random.key(4))
    agrees(got, 0.5 * black(500.0) * 0.199824895698, 0.15)


# A hot patch of 1 dm2 in the plane x = .49, beside the plate or in a box
PATCH = np.array([[0.49, 0.1, 0.1], [0.49, 0.2, 0.1], [0.49, 0.2, 0.0], [0.49, 0.1, 0.0]])


@pytest.mark.parametrize("direct", [DirectSampling(2, 0), DirectSampling(2, 2)], ids=["light", "both"])
def test_a_hot_patch_drawn_as_a_light_has_its_form_factor(direct):
    """Value and slope in the patch's temperature, without bounces; the plate sees it by Lambert's formula."""
    height = np.array([0.0, 0.0, 0.3])
    points, emissivity = 0.9 * raster(64), 0.7
    mesh = jaxir.Mesh(np.concatenate([SQUARE, PATCH + height]), np.concatenate([TWO, TWO + 4]))
    method = Method(direct, skin_light=SkinLight())

    def radiance(hot):
        temperature = jnp.asarray([COLD, COLD, 0.0, 0.0]) + hot * jnp.asarray([0.0, 0.0, 1.0, 1.0])
        skin = jaxir.Skin(mesh, temperature, jaxir.Lambert([0.5, 0.5, emissivity, emissivity]))
        return look(jaxir.Scene(skin), rays_down(points), method, jax.random.key(21))

    at = jnp.asarray(700.0)
    value, slope = jax.jvp(radiance, (at,), (jnp.ones_like(at),))
    seen = jax.jit(jax.vmap(lambda p: polygon_form_factor(p, jnp.asarray([0.0, 0, 1]), jnp.asarray(PATCH + height))))
    factor = np.asarray(seen(jnp.asarray(np.column_stack([points, np.zeros(len(points))]))), float)
    level = jax.jvp(lambda t: jaxir.band_radiance(t, NODES)[0], (at,), (jnp.ones_like(at),))
    for got, black_body in zip((value, slope), level, strict=True):
        want = 0.5 * emissivity * float(black_body) * factor
        difference = np.asarray(got, float) - want
        error = difference.std() / np.sqrt(difference.size)
        assert abs(difference.mean()) < 4 * error
        assert error < 0.01 * want.mean()
        # as many directions of the brdf would scatter by (1 - F) / F of the squared mean, over their number
        met = np.mean(want**2 * (1 - factor) / factor) / direct.lights
        assert met > 1000 * difference.var()


def test_a_hot_patch_and_a_plume_in_a_box_drawn_as_lights_or_met_by_bounces():
    """The same orders of reflection either way, and far less scatter where patch and plume are drawn.

    The plume lies about some of the points seen and reaches through a wall, which hides its far end.
    """
    box = open_box(jaxir.Lambert(0.5)).mesh
    patch = PATCH - [0.01, 0.0, 0.0]
    mesh = jaxir.Mesh(np.concatenate([box.vertices, patch]), np.concatenate([box.faces, TWO + 8]))
    temperature = [300.0] * 10 + [900.0] * 2
    grid = jaxir.Grid((-0.7, -0.5, -0.6), (0.1, 0.15, 0.1), (4, 4, 3))
    plume = jaxir.GridPlume(grid, np.linspace(300, 700, 48).reshape(4, 4, 3), jaxir.GrayGas(2.0))
    scene = jaxir.Scene(jaxir.Skin(mesh, temperature, jaxir.Lambert([0.5] * 10 + [0.9] * 2)), plume)
    rays = rays_down(0.9 * raster(32), 2.0)
    sharp, drawn = (
        Method(DirectSampling(), bounces=2, skin_light=SkinLight(power), plume_light=PlumeLight(power))
        for power in (8.0, 4.0)
    )
    met = Method(DirectSampling(0, 1), bounces=3)
    moments = []
    for place, method in enumerate((sharp, drawn, met)):
        keys = [jax.random.key(100 * place + repeat) for repeat in range(8)]
        got = np.stack([np.asarray(look(scene, rays, method, key), float) for key in keys])
        # rays differ from each other, so the scatter is that of the repeats of each
        moments.append((got.mean(), got.var(axis=0, ddof=1).mean() / got.size))
    (a, va), (b, vb), (c, vc) = moments
    # of the three differences one in 100 runs may fail
    for difference, variance in ((a - c, va + vc), (b - c, vb + vc), (a - b, va + vb)):
        assert norm.sf(abs(difference) / np.sqrt(variance)) * 2 > 1 - 0.99 ** (1 / 3)
        assert np.sqrt(variance) < 0.02 * a
    assert vc > 4 * max(va, vb), (vc / va, vc / vb)


# Furnaces -----------------------------------------------------------------------------------------------------------


def outward(count, key=5):
    omega = jax.random.normal(jax.random.key(key), (count, 3))
    return Rays(jnp.zeros((count, 3)) + 0.01, omega / jnp.linalg.norm(omega, axis=-1, keepdims=True))


def mixed_brdf(emissivity, faces):
    """Diffuse, painted and metal faces by turns."""
    share = np.asarray(emissivity)
    kinds = [
        jaxir.Lambert(share),
        jaxir.SandfordRobertson(share * 0.8, (1 - share) * 0.3, 0.3, 0.3),
        jaxir.RoughConductor(2.0, 2.0, 0.4),
    ]
    return jaxir.BrdfPerFace(kinds, np.arange(faces) // 2 % 3)


FURNACE = Method(DirectSampling(0, 1), bounces=4, ambient=0.0)


def cube(brdf, temperature=500.0):
    return jaxir.Skin(box_mesh(), temperature, brdf)


@pytest.mark.parametrize("emissivity", [0.2, 0.5, 0.8])
def test_inside_of_a_diffuse_furnace(emissivity):
    """O10, deterministic: what five emissions leave out of the blackbody is rho^5; the ambient term closes it."""
    got = look(jaxir.Scene(cube(jaxir.Lambert(emissivity))), outward(512), FURNACE, jax.random.key(6))
    np.testing.assert_allclose(got, np.full(512, black(500.0) * (1 - (1 - emissivity) ** 5)), rtol=1e-5)
    closed = Method(DirectSampling(0, 1), bounces=4, ambient=black(500.0))
    got = look(jaxir.Scene(cube(jaxir.Lambert(emissivity))), outward(512), closed, jax.random.key(6))
    np.testing.assert_allclose(got, np.full(512, black(500.0)), rtol=1e-5)


def test_a_furnace_counts_no_emission_twice():
    """Met as a light by the same directions, the skin's glow is one order ahead; the term closes what it reflects."""
    ahead = Method(DirectSampling(0, 1), bounces=3, ambient=0.5 * black(500.0), skin_light=SkinLight())
    got = look(jaxir.Scene(cube(jaxir.Lambert(0.5))), outward(512), ahead, jax.random.key(6))
    np.testing.assert_allclose(got, np.full(512, black(500.0)), rtol=1e-5)


def test_inside_of_a_furnace_of_paint_and_metal():
    closed = Method(DirectSampling(0, 1), bounces=4, ambient=black(500.0))
    for emissivity in (0.2, 0.5, 0.8):
        scene = jaxir.Scene(cube(mixed_brdf(emissivity, 12)))
        got = look(scene, outward(4096), closed, jax.random.key(7))
        agrees(got, black(500.0), 0.05)


def open_box(brdf, temperature=500.0):
    """A box without its top, walls on both sides."""
    mesh = box_mesh()
    faces = np.asarray(mesh.faces)
    top = np.asarray(mesh.vertices)[faces][:, :, 2].min(axis=1) > 0.4
    return jaxir.Skin(jaxir.Mesh(mesh.vertices, faces[~top]), temperature, brdf)


def test_a_cavity_and_its_surroundings_at_one_temperature():
    """O10 with a concave body, seen from outside, lit by the background by both strategies."""
    method = Method(DirectSampling(), bounces=6, ambient=black(500.0))
    rays = rays_down(0.9 * raster(64), 2.0)
    for emissivity in (0.2, 0.8):
        skin = open_box(mixed_brdf(emissivity, 10))
        scene = jaxir.Scene(skin, background=jaxir.BlackbodyBackground(500.0))
        agrees(look(scene, rays, method, jax.random.key(8)), black(500.0), 0.05)


@pytest.mark.parametrize("mode", [jax.jacfwd, jax.jacrev])
def test_a_furnace_has_no_slope_in_emissivity(mode, x64):
    method = Method(DirectSampling(0, 1), bounces=4, ambient=1.0)
    nodes = gray_nodes((jaxir.LWIR,))
    level = jaxir.band_radiance(jnp.asarray(500.0), nodes)
    method = eqx.tree_at(lambda m: m.ambient, method, level)
    rays = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), outward(16))
    body = jaxir.Mesh(np.asarray(box_mesh().vertices), np.asarray(box_mesh().faces))

    def mean(emissivity):
        scene = jaxir.Scene(jaxir.Skin(body, 500.0, jaxir.Lambert(emissivity)))
        return evaluate(scene.on(nodes), trace(scene, rays, method, jax.random.key(9))).mean()

    slope = jax.jit(mode(mean))(jnp.asarray(0.3))
    assert abs(float(slope)) < 1e-9 * float(level[0])


# No bias ------------------------------------------------------------------------------------------------------------


def random_scene(seed):
    """Three boxes of random sizes, temperatures and paints around the origin, a disc, a ball and a sky."""
    draw = np.random.default_rng(seed)
    meshes = [box_mesh(draw.uniform(0.3, 1.0, 3), draw.uniform(-0.8, 0.8, 3)) for _ in range(3)]
    vertices = np.concatenate([m.vertices for m in meshes])
    faces = np.concatenate([np.asarray(m.faces) + 8 * i for i, m in enumerate(meshes)])
    share, dull, width = draw.uniform(0.1, 0.6, 36), draw.uniform(0.1, 0.9, 36), draw.uniform(0.2, 0.6, 36)
    kinds = [jaxir.Lambert(dull), jaxir.SandfordRobertson(share, (1 - share) * 0.2, width, 0.2)]
    skin = jaxir.Skin(
        jaxir.Mesh(vertices, faces), draw.uniform(300, 500, 36), jaxir.BrdfPerFace(kinds, draw.integers(0, 2, 36))
    )
    towards = draw.normal(size=3)
    towards = towards / np.linalg.norm(towards)
    sources = (
        jaxir.DiscSource(3 * towards, -towards, draw.uniform(0.5, 1.5), draw.uniform(100, 500)),
        jaxir.SphereSource(draw.uniform(-1, 1, 3) + [0.0, 0.0, 3.0], draw.uniform(0.3, 1.0), draw.uniform(100, 500)),
    )
    return jaxir.Scene(skin, sources=sources, background=jaxir.UniformBackground(draw.uniform(1, 30)))


@jax.jit
def painted(scene, values):
    """The scene with an emissivity of each box, and a width of the paint's lobe, that are given."""
    share, width = jnp.repeat(values[:3], 12), jnp.broadcast_to(values[3], (36,))
    kinds = jaxir.Lambert(share), jaxir.SandfordRobertson(share, (1 - share) * 0.2, width, 0.2)
    return eqx.tree_at(lambda s: s.skin.brdf.kinds, scene, kinds)


REPEATS, AREA = 4, 2.4**2 / 20**2
ACROSS = rays_down(np.tile(2.4 * raster(20), (REPEATS, 1)), 4.0)  # the scene from above, each ray as often


def moments(values):
    """Sum over the scene, and its standard error: rays differ, so the scatter is that of the repeats of each."""
    each = AREA * np.asarray(values, float).reshape(REPEATS, -1)
    return each.sum() / REPEATS, np.sqrt(np.sum(each.var(axis=0, ddof=1)) / REPEATS)


@pytest.mark.optimised
def test_strategies_agree_on_random_scenes():
    """Light, brdf and both, ten bounces, 20 scenes: 60 differences, one in 100 runs of the family may fail."""
    methods = [Method(d, bounces=10) for d in (DirectSampling(1, 0), DirectSampling(0, 1), DirectSampling())]
    worst, power = 0.0, []
    for seed in range(20):
        scene = random_scene(seed)
        keys = [jax.random.key(100 * seed + place) for place in range(3)]
        results = [moments(look(scene, ACROSS, method, key)) for method, key in zip(methods, keys, strict=True)]
        for (a, sa), (b, sb) in itertools.combinations(results, 2):
            worst = max(worst, abs(a - b) / np.hypot(sa, sb))
            power.append(np.hypot(sa, sb) / a)
    assert np.median(power) < 0.05
    assert norm.sf(worst) * 2 > 1 - 0.99 ** (1 / 60), worst


@pytest.mark.optimised
def test_slopes_under_bounces_are_those_of_the_expected_intensity():
    """W/sr per unit of emissivity of each box, and of lobe width: pathwise against differences with other samples.

    Ten bounces, 5 scenes: 20 slopes, one in 100 runs of the family may fail.
    """
    method, step, at = Method(DirectSampling(), bounces=10), 0.04, jnp.asarray([0.3, 0.5, 0.7, 0.4])

    @jax.jit
    def slope(scene, along, key):
        return jax.jvp(lambda v: look(painted(scene, v), ACROSS, method, key), (at,), (along,))[1]

    worst, power = 0.0, []
    for seed in range(5):
        scene = random_scene(seed)
        for place, along in enumerate(jnp.eye(4)):
            own, other = (jax.random.key(100 * seed + 2 * place + i) for i in range(2))
            # common random numbers inside the difference, others than the slope's
            high, low = (look(painted(scene, at + s * step * along), ACROSS, method, other) for s in (1, -1))
            difference = (np.asarray(high, float) - np.asarray(low, float)) / (2 * step)
            (a, sa), (b, sb) = moments(slope(scene, along, own)), moments(difference)
            worst = max(worst, abs(a - b) / np.hypot(sa, sb))
            power.append(np.hypot(sa, sb) / abs(a))
    assert np.median(np.reshape(power, (5, 4))[:, :3]) < 0.1
    assert norm.sf(worst) * 2 > 1 - 0.99 ** (1 / 20), worst


# Delta sources, surroundings, bad input -----------------------------------------------------------------------------


def test_a_point_source_falls_with_the_square_and_casts_shadows(precision):
    nodes = gray_nodes((jaxir.LWIR,))
    blocker = np.array([[0.0, 0.0, 0.5], [0.2, 0.0, 0.5], [0.2, 0.2, 0.5], [0.0, 0.2, 0.5]]) + [0.1, 0.1, 0.0]
    mesh = jaxir.Mesh(np.concatenate([SQUARE, blocker]), np.concatenate([TWO, TWO + 4]))
    lamp = jaxir.PointSource([0.4, 0.4, 1.0], 8.0)
    scene = jaxir.Scene(jaxir.Skin(mesh, COLD, jaxir.Lambert(0.5)), sources=(lamp,))
    points = np.array([[-0.2, 0.1], [0.0, 0.0], [0.45, -0.3]])  # the second looks at the lamp through the blocker
    rays = rays_down(points, 0.2)
    got = jax.jit(lambda scene, rays: evaluate(scene.on(nodes), trace(scene, rays))[:, 0])(scene, rays)
    square = np.sum((points - 0.4) ** 2, axis=1) + 1
    expected = 0.5 / np.pi * 8.0 / square**1.5 * np.array([1, 0, 1])
    np.testing.assert_allclose(got, expected, rtol=1e-5, atol=1e-12)


def test_sky_and_earth_light_the_skin_and_leave_no_contrast_of_their_own():
    """A level white plate shows the sky it sees; contrast counts the skin alone, horizon or not."""
    sky = jaxir.ElevationTable([-90.0, 0.0, 0.0, 90.0], [5.0, 5.0, 2.0, 2.0])
    scene = jaxir.Scene(plate(0.0), background=sky)
    got = look(scene, rays_down(raster(8)), Method(DirectSampling(4, 4)), jax.random.key(12))
    agrees(got, 2.0, 0.2)
    camera = jaxir.perspective_camera(0.0, 30.0, 4.0, 0.05, (32, 32))
    image = jaxir.render(scene, camera, jaxir.LWIR, samples=8, method=Method(DirectSampling(0, 1)))
    assert image.empty.shape == (32, 32, 1)
    assert set(np.unique(np.asarray(image.empty))) >= {2.0, 5.0}
    off = np.asarray(image.radiance == image.empty)
    assert 0.3 < off.mean() < 0.99
    expected = (2.0 - 5.0) * 0.5  # white, lit by the sky, before the earth, seen from 30 degrees above
    error = float(image.intensity_error()[0])
    assert error < 0.05 * abs(expected)
    assert abs(float(image.radiant_intensity()[0]) - expected) < 4 * error


@pytest.mark.parametrize("emissivity", [0.0, 1.0])
@pytest.mark.parametrize("place", ["behind", "at the point", "around"])
def test_awkward_lights_give_right_values_and_finite_slopes(place, emissivity):
    ball = {
        "behind": jaxir.SphereSource([0.0, 0.0, -2.0], 0.5, 10.0),
        "at the point": jaxir.SphereSource([0.0, 0.0, 0.0], 1e-3, 10.0),
        "around": jaxir.SphereSource([0.0, 0.0, 0.0], 5.0, 10.0),
    }[place]

    def total(emissivity, radiance):
        light = eqx.tree_at(lambda b: b.radiance, ball, radiance)
        scene = jaxir.Scene(jaxir.Skin(plate().mesh, COLD, jaxir.Lambert(emissivity)), sources=(light,))
        return look(
            scene, rays_down(np.array([[0.0, 0.0], [0.2, 0.1]])), Method(DirectSampling(0, 2)), jax.random.key(13)
        )

    value = np.asarray(total(jnp.asarray(emissivity), ball.radiance))
    expected = (1 - emissivity) * 10.0 * {"behind": 0, "around": 1}.get(place, np.array([1, 0]))
    np.testing.assert_allclose(value, np.broadcast_to(expected, (2,)), rtol=1e-5, atol=1e-10)
    for slope in jax.jacrev(total, argnums=(0, 1))(jnp.asarray(emissivity), ball.radiance):
        assert np.isfinite(slope).all()


def test_what_does_not_apply_is_refused():
    lit = jaxir.Scene(plate(), sources=(DISC,))
    ray = rays_down(np.zeros((1, 2)))
    with pytest.raises(ValueError, match="trace: got no key"):
        trace(lit, ray)
    with pytest.raises(ValueError, match="DirectSampling: got lights = 0 and brdfs = 0, expected at least one sample"):
        DirectSampling(0, 0)
    with pytest.raises(ValueError, match="DirectSampling.brdfs: got -1"):
        DirectSampling(1, -1)
    with pytest.raises(ValueError, match="Method.skin_light: got SkinLight with direct = ClosedForm"):
        Method(ClosedForm(), skin_light=SkinLight())
    with pytest.raises(ValueError, match="Method.plume_light: got PlumeLight with direct = ClosedForm"):
        Method(ClosedForm(), plume_light=PlumeLight())
    for method in (Method(skin_light=SkinLight(np.nan)), Method(plume_light=PlumeLight(np.nan))):
        with pytest.raises(ValueError, match="Light.exponent: got nan"):
            enforce(NODES, method.checks_for(lit))
    with pytest.raises(ValueError, match="Method.bounces: got -1"):
        Method(bounces=-1)

    def refused(scene, message):
        with pytest.raises(ValueError, match=message):
            enforce(NODES, Method(ClosedForm()).checks_for(scene))

    metal = jaxir.Skin(plate().mesh, COLD, jaxir.RoughConductor(2.0, 2.0, 0.4))
    refused(jaxir.Scene(metal, sources=(DISC,)), "ClosedForm: got RoughConductor skin without plume")
    refused(jaxir.Scene(plate(), sources=(jaxir.SphereSource([0.0, 0, 2], 0.5, 1.0),)), "got SphereSource")
    refused(jaxir.Scene(open_box(jaxir.Lambert(0.5))), "expected 0: skin closed and convex, or flat")
    low = jaxir.DiscSource([3.0, 0.0, 0.5], [-1.0, 0.0, 0.0], 1.0, 1.0)
    refused(jaxir.Scene(plate(), sources=(low,)), "wholly above or wholly below")
    with pytest.raises(ValueError, match="rtol: got -1"):
        jaxir.render(lit, jaxir.orthographic_camera(0.0, 90.0, 0.1, (4, 4)), jaxir.LWIR, rtol=-1.0)
    with pytest.raises(ValueError, match="sources at a finite distance"):
        jaxir.unoccluded_intensity(lit, 0.0, 90.0, jaxir.LWIR)


def test_passes_are_added_until_the_error_is_met():
    camera = jaxir.orthographic_camera(0.0, 90.0, 1.0 / 16, (16, 16))
    scene = jaxir.Scene(plate(), sources=(DISC,))
    method = Method(DirectSampling(1, 0))
    met = jaxir.render(scene, camera, jaxir.LWIR, samples=2, method=method, rtol=0.008)
    assert met.outcome == jaxir.Outcome.tolerance_met
    assert int(met.samples) > 2
    error, intensity = float(met.intensity_error()[0]), float(met.radiant_intensity()[0])
    assert error <= 0.008 * intensity
    expected = 50.0 * form_factor(raster(64)).mean()
    assert abs(intensity - expected) < 4 * error
    spent = jaxir.render(scene, camera, jaxir.LWIR, samples=2, method=method, rtol=1e-6, max_samples=6)
    assert spent.outcome == jaxir.Outcome.samples_spent
    assert int(spent.samples) == 6
    once = jaxir.render(scene, camera, jaxir.LWIR, samples=2, method=method)
    assert once.outcome == jaxir.Outcome.samples_taken


def test_standard_errors_of_even_points_are_honest():
    camera = jaxir.orthographic_camera(0.0, 90.0, 1.0 / 16, (16, 16))
    scene = jaxir.Scene(plate(), sources=(DISC,))
    method = Method(DirectSampling(4, 4), sampler=Sobol())
    images = [
        jaxir.render(scene, camera, jaxir.LWIR, samples=2, method=method, key=jax.random.key(k)) for k in range(64)
    ]
    scatter = np.var([float(i.radiant_intensity()[0]) for i in images], ddof=1)
    claimed = np.mean([float(i.intensity_error()[0]) ** 2 for i in images])
    assert 0.6 < scatter / claimed < 1.55  # chi-squared of 63 degrees of freedom: .1 % to 99.9 %
    pixels = np.var([np.asarray(i.radiance[..., 0]) for i in images], axis=0, ddof=1).mean()
    assert pixels / np.mean([np.asarray(i.standard_error) ** 2 for i in images]) == pytest.approx(1, abs=0.1)


def test_form_factor_vector_is_the_plain_formula():
    points = np.column_stack([raster(4), np.zeros(16)])
    vector = jax.vmap(lambda p: disc_vector(p, DISC.centre, DISC.normal, DISC.radius))(jnp.asarray(points))
    np.testing.assert_allclose(vector[:, 2], form_factor(points[:, :2]), rtol=1e-5)
