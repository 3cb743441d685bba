"""Rays aimed at shared vertices and edges of closed and flat meshes."""

import jax.numpy as jnp
import numpy as np
import pytest
from bodies import as_float, frame, sphere

from jaxir.geometry.mesh import Mesh, any_hit
from jaxir.geometry.ray import Bundle, Rays

SCALES = [1e-3, 1.0, 1e6]


def seams(rng, vertices, faces, count):
    """Every vertex, and points on edges."""
    start, stop = faces[:, [0, 1, 2]].ravel(), faces[:, [1, 2, 0]].ravel()
    pick = rng.integers(len(start), size=count)
    s = rng.random((count, 1))
    return np.concatenate([vertices, vertices[start[pick]] * (1 - s) + vertices[stop[pick]] * s])


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("offset", [0.0, 30.0])
def test_single_rays_do_not_leak(scale, offset):
    rng = np.random.default_rng(0)
    vertices, faces = sphere(4)
    vertices = np.asarray((vertices + offset) * scale, np.float32)
    mesh = Mesh(vertices, faces)
    exact = vertices.astype(np.float64)
    target = seams(rng, exact, faces, 6000)
    centre = (exact.min(0) + exact.max(0)) / 2
    inside = centre + rng.uniform(-0.8, 0.8, size=target.shape) * scale
    for origin in (inside, 2 * target - inside):
        direction = target - origin
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        hit = any_hit(mesh, Rays(as_float(origin), as_float(direction)))
        assert np.all(hit), int(np.sum(~np.asarray(hit)))


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("distance", [3.0, 12000.0, np.inf])
def test_bundles_do_not_leak(scale, distance):
    rng = np.random.default_rng(1)
    vertices, faces = sphere(4)
    vertices = np.asarray(vertices * scale, np.float32)
    mesh = Mesh(vertices, faces)
    exact = vertices.astype(np.float64)
    target = seams(rng, exact, faces, 6000)
    axes = frame(rng.normal(size=3))
    inverse = 0.0 if np.isinf(distance) else 1 / (distance * scale)
    p = target @ axes.T
    screen = p[:, :2] / (1 - p[:, 2:] * inverse)
    view = axes[2] - target * inverse
    slope = np.abs(np.sum(view * target, axis=1)) / np.linalg.norm(view, axis=1) / np.linalg.norm(target, axis=1)
    cell = 0.1 * scale
    order = np.lexsort((np.floor(screen[:, 1] / cell), np.floor(screen[:, 0] / cell)))
    bundle = Bundle(
        as_float(np.zeros(3)), as_float(axes), as_float(inverse), as_float(2.5 * scale), as_float(screen[order])
    )
    hit = np.asarray(any_hit(mesh, bundle))
    clear = slope[order] > 0.12  # nearer to the outline a vertex of the polyhedron may be part of it
    assert np.all(hit[clear]), int(np.sum(~hit[clear]))


@pytest.mark.parametrize("elevation", [30.0, 0.1, 0.001])
def test_a_plate_at_grazing_incidence_does_not_leak(elevation):
    """Rays through the inner vertices and edges of a flat grid, seen at a small angle."""
    rng = np.random.default_rng(2)
    grid = np.linspace(-1, 1, 17)
    u, v = np.meshgrid(grid, grid, indexing="ij")
    i = (np.arange(16)[:, None] * 17 + np.arange(16)[None, :]).ravel()
    faces = np.concatenate([np.stack([i, i + 17, i + 18], -1), np.stack([i, i + 18, i + 1], -1)])
    vertices = np.stack([u, v, np.zeros_like(u)], -1).reshape(-1, 3)
    mesh = Mesh(vertices, faces)
    target = seams(rng, vertices, faces, 4000)
    target = target[np.max(np.abs(target), axis=1) < 0.99]
    angle = np.radians(elevation)
    towards = np.array([np.cos(angle) * np.cos(0.4), np.cos(angle) * np.sin(0.4), np.sin(angle)])
    rays = Rays(as_float(target + 3 * towards), as_float(np.tile(-towards, (len(target), 1))))
    assert np.all(any_hit(mesh, rays))
    axes = frame(towards)
    p = target @ axes.T
    order = np.lexsort((p[:, 1], np.floor(p[:, 0] / 0.1)))
    bundle = Bundle(as_float(np.zeros(3)), as_float(axes), as_float(0.0), as_float(3.0), as_float(p[order, :2]))
    assert np.all(any_hit(mesh, bundle))
    assert jnp.all(any_hit(mesh, bundle.rays()))
