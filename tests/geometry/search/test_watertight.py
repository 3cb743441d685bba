"""Rays aimed at shared vertices and edges, and beside them, of closed, flat and thin meshes."""

import functools

import numpy as np
import pytest

from jaxir.geometry import Bundle, Rays
from jaxir.geometry.search import Mesh, any_hit, closest_hit
from tests.geometry.search.bodies import (
    BODIES,
    Lines,
    as_float,
    as_large_as_soup,
    every_face,
    frame,
    slivers,
    sphere,
    unrelated,
)

pytestmark = pytest.mark.optimised

SCALES = [1e-3, 1.0, 1e6]


def parts(rays, most=600):
    """Rays, or a bundle of neighbours, as several of as many, so that searches of all are one program."""
    assert rays.count % most == 0
    for part in np.split(np.arange(rays.count), rays.count // most):
        if isinstance(rays, Bundle):
            screen = as_float(np.asarray(rays.screen)[part])
            yield Bundle(rays.target, rays.frame, rays.inverse_range, rays.start, screen)
        else:
            yield Rays(*(as_float(np.asarray(each)[part]) for each in (rays.origin, rays.direction)))


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
    mesh = Mesh(*as_large_as_soup(lambda: (vertices, faces))())
    target = seams(rng, vertices, faces, 4000)
    target = np.resize(target[np.max(np.abs(target), axis=1) < 0.99], (4200, 3))
    angle = np.radians(elevation)
    towards = np.array([np.cos(angle) * np.cos(0.4), np.cos(angle) * np.sin(0.4), np.sin(angle)])
    rays = Rays(as_float(target + 3 * towards), as_float(np.tile(-towards, (len(target), 1))))
    assert all(np.all(any_hit(mesh, part)) for part in parts(rays))
    axes = frame(towards)
    p = target @ axes.T
    order = np.lexsort((p[:, 1], np.floor(p[:, 0] / 0.1)))
    bundle = Bundle(as_float(np.zeros(3)), as_float(axes), as_float(0.0), as_float(3.0), as_float(p[order, :2]))
    assert all(np.all(any_hit(mesh, part)) for part in parts(bundle))
    assert all(np.all(any_hit(mesh, part)) for part in parts(unrelated(bundle)))


def crossings(mesh, rays):
    """How often each ray enters, leaves and enters again, going on from each hit: a seam counts once."""
    direction = unrelated(rays).direction if isinstance(rays, Bundle) else rays.direction
    first = closest_hit(mesh, rays)
    second = closest_hit(mesh, Rays(first.point, direction), leaving=first.face)
    third = closest_hit(mesh, Rays(second.point, direction), leaving=second.face)
    return sum((np.asarray(hit.face) >= 0).astype(int) for hit in (first, second, third))


@pytest.mark.parametrize("scale", [1e-3, 1e6])
def test_seams_of_a_convex_body_are_entered_once_and_left_once(scale):
    """A flat body seen at small angles, alone, and in bundles from 1 m to 12 km, as far as no outline is near."""
    rng = np.random.default_rng(3)
    vertices, faces = sphere(3)
    mesh = Mesh(np.asarray(vertices * scale * [1, 1, 0.02], np.float32), faces)
    exact = np.asarray(mesh.vertices, np.float64)
    start, stop = faces.ravel(), faces[:, [1, 2, 0]].ravel()
    top = (exact[start, 2] > 0.013 * scale) & (exact[stop, 2] > 0.013 * scale)
    count = 4200
    pick = rng.choice(np.flatnonzero(top), count)
    weight = rng.random((count, 1)) * (rng.random((count, 1)) < 0.8)
    target = exact[start[pick]] * (1 - weight) + exact[stop[pick]] * weight
    azimuth, slope = rng.uniform(0, 2 * np.pi, count), np.exp(rng.uniform(np.log(0.06), 0, count))
    flat = np.sqrt(1 - slope**2)
    towards = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), slope], -1)
    single = Rays(as_float(target + 3 * scale * towards), as_float(-towards))
    assert all(np.all(crossings(mesh, part) == 2) for part in parts(single))
    for distance in (max(1.0, 5 * scale), max(12_000.0, 5 * scale), np.inf):
        axes = frame(towards[0])
        p = target @ axes.T
        screen = p[:, :2] / (1 - p[:, 2:] / distance)
        order = np.lexsort((screen[:, 1], np.floor(screen[:, 0] / (0.1 * scale))))
        inverse, begin = 1 / distance, 2.5 * scale
        bundle = Bundle(*map(as_float, (np.zeros(3), axes, inverse, begin, screen[order])))
        assert all(np.all(crossings(mesh, part) == 2) for part in parts(bundle))


THIN = {"needles": as_large_as_soup(functools.partial(slivers, width=1e-6))}  # 1e-6 as wide as long


@pytest.mark.parametrize("body", [*BODIES, *THIN])
def test_rays_beside_seams_meet_what_double_precision_says(body):
    """Without any margin: in float32, hits and misses are those of the given numbers, however near an edge is."""
    rng = np.random.default_rng(5)
    vertices, faces = (BODIES | THIN)[body]()
    mesh = Mesh(np.asarray(vertices, np.float32), faces)
    exact = np.asarray(mesh.vertices, np.float64)
    target = seams(rng, exact, faces, 600)[-600:]
    target += rng.normal(size=target.shape) * 10.0 ** rng.uniform(-8, -4, (600, 1))
    towards = rng.normal(size=target.shape)
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    single = Rays(as_float(target + 4 * towards), as_float(-towards))
    expected = np.isfinite(every_face(exact, faces, single)[0])
    assert np.array_equal(np.asarray(closest_hit(mesh, single).face) >= 0, expected)
    assert np.array_equal(any_hit(mesh, single), expected)

    axes = np.asarray(frame([0.3, -0.8, 0.5]), np.float32)
    for distance in (8.0, 12_000.0, np.inf):
        inverse = np.float32(1 / distance)
        p = target @ axes.T.astype(float)
        screen = np.asarray(p[:, :2] / (1 - p[:, 2:] * inverse), np.float32)
        screen = screen[np.lexsort((screen[:, 1], np.floor(screen[:, 0] / 0.5)))]
        bundle = Bundle(*map(as_float, (np.zeros(3), axes, inverse, 6.5, screen)))
        u, v, w = np.linalg.inv(axes.astype(float)).T
        lateral = screen[:, :1].astype(float) * u + screen[:, 1:].astype(float) * v
        direction = float(inverse) * lateral - w
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        expected = np.isfinite(every_face(exact, faces, Lines(lateral - 7 * direction, direction))[0])
        assert np.array_equal(np.asarray(closest_hit(mesh, bundle).face) >= 0, expected)
        assert np.array_equal(any_hit(mesh, bundle), expected)
