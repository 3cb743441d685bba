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
    return hit, jnp.asarray(np.asarray(hit.face) >= 0)


@jax.jit
def lit_side(normal, towards):
    """As the search tells on which side of a lamp faces look, to the last bit."""
    return jnp.sum(normal * towards[None, :], axis=-1) > 0


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
    alone = any_hit(mesh, Rays(hit.point, as_float(np.tile(TOWARDS, (len(hidden), 1)))), leaving=hit.face)
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
    """Of many faces in single precision, and from several sides of as many as a torus has in double."""
    mesh = Mesh(*sphere(4 if precision == "float32" else 3))
    hit, seen = visible(mesh)
    for towards in (TOWARDS, -TOWARDS[[1, 0, 2]], np.array([0.6, 0.0, 0.8]), np.array([0.28, -0.96, 0.0])):
        lit = lit_side(hit.normal, as_float(towards))
        hidden = np.asarray(occluded(mesh, hit.point, hit.face, as_float(towards), seen))
        assert np.array_equal(hidden, np.asarray(seen) & ~np.asarray(lit)) and hidden.any() and lit.any()


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e5])
def test_rays_that_leave_a_face_do_not_meet_it_again(scale):
    """Points on an open and a closed mesh, rays to both sides, as bounces start."""
    rng = np.random.default_rng(0)
    vertices, faces = sphere(3)
    for keep in (slice(None), slice(0, -1)):
        mesh = Mesh(vertices * scale, faces[keep])
        assert mesh.closed == (keep == slice(None))
        face = rng.integers(len(faces) - 1, size=2048)
        weights = rng.dirichlet([0.3, 0.3, 0.3], size=len(face))
        point = np.einsum("rk,rki->ri", weights, np.asarray(mesh.vertices, np.float64)[faces[face]])
        outward = rng.normal(size=point.shape)
        a, b, c = np.moveaxis(np.asarray(mesh.vertices, np.float64)[faces[face]], 1, 0)
        normal = np.cross(b - a, c - a)
        outward *= np.sign(np.sum(outward * normal, axis=1, keepdims=True))
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        cosine = np.sum(outward * normal, axis=1) / np.linalg.norm(normal, axis=1)
        for part in np.split(np.arange(len(face)), 2):  # as many as points in a picture
            start, at = jnp.asarray(face[part], jnp.int32), as_float(point[part])
            out = any_hit(mesh, Rays(at, as_float(outward[part])), leaving=start)
            assert not np.any(np.asarray(out)[cosine[part] > 1e-3])
            into = np.asarray(closest_hit(mesh, Rays(at, as_float(-outward[part])), leaving=start).face)
            assert np.mean(into >= 0) > 0.99
            assert np.all(into != face[part])


def test_shadows_under_vmap_over_lamps():
    mesh = Mesh(*plates())
    hit, seen = visible(mesh)
    lamps = np.array([TOWARDS, [0, 0, 1.0], [-1.0, 0, 0]])
    both = np.asarray(jax.vmap(lambda s: occluded(mesh, hit.point, hit.face, s, seen))(as_float(lamps)))
    points = jax.vmap(lambda s: occluded_from(mesh, hit.point, hit.face, s, seen))(as_float(9 * lamps))
    for k, lamp in enumerate(lamps):
        assert np.array_equal(both[k], occluded(mesh, hit.point, hit.face, as_float(lamp), seen))
        assert np.array_equal(np.asarray(points)[k], occluded_from(mesh, hit.point, hit.face, as_float(9 * lamp), seen))
