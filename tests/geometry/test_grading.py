"""Rasters follow what shines, and expectations do not change."""

import jax
import numpy as np
import pytest

import jaxir
from jaxir._arrays import as_float
from jaxir.geometry import Brightness, fitted_camera, graded, rolled_camera, view_frame
from tests.scenes import box_mesh

EXTENT = as_float(np.array([[0, y, z] for y in (-10, 10) for z in (-5, 5)]))


def _balls(centres: np.ndarray, radius: float, intensity: float) -> Brightness:
    one = np.ones(len(centres))
    given = np.zeros((0, 3, 3)), one[:0], np.repeat(centres[:, None], 2, axis=1), radius * one, intensity * one
    return Brightness(*map(as_float, given))


rolled, fitted = jax.jit(rolled_camera), jax.jit(fitted_camera, static_argnums=3)  # one program each


def graded_camera(azimuth, elevation, extent, brightness, shape, distance=np.inf):
    one = jax.tree.map(lambda leaf: leaf[None], rolled(azimuth, elevation, extent, brightness, distance))
    return jax.tree.map(lambda leaf: leaf[0], graded(*one, shape))


def _area(camera):
    return np.asarray(jax.jit(lambda camera: camera.pixel_area())(camera))


@pytest.mark.parametrize("distance", [np.inf, 30.0])
def test_half_of_the_columns_and_rows_go_to_bright_balls(distance):
    """Of two side by side, which leave the image upright."""
    balls = _balls(np.array([[0, 2.75, -2], [0, 3.25, -2]]), 0.25, 7.0)
    camera = graded_camera(0.0, 0.0, EXTENT, balls, (64, 128), distance)
    assert camera.grading is not None
    x, y = (np.convolve(edges, [0.5, 0.5], "valid") - 0.5 for edges in camera.grading)
    width, height = np.asarray(camera.pixel) * [128, 64]
    assert np.mean(np.abs(x * width - 3) < 0.5) == pytest.approx(0.5 + 0.5 * 1.0 / 20, abs=0.03)  # in bins of 4 cm
    assert np.mean(np.abs(y * height - 2) < 0.25) == pytest.approx(0.5 + 0.5 * 0.5 / 10, abs=0.03)  # rows run down
    even = fitted(0.0, 0.0, EXTENT, (64, 128), distance)
    assert _area(camera).sum() == pytest.approx(_area(even).sum(), rel=2e-3)


def test_a_small_ball_aside_leaves_the_image_upright():
    """What it is spread is small beside the square of its way from the middle."""
    camera = graded_camera(0.0, 0.0, EXTENT, _balls(np.array([[0, 3, -2]]), 0.25, 7.0), (64, 128), np.inf)
    np.testing.assert_allclose(camera.frame, fitted(0.0, 0.0, EXTENT, (64, 128), np.inf).frame, atol=1e-6)


@pytest.mark.parametrize("distance", [np.inf, 300.0])
@pytest.mark.parametrize("aside", [0.0, 200.0])
def test_a_frame_holds_its_target_and_hardly_more(aside, distance):
    """What rays hardly meet beside it they do not tell: it would count as target."""
    extent = as_float(np.asarray(EXTENT) + aside)

    @jax.jit
    def measured(azimuth, elevation):
        camera = fitted_camera(azimuth, elevation, extent, (8, 8), distance)
        return camera.project(extent), camera.half_size()

    for azimuth, elevation in ((0.0, 0.0), (35.0, -70.0), (180.0, 60.0)):
        seen, half = map(np.asarray, measured(azimuth, elevation))
        filled = np.abs(seen).max(axis=0) / half
        assert (filled < 1).all() and (filled > 1 - 1e-4).all()


def test_nothing_bright_leaves_the_raster_even():
    camera = graded_camera(20.0, 10.0, EXTENT, _balls(np.array([[0, 3, -2]]), 0.25, 0.0), (5, 7))
    even = fitted(20.0, 10.0, EXTENT, (5, 7))
    np.testing.assert_allclose(_area(camera), _area(even), rtol=1e-5)


def test_the_image_is_rolled_along_a_bright_bar():
    along = np.array([0, 2, 1]) / np.sqrt(5)
    bar = _balls(np.linspace(-8, 8, 21)[:, None] * along, 0.1, 1.0)
    camera = graded_camera(0.0, 0.0, EXTENT, bar, (16, 64))
    frame = np.asarray(camera.frame)
    assert abs(frame[0] @ along) == pytest.approx(1, abs=1e-5)
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-6)
    assert np.linalg.det(frame) == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("height", [4.0, 1.3])
def test_an_upright_plate_of_two_triangles_stays_upright(height):
    """Their middles lie on a diagonal, what they cover does not."""
    square = np.array([[0, -2, -1], [0, 2, -1], [0, 2, 1], [0, -2, 1]]) * [1, 1, height / 2]
    corners = as_float(square[np.array([[0, 1, 2], [0, 2, 3]])])
    nothing = _balls(np.zeros((1, 3)), 0.1, 0.0)
    bright = Brightness(corners, as_float(np.ones(2)), nothing.ends, nothing.radius, nothing.intensity)
    camera = graded_camera(0.0, 0.0, as_float(square), bright, (16, 16))
    np.testing.assert_allclose(camera.frame, view_frame(0.0, 0.0), atol=1e-6)
    even = fitted(0.0, 0.0, as_float(square), (16, 16))
    np.testing.assert_allclose(_area(camera), _area(even), rtol=0.02)


@pytest.mark.parametrize("gridded", [False, True])
def test_a_small_hot_jet_beside_a_large_body_takes_few_rays(gridded):
    """W/sr agrees with even rasters and errs four times less than one of as many rays."""
    plume = jaxir.JetPlume((-6.0, 0, 0), (-1.0, 0, 0), 0.3, 1800.0, 250.0, jaxir.GrayGas(0.5), length=20.0)
    if gridded:
        grid = jaxir.Grid((-12.0, -1.5, -1.5), (0.1, 0.1, 0.1), (60, 30, 30))
        plume = jax.jit(lambda plume: plume.to_grid(grid))(plume)
    scene = jaxir.Scene(jaxir.Skin(box_mesh((12.0, 8.0, 0.5)), 260.0, jaxir.Lambert(0.2)), plume)
    nodes = jaxir.optics.spectrum.gray_nodes((jaxir.MWIR, jaxir.LWIR))
    shape = (24, 48)
    table = jaxir.signature(scene, [[70.0, 20.0]], nodes, shape=shape)

    eye, numbers = fitted(70.0, 20.0, scene.extent(), shape), range(12)
    images = [jaxir.render(scene, eye, nodes, samples=2, key=jax.random.key(number)) for number in numbers]
    even = np.array([image.radiant_intensity() for image in images])
    errors = np.sqrt(np.mean([np.asarray(image.intensity_error()) ** 2 for image in images], axis=0))
    got, error = np.asarray(table.intensity)[0], np.asarray(table.standard_error)[0]
    assert (np.abs(got - even.mean(axis=0)) < 3.5 * np.hypot(error, errors / np.sqrt(len(images)))).all()
    assert errors[0] > 4 * error[0]
    assert (error < 0.02 * got).all()
