"""Values of a scene file that vary: the section `over`, whose tables are axes by name.

    [over.mach]
    values = [0.6, 0.9]
    keys = ["skin.temperature.mach"]

An axis gives its values to its `keys`; in `tables` a key has values of its own, one for each value of the axis. A state
is one value of every axis.
"""

from __future__ import annotations

import copy
import itertools
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxir.imaging import is_column
from jaxir.io._files import labels
from jaxir.io.scene_file._entries import Entry, numbers, text

_KEY = re.compile(r"[^.\[\]]+(\[\d+\])*(\.[^.\[\]]+(\[\d+\])*)*")


class Axis(NamedTuple):
    """What varies along an axis.

    Attributes:
        values: of the axis.
        keys: dotted keys of the file, each with its value for every value of the axis.
    """

    values: tuple[float, ...]
    keys: dict[str, list[Any]]


class States(NamedTuple):
    """All combinations of the values of some axes.

    Attributes:
        whole: the file, without its section `over`.
        axes: by name.
    """

    whole: Entry
    axes: dict[str, Axis]

    @property
    def over(self) -> dict[str, tuple[float, ...]]:
        """The values of every axis by its name, as `jaxir.io.result.sweep` takes them."""
        return {name: axis.values for name, axis in self.axes.items()}

    @property
    def every(self) -> list[dict[str, float]]:
        """All states, the last axis fastest."""
        return [dict(zip(self.axes, state, strict=True)) for state in itertools.product(*self.over.values())]

    @property
    def labels(self) -> dict[str, dict[float, str]]:
        """The values of every axis as text, by axis and value."""
        return {name: labels(values, 6) for name, values in self.over.items()}

    @property
    def new_keys(self) -> bool:
        """Whether keys are set that the file has not, which only a state that is built may find to be unknown."""
        every = (key for axis in self.axes.values() for key in axis.keys)
        return any(not _has(self.whole.value, _steps(key)) for key in every)

    def refuse(self, names: Sequence[str], reason: str) -> None:
        """Raise `ValueError` if something at, in or around a key of the file called one of `names` varies."""
        for name, axis in self.axes.items():
            for key in axis.keys:
                if any(_overlap([step for step in _steps(key) if isinstance(step, str)], _steps(one)) for one in names):
                    raise ValueError(f"{self.whole.file}: over.{name}: got the key {key!r}, expected others: {reason}")

    def at(self, /, **state: float) -> Entry:
        """The file in a state, of a value of every axis.

        Raises:
            ValueError: an axis that is missing or unknown, a value that an axis has not, a key of a table or array that
                the file has not.
        """
        if set(state) != set(self.axes):
            raise ValueError(
                f"{self.whole.file}: over: got {', '.join(state) or 'nothing'}, expected {', '.join(self.axes)}"
            )
        held = copy.deepcopy(self.whole.value)
        for name, value in state.items():
            axis = self.axes[name]
            if value not in axis.values:
                raise ValueError(f"{self.whole.file}: over.{name}: got {value:g}, expected one of {axis.values}")
            for key, values in axis.keys.items():
                _place(held, key, values[axis.values.index(value)], f"{self.whole.file}: over.{name}")
        return self.whole._replace(value=held)


def read_states(entry: Entry, whole: Entry) -> States:
    """The section `over` of a whole file.

    Raises:
        ValueError: an axis without a name of letters, without values or keys, with a value twice, with a key whose
            place the file has not or that another sets, too; names file and key.
    """
    rest = whole._replace(value={name: value for name, value in whole.value.items() if name != "over"})
    axes = {name: _axis(name, child) for name, child in entry.children().items()}
    if not axes:
        raise entry.wrong("at least one table, as over.mach")
    every = [(name, key) for name, axis in axes.items() for key in axis.keys]
    for (_, one), (name, key) in itertools.combinations(every, 2):
        if _overlap(_steps(one), _steps(key)):
            raise ValueError(f"{entry.file}: over.{name}: got the key {key!r}, expected one apart from {one!r}")
    states = States(rest, axes)
    states.at(**states.every[0])  # its errors are those of all
    return states


def _axis(name: str, entry: Entry) -> Axis:
    if not re.fullmatch(r"[A-Za-z]\w*", name) or is_column(name):
        raise entry.wrong(f"a name of letters, digits and _ that no column has; got {name!r}")
    found = entry.only(["values", "keys", "tables"], ["values"])
    values = np.asarray(numbers(found["values"]), np.float64)
    if values.ndim != 1 or values.size == 0 or np.unique(values).size < values.size:
        raise found["values"].wrong("different numbers")
    given = found["values"].value if isinstance(found["values"].value, list) else values.tolist()
    keys = {text(item): given for item in found["keys"].items()} if "keys" in found else {}
    for key, column in (found["tables"].children() if "tables" in found else {}).items():
        if len(column.items()) != values.size:
            raise column.wrong(f"{values.size} values, one for each of {entry.key}.values")
        if key in keys:
            raise column.wrong(f"no values: {key!r} is among {entry.key}.keys")
        keys[key] = column.value
    for key in keys:
        if not _KEY.fullmatch(key):
            raise ValueError(f"{entry.file}: {entry.key}: got the key {key!r}, expected one as sources[1].direction")
    if not keys:
        raise entry.wrong("keys or tables, which say what varies")
    return Axis(tuple(values.tolist()), keys)


def _steps(key: str) -> list[str | int]:
    """Names and indices of a dotted key."""
    return [int(index) if index else name for name, index in re.findall(r"([^.\[\]]+)|\[(\d+)\]", key)]


def _overlap(one: Sequence[str | int], other: Sequence[str | int]) -> bool:
    """Whether two keys are the same place, or one lies in the other."""
    return all(a == b for a, b in zip(one, other, strict=False))


def _has(held: Any, steps: Sequence[str | int]) -> bool:
    for step in steps[:-1]:
        held = held[step]
    return isinstance(steps[-1], int) or steps[-1] in held


def _place(held: Any, key: str, value: Any, about: str) -> None:
    """Put a value where a dotted key says, as `sources[1].direction`."""
    steps = _steps(key)
    for step, after in zip(steps, [*steps[1:], None], strict=True):
        there = isinstance(step, str) and isinstance(held, dict) and (after is None or step in held)
        if not there and not (isinstance(step, int) and isinstance(held, list) and step < len(held)):
            raise ValueError(f"{about}: got the key {key!r}, expected one of the file: it has no {step!r} there")
        if after is None:
            held[step] = value
        else:
            held = held[step]
