import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir._arrays import as_float
from jaxir.geometry import Rays
from jaxir.medium import medium_optics
from jaxir.medium._jet_layers import KNOTS
from jaxir.optics.spectrum import gray_nodes
from jaxir.scene.plume import _resolve
from tests.scenes import box_mesh

NOZZLE, AXIS, DIAMETER = np.array([0.3, -0.1, 0.2]), np.array([-2.0, 0.3, 0.1]), 0.5
GAS = 0.6


def jet(panels=4, gas=GAS, length=12.0, **changed):
    given = dict(nozzle=NOZZLE, axis=AXIS, diameter=DIAMETER, exit_temperature=1400.0, ambient_temperature=270.0)
    return jaxir.JetPlume(**{**given, **changed}, gas=jaxir.GrayGas(gas), length=length, panels=panels)


def nodes():
    return gray_nodes((jaxir.MWIR, jaxir.LWIR))


@jax.jit
def radiance(medium, rays, t_max, behind):
    return medium.radiance(rays, t_max, behind)


def rays_through(angles, count, seed=0, distance=12.0):
    """Rays at angles with the jet's axis through random points of the jet: origins and directions in double."""
    rng = np.random.default_rng(seed)
    w = AXIS / np.linalg.norm(AXIS)
    u = np.cross(w, [0.0, 0.0, 1.0])
    u /= np.linalg.norm(u)
    v = np.cross(w, u)
    origins, directions = [], []
    for angle in np.deg2rad(angles):
        z = rng.uniform(0, 6.0, count)
        r, turn = (0.25 + 0.22 * z) * np.sqrt(rng.random(count)), rng.uniform(0, 2 * np.pi, count)
        point = NOZZLE + z[:, None] * w + r[:, None] * (np.cos(turn)[:, None] * u + np.sin(turn)[:, None] * v)
        direction = np.cos(angle) * w + np.sin(angle) * u
        origins.append(point - distance * direction)
        directions.append(np.broadcast_to(direction, point.shape))
    return np.concatenate(origins), np.concatenate(directions)


def dense_sum(medium, origin, direction, t_max, behind, steps=20000, reach=24.0):
    """The same integral by brute force: many equal steps through the jet's state, nothing known of its shape."""
    edges = np.linspace(0, min(t_max, reach), steps + 1)
    t = as_float((edges[1:] + edges[:-1]) / 2)
    fraction = medium.shape.at(as_float(origin)[None, :] + t[:, None] * as_float(direction)[None, :])
    knots = np.linspace(0, 1, medium.extinction.shape[0])
    mu, j = (
        np.stack([np.interp(fraction, knots, np.asarray(table)[:, n]) for n in range(table.shape[1])], axis=1)
        for table in (medium.extinction, medium.emission)
    )
    u = mu * np.diff(edges)[:, None]
    through = np.exp(-np.cumsum(np.concatenate([np.zeros((1, u.shape[1])), u]), axis=0))
    mean = np.where(u > 0, -np.expm1(-u) / np.where(u > 0, u, 1), 1)
    return (through[:-1] * mean * j * np.diff(edges)[:, None]).sum(axis=0) + through[-1] * np.asarray(behind)


def test_quadrature_equals_brute_force_on_every_kind_of_ray(x64):
    origin, direction = rays_through([0.0, 2.0, 30.0, 90.0, 140.0, 180.0], 3)
    w = AXIS / np.linalg.norm(AXIS)
    on_axis = np.array([NOZZLE - 3 * w, NOZZLE + 8 * w, NOZZLE + 1.0 * w, NOZZLE + [0.0, 0.0, 9.0]])
    along_axis = np.array([w, -w, w, w])  # the last one misses
    origin, direction = np.concatenate([origin, on_axis]), np.concatenate([direction, along_axis])
    t_max = np.where(np.arange(len(origin)) % 3 == 1, 11.5, np.inf)
    behind = as_float(np.random.default_rng(1).uniform(0, 300, (len(origin), 2)))
    medium = jet(panels=16).medium(nodes())
    got = radiance(medium, Rays(as_float(origin), as_float(direction)), as_float(t_max), behind)
    rays = zip(origin, direction, t_max, np.asarray(behind), strict=True)
    want = np.array([dense_sum(medium, *ray) for ray in rays])
    scale = np.max(want, axis=0)
    np.testing.assert_allclose(np.asarray(got) / scale, want / scale, atol=6e-4)
    np.testing.assert_array_equal(got[-1], behind[-1])


def test_single_precision_agrees_with_double():
    origin, direction = rays_through([0.0, 5.0, 60.0, 90.0, 175.0], 160)  # as many as of a twin
    found = []
    for enabled in (False, True):
        with jax.enable_x64(enabled):
            t_max = as_float(np.full(len(origin), np.inf))
            rays = Rays(as_float(origin), as_float(direction))
            found.append(np.asarray(radiance(jet().medium(nodes()), rays, t_max, as_float(np.zeros((len(origin), 2))))))
    np.testing.assert_allclose(found[0], found[1], atol=2e-5 * found[1].max())


def test_gridded_twin_converges_to_the_jet():
    origin, direction = rays_through([90.0, 35.0], 400, seed=2)
    rays, t_max = Rays(as_float(origin), as_float(direction)), as_float(np.full(800, np.inf))
    behind = as_float(np.zeros((800, 2)))
    short = jet(length=6.0)
    want = np.asarray(radiance(short.medium(nodes()), rays, t_max, behind))
    corners = np.asarray(jax.jit(lambda jet: jet.extent())(short))
    errors = []
    for cells in (20, 80):
        shape = (cells, cells // 2, cells // 2)
        spacing = (corners.max(axis=0) - corners.min(axis=0)) / shape
        grid = jaxir.Grid(corners.min(axis=0), spacing, shape)
        twin = jax.jit(lambda jet, grid=grid: jet.to_grid(grid))(short)
        got = np.asarray(radiance(twin.medium(nodes()), rays, t_max, behind))
        errors.append(np.sqrt(((got - want) ** 2).mean() / (want**2).mean()))
    assert errors[1] < 0.04
    assert errors[1] < 0.4 * errors[0]


def test_a_resolved_jet_keeps_its_tolerance(gas=0.5):
    origin, direction = rays_through([1.0, 8.0, 50.0, 90.0, 150.0, 178.0], 150, seed=3)
    count = len(origin)
    rays, t_max = Rays(as_float(origin), as_float(direction)), as_float(np.full(count, np.inf))
    dark = as_float(np.zeros((count, 2)))
    truth = np.asarray(radiance(jet(64, gas).medium(nodes()), rays, t_max, dark)).reshape(6, -1, 2)
    panels = []
    for tolerance in (1e-2, 1e-3):
        resolved = jaxir.resolve_jet(jet(1, gas), (jaxir.MWIR, jaxir.LWIR), tolerance)
        got = np.asarray(radiance(resolved.medium(nodes()), rays, t_max, dark)).reshape(6, -1, 2)
        assert (np.abs(got - truth) / truth.max(axis=1, keepdims=True)).max() < 1.5 * tolerance
        panels.append(resolved.panels)
    assert panels[0] < panels[1] <= 32


def test_a_tolerance_out_of_reach_is_an_error(monkeypatch):
    monkeypatch.setattr(_resolve, "MOST_PANELS", 1)
    with pytest.raises(ValueError, match="tolerance: got 1e-09, expected one that 1 panels reach"):
        jaxir.resolve_jet(jet(1, GAS), (jaxir.MWIR, jaxir.LWIR), 1e-9)


def test_a_jet_as_warm_as_its_surroundings_is_invisible():
    warm = jet(exit_temperature=300.0, ambient_temperature=300.0)
    scene = jaxir.Scene(plumes=warm, background=jaxir.BlackbodyBackground(300.0))
    camera = jaxir.orthographic_camera(60.0, 10.0, 0.4, (16, 16), target=(-2.0, 0.2, 0.2))
    image = jaxir.render(scene, camera, jaxir.LWIR, samples=2)
    np.testing.assert_allclose(image.radiance, float(image.empty.max()), rtol=1e-5)


def total(place, scales, lengths):
    """Radiance summed over rays, some of which end on a skin; every parameter of the jet moves."""
    plume = jaxir.JetPlume(
        NOZZLE + place[0], AXIS + place[1], 0.5 * scales[0], 1400.0 * scales[1], 270.0 * scales[2],
        jaxir.GrayGas(GAS * scales[3]), core_length=5 * lengths[0], spreading=0.22 * lengths[1],
        length=12 * lengths[2], panels=2,
    )  # fmt: skip
    origin, direction = rays_through([1.0, 25.0, 65.0, 178.0], 30)
    t_max = as_float(np.where(np.arange(len(origin)) % 3 == 1, 12.2, np.inf))
    rays = Rays(as_float(origin), as_float(direction))
    behind = as_float(np.full((len(origin), 1), 40.0))
    return plume.medium(gray_nodes((jaxir.MWIR,))).radiance(rays, t_max, behind).sum()


def test_forward_reverse_and_difference_agree_in_every_parameter(x64):
    at = (np.zeros((2, 3)), np.ones(4), np.ones(3))
    onward, back = jax.jacfwd(total, (0, 1, 2)), jax.value_and_grad(total, (0, 1, 2))
    all_at_once = jax.jit(lambda *at: (onward(*at), *back(*at)))  # one program compiles faster
    forward, _, reverse = jax.device_get(all_at_once(*map(as_float, at)))
    for index in range(3):
        np.testing.assert_allclose(forward[index], reverse[index], rtol=1e-9, atol=1e-9)
        for place in np.ndindex(at[index].shape):
            step, ends = 1e-7, []
            for sign in (1, -1):
                moved = [x.copy() for x in at]
                moved[index][place] += sign * step
                ends.append(float(all_at_once(*map(as_float, moved))[1]))
            difference = (ends[0] - ends[1]) / (2 * step)
            np.testing.assert_allclose(forward[index][place], difference, rtol=1e-5, err_msg=f"{index} {place}")


def test_where_a_ray_is_cut_moves_without_jumps(x64):
    """Many rays and one panel: the derivative of their sum is its slope only if no ray's quadrature jumps."""
    rng, count = np.random.default_rng(0), 2000
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    middle = np.stack([rng.uniform(0.2, 9, count), *(0.3 * rng.normal(size=(2, count)))], axis=1)
    rays = Rays(jnp.asarray(middle - 20 * direction), jnp.asarray(direction))

    @jax.jit
    def both(core):
        def total(core):
            along_x = jet(1, length=20.0, nozzle=np.zeros(3), axis=np.array([1.0, 0.0, 0.0]), core_length=core)
            return (
                along_x.medium(gray_nodes((jaxir.MWIR,)))
                .radiance(rays, jnp.full(count, jnp.inf), jnp.zeros((count, 1)))
                .sum()
            )

        return jax.jvp(total, (core,), (1.0,))

    difference = (both(6.001)[0] - both(5.999)[0]) / 0.002
    np.testing.assert_allclose(difference, both(6.0)[1], rtol=1e-3)


def test_values_and_gradients_are_finite_at_every_hard_place():
    w = AXIS / np.linalg.norm(AXIS)
    side = np.cross(w, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(w, [0.0, 0.0, 1.0]))
    steep = np.arctan(0.22)
    cone = np.cos(steep) * w + np.sin(steep) * side
    origin = np.array(
        [NOZZLE, NOZZLE - w, NOZZLE + w, NOZZLE - 3 * side, NOZZLE + 0.25 * side, NOZZLE - 3 * side + 2.5 * w]
    )
    direction = np.array([w, w, -w, side, cone, side])
    rays = Rays(as_float(origin), as_float(direction))
    t_max = as_float([np.inf, np.inf, 0.0, np.inf, 3.0, np.inf])

    @jax.jit
    @jax.value_and_grad
    def slopes(jet):
        medium = jet.medium(gray_nodes((jaxir.MWIR,)))
        return medium.radiance(rays, t_max, jnp.ones_like(rays.origin[:, :1])).sum()

    for gas in (0.0, 1e-30, 1e-3, 1e5):
        for leaf in jax.tree.leaves(slopes(jet(panels=1, gas=gas))):
            assert np.isfinite(leaf).all(), gas


def test_a_jet_in_a_scene_hides_and_is_hidden_like_its_twin():
    plume = jet(panels=8, length=6.0)
    corners = np.asarray(jax.jit(lambda jet: jet.extent())(plume))
    shape = (72, 36, 36)
    grid = jaxir.Grid(corners.min(axis=0), (corners.max(axis=0) - corners.min(axis=0)) / shape, shape)
    twin = jax.jit(lambda plume: plume.to_grid(grid))(plume)
    skin = jaxir.Skin(box_mesh((0.5, 0.6, 0.4), (-1.2, 0.1, 0.3)), 900.0, jaxir.Lambert(0.9))
    views = [[65.0, 20.0], [180.0, 0.0]]
    first, second = (
        jaxir.signature(jaxir.Scene(skin, p), views, jaxir.MWIR, shape=(32, 32)).intensity for p in (plume, twin)
    )
    np.testing.assert_allclose(first, second, rtol=0.03)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: jet(diameter=[1.0, 2.0]), r"JetPlume.diameter: got shape \(2,\), expected \(\)"),
        (lambda: jet(panels=0), "JetPlume.panels: got 0"),
        (lambda: jaxir.resolve_jet(jet(axis=(0.0, 0.0, 0.0)), jaxir.MWIR), "JetPlume.axis: squared length: got 0.0"),
        (lambda: jaxir.resolve_jet(jet(exit_temperature=-1.0), jaxir.MWIR), "JetPlume.exit_temperature: got -1.0"),
        (lambda: jaxir.resolve_jet(jet(), jaxir.MWIR, 0.0), "tolerance: got 0.0"),
        (lambda: jet(gas=np.ones((2, 1))).medium(nodes()), r"GrayGas.coefficient: got shape \(2, 1\)"),
    ],
)
def test_the_error_names_field_got_and_expected(build, message):
    with pytest.raises(ValueError, match=message):
        build()


@pytest.mark.parametrize("hot", [900.0, 2500.0])
def test_tables_of_a_jet_hold_its_optics(hot, x64):
    """Read along straight lines at four places between knots, against optics computed there."""
    gas = jaxir.NarrowBandGas(26_500.0, 0.1, 0.08)
    plume = jaxir.JetPlume(NOZZLE, AXIS, DIAMETER, hot, 218.0, gas)
    bins = jaxir.resolved_nodes((jaxir.SWIR, jaxir.MWIR, jaxir.LWIR), 400.0, 1, 0)
    fraction = np.linspace(0, 1, 4 * KNOTS + 1)

    @jax.jit
    def both(plume, fraction):
        return plume.medium(bins), medium_optics(plume.mixture(fraction), None, bins, plume.temperature(fraction))

    medium, exact = both(plume, as_float(fraction))
    for table, want, bound in ((medium.extinction, exact.extinction, 5e-5), (medium.emission, exact.emission, 3e-5)):
        table, want = np.asarray(table, np.float64), np.asarray(want, np.float64)
        knots = np.linspace(0, 1, table.shape[0])
        read = np.stack([np.interp(fraction, knots, column) for column in table.T], axis=1)
        assert (table >= 0).all()
        assert (np.abs(read - want) / want.max(axis=0)).max() < bound
