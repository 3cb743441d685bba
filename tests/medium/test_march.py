from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxir._arrays import as_float
from jaxir.geometry import Grid, Rays, crossings
from jaxir.medium import crossing_sum, march, optical_depth, transmittance
from tests.reference import reference_crossings, reference_radiance

SHAPE, NODES = (6, 4, 5), 2
DEPTHS = {"thin": (-8, -6), "mixed": (-8, 4), "thick": (2, 4)}


def tolerance(precision):
    return 1e-5 if precision == "float32" else 1e-6


def parallel_rays(start, direction):
    start = np.asarray(start, float)
    return Rays(as_float(start), as_float(np.broadcast_to(direction, start.shape)))


def scene(case, seed=0, count=300):
    """A grid of random cells whose optical depths span `case`, random rays, random radiance behind."""
    rng = np.random.default_rng(seed)
    grid = Grid([-0.3, -0.4, -0.25], [0.1, 0.2, 0.1], SHAPE)
    low, high = DEPTHS[case]
    extinction = 10 ** rng.uniform(low, high, size=SHAPE + (NODES,)) / 0.1
    extinction[rng.random(extinction.shape) < 0.1] = 0.0
    emission = extinction * rng.uniform(0.5, 2, size=extinction.shape)
    start = rng.normal(size=(count, 3)) * np.where(rng.random((count, 1)) < 0.3, 0.1, 1.0)
    direction = rng.normal(size=(count, 3)) * 0.2 - start
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    t_max = np.where(rng.random(count) < 0.5, np.inf, rng.uniform(0, 1.5, count))
    rays = Rays(as_float(start), as_float(direction))
    behind = rng.uniform(0, 2, size=(count, NODES))
    return grid, rays, as_float(t_max), *(as_float(x) for x in (extinction, emission, behind))


@jax.jit  # compiled once for all tests of one shape
def summed(lists, extinction, emission, behind):
    return crossing_sum(
        lists, extinction.reshape(-1, extinction.shape[-1]), emission.reshape(-1, emission.shape[-1]), behind
    )


def by_list(grid, rays, t_max):
    lists = crossings(grid, rays, t_max)
    return lambda extinction, emission, behind: summed(lists, extinction, emission, behind)


def by_march(grid, rays, t_max):
    return lambda extinction, emission, behind: march(grid, extinction, emission, rays, t_max, behind)


ROUTES = {"march": by_march, "list": by_list}


def linearized(function, primals, tangents, weight):
    """A value, its derivative along tangents, and what `weight` on it pulls back."""
    found, along = jax.linearize(function, *primals)
    return found, along(*tangents), jax.linear_transpose(along, *primals)(weight)


@partial(jax.jit, static_argnames="name")
def in_both_modes(name, grid, rays, t_max, fields, tangents, weight):
    return linearized(ROUTES[name](grid, rays, t_max), fields, tangents, weight)


@pytest.mark.parametrize("case", DEPTHS)
def test_march_list_and_reference_agree(case, precision):
    grid, rays, t_max, extinction, emission, behind = scene(case)
    mu, j = (np.asarray(x, float).reshape(-1, NODES) for x in (extinction, emission))
    want, scale = np.zeros(behind.shape), 2.0 if case != "thin" else 1.0
    given = (np.asarray(x, float) for x in (rays.origin, rays.direction, t_max, behind))
    for row, (start, direction, end, light) in zip(want, zip(*given, strict=True), strict=True):
        cell, length = reference_crossings(grid.origin, grid.spacing, SHAPE, start, direction, end)
        row[:] = reference_radiance(cell, length, mu, j, light)
    for route in ROUTES.values():
        got = route(grid, rays, t_max)(extinction, emission, behind)
        error = np.abs(np.asarray(got) - want)
        # A ray that grazes an edge by less than its own rounding may take the other cell: few may, in float32.
        assert np.quantile(error, 0.98) < tolerance(precision) * scale
        assert precision == "float32" or error.max() < tolerance(precision)
    both = [route(grid, rays, t_max)(extinction, emission, behind) for route in ROUTES.values()]
    np.testing.assert_allclose(*both, atol=tolerance(precision), rtol=tolerance(precision))


@pytest.mark.parametrize("case", DEPTHS)
def test_gradients_of_march_equal_those_of_the_list_in_both_modes(case, precision):
    grid, rays, t_max, *fields = scene(case, seed=1)
    rng = np.random.default_rng(2)
    weight = as_float(rng.normal(size=fields[2].shape))
    tangents = tuple(as_float(rng.normal(size=x.shape) * np.asarray(x)) for x in fields)
    found = [in_both_modes(name, grid, rays, t_max, tuple(fields), tangents, weight) for name in ROUTES]
    _, pushed, pulled = zip(*jax.device_get(found), strict=True)
    limit = 1e-5 if precision == "float32" else 1e-11
    np.testing.assert_allclose(*pushed, rtol=limit, atol=limit * np.abs(pushed[1]).max())
    for ours, theirs in zip(*pulled, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=limit, atol=limit * np.abs(theirs).max())
    inner = sum(np.vdot(a, b) for a, b in zip(pulled[0], tangents, strict=True))
    np.testing.assert_allclose(inner, np.vdot(weight, pushed[0]), rtol=20 * limit)


def test_gradients_of_march_equal_central_differences(x64):
    grid, rays, t_max, extinction, emission, behind = scene("mixed", seed=3)
    extinction, emission = (as_float(np.minimum(x, 20.0)) for x in (extinction, emission))

    def total(scale):
        return jnp.sum(march(grid, extinction * scale[0], emission * scale[1], rays, t_max, behind * scale[2]) ** 2)

    modes = jax.jit(lambda scale: (total(scale), jax.grad(total)(scale), jax.jacfwd(total)(scale)))
    at, step = np.ones(3), 1e-5
    ends = [[modes(as_float(at + sign * step * unit))[0] for sign in (1, -1)] for unit in np.eye(3)]
    want = [(float(after) - float(before)) / (2 * step) for after, before in ends]
    for found in modes(as_float(at))[1:]:
        np.testing.assert_allclose(found, want, rtol=1e-6)


def test_march_works_under_every_transformation(x64):
    grid, rays, t_max, extinction, emission, behind = scene("mixed", seed=4)
    scales = as_float([0.5, 1.0, 2.0])

    def one(at, scale):
        return march(grid, extinction * scale * at[0], emission * at[1], rays, t_max, behind * at[2]).sum()

    at, fields = as_float(np.ones(3)), (extinction, emission, behind)
    slopes, sent = [], as_float(np.ones(behind.shape))
    for scale in np.asarray(scales):
        scaled = (as_float(scale * np.asarray(extinction)), emission, behind)
        _, _, pulled = in_both_modes("march", grid, rays, t_max, scaled, fields, sent)
        slopes.append([np.vdot(a, b) for a, b in zip(pulled, scaled, strict=True)])
    runs = {
        "vmap": (lambda at: jax.vmap(one, (None, 0))(at, scales).sum(), np.sum(slopes, axis=0)),
        "scan": (
            lambda at: jax.lax.scan(lambda c, s: (c + one(at, s), None), jnp.zeros(()), scales)[0],
            np.sum(slopes, axis=0),
        ),
        "checkpoint": (jax.checkpoint(lambda at: one(at, scales[0])), slopes[0]),
    }
    found = jax.jit(lambda at: [[mode(run)(at) for mode in (jax.grad, jax.jacfwd)] for run, _ in runs.values()])(at)
    for (_, want), both in zip(runs.values(), found, strict=True):
        for slope in both:
            np.testing.assert_allclose(slope, want, rtol=1e-10)

    def many(at):
        return march(grid, extinction * at[0], emission * at[1], rays, t_max, behind * at[2])[:4]

    np.testing.assert_allclose(*jax.jit(lambda at: [jax.jacfwd(many)(at), jax.jacrev(many)(at)])(at), rtol=1e-10)
    for argument in range(3):  # one differentiated operand at a time takes other paths through the rules

        def single(value, argument=argument, fields=fields):
            inputs = [*fields[:argument], value, *fields[argument + 1 :]]
            return march(grid, inputs[0], inputs[1], rays, t_max, inputs[2])

        @jax.jit
        def sums(tangent, single=single):
            _, pushed, (pulled,) = linearized(single, (tangent,), (tangent,), jnp.ones_like(behind))
            return jnp.vdot(pulled, tangent), pushed.sum()

        np.testing.assert_allclose(*sums(fields[argument]), rtol=1e-10)


def test_second_derivatives_of_the_march_are_those_of_the_list(x64):
    grid, rays, t_max, *fields = scene("thick", seed=5)

    def total(by, s):
        return by(grid, rays, t_max)(fields[0] * s[0], fields[1] * s[1], fields[2] * s[2]).sum()

    hessians = [jax.hessian(partial(total, by)) for by in (by_list, by_march)]
    listed, marched = jax.jit(lambda one: [hessian(one) for hessian in hessians])(jnp.ones(3))
    assert (np.abs(listed[0]) > 0).all()  # of the extinction with each; the others add
    np.testing.assert_allclose(marched, listed, rtol=1e-9)


def test_geometry_has_no_derivative(x64):
    grid, rays, t_max, *fields = scene("thin", seed=6)

    def total(rays, grid, t_max):
        return march(grid, fields[0], fields[1], rays, t_max, fields[2]).sum()

    for leaf in jax.tree.leaves(jax.grad(total, (0, 1, 2))(rays, grid, t_max)):
        assert not np.asarray(leaf).any()


def test_transmittance_and_its_gradient(precision):
    grid, rays, t_max, extinction, _, _ = scene("mixed", seed=7)
    extinction = as_float(np.minimum(extinction, 30.0))
    weight = as_float(np.random.default_rng(8).normal(size=(rays.count, NODES)))

    @jax.jit
    def both(extinction):
        lists = crossings(grid, rays, t_max)

        def depth(mu):
            return jnp.sum(mu.reshape(-1, NODES)[lists.cell] * lists.length[..., None], axis=1)

        def marched(mu):
            return transmittance(grid, mu, rays, t_max)

        ours, theirs = (
            linearized(function, (extinction,), (extinction,), weight)
            for function in (marched, lambda mu: jnp.exp(-depth(mu)))
        )
        bent = jax.hessian(lambda s: optical_depth(grid, s * extinction, rays, t_max).sum())(as_float(1.0))
        return ours, theirs, -depth(extinction) * ours[0], bent

    (got, along, (pulled,)), (expected, _, (wanted,)), slope, bent = jax.device_get(both(extinction))
    limit = 2e-5 if precision == "float32" else 1e-12
    np.testing.assert_allclose(got, expected, rtol=limit)
    np.testing.assert_allclose(pulled, wanted, atol=limit * np.abs(wanted).max())
    np.testing.assert_allclose(along, slope, atol=limit)
    assert float(bent) == 0


@pytest.mark.parametrize("depth", [0.0, 1e-38, 1e-30, 1e-8, 1e4, 1e30])
def test_no_nan_at_extreme_depths(depth, precision):
    grid, rays, t_max, extinction, _, behind = scene("thin", seed=9)
    extinction, double = (as_float(np.full(extinction.shape, times * depth)) for times in (1, 2))
    one = as_float(np.ones(behind.shape))
    for name in ROUTES:
        for emission in (extinction, double):
            given = (extinction, emission, behind), (extinction, extinction, behind)
            found = in_both_modes(name, grid, rays, t_max, *given, one)
            assert all(np.isfinite(x).all() for x in jax.tree.leaves(found))


def test_shapes_that_disagree_are_named():
    grid, rays, t_max, extinction, emission, behind = scene("thin", count=8)
    wrong = [
        ("extinction", lambda: march(grid, extinction[1:], emission, rays, t_max, behind)),
        ("emission", lambda: march(grid, extinction, emission[..., :1], rays, t_max, behind)),
        ("t_max", lambda: march(grid, extinction, emission, rays, t_max[1:], behind)),
        ("behind", lambda: march(grid, extinction, emission, rays, t_max, behind[1:])),
    ]
    for field, call in wrong:
        with pytest.raises(Exception, match=field):  # the type checker of the tests may be first to object
            call()


def test_no_rays_and_one_ray(precision):
    grid, rays, t_max, *fields = scene("thin", count=5)
    for count in (0, 1):
        few = Rays(rays.origin[:count], rays.direction[:count])
        got = march(grid, fields[0], fields[1], few, t_max[:count], fields[2][:count])
        assert got.shape == (count, NODES)
        assert transmittance(grid, fields[0], few, t_max[:count]).shape == (count, NODES)


# --- closed forms ---------------------------------------------------------------------------------------------------


def uniform(grid, mu, source):
    return tuple(as_float(np.full((*grid.shape, 1), value)) for value in (mu, mu * source))


@pytest.mark.parametrize("route", ROUTES)
@pytest.mark.parametrize(
    "mu, source, depth, want", [(10, 10, 2, (39.9999999, 52.9089653)), (0.01, 1e4, 0.5, (199.500832, 199.451457))]
)
def test_gray_box_intensity(route, mu, source, depth, want, precision):
    """O5: gray box 2 m wide, `depth` deep, 2 m high, under 0 and 30 degrees: I = integral of (1 - exp(-mu l)) B.

    Gauss-Legendre on the three parts of the silhouette, on each of which the path length is linear.
    """
    height = 2
    grid = Grid([-0.5 * depth, -1, 0], [depth / 8, 0.25, height], (8, 8, 1))
    nodes, weights = np.polynomial.legendre.leggauss(24)
    for angle, expected in zip((0.0, 30.0), want, strict=True):
        c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        half, tilt = c, 0.5 * depth * s
        edges = [-(half + tilt), -abs(half - tilt), abs(half - tilt), half + tilt]
        offset = np.concatenate([0.5 * (b - a) * nodes + 0.5 * (a + b) for a, b in zip(edges, edges[1:], strict=False)])
        area = np.concatenate([0.5 * (b - a) * weights for a, b in zip(edges, edges[1:], strict=False)]) * height
        start = offset[:, None] * [-s, c, 0] + np.array([c, s, 0]) * 5 + [0, 0, 0.5 * height]
        rays = parallel_rays(start, [-c, -s, 0])
        dark = as_float(np.zeros((rays.count, 1)))
        far = as_float(np.full(rays.count, np.inf))
        radiance = ROUTES[route](grid, rays, far)(*uniform(grid, mu, source), dark)
        intensity = np.asarray(radiance, float)[:, 0] @ area
        np.testing.assert_allclose(intensity, expected, rtol=2e-5 if precision == "float32" else 1e-6)


@pytest.mark.parametrize("tau, want", [(0.005, 0.00997088535), (0.5, 0.754285382012), (5.0, 1.37709098)])
def test_slab_with_linear_source(tau, want, x64):
    """O8: L = B0 (1 - e^-tau) + (B1 - B0) / tau (1 - (1 + tau) e^-tau); cells of the mean source converge as h^2."""
    errors = []
    grid = Grid([0, 0, 0], [1 / 400, 1, 1], (400, 1, 1))
    for cells in (200, 400):  # pairs of equal cells, then all of them different
        centre = np.repeat((np.arange(cells) + 0.5) / cells, 400 // cells)
        mu = as_float(np.full((400, 1, 1, 1), tau))
        j = as_float(tau * (1 + 2 * centre)[:, None, None, None])
        rays = parallel_rays([[-1, 0.5, 0.5]], [1, 0, 0])
        for route in ROUTES.values():
            got = route(grid, rays, as_float([np.inf]))(mu, j, as_float([[0.0]]))
            errors.append(abs(float(got[0, 0]) / want - 1))
    assert errors[0] < 2e-4 and errors[2] < 0.26 * errors[0] + 2e-9
    back = march(grid, mu, j, parallel_rays([[2, 0.5, 0.5]], [-1, 0, 0]), as_float([np.inf]), as_float([[0.0]]))
    assert float(back[0, 0]) > want * (1 + 1e-4)  # the hot end is now in front


@pytest.mark.parametrize("route", ROUTES)
def test_ramp_medium(route, precision):
    """O8b: mu = 0.1 x over 4 x 1 x .2 m, B = 100, 5 mm cells: broadside and end-on, exact for these cells."""
    cells = 800
    grid = Grid([0, 0, 0], [0.005, 1, 0.2], (cells, 1, 1))
    mu = as_float((0.1 * 0.005 * (np.arange(cells) + 0.5))[:, None, None, None])
    centre = 0.005 * (np.arange(cells) + 0.5)
    start = np.stack([centre, np.full(cells, 0.5), np.full(cells, 1.0)], axis=1)
    start = np.concatenate([start, [[-1, 0.5, 0.1], [5, 0.5, 0.1]]])
    direction = np.concatenate([np.tile([0, 0, -1], (cells, 1)), [[1, 0, 0], [-1, 0, 0]]])
    rays, dark = Rays(as_float(start), as_float(direction)), as_float(np.zeros((cells + 2, 1)))
    got = ROUTES[route](grid, rays, as_float(np.full(rays.count, np.inf)))(mu, 100 * mu, dark)
    value = np.asarray(got, float)[:, 0]
    limit = 1e-5 if precision == "float32" else 1e-9
    np.testing.assert_allclose(0.005 * value[:cells].sum(), 15.58173209, rtol=limit)
    np.testing.assert_allclose(0.2 * value[cells:], [11.01342072, 11.01342072], rtol=limit)


@pytest.mark.parametrize("t, want", [(0.1, 0.0642319679), (1.0, 0.471517764686), (10.0, 0.98000999)])
def test_isothermal_sphere(t, want, x64):
    """O6: mean emissivity over the disc of a gray sphere; staircase cells converge to it."""
    cells = 100
    grid = Grid([-1, -1, -1], [2 / cells] * 3, (cells,) * 3)
    inside = np.linalg.norm(np.asarray(grid.centres()), axis=-1) < 1
    mu = as_float(np.where(inside, 0.5 * t, 0.0)[..., None])
    rng = np.random.default_rng(0)
    radius, angle = np.sqrt((np.arange(4000) + 0.5) / 4000) * 1.05, np.arange(4000) * 2.399963229728653
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    first = np.cross(direction, [0, 0, 1.0])
    first /= np.linalg.norm(first)
    start = radius[:, None] * (np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * np.cross(direction, first))
    rays = parallel_rays(start - 2 * direction, direction)
    got = march(grid, mu, mu, rays, as_float(np.full(4000, np.inf)), as_float(np.zeros((4000, 1))))
    np.testing.assert_allclose(1.05**2 * float(got.mean()), want, rtol=6e-3)


@pytest.mark.parametrize("depth", [1e-8, 1e-4, 1e-2, 1.0, 30.0, 1e4])
def test_many_equal_cells_keep_single_precision(depth, precision):
    """800 cells in a row of equal optical depth against the closed form, with radiance behind."""
    grid = Grid([0, 0, 0], [0.25, 1, 1], (800, 1, 1))
    mu = as_float(np.full((800, 1, 1, 1), depth / 200))
    rays = parallel_rays([[-1, 0.5, 0.5]], [1, 0, 0])
    got = march(grid, mu, 3 * mu, rays, as_float([np.inf]), as_float([[0.5]]))
    exact = 3 * -np.expm1(-800 * 0.25 * float(mu[0, 0, 0, 0])) + 0.5 * np.exp(-200 * float(mu[0, 0, 0, 0]))
    np.testing.assert_allclose(got[0, 0], exact, rtol=1e-5 if precision == "float32" else 1e-12)


@pytest.mark.parametrize("backend", ["cpu", "gpu"])
def test_a_million_rays_add_to_one_number_in_single_precision(backend, monkeypatch):
    """Their cotangents, one after the other, lost .2 and .7 % of the gradients of one cell."""
    count, mu, j, reach = 1_000_000 + (backend == "gpu"), 0.7, 300.0, 1.0
    monkeypatch.setattr(jax, "default_backend", lambda: backend)
    rays = parallel_rays(np.tile([-1.0, 0.4, 0.6], (count, 1)), [1.0, 0.0, 0.0])
    grid = Grid((0.0, 0.0, 0.0), (reach, 1.0, 1.0), (1, 1, 1))

    def total(mu, j, rays):
        cells = [jnp.full((1, 1, 1, 1), x) for x in (mu, j)]
        dark = jnp.zeros((count, 1))
        weights = jnp.full((count, 1), 1.03)
        return jnp.sum(weights * march(grid, *cells, rays, jnp.full(count, jnp.inf), dark)) / count

    got = jax.jit(jax.grad(total, (0, 1)))(mu, j, rays)
    u = mu * reach
    mean, slope = -np.expm1(-u) / u, (np.exp(-u) * (1 + u) - 1) / u**2  # of exp(-u), and its derivative
    np.testing.assert_allclose(got, [1.03 * j * reach**2 * slope, 1.03 * reach * mean], rtol=2e-5)
