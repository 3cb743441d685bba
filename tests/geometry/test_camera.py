"""Cameras: frames, screens, tiles, and the grain of float32 at long range."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir._arrays import as_float
from jaxir.geometry import TILE, fitted_camera, tile_points, view_frame


@pytest.mark.parametrize("azimuth", [0.0, 37.0, 180.0, -120.0])
@pytest.mark.parametrize("elevation", [0.0, 45.0, 90.0, -90.0])
def test_frames_are_right_handed_and_upright(azimuth, elevation, precision):
    frame = np.asarray(view_frame(azimuth, elevation), float)
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-6)
    np.testing.assert_allclose(np.cross(frame[0], frame[1]), frame[2], atol=1e-6)
    az, el = np.deg2rad([azimuth, elevation])
    np.testing.assert_allclose(frame[2], [np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)], atol=1e-6)
    assert frame[1, 2] >= -1e-6


@pytest.mark.parametrize("shape", [(16, 16), (20, 50), (1, 1), (33, 7)])
def test_tiles_cover_the_image_once(shape):
    camera = jaxir.orthographic_camera(0.0, 0.0, 1.0, shape)
    edges = jnp.asarray(camera.tile_edges())
    screen = tile_points(edges, jnp.full((len(edges), TILE * TILE, 2), 0.5))
    image = np.asarray(camera.untile(screen))
    rows, columns = shape
    np.testing.assert_allclose(image[..., 0], np.broadcast_to(np.arange(columns) + 0.5 - columns / 2, shape))
    np.testing.assert_allclose(image[..., 1], np.broadcast_to((rows / 2 - np.arange(rows) - 0.5)[:, None], shape))


def test_rays_of_a_pinhole_meet_at_the_eye(x64):
    camera = jaxir.perspective_camera(30.0, 20.0, 50.0, 1e-2, (16, 16), target=(1.0, 2.0, 3.0))

    @jax.jit
    def traced(camera):
        screen = tile_points(jnp.asarray(camera.tile_edges()), jnp.full((1, 256, 2), 0.5)).reshape(-1, 2)
        return screen, camera.bundle(screen, as_float(5.0)).rays()

    screen, rays = jax.device_get(traced(camera))
    target, towards = np.asarray(camera.target), np.asarray(camera.frame)[2]
    offset = target + 50.0 * towards - rays.origin
    np.testing.assert_allclose(np.cross(offset, np.asarray(rays.direction)), 0.0, atol=1e-10)
    np.testing.assert_allclose(np.linalg.norm(rays.direction, axis=1), 1.0, rtol=1e-12)
    # pixel at the target subtends the resolution, and the plane of start is 5 m in front of it
    np.testing.assert_allclose(np.diff(screen.reshape(16, 16, 2)[0, :, 0]), 0.5)
    np.testing.assert_allclose((rays.origin - target) @ towards, 5.0)


@pytest.mark.parametrize("distance", [5e3, 11547.0])
def test_the_grain_of_a_hit_is_a_hundredth_of_a_pixel(distance):
    """Float32 against float64 at .005 mrad, on a plate 10 m off the axis."""
    resolution = 5e-6
    points = {}
    for x64 in (False, True):
        with jax.enable_x64(x64):
            vertices = np.array([[-8.0, -12.0, -12.0], [-8.0, 12.0, -12.0], [8.0, 12.0, 12.0], [8.0, -12.0, 12.0]])
            mesh = jaxir.Mesh(vertices, np.array([[0, 1, 2], [0, 2, 3]]))
            camera = jaxir.perspective_camera(20.0, 30.0, distance, resolution, (400, 400))
            rng = np.random.default_rng(1)
            screen = as_float(rng.uniform(-10, 10, (512, 2)).astype(np.float32))
            from jaxir.geometry.search import closest_hit

            hit = closest_hit(mesh, camera.bundle(screen, as_float(20.0)))
            points[x64] = np.where(np.asarray(hit.face)[:, None] >= 0, np.asarray(hit.point, float), np.nan)
    both = np.isfinite(points[False]) & np.isfinite(points[True])
    assert both.mean() > 0.3
    assert np.abs(points[False] - points[True])[both].max() < 0.01 * resolution * distance


def test_solid_angle_weights_give_the_intensity_of_a_lambert_plane(x64):
    """A wide image of a uniform disc: pupil irradiance pi L sin^2, intensity E range^2."""
    distance, radius = 10.0, 20.0
    camera = jaxir.perspective_camera(0.0, 0.0, distance, 2 * radius / 2000 / distance, (2000, 2000))
    x = (np.arange(2000) + 0.5 - 1000) * float(camera.pixel[0])
    inside = x[:, None] ** 2 + x[None, :] ** 2 < radius**2
    got = float(np.sum(np.asarray(jax.jit(lambda camera: camera.pixel_area())(camera)) * inside))
    assert got == pytest.approx(np.pi * distance**2 * radius**2 / (distance**2 + radius**2), rel=1e-4)


@pytest.mark.parametrize("distance", [np.inf, 12.0])
def test_a_fitted_camera_just_holds_the_scene(distance, x64):
    rng = np.random.default_rng(2)
    extent = rng.uniform(-1, 1, (50, 3)) * [4.0, 2.0, 1.0] + [3.0, 0.0, 0.0]
    camera = jax.jit(fitted_camera, static_argnums=3)(40.0, 25.0, as_float(extent), (30, 60), distance)
    local = (extent - np.asarray(camera.target)) @ np.asarray(camera.frame).T
    seen = local[:, :2] / (1 - local[:, 2:] * float(camera.inverse_range))
    half = np.asarray(camera.pixel) * np.array([60, 30]) / 2
    share = np.abs(seen).max(axis=0) / half
    assert (share < 1).all() and (share > 0.99).all()
