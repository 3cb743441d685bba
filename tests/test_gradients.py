"""Gradients of radiant intensity: forward = reverse = central difference, and finite where it is hard."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from tests.scenes import box_mesh, gray_box, plate

BANDS = (jaxir.MWIR, jaxir.LWIR)
PARAMETERS = {"emissivity": 0.7, "skin_temperature": 420.0, "absorption": 0.8, "plume_temperature": 1100.0}


def intensity(emissivity, skin_temperature, absorption, plume_temperature):
    """A box in front of, inside and behind a plume, lit by a sun through it."""
    scene = jaxir.Scene(
        skin=jaxir.Skin(box_mesh((0.5, 0.6, 0.4), (0.4, 0.1, 0.0)), skin_temperature, jaxir.Lambert(emissivity)),
        plumes=gray_box(
            (2.0, 1.0, 0.8), absorption * np.linspace(0.2, 1.0, 60).reshape(4, 3, 5, 1), temperature=plume_temperature
        ),
        sources=(jaxir.ParallelSource((-0.6, 0.0, -0.8), 20.0),),
        background=jaxir.BlackbodyBackground(250.0),
        atmosphere=jaxir.FixedPath(0.8, 0.1),
    )
    camera = jaxir.orthographic_camera(25.0, 15.0, 0.15, (16, 16))
    return jaxir.render(scene, camera, BANDS, samples=2).radiant_intensity()


def test_forward_reverse_and_difference_agree(x64):
    at = tuple(jnp.asarray(value) for value in PARAMETERS.values())
    compiled = jax.jit(intensity)
    forward, reverse = (jax.jit(mode(intensity, argnums=(0, 1, 2, 3)))(*at) for mode in (jax.jacfwd, jax.jacrev))
    for index, name in enumerate(PARAMETERS):
        step = 1e-3 * at[index]
        near, far = (
            compiled(*at[:index], at[index] + k * step, *at[index + 1 :])
            - compiled(*at[:index], at[index] - k * step, *at[index + 1 :])
            for k in (1, 2)
        )
        difference = (8 * near - far) / (12 * step)
        np.testing.assert_allclose(forward[index], reverse[index], rtol=1e-10, err_msg=name)
        np.testing.assert_allclose(forward[index], difference, rtol=1e-6, err_msg=name)
        assert (np.abs(forward[index]) > 0).all()


def test_gradient_of_every_face_and_cell_at_once(x64):
    camera = jaxir.orthographic_camera(25.0, 15.0, 0.15, (16, 16))
    base = jaxir.Scene(
        skin=jaxir.Skin(
            box_mesh((0.5, 0.6, 0.4)), np.linspace(300.0, 500.0, 12), jaxir.Lambert(np.linspace(0.2, 0.9, 12))
        ),
        plumes=gray_box((2.0, 1.0, 0.8), np.linspace(0.2, 1.0, 60).reshape(4, 3, 5, 1)),
    )

    def total(scene):
        return jaxir.render(scene, camera, jaxir.LWIR, samples=2).radiant_intensity()[0]

    value, static = eqx.partition(base, eqx.is_inexact_array)
    direction = jax.tree.map(lambda x: jnp.cos(jnp.arange(x.size, dtype=x.dtype)).reshape(x.shape), value)
    geometry = (direction.skin.mesh, direction.plumes[0].grid)
    direction = eqx.tree_at(
        lambda s: (s.skin.mesh, s.plumes[0].grid), direction, jax.tree.map(jnp.zeros_like, geometry)
    )
    function = jax.jit(lambda v: total(eqx.combine(v, static)))
    slope = jax.jvp(function, (value,), (direction,))[1]
    gradient = jax.grad(function)(value)
    pairs = zip(jax.tree.leaves(gradient), jax.tree.leaves(direction), strict=True)
    np.testing.assert_allclose(slope, sum(float(jnp.vdot(g, d)) for g, d in pairs), rtol=1e-9)


@pytest.mark.parametrize("mode", [jax.jacfwd, jax.jacrev])
def test_finite_at_every_hard_place(mode):
    slopes = jax.jit(mode(intensity, argnums=(0, 1, 2, 3)))
    for emissivity, absorption, temperature in itertools.product(
        (0.0, 1e-7, 1.0), (0.0, 1e-30, 1e-8, 1e4), (3.0, 6000.0)
    ):
        for got in slopes(emissivity, temperature, absorption, temperature):
            assert np.isfinite(got).all(), (emissivity, absorption, temperature)


@pytest.mark.parametrize("azimuth", [0.0, 89.9999, 90.0])
def test_finite_on_misses_edges_and_grazing_views(azimuth):
    def total(temperature):
        scene = jaxir.Scene(plate(temperature=temperature), sources=(jaxir.ParallelSource((0.0, -1.0, 0.0), 10.0),))
        camera = jaxir.orthographic_camera(azimuth, 0.0, 1.0 / 16, (16, 16))
        return jaxir.render(scene, camera, jaxir.LWIR, samples=2).radiant_intensity()[0]

    assert np.isfinite(jax.grad(total)(400.0))


def test_visibility_has_no_derivative(x64):
    def total(shift):
        mesh = box_mesh()
        moved = jaxir.Mesh(mesh.vertices + shift[None, :], np.asarray(mesh.faces))
        scene = jaxir.Scene(jaxir.Skin(moved, 400.0, jaxir.Lambert(1.0)))
        camera = jaxir.orthographic_camera(0.0, 0.0, 0.1, (4, 4), target=(0.0, 0.4, 0.0))
        return jaxir.render(scene, camera, jaxir.LWIR, samples=2).radiant_intensity()[0]

    np.testing.assert_array_equal(jax.grad(total)(jnp.zeros(3)), 0.0)
