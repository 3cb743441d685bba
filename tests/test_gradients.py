"""Gradients of radiant intensity: forward = reverse = central difference, and finite where it is hard."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from tests.scenes import box_mesh, gray_box, plate

BANDS = (jaxir.MWIR, jaxir.LWIR)
PARAMETERS = {"emissivity": 0.7, "skin_temperature": 420.0, "absorption": 0.8, "plume_temperature": 1100.0}
FACES, CELLS = 12, (4, 3, 5)
RAMP = np.linspace(0.2, 1.0, 60).reshape(*CELLS, 1)


def intensity(emissivity, skin_temperature, absorption, plume_temperature):
    """A box in front of, inside and behind a plume, lit by a sun through it, by values of each face and cell."""
    scene = jaxir.Scene(
        skin=jaxir.Skin(box_mesh((0.5, 0.6, 0.4), (0.4, 0.1, 0.0)), skin_temperature, jaxir.Lambert(emissivity)),
        plumes=gray_box((2.0, 1.0, 0.8), absorption, temperature=plume_temperature),
        sources=(jaxir.ParallelSource((-0.6, 0.0, -0.8), 20.0),),
        background=jaxir.BlackbodyBackground(250.0),
        atmosphere=jaxir.FixedPath(0.8, 0.1),
    )
    camera = jaxir.orthographic_camera(25.0, 15.0, 0.15, (16, 16))
    return jaxir.render(scene, camera, BANDS, samples=2).radiant_intensity()


def everywhere(emissivity, skin_temperature, absorption, plume_temperature):
    """One number for all faces, or for all cells, whose absorption rises from cell to cell."""
    faces, cells = jnp.ones(FACES), jnp.ones(CELLS)
    return emissivity * faces, skin_temperature * faces, absorption * jnp.asarray(RAMP), plume_temperature * cells


@jax.jit
def slopes(at, direction, weight):
    """Intensity, its derivative in a direction [band], and those of its weighted sum: forward, and that transposed."""
    value, forward = jax.linearize(intensity, *at)
    return value, forward(*direction), jax.linear_transpose(forward, *at)(weight)


def test_forward_reverse_and_difference_agree(x64):
    value = np.asarray(list(PARAMETERS.values()))
    for index, name in enumerate(PARAMETERS):
        unit = everywhere(*np.eye(4)[index])
        step = 1e-3 * value[index] * np.eye(4)[index]
        near, far = (
            np.asarray(slopes(everywhere(*(value + k * step)), unit, jnp.ones(2))[0])
            - np.asarray(slopes(everywhere(*(value - k * step)), unit, jnp.ones(2))[0])
            for k in (1, 2)
        )
        difference = (8 * near - far) / (12 * step[index])
        found = [slopes(everywhere(*value), unit, weight) for weight in jnp.eye(2)]
        forward = np.asarray(found[0][1])
        reverse = [np.vdot(gradient[index], unit[index]) for _, _, gradient in found]
        np.testing.assert_allclose(forward, reverse, rtol=1e-10, err_msg=name)
        np.testing.assert_allclose(forward, difference, rtol=1e-6, err_msg=name)
        assert (np.abs(forward) > 0).all()


def test_gradient_of_every_face_and_cell_at_once(x64):
    at = np.linspace(0.2, 0.9, FACES), np.linspace(300.0, 500.0, FACES), RAMP, np.full(CELLS, 600.0)
    at = tuple(jnp.asarray(value) for value in at)
    direction = tuple(jnp.cos(jnp.arange(x.size, dtype=x.dtype)).reshape(x.shape) for x in at)
    for band, weight in enumerate(jnp.eye(2)):
        _, slope, gradient = slopes(at, direction, weight)
        expected = sum(np.vdot(g, d) for g, d in zip(gradient, direction, strict=True))
        np.testing.assert_allclose(slope[band], expected, rtol=1e-9)


def test_finite_at_every_hard_place():
    for emissivity, absorption, temperature in itertools.product(
        (0.0, 1e-7, 1.0), (0.0, 1e-30, 1e-8, 1e4), (3.0, 6000.0)
    ):
        at = everywhere(emissivity, temperature, absorption, temperature)
        for unit, weight in zip(np.eye(4), (*jnp.eye(2), *jnp.eye(2)), strict=True):
            for got in jax.tree.leaves(slopes(at, everywhere(*unit), weight)):
                assert np.isfinite(got).all(), (emissivity, absorption, temperature)


@jax.jit
def slope_of_a_plate(camera):
    def total(temperature):
        scene = jaxir.Scene(plate(temperature=temperature), sources=(jaxir.ParallelSource((0.0, -1.0, 0.0), 10.0),))
        return jaxir.render(scene, camera, jaxir.LWIR, samples=2).radiant_intensity()[0]

    return jax.grad(total)(400.0)


@pytest.mark.parametrize("azimuth", [0.0, 89.9999, 90.0])
def test_finite_on_misses_edges_and_grazing_views(azimuth):
    assert np.isfinite(slope_of_a_plate(jaxir.orthographic_camera(azimuth, 0.0, 1.0 / 16, (16, 16))))


def test_visibility_has_no_derivative(x64):
    def total(shift):
        mesh = box_mesh()
        moved = jaxir.Mesh(mesh.vertices + shift[None, :], np.asarray(mesh.faces))
        scene = jaxir.Scene(jaxir.Skin(moved, 400.0, jaxir.Lambert(1.0)))
        camera = jaxir.orthographic_camera(0.0, 0.0, 0.1, (4, 4), target=(0.0, 0.4, 0.0))
        return jaxir.render(scene, camera, jaxir.LWIR, samples=2).radiant_intensity()[0]

    np.testing.assert_array_equal(jax.grad(total)(jnp.zeros(3)), 0.0)
