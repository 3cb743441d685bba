"""A scene without its air, and alone: the background that lights it stays, that which is seen behind it goes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir.geometry import Rays
from tests.scenes import gray_box, plate

LEVEL, EMISSIVITY = 7.0, 0.4


def scene(**more):
    air = jaxir.FixedPath(0.5, 1.0)
    return jaxir.Scene(plate(EMISSIVITY), background=jaxir.UniformBackground(LEVEL), atmosphere=air, **more)


def seen(made, method=None, count=1):
    """Radiance of rays on the plate, and of one that misses it."""
    origin = jnp.asarray([[2.0, 0.1, 0.2]] * count + [[2.0, 3.0, 0.0]])
    rays = Rays(origin, jnp.broadcast_to(jnp.asarray([[-1.0, 0.0, 0.0]]), origin.shape))
    paths = jaxir.trace(made, rays, method, jax.random.key(0))
    return np.asarray(jaxir.evaluate(made.on(jaxir.gray_nodes((jaxir.LWIR,))), paths))[:, 0]


WAYS = {"default": None, "closed form": jaxir.Method(jaxir.ClosedForm()), "left out": jaxir.Method(direct=None)}


@pytest.mark.parametrize("way", WAYS)
def test_radiances_of_a_plate(way):
    """Closed forms: emitted, plus what it reflects of the background unless that is left out.

    Both of the default's samples have the density of what they find, cos / pi, so that they find it exactly.
    """
    skin = EMISSIVITY * float(jaxir.band_radiance(jnp.asarray(400.0), jaxir.gray_nodes((jaxir.LWIR,)))[0])
    skin += 0.0 if way == "left out" else (1 - EMISSIVITY) * LEVEL
    full, bare = scene(), jaxir.at_target(scene())
    for made, want in (
        (full, (0.5 * skin + 1, 0.5 * LEVEL + 1)),
        (bare, (skin, LEVEL)),
        (jaxir.alone(bare), (skin, 0.0)),
        (jaxir.alone(full), (0.5 * skin + 1, 1.0)),
    ):
        np.testing.assert_allclose(seen(made, WAYS[way]), want, rtol=1e-5)


def test_a_background_that_is_not_seen_is_sampled_as_one_that_is():
    bare = jaxir.at_target(scene())
    assert jaxir.alone(bare).extended_lights == (bare.background,) == bare.extended_lights


def test_particles_scatter_a_background_that_is_not_seen():
    """What a plume shows of a background is what it lets through and what it scatters; only the first is hidden."""
    particles = jaxir.GrayParticles(0.7, 1.0, jaxir.HenyeyGreenstein(0.5))
    box = gray_box((1.0, 1.0, 1.0), 0.0, temperature=3.0)  # that absorbs nothing and, so cold, emits nothing
    plume = jaxir.GridPlume(box.grid, box.temperature, box.gas, particles)
    full = jaxir.Scene(plumes=plume, background=jaxir.UniformBackground(LEVEL))
    shown, scattered = seen(full, count=8), seen(jaxir.alone(full), count=8)
    np.testing.assert_allclose(shown[:8] - scattered[:8], LEVEL * np.exp(-0.7), rtol=1e-5)
    assert scattered[:8].min() > 0 and scattered[8] == 0 and shown[8] == pytest.approx(LEVEL)
