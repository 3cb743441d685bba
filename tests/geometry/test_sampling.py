"""Samplers against their densities, and uniform numbers against uniformity."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chi2

from jaxir._math import frame_around
from jaxir.geometry import (
    Independent,
    Lattice,
    Sobol,
    Stratified,
    nearly_square,
    pdf_cap,
    pdf_disc,
    pdf_hemisphere,
    pdf_triangle,
    sample_cap,
    sample_disc,
    sample_hemisphere,
    sample_triangle,
    sphere_drop,
)
from tests.chi_square import p_value

NORMAL = np.array([0.6, 0.0, -0.8])
SAMPLERS = [Independent(), Stratified(), Sobol(), Lattice()]


def unit(array):
    return array / np.linalg.norm(array, axis=-1, keepdims=True)


with_slope = jax.jit(lambda axis: (frame_around(axis), jax.jacobian(frame_around)(axis)))
around = jax.jit(frame_around)


@pytest.mark.parametrize("normal", [[0, 0, 1], [0, 0, -1], [1, 0, 0], [1e-4, -1e-4, -1], [1e-9, 1, 1e-9]])
def test_frame_is_orthonormal_without_a_singular_direction(normal, precision):
    axis = jnp.asarray(unit(np.array(normal, float)), precision)
    frame, slope = map(np.asarray, with_slope(axis))
    assert frame.dtype == precision
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=4 * np.finfo(precision).eps)
    np.testing.assert_allclose(np.linalg.det(frame.astype(float)), 1, rtol=1e-6)
    assert np.all(np.isfinite(slope))


def test_hemisphere_is_uniform():
    normal = jnp.asarray(NORMAL)
    p, total = p_value(
        lambda u: sample_hemisphere(u, normal), lambda w: pdf_hemisphere(w, normal), around(normal),
        jax.random.key(0),
    )  # fmt: skip
    assert p > 1e-3
    assert total == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize("drop", [0.3, 1.5, 2.0])
def test_cap_is_uniform(drop):
    axis = jnp.asarray(NORMAL)
    p, total = p_value(
        lambda u: sample_cap(u, axis, jnp.asarray(drop)), lambda w: pdf_cap(w, axis, jnp.asarray(drop)),
        around(axis), jax.random.key(1),
    )  # fmt: skip
    assert p > 1e-3
    assert total == pytest.approx(1, abs=0.02)


def test_solid_angle_of_a_small_and_far_sphere(precision):
    """The sun's disc keeps its digits: drop = s^2 / 2 for s = radius / distance -> 0; 2 from inside."""
    zero = jnp.asarray(np.zeros(3))
    drop = jax.jit(jax.value_and_grad(sphere_drop, argnums=(0, 2)))
    far = drop(zero, jnp.asarray([0.0, 3e8, 4e8]), jnp.asarray(1e4))[0]
    np.testing.assert_allclose(far, 2e-10, rtol=1e-6)
    near = drop(zero, jnp.asarray([0.0, 0.0, 2.0]), jnp.asarray(1.0))[0]
    np.testing.assert_allclose(near, 1 - np.sqrt(0.75), rtol=1e-6)
    assert drop(zero, jnp.asarray([0.1, 0.0, 0.0]), jnp.asarray(1.0))[0] == 2
    gradient = drop(zero, zero, jnp.asarray(1.0))[1]
    assert all(np.all(np.isfinite(leaf)) for leaf in gradient)


def test_disc_is_uniform_in_area():
    """chi2 over 8 rings of equal area times 8 sectors; all points in the plane and inside."""
    centre, radius, normal = jnp.asarray([1.0, 2.0, 3.0]), jnp.asarray(2.0), jnp.asarray(NORMAL)
    u = jax.random.uniform(jax.random.key(2), (20000, 2))
    drawn = jax.jit(jax.vmap(lambda u: sample_disc(u, centre, normal, radius)))(u)
    local = (np.asarray(drawn) - np.asarray(centre)) @ np.asarray(around(normal)).T
    np.testing.assert_allclose(local[:, 2], 0, atol=1e-5)
    ring = np.clip((local[:, 0] ** 2 + local[:, 1] ** 2) / 4 * 8, 0, 7.999).astype(int)
    sector = (np.arctan2(local[:, 1], local[:, 0]) / (2 * np.pi) % 1 * 8).astype(int) % 8
    seen = np.bincount(ring * 8 + sector, minlength=64)
    assert chi2.sf(np.sum((seen - 20000 / 64) ** 2 / (20000 / 64)), 63) > 1e-3
    assert pdf_disc(radius) == pytest.approx(1 / (4 * np.pi))
    assert pdf_disc(jnp.asarray(0.0)) == 0


def test_triangle_is_uniform_in_area():
    """The four triangles that the midpoints of the sides cut off have equal parts; so have theirs."""
    u = jax.random.uniform(jax.random.key(3), (20000, 2))
    weights = np.asarray(jax.jit(jax.vmap(sample_triangle))(u))
    np.testing.assert_allclose(weights.sum(axis=-1), 1, rtol=1e-6)
    assert weights.min() >= 0
    place = (weights[:, :2] * 4).astype(int)
    upper = (weights[:, :2] * 4 % 1).sum(axis=-1) > 1
    bins = (place[:, 0] * 4 + place[:, 1]) * 2 + upper
    seen = np.array([np.sum(bins == b) for b in np.unique(bins)])
    assert len(seen) == 16
    assert chi2.sf(np.sum((seen - 1250) ** 2 / 1250), 15) > 1e-3
    corners = jnp.asarray([[0.0, 0, 0], [2, 0, 0], [0, 3, 0]])
    assert pdf_triangle(corners) == pytest.approx(1 / 3)
    assert pdf_triangle(jnp.zeros((3, 3))) == 0


@pytest.mark.parametrize("sampler", SAMPLERS, ids=lambda s: type(s).__name__)
def test_uniform_numbers_are_uniform_one_by_one(sampler, precision):
    """Every place in the order is uniform over keys, in [0, 1), and tells nothing about the cell it falls into."""
    draw = jax.jit(jax.vmap(lambda k: sampler.draw(k, 16)))
    points = np.asarray(draw(jax.random.split(jax.random.key(4), 2000)))
    assert points.dtype == precision
    assert points.min() >= 0 and points.max() < 1
    for place in (0, 7, 15):
        cell = (points[:, place] * 4).astype(int) @ np.array([4, 1])
        seen = np.bincount(cell, minlength=16)
        assert chi2.sf(np.sum((seen - 125) ** 2 / 125), 15) > 1e-4


@pytest.mark.parametrize("sampler", [Stratified(), Sobol()], ids=lambda s: type(s).__name__)
def test_even_points_fill_every_cell_once(sampler):
    u = np.asarray(sampler.draw(jax.random.key(5), 64))
    assert len(np.unique((u * 8).astype(int) @ np.array([8, 1]))) == 64


def test_sobol_points_are_a_net():
    """Every elementary interval of area 1/64 holds one of 64 points, Owen-scrambled or not."""
    u = np.asarray(Sobol().draw(jax.random.key(6), 64))
    for power in range(7):
        shape = np.array([2**power, 2 ** (6 - power)])
        assert len(np.unique((u * shape).astype(int) @ np.array([64, 1]))) == 64


@pytest.mark.parametrize(("sampler", "better"), [(Stratified(), 4), (Sobol(), 4), (Lattice(), 4)])
def test_even_points_estimate_without_bias_and_with_less_variance(sampler, better):
    """Mean of (x^2 + y) e^x over the unit square, (e - 2) + (e - 1) / 2, from 64 points."""
    truth = (np.e - 2) + (np.e - 1) / 2
    keys = jax.random.split(jax.random.key(7), 1000)

    def means(sampler):
        value = lambda u: jnp.mean((u[:, 0] ** 2 + u[:, 1]) * jnp.exp(u[:, 0]))  # noqa: E731
        return np.asarray(jax.jit(jax.vmap(lambda k: value(sampler.draw(k, 64))))(keys))

    mean = means(sampler)
    error = mean.std() / np.sqrt(len(mean))
    assert error < truth * 1e-3
    assert abs(mean.mean() - truth) < 4 * error
    assert mean.std() * better < means(Independent()).std()


def test_strata_are_nearly_square():
    assert [nearly_square(n) for n in (1, 2, 12, 13, 64)] == [(1, 1), (2, 1), (4, 3), (13, 1), (8, 8)]
