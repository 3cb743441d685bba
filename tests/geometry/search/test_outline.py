"""What boxes around a body tell before any ray is traced."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir.geometry import Grading, fitted_camera, pixel_samples, tile_points
from jaxir.geometry.search import WIDTH, closest_hit, front_of, may_see, outline
from tests.geometry.search.bodies import sphere, torus
from tests.scenes import box_mesh


def stretched_torus():
    vertices, faces = torus()
    return jaxir.Mesh(vertices * np.array([3.0, 1.0, 0.5]) + np.array([0.5, 0.2, 0.1]), faces)


@pytest.mark.parametrize("distance", [np.inf, 30.0])
def test_rays_start_before_the_boxes_of_the_search_at_every_aspect(distance):
    mesh = stretched_torus()
    scene = jaxir.Scene(jaxir.Skin(mesh, 300.0, jaxir.Lambert(0.8)))

    @jax.jit
    def measures(aspect):
        camera = fitted_camera(aspect[0], aspect[1], mesh.vertices, (16, 16), distance)
        front = front_of(mesh.outline(WIDTH), camera.frame[2], camera.target)
        return camera.target, camera.frame[2], scene.start(camera), front

    for azimuth, elevation in np.random.default_rng(3).uniform([0, -90], [360, 90], (40, 2)):
        target, towards, start, front = map(np.asarray, measures(np.array([azimuth, elevation], np.float32)))
        height = (np.asarray(mesh.vertices) - target) @ towards
        assert height.max() < front < start < distance


def test_an_eye_among_the_boxes_but_outside_the_sphere_of_the_vertices_still_has_all_before_it():
    vertices, faces = sphere(1)  # 80 faces: boxes reach beyond the sphere
    scene = jaxir.Scene(jaxir.Skin(jaxir.Mesh(vertices, faces), 300.0, jaxir.Lambert(0.8)))
    reach = np.linalg.norm(vertices, axis=1).max()

    @jax.jit
    def looked():
        camera = fitted_camera(45.0, 35.26, jnp.asarray(vertices), (16, 16), 1.005 * reach)
        camera = eqx.tree_at(lambda c: c.target, camera, jnp.zeros(3))
        front = front_of(scene.outline(WIDTH), camera.frame[2], jnp.zeros(3))
        away = eqx.tree_at(lambda c: c.pixel, camera, camera.pixel * 10)  # a box at the eye may be seen anywhere
        return scene.start(camera), front, may_see(scene.outline(), away, jnp.asarray(away.tile_edges()))

    start, front, seen = map(np.asarray, looked())
    assert reach < start < 1.005 * reach < front
    assert seen.all()


@pytest.mark.parametrize("distance", [np.inf, 12.0])
@pytest.mark.parametrize("graded", [False, True])
def test_rays_of_tiles_that_see_nothing_meet_nothing(distance, graded):
    mesh = stretched_torus()
    edges = [np.linspace(0, 1, n + 1) ** 1.5 for n in (128, 96)]

    @jax.jit
    def looked(distance, key):
        camera = fitted_camera(40.0, 50.0, mesh.vertices, (96, 128), distance)
        camera = eqx.tree_at(lambda c: (c.target, c.pixel), camera, (camera.target + 0.4, camera.pixel * 1.6))
        if graded:
            grading = Grading(*map(jnp.float32, edges))
            camera = eqx.tree_at(lambda c: c.grading, camera, grading, is_leaf=lambda x: x is None)
        tiles = jnp.asarray(camera.tile_edges())
        offset = pixel_samples(key, len(tiles), 8).reshape(8, len(tiles), -1, 2)
        screen = jax.vmap(lambda o: tile_points(tiles, o))(offset)
        bundle = camera.bundle(screen.reshape(-1, 2), jnp.asarray(8.0))
        return may_see(mesh.outline(4096), camera, tiles), bundle

    some, bundle = looked(np.float32(distance), jax.random.key(0))
    some, hit = np.asarray(some), np.asarray(closest_hit(mesh, bundle).face) >= 0
    met = hit.reshape(8, len(some), -1).any(axis=(0, 2))
    assert not (met & ~some).any()
    assert met.sum() > 0.4 * some.sum() and 8 < some.sum() < 0.8 * len(some)


def test_an_outline_holds_its_boxes_and_no_others():
    rng = np.random.default_rng(0)
    low = rng.uniform(-1, 1, (21, 3)).astype(np.float32)
    high = low + rng.uniform(0, 1, (21, 3)).astype(np.float32)
    corners = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), -1).reshape(-1, 3)
    points = np.where(corners[None], high[:, None], low[:, None]).reshape(-1, 3)
    front = jax.jit(lambda low, high, toward: front_of(outline(low, high), toward, jnp.full(3, 0.5)))
    for direction in rng.normal(size=(10, 3)):
        toward = (direction / np.linalg.norm(direction)).astype(np.float32)
        assert float(front(low, high, toward)) == pytest.approx(((points - 0.5) @ toward).max(), abs=1e-5)


def test_before_a_uniform_background_tiles_without_the_scene_show_it_exactly():
    background = jaxir.UniformBackground(3.0)
    scene = jaxir.Scene(jaxir.Skin(box_mesh((2.0, 1.0, 0.5)), 300.0, jaxir.Lambert(0.8)), background=background)
    image = jaxir.render(scene, jaxir.orthographic_camera(30.0, 20.0, 0.25, (80, 80)), jaxir.MWIR, samples=2)
    radiance, error = np.asarray(image.radiance), np.asarray(image.standard_error)
    assert (radiance[:16, :16] == 3).all() and (error[:16, :16] == 0).all()
    assert radiance[32:48, 32:48].std() > 0
