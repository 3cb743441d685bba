"""Radiance by component: it adds up, and every part is what it is called."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir.geometry import Rays
from jaxir.medium import MediumSum
from jaxir.transport import Components, components_of, evaluate_components, with_own_media
from tests.scenes import box_mesh, gray_box

NODES = jaxir.gray_nodes((jaxir.MWIR,))
SUN, LAMP = jaxir.ParallelSource((0.0, 0.0, -1.0), 10.0), jaxir.PointSource((3.0, 3.0, 3.0), 500.0)
SKY = jaxir.ElevationTable([-90, 0, 0, 90], [30.0, 30.0, 10.0, 2.0])
SKIN = jaxir.Skin(box_mesh(), 500.0, jaxir.Lambert(0.6), np.arange(12) // 6, ("sides", "ends"))
CLOUD = jaxir.GridPlume(
    jaxir.Grid((-3.0, -0.5, -0.5), (0.5, 0.5, 0.5), (4, 2, 2)),
    800.0,
    jaxir.GrayGas(0.4),
    jaxir.GrayParticles(0.3, 0.8, jaxir.Isotropic()),
)


def rays(count=64):
    """Rays from two places towards points in a box about the scene, of which some meet nothing."""
    u = np.random.default_rng(1).uniform(-1, 1, (count, 3))
    origin = np.where(u[:, :1] > 0, np.array([[1.0, 8.0, 3.0]]), np.array([[-6.0, -6.0, -6.0]]))
    direction = u * np.array([3.0, 1.0, 1.0]) - np.array([1.0, 0.0, 0.0]) - origin
    return Rays(jnp.asarray(origin), jnp.asarray(direction / np.linalg.norm(direction, axis=1, keepdims=True)))


def test_components_add_up_on_the_same_paths(x64):
    nodes = jaxir.gray_nodes((jaxir.MWIR,))
    air = jaxir.FixedPath(0.7, 2.0)
    scene = jaxir.Scene(SKIN, CLOUD, (SUN, LAMP, jaxir.UniformBackground(1.0)), SKY, air)
    scene = jax.tree.map(lambda leaf: leaf.astype(float) if leaf.dtype == jnp.float32 else leaf, scene)
    method = jaxir.Method(direct=None, orders=0, ambient=1.0).resolved(scene)
    split = components_of(scene, method, "parts")
    assert split.names == (
        *("skin, sides", "skin, ends", "ParallelSource", "PointSource", "surroundings", "plume"),
        *("ambient", "background", "air"),
    )

    @jax.jit
    def both(scene):
        lit, paths = scene.on(nodes), jaxir.trace(scene, rays(), method, jax.random.key(1))
        return jaxir.evaluate(lit, paths), evaluate_components(lit, paths, split), paths.face

    whole, parts, face = both(scene)
    np.testing.assert_allclose(parts.sum(axis=1), whole, rtol=1e-13)
    assert np.all(parts >= 0)
    lit = np.asarray(parts).max(axis=(0, 2)) > 0
    assert [name for name, shines in zip(split.names, lit, strict=True) if not shines] == ["surroundings"]  # by method
    held = dict(zip(split.names, np.moveaxis(np.asarray(parts)[..., 0], 1, 0), strict=True))
    free = np.asarray(face) < 0
    assert free.any() and not free.all()
    assert np.all(held["background"][~free] == 0) and np.all(held["background"][free] > 0)
    np.testing.assert_allclose(held["air"], 2.0)


def test_an_image_tells_components_and_their_contrast():
    """A Lambert plate of 1 m2 seen from in front: every part by hand."""
    vertices = np.array([[0.0, -0.5, -0.5], [0.0, 0.5, -0.5], [0.0, 0.5, 0.5], [0.0, -0.5, 0.5]])
    mesh = jaxir.Mesh(vertices, np.array([[0, 1, 2], [0, 2, 3]]))
    sun = jaxir.ParallelSource((-1.0, 0.0, 0.0), 10.0)
    skin = jaxir.Skin(mesh, 400.0, jaxir.Lambert(0.6), [0, 1], ("a", "b"))
    scene = jaxir.Scene(skin, (), sun, jaxir.UniformBackground(3.0), jaxir.FixedPath(0.5, 0.25))
    camera = jaxir.orthographic_camera(0.0, 0.0, 0.125, (16, 16))
    method = jaxir.Method(direct=jaxir.ClosedForm())
    image = jaxir.render(scene, camera, jaxir.MWIR, samples=8, method=method, components="parts")
    assert image.components == ("skin, a", "skin, b", "ParallelSource", "surroundings", "background", "air")
    black = float(jaxir.band_radiance(jnp.asarray(400.0), NODES)[0])
    want = 0.5 * np.array([0.6 * black, 0.4 * 10 / np.pi, 0.4 * 3.0, -3.0, 0.0])
    first, second, *others = image.component_intensity()[:, 0].tolist()
    np.testing.assert_allclose([first + second, *others], want, rtol=2e-5, atol=1e-6)
    assert first == pytest.approx(second, rel=0.1)
    np.testing.assert_allclose(image.component_intensity().sum(axis=0), image.radiant_intensity(), rtol=1e-5)
    np.testing.assert_allclose(image.parts.sum(axis=2), image.radiance, rtol=1e-6)
    np.testing.assert_allclose(image.parts[0, 0, :, 0], [0, 0, 0, 0, 1.5, 0.25], rtol=1e-6)  # where there is no plate

    def inside(kelvin):  # jit, which does not know which parts have faces
        made = jaxir.Scene(jaxir.Skin(mesh, kelvin, jaxir.Lambert(0.6), [0, 1], ("a", "b")), (), sun)
        return jaxir.render(made, camera, jaxir.MWIR, samples=2, method=method, components="parts")

    emitted = jax.jit(lambda kelvin: inside(kelvin).component_intensity())(500.0)[:2, 0]
    np.testing.assert_allclose(emitted.sum(), 0.6 * float(jaxir.band_radiance(500.0, NODES)[0]), rtol=2e-5)
    with pytest.raises(ValueError, match="Image.parts: got none, expected render"):
        dataclasses.replace(image, parts=None).component_intensity()


def test_every_plume_has_a_factor_of_its_own():
    one, other = (gray_box((1.0, 1.0, 1.0), k).medium(NODES) for k in (0.5, 2.0))
    point = jnp.zeros((1, 3))
    dark = MediumSum((one, other)).brightened((jnp.float32(0.0), jnp.float32(1.0)))
    extinction, emission = dark.coefficients(point)
    np.testing.assert_allclose(extinction, 2.5)
    np.testing.assert_allclose(emission, other.coefficients(point)[1])


def test_names_tell_one_of_a_kind_from_several():
    lights = (SUN, LAMP, SUN)
    plumes = (gray_box((1.0, 1.0, 1.0), 0.5), gray_box((1.0, 1.0, 1.0), 0.5))
    split = components_of(jaxir.Scene(SKIN, plumes, lights), jaxir.Method(), "sources")
    assert isinstance(split, Components)
    assert split.names == ("skin", "ParallelSource 0", "PointSource", "ParallelSource 1", "plume 0", "plume 1")
    np.testing.assert_array_equal(
        np.asarray(split.sources), np.eye(3)[[0, 0, 1, 2, 0, 0]] * [[0], [1], [1], [1], [0], [0]]
    )
    assert components_of(jaxir.Scene(SKIN), jaxir.Method(), None) is None


def test_light_that_was_solved_for_is_split_too():
    """Each component has a solution of its own, and they add up to that of all light together."""
    scene = jaxir.Scene(None, CLOUD, (SUN,), jaxir.UniformBackground(2.0))
    method = jaxir.Method(scattering=jaxir.DiscreteOrdinates(4, 4, 1))
    split = components_of(scene, method, "sources")
    assert split.names == ("ParallelSource", "surroundings", "plume", "background")
    first = jnp.zeros((3, 1)).at[0].set(1)  # all light in the first, none in the others: the same programs
    together = dataclasses.replace(split, sources=jnp.broadcast_to(first, (3, 2)), plumes=first)

    @jax.jit
    def seen(scene, split):
        paths = jaxir.trace(scene, rays(), method, None)
        return evaluate_components(scene.on(NODES), paths, split)

    whole, parts = (seen(scene, with_own_media(scene, NODES, method, each)) for each in (together, split))
    np.testing.assert_allclose(parts.sum(axis=1), whole.sum(axis=1), rtol=2e-4)
    assert np.all(np.asarray(parts)[np.argmax(whole[:, 0])] > 0) and np.all(whole[:, 1:3] == 0)


def test_kinds_that_are_none_are_refused():
    with pytest.raises(ValueError, match="components: got 'all', expected sources or parts, or None"):
        components_of(jaxir.Scene(SKIN, CLOUD), jaxir.Method(), "all")
