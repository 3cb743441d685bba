"""Reflected light against closed forms: area lights, view factors, furnaces, variances, many random scenes."""

import dataclasses
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
from tests.scenes import box_mesh

NODES = gray_nodes((jaxir.LWIR,))
COLD = 3.0
SQUARE = np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]])
TWO = np.array([[0, 1, 2], [0, 2, 3]])
DISC = jaxir.DiscSource([1.2, 1.2, 1.8], [0.0, 0.0, -1.0], 1.0, 100.0)


traced = eqx.filter_jit(trace)


@eqx.filter_jit
def evaluated(scene, paths):
    """Radiance of each path [ray]."""
    return evaluate(scene.on(NODES), paths)[:, 0]


def look(scene, rays, method, key):
    """Radiance of each ray [ray]; compiled once for every scene of the same structure."""
    return evaluated(scene, traced(scene, rays, method, key))


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


# Whatever will do with three boxes, a disc, a ball, a sky and as many rays shares three programs, one for each way.
MANY = 30**2
WAYS = {
    "light": Method(DirectSampling(1, 0), bounces=10, ambient=0.0),
    "brdf": Method(DirectSampling(0, 1), bounces=10, ambient=0.0),
    "both": Method(DirectSampling(1, 1), bounces=10, ambient=0.0),
}
BELOW = box_mesh(centre=(0.0, 0.0, -0.5))  # its top is the unit square about the origin
FAR = box_mesh(centre=(0.0, 0.0, -9.0)), box_mesh(centre=(0.0, 0.0, -12.0))  # which the square does not see
DARK = jaxir.DiscSource([0.0, 0.0, -20.0], [0.0, 0.0, -1.0], 1.0, 0.0), jaxir.SphereSource([0.0, 0.0, -20.0], 1.0, 0.0)


def three_boxes(meshes, temperature, kinds, kind=0, *, disc=DARK[0], ball=DARK[1], sky=0.0):
    """Skin of 36 faces, each of one of some kinds, a disc, a ball and a sky."""
    vertices = np.concatenate([m.vertices for m in meshes])
    faces = np.concatenate([np.asarray(m.faces) + 8 * i for i, m in enumerate(meshes)])
    brdf = jaxir.BrdfPerFace(kinds, np.broadcast_to(kind, (36,)))
    skin = jaxir.Skin(jaxir.Mesh(vertices, faces), np.broadcast_to(temperature, (36,)), brdf)
    return jaxir.Scene(skin, sources=(disc, ball), background=jaxir.UniformBackground(sky))


def kinds_of(dull, share=0.5, glossy=0.1, width=0.3, slope=0.3):
    """Lambert's skin and paint, of 36 faces."""
    dull, share, glossy, width = (np.broadcast_to(x, (36,)) for x in (dull, share, glossy, width))
    return [jaxir.Lambert(dull), jaxir.SandfordRobertson(share, glossy, width, slope)]


def seen_often(scene, rays, method, count, first):
    """Radiance in several looks [look, ray], each with a key of its own from `first` on."""
    keys = [jax.random.key(first + i) for i in range(count)]
    return np.stack([np.asarray(look(scene, rays, method, key), float) for key in keys])


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

EXACT, EVEN = Method(ClosedForm()), Method(DirectSampling(64, 64), sampler=Sobol())


def disc_or_polygon(disc=0.0, polygon=0.0, shift=0.0):
    """The plate with both, of which one is dark."""
    corners = np.array([[0.5, -0.5, 1.0], [0.5, 0.5, 1.0], [0.5, 0.5, -shift], [0.5, -0.5, -shift]])
    lights = jaxir.DiscSource(DISC.centre, DISC.normal, DISC.radius, disc), jaxir.PolygonSource(corners, polygon)
    return jaxir.Scene(plate(), sources=lights)


@pytest.mark.parametrize(
    ("method", "count", "least", "most"),
    [
        (EXACT, 128, 0.0, 1e-5),
        (Method(DirectSampling(100, 100)), 32, 0.048, 0.052),
        (EVEN, 24, 0.0, 0.009),
        (Method(DirectSampling(1024, 0), sampler=Sobol()), 12, 0.0, 0.0008),
    ],
    ids=["closed form", "independent", "sobol", "sobol 1024"],
)
def test_error_of_the_disc_lit_plate(method, count, least, most):
    points, scene = raster(count), disc_or_polygon(disc=100.0)
    enforce(NODES, method.checks_for(scene))
    expected = 0.5 * 100.0 * form_factor(points)
    got = np.asarray(look(scene, rays_down(points), method, jax.random.key(1)), float)
    error = np.sqrt(np.mean((got / expected - 1) ** 2))
    assert least <= error <= most, error


def lit_square():
    """A dull square of emissivity .5 below the disc."""
    return three_boxes((BELOW, *FAR), COLD, kinds_of(0.5), disc=DISC)


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
    points, most = 0.9 * raster(24), raster(128)
    scene = disc_or_polygon(polygon=100.0, shift=shift)
    enforce(NODES, EXACT.checks_for(scene))
    rays = [rays_down(np.resize(p, most.shape)) for p in (most, points)]  # as many of either: one program for both
    whole, want = (np.asarray(look(scene, r, EXACT, jax.random.key(1)), float) for r in rays)
    want = want[: len(points)]
    difference = np.asarray(look(scene, rays_down(points), EVEN, jax.random.key(1)), float) - want
    error = difference.std() / np.sqrt(difference.size)
    assert abs(difference.mean()) < 4 * error
    assert error < 0.005 * want.mean()
    # O4: perpendicular unit squares with a common edge
    assert whole.mean() == pytest.approx(50.0 * 0.200043776075, rel=1e-3)


@pytest.mark.parametrize("way", WAYS)
def test_variance_of_each_strategy_is_its_closed_form(way):
    """Brdf sampling: (1 - p) / p of the squared mean with p the chance to hit; the others by quadrature."""
    point = (0.1, -0.2)
    value, from_light, from_brdf, solid = light_moments(point)
    mean = np.sum(value * solid)
    np.testing.assert_allclose(mean, 50.0 * form_factor([point])[0], rtol=1e-4)
    p = form_factor([point])[0]
    if way == "brdf":
        variance = mean**2 * (1 - p) / p
    elif way == "light":
        variance = np.sum(value**2 / from_light * solid) - mean**2
    else:
        both = from_light**2 + from_brdf**2
        variance = 0.0
        for pdf in (from_light, from_brdf):
            share = pdf**2 / both * value
            variance += np.sum(share**2 / pdf * solid) - np.sum(share * solid) ** 2
    rays = rays_down(np.broadcast_to(point, (MANY, 2)))
    got = seen_often(lit_square(), rays, WAYS[way], 14 if way == "brdf" else 4, 3)
    agrees(got, mean, 0.2)
    square = (got - mean) ** 2 / variance
    assert abs(square.mean() - 1) < 4 * square.std() / np.sqrt(square.size)
    assert square.std() / np.sqrt(square.size) < 0.03


# From skin to skin --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("place", "factor"), [((0.0, 0.0, 1.5), 0.199824895698), ((1.0, 0.0, 0.5), 0.200043776075)])
def test_a_hot_square_lights_a_cold_one_by_its_view_factor(place, factor):
    """O4: unit squares of two boxes, facing at distance 1 and perpendicular with a common edge."""
    meshes, hot = (BELOW, box_mesh(centre=place), FAR[0]), np.repeat([0.0, 1.0, 0.0], 12)
    scene = three_boxes(meshes, COLD + (500.0 - COLD) * hot, kinds_of(0.5 + 0.5 * hot))
    got = seen_often(scene, rays_down(raster(30)), WAYS["brdf"], 10, 3)
    agrees(got, 0.5 * black(500.0) * factor, 0.1)


def drawn_as_lights(power=4.0):
    return Method(DirectSampling(), bounces=2, skin_light=SkinLight(power), plume_light=PlumeLight(power))


def skin_and_cells(vertices, faces, temperature, emissivity, origin, size, hot, coefficient):
    """Skin of 12 faces and a plume of 48 cells: one structure."""
    mesh = jaxir.Mesh(np.resize(vertices, (12, 3)), faces)
    skin = jaxir.Skin(mesh, np.broadcast_to(temperature, (12,)), jaxir.Lambert(np.broadcast_to(emissivity, (12,))))
    plume = jaxir.GridPlume(jaxir.Grid(origin, size, (4, 4, 3)), hot, jaxir.GrayGas(coefficient))
    return jaxir.Scene(skin, plume)


def test_a_hot_plume_lights_the_skin():
    """An opaque box of gas is a black body; its underside faces the plate like the hot square."""
    place, size = (-0.5, -0.5, 1.0), (0.25, 0.25, 1 / 3)
    scene = skin_and_cells(BELOW.vertices, BELOW.faces, COLD, 0.5, place, size, np.full((4, 4, 3), 500.0), 1e3)
    got = seen_often(scene, rays_down(raster(32)), drawn_as_lights(), 8, 4)
    agrees(got, 0.5 * black(500.0) * 0.199824895698, 0.15)


# A hot patch of 1 dm2 in the plane x = .49, beside the plate or in a box
PATCH = np.array([[0.49, 0.1, 0.1], [0.49, 0.2, 0.1], [0.49, 0.2, 0.0], [0.49, 0.1, 0.0]])


@eqx.filter_jit
def hotter(scene, rays, method, key):
    """Radiance, its slope in the temperature of the last two faces, and both of a black body."""
    change = np.array([0.0, 0.0, 1.0, 1.0], np.float32)

    def radiance(temperature):
        own = eqx.tree_at(lambda s: s.skin.temperature, scene, temperature)
        lit = own.on(NODES)
        return evaluate(lit, trace(own, rays, method, key))[:, 0], jaxir.band_radiance(temperature[-1], NODES)[0]

    (value, level), (slope, level_slope) = jax.jvp(radiance, (scene.skin.temperature,), (jnp.asarray(change),))
    return value, slope, (level, level_slope)


@jax.jit
def patch_seen(points, corners):
    """Form factors of a polygon for points that face up."""
    return jax.vmap(lambda p: polygon_form_factor(p, jnp.asarray([0.0, 0, 1]), corners))(points)


@pytest.mark.parametrize("direct", [DirectSampling(2, 0), DirectSampling(2, 2)], ids=["light", "both"])
def test_a_hot_patch_drawn_as_a_light_has_its_form_factor(direct):
    """Value and slope in the patch's temperature, without bounces; the plate sees it by Lambert's formula."""
    height = np.array([0.0, 0.0, 0.3])
    points, emissivity = 0.9 * raster(64), 0.7
    mesh = jaxir.Mesh(np.concatenate([SQUARE, PATCH + height]), np.concatenate([TWO, TWO + 4]))
    method = Method(direct, skin_light=SkinLight())

    skin = jaxir.Skin(mesh, [COLD, COLD, 700.0, 700.0], jaxir.Lambert([0.5, 0.5, emissivity, emissivity]))
    value, slope, level = hotter(jaxir.Scene(skin), rays_down(points), method, jax.random.key(21))
    factor = np.asarray(patch_seen(np.column_stack([points, np.zeros(len(points))]), PATCH + height), float)
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
    vertices, faces = np.concatenate([box.vertices, patch]), np.concatenate([box.faces, TWO + 8])
    warm, emissivity = [300.0] * 10 + [900.0] * 2, [0.5] * 10 + [0.9] * 2
    place, size, hot = (-0.7, -0.5, -0.6), (0.1, 0.15, 0.1), np.linspace(300, 700, 48).reshape(4, 4, 3)
    scene = skin_and_cells(vertices, faces, warm, emissivity, place, size, hot, 2.0)
    rays = rays_down(0.9 * raster(32), 2.0)
    met = Method(DirectSampling(0, 1), bounces=3)
    moments = []
    for place, method in enumerate((drawn_as_lights(8.0), drawn_as_lights(), met)):
        got = seen_often(scene, rays, method, 8, 100 * place)
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


@pytest.mark.parametrize("emissivity", [0.2, 0.5, 0.8])
def test_inside_of_a_diffuse_furnace(emissivity):
    """O10, deterministic: what 11 emissions leave out of the blackbody is rho^11; the ambient term closes it."""
    scene, rays = three_boxes((box_mesh(), *FAR), 500.0, kinds_of(emissivity)), outward(MANY)
    closed = dataclasses.replace(WAYS["brdf"], ambient=black(500.0))
    got = look(scene, rays, WAYS["brdf"], jax.random.key(6))
    np.testing.assert_allclose(got, np.full(MANY, black(500.0) * (1 - (1 - emissivity) ** 11)), rtol=1e-5)
    got = look(scene, rays, closed, jax.random.key(6))
    np.testing.assert_allclose(got, np.full(MANY, black(500.0)), rtol=1e-5)


def test_a_furnace_counts_no_emission_twice():
    """Met as a light by the same directions, the skin's glow is one order ahead; the term closes what it reflects."""
    ahead = Method(DirectSampling(0, 1), bounces=3, ambient=0.5 * black(500.0), skin_light=SkinLight())
    cube = jaxir.Skin(box_mesh(), 500.0, jaxir.Lambert(0.5))
    got = look(jaxir.Scene(cube), outward(512), ahead, jax.random.key(6))
    np.testing.assert_allclose(got, np.full(512, black(500.0)), rtol=1e-5)


def at_top(box):
    return np.asarray(box.vertices)[np.asarray(box.faces)][:, :, 2].min(axis=1) > 0.4


def open_box(brdf, temperature=500.0):
    """A box without its top, walls on both sides."""
    mesh = box_mesh()
    return jaxir.Skin(jaxir.Mesh(mesh.vertices, np.asarray(mesh.faces)[~at_top(mesh)]), temperature, brdf)


def in_paint_and_metal(mesh, emissivity, rays, first):
    """Radiance [look, ray] about skin of diffuse, painted and metal faces by turns, all and its background as warm."""
    mesh = jaxir.Mesh(np.concatenate([mesh.vertices, SQUARE - [0.0, 0.0, 9.0]]), np.concatenate([mesh.faces, TWO + 8]))
    kinds = [
        jaxir.Lambert(emissivity),
        jaxir.SandfordRobertson(emissivity * 0.8, (1 - emissivity) * 0.3, 0.3, 0.3),
        jaxir.RoughConductor(2.0, 2.0, 0.4),
    ]
    skin = jaxir.Skin(mesh, 500.0, jaxir.BrdfPerFace(kinds, np.arange(14) // 2 % 3))
    scene = jaxir.Scene(skin, background=jaxir.BlackbodyBackground(500.0))
    return seen_often(scene, rays, Method(DirectSampling(), bounces=6, ambient=black(500.0)), 4, first)


def test_inside_of_a_furnace_of_paint_and_metal():
    for emissivity in (0.2, 0.5, 0.8):
        agrees(in_paint_and_metal(box_mesh(), emissivity, outward(1024), 7), black(500.0), 0.05)


def test_a_cavity_and_its_surroundings_at_one_temperature():
    """O10 with a concave body, seen from outside, lit by the background by both strategies."""
    box = box_mesh()
    wall = [[0, 6, 7], [0, 7, 1]]  # from edge to edge, in the place of the top
    divided = jaxir.Mesh(box.vertices, np.concatenate([np.asarray(box.faces)[~at_top(box)], wall]))
    rays = rays_down(0.9 * raster(32) + [0.01, 0.0], 2.0)
    for emissivity in (0.2, 0.8):
        agrees(in_paint_and_metal(divided, emissivity, rays, 8), black(500.0), 0.05)


def test_a_furnace_has_no_slope_in_emissivity(x64):
    """Neither forward nor in reverse."""
    nodes = gray_nodes((jaxir.LWIR,))
    level = jaxir.band_radiance(500.0, nodes)
    method = Method(DirectSampling(0, 1), bounces=4, ambient=level)
    rays, body = outward(16), box_mesh()

    @jax.jit
    def slopes(emissivity):
        def scene(emissivity):
            return jaxir.Scene(jaxir.Skin(body, 500.0, jaxir.Lambert(emissivity)))

        def traced_and_seen(emissivity):
            paths = trace(scene(emissivity), rays, method, jax.random.key(9))
            return seen(emissivity, paths), paths

        def seen(emissivity, paths):
            return evaluate(scene(emissivity).on(nodes), paths).mean()

        value, pull, paths = jax.vjp(traced_and_seen, emissivity, has_aux=True)
        return value, *pull(jnp.ones_like(value)), jax.jacfwd(seen)(emissivity, paths)

    value, *both = slopes(0.3)
    np.testing.assert_allclose(value, level[0], rtol=1e-12)
    np.testing.assert_allclose(both, [0.0, 0.0], atol=1e-9 * float(level[0]))


# No bias ------------------------------------------------------------------------------------------------------------


def random_scene(seed):
    """Three boxes of random sizes, temperatures and paints around the origin, a disc, a ball and a sky."""
    draw = np.random.default_rng(seed)
    meshes = [box_mesh(draw.uniform(0.3, 1.0, 3), draw.uniform(-0.8, 0.8, 3)) for _ in range(3)]
    share, dull, width = draw.uniform(0.1, 0.6, 36), draw.uniform(0.1, 0.9, 36), draw.uniform(0.2, 0.6, 36)
    kinds = kinds_of(dull, share, (1 - share) * 0.2, width, 0.2)
    temperature, kind, towards = draw.uniform(300, 500, 36), draw.integers(0, 2, 36), draw.normal(size=3)
    towards = towards / np.linalg.norm(towards)
    disc = jaxir.DiscSource(3 * towards, -towards, draw.uniform(0.5, 1.5), draw.uniform(100, 500))
    place = draw.uniform(-1, 1, 3) + [0.0, 0.0, 3.0]
    ball = jaxir.SphereSource(place, draw.uniform(0.3, 1.0), draw.uniform(100, 500))
    return three_boxes(meshes, temperature, kinds, kind, disc=disc, ball=ball, sky=draw.uniform(1, 30))


@jax.jit
def painted(scene, values):
    """The scene with an emissivity of each box, and a width of the paint's lobe, that are given."""
    share, width = jnp.repeat(values[:3], 12), jnp.broadcast_to(values[3], (36,))
    kinds = jaxir.Lambert(share), jaxir.SandfordRobertson(share, (1 - share) * 0.2, width, 0.2)
    return eqx.tree_at(lambda s: s.skin.brdf.kinds, scene, kinds)


REPEATS, AREA = 4, 2.4**2 / 15**2
ACROSS = rays_down(np.tile(2.4 * raster(15), (REPEATS, 1)), 4.0)  # the scene from above, each ray as often


def moments(values):
    """Sum over the scene, and its standard error: rays differ, so the scatter is that of the repeats of each."""
    each = AREA * np.asarray(values, float).reshape(REPEATS, -1)
    return each.sum() / REPEATS, np.sqrt(np.sum(each.var(axis=0, ddof=1)) / REPEATS)


def test_strategies_agree_on_random_scenes():
    """Light, brdf and both, ten bounces, 20 scenes: 60 differences, one in 100 runs of the family may fail."""
    worst, power = 0.0, []
    for seed in range(20):
        scene = random_scene(seed)
        keys = [jax.random.key(100 * seed + place) for place in range(3)]
        results = [moments(look(scene, ACROSS, way, key)) for way, key in zip(WAYS.values(), keys, strict=True)]
        for (a, sa), (b, sb) in itertools.combinations(results, 2):
            worst = max(worst, abs(a - b) / np.hypot(sa, sb))
            power.append(np.hypot(sa, sb) / a)
    assert np.median(power) < 0.05
    assert norm.sf(worst) * 2 > 1 - 0.99 ** (1 / 60), worst


def test_slopes_under_bounces_are_those_of_the_expected_intensity():
    """W/sr per unit of emissivity of each box, and of lobe width: pathwise against differences with other samples.

    Ten bounces, 5 scenes: 20 slopes, one in 100 runs of the family may fail.
    """
    method, step, at = WAYS["both"], 0.04, np.array([0.3, 0.5, 0.7, 0.4], np.float32)
    jacobian = eqx.filter_jit(lambda scene, paths: jax.jacfwd(lambda v: evaluated(painted(scene, v), paths))(at))
    worst, power = 0.0, []
    for seed in range(5):
        scene, own, other = random_scene(seed), jax.random.key(2 * seed), jax.random.key(2 * seed + 1)
        slopes = np.asarray(jacobian(scene, traced(painted(scene, at), ACROSS, method, own)))
        for place, along in enumerate(np.eye(4, dtype=np.float32)):
            # common random numbers inside the difference, others than the slope's
            high, low = (look(painted(scene, at + s * step * along), ACROSS, method, other) for s in (1, -1))
            difference = (np.asarray(high, float) - np.asarray(low, float)) / (2 * step)
            (a, sa), (b, sb) = moments(slopes[:, place]), moments(difference)
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


def drawn_plate(emissivity, disc, sky, camera, count=1, **asked):
    """Images of the plate below a disc, a sky and the earth, one for each key; one structure, one view."""
    lamp = jaxir.DiscSource(DISC.centre, DISC.normal, DISC.radius, disc)
    scene = jaxir.Scene(plate(emissivity), sources=(lamp,), background=jaxir.ElevationTable([-90.0, 0, 0, 90], sky))
    method = Method(DirectSampling(4, 4), sampler=Sobol())
    keys = [jax.random.key(k) for k in range(count)]
    return [jaxir.render(scene, camera, jaxir.LWIR, samples=2, method=method, key=key, **asked) for key in keys]


def lit_from_above(count=1, **asked):
    """The plate below the disc, seen from far above."""
    camera = jaxir.perspective_camera(0.0, 90.0, 1000.0, 1 / 16e3, (16, 16))
    return drawn_plate(0.5, 100.0, [0.0, 0.0, 0.0, 0.0], camera, count, **asked)


def test_sky_and_earth_light_the_skin_and_leave_no_contrast_of_their_own():
    """A level white plate shows the sky it sees; contrast counts the skin alone, horizon or not."""
    camera = jaxir.perspective_camera(0.0, 30.0, 2.0, 0.08, (16, 16))
    images = drawn_plate(0.0, 0.0, [5.0, 5.0, 2.0, 2.0], camera, 32)
    empty = np.asarray(images[0].empty)
    assert empty.shape == (16, 16, 1)
    assert set(np.unique(empty)) >= {2.0, 5.0}
    off = np.asarray(images[0].radiance) == empty
    assert 0.3 < off.mean() < 0.99
    away = np.column_stack([raster(64), np.zeros(64**2)]) - [np.sqrt(3.0), 0.0, 1.0]
    solid = np.mean(1 / np.linalg.norm(away, axis=1) ** 3)
    expected = (2.0 - 5.0) * 4.0 * solid  # white, lit by the sky, before the earth, seen from 30 degrees above
    error = np.sqrt(np.sum([float(i.intensity_error()[0]) ** 2 for i in images])) / len(images)
    assert error < 0.03 * abs(expected)
    assert abs(np.mean([float(i.radiant_intensity()[0]) for i in images]) - expected) < 4 * error


@pytest.mark.parametrize("emissivity", [0.0, 1.0])
@pytest.mark.parametrize("place", ["behind", "at the point", "around"])
def test_awkward_lights_give_right_values_and_finite_slopes(place, emissivity):
    """Both slopes and values are those of paths that the brdf draws."""
    centre, radius = {"behind": (-2.0, 0.5), "at the point": (0.0, 1e-3), "around": (0.0, 5.0)}[place]
    ball = jaxir.SphereSource([0.0, 0.0, centre], radius, 10.0)
    scene = three_boxes((BELOW, *FAR), COLD, kinds_of(emissivity), ball=ball)
    rays = rays_down(np.resize([[0.0, 0.0], [0.2, 0.1]], (MANY, 2)))
    value, slopes = pulled(scene, traced(scene, rays, WAYS["brdf"], jax.random.key(13)))
    expected = (1 - emissivity) * 10.0 * {"behind": 0, "around": 1}.get(place, np.resize([1, 0], MANY))
    np.testing.assert_allclose(value, np.broadcast_to(expected, (MANY,)), rtol=1e-5, atol=1e-10)
    assert all(np.isfinite(slope).all() for slope in slopes)


@eqx.filter_jit
def pulled(scene, paths):
    """Radiance, and the slopes of its sum in Lambert's emissivities and the ball's radiance."""

    def radiance(dull, ball):
        own = eqx.tree_at(lambda s: (s.skin.brdf.kinds[0].emissivity, s.sources[1].radiance), scene, (dull, ball))
        return evaluated(own, paths)

    value, pull = jax.vjp(radiance, scene.skin.brdf.kinds[0].emissivity, scene.sources[1].radiance)
    return value, pull(jnp.ones_like(value))


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
    (met,) = lit_from_above(rtol=0.002)
    assert met.outcome == jaxir.Outcome.tolerance_met
    assert int(met.samples) > 2
    error, intensity = float(met.intensity_error()[0]), float(met.radiant_intensity()[0])
    assert error <= 0.002 * intensity
    expected = 50.0 * form_factor(raster(64)).mean()
    assert abs(intensity - expected) < 4 * error
    (spent,) = lit_from_above(rtol=1e-6, max_samples=6)
    assert spent.outcome == jaxir.Outcome.samples_spent
    assert int(spent.samples) == 6
    (once,) = lit_from_above()
    assert once.outcome == jaxir.Outcome.samples_taken


def test_standard_errors_of_even_points_are_honest():
    images = lit_from_above(64)
    scatter = np.var([float(i.radiant_intensity()[0]) for i in images], ddof=1)
    claimed = np.mean([float(i.intensity_error()[0]) ** 2 for i in images])
    assert 0.6 < scatter / claimed < 1.55  # chi-squared of 63 degrees of freedom: .1 % to 99.9 %
    pixels = np.var([np.asarray(i.radiance[..., 0]) for i in images], axis=0, ddof=1).mean()
    assert pixels / np.mean([np.asarray(i.standard_error) ** 2 for i in images]) == pytest.approx(1, abs=0.1)


def test_form_factor_vector_is_the_plain_formula():
    points = np.column_stack([raster(4), np.zeros(16)])
    vector = jax.vmap(lambda p: disc_vector(p, DISC.centre, DISC.normal, DISC.radius))(jnp.asarray(points))
    np.testing.assert_allclose(vector[:, 2], form_factor(points[:, :2]), rtol=1e-5)
