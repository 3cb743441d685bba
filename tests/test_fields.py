"""A field is declared once: conversion, shape and range follow from its declaration."""

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

from jaxir._arrays import enforce, increasing, positive
from jaxir._fields import Physical, flag, per_face, per_node, quantity, spectral


class Slab(Physical):
    temperature: Float[Array, "*cell"] = quantity("K", ("*cell",), positive)
    absorption: Float[Array, "*cell node"] = quantity("m-1", ("*cell", "node"), spread=per_node)
    albedo: Float[Array, " node"] = spectral("1", default=0.5)
    emissivity: Float[Array, "face node"] = quantity("1", ("face", "node"), spread=per_face, least=1, default=1.0)
    level: Float[Array, " level"] | None = quantity("m", ("level",), (positive, increasing), least=2, default=None)
    gray: bool = flag()


def test_arguments_become_leaves_of_the_declared_shape(precision):
    slab = Slab(300, 1.0)
    assert [np.shape(leaf) for leaf in (slab.temperature, slab.absorption, slab.albedo)] == [(), (1,), (1,)]
    assert slab.level is None and slab.emissivity.shape == (1, 1) and slab.temperature.dtype == precision
    wide = Slab(np.ones((2, 3)), np.ones((2, 3, 4)), [1, 2, 3, 4], [0.1, 0.2], [1.0, 2.0])
    assert wide.emissivity.shape == (2, 1) and wide.albedo.shape == (4,)
    assert Slab(np.ones((2, 3)), 1.0).absorption.shape == Slab(1.0, np.ones((5, 1))).absorption.shape[1:]


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Slab("warm", 1.0), "Slab.temperature: got 'warm', expected a number"),
        (
            lambda: Slab(np.ones(2), np.ones((3, 1))),
            r"Slab.absorption: got shape \(3, 1\), expected \(2, node\) or one without cells",
        ),
        (lambda: Slab(1.0, [1.0, 2.0], [1.0, 2.0, 3.0]), r"Slab.albedo: got shape \(3,\), expected \(2 or 1,\)"),
        (lambda: Slab(1.0, 1.0, np.ones((2, 2))), r"Slab.albedo: got shape \(2, 2\), expected \(node,\)"),
        (lambda: Slab(1.0, 1.0, 1.0, np.ones((2, 2, 2))), r"Slab.emissivity: got shape .* expected \(face, node\)"),
        (lambda: Slab(1.0, 1.0, 1.0, np.ones((0, 1))), r"Slab.emissivity: got shape \(0, 1\), .* at least 1"),
        (lambda: Slab(1.0, 1.0, level=[1.0]), r"Slab.level: got shape \(1,\), expected a length of at least 2"),
        (lambda: Slab(1.0, 1.0, gray=1), "Slab.gray: got 1, expected True or False"),
    ],
)
def test_a_wrong_shape_is_refused_by_the_constructor(build, message):
    with pytest.raises(ValueError, match=message):
        build()


@pytest.mark.parametrize(
    ("slab", "message"),
    [
        (lambda: Slab(-1.0, 1.0), "Slab.temperature: got -1.0, expected finite values > 0"),
        (lambda: Slab(1.0, 1.0, level=[2.0, 1.0]), r"Slab.level: got 1.0 at index \[1\], expected increasing"),
        (lambda: Slab(1.0, 1.0, level=[-1.0, 1.0]), r"Slab.level: got -1.0 at index \[0\], expected finite values > 0"),
    ],
)
def test_every_declared_range_is_checked_at_the_entry(slab, message):
    with pytest.raises(ValueError, match=message):
        enforce(jnp.zeros(1), slab().checks())
