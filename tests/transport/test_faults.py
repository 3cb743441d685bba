"""What once was lost or doubled without a word: bounces, hidden backgrounds, backgrounds that are one object."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir.optics.spectrum import gray_nodes

NODES = gray_nodes((jaxir.LWIR,))
SQUARE = np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]])
TWO = np.array([[0, 1, 2], [0, 2, 3]])
COLD = 3.0


traced = eqx.filter_jit(jaxir.trace)


def rays_down(count, height):
    x = 0.8 * ((np.arange(count) + 0.5) / count - 0.5)
    points = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2)
    origin = jnp.asarray(np.column_stack([points, np.full(len(points), height)]))
    return jaxir.Rays(origin, jnp.broadcast_to(jnp.asarray([0.0, 0.0, -1.0]), origin.shape))


def plate(emissivity, temperature=COLD):
    return jaxir.Skin(jaxir.Mesh(SQUARE, TWO), temperature, jaxir.Lambert(emissivity))


def facing_plates(emissivity, temperature):
    """Two plates ten times as wide as far apart: between their middles nearly an enclosure."""
    wide = np.concatenate([10 * SQUARE, 10 * SQUARE + [0.0, 0.0, 1.0]])
    mesh = jaxir.Mesh(wide, np.concatenate([TWO, TWO + 4]))
    return jaxir.Skin(mesh, temperature, jaxir.Lambert(emissivity))


def test_paths_keep_their_bounces():
    """Evaluated without a word of the method: emissivity B times the sum of rho^k, less what leaves at the rim."""
    emissivity, bounces = 0.3, 3
    scene = jaxir.Scene(facing_plates(emissivity, 400.0))

    @eqx.filter_jit
    def look(scene):
        paths = jaxir.trace(scene, rays_down(48, 0.5), jaxir.Method(bounces=bounces), jax.random.key(0))
        return paths, jaxir.evaluate(scene.on(NODES), paths)[:, 0]

    paths, got = look(scene)
    got = np.asarray(got, float)
    black = float(jaxir.band_radiance(jnp.asarray(400.0), NODES)[0])
    full = black * (1 - (1 - emissivity) ** (bounces + 1))
    error = got.std() / np.sqrt(got.size)
    assert error < 0.01 * full
    assert 0.95 * full - 4 * error < got.mean() < full + 4 * error
    assert paths.method.bounces == bounces


def test_paths_that_have_ended_stay_finite():
    """Those that meet nothing were reflected on, each time about themselves: after 24 times lengths were infinite."""
    skin = jaxir.Skin(jaxir.Mesh(SQUARE, TWO), 300.0, jaxir.RoughConductor(2.0, 9.0, 0.1))
    rays = rays_down(4, 0.5)
    beside = jaxir.Rays(rays.origin.at[:, 0].add(3.0), rays.direction)
    both = jax.tree.map(lambda *each: jnp.concatenate(each), rays, beside)

    scene = jaxir.Scene(skin)
    paths = traced(scene, both, jaxir.Method(bounces=60), jax.random.key(0))
    segments = paths.segments

    @jax.jit
    def pulled(brdf):
        def radiance(brdf):
            own = eqx.tree_at(lambda s: s.skin.brdf, scene, brdf)
            return jaxir.evaluate(own.on(NODES), paths)[:, 0]

        value, pull = jax.vjp(radiance, brdf)
        return value, pull(jnp.ones_like(value))[0]

    value, slope = pulled(skin.brdf)
    np.testing.assert_allclose(np.linalg.norm(segments.rays.direction, axis=-1), 1, atol=1e-5)
    assert np.isfinite(segments.inverse_pdf).all() and np.isfinite(jax.tree.leaves(slope)).all()
    assert (np.asarray(value)[:16] > 0).all() and (np.asarray(value)[16:] == 0).all()


@pytest.mark.parametrize("given", [False, True])
def test_a_background_that_is_also_a_source_lights_once_for_each(given):
    """One object named twice is two lights, where a program holds the very object as where it is given a scene."""
    sky = jaxir.UniformBackground(10.0)
    scene = jaxir.Scene(plate(0.5), sources=(sky,), background=sky)

    def look(scene):
        paths = jaxir.trace(scene, rays_down(4, 0.5), key=jax.random.key(1))
        return jaxir.evaluate(scene.on(NODES), paths)[:, 0]

    got = jax.jit(look)(scene) if given else jax.jit(lambda: look(scene))()
    np.testing.assert_allclose(got, 0.5 * 2 * 10.0, rtol=1e-5)


def test_hidden_backgrounds_light_the_skin_by_default():
    """One that is uniform and one by elevation, each with a share of its own."""
    hidden = jaxir.UniformBackground(8.0), jaxir.ElevationTable([-90.0, 90.0], [4.0, 4.0])
    scene = jaxir.Scene(plate(0.5), sources=hidden)
    camera = jaxir.orthographic_camera(0.0, 90.0, 0.02, (16, 16))
    image = jaxir.render(scene, camera, jaxir.LWIR, samples=2)
    np.testing.assert_allclose(image.radiance, np.full((16, 16, 1), 6.0), rtol=1e-5)
    left_out = jaxir.render(scene, camera, jaxir.LWIR, samples=2, method=jaxir.Method(direct=None))
    assert float(jnp.abs(left_out.radiance).max()) < 1e-10


def test_no_random_key_is_used_twice():
    """JAX's own check: a key that was drawn from or split is neither drawn from nor split again."""
    disc = jaxir.DiscSource([0.0, 0.0, 2.0], [0.0, 0.0, -1.0], 0.5, 10.0)
    grid = jaxir.Grid((-0.5, -0.5, 0.2), (0.5, 0.5, 0.5), (2, 2, 1))
    particles = jaxir.GrayParticles(0.5, 0.9, jaxir.Isotropic())
    scene = jaxir.Scene(plate(0.5), jaxir.GridPlume(grid, 400.0, jaxir.GrayGas(0.1), particles), disc)
    method = jaxir.Method(bounces=1, orders=2, skin_light=jaxir.SkinLight(), plume_light=jaxir.PlumeLight())
    with jax.debug_key_reuse(True):
        once = eqx.filter_jit(lambda key: jaxir.trace(scene, rays_down(2, 1.5), method, key))
        traced = eqx.filter_eval_shape(once, jax.random.key(3))  # checked while traced: nothing need be compiled
    assert traced.segments.length.shape == (3, 4)
