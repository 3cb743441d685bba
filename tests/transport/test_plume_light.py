"""The plume drawn as a light on the skin: a closed form of it and of its slopes."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxir
from jaxir import DirectSampling, Method, PlumeLight
from jaxir.geometry import Rays
from jaxir.optics.spectrum import gray_nodes
from jaxir.transport import evaluate, trace

NODES = gray_nodes((jaxir.LWIR,))
COLD, HOT = 3.0, 700.0
CORNERS = np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]])
TWO = np.array([[0, 1, 2], [0, 2, 3]])


def rays_down(count, height=0.5):
    """Rays that fall on a raster of the plane z = 0."""
    x = 0.9 * ((np.arange(count) + 0.5) / count - 0.5)
    points = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2)
    origin = jnp.asarray(np.column_stack([points, np.full(len(points), height)]))
    return Rays(origin, jnp.broadcast_to(jnp.asarray([0.0, 0.0, -1.0]), origin.shape))


def test_a_small_thin_box_far_away_lights_a_plate():
    """reflectance / pi * cos * absorption B V / distance^2; (size / distance)^2 and depth leave 1e-3.

    Its slopes in the gas's temperature and the skin's emissivity, too, and these as differences on the paths kept.
    """
    count, cell, centre, absorption = (4, 3, 5), 0.1, np.array([5.0, -1.0, 8.0]), 1e-3
    grid = jaxir.Grid(centre - np.array(count) * cell / 2, (cell,) * 3, count)
    method, rays, at = Method(DirectSampling(1, 0), plume_light=PlumeLight()), rays_down(32), jnp.asarray([HOT, 0.5])

    def scene(values):
        skin = jaxir.Skin(jaxir.Mesh(CORNERS, TWO), COLD, jaxir.Lambert(values[1]))
        return jaxir.Scene(skin, jaxir.GridPlume(grid, values[0], jaxir.GrayGas(absorption)))

    kept = eqx.filter_jit(lambda s: trace(s, rays, method, jax.random.key(1)))(scene(at))

    @jax.jit
    def radiance(values):
        """Value and slopes of each ray [1 + value, ray]."""

        def of(values):
            return evaluate(scene(values).on(NODES), kept)[:, 0]

        value, slopes = jax.vmap(lambda along: jax.jvp(of, (values,), (along,)))(jnp.eye(2))
        return jnp.concatenate([value[:1], slopes])

    offset = centre - np.asarray(rays.origin, float) * [1, 1, 0]
    square = np.sum(offset**2, axis=1)
    level = jax.jit(jax.value_and_grad(lambda t: jaxir.band_radiance(t, NODES)[0]))(at[0])
    received = offset[:, 2] / np.sqrt(square) * absorption * np.prod(count) * cell**3 / square / np.pi
    got = np.asarray(radiance(at), float)
    factors = (0.5 * float(level[0]), 0.5 * float(level[1]), -float(level[0]))
    for values, factor in zip(got, factors, strict=True):
        ratio = values / (factor * received)
        error = ratio.std() / np.sqrt(ratio.size)
        assert error < 2e-3
        assert abs(ratio.mean() - 1) < 4 * error + 1e-3
    # p of the brdf's directions meet the box: whatever they find there, their squares scatter by (1 - p) / p or more
    met = np.max(0.25 * np.sum((np.array(count) * cell) ** 2) / square)
    assert (got[0] / (factors[0] * received)).var() < 1e-4 * (1 - met) / met
    for index, step in enumerate((7.0, 0.01)):
        ends = [np.asarray(radiance(at.at[index].add(s * step))[0], float) for s in (1, -1)]
        # B is curved: its third derivative leaves (c2 / (wavelength T) * 1 %)^2 / 6, below 1e-4
        np.testing.assert_allclose(got[1 + index], (ends[0] - ends[1]) / (2 * step), rtol=1e-3)
