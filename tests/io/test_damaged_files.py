"""Files of every format with flipped bytes or cut off: each is read as it is or refused by one error that names it.

`python -m tests.io.test_damaged_files 2000` damages every format so many times; names of formats may follow.
"""

import functools
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import pyvista
import trimesh

import jaxir
from jaxir.imaging import prepare_views
from jaxir.io.field import load_array, load_face_values, load_flow, load_surface_field
from jaxir.io.mesh import load_mesh
from jaxir.io.result import save_face_values
from jaxir.io.result._sweep import CONDITIONS, _Folder
from jaxir.io.scene_file import load_scene
from jaxir.io.spectra import (
    KTables,
    check_line_file,
    load_atmosphere_csv,
    load_k_tables,
    load_tape7,
    save_k_tables,
)
from jaxir.optics.gas import CrossSections
from jaxir.optics.spectrum import gray_nodes
from jaxir.transport import Method
from tests.io.scene_file.scene_text import TEXT
from tests.scenes import box_mesh, plate

ROUNDS = 60
MESH = box_mesh((1.0, 2.0, 3.0))
NODES = gray_nodes([jaxir.MWIR, jaxir.LWIR])


class Format(NamedTuple):
    """How a small valid file is written and read."""

    name: str
    write: Callable[[Path], object]
    read: Callable[[Path], object]


def _exported(path, **options):
    trimesh.Trimesh(np.asarray(MESH.vertices), np.asarray(MESH.faces), process=False).export(path, **options)


def _two_solids(path):
    mesh = trimesh.Trimesh(np.asarray(MESH.vertices), np.asarray(MESH.faces), process=False)
    text = mesh.export(file_type="stl_ascii")
    path.write_text(text.replace("solid", "solid Wing", 1) + "\n" + text)


def _mixed_polygons(path):
    rows = ["0 0 0", "1 0 0", "1 1 0", "0 1 0", "0 0 1", "4 0 1 2 3", "3 0 1 4", "5 0 1 2 3 4"]
    head = ["ply", "format ascii 1.0", "comment mixed", "element vertex 5", *(f"property float {a}" for a in "xyz")]
    path.write_text(
        "\n".join([*head, "element face 3", "property list uchar int vertex_index", "end_header", *rows, ""])
    )


def _face_csv(path):
    path.write_text("# K\nface,temperature,note\n" + "".join(f'{11 - i},{300 + i}.25,"a, b"\n' for i in range(12)))


def _k_tables(path):
    axes = [300.0, 900.0], [2e4, 1e5], [0.0, 0.3]
    table = CrossSections("H2O", NODES, *axes, np.full((2, 2, 2, NODES.count), 1e-26))
    save_k_tables(path, KTables(NODES, (table,), jaxir.FixedPath([0.5, 0.75], [0.1, 0.2]), "made up"))


def _atmosphere(path):
    rows = "".join(f"{2000 + 5 * i}.5,0.{100 + i},{1 + i / 8:.3e}\n" for i in range(20))
    path.write_text("# air\nwavenumber_cm-1,transmittance,path_radiance\n" + rows)


def _tape7(path):
    head = ["TM  6    2    2    0", "   10.000     0.000   30.000", "", "    FREQ  TOT TRANS  PTH THRML   SOL SCAT"]
    rows = [f"{2000 + 5 * i:8.2f}{0.5 + i / 90:11.8f}{1e-9 * i:11.4E}{2e-10:11.4E}" for i in range(20)]
    path.write_text("\n".join([*head, *rows, "  -9999.", ""]))


def _lines(path):
    rows = [
        f" 21{2300 + i:12.6f}{1e-19 / (i + 1):10.3E}{1:10.3E}.0700.0900{100 + i:10.4f}0.50{0:8.6f}" for i in range(6)
    ]
    path.write_text("".join(f"{row:160}\n" for row in rows))


@functools.cache
def _asked():
    scene, aspects = jaxir.Scene(plate(temperature=400.0)), np.array([[0.0, 0.0], [30.0, 10.0]])
    return prepare_views(
        scene,
        aspects,
        NODES,
        distance=np.inf,
        shape=(4, 4),
        samples=2,
        key=None,
        method=Method(direct=None),
        until=None,
    )


SWEPT = {"scene": "0a1b", "bands[0]": "2c3d"}


def _swept(path):
    folder = _Folder(path.parent, _asked())
    folder.finished(SWEPT)
    for index in range(2):
        values = ([1.0, 2.0], [0.1, 0.2], [0.0, 0.0], [1.0, 2.0])
        folder.write(index, [np.array(value) for value in values])


def _read_sweep(path):
    folder = _Folder(path.parent, _asked())
    assert folder.finished(SWEPT).all()
    return folder.read()


def _flow(path):
    data = pyvista.ImageData(dimensions=(4, 4, 4))
    data.point_data["T"] = 300.0 + np.arange(data.n_points)
    (data if path.suffix == ".vti" else data.cast_to_unstructured_grid()).save(path)


def _read_flow(path):
    return load_flow(path, {"T": 300.0}, unit="m", shape=(2, 2, 2))


def _surface(path):
    data = pyvista.PolyData(np.asarray(MESH.vertices), np.insert(np.asarray(MESH.faces), 0, 3, axis=1))
    data.cell_data["T"] = 300.0 + np.arange(data.n_cells)
    data.save(path)


def _mesh(path):
    return load_mesh(path, unit="m")


def _faces(path):
    return load_face_values(path, MESH.count)


FORMATS = [
    Format("body.obj", _exported, _mesh),
    Format("body.off", _exported, _mesh),
    Format("binary.stl", _exported, _mesh),
    Format("text.stl", _two_solids, _mesh),
    Format("binary.ply", _exported, _mesh),
    Format("text.ply", _mixed_polygons, _mesh),
    Format("coloured.ply", lambda p: save_face_values(p, MESH, np.arange(12.0), name="t", unit="K"), _mesh),
    Format("body.glb", _exported, _mesh),
    Format("faces.csv", _face_csv, _faces),
    Format("faces.npy", lambda p: np.save(p, np.linspace(300, 400, 12)), _faces),
    Format("faces.npz", lambda p: np.savez(p, face=np.arange(12), temperature=np.full(12, 300.0)), _faces),
    Format("field.npz", lambda p: np.savez_compressed(p, T=np.full((3, 4, 5), 300.0)), lambda p: load_array(p, "T")),
    Format("tables.npz", _k_tables, load_k_tables),
    Format("air.csv", _atmosphere, load_atmosphere_csv),
    Format("air.tp7", _tape7, load_tape7),
    Format("lines.par", _lines, lambda p: check_line_file(p, progress=False)),
    Format("scene.toml", lambda p: p.write_text(TEXT), load_scene),
    Format(CONDITIONS, _swept, _read_sweep),
    Format("view_000001.npz", _swept, _read_sweep),
    Format("flow.vti", _flow, _read_flow),
    Format("flow.vtu", _flow, _read_flow),
    Format("skin.vtp", _surface, lambda p: load_surface_field(p, MESH, "T", unit="m")),
]
CRASHING = [Format("flow.vtk", _flow, _read_flow)]  # rarely, and not again: VTK's reader writes beyond its memory


def damaged(raw: bytes, random: np.random.Generator) -> bytes:
    """The bytes of a file, cut somewhere or with one to eight of them changed."""
    if random.random() < 0.3:
        return raw[: random.integers(len(raw))]
    changed = bytearray(raw)
    for place in random.integers(len(raw), size=2 ** random.integers(4)):
        if random.random() < 0.5:
            changed[place] ^= 1 << random.integers(8)
        else:
            changed[place] = random.integers(256)
    return bytes(changed)


def refused(one: Format, folder: Path, rounds: int, seed: int = 0) -> int:
    """How many damaged files of a format are refused; the others are read. Anything but that raises."""
    path = folder / one.name
    one.write(path)
    one.read(path)
    raw, random, count = path.read_bytes(), np.random.default_rng(seed), 0
    for number in range(rounds):
        path.write_bytes(damaged(raw, random))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                warnings.filterwarnings("ignore", f".*{one.name}: .* zero area")
                warnings.simplefilter("ignore", jaxir.PlausibilityWarning)  # which says what was read
                one.read(path)
        except (ValueError, OSError) as error:
            assert one.name in str(error) or CONDITIONS == one.name and str(folder) in str(error), (number, error)
            count += 1
        except Exception as error:
            error.add_note(f"{one.name}, damaged file number {number} of seed {seed}")
            raise
    return count


@pytest.mark.parametrize("one", FORMATS, ids=lambda one: one.name)
def test_a_damaged_file_is_read_or_refused_by_name(one, tmp_path):
    assert refused(one, tmp_path, ROUNDS) > 0


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"[]", "got a list, expected a table of conditions"),
        (b'{"scene": "0a1b", "ban', "Unterminated string .* expected the conditions of a sweep"),
        (b"\xff", "conditions.json:1: got the byte 0xff, expected UTF-8"),
        (b'{"scene": "0a1b"}', "other values of bands"),
    ],
)
def test_conditions_of_a_sweep_that_are_none(content, message, tmp_path):
    (tmp_path / CONDITIONS).write_bytes(content)
    with pytest.raises(ValueError, match=message):
        _Folder(tmp_path, _asked()).finished(SWEPT)


def test_parts_that_a_killed_sweep_left_are_removed(tmp_path):
    _swept(tmp_path / CONDITIONS)
    (tmp_path / ".own").touch()
    for name in (".conditions.json.a1b2c3d4.json", ".view_000001.npz.a1b2c3d4.npz", ".view_000099.npz.abcd1234.npz"):
        (tmp_path / name).write_bytes(b"half")
    assert _Folder(tmp_path, _asked()).finished(SWEPT).all()
    assert {path.name for path in tmp_path.iterdir()} == {CONDITIONS, "view_000000.npz", "view_000001.npz", ".own"}


@pytest.mark.parametrize(
    ("name", "value"), [("intensity", [1.0]), ("intensity", [np.nan, 1.0]), ("standard_error", [-1.0, 1.0])]
)
def test_views_of_a_sweep_with_other_values_are_refused(name, value, tmp_path):
    _swept(tmp_path / CONDITIONS)
    with np.load(tmp_path / "view_000001.npz") as found:
        arrays = dict(found)
    np.savez(tmp_path / "view_000001.npz", **{**arrays, name: np.array(value)})
    with pytest.raises(ValueError, match="view_000001.npz: got a damaged file, expected a finished view"):
        _Folder(tmp_path, _asked()).finished(SWEPT)


if __name__ == "__main__":
    for one in FORMATS + CRASHING:
        if one.name in sys.argv[2:] or not sys.argv[2:]:
            with tempfile.TemporaryDirectory() as name:
                print(one.name, refused(one, Path(name), int(sys.argv[1])), "refused", flush=True)
