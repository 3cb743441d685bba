"""Views looked at until the error asked for is met, each as often as it needs.

An answer that stops by the error of the samples that it averages is biased: it stops early where they missed what is
rare and bright (Kirk and Arvo, "Unbiased sampling techniques for image synthesis", 1991). So a first look decides how
many looks a view takes,

    n = (e / (MARGIN asked))^2,

e its standard error of the worst band, and n others, of other random numbers, are the answer; or the first look is, if
it errs by less than a third of what is asked. Where the answer errs by more than was asked it is thrown away, too, and
decides for the next, `ROUNDS` times at most. The looks are of one program, and independent of one another: their mean
has the mean of their variances over their number.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Float, Int

from jaxir._arrays import float_dtype
from jaxir.imaging._devices import item_by_item

MARGIN = 0.9  # of the error asked for that is aimed at: what the first look tells is itself uncertain
ROUNDS = 3  # at most, after the first look; each decides for the next
ERRORS = (1, 4)  # places of standard errors in what a look finds
LEAST = 8  # units of the last place: a relative tolerance below is beyond the precision in force
FIRST = 1 / 3  # of the error asked for, at which the first look is the answer: few rays tell their own error poorly


class Tolerance(NamedTuple):
    """What is asked of the intensities of a view.

    Attributes:
        rtol: standard error as a share of the intensity.
        atol: standard error that is good enough for any intensity [W sr-1].
        looks: at a view, at most.
    """

    rtol: float
    atol: float
    looks: int

    def excess(
        self, intensity: Float[np.ndarray, "*view band"], error: Float[np.ndarray, "*view band"]
    ) -> Float[np.ndarray, "*view"]:
        """Standard error over what is asked, of the worst band; 0 for what is exact, inf for what can not be met."""
        asked = np.maximum(self.rtol * np.abs(intensity), self.atol)
        beyond = np.where(error > 0, np.inf, 0.0)
        return np.asarray(np.divide(error, asked, out=beyond, where=asked > 0).max(axis=-1))


def require_rtol(rtol: float, name: str = "rtol") -> None:
    """Raise `ValueError` unless the tolerance is positive and the precision in force can hold it."""
    if not rtol > 0:
        raise ValueError(f"{name}: got {rtol}, expected > 0")
    dtype = float_dtype()
    least = LEAST * float(np.finfo(dtype).eps)
    if rtol < least:
        double = LEAST * float(np.finfo(np.float64).eps)
        need = "float64: jax.config.update('jax_enable_x64', True)" if rtol >= double else "more than float64"
        raise ValueError(f"{name}: got {rtol}, expected at least {least:.2g} in {dtype}; {rtol} needs {need}")


def require_tolerance(
    rtol: float | None, atol: float | None, samples: int = 1, max_samples: int = 1
) -> Tolerance | None:
    """What is asked, None where nothing is.

    Args:
        rtol: of `Tolerance`; None for 0.
        atol: of `Tolerance`; None for 0.
        samples: rays per pixel of one look.
        max_samples: of all looks at a view.

    Raises:
        ValueError: tolerances <= 0 or beyond the precision in force; fewer rays at most than those of one look.
    """
    if rtol is not None:
        require_rtol(rtol)
    if atol is not None and not 0 < atol < math.inf:
        raise ValueError(f"atol: got {atol}, expected a finite value > 0")
    if rtol is None and atol is None:
        return None
    if max_samples < samples:
        raise ValueError(f"max_samples: got {max_samples}, expected at least samples = {samples}")
    return Tolerance(rtol or 0.0, atol or 0.0, max_samples // samples)


def until_met(
    look: Callable[[Any, Array], tuple[Array, ...]],
    inputs: Any,
    views: Int[np.ndarray, " some"],
    count: int,
    tolerance: Tolerance | None,
    label: str,
    devices: Mesh | None,
) -> Iterator[tuple[int, list[np.ndarray]]]:
    """Views and what was found of each, as it is ready.

    Args:
        look: `look(inputs, view + number * count)` of a look at a view: its intensity, its standard error and the share
            left out [band], and by component the same two; compiled once.
        inputs: its first argument.
        views: those to look at.
        count: of all views.
        tolerance: what is asked of each; None for one look.
        label: of the progress bar.
        devices: that share the looks; None for one.
    """
    wanted = {int(view): 1 for view in views}
    begin, squared = dict.fromkeys(wanted, 0), dict.fromkeys(wanted, 0.0)
    for round_ in range(1 + ROUNDS):
        items = [v + count * number for v, looks in wanted.items() for number in range(begin[v], begin[v] + looks)]
        more: dict[int, int] = {}
        seen: list[list[np.ndarray]] = []
        for index, found in item_by_item(look, inputs, np.asarray(items, np.int32), label, devices):
            rows = [np.asarray(part)[None] if devices is None else np.asarray(part) for part in found]
            for place, item in enumerate(index.tolist()):
                seen.append([part[place] for part in rows])
                view = item % count
                if len(seen) < wanted[view]:
                    continue
                values, seen = _mean(seen), []
                excess = 0.0 if tolerance is None else float(tolerance.excess(values[0], values[1]))
                begin[view] += wanted[view]
                if tolerance is None or _ends(excess, round_, wanted[view], tolerance):
                    yield view, values
                else:
                    squared[view] = max(squared[view], excess**2 * wanted[view])
                    more[view] = max(1, math.ceil(min(squared[view] / MARGIN**2, tolerance.looks)))
        if not more:
            return
        wanted = more


def _ends(excess: float, round_: int, looks: int, tolerance: Tolerance) -> bool:
    """Whether looks at a view are the answer: they meet what is asked, or no more will come."""
    last = round_ == ROUNDS or round_ > 0 and looks == tolerance.looks
    return excess <= (FIRST if round_ == 0 else 1) or last


def _mean(seen: list[list[np.ndarray]]) -> list[np.ndarray]:
    """What independent looks found together."""
    if len(seen) == 1:
        return seen[0]
    every = [np.stack(part) for part in zip(*seen, strict=True)]
    return [
        (np.sqrt((part**2).sum(axis=0)) / len(seen) if place in ERRORS else part.mean(axis=0)).astype(part.dtype)
        for place, part in enumerate(every)
    ]
