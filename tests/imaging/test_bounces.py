"""Bounces as many as an error asked for needs: against long paths, in images, plans and tables."""

import functools

import jax
import numpy as np
import pytest
import trimesh

import jaxir
from jaxir import LWIR, MWIR
from jaxir.imaging import _left_out as left_out
from jaxir.io.result import sweep
from jaxir.io.result._way import read_way, write_way
from jaxir.scene import scene_nodes
from tests.scenes import warm_corner

VIEWS = [(40.0, 30.0), (10.0, 50.0), (80.0, 10.0)]
RASTER = {"shape": (32, 32), "samples": 2}


pytestmark = pytest.mark.usefixtures("one_program")


def corner(emissivity):
    return jaxir.Scene(warm_corner(emissivity))


def eye(scene):
    return jaxir.fitted_camera(*VIEWS[0], scene.extent(), (32, 32))


@functools.cache
def followed(emissivity, bounces=12):
    """A corner by paths that go on so often: what comes after 12 is a hundred thousandth."""
    scene = corner(emissivity)
    return jaxir.render(scene, eye(scene), LWIR, samples=128, rtol=0.5, method=jaxir.Method(bounces=bounces))


def test_an_image_and_a_table_follow_paths_as_far_as_is_asked():
    """What is left out stays below half of what is asked, and no more bounces than needed are followed."""
    scene, rtol = corner(0.6), 0.01
    camera = eye(scene)
    long = followed(0.6)
    true, noise = float(long.radiant_intensity()[0]), float(long.intensity_error()[0])
    plan = jaxir.plan(scene, camera, LWIR, rtol)
    image = jaxir.render(scene, camera, LWIR, rtol=rtol)
    assert image.outcome == jaxir.Outcome.tolerance_met
    bounces = image.asked.method.bounces
    assert bounces == plan.method.bounces and 0 < plan.bounces <= rtol / 2
    told = image.error_budget(look=False)
    np.testing.assert_allclose(told.bounces, plan.bounces * told.intensity, rtol=1e-3)  # no look: the plan took one
    assert f"paths go on from skin {bounces} times, and more of them would add about {plan.bounces:.2g}" in str(plan)
    off = abs(float(image.radiant_intensity()[0]) - true)
    assert off < 0.5 * rtol * true + 3 * float(image.intensity_error()[0]) + 3 * noise
    lacks = true - float(followed(0.6, bounces - 1).radiant_intensity()[0])
    assert lacks > 0.25 * rtol * true  # what is told is at most 1.35 times that, and two standard errors
    table = jaxir.signature(scene, VIEWS, LWIR, rtol=rtol, **RASTER)
    assert abs(table.asked.method.bounces - bounces) <= 1 and table.meets(rtol).all()
    each, all_told = (table.error_budget(look=look).bounces for look in (True, False))
    assert (all_told <= 0.5 * rtol * np.asarray(table.intensity)).all() and all_told.shape == each.shape == (3, 1)
    assert 0.3 < float(np.max(each / all_told)) < 1.5  # the plan's look foretells more of the series
    assert abs(float(table.intensity[0, 0]) - true) < 0.5 * rtol * true + 4 * float(table.standard_error[0, 0])


def test_pixels_to_an_error_hold_what_bounces_bring():
    scene = corner(0.3)
    camera = eye(scene)
    long = followed(0.3)
    image = jaxir.render(scene, camera, LWIR, pixel_rtol=0.1)
    assert image.outcome == jaxir.Outcome.tolerance_met and image.asked.method.bounces > 0
    seen = np.asarray(long.radiance) > 0
    apart = np.asarray(image.radiance - long.radiance)[seen]
    noise = np.mean(np.asarray(long.standard_error)[seen] ** 2)
    mean = float(np.asarray(long.radiance)[seen].mean())
    assert np.sqrt(np.mean(apart**2) - noise) < 1.3 * 0.1 * mean
    passes = jaxir.render(scene, camera, LWIR, samples=8, rtol=0.1)
    assert passes.asked.method.bounces == jaxir.plan(scene, camera, LWIR, 0.1).method.bounces > 0
    without = jaxir.render(scene, camera, LWIR, pixel_rtol=0.1, method=jaxir.Method())
    assert np.sqrt(np.mean(np.asarray(without.radiance - long.radiance)[seen] ** 2)) > 2 * 0.1 * mean


def test_a_method_that_is_given_is_kept_and_dark_or_convex_skin_needs_no_bounces():
    scene = corner(0.3)
    image = jaxir.render(scene, eye(scene), LWIR, rtol=0.1, method=jaxir.Method())
    assert image.asked.method.bounces == 0
    assert jaxir.plan(scene, eye(scene), LWIR, 0.1, method=jaxir.Method()).bounces is None
    dark = corner(0.97)
    found = jaxir.plan(dark, eye(dark), LWIR, 0.1)
    assert found.method.bounces == 0 and 0 < found.bounces < 0.05
    assert "paths go on from skin 0 times" in str(found)
    turn = np.arange(6) * np.pi / 3
    rim = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    mesh = jaxir.Mesh([[0.0, 0, 0], *rim], [[0, k + 1, (k + 1) % 6 + 1] for k in range(6)])
    plate = jaxir.Scene(jaxir.Skin(mesh, np.full(6, 300.0), jaxir.Lambert(0.3)))
    found = jaxir.plan(plate, eye(plate), LWIR, 0.1)
    assert found.method.bounces == 0 and found.bounces == 0 and "Bounces" not in str(found)


def test_bounces_that_do_not_suffice_are_told(monkeypatch):
    monkeypatch.setattr(left_out, "MOST_BOUNCES", 3)
    scene = corner(0.1)
    image = jaxir.render(scene, eye(scene), LWIR, rtol=0.01)
    assert image.asked.method.bounces == 3 and image.outcome == jaxir.Outcome.left_out


def test_where_the_first_bounces_do_not_suffice_the_next_looks_are_foretold():
    """In bands of their own, as `left_out` finds them: the fewest whose rest is allowed."""
    scene = corner(0.05)
    lit = scene.on(scene_nodes(scene, (MWIR, LWIR)))
    camera = eye(scene)
    cameras = jax.tree.map(lambda leaf: leaf[None], camera)
    least = 2 * left_out.FURTHER
    third = np.asarray(left_out.left_out(lit, cameras, jaxir.Method(bounces=least + left_out.FURTHER)))[0]
    allowed = third[9 - least]  # [bounce, band]

    def enough(method, allowed):
        return left_out.enough_bounces(lit, camera, method, lambda: np.ones(2), lambda _: allowed)[:2]

    found, left = enough(jaxir.Method(), allowed)
    assert 8 <= found <= 11 and (left <= allowed).all()
    assert enough(jaxir.Method(bounces=least), 1.01 * third[0])[0] == least


def test_what_is_seen_by_bounces_alone_is_found():
    """Of a plate that emits nothing beside a hot one edge-on: f B, f = .2 of squares with one edge in common."""
    corners = [[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [0, 1, 1]]
    mesh = jaxir.Mesh(corners, [[0, 1, 2], [0, 2, 3], [0, 3, 5], [0, 5, 4]])
    kelvin, emissivity = np.repeat([600.0, 3.0], 2), np.repeat([1.0, 0.5], 2)
    scene = jaxir.Scene(jaxir.Skin(mesh, kelvin, jaxir.Lambert(emissivity)))
    camera = jaxir.orthographic_camera(0.0, 0.0, 1 / 16, (20, 20), target=(0.5, 0.5, 0.5))
    factor = 0.200044
    true = 0.5 * factor * float(jaxir.band_radiance(600.0, jaxir.LWIR)[0])
    image = jaxir.render(scene, camera, LWIR, rtol=0.02)
    assert image.asked.method.bounces == 1 and image.outcome == jaxir.Outcome.tolerance_met
    assert abs(float(image.radiant_intensity()[0]) - true) < 3.5 * float(image.intensity_error()[0]) < 0.08 * true


def _beside_a_spot():
    """A plate of 10 x 10 m in the plane x = 0, and a hot square that faces it, edge-on for an eye at azimuth 45."""
    along, up = np.array([0.5**0.5, 0.5**0.5, 0.0]), np.array([0.0, 0.0, 1.0])
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    spot = np.array([7.2, -7.2, 0.0]) + 0.03 * square @ np.stack([along, up])
    plate = 5.0 * np.stack([0 * square[:, 0], *square.T], axis=1)
    faces = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]
    brdf = jaxir.Lambert(np.repeat([0.5, 1.0], 2))
    return jaxir.Skin(jaxir.Mesh(np.concatenate([plate, spot]), faces), np.repeat([300.0, 2500.0], 2), brdf)


def test_a_spot_that_outshines_the_skin_is_looked_for():
    """By a sum over points of the plate; of the paths that go on from it 3 in 100,000 meet the spot."""
    scene = jaxir.Scene(_beside_a_spot())
    camera = jaxir.orthographic_camera(45.0, 0.0, 1.5, (8, 8))
    image = jaxir.render(scene, camera, jaxir.SWIR, rtol=0.02)
    place = (np.arange(400) + 0.5) / 40 - 5
    apart = np.stack(np.broadcast_arrays(-7.2, place[:, None] + 7.2, place[None]), axis=-1)
    square = np.sum(apart**2, axis=-1)
    cosines = (apart @ [-(0.5**0.5), 0.5**0.5, 0.0]) * 7.2 / square
    black = float(jaxir.band_radiance(2500.0, jaxir.SWIR)[0])
    true = 0.5 / np.pi * black * 0.06**2 * np.mean(cosines / square) * 100 * 0.5**0.5
    assert isinstance(image.asked.method.skin_light, jaxir.SkinLight)
    assert abs(float(image.radiant_intensity()[0]) - true) < 0.06 * true


def test_a_view_into_a_cavity_is_looked_at_among_many():
    """A box open to the nose, of whose outside bounces bring nothing; five views spread evenly miss its inside."""
    mesh = trimesh.creation.box((4.0, 1.0, 1.0))
    walls = mesh.faces[mesh.face_normals[:, 0] < 0.5]
    skin = jaxir.Skin(jaxir.Mesh(mesh.vertices, walls), 900.0, jaxir.Lambert(0.3))
    views = [(azimuth, 0.0) for azimuth in (180, 0, 170, 90, 100, 120, 140)]
    table = jaxir.signature(jaxir.Scene(skin), views, LWIR, rtol=0.1, **RASTER)
    black = float(jaxir.band_radiance(900.0, LWIR)[0])
    assert table.asked.method.bounces > 2
    assert 0.75 * black < float(table.intensity[1, 0]) < black  # of an area of 1 m2


def test_a_way_with_the_skin_as_a_light_is_kept(tmp_path):
    chosen = jaxir.Method(skin_light=jaxir.SkinLight(), bounces=2)
    write_way(tmp_path, chosen)
    kept = read_way(tmp_path)
    assert jax.tree.structure(kept) == jax.tree.structure(chosen) and float(kept.skin_light.exponent) == 4.0


def test_a_sweep_keeps_the_way_that_was_chosen(tmp_path):
    scene, asked = corner(0.3), {**RASTER, "rtol": 0.05}
    table = sweep(tmp_path / "views", scene, VIEWS[:2], LWIR, **asked)
    method = read_way(tmp_path / "views")
    assert method.bounces == table.asked.method.bounces > 0
    more = sweep(tmp_path / "views", scene, VIEWS, LWIR, **asked)
    np.testing.assert_array_equal(more.intensity[:2], table.intensity)
    assert more.asked.method.bounces == method.bounces
    way = tmp_path / "views" / "method.json"
    for damaged in ("{", "3", '{"type": "Method", "bounces": -1}', '{"type": "Nothing"}'):
        way.write_text(damaged)
        with pytest.raises(ValueError, match=r"method\.json.*expected"):
            sweep(tmp_path / "views", scene, VIEWS, LWIR, **asked)
    way.unlink()
    with pytest.raises(ValueError, match="views without method.json"):
        sweep(tmp_path / "views", scene, VIEWS, LWIR, **asked)
