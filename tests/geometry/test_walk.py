import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxir._arrays import as_float
from jaxir.geometry import Grid, Rays, crossing_bound, crossings
from tests.reference import reference_crossings

SHAPES = [(7, 5, 6), (1, 9, 2), (40, 3, 3)]


def unit(direction):
    direction = np.asarray(direction, float)
    return direction / np.linalg.norm(direction)


def random_rays(grid, count, seed):
    """Half of the rays start inside, all point roughly at the grid."""
    rng = np.random.default_rng(seed)
    size = np.asarray(grid.shape) * np.asarray(grid.spacing, float)
    low = np.asarray(grid.origin, float)
    start = low + size * (0.5 + rng.normal(size=(count, 3)) * np.where(rng.random((count, 1)) < 0.5, 0.2, 1.5))
    direction = low + size * rng.random((count, 3)) - start
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    t_max = np.where(rng.random(count) < 0.5, np.inf, rng.random(count) * np.linalg.norm(size))
    return Rays(as_float(start), as_float(direction)), as_float(t_max)


def spread(crossings, cells):
    """Length per cell [ray, cell], which forgets the order."""
    cell, length = np.asarray(crossings.cell), np.asarray(crossings.length, float)
    table = np.zeros((cell.shape[0], cells))
    for ray in range(cell.shape[0]):
        np.add.at(table[ray], cell[ray], length[ray])
    return table


@pytest.mark.parametrize("shape", SHAPES)
def test_random_rays_cross_the_cells_of_the_plane_sorting_reference(shape, precision):
    grid = Grid([-0.3, 0.2, 0.1], [0.1, 0.2, 0.15], shape)
    rays, t_max = random_rays(grid, 200, seed=1)
    got = crossings(grid, rays, t_max)
    cells = int(np.prod(shape))
    want = np.zeros((200, cells))
    given = (np.asarray(x, float) for x in (rays.origin, rays.direction, t_max))
    for row, (start, direction, end) in zip(want, zip(*given, strict=True), strict=True):
        cell, length = reference_crossings(grid.origin, grid.spacing, shape, start, direction, end)
        np.add.at(row, cell, length)
    tolerance = 3e-5 if precision == "float32" else 1e-12
    np.testing.assert_allclose(spread(got, cells), want, atol=tolerance)
    assert got.bound == crossing_bound(shape)
    assert int(got.longest()) <= sum(shape) - 2
    assert got.cell.dtype == jnp.int32


def test_lists_run_near_to_far_and_padding_is_empty(precision):
    grid = Grid([0, 0, 0], [1, 1, 1], (5, 4, 6))
    rays, t_max = random_rays(grid, 100, seed=2)
    got = crossings(grid, rays, t_max)
    index = np.stack(np.unravel_index(np.asarray(got.cell), grid.shape), axis=-1)
    along, length = np.sign(np.asarray(rays.direction)), np.asarray(got.length)
    for ray in range(100):
        used = length[ray] > 0
        assert not used[int(used.sum()) :].any()
        steps = np.diff(index[ray][used], axis=0) * along[ray]
        assert (steps >= 0).all() and (steps.sum(axis=1) >= 1).all()


AXIS_CASES = {
    "along x": ((-1, 0.5, 0.5), (1, 0, 0), {0: 1, 20: 1, 40: 1}),
    "against z": ((1.5, 1.5, 7), (0, 0, -1), {29: 1, 28: 1, 27: 1, 26: 1, 25: 1}),
    "inside an inner face": ((-1, 1, 0.5), (1, 0, 0), {5: 1, 25: 1, 45: 1}),
    "along an inner edge": ((-1, 1, 1), (1, 0, 0), {6: 1, 26: 1, 46: 1}),
    "inside the low outer face": ((-1, 0, 0.5), (1, 0, 0), {0: 1, 20: 1, 40: 1}),
    "inside the high outer face": ((-1, 4, 0.5), (1, 0, 0), {}),
    "through corners": ((-1, -1, -1), (1, 1, 1), {0: 3**0.5, 26: 3**0.5, 52: 3**0.5}),
    "through corners, back": ((4, 4, 4), (-1, -1, -1), {52: 3**0.5, 26: 3**0.5, 0: 3**0.5}),
    "starts inside": ((0.5, 0.5, 0.25), (0, 0, 1), {0: 0.75, 1: 1, 2: 1, 3: 1, 4: 1}),
    "starts on a face": ((0.5, 0.5, 2), (0, 0, 1), {2: 1, 3: 1, 4: 1}),
    "starts on a face, back": ((0.5, 0.5, 2), (0, 0, -1), {1: 1, 0: 1}),
    "starts on the rim and leaves": ((3, 0.5, 0.5), (1, 0, 0), {}),
    "misses": ((10, 10, 10), (1, 0, 0), {}),
    "points away": ((-1, 0.5, 0.5), (-1, 0, 0), {}),
    "no direction": ((0.5, 0.5, 0.5), (0, 0, 0), {}),
    "a drift too small to matter": ((-1, 0.5, 0.5), (1, 1e-35, -1e-44), {0: 1, 20: 1, 40: 1}),
}


@pytest.mark.parametrize("case", AXIS_CASES)
def test_rays_along_axes_faces_edges_and_corners(case, precision):
    start, direction, want = AXIS_CASES[case]
    if any(direction):
        direction = unit(direction)
    grid = Grid([0, 0, 0], [1, 1, 1], (3, 4, 5))
    got = crossings(grid, Rays(as_float([start]), as_float([direction])), as_float([np.inf]))
    count, cell, length = int(got.longest()), np.asarray(got.cell)[0], np.asarray(got.length)[0]
    assert cell[:count].tolist() == list(want)
    np.testing.assert_allclose(length[:count], list(want.values()), rtol=1e-6)
    assert not length[count:].any()


@pytest.mark.parametrize("t_max, want", [(0.0, []), (-1.0, []), (1.25, [0.25]), (2.5, [1, 0.5]), (9, [1, 1, 1])])
def test_a_ray_ends_at_t_max(t_max, want, precision):
    grid = Grid([0, 0, 0], [1, 1, 1], (3, 4, 5))
    got = crossings(grid, Rays(as_float([[-1, 0.5, 0.5]]), as_float([[1, 0, 0]])), as_float([t_max]))
    np.testing.assert_allclose(np.asarray(got.length)[0, :3], want + [0] * (3 - len(want)), rtol=1e-6)


def test_near_diagonal_rays_keep_their_cells_in_single_precision():
    """A drift of almost one cell per slab beside the cell edges must not change the index by two."""
    grid = Grid([0, 0, 0], [1, 1, 1], (64, 64, 64))
    with jax.enable_x64(False):
        offsets = np.linspace(-4e-7, 4e-7, 41, dtype=np.float32)
        start = np.stack([np.full(41, -1), offsets - 1, np.full(41, 3.3)], axis=1)
        direction = np.stack([np.ones(41), np.ones(41) - 1e-7, np.zeros(41)], axis=1) / 2**0.5
        got = crossings(grid, Rays(as_float(start), as_float(direction)), as_float(np.full(41, np.inf)))
    x, y, z = np.unravel_index(np.asarray(got.cell), grid.shape)
    used = np.asarray(got.length) > 1e-3
    assert (np.abs(x - y)[used] <= 1).all() and (z[used] == 3).all()
    length = np.asarray(got.length)
    np.testing.assert_allclose(length.sum(axis=1), 64 * 2**0.5, rtol=1e-5)
    for ray in range(41):  # a long stretch lies either on the diagonal or beside it, never in both at one x
        stretches = used[ray] & (length[ray] > 0.5)
        assert len(np.unique(x[ray][stretches])) == stretches.sum()


def test_flat_cells_far_coordinates_and_no_rays(precision):
    grid = Grid([100, -50, 20], [1e-3, 1, 1], (10, 2, 2))
    rays = Rays(as_float([[100.0 + 4.5e-3, -60, 20.5], [99, -49.5, 20.5]]), as_float([[0, 1, 0], [1, 0, 0]]))
    got = crossings(grid, rays, as_float([np.inf, np.inf]))
    length = np.asarray(got.length).sum(axis=1)
    np.testing.assert_allclose(length, [2, 1e-2], rtol=1e-2 if precision == "float32" else 1e-9)
    none = crossings(grid, Rays(as_float(np.zeros((0, 3))), as_float(np.zeros((0, 3)))), as_float(np.zeros(0)))
    assert none.cell.shape == (0, crossing_bound(grid.shape)) and int(none.longest()) == 0
