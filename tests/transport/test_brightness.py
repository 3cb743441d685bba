"""Where a scene shines, in few numbers: what decides how many rays must look before an error is believed."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir.transport import faces_in_sight, what_shines
from tests.scenes import box_mesh

CAMERA = jaxir.orthographic_camera(0, 0, 1.0, (32, 32))
MISSED = np.array([[0.01, 0.0]], np.float32)  # of an intensity


def squares(*parts):
    """Squares of (size, x, y, z), seen from the nose."""
    corner = np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]]) / 2
    points = [size * corner + np.array(place) for size, *place in parts]
    faces = [[4 * i, 4 * i + 1 + k, 4 * i + 2 + k] for i in range(len(parts)) for k in (0, 1)]
    return jaxir.Mesh(np.concatenate(points), np.array(faces))


def lit(mesh, temperature, **more):
    scene = jaxir.Scene(jaxir.Skin(mesh, np.repeat(temperature, 2), jaxir.Lambert(1.0)), **more)
    return scene.on(jaxir.gray_nodes(jaxir.MWIR))


COLD = (6.0, 0.0, 0.0, 0.0)
SCENES = {
    "alike": (squares(COLD), [300.0], {}, 36.0),
    "hot and small": (squares(COLD, (0.2, 0.1, 1.3, 0.7)), [200.0, 2500.0], {}, 0.04),
    "far apart": (squares((0.2, 0.0, -14.3, -13.7), (0.2, 0.0, 14.1, 14.4)), [900.0, 900.0], {}, 0.08),
    "like what is behind": (
        squares(COLD, (0.1, 0.1, 1.3, 0.7)),
        [300.0, 320.0],
        {"background": jaxir.BlackbodyBackground(300.0)},
        0.01,
    ),
    "beyond the frame": (squares((2.0, 0.0, 0.0, 0.0), (0.1, 0.0, 40.0, 0.0)), [300.0, 2500.0], {}, 4.0),
}


@pytest.mark.parametrize("name", SCENES)
def test_the_patch_is_what_shines(name):
    mesh, temperature, more, area = SCENES[name]
    found = what_shines(lit(mesh, temperature, **more), CAMERA, None, MISSED).patch
    np.testing.assert_allclose(found, area, rtol=0.03)


@pytest.mark.parametrize("bands", [(jaxir.MWIR,), (jaxir.SWIR, jaxir.LWIR)], ids=len)
def test_the_brightest_is_as_small_as_what_may_not_be_missed(bands):
    """Spots of .01 m2 and .16 m2 on a cold square, and nothing of what is evenly bright."""
    mesh, temperature = squares(COLD, (0.1, 0.1, 1.3, 0.7), (0.4, 0.1, -1.0, 0.3)), np.array([250.0, 2000.0, 600.0])
    own = jaxir.Scene(jaxir.Skin(mesh, np.repeat(temperature, 2), jaxir.Lambert(1.0))).on(jaxir.gray_nodes(bands))
    area, radiance = np.array([36.0, 0.01, 0.16]), np.asarray(own.blackbody)[::2].T
    share = radiance * area / (radiance @ area)[:, None] - area / area.sum()
    for allowed, expected in ((0.9 * share[:, 1], 0.01), (share[:, 1] + 0.9 * share[:, 2], 0.17)):
        for band, one in enumerate(allowed):
            found = what_shines(own, CAMERA, None, np.array([[one, 0.0], [1.0, 0.0]], np.float32)).brightest[band]
            np.testing.assert_allclose(found, expected, rtol=1e-3)
    total = np.asarray(own.blackbody)[::2].T @ area
    alike = what_shines(own, CAMERA, None, np.array([[0.0, 2 * total.max()]], np.float32)).brightest
    np.testing.assert_array_equal(alike, np.inf)


def test_what_is_hidden_does_not_shine():
    own = lit(squares(COLD, (0.1, -0.1, 1.3, 0.7)), [300.0, 2500.0])
    in_sight = faces_in_sight(own, CAMERA)
    np.testing.assert_array_equal(in_sight, [True, True, False, False])
    np.testing.assert_allclose(what_shines(own, CAMERA, in_sight, MISSED).patch, 36.0, rtol=1e-5)
    closed = lit(box_mesh(), np.full(6, 300.0))
    near = jaxir.perspective_camera(30.0, 20.0, 5.0, 1e-2, (64, 64))
    vector = np.asarray(closed.scene.skin.mesh.area_vectors())
    centre = np.asarray(closed.scene.skin.mesh.corners()).mean(axis=1)
    eye = np.asarray(near.target) + np.asarray(near.frame)[2] * 5.0
    np.testing.assert_array_equal(faces_in_sight(closed, near), ((eye - centre) * vector).sum(axis=1) > 0)


@pytest.mark.parametrize("count", [12, 60])
def test_one_hot_cell_is_as_large_as_it_is(count):
    """Also where cells are told in blocks."""
    grid = jaxir.Grid((-3.0, -3.0, -3.0), (6.0 / count,) * 3, (count,) * 3)
    scene = jaxir.Scene(plumes=jaxir.GridPlume(grid, jnp.full((count,) * 3, 250.0), jaxir.GrayGas(0.02)))
    cold = what_shines(scene.on(jaxir.gray_nodes(jaxir.MWIR)), CAMERA, None, MISSED).patch
    np.testing.assert_allclose(cold, 36.0, rtol=1e-4)
    hot = jnp.full((count,) * 3, 250.0).at[3, 4, 7].set(4000.0)
    scene = jaxir.Scene(plumes=jaxir.GridPlume(grid, hot, jaxir.GrayGas(0.02)))
    found = what_shines(scene.on(jaxir.gray_nodes(jaxir.SWIR)), CAMERA, None, MISSED).patch
    assert 0.5 < float(found[0]) / (6.0 / count) ** 2 < 2


@pytest.mark.optimised
@pytest.mark.parametrize("asked", [{"rtol": 0.1}, {"pixel_rtol": 0.2}], ids=str)
@pytest.mark.parametrize("name", ["hot and small", "far apart"])
def test_what_is_small_and_bright_is_not_missed(name, asked):
    mesh, temperature, more, _ = SCENES[name]
    scene = jaxir.Scene(jaxir.Skin(mesh, np.repeat(temperature, 2), jaxir.Lambert(1.0)), **more)
    emitted = np.asarray(jaxir.band_radiance(scene.skin.temperature, jaxir.gray_nodes(jaxir.MWIR)))[:, 0]
    area = np.linalg.norm(np.asarray(mesh.area_vectors()), axis=1)
    exact = float(emitted @ area) - (0.04 * float(emitted[0]) if name == "hot and small" else 0.0)
    for key in range(5):
        image = jaxir.render(scene, CAMERA, jaxir.MWIR, method=jaxir.Method(), key=jax.random.key(key), **asked)
        assert bool(image.outcome == jaxir.Outcome.tolerance_met)
        assert abs(float(image.radiant_intensity()[0]) / exact - 1) < 0.4


@pytest.mark.optimised
def test_a_small_part_of_what_is_sent_is_not_missed():
    """A square of 4 cm at 1200 K, free above a cold one, sends a twentieth of what is seen in pixels of 50 cm."""
    mesh, temperature = squares((12.0, 0.0, 0.0, 0.0), (0.04, 0.5, 1.3, 0.7)), [300.0, 1200.0]
    camera = jaxir.orthographic_camera(0, 0, 0.5, (26, 26))
    scene = jaxir.Scene(jaxir.Skin(mesh, np.repeat(temperature, 2), jaxir.Lambert(1.0)))
    emitted = np.asarray(jaxir.band_radiance(scene.skin.temperature, jaxir.gray_nodes(jaxir.MWIR)))[:, 0]
    area = np.linalg.norm(np.asarray(mesh.area_vectors()), axis=1)
    exact = float(emitted @ area) - 0.0016 * float(emitted[0])
    share = 0.0016 * float(emitted[2]) / exact
    assert 0.03 < share < 0.1
    for key in range(3):
        image = jaxir.render(scene, camera, jaxir.MWIR, method=jaxir.Method(), key=jax.random.key(key), rtol=0.01)
        assert abs(float(image.radiant_intensity()[0]) / exact - 1) < 0.025
    tight = jaxir.render(scene, camera, jaxir.MWIR, method=jaxir.Method(), rtol=0.01, max_samples=64)
    assert bool(tight.outcome == jaxir.Outcome.samples_spent)
