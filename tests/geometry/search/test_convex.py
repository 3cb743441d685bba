"""Whether a body is convex: with faces cut and vertices doubled, dents, holes, planes, and many faces."""

import tracemalloc

import numpy as np
import pytest
import trimesh

from jaxir.geometry.search import is_convex

BODIES = {
    "box": trimesh.creation.box((1.0, 0.02, 3.0)),
    "ball": trimesh.creation.icosphere(2),
    "cylinder": trimesh.creation.cylinder(0.5, 2.0, sections=24),
    "hull": trimesh.convex.convex_hull(np.random.default_rng(0).normal(size=(40, 3))),
}


def turned(vertices, dtype=np.float32):
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    return (vertices @ (turn * np.sign(np.linalg.det(turn))).T + [3.0, -2.0, 1.0]).astype(dtype)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", BODIES)
def test_bodies_however_they_are_cut(name, dtype):
    vertices, faces = BODIES[name].vertices, BODIES[name].faces
    fine = trimesh.remesh.subdivide(vertices, faces)
    soup = vertices[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)
    for points, own in ((vertices, faces), fine, soup):
        assert is_convex(turned(points, dtype), own)
        assert not is_convex(turned(points, dtype), own[:, ::-1])  # inside out
        assert not is_convex(turned(points, dtype), own[1:])  # open
    middle = np.mean(fine[0], axis=0)
    for place in (0, len(vertices), len(fine[0]) - 1):  # pushed in: a dent, pulled out: a spike amid its neighbours
        dented = fine[0].copy()
        dented[place] += 0.2 * (middle - dented[place])
        assert not is_convex(turned(dented, dtype), fine[1])
    twice = np.concatenate([vertices, vertices + 4.0]), np.concatenate([faces, faces + len(vertices)])
    assert not is_convex(turned(twice[0], dtype), twice[1])


def test_planes_are_and_folds_are_not():
    x, y = np.meshgrid(np.linspace(0, 1, 4), np.linspace(0, 2, 4))
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(16)], axis=1)
    corner = np.array([4 * i + j for i in range(3) for j in range(3)])
    faces = np.concatenate([corner[:, None] + [0, 1, 5], corner[:, None] + [0, 5, 4]])
    assert is_convex(turned(vertices), faces) and is_convex(vertices.astype(np.float32), faces[:, ::-1])
    folded = vertices + [0, 0, 0.1] * (x.ravel() > 0.5)[:, None]
    assert not is_convex(turned(folded), faces) and not is_convex(turned(folded), faces[:, ::-1])


def test_many_faces_need_little_memory():
    """A table of all faces and all corners would take 1.6 GB."""
    ball = trimesh.creation.icosphere(5)
    vertices = ball.vertices.astype(np.float32)
    tracemalloc.start()
    try:
        assert is_convex(vertices, ball.faces)
        vertices[7] *= 0.9
        assert not is_convex(vertices, ball.faces)
        assert tracemalloc.get_traced_memory()[1] < 2e8
    finally:
        tracemalloc.stop()
