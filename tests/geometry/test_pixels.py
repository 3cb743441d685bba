"""The points of pixels: where they lie, and what their mean errs."""

import jax
import numpy as np
import pytest

from jaxir.geometry import pixel_samples, pixel_strata

TILES = 16  # of 256 pixels


draw = jax.jit(pixel_samples, static_argnums=(1, 2))


def points(samples, tiles=TILES):
    """Places [stratum, set, pixel, 2]."""
    place = draw(jax.random.key(samples), tiles, samples)
    return np.asarray(place, float).reshape(samples // 2, 2, -1, 2)


@pytest.mark.parametrize("samples", [2, 8, 12, 72])
def test_points_of_a_set_share_no_part_of_a_column_or_row(samples):
    columns, rows = pixel_strata(samples)
    place, index = points(samples, 1), np.arange(columns * rows)[:, None, None]
    assert np.array_equal(np.floor(place[..., 0] * columns), np.broadcast_to(index % columns, place.shape[:-1]))
    assert np.array_equal(np.floor(place[..., 1] * rows), np.broadcast_to(index // columns, place.shape[:-1]))
    parts = np.sort(np.floor(place * (columns * rows)), axis=0)
    assert np.array_equal(parts, np.broadcast_to(np.arange(columns * rows)[:, None, None, None], parts.shape))


@pytest.mark.parametrize("samples", [8, 24])
def test_points_are_uniform_in_their_strata_and_sets_independent(samples):
    columns, rows = pixel_strata(samples)
    within = (points(samples) * (columns, rows)) % 1
    count = within.shape[2]
    assert np.abs(within.mean(axis=2) - 0.5).max() < 4.5 / np.sqrt(12 * count)
    # of the variance of a square of a uniform number, 4 / 45 / 16
    assert np.abs(((within - 0.5) ** 2).mean(axis=2) - 1 / 12).max() < 4.5 / np.sqrt(180 * count)
    one, other = within[:, 0] - 0.5, within[:, 1] - 0.5
    together = np.einsum("ipa,jpb->ijab", one, other) / count * 12
    assert np.abs(together).max() < 5 / np.sqrt(count)


def edge(place, turn, shift):
    return (place[..., 0] - 0.5) * np.cos(turn) + (place[..., 1] - 0.5) * np.sin(turn) > shift


def smooth(place, turn, shift):
    return np.sin(2 * ((place[..., 0] - 0.5) * np.cos(turn) + (place[..., 1] - 0.5) * np.sin(turn)) + shift)


@pytest.mark.parametrize("samples, ratio", [(8, (0.85, 0.45)), (32, (0.8, 0.35))])
@pytest.mark.parametrize("field", [edge, smooth])
def test_the_error_told_is_that_of_the_mean_and_less_than_of_independent_points(field, samples, ratio):
    """Each pixel has an edge or a wave of its own; what is told is right in the mean over 4096 of them."""
    rng = np.random.default_rng(0)
    turn, shift = rng.uniform(0, 2 * np.pi, TILES * 256), rng.uniform(-0.7, 0.7, TILES * 256)
    fine = (np.stack(np.meshgrid(*[np.arange(64)] * 2), axis=-1).reshape(-1, 1, 2) + 0.5) / 64
    exact = field(fine, turn, shift).mean(axis=0)
    columns, rows = pixel_strata(samples)
    corner = np.stack(np.divmod(np.arange(columns * rows), columns)[::-1], axis=-1)[:, None, None]
    alone = (corner + rng.random((columns * rows, 2, TILES * 256, 2))) / (columns, rows)
    errors = []
    for place in (points(samples), alone):
        one, other = field(place, turn, shift).mean(axis=0).astype(float)
        errors.append(((one + other) / 2 - exact) ** 2)
        told = (one - other) ** 2 / 4
        if place is not alone:
            apart = errors[0] - told
            assert abs(apart.mean()) < 4 * apart.std() / np.sqrt(apart.size)
            assert apart.std() / np.sqrt(apart.size) < 0.06 * told.mean()
    assert errors[0].mean() < ratio[field is smooth] * errors[1].mean()
