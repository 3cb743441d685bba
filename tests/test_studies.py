"""Every study has one shape, and the frame of studies writes what it says."""

import argparse
import ast
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from studies import _study, computed_flow, gallery, measurements, mitsuba_peer, paper, torch, validation_page

ROOT = Path(__file__).parents[1]
STUDIES = sorted(path for path in (ROOT / "studies").glob("*.py") if "\n    study(main" in path.read_text())


def test_the_readme_names_every_study():
    text = (ROOT / "README.md").read_text()
    assert len(STUDIES) > 20
    assert [path.stem for path in STUDIES if f"`studies.{path.stem}" not in text] == []


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_a_study_asks_a_question_and_returns_its_answer(path):
    tree = ast.parse(path.read_text())
    assert "?" in ast.get_docstring(tree).split("\n")[0]
    main = next(node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == "main")
    assert ast.unparse(main.args) == "run: Run" and ast.unparse(main.returns) == "str"
    assert isinstance(tree.body[-1], ast.If) and len(tree.body[-1].body) == 1
    printed = [node for node in ast.walk(tree) if isinstance(node, ast.Name) and node.id in ("plt", "csv")]
    assert not printed  # tables and charts go through the frame


def test_the_gallery_is_up_to_date():
    assert gallery.PAGE.read_text(encoding="utf-8") == gallery.gallery(), "python -m studies.gallery"
    with pytest.raises(ValueError, match="nothing.png: got no study of that name"):
        gallery.maker("nothing")


def test_the_page_on_the_paper_is_up_to_date():
    assert paper.PAGE.read_text(encoding="utf-8") == paper.page(), "python -m studies.paper"


def test_the_page_on_validation_is_up_to_date():
    assert validation_page.PAGE.read_text(encoding="utf-8") == validation_page.page(), (
        "python -m studies.validation_page"
    )


def test_a_computed_jet_is_that_of_the_books():
    """Of one density, in air nearly still: a core of 4 to 6 diameters, and beyond it u / u_0 = 6 d / z and a half
    radius of .09 z within 15 %; momentum and exhaust are kept."""
    jet = computed_flow.Jet(100.0, 218.0, 1.0, 218.0, 26500.0, 0.5)
    flow = computed_flow.march(jet, 12.0)
    excess = (flow.speed - jet.air_speed) / (jet.speed - jet.air_speed)
    assert 4 < flow.along[np.argmax(excess[:, 0] < 0.99)] / jet.diameter < 6
    at = np.searchsorted(flow.along, 10.0)
    np.testing.assert_allclose(excess[at, 0] * flow.along[at] / jet.diameter, 6.0, rtol=0.15)
    half = np.interp(-0.5, -excess[at] / excess[at, 0], flow.radius[at])
    np.testing.assert_allclose(half / flow.along[at], 0.09, rtol=0.15)
    for field in (excess, flow.fraction):
        np.testing.assert_allclose((flow.mass * field).sum(axis=1), (flow.mass * field[0]).sum(), rtol=1e-9)


def _parser():
    parser = argparse.ArgumentParser()
    parser.add_argument("--full", action="store_true")
    parser.add_argument("--out", type=Path)
    return parser


def test_only_the_published_command_writes_to_the_figures():
    published = _study.run_of("x", _parser(), ["--full"], "--full")
    other = _study.run_of("x", _parser(), [], "--full")
    assert published.figures == _study.FIGURES
    assert other.figures == other.folder == published.folder == _study.HERE / "out" / "x"


def test_tables_charts_and_records_are_written_where_asked(tmp_path):
    run = _study.run_of("x", _parser(), ["--out", str(tmp_path / "new")])
    run.table([{"name": "a", "count": 123456, "value": 1 / 3}])
    run.table([{"value": 1 / 3}], "y", digits=None)
    figure, axes = _study.subplots(1, 2, figsize=(2, 1))
    axes[0].plot([0, 1], [0, 1])
    run.chart(figure)
    run.record({"a": 1})
    assert [path.name for path in run.written] == ["x.csv", "y.csv", "x.png", "x.json"]
    assert all(path.parent == tmp_path / "new" and path.stat().st_size for path in run.written)
    assert (tmp_path / "new" / "x.csv").read_text().splitlines()[1] == "a,123456,0.3333"
    assert float((tmp_path / "new" / "y.csv").read_text().splitlines()[1]) == 1 / 3
    assert run.bulk("deep", "er").is_dir()


@pytest.mark.parametrize(
    ("probe", "why"),
    [
        ("import os\nos.abort()", r"a process that loads it ends by signal 6"),
        ("raise RuntimeError('LLVM is too old')", "ends with status 1: RuntimeError: LLVM is too old"),
        ("pass", ""),
    ],
)
def test_what_would_end_a_study_is_found_in_a_process_of_its_own(probe, why, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: name)
    found = mitsuba_peer.trouble(probe)
    assert why in found and "\n" not in found and bool(found) == bool(why)


def test_a_peer_that_is_not_installed_is_said_in_one_line(monkeypatch, capsys):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    mitsuba_peer.trouble.cache_clear()
    assert mitsuba_peer.load() is None
    mitsuba_peer.trouble.cache_clear()
    assert capsys.readouterr().out == 'Mitsuba is not measured: it is not installed (pip install "jaxir[peers]")\n'


def test_help_is_the_question():
    command = [sys.executable, "-m", "studies.plate", "--help"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0 and "plate right at every angle?" in done.stdout


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("wavelength_nm,radiance\n4000,1\n", "got columns wavelength_nm, radiance, expected wavelength_um, value_W"),
        ("wavelength_um,value_W\n4,1\n4.1\n4.2,1\n", r":3: got '4.1', expected 2 finite numbers"),
        ("wavelength_um,value_W\n4,1\n4.1,nan\n4.2,1\n", r":3: got '4.1,nan', expected 2 finite numbers"),
        (
            "wavelength_um,value_W\n4,1\n4.1,1\n4.2,1\n4.3,1\n5,1\n",
            r":6: got wavelength_um 5 after 4.3, expected one that",
        ),
        ("wavelength_um,value_W\n4,1\n4.1,1\n4.1,1\n4.2,1\n", r":4: got wavelength_um 4.1 after 4.1"),
        ("# a citation\nwavelength_um,value_W\n4,1\n", "got 1 rows, expected at least 3"),
    ],
)
def test_a_measurement_in_other_units_or_with_gaps_is_refused_in_one_line(tmp_path, text, told):
    path = tmp_path / "measured.csv"
    with pytest.raises(ValueError, match="got no file"):
        measurements.read_columns(path, ("wavelength_um", "value_W"))
    path.write_text(text)
    with pytest.raises(ValueError, match=told) as error:
        measurements.read_columns(path, ("wavelength_um", "value_W"))
    assert "\n" not in str(error.value) and "measured.csv" in str(error.value)


def test_the_torch_is_read_and_its_slit_keeps_the_mean():
    given = torch.torch()
    assert given.wavelength.size == 901 and given.temperature[0] == 3409 and given.co2.size == 12
    wavelength = np.linspace(3.0, 5.0, 20001)
    line = np.exp(-(((wavelength - 4.0) / 2e-3) ** 2))
    seen = measurements.through_slit(wavelength, line, 7.2e-3, 15.2e-3, wavelength)
    assert seen.sum() == pytest.approx(line.sum(), rel=1e-6)
    width = 1e-4 * seen.sum() / seen.max()
    assert width == pytest.approx(11.2e-3, rel=0.01)  # a narrow line shows the slit itself
