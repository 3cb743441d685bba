"""Faces by place, direction, connection and name: counted by hand on boxes."""

import numpy as np
import pytest

import jaxir
from jaxir.geometry.selection import Complement, Intersection, Union
from jaxir.io.mesh import Body
from tests.scenes import box_mesh

# Two unit cubes about (0, 0, 0) and (3, 0, 0), of twelve faces each.
CUBES = [box_mesh(), box_mesh(centre=(3.0, 0.0, 0.0))]
MESH = jaxir.Mesh(
    np.concatenate([np.asarray(cube.vertices) for cube in CUBES]),
    np.concatenate([np.asarray(CUBES[0].faces), np.asarray(CUBES[1].faces) + 8]),
)
SECOND = np.arange(24) >= 12
BODY = Body(MESH, SECOND.astype(np.int32), ("aft", "fore"), np.arange(24, dtype=np.int32) % 2, ("black", "white"))
TOP = np.flatnonzero((np.asarray(MESH.corners())[:, :, 2] == 0.5).all(axis=1))


@pytest.mark.parametrize(
    ("selection", "count"),
    [
        (jaxir.InBox(x=(-1, 1)), 12),
        (jaxir.InBox(x=(-1, 1), z=(0.4, np.inf)), 2),
        (jaxir.AbovePlane((1.0, 0.0, 0.0), (2.0, 0.0, 0.0)), 12),
        (jaxir.InCylinder((2.4, 0.0, 0.0), (3.6, 0.0, 0.0), 0.3), 4),  # centres of the ends lie 0.24 m from the axis
        (jaxir.Facing((0.0, 0.0, 3.0)), 4),
        (jaxir.Facing((1.0, 1.0, 0.0), 45.01), 8),
        (jaxir.Facing((1.0, 1.0, 0.0), 44.99), 0),
        (jaxir.Connected((3.0, 0.0, 0.5)), 12),
        (jaxir.Connected((3.0, 0.0, 0.6), crease=89), 2),
        (jaxir.OfPart("fore"), 12),
        (jaxir.OfMaterial(["white"]), 12),
        (jaxir.OfPart("fore") & jaxir.Facing((0, 0, 1)), 2),
        (jaxir.OfPart("aft") | jaxir.Facing((0, 0, 1)), 14),
        (~jaxir.Facing((0, 0, 1)), 20),
        (jaxir.OfPart(["fore", "aft"]), 24),
    ],
)
def test_faces_are_those_that_one_counts(selection, count):
    if count in (0, 24):
        caught = "no face" if count == 0 else "every face"
        with pytest.raises(ValueError, match=rf"catches {caught} of 24, which span x -0.5 to 3.5, .* expected some"):
            BODY.select(selection)
    else:
        assert BODY.select(selection).size == count


def test_sets_are_those_of_python():
    top, fore = jaxir.Facing((0, 0, 1)), jaxir.OfPart("fore")
    assert (top & fore, top | fore, ~top) == (Intersection((top, fore)), Union((top, fore)), Complement(top))
    np.testing.assert_array_equal(BODY.select(top), TOP)


def test_a_region_needs_no_shared_vertices_and_no_order_of_corners():
    """A scan, whose faces have corners of their own and look inwards here and there."""
    corners = np.asarray(MESH.corners(), np.float64)
    corners[::3] = corners[::3, ::-1]
    torn = Body(jaxir.Mesh(corners.reshape(-1, 3), np.arange(72).reshape(-1, 3)), np.zeros(24, np.int32), ("scan",))
    np.testing.assert_array_equal(torn.select(jaxir.Connected((3.0, 0.0, 0.5))), np.flatnonzero(SECOND))
    assert torn.select(jaxir.Connected((3.0, 0.0, 0.6), crease=45)).size == 2


def test_a_flap_is_cut_from_its_wing_at_the_bend():
    bend = np.deg2rad(30)
    along = np.array([[0.0, 0.0], [1.0, 0.0], [1.0 + np.cos(bend), -np.sin(bend)]])
    vertices = np.array([[x, y, z] for x, z in along for y in (0.0, 1.0)])
    faces = [[0, 2, 3], [0, 3, 1], [2, 4, 5], [2, 5, 3]]
    wing = Body(jaxir.Mesh(vertices, np.array(faces)), np.zeros(4, np.int32), ("wing",))
    np.testing.assert_array_equal(wing.select(jaxir.Connected((0.2, 0.5, 0.0), crease=29.9)), [0, 1])
    with pytest.raises(ValueError, match="every face"):
        wing.select(jaxir.Connected((0.2, 0.5, 0.0), crease=30.1))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: jaxir.InBox(x=(1, 0)), r"InBox.x: got \(1, 0\), expected two numbers .m., the lower first"),
        (lambda: jaxir.AbovePlane((0, 0, 0), (0, 0, 0)), r"AbovePlane.normal: got \(0, 0, 0\), expected a direction"),
        (lambda: jaxir.InCylinder((0, 0, 0), (0, 0, 0), 1.0), "InCylinder.end: got .* which is its start"),
        (lambda: jaxir.InCylinder((0, 0, 0), (1, 0, 0), -1.0), "InCylinder.radius: got -1.0, expected a number > 0"),
        (lambda: jaxir.Facing("up"), "Facing.direction: got 'up', expected three finite numbers"),
        (lambda: jaxir.Facing((1, 0, 0), 270), "Facing.within: got 270, expected degrees above 0, at most 180"),
        (lambda: jaxir.Connected((0, 0)), r"Connected.point: got \(0, 0\), expected three finite numbers"),
        (lambda: Union(()), r"Union.of: got \(\), expected at least one selection"),
        (lambda: Complement("fore"), "Complement.of: got 'fore', expected a selection of faces"),
        (lambda: BODY.select(jaxir.OfPart("wing")), r"OfPart.parts: got \['wing'\], expected some of aft, fore"),
        (lambda: BODY._replace(material=np.zeros(0)).select(jaxir.OfMaterial("a")), "a mesh without materials"),
        (lambda: BODY.with_part("aft", jaxir.Facing((0, 0, 1))), "got the name 'aft', expected a new one; aft, fore"),
    ],
)
def test_what_is_no_selection_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_a_part_of_a_skin_is_painted_warmed_and_named():
    skin = jaxir.Skin(MESH, 300.0, jaxir.Lambert(0.8), BODY.part, BODY.part_names)
    hot = skin.with_part("top", jaxir.Facing((0, 0, 1)), 400.0, jaxir.Lambert(0.3))
    assert hot.part_names == ("aft", "fore", "top") and np.flatnonzero(np.asarray(hot.part) == 2).tolist() == [*TOP]
    np.testing.assert_allclose(hot.temperature, np.where(np.isin(np.arange(24), TOP), 400, 300))
    np.testing.assert_allclose(hot.brdf.emissivity[:, 0], np.where(np.isin(np.arange(24), TOP), 0.3, 0.8), rtol=1e-6)
    metal = hot.with_part("nose", jaxir.InBox(x=(3.4, 4.0)), brdf=jaxir.RoughConductor(3.0, 8.0, 0.4))
    assert [type(kind) for kind in metal.brdf.kinds] == [jaxir.Lambert, jaxir.RoughConductor]
    assert np.asarray(metal.brdf.kind).sum() == 2 and metal.temperature.max() == 400
    with pytest.raises(ValueError, match=r"Skin.temperature: got shape \(3,\), expected one value or \(4,\)"):
        skin.with_part("top", jaxir.Facing((0, 0, 1)), [1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match="brdf: got parameters of 2 faces, expected those of one"):
        skin.with_part("top", jaxir.Facing((0, 0, 1)), brdf=jaxir.Lambert([0.1, 0.2]))
