"""The path integral against closed forms of homogeneous spheres, linear sources and the ramp medium."""

import numpy as np
import pytest

import jaxir
from jaxir._arrays import as_float
from jaxir.geometry import Rays
from jaxir.medium import march

TOLERANCE = {"float32": 1e-5, "float64": 1e-6}


def _along_x(count, start=-1.0):
    origin = np.tile([[start, 0.05, 0.05]], (count, 1))
    return Rays(as_float(origin), as_float(np.tile([[1.0, 0.0, 0.0]], (count, 1))))


@pytest.mark.parametrize("thickness", [0.01, 0.1, 1.0, 10.0])
def test_mean_emissivity_of_a_gray_sphere(thickness, precision):
    """Chords of a sphere in a homogeneous box: eps = 1 - 2/t^2 (1 - (1 + t) e^-t), t = 2 kappa R."""
    exact = {0.01: 0.00664173319, 0.1: 0.0642319679, 1.0: 0.471517764686, 10.0: 0.98000999}
    place, weight = np.polynomial.legendre.leggauss(24)
    cosine = (place + 1) / 2  # chord = 2 R cos, disc area element 2 cos dcos
    grid = jaxir.Grid((0.0, 0.0, 0.0), (0.21, 0.1, 0.1), (5, 1, 1))
    field = as_float(np.full((5, 1, 1, 1), thickness))
    rays = _along_x(24)
    got = march(grid, field, field, rays, as_float(1.0 + cosine), as_float(np.zeros((24, 1))))[:, 0]
    mean = float(np.sum(np.asarray(got, float) * weight * cosine))
    assert mean == pytest.approx(exact[thickness], rel=TOLERANCE[precision])


@pytest.mark.parametrize(("depth", "exact"), [(0.005, 0.00997088535), (0.5, 0.754285382012), (5.0, 1.37709098)])
@pytest.mark.parametrize("turned", [False, True])
def test_a_source_that_rises_along_the_path(depth, exact, turned, precision):
    """B from 1 (near) to 3 (far), and its mirror image, whose radiance differs: order of layers matters."""
    cells = 4000
    near_to_far = 1 + 2 * (np.arange(cells) + 0.5) / cells
    source = near_to_far[::-1] if turned else near_to_far
    grid = jaxir.Grid((0.0, 0.0, 0.0), (1 / cells, 0.1, 0.1), (cells, 1, 1))
    kappa = np.full((cells, 1, 1, 1), depth)
    got = march(
        grid,
        as_float(kappa),
        as_float(kappa * source[:, None, None, None]),
        _along_x(1),
        as_float([np.inf]),
        as_float([[0.0]]),
    )
    if turned:  # B = 3 near, 1 far
        full = -np.expm1(-depth)
        exact = 3 * full - 2 / depth * (1 - (1 + depth) * np.exp(-depth))
    assert float(got[0, 0]) == pytest.approx(exact, rel=TOLERANCE[precision])


def test_the_ramp_medium_broadside_and_end_on(precision):
    """kappa = .1 x, B = 100, 4 x 1 x .2 m in 800 cells along x [W/sr per metre of height; W/sr]."""
    cells = 800
    grid = jaxir.Grid((0.0, 0.0, 0.0), (4 / cells, 0.1, 0.1), (cells, 1, 2))
    kappa = np.broadcast_to(0.1 * (np.arange(cells) + 0.5)[:, None, None, None] * 4 / cells, (cells, 1, 2, 1))
    extinction, emission = as_float(kappa), as_float(100 * kappa)
    x = (np.arange(cells) + 0.5) * 4 / cells
    down = Rays(
        as_float(np.stack([x, np.full(cells, 0.05), np.full(cells, 1.0)], 1)),
        as_float(np.tile([[0.0, 0.0, -1.0]], (cells, 1))),
    )
    none = as_float(np.zeros((cells, 1)))
    broadside = march(grid, extinction, emission, down, as_float(np.full(cells, np.inf)), none)
    assert float(np.sum(np.asarray(broadside, float))) * 4 / cells == pytest.approx(
        15.58173209, rel=TOLERANCE[precision]
    )
    end_on = march(grid, extinction, emission, _along_x(1), as_float([np.inf]), as_float([[0.0]]))
    assert float(end_on[0, 0]) * 0.2 == pytest.approx(11.01342072, rel=TOLERANCE[precision])
