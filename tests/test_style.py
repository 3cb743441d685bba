"""Lint, format and types of the whole repository, by the tools' own settings in pyproject.toml."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize(
    "words", [("ruff", "check"), ("ruff", "format", "--check"), ("mypy",)], ids=lambda words: " ".join(words)
)
def test_the_tool_finds_nothing(words):
    command = [sys.executable, "-m", *words]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, f"{done.stdout}{done.stderr}"


def test_the_package_says_that_it_is_typed():
    assert (ROOT / "jaxir" / "py.typed").is_file()
