"""Numbers per face from CSV, NPZ and NPY: by order or by index, and what is wrong with a file is named."""

import numpy as np
import pytest

from jaxir.io.field import load_array, load_face_values
from tests.io.scene_file.scene_text import write_npz


@pytest.mark.parametrize(
    "text",
    [
        "300\n310\n320\n",
        "# K\ntemperature\n300\n310\n\n320\n",
        "face,temperature,note\n2,320,a\n0,300,b\n1,310,c\n",
    ],
)
def test_csv(text, tmp_path):
    (tmp_path / "t.csv").write_text(text)
    np.testing.assert_array_equal(load_face_values(tmp_path / "t.csv", 3), [300, 310, 320])


def test_npz_and_npy(tmp_path):
    want = np.array([300.0, 310.0, 320.0])
    write_npz(tmp_path / "t.npz", temperature=want[::-1], face=np.array([2, 1, 0]), other=want)
    np.save(tmp_path / "t.npy", want)
    np.testing.assert_array_equal(load_face_values(tmp_path / "t.npz", 3), want)
    np.testing.assert_array_equal(load_face_values(tmp_path / "t.npy", 3), want)
    np.testing.assert_array_equal(load_array(tmp_path / "t.npz", "other"), want)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "t.csv: holds no values, expected 3"),
        ("300\n310\n", "t.csv: got 2 values, expected 3, one per face"),
        ("300\n310\n320\n330\n", "t.csv:4: got more than 3 values"),
        ("300\n310\nnan\n", "t.csv:3: got 'nan', expected a finite number"),
        ("300\n310\nhot\n", "t.csv:3: got 'hot', expected a finite number"),
        ("temperature_C\n20\n", "t.csv:1: got columns temperature_C, expected temperature"),
        ("face,temperature\n0,300\n1\n", "t.csv:3: got 1 columns, expected 2"),
        ("face,temperature\n0,300\n1,310\n1,320\n", "t.csv: face 1 has 2 values|face 2 has 0 values"),
        ("Face ID,temperature\n2,300\n1,310\n0,320\n", "t.csv:1: got 'Face ID', expected 'face' where it is the index"),
        ("300.25\n310.25\n320.25\n33", "t.csv:4: got '33' without a line end, .*: the file is cut"),
        ("1e999\n1\n1\n", "t.csv:1: got '1e999', expected a finite number"),
        ("1e300\n1\n1\n", "t.csv:1: got '1e300', expected a finite number"),
        ("3_0\n1\n1\n", "t.csv:1: got columns 3_0, expected temperature"),
        ('temperature\n"300\n310\n320\n', "t.csv:4: not readable as CSV"),
        ("face,temperature\n0,300\n1,310\n3,320\n", "t.csv: face 3 at .2., expected integers 0 to 2"),
    ],
)
def test_wrong_csv(text, message, tmp_path):
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(ValueError, match=message):
        load_face_values(tmp_path / "t.csv", 3)


@pytest.mark.parametrize("name", ["id", "cell_number", "tri_id", "elem", "facet", "idx", "N", "Row", "polygon", ""])
def test_a_column_that_may_number_faces_is_not_passed_over(name, tmp_path):
    (tmp_path / "t.csv").write_text(f"{name},temperature\n1,310\n0,300\n2,320\n")
    with pytest.raises(ValueError, match=f"t.csv:1: got '{name}', expected 'face' where it is the index"):
        load_face_values(tmp_path / "t.csv", 3)
    (tmp_path / "t.csv").write_text("x,normal,unit,temperature\n1,2,3,310\n0,2,3,300\n2,2,3,320\n")
    np.testing.assert_array_equal(load_face_values(tmp_path / "t.csv", 3), [310, 300, 320])


def test_wrong_npz(tmp_path):
    good = write_npz(tmp_path / "good.npz", temperature=np.ones(3), words=np.array(["a"]), bad=np.array([1.0, np.nan]))
    (tmp_path / "cut.npz").write_bytes(good.read_bytes()[:200])
    other = write_npz(tmp_path / "other.npz", temperature=np.ones(3), face_index=np.arange(3)[::-1])
    np.save(tmp_path / "whole.npy", np.ones(1000))
    (tmp_path / "cut.npy").write_bytes((tmp_path / "whole.npy").read_bytes()[:500])
    (tmp_path / "noise.npz").write_bytes(b"hello")
    (tmp_path / "latin.csv").write_bytes(b"30\xe9\n")
    for call, message in (
        (lambda: load_face_values(good, 4), r"good.npz: temperature has shape \(3,\), expected \(4,\)"),
        (lambda: load_face_values(good, 3, "heat"), "good.npz: got array 'heat', expected one of temperature, words"),
        (lambda: load_face_values(other, 3), "other.npz: got 'face_index', expected 'face' where it is the index"),
        (lambda: load_array(good, "words"), "good.npz: words holds <U1, expected numbers"),
        (lambda: load_array(good, "bad"), r"good.npz: bad is nan at \[1\], expected finite"),
        (lambda: load_array(tmp_path / "cut.npz", "temperature"), "cut.npz: not readable as NPZ or NPY"),
        (lambda: load_array(tmp_path / "cut.npy"), "cut.npy: not readable as NPZ or NPY"),
        (lambda: load_array(tmp_path / "noise.npz"), "noise.npz: not readable as NPZ or NPY"),
        (lambda: load_array(tmp_path / "none.npz"), "none.npz: no such file"),
        (lambda: load_face_values(tmp_path / "latin.csv", 1), "latin.csv:1: got the byte 0xe9, expected UTF-8"),
        (
            lambda: load_face_values(tmp_path / "t.xls", 1),
            "t.xls: expected a file name that ends in .csv, .npz or .npy",
        ),
    ):
        with pytest.raises(ValueError, match=message):
            call()


def test_whole_numbers_need_no_last_line_end(tmp_path):
    for text in ("100\n200\n50", "0.5\n0.25\n1", "10.5\n20.5\n30.5"):
        (tmp_path / "t.csv").write_text(text)
        assert load_face_values(tmp_path / "t.csv", 3).size == 3


def test_arrays_are_bounded_before_they_take_memory(tmp_path, monkeypatch):
    np.savez_compressed(tmp_path / "a.npz", small=np.ones(9), large=np.zeros(10_000, np.int8))
    np.save(tmp_path / "a.npy", np.zeros(10_000))
    monkeypatch.setattr("jaxir.io._array_files.LARGEST_ARRAYS", 50_000)
    assert load_array(tmp_path / "a.npz", "small").size == 9
    for call in (lambda: load_array(tmp_path / "a.npz", "large"), lambda: load_array(tmp_path / "a.npy")):
        with pytest.raises(ValueError, match="a.np.: not readable .* .got arrays of 80000 bytes in memory"):
            call()
    whole = (tmp_path / "a.npy").read_bytes()
    (tmp_path / "a.npy").write_bytes(whole.replace(b"(10000,)", b"(99999,)"))
    with pytest.raises(ValueError, match="a.npy: .*got 80128 bytes, expected 800120 as its header says"):
        load_array(tmp_path / "a.npy")


def test_damaged_headers(tmp_path):
    path = tmp_path / "a.npy"
    np.save(path, np.zeros(10))
    whole = path.read_bytes()
    for old, new in ((b"{'descr'", b"{'des\ncr"), (b"<f8", b"|O8"), (b"(10,)", b"(-9,)"), (b"\x93NUMPY", b"\x93NUMBY")):
        path.write_bytes(whole.replace(old, new))
        with pytest.raises(ValueError, match="a.npy: not readable as NPZ or NPY"):
            load_array(path)
    np.savez(tmp_path / "a.npz", a=np.array([{"any": "object"}], object), b=np.ones(2))
    with pytest.raises(ValueError, match="a.npz: not readable as NPZ or NPY .a: got object"):
        load_array(tmp_path / "a.npz", "b")
