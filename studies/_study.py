"""The frame of every study: command line, table, chart and answer.

A study is a module whose text begins with its question. Its `main` takes a `Run` and returns the answer:

    def options(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--rays", type=int, default=100, help="per pixel (%(default)s)")


    def main(run: Run) -> str:
        rows = [...]  # one dictionary per row
        run.table(rows)
        figure, axis = subplots(figsize=(5, 4))
        run.chart(figure)
        return "4 % at 100 rays"


    if __name__ == "__main__":
        study(main, options)

The command line is read where the study is run. An import or a call of `main` reads none.
"""

import argparse
import csv
import importlib.util
import json
import numbers
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
FIGURES = HERE / "figures"
EXTRAS = {
    "matplotlib": "studies",
    "miepython": "studies",
    "tifffile": "studies",
    "numba": "bench",
    "embreex": "peers",
    "pyvista": "cfd",
}


@dataclass(frozen=True)
class Run:
    """One run of a study.

    Attributes:
        name: of the study, and of its table and chart.
        options: the words of its command line.
        figures: folder of tables and charts.
        folder: folder of bulky results.
        written: paths of the tables and charts so far.
    """

    name: str
    options: argparse.Namespace
    figures: Path
    folder: Path
    written: list[Path] = field(default_factory=list)

    def table(self, rows: Sequence[Mapping[str, Any]], name: str | None = None, digits: int | None = 4) -> None:
        """Write a CSV.

        Args:
            rows: one mapping from column to value for each row. All have the columns of the first.
            name: of the file without its ending, instead of the study's name.
            digits: significant digits of a float. None writes all of them.
        """
        path = self._path(name, ".csv")
        with path.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, list(rows[0]))
            writer.writeheader()
            writer.writerows({key: _written(value, digits) for key, value in row.items()} for row in rows)

    def chart(self, figure: Any, name: str | None = None, dpi: int = 90, **settings: Any) -> None:
        """Write a PNG.

        Args:
            figure: of matplotlib.
            name: of the file without its ending, instead of the study's name.
            dpi: dots per inch.
            **settings: further ones of `Figure.savefig`.
        """
        figure.savefig(self._path(name, ".png"), dpi=dpi, **settings)

    def record(self, content: Mapping[str, Any], name: str | None = None) -> None:
        """Write a JSON file, for conditions and conclusions that fit no table."""
        self._path(name, ".json").write_text(json.dumps(content, indent=1), encoding="utf-8")

    def bulk(self, *parts: str) -> Path:
        """A folder inside `folder`, made where it is missing."""
        folder = self.folder.joinpath(*parts)
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def _path(self, name: str | None, suffix: str) -> Path:
        self.figures.mkdir(parents=True, exist_ok=True)
        path = self.figures / f"{name or self.name}{suffix}"
        if path not in self.written:
            self.written.append(path)
        return path


def _written(value: Any, digits: int | None) -> Any:
    rounds = digits is not None and isinstance(value, numbers.Real) and not isinstance(value, numbers.Integral)
    return f"{value:.{digits}g}" if rounds else value


def study(
    main: Callable[[Run], str],
    options: Callable[[argparse.ArgumentParser], None] | None = None,
    *,
    needs: Sequence[str] = ("matplotlib",),
    published: str = "",
) -> None:
    """Read the command line, run a study, and print its answer in one line with the elapsed time.

    Args:
        main: computes, writes and returns the answer. Its module's text begins with the question.
        options: adds the study's own options to the parser.
        needs: packages beyond those of jaxir.
        published: the command line whose table and chart lie in studies/figures. Those of other command lines go to
            studies/out/NAME, and so do bulky results of all.
    """
    module = sys.modules[main.__module__]
    name, question = Path(str(module.__file__)).stem, str(module.__doc__).split("\n")[0]
    parser = argparse.ArgumentParser(prog=f"python -m studies.{name}", description=question)
    if options is not None:
        options(parser)
    parser.add_argument("--out", type=Path, help=f"folder of all results (studies/figures or studies/out/{name})")
    if published:
        parser.epilog = f"studies/figures holds the results of `{parser.prog} {published}`"
    run = run_of(name, parser, sys.argv[1:], published)
    for package in needs:
        if importlib.util.find_spec(package) is None:
            parser.exit(2, f"{name}: needs {package}: pip install -e '.[{EXTRAS[package]}]'\n")
    began = time.perf_counter()
    try:
        answer = main(run)
    except ValueError as error:
        parser.exit(1, f"{name}: {error}\n")
    places = ", ".join(os.path.relpath(path) for path in run.written)
    print(f"{answer} ({time.perf_counter() - began:.0f} s{f'; see {places}' if places else ''})")


def run_of(name: str, parser: argparse.ArgumentParser, argv: Sequence[str], published: str = "") -> Run:
    """The run that a command line asks for."""
    chosen = parser.parse_args(argv)
    if chosen.out is not None:
        return Run(name, chosen, chosen.out, chosen.out)
    folder = HERE / "out" / name
    return Run(name, chosen, FIGURES if chosen == parser.parse_args(published.split()) else folder, folder)


def subplots(rows: int = 1, columns: int = 1, *, figsize: tuple[float, float], **settings: Any) -> tuple[Any, Any]:
    """Figure and axes of matplotlib, laid out by it; settings are those of `Figure.subplots`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=figsize, layout="constrained")
    return figure, figure.subplots(rows, columns, **settings)


def judge(what: str, got: float, goal: float, more_is_better: bool = True) -> str:
    """How far a number is from its goal."""
    good = got >= goal if more_is_better else got <= goal
    apart = got / goal if (got >= goal) else goal / got
    sign, verdict = ">=" if more_is_better else "<=", "met" if good else "MISSED"
    return f"{what}: {got:.3g} (goal {sign} {goal:g}), {verdict} by {apart:.2g} x"
