"""AFSIM's table: whole, rising, with azimuth to the right."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir.io.result import save_afsim
from jaxir.io.result._sweep import joined_tables


def table(azimuth, elevation, bands=("MWIR",), sign=1.0):
    aspect = np.stack(np.meshgrid(azimuth, elevation, indexing="ij"), -1).reshape(-1, 2)
    value = sign * jnp.asarray((aspect[:, :1] + 400) * 10 + aspect[:, 1:], jnp.float32)
    wide = jnp.broadcast_to(value, (len(aspect), len(bands)))
    azimuth, elevation = (jnp.asarray(a, jnp.float32) for a in aspect.T)
    return jaxir.Signature(azimuth, elevation, wide, 0 * wide, tuple(bands), 0 * wide)


def test_a_full_circle_is_mirrored_and_closed(tmp_path):
    save_afsim(tmp_path / "s.txt", table([0, 90, 180, 270], [-90, 0, 90], ("MWIR", "LWIR")), "f-1", {"by": "us\nall"})
    lines = (tmp_path / "s.txt").read_text().splitlines()
    assert lines[:5] == [
        "# by: us all",
        "infrared_signature f-1",
        "   state default",
        "      band medium",
        "         inline_table w/sr 5 3",
    ]
    assert "      band long" in lines and lines[-1] == "end_infrared_signature"
    rows = np.array([[float(word) for word in line.split()] for line in lines[6:11]])
    assert lines[5].split() == ["-90", "0", "90"] and lines[11].strip() == "end_inline_table"
    np.testing.assert_array_equal(rows[:, 0], [-180, -90, 0, 90, 180])
    np.testing.assert_array_equal(rows[:, 2], [5800, 4900, 4000, 6700, 5800])  # our 90, the left wing, is their -90
    np.testing.assert_array_equal(rows[0, 1:], [5710, 5800, 5890])


def test_what_afsim_cannot_take_is_refused(tmp_path):
    good = table([-90, 90], [0, 10])
    for given, name, message in (
        (good, "two words", "name: got 'two words'"),
        (good, "büro", "name: got 'büro'"),
        (table([0], [0, 10]), "a", "views: got 2 aspects of 1 azimuths and 2 elevations"),
        (table([0, 400], [0, 10]), "a", "views: got angles beyond"),
        (table([0, 10], [0, 100]), "a", "views: got angles beyond"),
        (table([0, 10], [0, 10], ("A", "B")), "a", "bands: got A, B, expected one, or some of SWIR"),
        (table([0, 10], [0, 10], sign=-1.0), "a", "intensity: got -.* expected values >= 0"),
    ):
        with pytest.raises(ValueError, match=message):
            save_afsim(tmp_path / "s.txt", given, name)
    with pytest.raises(ValueError, match="ends in .txt"):
        save_afsim(tmp_path / "s.csv", good, "a")
    save_afsim(tmp_path / "s.txt", table([-90, 90], [0, 10], ("mine",)), "a")
    assert "band default" in (tmp_path / "s.txt").read_text()
    with pytest.raises(ValueError, match="^.txt: expected a file name that ends in .txt, as name.txt"):
        save_afsim(".txt", good, "a")


def test_states_of_close_values_stay_apart(tmp_path):
    parts = [table([0, 90], [0, 10]), table([0, 90], [0, 10])]
    both = joined_tables(parts, [{"range": 1000001.0}, {"range": 1000002.0}])
    save_afsim(tmp_path / "s.txt", both, "a")
    states = [line.split()[1] for line in (tmp_path / "s.txt").read_text().splitlines() if "state" in line]
    assert states == ["default", "range_1000001", "range_1000002"]
