import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxir.geometry import Rays
from jaxir.geometry.search import Mesh, any_hit, closest_hit, occluded, occluded_from
from tests.geometry.search.bodies import Lines, as_float, as_large_as_soup, every_face, fins, picture, sphere, torus

TOWARDS = np.array([-0.5, 0.25, 0.4]) / np.linalg.norm([-0.5, 0.25, 0.4])


def plates():
    """Two boxes of 12 faces, one above the other: closed, and a handful."""
    corner = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-0.1, 0.1)], float)
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = np.array([t for a, b, c, d in quads for t in ([a, b, c], [a, c, d])])
    return np.concatenate([corner, corner * [0.5, 0.5, 1] + [0, 0, 1]]), np.concatenate([faces, faces + 8])


BODIES = {"torus": torus, "fins": as_large_as_soup(fins), "plates": plates}


def visible(mesh, distance=np.inf):
    bundle = picture([0.9, -0.1, 0.7], distance, width=4.0)
    hit = closest_hit(mesh, bundle)
    return hit, hit.face >= 0


def reference(mesh, hit, towards, t_max):
    """Shadows of the visible points in float64, and which of them are clear of edges and of grazing light."""
    corners = np.asarray(mesh.vertices, np.float64)[np.asarray(mesh.faces)[np.maximum(hit.face, 0)]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    lit = np.sum(normal * towards, axis=1)
    point = np.sum(corners * np.asarray(hit.barycentric, np.float64)[:, :, None], axis=1)
    t, margin = every_face(mesh.vertices, np.asarray(mesh.faces), Lines(point, towards), 1e-4, t_max)
    hidden = np.isfinite(t)
    return (hidden | (lit < 0)) if mesh.closed else hidden, (margin > 1e-4) & (np.abs(lit) > 1e-2)


@pytest.mark.parametrize("body", BODIES)
def test_parallel_light_equals_every_face(body, precision):
    mesh = Mesh(*BODIES[body]())
    assert mesh.closed == (body != "fins") and (mesh.tree is None) == (body == "plates")
    hit, seen = visible(mesh)
    hidden = np.asarray(occluded(mesh, hit.point, hit.face, as_float(TOWARDS), seen))
    assert not np.any(hidden & ~np.asarray(seen))
    expected, clear = reference(mesh, hit, np.tile(TOWARDS, (len(hidden), 1)), np.inf)
    clear &= np.asarray(seen)
    assert clear.sum() > 100 and 0.03 < expected[clear].mean() < 0.97
    assert np.array_equal(hidden[clear], expected[clear])
    alone = any_hit(mesh, Rays(hit.point, jnp.broadcast_to(as_float(TOWARDS), hit.point.shape)), leaving=hit.face)
    assert np.array_equal(np.asarray(alone)[clear], expected[clear])


@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("distance", [1.2, 8.0])
def test_point_light_equals_every_face(body, distance):
    mesh = Mesh(*BODIES[body]())
    position = TOWARDS * distance
    hit, seen = visible(mesh)
    hidden = np.asarray(occluded_from(mesh, hit.point, hit.face, as_float(position), seen))
    ray = position - np.asarray(hit.point, np.float64)
    length = np.linalg.norm(ray, axis=1)
    expected, clear = reference(mesh, hit, ray / length[:, None], length)
    clear &= np.asarray(seen)
    assert clear.sum() > 100
    assert np.array_equal(hidden[clear], expected[clear])


def test_a_convex_closed_body_never_shades_its_lit_side(precision):
    mesh = Mesh(*sphere(4))
    hit, seen = visible(mesh)
    lit = jnp.sum(hit.normal * as_float(TOWARDS)[None, :], axis=-1)
    hidden = occluded(mesh, hit.point, hit.face, as_float(TOWARDS), seen)
    assert np.array_equal(hidden, seen & (lit <= 0))


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e5])
def test_rays_that_leave_a_face_do_not_meet_it_again(scale):
    """Points on an open and a closed mesh, rays to both sides, as bounces start."""
    rng = np.random.default_rng(0)
    vertices, faces = sphere(3)
    for keep in (slice(None), slice(0, -1)):
        mesh = Mesh(vertices * scale, faces[keep])
        assert mesh.closed == (keep == slice(None))
        face = rng.integers(len(faces) - 1, size=2000)
        weights = rng.dirichlet([0.3, 0.3, 0.3], size=len(face))
        point = np.einsum("rk,rki->ri", weights, np.asarray(mesh.vertices, np.float64)[faces[face]])
        outward = rng.normal(size=point.shape)
        normal = np.asarray(mesh.area_vectors())[face]
        outward *= np.sign(np.sum(outward * normal, axis=1, keepdims=True))
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        cosine = np.sum(outward * normal, axis=1) / np.linalg.norm(normal, axis=1)
        start = jnp.asarray(face, jnp.int32)
        out = any_hit(mesh, Rays(as_float(point), as_float(outward)), leaving=start)
        assert not np.any(np.asarray(out)[cosine > 1e-3])
        into = closest_hit(mesh, Rays(as_float(point), as_float(-outward)), leaving=start)
        assert np.mean(np.asarray(into.face) >= 0) > 0.99
        assert np.all(np.asarray(into.face) != face)


def test_shadows_under_vmap_over_lamps():
    mesh = Mesh(*torus())
    hit, seen = visible(mesh)
    lamps = as_float([TOWARDS, [0, 0, 1.0], [-1.0, 0, 0]])
    both = jax.vmap(lambda s: occluded(mesh, hit.point, hit.face, s, seen))(lamps)
    points = jax.vmap(lambda s: occluded_from(mesh, hit.point, hit.face, 9 * s, seen))(lamps)
    for k, lamp in enumerate(lamps):
        assert np.array_equal(both[k], occluded(mesh, hit.point, hit.face, lamp, seen))
        assert np.array_equal(points[k], occluded_from(mesh, hit.point, hit.face, 9 * lamp, seen))
