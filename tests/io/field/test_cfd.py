import sys

import numpy as np
import pytest
import pyvista

from jaxir.io.field import load_flow


def temperature(points):
    return 300 + 100 * points[:, 0] + 50 * points[:, 1] - 20 * points[:, 2]


def image(cells=(8, 6, 4), size=(2.0, 1.5, 1.0)):
    data = pyvista.ImageData(
        dimensions=tuple(n + 1 for n in cells), spacing=tuple(s / n for s, n in zip(size, cells, strict=True))
    )
    data.point_data["T"] = temperature(np.asarray(data.points))
    data.cell_data["CO2"] = np.arange(data.n_cells) / data.n_cells
    data.cell_data["U"] = np.zeros((data.n_cells, 3))
    return data


@pytest.mark.parametrize("name", ["flow.vti", "flow.vtu", "flow.vtk"])
def test_a_linear_field_and_a_cellwise_one_come_through(tmp_path, name):
    data = image()
    (data if name.endswith("vti") else data.cast_to_unstructured_grid()).save(tmp_path / name)
    flow = load_flow(tmp_path / name, {"T": 300.0, "CO2": 0.0}, unit="m", shape=(8, 6, 4))
    assert flow.grid.shape == (8, 6, 4) and flow.covered == 1
    want = temperature(np.asarray(flow.grid.centres()).reshape(-1, 3)).reshape(8, 6, 4)
    np.testing.assert_allclose(flow.fields["T"], want, rtol=1e-5)
    np.testing.assert_allclose(flow.fields["CO2"], data.cell_data["CO2"].reshape(4, 6, 8).transpose(2, 1, 0), atol=1e-9)
    for report in flow.report.values():
        assert report.rms < 1e-5 * report.span and abs(report.integral) < 1e-6
    assert "T: rms" in flow.describe() and "100.0% of the grid" in flow.describe()


def test_units_box_and_values_beyond_the_data(tmp_path):
    image().save(tmp_path / "flow.vti")
    flow = load_flow(
        tmp_path / "flow.vti", {"T": 288.0}, unit="mm", shape=(4, 3, 2), box=[[0, 0, 0], [4e-3, 1.5e-3, 1e-3]]
    )
    np.testing.assert_allclose(flow.grid.spacing, [1e-3, 0.5e-3, 0.5e-3], rtol=1e-6)
    assert (flow.fields["T"][2:] == 288.0).all() and (flow.fields["T"][:2] > 299).all()
    assert flow.covered == 0.5


def test_the_report_tells_a_coarse_grid_from_a_fine_one(tmp_path):
    data = image((40, 12, 12))
    points = np.asarray(data.points)
    data.point_data["T"] = 300 + 900 * np.exp(-8 * ((points[:, 1] - 0.75) ** 2 + (points[:, 2] - 0.5) ** 2))
    data.save(tmp_path / "flow.vti")
    coarse, fine = (
        load_flow(tmp_path / "flow.vti", {"T": 300.0}, unit="m", shape=shape).report["T"]
        for shape in ((40, 3, 3), (40, 12, 12))
    )
    assert 0.05 * coarse.span < coarse.rms <= coarse.largest
    assert fine.rms < 0.03 * fine.span and abs(fine.integral) < 0.01


def _foam(path, kind, body):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"FoamFile\n{{\n version 2.0;\n format ascii;\n class {kind};\n object {path.name};\n}}\n{body}\n")


def _list(items):
    return f"{len(items)}\n(\n" + "\n".join(items) + "\n)"


def foam_case(folder):
    """Two unit cubes along x with temperatures 400 and 800 at time 0, 500 and 900 at time 2."""
    points = [(x, y, z) for x in range(3) for y in range(2) for z in range(2)]
    number = {p: i for i, p in enumerate(points)}

    def face(*corners):
        return "4(" + " ".join(str(number[c]) for c in corners) + ")"

    faces, owner = [face((1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0, 1))], [0]
    faces.append(face((0, 0, 0), (0, 0, 1), (0, 1, 1), (0, 1, 0)))
    owner.append(0)
    faces.append(face((2, 0, 0), (2, 1, 0), (2, 1, 1), (2, 0, 1)))
    owner.append(1)
    for x in (0, 1):
        a, b = x, x + 1
        faces += [
            face((a, 0, 0), (b, 0, 0), (b, 0, 1), (a, 0, 1)),
            face((a, 1, 0), (a, 1, 1), (b, 1, 1), (b, 1, 0)),
            face((a, 0, 0), (a, 1, 0), (b, 1, 0), (b, 0, 0)),
            face((a, 0, 1), (b, 0, 1), (b, 1, 1), (a, 1, 1)),
        ]
        owner += [x] * 4
    mesh = folder / "constant" / "polyMesh"
    _foam(mesh / "points", "vectorField", _list([f"({x} {y} {z})" for x, y, z in points]))
    _foam(mesh / "faces", "faceList", _list(faces))
    _foam(mesh / "owner", "labelList", _list([str(o) for o in owner]))
    _foam(mesh / "neighbour", "labelList", _list(["1"]))
    _foam(mesh / "boundary", "polyBoundaryMesh", "1\n(\n walls { type wall; nFaces 10; startFace 1; }\n)")
    _foam(folder / "system" / "controlDict", "dictionary", "startTime 0;\nendTime 2;\ndeltaT 2;\nwriteInterval 1;")
    for time, values in (("0", "400 800"), ("2", "500 900")):
        body = f"dimensions [0 0 0 1 0 0 0];\ninternalField nonuniform List<scalar> 2({values});\n"
        _foam(folder / time / "T", "volScalarField", body + "boundaryField { walls { type zeroGradient; } }")
    (folder / "case.foam").touch()
    return folder / "case.foam"


def test_an_openfoam_case_is_read_at_its_last_time_or_at_one_asked_for(tmp_path):
    case = foam_case(tmp_path)
    for time, want in ((None, (500, 900)), (0.0, (400, 800))):
        flow = load_flow(case, {"T": 300.0}, unit="m", shape=(2, 1, 1), time=time)
        np.testing.assert_allclose(flow.fields["T"][:, 0, 0], want, rtol=1e-6)
    with pytest.raises(ValueError, match=r"case.foam: time 7.0 not found, the file holds \[0.0, 2.0\]"):
        load_flow(case, {"T": 300.0}, unit="m", shape=(2, 1, 1), time=7.0)


def test_errors_name_file_field_and_what_was_found(tmp_path):
    image().save(tmp_path / "flow.vti")
    broken = image()
    broken.point_data["T"][5] = np.nan
    broken.save(tmp_path / "nan.vti")
    pyvista.Sphere().save(tmp_path / "skin.vtp")
    (tmp_path / "bad.vtu").write_text("hello")
    (tmp_path / "what.xyzzy").write_text("hello")
    turned = pyvista.RectilinearGrid([0.0, 1.0], [0.0, 2.0, 1.0], [0.0, 1.0])
    turned.point_data["T"] = np.full(turned.n_points, 500.0)
    turned.save(tmp_path / "turned.vtr")

    def load(name, fields=("T",), **more):
        return load_flow(tmp_path / name, dict.fromkeys(fields, 300.0), **{"unit": "m", "shape": (2, 2, 2), **more})

    for call, message in (
        (lambda: load("none.vti"), "none.vti: no such file"),
        (
            lambda: load("flow.vti", ["p"]),
            r"flow.vti: field 'p' not found, .* point data \['T'\] and cell data \['CO2'",
        ),
        (lambda: load("flow.vti", ["U"]), "flow.vti: field 'U' has 3 components, expected a scalar"),
        (lambda: load("nan.vti"), "nan.vti: field 'T' is nan at entry 5"),
        (lambda: load("skin.vtp"), "skin.vtp: holds no volume cells, found PolyData with 1680 flat cells"),
        (lambda: load("bad.vtu"), "bad.vtu: "),
        (lambda: load("what.xyzzy"), r"what.xyzzy: got a file .xyzzy, expected .vtk, .*"),
        (lambda: load("turned.vtr"), "turned.vtr: got coordinates along y that do not rise"),
        (lambda: load("flow.vti", unit="furlong"), "unit: got 'furlong', expected one of m"),
        (lambda: load("flow.vti", []), "flow.vti: got no fields"),
        (lambda: load("flow.vti", box=[[0, 0, 0], [1, 1, 0]]), "flow.vti: the box .* has no volume"),
        (lambda: load("flow.vti", box=[[5, 0, 0], [6, 1, 1]]), "flow.vti: the box .* is beside the data"),
        (lambda: load("flow.vti", box=[1.0]), "box: got .*, expected two corners"),
        (lambda: load("flow.vti", shape=(0, 1, 1)), "Grid.shape: got"),
    ):
        with pytest.raises(ValueError, match=message):
            call()


def test_without_pyvista_the_error_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(ImportError, match=r'needs pyvista: pip install "jaxir\[cfd\]"'):
        load_flow(tmp_path / "flow.vti", {"T": 300.0}, unit="m", shape=(2, 2, 2))
