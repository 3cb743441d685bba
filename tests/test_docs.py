"""Every code block of the documentation does what it says: Python runs, scene files are read, commands succeed."""

import re
import shutil
import tomllib
from pathlib import Path

import pytest

from jaxir.command_line import main
from jaxir.io.scene_file import load_scene

ROOT = Path(__file__).parents[1]
PAGES = sorted(path for path in (ROOT / "docs").glob("*.md"))
MADE_BY_HAND = ("python3 -m venv", ".venv/bin/pip")  # the steps of an installation


def blocks(page, language):
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


def test_every_block_is_of_a_kind_that_is_run():
    for page in PAGES:
        kinds = set(re.findall(r"^```(\w+)$", page.read_text(encoding="utf-8"), re.MULTILINE))
        assert kinds <= {"python", "sh", "toml", "text"}, page


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "python")], ids=lambda page: page.stem)
def test_python(page, monkeypatch):
    monkeypatch.chdir(ROOT)
    held = {}
    for block in blocks(page, "python"):
        exec(compile(block, page.name, "exec"), held)


def sections(text):
    """The text of every section of a scene file, sub-sections included, by name."""
    found, name = {}, None
    for line in text.splitlines():
        header = re.match(r"\[+(\w+)|(\w+) =", line)
        if header and (header[1] or name is None):
            name = header[1] or header[2]
        if name is not None:
            found.setdefault(name, []).append(line)
    return {name: "\n".join(lines) for name, lines in found.items()}


def test_scene_files_are_read(tmp_path, monkeypatch):
    """Each block replaces the sections of its name in the first, and what results is a scene."""
    resolve = "jaxir.io.scene_file._scene_files.resolve_jet"  # has its own tests
    monkeypatch.setattr(resolve, lambda jet, bands, tolerance: jet)
    shutil.copy(ROOT / "examples" / "aircraft.obj", tmp_path)
    first, *others = blocks(ROOT / "docs" / "scene_files.md", "toml")
    assert len(others) > 5
    base = sections(first)
    for block in (first, *others):
        changed = {**base, **sections(block)}
        assert set(sections(block)) == set(tomllib.loads(block))
        changed = {"bands": changed.pop("bands"), **changed}
        (tmp_path / "scene.toml").write_text("\n".join(changed.values()))
        load_scene(tmp_path / "scene.toml")


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "sh")], ids=lambda page: page.stem)
def test_commands(page, tmp_path, monkeypatch):
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    monkeypatch.chdir(tmp_path)
    lines = [line for block in blocks(page, "sh") for line in block.splitlines()]
    for line in lines:
        words = line.split()
        if words[0] == "jaxir":
            assert main(words[1:]) == 0, line
            assert all(Path(name).is_file() for flag, name in zip(words, words[1:], strict=False) if flag == "-o")
        else:
            assert line.startswith(MADE_BY_HAND), line


def test_every_oracle_that_a_test_names_is_described():
    page = (ROOT / "docs" / "oracles.md").read_text(encoding="utf-8")
    described = set(re.findall(r"^## (O\d+b?) ", page, re.MULTILINE))
    tests = {path.name: path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py")}
    named = {name for text in tests.values() for name in re.findall(r"\bO(?:1[0-6]|[1-9])b?\b", text)}
    assert len(named) > 8 and named <= described
    assert set(re.findall(r"`(test_\w+\.py)`", page)) <= set(tests)


def test_the_reference_has_every_name_of_the_package_once():
    text = "\n".join(page.read_text(encoding="utf-8") for page in (ROOT / "docs" / "reference").glob("*.md"))
    named = re.findall(r"^::: ([\w.]+)$", text, re.MULTILINE)
    assert len(set(named)) == len(named)
    listed = re.findall(r"members: \[([^\]]*)\]", text) + re.findall(r"^        - (\w+)$", text, re.MULTILINE)
    shown = [name.rsplit(".", 1)[-1] for name in named] + re.findall(r"\w+", " ".join(listed))
    top = re.findall(
        r"import \w+ as (\w+)$", (ROOT / "jaxir" / "__init__.py").read_text(encoding="utf-8"), re.MULTILINE
    )
    apart = {"alone", "at_target", "__version__"}  # in `quantity`, which is shown whole, and no part of the API
    assert len(top) > 80
    assert [name for name in top if shown.count(name) != 1 and name not in apart] == []
