"""Charts and sentences that several studies make."""

from collections.abc import Mapping
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

from jaxir import plot  # noqa: E402
from jaxir.imaging import Image  # noqa: E402


def out_folder(study: str) -> Path:
    """Where a study writes: studies/out/NAME."""
    folder = Path(__file__).parent / "out" / study
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def radiance_panels(path: Path, images: Mapping[str, Image]) -> None:
    """Write `jaxir.plot.radiance_panels` to a file."""
    plot.radiance_panels(images).savefig(path, dpi=110, bbox_inches="tight")


def judge(what: str, got: float, goal: float, more_is_better: bool = True) -> str:
    """How far a number is from its goal."""
    good = got >= goal if more_is_better else got <= goal
    apart = got / goal if (got >= goal) else goal / got
    sign, verdict = ">=" if more_is_better else "<=", "met" if good else "MISSED"
    return f"{what}: {got:.3g} (goal {sign} {goal:g}), {verdict} by {apart:.2g} x"
