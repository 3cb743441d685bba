"""The example in the README runs as written."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def test_the_example_in_the_readme_runs(monkeypatch, capsys):
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert blocks
    monkeypatch.chdir(ROOT)
    for block in blocks:
        exec(compile(block, "README.md", "exec"), {})
    assert "W/sr" in capsys.readouterr().out


@pytest.mark.parametrize("name", re.findall(r"`studies\.(\w+)`", (ROOT / "README.md").read_text()))
def test_every_study_in_the_readme_exists(name):
    assert (ROOT / "studies" / f"{name}.py").is_file()


def test_continuous_integration_runs_the_readme_s_command():
    command = re.search(r"\*\*Run the tests:\*\*\n\n```sh\n(.*?)\n```", (ROOT / "README.md").read_text()).group(1)
    assert command in (ROOT / ".ci" / "run").read_text().splitlines()
