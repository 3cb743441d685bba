"""A scene without its air, and alone: the background that lights it stays, that which is seen behind it goes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir.geometry.ray import Rays
from tests.scenes import gray_box, plate

LEVEL, EMISSIVITY = 7.0, 0.4
ROUND = jaxir.Reflection(direct=jaxir.MultipleImportance(1, 1))


def scene(**more):
    air = jaxir.FixedPath(0.5, 1.0)
    return jaxir.Scene(plate(EMISSIVITY), background=jaxir.UniformBackground(LEVEL), atmosphere=air, **more)


def seen(made, reflection=None, count=1):
    """Radiance of rays on the plate, and of one that misses it."""
    origin = jnp.asarray([[2.0, 0.1, 0.2]] * count + [[2.0, 3.0, 0.0]])
    rays = Rays(origin, jnp.broadcast_to(jnp.asarray([[-1.0, 0.0, 0.0]]), origin.shape))
    paths = jaxir.trace(made, rays, reflection, jax.random.key(0))
    optical = jaxir.radiometry(made, jaxir.gray_nodes((jaxir.LWIR,)))
    return np.asarray(jaxir.evaluate(optical, paths, reflection))[:, 0]


@pytest.mark.parametrize("reflection", [None, jaxir.Reflection(direct=jaxir.ClosedForm())])
def test_radiances_of_a_plate(reflection):
    """Closed forms: emitted, plus what it reflects of the background where that is asked for."""
    skin = EMISSIVITY * float(jaxir.band_radiance(jnp.asarray(400.0), jaxir.gray_nodes((jaxir.LWIR,)))[0])
    skin += 0.0 if reflection is None else (1 - EMISSIVITY) * LEVEL
    full, bare = scene(), jaxir.at_target(scene())
    for made, want in (
        (full, (0.5 * skin + 1, 0.5 * LEVEL + 1)),
        (bare, (skin, LEVEL)),
        (jaxir.alone(bare, reflection), (skin, 0.0)),
        (jaxir.alone(full, reflection), (0.5 * skin + 1, 1.0)),
    ):
        np.testing.assert_allclose(seen(made, reflection), want, rtol=1e-5)


def test_a_background_that_is_not_seen_is_sampled_as_one_that_is():
    bare = jaxir.at_target(scene())
    np.testing.assert_array_equal(seen(jaxir.alone(bare, ROUND), ROUND, 8)[:8], seen(bare, ROUND, 8)[:8])


def test_a_background_that_lights_nothing_is_dropped():
    assert jaxir.alone(scene()).sources == () and jaxir.alone(scene()).background is None
    gas = jaxir.Scene(plume=gray_box((1.0, 1.0, 1.0), 0.5), background=jaxir.UniformBackground(1.0))
    assert jaxir.alone(gas, ROUND).sources == ()
    disc = jaxir.DiscSource((3.0, 0.0, 0.0), (-1.0, 0.0, 0.0), 1.0, 1.0)
    kept = jaxir.alone(scene(sources=(disc,)))  # an area source brings a reflection, which finds the background too
    assert len(kept.sources) == 2 and kept.surroundings == (kept.sources[1],)
