"""Scattering by particles against radiative transfer's closed forms, energy, furnaces, and other ways to the same."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir import Scattering
from jaxir.geometry.ray import Rays
from jaxir.optics.band import gray_nodes
from jaxir.transport.evaluate import evaluate
from jaxir.transport.paths import trace
from jaxir.transport.radiometry import radiometry

NODES = gray_nodes((jaxir.LWIR,))
WARM, COLD = 400.0, 3.0
BLACK = float(jaxir.band_radiance(jnp.asarray(WARM), NODES)[0])
WIDE = 1e3  # a slab of thickness 1 is infinite to 1e-6: no path of some orders leaves by its sides


@eqx.filter_jit
def look(scene, rays, key, scattering=None, reflection=None):
    """Radiance of each ray [ray]."""
    paths = trace(scene, rays, reflection, key, scattering)
    return evaluate(radiometry(scene, NODES), paths, reflection)[:, 0]


def slab(depth, albedo, phase=None, temperature=WARM, cells=6, **parts):
    """A slab 0 < z < 1 of particles alone, in `cells` layers."""
    grid = jaxir.Grid((-WIDE / 2, -WIDE / 2, 0.0), (WIDE, WIDE, 1 / cells), (1, 1, cells))
    particles = jaxir.GrayParticles(depth, albedo, jaxir.Isotropic() if phase is None else phase)
    return jaxir.Scene(plume=jaxir.GridPlume(grid, temperature, jaxir.GrayGas(0.0), particles), **parts)


def down(cosine, count):
    """Rays from above at one angle with the normal."""
    origin = jnp.broadcast_to(jnp.asarray([0.0, 0.0, 2.0]), (count, 3))
    return Rays(origin, jnp.broadcast_to(jnp.asarray([np.sqrt(1 - cosine**2), 0.0, -cosine]), (count, 3)))


def from_above(count, key=7):
    """Rays whose origin sees the slab with density cos / pi: their mean is the flux over pi."""
    u = jax.random.uniform(jax.random.key(key), (count, 2))
    cosine, turn = jnp.sqrt(1 - u[:, 0]), 2 * jnp.pi * u[:, 1]
    sine = jnp.sqrt(u[:, 0])
    direction = jnp.stack([sine * jnp.cos(turn), sine * jnp.sin(turn), -cosine], axis=-1)
    return Rays(jnp.broadcast_to(jnp.asarray([0.0, 0.0, 1.001]), (count, 3)), direction)


def agrees(values, expected, tolerance, bias=0.0):
    """The mean is right within 4 standard errors, themselves below a quarter of the tolerance."""
    values = np.asarray(values, float)
    error = values.std(ddof=1) / np.sqrt(values.size)
    assert error < tolerance / 4 * abs(expected), (error, expected)
    assert abs(values.mean() - expected) < 4 * error + bias * abs(expected), (values.mean(), expected, error)


# Isothermal slabs (O9) ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("depth", "albedo", "cosine", "expected"),
    [
        (1, 0.5, 1.0, 0.454822),
        (1, 0.5, 0.5, 0.619961),
        (1, 0.9, 1.0, 0.140965),
        (1, 0.9, 0.5, 0.191498),
        (40, 0.5, 1.0, 0.884774),
        (40, 0.9, 1.0, 0.585053),
    ],
)
def test_emissivity_of_a_scattering_slab(depth, albedo, cosine, expected):
    """O9; what is left out beyond order n is below albedo^(n + 1)."""
    orders = 12 if albedo == 0.5 else 60
    got = look(slab(depth, albedo), down(cosine, 40_000), jax.random.key(1), Scattering(orders))
    agrees(np.asarray(got) / BLACK, expected, 0.01, bias=2e-4)


def test_hemispherical_emissivity_reflectance_and_transmittance():
    """O9 for Henyey and Greenstein's phase function: light from one side sent back, let through, and emitted."""
    phase, count, order = jaxir.HenyeyGreenstein(0.5), 40_000, Scattering(25)
    emitted = look(slab(1.0, 0.9, phase), from_above(count), jax.random.key(2), order)
    agrees(np.asarray(emitted) / BLACK, 0.1734992, 0.02)
    sky = jaxir.ElevationTable([-90.0, -0.001, 0.001, 90.0], [0.0, 0.0, 1.0, 1.0])
    lit = slab(1.0, 0.9, phase, temperature=COLD, background=sky)
    agrees(look(lit, from_above(count), jax.random.key(3), order), 0.227953, 0.05)
    ground = jaxir.ElevationTable([-90.0, -0.001, 0.001, 90.0], [1.0, 1.0, 0.0, 0.0])
    lit = slab(1.0, 0.9, phase, temperature=COLD, background=ground)
    agrees(look(lit, from_above(count), jax.random.key(4), order), 0.598548, 0.02)


def test_particles_that_absorb_nothing_conserve_energy():
    """Under an even sky every direction shows it, whatever is scattered how often: R + T = 1."""
    scene = slab(2.0, 1.0, jaxir.HenyeyGreenstein(0.3), COLD, background=jaxir.UniformBackground(5.0))
    agrees(look(scene, down(0.7, 4000), jax.random.key(5), Scattering(60)), 5.0, 0.01, bias=1e-4)
