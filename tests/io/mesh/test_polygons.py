"""Polygons of every format are cut into triangles that cover them once."""

import numpy as np
import pytest

from jaxir.io.mesh import load_mesh

L = [[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]]  # area 3
U = [[0, 0], [3, 0], [3, 3], [2, 3], [2, 1], [1, 1], [1, 3], [0, 3]]  # area 7
DART = [[2, -1], [1, 0], [2, 1], [0, 0]]  # area 1
RING = [[0, 0], [4, 0], [4, 4], [0, 4], [0, 0], [1, 1], [1, 3], [3, 3], [3, 1], [1, 1]]  # area 12, a hole by a bridge
MIDPOINTS = [[0, 0], [1, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2], [0, 1]]  # L with corners that are none
TURNED = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0]])  # the plane in space, whose normal is the third row
NORMAL = np.array([0.48, 0.64, 0.6])


def _write(path, polygons):
    """A file of polygons, each of vertices of its own."""
    points = np.concatenate([np.asarray(polygon) for polygon in polygons])
    ends = np.cumsum([len(polygon) for polygon in polygons])
    corners = [range(end - len(polygon), end) for polygon, end in zip(polygons, ends, strict=True)]
    rows = [" ".join(repr(float(x)) for x in point) for point in points]
    lists = [" ".join(map(str, (len(polygon), *polygon))) for polygon in corners]
    if path.suffix == ".obj":
        rows = [f"v {row}" for row in rows]
        lists = ["f " + " ".join(str(corner + 1) for corner in polygon) for polygon in corners]
        head = []
    elif path.suffix == ".off":
        head = ["OFF", f"{len(points)} {len(polygons)} 0"]
    else:
        head = ["ply", "format ascii 1.0", f"element vertex {len(points)}"]
        head += [f"property double {axis}" for axis in "xyz"]
        head += [f"element face {len(polygons)}", "property list uchar int vertex_indices", "end_header"]
    path.write_text("\n".join([*head, *rows, *lists]) + "\n")


@pytest.mark.filterwarnings("ignore:.* zero area")
@pytest.mark.parametrize("suffix", ["obj", "off", "ply"])
@pytest.mark.parametrize(
    ("outline", "area"),
    [(L, 3.0), (U, 7.0), (DART, 1.0), (RING, 12.0), (MIDPOINTS, 3.0)],
    ids=["L", "U", "dart", "ring", "midpoints"],
)
def test_concave_polygons_are_covered_once(suffix, outline, area, tmp_path):
    starts = range(len(outline))
    _write(tmp_path / f"a.{suffix}", [np.roll(outline, start, axis=0) @ TURNED + [5, 0, 0] for start in starts])
    mesh = load_mesh(tmp_path / f"a.{suffix}", unit="m").mesh
    assert mesh.count == len(outline) * (len(outline) - 2)
    vectors = np.asarray(mesh.area_vectors(), np.float64).reshape(len(outline), -1, 3)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=-1).sum(axis=1), area, rtol=1e-5)
    np.testing.assert_allclose(vectors.sum(axis=1), [area * NORMAL] * len(outline), atol=1e-5)


def test_convex_polygons_stay_fans(tmp_path):
    pentagon = [[0, 0, 0], [2, 0, 0], [3, 1, 0], [2, 2, 0], [0, 2, 0]]
    warped = [[0, 0, 0], [1, 0, 0], [1, 1, 0.3], [0, 1, 0]]
    _write(tmp_path / "a.obj", [pentagon, warped])
    want = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [5, 6, 7], [5, 7, 8]]
    np.testing.assert_array_equal(load_mesh(tmp_path / "a.obj", unit="m").mesh.faces, want)


@pytest.mark.parametrize(("suffix", "place"), [("obj", ":9"), ("off", ": face 0"), ("ply", ": face 0")])
@pytest.mark.parametrize("last", [[0, 1, 0], [0, 1.5, 0]])
def test_a_polygon_that_crosses_itself_is_refused(suffix, place, last, tmp_path):
    bow = [[0, 0, 0], [1, 1, 0], [1, 0, 0], last]
    _write(tmp_path / f"a.{suffix}", [bow, [[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]])
    with pytest.raises(ValueError, match=f"a.{suffix}{place}: got a polygon that crosses itself, expected a simple"):
        load_mesh(tmp_path / f"a.{suffix}", unit="m")
