import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxir.geometry import Rays
from jaxir.geometry.search import Mesh, _lockstep, any_hit, closest_hit, occluded
from tests.geometry.search.bodies import (
    BODIES,
    as_float,
    as_large_as_soup,
    every_face,
    fins,
    incoherent,
    picture,
    soup,
    sphere,
    torus,
    unrelated,
)

TOLERANCE = {"float32": 2e-5, "float64": 1e-12}


def agree(mesh, hit, hidden, t, margin, tolerance):
    """Hits are those of the reference, but for rays that pass within rounding of an edge."""
    t_found = np.asarray(hit.t, np.float64)
    same = np.isclose(t_found, t, rtol=0, atol=50 * tolerance)
    clear = margin > tolerance
    assert clear.mean() > 0.95
    assert np.all(same[clear]), np.flatnonzero(~same & clear)
    assert np.array_equal(np.asarray(hidden)[clear], np.isfinite(t)[clear])
    assert np.array_equal(np.isfinite(t_found), np.asarray(hit.face) >= 0)


@pytest.mark.parametrize("body", BODIES)
def test_single_rays_meet_what_every_face_says(body, precision):
    vertices, faces = BODIES[body]()
    mesh = Mesh(vertices, faces)
    rays = incoherent(np.random.default_rng(3))
    t, margin = every_face(mesh.vertices, faces, rays)
    agree(mesh, closest_hit(mesh, rays), any_hit(mesh, rays), t, margin, TOLERANCE[precision])


@pytest.mark.parametrize(("body", "distance"), [*((body, 9.0) for body in BODIES), ("torus", 12e3), ("soup", np.inf)])
def test_bundles_meet_what_every_face_says(body, distance, precision):
    vertices, faces = BODIES[body]()
    mesh = Mesh(vertices, faces)
    bundle = picture([0.3, -0.8, 0.5], distance)
    t, margin = every_face(mesh.vertices, faces, unrelated(bundle))
    agree(mesh, closest_hit(mesh, bundle), any_hit(mesh, bundle), t, margin, TOLERANCE[precision])


def test_bundle_that_starts_inside_the_mesh_or_looks_from_inside():
    vertices, faces = sphere()
    mesh = Mesh(vertices, faces)
    for start, distance in ((0.3, 50.0), (0.5, 1.0)):
        bundle = picture([0.3, -0.8, 0.5], distance, width=1.0, start=start)
        t, _ = every_face(mesh.vertices, faces, unrelated(bundle))
        assert np.allclose(closest_hit(mesh, bundle).t, t, atol=1e-5)
        t_max = np.where(np.arange(bundle.count) % 3, np.float32(np.median(t)), 0)  # some rays are inactive
        limited = closest_hit(mesh, bundle, t_max=jnp.asarray(t_max)).t
        assert np.isfinite(limited).any() and np.allclose(limited, np.where(t < t_max, t, np.inf), atol=1e-5)


@pytest.mark.parametrize("distance", [9.0, np.inf])
def test_limits_of_distance_hold_in_both_routes(distance, x64):
    vertices, faces = torus()
    mesh = Mesh(vertices, faces)
    bundle = picture([0.9, -0.3, 0.2], distance, start=3.5)
    rays = unrelated(bundle)
    for t_min, t_max in ((0.0, 3.0), (2.0, np.inf), (1.5, 4.0)):
        t, margin = every_face(vertices, faces, rays, t_min, t_max)
        assert np.isfinite(t).any()
        for shape in (bundle, rays):
            agree(mesh, closest_hit(mesh, shape, t_min, t_max), any_hit(mesh, shape, t_min, t_max), t, margin, 1e-9)


def test_rays_without_an_interval_are_inactive():
    vertices, faces = sphere()
    mesh = Mesh(vertices, faces)
    bundle = picture([0.3, -0.8, 0.5], 9.0)
    on = np.arange(bundle.count) % 3 == 0
    t_max = as_float(np.where(on, np.inf, 0.0))
    for shape in (bundle, unrelated(bundle)):
        expected = np.asarray(closest_hit(mesh, shape).face)
        assert np.array_equal(closest_hit(mesh, shape, t_max=t_max).face, np.where(on, expected, -1))
        assert np.array_equal(any_hit(mesh, shape, t_max=t_max), on & (expected >= 0))


@pytest.mark.parametrize("count", [1, 2, 12])
def test_a_handful_of_faces_has_no_tree(count, precision):
    vertices, faces = soup(1, 60)
    mesh = Mesh(vertices, faces[:count])
    assert mesh.tree is None
    rays = incoherent(np.random.default_rng(5))
    t, margin = every_face(mesh.vertices, faces[:count], rays)
    agree(mesh, closest_hit(mesh, rays), any_hit(mesh, rays), t, margin, TOLERANCE[precision])


def test_faces_without_area_are_never_met(precision):
    """A line of three corners, a doubled corner, a point: a handful of them, and within a tree."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [3, 0, 0], [0, 1, 0]], float) * 0.3
    flat = np.array([[0, 1, 2], [0, 1, 1], [3, 3, 3]])
    above = np.array([[0.1, 0, 5], [0.3, 0, 5], [0, 0.3, 5], [0, 0, 5]])
    rays = Rays(as_float(np.resize(above, (500, 3))), as_float(np.tile([0, 0, -1], (500, 1))))
    for count, corners in ((12, 180), (700, 2100)):  # as many as other tests have, whose programs serve here, too
        mesh = Mesh(np.resize(vertices, (corners, 3)), np.resize(flat, (count, 3)))
        assert (mesh.tree is None) == (count == 12)
        hit = closest_hit(mesh, rays)
        assert np.all(np.asarray(hit.face) == -1)
        assert not np.any(any_hit(mesh, rays))
        assert np.all(np.isfinite(hit.point)) and np.all(np.asarray(hit.normal) == 0)


def test_a_ray_without_direction_meets_nothing(precision):
    mesh = Mesh(*sphere())
    rays = Rays(as_float(np.resize([[0.0, 0, 0], [2.0, 0, 0]], (500, 3))), as_float(np.zeros((500, 3))))
    hit = closest_hit(mesh, rays)
    assert np.all(np.asarray(hit.face) == -1) and np.all(np.isfinite(hit.point))


def test_axis_parallel_rays_in_the_planes_of_boxes(precision):
    """Directions with zeros, along flat boxes and through vertices, meet a plate face on and not edge on."""
    vertices, faces = fins()
    vertices = vertices[:81] @ np.array([[np.cos(0.1), -np.sin(0.1), 0], [np.sin(0.1), np.cos(0.1), 0], [0, 0, 1.0]])
    vertices[:, 1] = 0
    mesh = Mesh(*as_large_as_soup(lambda: (vertices, faces[:128]))())
    points = np.asarray(mesh.vertices)[:81]
    inner = (points[:, 0] > 0.1) & (points[:, 0] < 1.9) & (np.abs(points[:, 2]) < 0.9)
    points = np.resize(points[inner], (500, 3))
    across = Rays(as_float(points + [0, 3, 0]), as_float(np.tile([0, -1.0, 0], (500, 1))))
    assert np.all(np.asarray(closest_hit(mesh, across).face) >= 0)
    along = Rays(as_float(points + [5, 0, 0]), as_float(np.tile([-1.0, 0, 0], (500, 1))))
    assert np.all(np.asarray(closest_hit(mesh, along).face) == -1)


def test_moving_the_mesh_with_refit_equals_building_it_anew(precision):
    vertices, faces = torus()
    moved = vertices * [1.0, 1.3, 0.8] + [0.5, 0.1, -0.2]
    mesh = jax.jit(lambda mesh, v: mesh.refit(v))(Mesh(vertices, faces), as_float(moved))
    anew = Mesh(moved, faces)
    assert mesh.closed
    for rays in (picture([0.3, -0.8, 0.5], 9.0), incoherent(np.random.default_rng(1))):
        assert np.mean(np.asarray(closest_hit(mesh, rays).face) == np.asarray(closest_hit(anew, rays).face)) > 0.99
        assert np.allclose(closest_hit(mesh, rays).t, closest_hit(anew, rays).t, atol=TOLERANCE[precision] * 50)


def test_vmap_over_rays_over_views_and_over_meshes():
    vertices, faces = torus()
    mesh = Mesh(vertices, faces)
    rays = incoherent(np.random.default_rng(2))
    face = np.asarray(closest_hit(mesh, rays).face)
    split = jax.tree.map(lambda x: x.reshape(4, 125, 3), rays)
    views = [picture(w, 9.0) for w in ([1, 0, 0.2], [0.3, 1, 0.1])]
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *views)

    @jax.jit
    def together(split, scale, stacked):
        return (
            jax.vmap(lambda r: closest_hit(mesh, r).face)(split),
            jax.vmap(lambda s: closest_hit(mesh.refit(mesh.vertices * s), rays).face)(scale),
            jax.vmap(lambda b: closest_hit(mesh, b).face)(stacked),
        )

    in_parts, faces_scaled, found = map(np.asarray, together(split, as_float([1.0, 1.5]), stacked))
    assert np.array_equal(in_parts.ravel(), face)
    assert np.array_equal(faces_scaled[0], face)
    larger = jax.jit(lambda mesh, s: mesh.refit(mesh.vertices * s))(mesh, as_float(1.5))
    assert np.array_equal(faces_scaled[1], closest_hit(larger, rays).face)
    for k, view in enumerate(views):
        assert np.array_equal(found[k], closest_hit(mesh, view).face)


def test_rays_can_be_sharded():
    vertices, faces = torus()
    mesh = Mesh(vertices, faces)
    devices = jax.make_mesh((1,), ("ray",), axis_types=(jax.sharding.AxisType.Auto,))
    spec, whole = jax.sharding.PartitionSpec("ray"), jax.sharding.PartitionSpec()
    rays = incoherent(np.random.default_rng(2))
    bundle = picture([1, 0, 0.2], 9.0)

    def both(mesh, rays, screen):
        part = type(bundle)(bundle.target, bundle.frame, bundle.inverse_range, bundle.start, screen)
        return closest_hit(mesh, rays).face, closest_hit(mesh, part).face

    sharded = jax.jit(jax.shard_map(both, mesh=devices, in_specs=(whole, spec, spec), out_specs=(spec, spec)))
    single, tiles = sharded(mesh, rays, bundle.screen)
    assert np.array_equal(single, closest_hit(mesh, rays).face)
    assert np.array_equal(tiles, closest_hit(mesh, bundle).face)


@pytest.mark.parametrize("walks", [False, True])
def test_what_an_accelerator_would_run_finds_the_same(monkeypatch, walks):
    """Where it tests every face, and where it walks a tree, here of two levels."""
    vertices, faces = sphere()
    mesh, sun = Mesh(vertices, faces), as_float([0.0, 0.6, 0.8])
    rays, bundle = incoherent(np.random.default_rng(5)), picture([0.3, -0.8, 0.5], 9.0)
    # rays through vertices are in doubt, and so are searched again
    aimed = np.asarray(mesh.vertices)[:150] - np.asarray(rays.origin)[:150]
    aimed = np.concatenate([aimed / np.linalg.norm(aimed, axis=1, keepdims=True), np.asarray(rays.direction)[150:]])

    def found(more):
        """With the last ray repeated: what was compiled before has another shape."""
        at = np.minimum(np.arange(rays.count + more), rays.count - 1)
        hit = closest_hit(mesh, Rays(as_float(np.asarray(rays.origin)[at]), as_float(aimed[at])))
        at = np.minimum(np.arange(bundle.count + more), bundle.count - 1)
        seen = closest_hit(mesh, eqx.tree_at(lambda b: b.screen, bundle, as_float(np.asarray(bundle.screen)[at])))
        hidden = occluded(mesh, seen.point, seen.face, sun, jnp.asarray(np.asarray(seen.face) >= 0))
        return [np.asarray(value, float)[: len(value) - more] for value in (hit.t, seen.t, seen.normal, hidden)]

    native, taken = found(0), []

    def elsewhere():
        taken.append(1)
        return "gpu"

    monkeypatch.setattr(jax, "default_backend", elsewhere)
    monkeypatch.setattr(_lockstep, "FEW", 0 if walks else len(faces))
    lockstep = found(2 if walks else 1)
    assert len(taken) >= 5 and len(mesh.tree.children) == 2
    for one, other in zip(native, lockstep, strict=True):
        np.testing.assert_allclose(other, one, rtol=2e-5, atol=2e-5)
