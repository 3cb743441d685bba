"""A short run of `tests.random_scenes`, which runs all structures as `python -m tests.random_scenes`."""

import jax
import numpy as np
import pytest

from tests.random_scenes import BATCH, STRUCTURES, broken, draw_batch, outshines, program

SHORT = ("box in the sun", "grid of tables", "two grids")  # quick to compile, and what random scenes found wrong


def test_there_are_many_structures():
    assert len(STRUCTURES) >= 25


@pytest.mark.parametrize("name", SHORT)
def test_random_scenes_obey_the_laws(name):
    found = jax.device_get(program(STRUCTURES[name])(*draw_batch(STRUCTURES[name], (2, SHORT.index(name)))))
    assert found["legal"].sum() >= 0.8 * BATCH
    assert not any(broken(found).values()), broken(found)
    assert not outshines(found["mean"])


def test_the_laws_see_what_breaks_them():
    """A radiance that is wrong in sign, size, linearity or slope breaks the law that says so."""
    good = jax.device_get(program(STRUCTURES["gray grid"])(*draw_batch(STRUCTURES["gray grid"], (3,), 8)))
    assert not any(broken(good).values())
    for law in broken(good):
        bad = good | {law: np.zeros_like(good[law])}
        assert len(broken(bad)[law]) == good["legal"].sum()
    assert outshines(np.random.default_rng(0).normal(1.2, 0.1, 50)) and not outshines(np.full(50, 1.0))
