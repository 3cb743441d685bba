"""Several plumes in one scene: what each sends where they are apart, and the sum of coefficients where they overlap."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir.optics.spectrum import gray_nodes
from jaxir.scene.plume import pdf_direction, sample_direction

BANDS = (jaxir.MWIR, jaxir.LWIR)


def jet(y=0.0, axis=(-1.0, 0.0, 0.0), temperature=900.0, coefficient=0.6, panels=8):
    return jaxir.JetPlume(
        (0.0, y, 0.0), axis, 0.5, temperature, 250.0, jaxir.GrayGas(coefficient), length=8.0, panels=panels
    )


def rays_through(count, towards=(0.0, 0.0, -1.0), key=0):
    """Parallel rays spread over 5 x 4 m about the middle of the jets."""
    u = np.random.default_rng(key).uniform(size=(count, 2))
    w = np.asarray(towards) / np.linalg.norm(towards)
    side = np.linalg.svd(w[None])[2][1:]
    middle = np.array([-2.0, 0.0, 0.0])
    origin = middle - 8 * w + ((u[:, :1] - 0.5) * 5) * side[0] + ((u[:, 1:] - 0.5) * 4) * side[1]
    return jaxir.Rays(jnp.asarray(origin), jnp.asarray(np.broadcast_to(w, origin.shape)))


@eqx.filter_jit
def look(scene, rays):
    return jaxir.evaluate(scene.on(gray_nodes(BANDS)), jaxir.trace(scene, rays))


def test_jets_that_do_not_shade_each_other_add(x64):
    """Side by side and seen from above no ray meets both: W/sr are those of two single jets."""
    rays = rays_through(1500)
    apart = (jet(-1.0), jet(1.0, temperature=700.0))
    each = [np.asarray(look(jaxir.Scene(plumes=one), rays)) for one in apart]
    crossed = [np.any(values > 0, axis=1) for values in each]
    free = ~(crossed[0] & crossed[1])
    assert (free & crossed[0]).sum() > 100
    assert (free & crossed[1]).sum() > 100
    whole = np.asarray(look(jaxir.Scene(plumes=apart), rays))
    np.testing.assert_allclose(whole[free].sum(axis=0), (each[0] + each[1])[free].sum(axis=0), rtol=1e-5)


def test_crossing_jets_are_a_grid_of_both():
    """Absorption and emission add, to the error that cells make of each jet alone."""
    crossing = (jet(-1.2, (-1.0, 0.35, 0.0)), jet(1.2, (-1.0, -0.35, 0.1), temperature=700.0, coefficient=1.5))
    rays = rays_through(1500, (0.1, 0.2, -1.0))
    cells = 64
    grid = jaxir.Grid((-4.1, -3.0, -2.0), (4.2 / cells, 6.0 / cells, 4.0 / cells), (cells, cells, cells))

    twins = jax.jit(lambda jets: tuple(one.to_grid(grid) for one in jets))(crossing)

    def error(some):
        exact, gridded = (
            np.asarray(look(jaxir.Scene(plumes=plumes[some]), rays), float).sum(axis=0) for plumes in (crossing, twins)
        )
        return np.abs(gridded / exact - 1).max()

    alone = max(error(slice(0, 1)), error(slice(1, 2)))
    assert alone < 0.02
    assert error(slice(0, 2)) < 1.5 * alone


@pytest.mark.parametrize("precision", [pytest.param("float32", marks=pytest.mark.optimised), "float64"], indirect=True)
def test_overlapping_grids_add_cell_by_cell(precision):
    """Two grids with other cells, one within the other, against one fine grid that holds their sums, exactly."""
    temperature = 800.0
    coarse = jaxir.Grid((-2.0, -1.0, -1.0), (0.5, 1.0, 1.0), (8, 2, 2))
    fine = jaxir.Grid((-1.0, -0.5, -0.5), (0.25, 0.5, 0.5), (8, 2, 2))
    k = np.linspace(0.1, 1.0, 32).reshape(8, 2, 2, 1), np.linspace(2.0, 0.2, 32).reshape(8, 2, 2, 1)
    parts = tuple(jaxir.GridPlume(g, temperature, jaxir.GrayGas(x)) for g, x in zip((coarse, fine), k, strict=True))
    whole = jaxir.Grid((-2.0, -1.0, -1.0), (0.25, 0.5, 0.5), (16, 4, 4))
    total = np.repeat(np.repeat(np.repeat(k[0], 2, 0), 2, 1), 2, 2)
    total[4:12, 1:3, 1:3] += k[1]
    rays = rays_through(400, (0.7, 0.4, -0.6))
    got = look(jaxir.Scene(plumes=parts, background=jaxir.BlackbodyBackground(300.0)), rays)
    want = look(
        jaxir.Scene(
            plumes=jaxir.GridPlume(whole, temperature, jaxir.GrayGas(total)),
            background=jaxir.BlackbodyBackground(300.0),
        ),
        rays,
    )
    assert np.ptp(np.asarray(want)[:, 0]) > 1.0
    rtol = {"float32": 2e-5, "float64": 1e-9}[precision]
    np.testing.assert_allclose(got, want, rtol=rtol)


def test_a_ray_in_the_face_that_two_grids_share_is_in_one_of_them(x64):
    """Along the face and within it obliquely; of one grid of the same cells as long."""
    half = [jaxir.Grid((x, -0.5, -0.5), (0.5, 0.5, 0.5), (2, 2, 2)) for x in (-1.0, 0.0)]
    plumes = [jaxir.GridPlume(grid, 800.0, jaxir.GrayGas(0.5)) for grid in half]
    origin, toward = np.array([[0.0, 5.0, 0.25], [0.0, 5.0, 5.0]]), np.array([[0.0, -1.0, 0.0], [0.0, -1.0, -1.0]])
    rays = jaxir.Rays(jnp.asarray(origin), jnp.asarray(toward / np.linalg.norm(toward, axis=1, keepdims=True)))
    black = jaxir.band_radiance(jnp.asarray(800.0), gray_nodes(BANDS))
    want = -np.expm1(-0.5 * np.array([[1.0], [np.sqrt(2)]])) * np.asarray(black)
    for order in (plumes, plumes[::-1]):
        np.testing.assert_allclose(look(jaxir.Scene(plumes=tuple(order)), rays), want, rtol=1e-9)


def test_a_point_by_the_face_that_two_grids_share_scatters_once(x64):
    """And one beside both by rounding as the nearest cell."""

    def cloud(x, cells):
        grid = jaxir.Grid((x, -1.0, -1.0), (1.0, 2.0, 2.0), (cells, 1, 1))
        particles = jaxir.GrayParticles(2.0, [1.0], jaxir.Isotropic())
        return jaxir.GridPlume(grid, 1000.0, jaxir.GrayGas(0.1), particles)

    place = np.array([-1.0005, -0.5, -1e-4, 0.0, 1e-4, 0.5, 1.0005])
    point, ahead = jnp.asarray(np.stack([place, 0 * place, 0 * place], axis=1)), jnp.asarray(0 * place)

    @eqx.filter_jit
    def scattering(plumes):
        return jaxir.Scene(plumes=plumes).on(gray_nodes(BANDS)).medium.scattering(point, ahead)

    whole, halves = (scattering(plumes) for plumes in (cloud(-1.0, 2), (cloud(-1.0, 1), cloud(0.0, 1))))
    np.testing.assert_allclose(halves, whole)
    assert (np.asarray(whole) > 0).all()


def test_order_does_not_matter_and_one_half_twice_is_one(x64):
    rays = rays_through(1500, (0.3, 0.1, -1.0))
    pair = (jet(-0.3), jet(0.3, temperature=600.0))
    forth, back = (look(jaxir.Scene(plumes=p), rays) for p in (pair, pair[::-1]))
    np.testing.assert_allclose(forth, back, rtol=1e-12)
    halves = look(jaxir.Scene(plumes=(jet(coefficient=0.3), jet(coefficient=0.3))), rays)
    np.testing.assert_allclose(halves, look(jaxir.Scene(plumes=jet(coefficient=0.6)), rays), rtol=2e-5, atol=1e-9)


def test_gradients_reach_each_plume(x64):
    """Forward = reverse = central differences, in the exit temperature and the depth of each of two crossing jets."""
    rays = rays_through(64, (0.1, 0.2, -1.0))

    def total(values):
        jets = tuple(
            jet(y, (-1.0, -0.4 * np.sign(y), 0.0), *own, panels=2) for y, own in zip((-1.0, 1.0), values, strict=True)
        )
        return look(jaxir.Scene(plumes=jets), rays)[:, 0].sum()

    at = np.array([[900.0, 0.6], [700.0, 1.5]])
    all_at_once = jax.jit(lambda at: (jax.jacfwd(total)(at), *jax.value_and_grad(total)(at)))  # compiles faster
    forward, _, reverse = map(np.asarray, all_at_once(jnp.asarray(at)))
    np.testing.assert_allclose(forward, reverse, rtol=1e-8)
    for place in np.ndindex(2, 2):
        step = np.zeros((2, 2))
        step[place] = 1e-4 * at[place]
        after, before = (float(all_at_once(jnp.asarray(at + sign * step))[1]) for sign in (1, -1))
        np.testing.assert_allclose(forward[place], (after - before) / (2 * step[place]), rtol=1e-5)
        assert abs(float(forward[place])) > 0


@jax.jit
def of_two_grids(k):
    """What two plumes with these coefficients send in sum over rays, and its slopes by both modes."""
    grid = jaxir.Grid((-2.0, -1.0, -1.0), (0.5, 1.0, 1.0), (8, 2, 2))
    rays = rays_through(32, (0.7, 0.4, -0.6))

    def total(k):
        first, second = (jaxir.GridPlume(grid, 800.0, jaxir.GrayGas(x)) for x in k)
        return look(jaxir.Scene(plumes=(first, second)), rays).sum()

    value, reverse = jax.value_and_grad(total)(k)
    return value, jax.jacfwd(total)(k), reverse


@pytest.mark.parametrize("coefficient", [0.0, 1e-30, 1e-9, 1e7])
def test_gradients_are_finite_where_a_plume_is_clear_or_opaque(coefficient):
    """In both modes; what a layer selects away has no finite derivative."""
    for k in ([coefficient, 0.5], [coefficient, coefficient]):
        total, forward, reverse = map(np.asarray, of_two_grids(jnp.asarray(k)))
        assert np.all(np.isfinite(forward))
        size = np.array([max(x, 1e-3) for x in k])
        np.testing.assert_allclose(forward * size, reverse * size, rtol=1e-4, atol=1e-5 * float(total))


def test_particles_of_several_plumes_scatter_together():
    """A furnace of two overlapping plumes with particles, and the density of the directions drawn in both."""
    warm = 400.0
    clouds = tuple(
        jaxir.GridPlume(
            jaxir.Grid((x, -0.5, -0.5), (0.5, 0.5, 0.5), (2, 2, 2)),
            warm,
            jaxir.GrayGas(0.2),
            jaxir.GrayParticles(1.0, 0.5, jaxir.HenyeyGreenstein(g)),
        )
        for x, g in ((-0.7, 0.6), (-0.3, -0.4))
    )
    scene = jaxir.Scene(plumes=clouds, background=jaxir.BlackbodyBackground(warm))
    rays = rays_through(4000, (0.2, 0.1, -1.0))
    nodes = gray_nodes((jaxir.LWIR,))

    @eqx.filter_jit
    def followed(scene, rays, key):
        return jaxir.evaluate(scene.on(nodes), jaxir.trace(scene, rays, jaxir.Method(orders=12), key))

    got = np.asarray(followed(scene, rays, jax.random.key(1)), float)[:, 0]
    black = float(jaxir.band_radiance(jnp.asarray(warm), nodes)[0])
    error = got.std() / np.sqrt(got.size)
    assert error < 0.004 * black
    assert abs(got.mean() - black) < 4 * error + 1e-4 * black

    count = 200_000
    fine = (np.arange(2000) + 0.5) / 1000 - 1

    @jax.jit
    def scattered(plume, key, fine):
        point, along = jnp.zeros((count, 3)), jnp.broadcast_to(jnp.asarray([1.0, 0.0, 0.0]), (count, 3))
        omega = sample_direction(plume, jax.random.uniform(key, (count, 2)), point, along)
        return omega[:, 0], pdf_direction(plume, fine, jnp.zeros((2000, 3)))

    cosine, pdf = map(np.asarray, scattered(scene.plume, jax.random.key(2), jnp.asarray(fine)))
    seen, _ = np.histogram(cosine, np.linspace(-1, 1, 21))
    expected = 2 * np.pi * pdf.astype(float).reshape(20, 100).mean(axis=1) * 0.1 * count
    assert expected.sum() == pytest.approx(count, rel=1e-3)
    assert (((seen - expected) ** 2 / expected).sum()) < 45  # chi-squared of 19 degrees of freedom: 1 in 1000
