import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir._arrays import as_float
from jaxir.geometry import Crossings, pixel_samples, tile_rays
from jaxir.medium import crossing_sum
from jaxir.optics import thinning
from jaxir.optics.spectrum import gray_nodes
from tests.scenes import gray_box, plate

SAMPLED = (jaxir.PointIntegration(), jaxir.LineIntegration(), jaxir.CombinedIntegration())
NODES = gray_nodes((jaxir.MWIR,))
CELLS = 8
MAP = 10.0 ** np.arange(-8, 5)


def media(depths, samples=1):
    """Lists, extinction, emission of homogeneous, ramp, hot-core and cold-front media for every depth and sample."""
    x = (np.arange(CELLS) + 0.5) / CELLS
    shapes = [np.ones(CELLS), x, np.ones(CELLS), np.ones(CELLS)]
    sources = [np.ones(CELLS), np.ones(CELLS), np.exp(-32 * (x - 0.5) ** 2) + 0.01, np.where(x < 0.5, 0.01, 1.0)]
    length = 0.25
    mu = np.stack([d * s / (s.sum() * length) for s in shapes for d in depths])
    j = mu * np.stack([b for b in sources for _ in depths])
    cell = np.repeat(np.arange(mu.size, dtype=np.int32).reshape(mu.shape), samples, axis=0)
    lists = Crossings(jnp.asarray(cell), as_float(np.full(cell.shape, length)))
    return lists, as_float(mu.reshape(-1, 1)), as_float(j.reshape(-1, 1))


@jax.jit
def sample(path, lists, mu, j, behind, u):
    """Radiance, and its derivative along the logarithm of the absorption."""
    return jax.jvp(lambda m, e: path.radiance(lists, m, e, behind, u), (mu, j), (mu, j))


@jax.jit
def pulled(path, lists, mu, j, behind, u):
    return jax.grad(lambda s: path.radiance(lists, s * mu, s * j, behind, u).sum())(jnp.ones_like(mu[0, 0]))


@jax.jit
def variance(path, lists, mu, j, behind):
    return path.variance(lists, mu, j, behind)


@jax.jit
def exact(lists, mu, j, behind):
    return jax.jvp(lambda m, e: crossing_sum(lists, m, e, behind), (mu, j), (mu, j))


@jax.jit
def by_cell(lists, mu, j, behind):
    """Derivatives of the sum of all rays along the logarithms of each cell's extinction and emission."""
    pull = jax.grad(lambda m, e: crossing_sum(lists, m, e, behind).sum(), (0, 1))(mu, j)
    return pull[0] * mu, pull[1] * j


@pytest.mark.optimised
@pytest.mark.parametrize("glow", [0.0, 0.3])
@pytest.mark.parametrize("path", SAMPLED, ids=lambda p: type(p).__name__)
def test_mean_variance_and_gradient_are_those_of_the_closed_forms(path, glow, x64):
    """z-tests of mean and gradient, and the sample variance within 4.5 of its standard errors (chi-square bounds)."""
    depths, samples = np.array([0.04, 0.3, 1.0, 3.0]), 25000
    lists, mu, j = media(depths, samples)
    few = media(depths)[0]
    rays = lists.cell.shape[0]
    behind, u = np.full((rays, 1), glow), np.random.default_rng(7).uniform(size=rays)
    got, slope = (np.asarray(x).reshape(-1, samples) for x in sample(path, lists, mu, j, behind, u))
    want, want_slope = (np.asarray(x)[:, 0] for x in exact(few, mu, j, behind[: len(got)]))
    spread = np.asarray(variance(path, few, mu, j, behind[: len(got)]))[:, 0]

    error = np.sqrt(spread / samples)
    assert (np.abs(got.mean(1) - want) < 4.5 * error).all()
    assert (error < 0.05 * want).all()
    square = (got - want[:, None]) ** 2
    off = np.abs(square.mean(1) - spread) / (square.std(1) / samples**0.5)
    assert off.max() < 4.5
    assert np.median(square.std(1) / samples**0.5 / spread) < 0.03  # the bounds are narrow
    slope_error = slope.std(1) / samples**0.5
    assert (np.abs(slope.mean(1) - want_slope) < 4.5 * slope_error).all()
    assert np.median(slope_error / np.abs(want_slope)) < 0.1
    some = slice(None, None, 40)
    few = Crossings(lists.cell[some], lists.length[some])
    np.testing.assert_allclose(
        pulled(path, few, mu, j, behind[some], u[some]), slope.reshape(-1)[some].sum(), rtol=1e-9
    )


@pytest.mark.parametrize("path", SAMPLED, ids=lambda p: type(p).__name__)
def test_variance_of_a_homogeneous_path(path, precision):
    """O11: point 1 / (e^t - 1), line (2 - 2 (1 + t) e^-t) / (1 - e^-t)^2 - 1, combined (1 - e^-t) / 3."""
    t = 10.0 ** np.arange(-8, 2)
    lists, mu, j = media(t)
    dark = as_float(np.zeros((lists.cell.shape[0], 1)))
    spread = np.asarray(variance(path, lists, mu, j, dark))[: len(t), 0]
    p = -np.expm1(-t)
    tiny = t < 1e-2
    line = np.where(tiny, t / 3, (2 - 2 * (1 + t) * np.exp(-t)) / p**2 - 1)
    want = {"Point": 1 / np.expm1(t), "Line": line, "Combined": p / 3}[type(path).__name__[: -len("Integration")]]
    rtol = np.where(tiny, 4e-3, 2e-5 if precision == "float32" else 1e-9)
    assert (np.abs(spread / p**2 / want - 1) < rtol).all()
    assert (np.abs(np.asarray(path.relative_variance(as_float(t))) / want - 1) < rtol).all()


def test_point_beats_combined_beyond_1_5668(x64):
    point, _, combined = SAMPLED
    assert float(point.relative_variance(1.566) - combined.relative_variance(1.566)) > 0
    assert float(point.relative_variance(1.568) - combined.relative_variance(1.568)) < 0


def test_failure_map_in_single_precision_equals_double():
    """Exact sum, its derivatives, and every closed-form variance: within 2e-5 of the radiance (its square)."""
    found = []
    for wide in (False, True):
        with jax.enable_x64(wide):
            lists, mu, j = media(MAP)
            behind = as_float(np.full((lists.cell.shape[0], 1), 0.0))
            value, slope = exact(lists, mu, j, behind)
            spread = [variance(path, lists, mu, j, behind) for path in SAMPLED]
            cells = np.stack(by_cell(lists, mu, j, behind))[:, np.asarray(lists.cell), 0]
            found.append([np.asarray(x, float) for x in (value, slope, cells, *spread)])
    (value, slope, cells, *spread), (true, true_slope, true_cells, *true_spread) = found
    assert np.abs(value / true - 1).max() < 2e-5
    assert (np.abs(slope - true_slope) / true).max() < 2e-5
    assert (np.abs(cells - true_cells) / true).max() < 2e-5
    for ours, theirs in zip(spread, true_spread, strict=True):
        assert (np.abs(ours - theirs) / (theirs + true**2)).max() < 2e-5


@pytest.mark.parametrize("path", (jaxir.CellSum(), *SAMPLED), ids=lambda p: type(p).__name__)
def test_no_nan_anywhere_in_the_failure_map(path, precision):
    lists, mu, j = media(np.concatenate([[0.0, 1e-38, 1e30], MAP]), samples=16)
    rays = lists.cell.shape[0]
    u = as_float(np.tile(np.concatenate([[0.0, 1 - 6e-8], np.arange(14) / 14]), rays // 16))
    for glow in (0.0, 1.0):
        behind = as_float(np.full((rays, 1), glow))
        value, slope = sample(path, lists, mu, j, behind, u)
        results = (value, slope, pulled(path, lists, mu, j, behind, u), variance(path, lists, mu, j, behind))
        assert all(np.isfinite(x).all() for x in results)
        assert (np.asarray(results[3]) >= 0).all()


def test_thinning_is_the_difference_of_the_phis(x64):
    u = np.array([1e-3, 0.1, 0.4999, 0.5, 2.0, 30.0])
    np.testing.assert_allclose(thinning(as_float(u)), (1 - (1 + u) * np.exp(-u)) / u**2, rtol=1e-9)
    assert float(thinning(as_float(0.0))) == 0.5


@eqx.filter_jit
def rays_of_a_tile(scene, camera, samples):
    offset, edges = pixel_samples(jax.random.key(3), 1, samples), jnp.asarray(camera.tile_edges())
    bundle = tile_rays(camera, edges, offset, scene.start(camera))
    return bundle, jnp.asarray(camera.pixel_index()).reshape(-1), camera.pixel_area()


def camera_rays(scene, camera, samples):
    """Rays of all pixels of an image of one tile, and the part of the pixel's area that each stands for [ray] [m2]."""

    bundle, inside, area = jax.device_get(rays_of_a_tile(scene, camera, samples))
    area = np.where(inside >= 0, area.reshape(-1)[inside], 0)
    return bundle, np.repeat(area.astype(float), samples) / samples


@eqx.filter_jit
def traced(scene, rays, key):
    """Paths, and the exact sum along each."""
    paths = jaxir.trace(scene, rays, None, key)
    return paths, jaxir.evaluate(scene.on(NODES), paths)[:, 0]


@eqx.filter_jit
def estimated(scene, paths, path, key):
    return jaxir.estimate(scene.on(NODES), paths, path, key)[:, 0]


def whole():
    """A scene with all of its parts: skin behind a plume in the sun, sky and air."""
    sun = jaxir.ParallelSource((-1.0, 0.0, 0.0), 50.0)
    air, sky = jaxir.FixedPath(0.7, 0.2), jaxir.UniformBackground(2.0)
    return jaxir.Scene(plate(x=-0.9), gray_box((1.0, 1.2, 1.2), 1.0), sun, sky, air)


@pytest.mark.parametrize("path", SAMPLED, ids=lambda p: type(p).__name__)
@pytest.mark.parametrize("view", [(0.0, 0.0), (30.0, 20.0)])
def test_estimators_of_an_image_have_the_mean_of_the_exact_sum_over_all_pixels(view, path):
    """Radiant intensity by traced rays of a camera, and its standard error from repeats of every ray."""
    scene = whole()
    camera = jaxir.orthographic_camera(*view, 0.12, (16, 16))
    bundle, area = camera_rays(scene, camera, 8)
    paths, exact = traced(scene, bundle, jax.random.key(4))
    exact, repeats = np.asarray(exact, float), 8
    keys = [jax.random.key(k) for k in range(repeats)]
    noisy = np.stack([np.asarray(estimated(scene, paths, path, key), float) for key in keys])
    error = np.sqrt(np.sum(noisy.var(axis=0, ddof=1) * area**2) / repeats)
    assert abs(noisy.mean(axis=0) @ area - exact @ area) < 4 * error
    assert 0 < error < 0.02 * (exact @ area)
    summed = np.asarray(estimated(scene, paths, jaxir.CellSum(), keys[0]), float)
    np.testing.assert_allclose(summed, exact, rtol=1e-5)


def test_an_estimator_lies_behind_the_air_and_in_front_of_skin():
    """The exact sum, and the mean of a sampled one, in a scene with all of its parts."""
    scene = whole()
    bundle, _ = camera_rays(scene, jaxir.orthographic_camera(15.0, 10.0, 0.12, (16, 16)), 8)
    paths, exact = traced(scene, bundle, jax.random.key(4))
    exact = np.asarray(exact, float)
    summed = np.asarray(estimated(scene, paths, jaxir.CellSum(), jax.random.key(5)), float)
    np.testing.assert_allclose(summed, exact, rtol=1e-3)
    assert np.mean(np.abs(summed / exact - 1) < 1e-5) > 0.998  # but where a ray meets the corner of a cell
    keys = [jax.random.key(k) for k in range(8)]
    off = np.stack([estimated(scene, paths, jaxir.CombinedIntegration(), key) for key in keys]).astype(float) - exact
    error = off.std() / np.sqrt(off.size)
    assert 0 < error < 0.01 * exact.mean()
    assert abs(off.mean()) < 4 * error


@pytest.mark.parametrize("kind", ["PointIntegration", "LineIntegration", "CombinedIntegration"])
def test_an_opaque_cell_behind_a_thin_one_does_not_swallow_it(kind):
    # the sum up to a cell of depth 1e7 less its own is 0 in float32, not the .5 in front of it
    grid = jaxir.Grid((0.0, -0.5, -0.5), (1.0, 1.0, 1.0), (2, 1, 1))
    extinction = np.array([0.5, 1e7]).reshape(2, 1, 1, 1)
    plume = jaxir.GridPlume(grid, np.array([900.0, 700.0]).reshape(2, 1, 1), jaxir.GrayGas(extinction))
    scene, key = jaxir.Scene(None, plume), jax.random.key(0)
    rays = jaxir.Rays(*(as_float(np.tile([[x, 0.0, 0.0]], (4096, 1))) for x in (-1.0, 1.0)))
    paths, exact = traced(scene, rays, key)
    exact = float(exact.mean())
    found = np.asarray(estimated(scene, paths, getattr(jaxir, kind)(), key), np.float64)
    assert abs(found.mean() - exact) < 4 * found.std() / 64 + 1e-4 * exact
