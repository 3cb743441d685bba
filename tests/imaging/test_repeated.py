"""A signature to a tolerance: the error asked is the error obtained, without bias, and only where it is needed."""

import jax
import numpy as np
import pytest

import jaxir
from jaxir.command_line import main
from jaxir.imaging import _repeated as repeated
from jaxir.io.result import sweep
from tests.io.scene_file.scene_text import TEXT, write_scene
from tests.scenes import plate

LAMP = jaxir.DiscSource((1.0, 0.0, 1.5), (0.0, 0.0, -1.0), 1.0, 3000.0)
SCENE = jaxir.Scene(plate(temperature=300.0, emissivity=0.2), (), LAMP)
VIEWS = [(0.0, 0.0), (40.0, 30.0), (75.0, -20.0), (180.0, 0.0)]  # the last sees the dark side
RASTER = {"shape": (8, 8), "samples": 2}


def seen(key=0, **asked):
    return jaxir.signature(SCENE, VIEWS, jaxir.LWIR, key=jax.random.key(key), **RASTER, method=jaxir.Method(), **asked)


@pytest.fixture
def looks(monkeypatch):
    """Views that were looked at, in order, once for every look."""
    taken = []

    def watched(function, inputs, items, *rest):
        for index, result in item_by_item(function, inputs, items, *rest):
            taken.extend(items.view[index].tolist())
            yield index, result

    item_by_item = repeated.item_by_item
    monkeypatch.setattr(repeated, "item_by_item", watched)
    return taken


@pytest.mark.parametrize("rtol", [6e-2, 3e-2])
def test_the_error_asked_is_the_error_obtained_and_the_mean_is_not_biased(rtol):
    fine = [seen(key=1000 + key, rtol=rtol / 4) for key in range(4)]
    truth = np.mean([table.intensity for table in fine], axis=0)[:3, 0]
    known = np.mean([np.asarray(table.standard_error) ** 2 for table in fine], axis=0)[:3, 0] / 4
    tables = [seen(key=key, rtol=rtol) for key in range(24)]
    assert all(table.meets(rtol).all() for table in [*fine, *tables[:1], *tables])
    apart = np.array([np.asarray(table.intensity)[:3, 0] for table in tables]) - truth
    obtained = np.sqrt(np.maximum((apart**2).mean(axis=0) - known, 0)) / truth
    assert (obtained < 1.3 * rtol).all() and (obtained > 0.4 * rtol).any()
    z = apart.mean(axis=0) / np.sqrt(apart.var(axis=0, ddof=1) / len(tables) + known)
    assert np.abs(z).max() < 4
    told = np.sqrt(np.mean([np.asarray(table.standard_error)[:3, 0] ** 2 for table in tables], axis=0))
    np.testing.assert_allclose(told, np.sqrt((apart**2).mean(axis=0) - known), rtol=0.5)


def test_what_is_exact_enough_is_looked_at_once(looks):
    once = seen()
    del looks[:]
    often = seen(rtol=0.01)
    found, error = np.asarray(once.intensity)[:, 0], np.asarray(once.standard_error)[:, 0]
    enough = error <= 0.01 * found / 3
    assert enough[3] and not enough[:3].any()
    np.testing.assert_array_equal(np.asarray(often.intensity)[enough], np.asarray(once.intensity)[enough])
    assert (np.asarray(often.intensity)[:3] != np.asarray(once.intensity)[:3]).all()  # the first look is no part of it
    count = np.bincount(looks, minlength=4)
    wanted = (error / (repeated.MARGIN * 0.01 * found)) ** 2
    assert count[3] == 1 and (count[:3] >= wanted[:3]).all() and (count[:3] < 4 * wanted[:3] + 4).all()


def test_an_absolute_error_and_a_budget_end_it_too(looks):
    free = seen(rtol=1e-2)
    largest = float(np.asarray(seen().standard_error).max())
    del looks[:]
    coarse = seen(rtol=1e-2, atol=3.1 * largest)
    assert len(looks) == len(VIEWS) and coarse.meets(1e-2, 3.1 * largest).all() and not coarse.meets(1e-2).all()
    assert float(np.asarray(seen(atol=largest / 3).standard_error).max()) <= largest / 3
    del looks[:]
    short = seen(rtol=1e-3, max_samples=8)
    assert not short.meets(1e-3)[:3].any() and short.meets(1e-3)[3] and free.meets(1e-2).all()
    assert max(np.bincount(looks)) == 1 + 8 // RASTER["samples"]


def test_seconds_end_it_with_what_they_allowed(looks, monkeypatch):
    """A clock that counts looks: a second each."""
    monkeypatch.setattr(repeated.time, "perf_counter", lambda: float(len(looks)))
    free = seen(rtol=1e-2)
    everything = len(looks)
    del looks[:]
    again = seen(rtol=1e-2, max_seconds=1.5 * everything)
    np.testing.assert_array_equal(np.asarray(again.intensity), np.asarray(free.intensity))
    del looks[:]
    short = seen(rtol=1e-2, max_seconds=everything / 2)
    assert everything / 4 < len(looks) <= everything / 2 and not short.meets(1e-2)[:3].all()
    del looks[:]
    first = seen(rtol=1e-2, max_seconds=len(VIEWS) + 0.5)
    assert len(looks) == len(VIEWS)
    once = seen()
    np.testing.assert_array_equal(np.asarray(first.intensity), np.asarray(once.intensity))
    del looks[:]
    jaxir.signature(SCENE, VIEWS[:1], jaxir.LWIR, **RASTER, method=jaxir.Method(), rtol=1e-3, max_seconds=20.0)
    assert 15 < len(looks) <= 20


def test_components_are_of_the_same_looks():
    table = seen(rtol=1e-2, components="sources")
    np.testing.assert_allclose(np.asarray(table.parts).sum(axis=1), table.intensity, rtol=1e-5)
    own = np.asarray(table.parts_error)[:, :, 0]
    assert (own.max(axis=1)[:3] < 1.2 * np.asarray(table.standard_error)[:3, 0]).all()


def test_a_sweep_gives_the_same_also_where_it_goes_on(tmp_path, looks):
    asked = {**RASTER, "key": jax.random.key(3), "rtol": 1e-2, "method": jaxir.Method()}
    table = jaxir.signature(SCENE, VIEWS, jaxir.LWIR, **asked)
    whole = sweep(tmp_path / "views", SCENE, VIEWS, jaxir.LWIR, **asked)
    (tmp_path / "views" / "view_000001.npz").unlink()
    del looks[:]
    again = sweep(tmp_path / "views", SCENE, VIEWS, jaxir.LWIR, **asked)
    assert set(looks) == {1}
    for other in (whole, again):
        np.testing.assert_array_equal(np.asarray(other.intensity), np.asarray(table.intensity))
        np.testing.assert_array_equal(np.asarray(other.standard_error), np.asarray(table.standard_error))
    with pytest.raises(ValueError, match="other values of tolerance"):
        sweep(tmp_path / "views", SCENE, VIEWS, jaxir.LWIR, **{**asked, "rtol": 2e-2})


@pytest.mark.parametrize(
    "asked, said",
    [
        ({"rtol": 0.0}, "rtol: got 0.0, expected > 0"),
        ({"rtol": 1e-9}, "rtol: got 1e-09, expected at least"),
        ({"atol": -1.0}, "atol: got -1.0, expected a finite value > 0"),
        ({"atol": np.nan}, "atol: got nan, expected a finite value > 0"),
        ({"rtol": 0.1, "max_samples": 1}, "max_samples: got 1, expected at least samples = 2"),
        ({"rtol": 0.1, "max_seconds": 0.0}, "max_seconds: got 0.0, expected > 0"),
        ({"max_seconds": 3.0}, "max_seconds: got 3.0 alone, expected rtol or atol beside it"),
    ],
)
def test_what_cannot_be_asked_is_refused(asked, said, tmp_path):
    for ask in (jaxir.signature, lambda *rest, **given: sweep(tmp_path / "views", *rest, **given)):
        with pytest.raises(ValueError, match=said):
            ask(SCENE, VIEWS, jaxir.LWIR, **RASTER, **asked)
    assert not (tmp_path / "views").exists()


def test_a_scene_file_asks_for_it_and_what_is_missed_is_said(tmp_path, capsys):
    lamp = "[[sources]]\ntype = 'DiscSource'\ncentre = [1, 0, 1.5]\nnormal = [0, 0, -1]\nradius = 1\nradiance = 3e3\n"
    lit = TEXT[: TEXT.index("[[sources]]")] + lamp + TEXT[TEXT.index("[background]") : TEXT.index("[signature]")]
    views = "[method]\nbounces = 0\n[signature]\nviews = [[0, 0], [40, 30], [180, 0]]\nshape = [8, 8]\nrtol = 0.01\n"
    out = ["-q", "source", "-o", str(tmp_path / "table.csv")]
    assert main(["signature", str(write_scene(tmp_path, lit + views)), *out]) == 0
    table = np.loadtxt(tmp_path / "table.csv", delimiter=",", comments=("#", "azimuth"))
    intensity, error = table[:, [2, 10]], table[:, [3, 11]]
    assert (error <= 0.01 * intensity).all() and (error[:2] > 0).all()
    short = str(write_scene(tmp_path, lit + views + "max_samples = 4\n"))
    assert main(["signature", short, *out]) == 0
    assert "signature.rtol was not met in 2 of 3 views (max_samples = 4)" in capsys.readouterr().err


def test_a_tolerance_below_jit_is_refused():
    def intensity(temperature):
        return jaxir.signature(jaxir.Scene(plate(temperature=temperature)), VIEWS, jaxir.LWIR, rtol=0.01).intensity

    with pytest.raises(ValueError, match="rtol, atol: got traced values"):
        jax.jit(intensity)(300.0)
