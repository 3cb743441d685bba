"""Values that are legal and hardly meant, each of which gets one `PlausibilityWarning`.

`usual` stands beside the range of a field where it is declared, `within=(thermal, KELVIN)`; `doubt` is for what hangs
on several fields. `reach` is for what a model was made for: beyond it values are refused, or doubted where the model
was told to extrapolate. All look at known values on the host alone and are no operations of JAX. Zero is the same in
every unit and never doubted.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from jaxir._arrays import Check, known

SLACK = 1e-4  # of a limit, for limits that were rounded


def doubt(field: str, ok: Callable[..., Any], expected: str, value: Any, *others: Any) -> Check:
    """A check that warns unless `ok` of the value, and of others if given, holds; passes where they are not known."""
    here = [one for one in map(known, (value, *others)) if one is not None]
    if len(here) <= len(others):
        return Check(field, value, np.array(True), expected, doubt=True)
    holds = np.asarray(ok(*here))
    return Check(field, np.broadcast_to(here[0], holds.shape), holds, expected, doubt=True)


def usual(low: float, high: float, unit: str, below: str = "", above: str = "") -> Callable[..., Check]:
    """A check that warns of values outside a usual range, or of what is to be made `of` them first on the host.

    Args:
        low: lower end.
        high: upper end.
        unit: of both.
        below: what a value below the range suggests, for the message.
        above: what a value above it suggests.
    """
    least, most = low - SLACK * abs(low), high + SLACK * abs(high)

    def inside(value: np.ndarray) -> np.ndarray:
        ends = value.min(initial=high) < least or value.max(initial=low) > most  # spares large fields the rest
        return np.asarray((value == 0) | ~((value < least) | (value > most)) if ends else np.ones(value.shape, bool))

    def check(field: str, value: Any, of: Callable[[np.ndarray], np.ndarray] = np.asarray) -> Check:
        here, expected = known(value), f"{low:g} to {high:g} {unit} as a rule"
        if here is None:
            return Check(field, value, np.array(True), expected, doubt=True)
        here = np.asarray(of(here))
        ok = inside(here)
        hint = below if (here[~ok][:1] < low).any() else above
        return Check(field, here, ok, expected + (f"; {hint}" if hint else ""), doubt=True)

    return check


def reach(field: str, value: Any, low: float, high: float, unit: str, of: str, extrapolate: bool) -> Check:
    """A check of the range `low` to `high` that a model was made for; known values beyond it are refused or doubted.

    Args:
        field: name for the message.
        value: numbers, unchecked where jit has not got them.
        low: lower end.
        high: upper end.
        unit: of both.
        of: what was made for no more, as "the table of CO".
        extrapolate: whether the model was told to go on beyond.
    """
    span = f"{low:g} to {high:g} {unit}" if np.isfinite(low) else f"at most {high:g} {unit}"
    here, expected = known(value), f"{span}, for which {of} was made"
    if not extrapolate:
        expected += "; extrapolate=True goes on beyond"
    if here is None:
        return Check(field, value, np.array(True), expected, doubt=extrapolate)
    beyond = (here < low - SLACK * abs(low)) | (here > high + SLACK * abs(high))
    return Check(field, here, ~beyond, expected, doubt=extrapolate)


KELVIN = usual(100, 6000, "K", below="is it in degrees Celsius?")
PASCAL = usual(2e3, 5e6, "Pa", below="is it in hPa, kPa, bar or atm?")
WAVENUMBER = usual(50, 1e5, "cm-1", below="is it in um?", above="is it in m-1?")
ELEVATION = usual(-90, 90, "deg", below="is it an azimuth?", above="is it an azimuth?")
EXTENT = usual(0.05, 1000, "m", below="is it in km, or in m?", above="is it in mm?")
