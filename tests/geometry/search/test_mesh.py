import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxir.geometry import Hit, reattach
from jaxir.geometry.search import HANDFUL, Mesh, build, closest_hit, is_closed
from tests.geometry.search.bodies import as_float, fins, incoherent, picture, soup, sphere, torus, unrelated


@pytest.mark.parametrize("count", [33, 256, 257, 1000, 4097, 70000])
def test_the_tree_holds_every_face_once_in_full_leaves(count):
    rng = np.random.default_rng(0)
    vertices = rng.normal(size=(3 * count, 3)).astype(np.float32)
    tree = build(vertices, np.arange(3 * count).reshape(-1, 3))
    face, slots = np.asarray(tree.face).ravel(), tree.face.shape[1]
    assert np.array_equal(np.sort(face[face >= 0]), np.arange(count))
    assert slots % 4 == 0 and slots <= 16 and (count < 300 or face.size < 1.55 * count)


def test_boxes_hold_what_lies_below_them():
    vertices, faces = soup()
    tree = build(vertices.astype(np.float32), faces)
    slots = tree.face.shape[1]
    leaves = np.asarray(tree.leaves)[:, : 15 * slots].reshape(-1, 3, 5, slots)
    for octant in range(8):
        child = np.asarray(tree.children[-1]).reshape(8, -1)[octant]
        box = np.asarray(tree.boxes[-1]).reshape(8, -1, 2, 3, 16)[octant].transpose(0, 3, 1, 2).reshape(-1, 2, 3)
        for number, (low, high) in zip(child, box, strict=True):
            if number >= 0:
                there = np.any(leaves[number] != 0, axis=(0, 1))
                assert np.all(leaves[number][:, :, there].min((1, 2)) >= low)
                assert np.all(leaves[number][:, :, there].max((1, 2)) <= high)


def test_closed_means_a_solid_that_looks_outwards():
    vertices, faces = torus()
    assert is_closed(vertices, faces)
    assert is_closed(vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3))
    assert is_closed(np.concatenate([vertices, vertices + 9]), np.concatenate([faces, faces + len(vertices)]))
    assert not is_closed(vertices, faces[:, ::-1])
    assert not is_closed(vertices, faces[1:])
    assert not is_closed(vertices, np.concatenate([faces[:1, ::-1], faces[1:]]))
    assert not is_closed(vertices, np.concatenate([faces, faces]))
    inside_out = np.concatenate([faces, faces[:, ::-1] + len(vertices)])
    assert not is_closed(np.concatenate([vertices, vertices * 0.9]), inside_out)
    assert not is_closed(*fins())
    sheet = np.array([[0, 1, 2], [2, 1, 0]])
    assert not is_closed(np.eye(3), sheet)


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (np.zeros((3, 3)), np.zeros((0, 3), int), "got 0 faces"),
        (
            np.zeros((3, 3)),
            np.broadcast_to(np.arange(3), (2**27 + 1, 3)),
            "got 134217729 faces, expected 1 to 134217728",
        ),
        (np.zeros((3, 3)), [[0, 1, 3]], "indices 0 to 3"),
        (np.zeros((3, 3)), [[0, -1, 2]], "indices -1 to 2"),
        (np.zeros((3, 3)), [[0.0, 1.0, 2.0]], "expected integers"),
        (np.zeros((3, 2)), [[0, 1, 2]], "got shape"),
        ([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]], [[0, 1, 2]], "Mesh.vertices: got nan"),
        ([[0, 0, 0], [1, 0, 0], [0, 1e12, 0]], [[0, 1, 2]], "values below"),
    ],
)
def test_bad_meshes_are_refused_with_what_was_wrong(vertices, faces, message):
    with pytest.raises(ValueError, match=message):
        Mesh(vertices, np.asarray(faces))


def test_under_jit_only_a_handful_of_faces_can_be_built():
    vertices, faces = sphere(1)
    few = jax.jit(lambda v: Mesh(v, faces[:HANDFUL]).count)
    assert few(as_float(vertices)) == HANDFUL
    with pytest.raises(ValueError, match="refit"):
        jax.jit(lambda v: Mesh(v, faces).count)(as_float(vertices))
    with pytest.raises(ValueError, match="got shape"):
        Mesh(vertices, faces).refit(vertices[1:])


def by_differences(function, x, direction, step=1e-5):
    """Derivative of a function along a direction, to the fourth order of the step."""

    def at(h):
        return float(function(jax.tree.map(lambda a, b: np.asarray(a) + h * b, x, direction)))

    one, two = (at(h) - at(-h) for h in (step, 2 * step))
    return (8 * one - two) / (12 * step)


@pytest.mark.parametrize("body", [torus, soup])
@pytest.mark.parametrize("route", ["bundle", "single"])
def test_gradients_of_a_hit_equal_central_differences(body, route, x64):
    """In the vertices and in the rays; differences with the faces held, because visibility has no derivative."""
    rng = np.random.default_rng(4)
    mesh = Mesh(*body())
    rays = picture([0.3, -0.8, 0.5], 30.0) if route == "bundle" else incoherent(rng)
    weights = [as_float(rng.normal(size=(rays.count, length))) for length in (1, 3, 3, 3)]
    still = jax.tree.map(lambda x: as_float(np.zeros(x.shape)), rays)
    found = closest_hit(mesh, rays)

    # differences suffer where a face is thin or grazed: their step must be small against height times slope
    p = np.asarray(mesh.vertices)[np.asarray(mesh.faces)[np.maximum(np.asarray(found.face), 0)]]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    area = np.linalg.norm(normal, axis=1)
    height = area / np.linalg.norm(p - np.roll(p, 1, axis=1), axis=2).max(axis=1)
    direction = (unrelated(rays) if route == "bundle" else rays).direction
    slope = np.abs(np.sum(normal * np.asarray(direction), axis=1)) / np.where(area > 0, area, 1)
    met = jnp.asarray((np.asarray(found.face) >= 0) & (height > 0.05) & (slope > 0.1))
    assert np.asarray(met).sum() > 30
    moved = jax.jit(lambda vertices, shift: (mesh.refit(vertices), jax.tree.map(jnp.add, rays, shift)))

    @jax.jit
    def total(hit):
        parts = [jnp.where(met, hit.t, 0.0)[:, None], hit.barycentric, hit.point, hit.normal]
        return sum(jnp.sum(jnp.where(met[:, None], w * p, 0)) for w, p in zip(weights, parts, strict=True))

    def searched(vertices, shift):
        return total(closest_hit(*moved(vertices, shift)))

    @jax.jit
    def held(vertices, shift):
        shifted = jax.tree.map(jnp.add, rays, shift)
        single = shifted.rays() if route == "bundle" else shifted
        return total(Hit(found.face, *reattach(vertices, mesh.faces, found.face, single.origin, single.direction)))

    at = (mesh.vertices, still)
    reverse = jax.grad(searched, argnums=(0, 1))(*at)
    assert all(np.all(np.isfinite(g)) for g in jax.tree.leaves(reverse))
    for k in range(2):
        step = jax.tree.map(lambda x: rng.normal(size=x.shape) * (x.size > 1), at[k])
        expected = by_differences(lambda x, k=k: held(x, still) if k == 0 else held(mesh.vertices, x), at[k], step)
        slope = sum(np.vdot(g, s) for g, s in zip(jax.tree.leaves(reverse[k]), jax.tree.leaves(step), strict=True))
        assert np.isclose(slope, expected, rtol=1e-6)
    step = as_float(rng.normal(size=mesh.vertices.shape))
    _, forward = jax.jvp(lambda v: searched(v, still), (mesh.vertices,), (step,))
    assert np.isclose(forward, np.vdot(reverse[0], step), rtol=1e-9)


def test_misses_have_zero_derivatives_and_visibility_has_none(x64):
    vertices, faces = torus()
    mesh = Mesh(vertices, faces)
    bundle = picture([0.3, -0.8, 0.5], 30.0)
    assert np.any(np.asarray(closest_hit(mesh, bundle).face) < 0)

    def seen(v):
        hit = closest_hit(mesh.refit(v), bundle)
        return jnp.sum(jnp.where(hit.face >= 0, 1.0, 0.0)), jnp.where((hit.face < 0)[:, None], hit.normal, 0).sum()

    curved = jax.hessian(lambda s: jnp.sum(closest_hit(mesh.refit(mesh.vertices * s), bundle).point))
    (area, rest), hessian = jax.jit(lambda v, s: (jax.jacrev(seen)(v), curved(s)))(mesh.vertices, 1.1)
    assert not np.any(area) and not np.any(rest)
    assert np.isfinite(hessian)
