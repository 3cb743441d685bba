"""Pearson's test of samples on the sphere against their density."""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import chi2

RINGS, SECTORS, FINE = 12, 16, 12


def direction_grid(rings=RINGS * FINE, sectors=SECTORS * FINE):
    """Directions at midpoints of equal steps in z and azimuth [ring, sector, 3]; the solid angle of each."""
    z = (np.arange(rings) + 0.5) / rings * 2 - 1
    angle = (np.arange(sectors) + 0.5) / sectors * 2 * np.pi
    zz, aa = np.meshgrid(z, angle, indexing="ij")
    sine = np.sqrt(1 - zz**2)
    return np.stack([sine * np.cos(aa), sine * np.sin(aa), zz], axis=-1), 4 * np.pi / (rings * sectors)


def p_value(sample, pdf, frame, key, count=20000):
    """Probability of a worse fit between `count` draws of `sample(u)` and `pdf(omega)`.

    Bins are equal steps of z and azimuth in `frame` (rows); the density is integrated over each by 144 midpoints, and
    bins that expect fewer than 8 draws are joined. Returns (p, integral of the density).
    """
    u = jax.random.uniform(key, (count, 2))
    local = np.asarray(jax.jit(jax.vmap(sample))(u), float) @ np.asarray(frame).T
    ring = np.clip(((local[:, 2] + 1) / 2 * RINGS).astype(int), 0, RINGS - 1)
    sector = ((np.arctan2(local[:, 1], local[:, 0]) / (2 * np.pi) % 1) * SECTORS).astype(int) % SECTORS
    seen = np.bincount(ring * SECTORS + sector, minlength=RINGS * SECTORS)
    grid, solid = direction_grid()
    omega = jnp.asarray(grid.reshape(-1, 3) @ np.asarray(frame), u.dtype)
    density = np.asarray(jax.jit(jax.vmap(pdf))(omega), float).reshape(RINGS, FINE, SECTORS, FINE)
    expected = density.sum(axis=(1, 3)).ravel() * solid * count
    order = np.argsort(expected)
    rare = np.cumsum(expected[order]) < 8 * max(1, np.sum(expected < 8))
    rare = order[rare & (expected[order] < 8)]
    common = np.setdiff1d(np.arange(expected.size), rare)
    e = np.append(expected[common], expected[rare].sum())
    s = np.append(seen[common], seen[rare].sum())
    e, s = (e[:-1], s[:-1]) if e[-1] < 8 else (e, s)
    statistic = np.sum((s - e) ** 2 / e)
    return chi2.sf(statistic, len(e) - 1), expected.sum() / count
