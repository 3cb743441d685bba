"""Fields of physical objects, each declared once: its name, unit, shape and range.

From `radius: Float[Array, ""] = quantity("m", within=positive)` in a `Physical` follow the constructor's argument, its
conversion to an array of the floating dtype in force, the check of its shape when it is constructed, and that of its
values at the entry of a computation. All of them call the field by its one name, as scene files do.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import equinox as eqx
from jaxtyping import Array

from jaxir._arrays import Check, as_float, finite, non_negative, require_shape

Shape = tuple[int | str, ...] | None
Spread = Callable[[Array], Array]
_DECLARED = "quantity"


@dataclasses.dataclass(frozen=True)
class _Quantity:
    """What is declared of a field."""

    unit: str
    shape: Shape
    within: Callable[[str, Array], Check]
    spread: Spread | None


def _given(value: Any) -> Any:
    """The argument as it was given; `Physical` converts it, which knows the field's name."""
    return value


def quantity(
    unit: str,
    shape: Shape = (),
    within: Callable[[str, Array], Check] = finite,
    spread: Spread | None = None,
    **options: Any,
) -> Any:
    """A field of numbers.

    Args:
        unit: of the numbers; "1" for none.
        shape: lengths of the axes; a name stands for any length, the same wherever it occurs in one object, and None
            for any shape.
        within: the check that the values must pass, e.g. `jaxir._arrays.positive`.
        spread: what makes an array of another shape one of this shape, e.g. `per_node`; None for nothing.
        options: `default` and `kw_only` of a dataclass field. A field whose default is None may be None.
    """
    declared = _Quantity(unit, shape, within, spread)
    return eqx.field(converter=_given, metadata={_DECLARED: declared}, **options)


def per_node(value: Array) -> Array:
    """One number as an array with a node axis of length 1, others as they are."""
    return value[None] if value.ndim == 0 else value


def spectral(unit: str, within: Callable[[str, Array], Check] = non_negative, **options: Any) -> Any:
    """A field with one number for all nodes, or one for each [node or 1]."""
    return quantity(unit, ("node",), within, per_node, **options)


def count(least: int = 1, **options: Any) -> Any:
    """A field that is an integer of at least `least`; it is structure."""
    return eqx.field(static=True, metadata={"least": least}, **options)


def require_count(field: str, value: Any, least: int = 1) -> int:
    """`value`, or `ValueError` unless it is an integer of at least `least`."""
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise ValueError(f"{field}: got {value!r}, expected an integer >= {least}")
    return value


class Physical(eqx.Module):
    """An object whose fields are declared by `quantity`, `spectral` and `count`."""

    def __check_init__(self) -> None:
        lengths: dict[str, int] = {}
        for name, declared in _declared(self):
            value = getattr(self, name)
            if value is None:
                continue
            field = f"{type(self).__name__}.{name}"
            array = as_float(value, field)
            array = array if declared.spread is None else declared.spread(array)
            if declared.shape is not None:
                known = tuple(lengths.get(axis, axis) if isinstance(axis, str) else axis for axis in declared.shape)
                require_shape(field, array, known)
                lengths |= {
                    axis: length
                    for axis, length in zip(declared.shape, array.shape, strict=True)
                    if isinstance(axis, str) and axis != "node"  # 1 stands for all nodes
                }
            object.__setattr__(self, name, array)
        for entry in dataclasses.fields(self):
            if "least" in entry.metadata:
                require_count(f"{type(self).__name__}.{entry.name}", getattr(self, entry.name), entry.metadata["least"])

    def checks(self) -> list[Check]:
        """What must hold of the values: the range of every field, of every part, and `relations`."""
        ranges = [
            declared.within(f"{type(self).__name__}.{name}", getattr(self, name))
            for name, declared in _declared(self)
            if getattr(self, name) is not None
        ]
        parts = [getattr(self, entry.name) for entry in dataclasses.fields(self)]
        every = [one for part in parts for one in (part if isinstance(part, tuple) else (part,))]
        return [
            *ranges,
            *(check for part in every if hasattr(part, "checks") for check in part.checks()),
            *self.relations(),
        ]

    def relations(self) -> list[Check]:
        """What must hold between the fields, beyond the range of each."""
        return []


def _declared(of: Physical) -> Iterator[tuple[str, _Quantity]]:
    for entry in dataclasses.fields(of):
        if _DECLARED in entry.metadata:
            yield entry.name, entry.metadata[_DECLARED]
