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
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Int

from jaxir._fields import require_count
from jaxir.imaging._devices import item_by_item
from jaxir.imaging._tolerance import FIRST, Goal, Tolerance, seconds_of, tolerance_of

MARGIN = 0.9  # of the error asked for that is aimed at: what the first look tells is itself uncertain
ROUNDS = 3  # at most, after the first look; each decides for the next
ERRORS = (1, 5)  # places of standard errors in what a look finds


class Repeats(NamedTuple):
    """How long views are looked at.

    Attributes:
        tolerance: what is asked of each.
        looks: at a view, at most.
        seconds: of all looks at all views, at most, without compiling; one look at each is taken in any case.
    """

    tolerance: Tolerance
    looks: int
    seconds: float

    def goal(self, samples: int) -> Goal:
        """What is asked of one view by looks of so many rays per pixel."""
        return Goal(self.tolerance, None, self.looks * samples, math.inf)


def repeats(
    rtol: float | None, atol: float | None, samples: int, max_samples: int, max_seconds: float | None
) -> Repeats | None:
    """How long views are looked at; None for once.

    Args:
        rtol: of `tolerance_of`.
        atol: of `tolerance_of`.
        samples: rays per pixel of one look.
        max_samples: of all looks at a view.
        max_seconds: of all looks at all views; None for no limit.

    Raises:
        ValueError: as `tolerance_of` and `seconds_of`; fewer rays at most than those of one look.
    """
    require_count("max_samples", max_samples)
    tolerance = tolerance_of(rtol, atol)
    seconds = seconds_of(max_seconds, "rtol or atol", tolerance is not None)
    if tolerance is None:
        return None
    if max_samples < samples:
        raise ValueError(f"max_samples: got {max_samples}, expected at least samples = {samples}")
    return Repeats(tolerance, max_samples // samples, seconds)


def until_met(
    look: Callable[[Any, Any], tuple[Array, ...]],
    inputs: Any,
    views: Int[np.ndarray, " some"],
    looks_at: Callable[[Int[np.ndarray, " look"], Int[np.ndarray, " look"]], Any],
    asked: Repeats | None,
    label: str,
    devices: Mesh | None,
) -> Iterator[tuple[int, list[np.ndarray]]]:
    """Views and what was found of each, as it is ready.

    Args:
        look: `look(inputs, item)` of a look at a view: its intensity, its standard error, the share left out and the
            contrast [band], and by component the first two; compiled once.
        inputs: its first argument.
        views: those to look at.
        looks_at: the items of looks, stacked, of their views and their numbers, which count through the looks at each.
        asked: what is asked of each; None for one look.
        label: of the progress bar.
        devices: that share the looks; None for one.
    """
    left, each = math.inf if asked is None else asked.seconds, 0.0
    first = 2 if len(views) == 1 and left < math.inf else 1  # the first look compiles and tells no time
    wanted = {int(view): first for view in views}
    begin, squared = dict.fromkeys(wanted, 0), dict.fromkeys(wanted, 0.0)
    for round_ in range(1 + ROUNDS):
        every = [(v, number) for v, looks in wanted.items() for number in range(begin[v], begin[v] + looks)]
        items = looks_at(np.array([v for v, _ in every], np.int32), np.array([n for _, n in every], np.int32))
        more: dict[int, int] = {}
        short: dict[int, list[np.ndarray]] = {}
        seen: list[list[np.ndarray]] = []
        times = []
        for places, found in item_by_item(look, inputs, items, label, devices):
            times.append(time.perf_counter())
            rows = [np.asarray(part)[None] if devices is None else np.asarray(part) for part in found]
            for row, place in enumerate(places.tolist()):
                seen.append([part[row] for part in rows])
                view, _ = every[place]
                if len(seen) < wanted[view]:
                    continue
                values, seen = _mean(seen), []
                excess = 0.0 if asked is None else float(asked.tolerance.excess(values[0], values[1]))
                begin[view] += wanted[view]
                if asked is None or _ends(excess, round_, wanted[view] == asked.looks):
                    yield view, values
                else:
                    squared[view] = max(squared[view], excess**2 * wanted[view])
                    more[view] = max(1, math.ceil(min(squared[view] / MARGIN**2, asked.looks)))
                    short[view] = values
        if not more:
            return
        each = (times[-1] - times[0]) / (len(every) - 1) if len(every) > 1 else each
        left -= each * len(every)
        wanted = _in_time(more, left / each if each > 0 else math.inf)
        yield from ((view, values) for view, values in short.items() if view not in wanted)


def _in_time(wanted: dict[int, int], looks: float) -> dict[int, int]:
    """Looks at each view, all shortened alike where so many are not allowed in all; none where not one at each is."""
    total = sum(wanted.values())
    if total <= looks:
        return wanted
    return {view: max(1, int(number * looks / total)) for view, number in wanted.items()} if looks > len(wanted) else {}


def _ends(excess: float, round_: int, all_allowed: bool) -> bool:
    """Whether looks at a view are the answer: they meet what is asked, or no more will come."""
    last = round_ == ROUNDS or round_ > 0 and all_allowed
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
