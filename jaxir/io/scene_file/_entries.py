"""Values of a TOML file that know their file and key, and objects built from them.

A constructor, class or function, is called with the keys of a table: the names are those of its parameters, what is
required is what has no default. So a scene file says what Python says, and a new parameter is a new key.
"""

from __future__ import annotations

import datetime
import difflib
import inspect
import math
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from jaxir._arrays import enforce, float_dtype
from jaxir.io._files import largest_number, read_text, require_file
from jaxir.io.field import load_array
from jaxir.optics.air import air_pressure, air_temperature

LARGEST_FILE = 64 * 2**20  # bytes of a scene file
MOST_CELLS = 2**26  # pixels of an image, cells of a grid
MOST_NESTED = 8  # arrays in arrays
_LEAF = (int, float)
COMPUTED: dict[str, Callable] = {"air_temperature": air_temperature, "air_pressure": air_pressure}


class Entry(NamedTuple):
    """A value in a scene file.

    Attributes:
        file: the file.
        key: dotted, with the index of a table among several, e.g. `sources[1].direction`; empty for the whole file.
        value: as TOML has it.
        fields: what `{ field = "name" }` may refer to, by name.
    """

    file: Path
    key: str
    value: Any
    fields: Mapping[str, np.ndarray] = {}

    def wrong(self, expected: str) -> ValueError:
        """The error of a value that is not what was expected."""
        return ValueError(f"{self._place}: got {_shown(self.value)}, expected {expected}")

    def failed(self, error: Exception) -> ValueError:
        """An error of what was built from this value, with the place in front."""
        said = " ".join(str(error).split())
        return ValueError(said if said.startswith(f"{self.file}: ") else f"{self._place}: {said}")

    @property
    def _place(self) -> str:
        return f"{self.file}: {self.key}" if self.key else str(self.file)

    def children(self) -> dict[str, Entry]:
        """The keys of a table."""
        if not isinstance(self.value, dict):
            raise self.wrong("a table")
        dot = f"{self.key}." if self.key else ""
        return {name: self._replace(key=f"{dot}{name}", value=value) for name, value in self.value.items()}

    def items(self) -> list[Entry]:
        """The members of an array."""
        if not isinstance(self.value, list):
            raise self.wrong("an array")
        return [self._replace(key=f"{self.key}[{i}]", value=value) for i, value in enumerate(self.value)]

    def only(self, known: Iterable[str], required: Iterable[str] = ()) -> dict[str, Entry]:
        """The keys of a table none of which may be unknown or, if required, absent."""
        children, known = self.children(), list(known)
        for name, child in children.items():
            if name not in known:
                raise ValueError(f"{child._place}: unknown key, expected {_choice(name, known)}")
        for name in required:
            if name not in children:
                raise ValueError(f"{self._place}: got no key {name}, which it needs")
        return children


Reader = Callable[[Entry], Any]


def read_toml(path: Path) -> Entry:
    """The whole of a TOML file.

    Raises:
        ValueError: no such file, too large, not UTF-8, not TOML; names file and, where there is one, line.
    """
    require_file(path)
    if path.stat().st_size > LARGEST_FILE:
        raise ValueError(f"{path}: got {path.stat().st_size} bytes, expected a scene file of at most {LARGEST_FILE}")
    try:
        return Entry(path, "", tomllib.loads(read_text(path)))
    except (ValueError, RecursionError) as error:  # also of integers too long to be read
        if str(error).startswith(f"{path}:"):
            raise
        raise ValueError(f"{path}: not readable as TOML ({error})") from error


def text(entry: Entry) -> str:
    """A string that is not empty."""
    if not isinstance(entry.value, str) or not entry.value:
        raise entry.wrong("a string")
    return entry.value


def one_of(names: Sequence[str]) -> Reader:
    """One of some strings."""

    def read(entry: Entry) -> str:
        if text(entry) not in names:
            raise entry.wrong(_choice(entry.value, names))
        return entry.value

    return read


def existing_file(entry: Entry) -> Path:
    """A file, its path relative to the folder of the scene file."""
    path = entry.file.parent / text(entry)
    if not path.is_file():
        raise entry.wrong(f"a file: there is no {path}")
    return path


def _existing_files(entry: Entry) -> Path | list[Path]:
    """A file, or several."""
    return [existing_file(item) for item in entry.items()] if isinstance(entry.value, list) else existing_file(entry)


def integer(entry: Entry) -> int:
    """An integer."""
    if isinstance(entry.value, bool) or not isinstance(entry.value, int):
        raise entry.wrong("an integer")
    if abs(entry.value) > 2**31 - 1:
        raise entry.wrong("an integer of 32 bits")
    return entry.value


def _sizes(axes: int) -> Reader:
    """Numbers of rows and columns, or of cells along each axis."""

    def read(entry: Entry) -> tuple[int, ...]:
        counts = tuple(integer(item) for item in entry.items())
        if len(counts) != axes or min(counts) < 1 or math.prod(counts) > MOST_CELLS:
            raise entry.wrong(f"{axes} integers >= 1 whose product is at most {MOST_CELLS}")
        return counts

    return read


def truth(entry: Entry) -> bool:
    """True or false."""
    if not isinstance(entry.value, bool):
        raise entry.wrong("true or false")
    return entry.value


def number(entry: Entry) -> float:
    """A finite number."""
    if isinstance(entry.value, bool) or not isinstance(entry.value, _LEAF):
        raise entry.wrong("a finite number")
    if not abs(entry.value) <= largest_number():
        raise entry.wrong(f"a finite number in {float_dtype()}")
    return float(entry.value)


def positive_or_infinite(entry: Entry) -> float:
    """A number > 0, `inf` included."""
    if entry.value == math.inf:
        return math.inf
    if number(entry) <= 0:
        raise entry.wrong("a number > 0 or inf")
    return float(entry.value)


def _moment(entry: Entry) -> datetime.datetime:
    """Date and time with a zone."""
    if not isinstance(entry.value, datetime.datetime) or entry.value.tzinfo is None:
        raise entry.wrong("date and time with a zone, as 2026-06-21T12:00:00Z")
    return entry.value


_OF_TYPE: dict[str, Reader] = {  # by the annotation of a parameter
    "float": number,
    "float | None": number,
    "int": integer,
    "bool": truth,
    "tuple[int, int]": _sizes(2),
    "tuple[int, int, int]": _sizes(3),
    "datetime.datetime": _moment,
    "Path": existing_file,
    "str | os.PathLike": existing_file,
    "str | os.PathLike | Sequence[str | os.PathLike]": _existing_files,
}


def numbers(entry: Entry, nested: int = 0) -> float | np.ndarray:
    """A number, an array of numbers, or numbers elsewhere.

    `{ path = "file.npz", array = "name" }` and `{ path = "file.npy" }` stand for an array in a file,
    `{ field = "name" }` for a field of the flow that a plume is read from, `{ type = "air_temperature", ... }` for what
    one of `COMPUTED` returns.
    """
    if isinstance(entry.value, dict):
        return _elsewhere(entry)
    if not isinstance(entry.value, list):
        return number(entry)
    if nested == MOST_NESTED:
        raise entry.wrong(f"at most {MOST_NESTED} arrays in one another")
    members = [np.asarray(numbers(item, nested + 1), np.float64) for item in entry.items()]
    for member, item in zip(members, entry.items(), strict=True):
        if member.shape != members[0].shape:
            raise item.wrong(f"as many numbers as {entry.key}[0] has")
    return np.stack(members) if members else np.zeros(0)


def _elsewhere(entry: Entry) -> float | np.ndarray:
    if "type" in entry.value:
        value = np.asarray(build(entry, COMPUTED, {}), np.float64)
        return value if value.ndim else float(value)
    if "field" in entry.value:
        name = one_of(list(entry.fields))
        if not entry.fields:
            raise entry.wrong("numbers; `field` refers to the flow of a plume that is read from a file")
        return entry.fields[name(entry.only(["field"])["field"])]
    keys = entry.only(["path", "array"], ["path"])
    path = existing_file(keys["path"])
    array = text(keys["array"]) if "array" in keys else None
    try:
        return load_array(path, array)
    except ValueError as error:
        raise entry.failed(error) from error


def build(entry: Entry, constructors: Mapping[str, Callable], readers: Mapping[str, Reader], default: str = "") -> Any:
    """The object that a table describes.

    Args:
        entry: the table; its key `type` names the constructor.
        constructors: classes and functions by name.
        readers: as `construct`.
        default: the constructor of a table without `type`; it may also be absent where there is only one.

    Returns:
        What the constructor returns.

    Raises:
        ValueError: as `construct`, or no such type.
    """
    children = entry.children()
    name = default or (next(iter(constructors)) if len(constructors) == 1 else "")
    if "type" in children:
        name = one_of(list(constructors))(children["type"])
    elif not name:
        raise ValueError(f"{entry._place}: got no key type, expected {_choice('', list(constructors))}")
    return construct(entry, constructors[name], readers)


def construct(entry: Entry, constructor: Callable, readers: Mapping[str, Reader], **known: Any) -> Any:
    """Call a constructor with the keys of a table.

    Args:
        entry: the table; a key `type` is not looked at.
        constructor: class or function.
        readers: how values are read, by parameter; the others are read as their annotation asks (a number, sizes, a
            file), or by `numbers`.
        known: parameters that are no keys, with their values.

    Returns:
        What the constructor returns, once its checks hold.

    Raises:
        ValueError: a key that is no parameter or is missing, a value of another type, or whatever the constructor
            and its checks find; names file, key, what was got and what was expected.
    """
    given = arguments(entry, constructor, readers, tuple(known))
    try:
        return checked(constructor(**known, **given))
    except (ValueError, TypeError, ArithmeticError, LookupError, ImportError) as error:
        raise entry.failed(error) from error


def arguments(
    entry: Entry, constructor: Callable, readers: Mapping[str, Reader], known: Sequence[str] = ()
) -> dict[str, Any]:
    """The values of a table by parameter of a constructor; arguments and errors as `construct`."""
    parameters = {n: p for n, p in inspect.signature(constructor).parameters.items() if n not in known}
    required = [name for name, parameter in parameters.items() if parameter.default is parameter.empty]
    children = entry.only(["type", *parameters], required)
    annotated = {name: _OF_TYPE.get(parameter.annotation, numbers) for name, parameter in parameters.items()}
    return {
        name: readers.get(name, annotated.get(name, numbers))(child)
        for name, child in children.items()
        if name != "type"
    }


def checked(built: Any) -> Any:
    """`built`, once its own checks hold."""
    return enforce(built, built.checks()) if isinstance(built, eqx.Module) and hasattr(built, "checks") else built


def _choice(name: Any, known: Sequence[str]) -> str:
    """The known names, and the one that was probably meant."""
    near = difflib.get_close_matches(str(name).lower(), [one.lower() for one in known], 1)
    meant = [one for one in known if near and one.lower() == near[0]]
    listed = f"one of {', '.join(known)}" if known else "none"
    return f"{listed} (did you mean {meant[0]}?)" if meant else listed


def _shown(value: Any) -> str:
    shown = repr(value)
    return shown if len(shown) <= 60 else shown[:57] + "..."
