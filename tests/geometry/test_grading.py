"""Rasters follow what shines, and expectations do not change."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir._arrays import as_float
from jaxir.geometry import Brightness, fitted_camera, graded_camera, view_frame
from tests.scenes import box_mesh

EXTENT = as_float(np.array([[0, y, z] for y in (-10, 10) for z in (-5, 5)]))


def _balls(centres: np.ndarray, radius: float, intensity: float) -> Brightness:
    middle = as_float(centres)
    one = jnp.ones_like(middle[:, 0])
    ends = jnp.repeat(middle[:, None], 2, axis=1)
    return Brightness(jnp.zeros((0, 3, 3), one.dtype), one[:0], ends, radius * one, intensity * one)


@pytest.mark.parametrize("distance", [np.inf, 30.0])
def test_half_of_the_columns_and_rows_go_to_a_bright_ball(distance):
    camera = graded_camera(0.0, 0.0, EXTENT, _balls(np.array([[0, 3, -2]]), 0.25, 7.0), (64, 128), distance)
    assert camera.grading is not None
    x, y = (np.asarray(edges[1:] + edges[:-1]) / 2 - 0.5 for edges in camera.grading)
    width, height = np.asarray(camera.pixel) * [128, 64]
    assert np.mean(np.abs(x * width - 3) < 0.25) == pytest.approx(0.5 + 0.5 * 0.5 / 20, abs=0.03)  # in bins of 4 cm
    assert np.mean(np.abs(y * height - 2) < 0.25) == pytest.approx(0.5 + 0.5 * 0.5 / 10, abs=0.03)  # rows run down
    even = fitted_camera(0.0, 0.0, EXTENT, (64, 128), distance)
    assert float(camera.pixel_area().sum()) == pytest.approx(float(even.pixel_area().sum()), rel=2e-3)


@pytest.mark.parametrize("distance", [np.inf, 300.0])
@pytest.mark.parametrize("aside", [0.0, 200.0])
def test_a_frame_holds_its_target_and_hardly_more(aside, distance):
    """What rays hardly meet beside it they do not tell: it would count as target."""
    extent = EXTENT + aside
    for azimuth, elevation in ((0.0, 0.0), (35.0, -70.0), (180.0, 60.0)):
        camera = fitted_camera(azimuth, elevation, extent, (8, 8), distance)
        filled = np.abs(np.asarray(camera.project(extent))).max(axis=0) / np.asarray(camera.half_size())
        assert (filled < 1).all() and (filled > 1 - 1e-4).all()


def test_nothing_bright_leaves_the_raster_even():
    camera = graded_camera(20.0, 10.0, EXTENT, _balls(np.array([[0, 3, -2]]), 0.25, 0.0), (5, 7))
    even = fitted_camera(20.0, 10.0, EXTENT, (5, 7))
    np.testing.assert_allclose(camera.pixel_area(), even.pixel_area(), rtol=1e-5)


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
    bright = Brightness(corners, jnp.ones(2, corners.dtype), nothing.ends, nothing.radius, nothing.intensity)
    camera = graded_camera(0.0, 0.0, as_float(square), bright, (16, 16))
    np.testing.assert_allclose(camera.frame, view_frame(0.0, 0.0), atol=1e-6)
    even = fitted_camera(0.0, 0.0, as_float(square), (16, 16))
    np.testing.assert_allclose(camera.pixel_area(), even.pixel_area(), rtol=0.02)


@pytest.mark.parametrize("gridded", [False, True])
def test_a_small_hot_jet_beside_a_large_body_takes_few_rays(gridded):
    """W/sr agrees with even rasters and errs four times less than one of as many rays."""
    plume = jaxir.JetPlume((-6.0, 0, 0), (-1.0, 0, 0), 0.3, 1800.0, 250.0, jaxir.GrayGas(0.5), length=20.0)
    if gridded:
        plume = plume.to_grid(jaxir.Grid((-12.0, -1.5, -1.5), (0.1, 0.1, 0.1), (60, 30, 30)))
    scene = jaxir.Scene(jaxir.Skin(box_mesh((12.0, 8.0, 0.5)), 260.0, jaxir.Lambert(0.2)), plume)
    nodes = jaxir.optics.spectrum.gray_nodes((jaxir.MWIR, jaxir.LWIR))
    shape = (24, 48)
    table = jaxir.signature(scene, [[70.0, 20.0]], nodes, shape=shape)

    eye, numbers = fitted_camera(70.0, 20.0, scene.extent(), shape), range(12)
    images = [jaxir.render(scene, eye, nodes, samples=2, key=jax.random.key(number)) for number in numbers]
    even = np.array([image.radiant_intensity() for image in images])
    errors = np.sqrt(np.mean([np.asarray(image.intensity_error()) ** 2 for image in images], axis=0))
    got, error = np.asarray(table.intensity)[0], np.asarray(table.standard_error)[0]
    assert (np.abs(got - even.mean(axis=0)) < 3.5 * np.hypot(error, errors / np.sqrt(len(images)))).all()
    assert errors[0] > 4 * error[0]
    assert (error < 0.02 * got).all()
