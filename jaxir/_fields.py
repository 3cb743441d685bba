"""Fields of physical objects, each declared once: its name, unit, shape and range.

From `radius: Float[Array, ""] = quantity("m", within=positive)` in a `Physical` follow the constructor's argument, its
conversion to an array of the floating dtype in force, the check of its shape when it is constructed, and that of its
values at the entry of a computation. All of them call the field by its one name, as scene files do.
"""

from __future__ import annotations

import abc
import dataclasses
import operator
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, TypeVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._arrays import Check, as_float, broadcast, finite, non_negative, on_host, reshaped
from jaxir._programs import program

Axes = tuple[int | str, ...]
Range = Callable[[str, Array], Check]
Spread = Callable[[Array], Array]
P = TypeVar("P", bound="Physical")
_DECLARED = "quantity"
_ONE_FOR_ALL = ("face", "node")  # axes along which length 1 stands for every face or node


@dataclasses.dataclass(frozen=True)
class _Quantity:
    """What is declared of a field."""

    unit: str
    shape: Axes | None
    within: tuple[Range, ...]
    spread: Spread | None
    least: int
    light: bool


def _given(value: Any) -> Any:
    """The argument as it was given; `Physical` converts it, which knows the field's name."""
    return value


def quantity(
    unit: str,
    shape: Axes | None = (),
    within: Range | tuple[Range, ...] = finite,
    spread: Spread | None = None,
    least: int = 0,
    light: bool = False,
    **options: Any,
) -> Any:
    """A field of numbers.

    Args:
        unit: of the numbers; "1" for none.
        shape: lengths of the axes; a name stands for any length, the same wherever it occurs in one object, and None
            for any shape. Axes named "face" or "node" may have length 1, which stands for all of them. A first name
            with a star, as "*cell", stands for any number of axes, the same in one object, or for none.
        within: the check that the values must pass, e.g. `jaxir._arrays.positive`, or several.
        spread: what makes an array of another shape one of this shape, e.g. `per_node`; None for nothing.
        least: smallest length of every axis.
        light: whether an `AbstractSpectrum` may stand for the numbers, which has what the axes before the last are.
        options: `default` and `kw_only` of a dataclass field. A field whose default is None may be None.
    """
    ranges = within if isinstance(within, tuple) else (within,)
    declared = _Quantity(unit, shape, ranges, spread, least, light)
    return eqx.field(converter=_given, metadata={_DECLARED: declared}, **options)


def per_node(value: Array) -> Array:
    """One number as an array with a node axis of length 1, others as they are."""
    return broadcast(value, (1,)) if value.ndim == 0 else value


def per_face(value: Array) -> Array:
    """One number or one for each face as an array with the axes face and node, others as they are."""
    return reshaped(value, value.shape + (1,) * (2 - value.ndim)) if value.ndim else reshaped(value, (1, 1))


def spectral(unit: str, within: Range | tuple[Range, ...] = non_negative, **options: Any) -> Any:
    """A field with one number for all nodes, or one for each [node or 1]."""
    return quantity(unit, ("node",), within, per_node, **options)


def light(unit: str, within: Range | tuple[Range, ...] = non_negative, **options: Any) -> Any:
    """As `spectral`, or an `AbstractSpectrum`."""
    return quantity(unit, ("node",), within, per_node, light=True, **options)


def count(least: int = 1, **options: Any) -> Any:
    """A field that is an integer of at least `least`; it is structure."""
    return eqx.field(static=True, metadata={"least": least}, **options)


def flag(**options: Any) -> Any:
    """A field that is True or False; it is structure."""
    return eqx.field(static=True, kw_only=True, default=False, metadata={"flag": True}, **options)


def require_count(field: str, value: Any, least: int = 1) -> int:
    """`value`, or `ValueError` unless it is an integer of at least `least`."""
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise ValueError(f"{field}: got {value!r}, expected an integer >= {least}")
    return value


def require_counts(field: str, value: Any, what: str, many: int) -> tuple[int, ...]:
    """`value` as so many integers >= 1, or `ValueError`, which says `what` they are."""
    try:
        counts = tuple(map(operator.index, value))
    except TypeError:
        counts = ()
    if len(counts) != many or min(counts) < 1 or any(isinstance(each, bool) for each in value):
        raise ValueError(f"{field}: got {value!r}, expected {what}, integers >= 1")
    return counts


def require_part(field: str, value: Any, kind: type, expected: str) -> None:
    """`ValueError` unless `value` is of a kind of part; a number takes the place of {} in what is `expected`."""
    if not isinstance(value, kind):
        number = isinstance(value, (int, float))
        got = f"{value!r}" if number or isinstance(value, str | type) else f"a {type(value).__name__}"
        raise ValueError(f"{field}: got {got}, expected {expected.format(value if number else '...')}")


class Physical(eqx.Module):
    """An object whose fields are declared by `quantity`, `spectral`, `count` and `flag`."""

    def __check_init__(self) -> None:
        known: dict[str, tuple[int, ...]] = {}
        for name, declared in _declared(self):
            value = getattr(self, name)
            if value is None and self.__dataclass_fields__[name].default is None:
                continue
            field = f"{type(self).__name__}.{name}"
            if isinstance(value, AbstractSpectrum) and declared.light:
                _require_axes(field, (*value.batch, 1), declared, known)
                continue
            array = as_float(value, field)
            array = array if declared.spread is None else declared.spread(array)
            _require_axes(field, array.shape, declared, known)
            object.__setattr__(self, name, array)
        for entry in dataclasses.fields(self):
            if "least" in entry.metadata:
                require_count(f"{type(self).__name__}.{entry.name}", getattr(self, entry.name), entry.metadata["least"])
            if "flag" in entry.metadata and not isinstance(getattr(self, entry.name), bool):
                got = getattr(self, entry.name)
                raise ValueError(f"{type(self).__name__}.{entry.name}: got {got!r}, expected True or False")
        self.structure()

    def structure(self) -> None:
        """Raise `ValueError` where shapes do not suit, beyond what is declared of each field."""

    def checks(self) -> list[Check]:
        """What must hold of the values: the range of every field, of every part, `relations` and `doubts`."""
        ranges = [
            within(f"{type(self).__name__}.{name}", value)
            for name, declared, value in _numbers(self)
            for within in declared.within
        ]
        return [
            *ranges,
            *self.doubts(),
            *(check for part in self._parts() for check in part.checks()),
            *(_compiled_relations(self) if type(self).relations is not Physical.relations else []),
        ]

    def relations(self) -> list[Check]:
        """What must hold between the fields, beyond the range of each."""
        return []

    @property
    def has_spectrum(self) -> bool:
        """Whether it depends on the wavenumber inside a band: here, whether a part does."""
        return any(part.has_spectrum for part in self._parts() if isinstance(part, Physical))

    @property
    def has_quantiles(self) -> bool:
        """Whether it holds values of just the nodes that it was made for, so that none tells what these err."""
        return any(part.has_quantiles for part in self._parts() if isinstance(part, Physical))

    def doubts(self) -> list[Check]:
        """What is unlikely of several fields together, see `jaxir._plausible`; of known values, outside jit."""
        return []

    def node_checks(self, nodes: Any) -> list[Check]:
        """What must hold between this and the spectral nodes of a computation: light given by band, and the parts."""
        return [
            *self._light_checks(nodes),
            *(check for part in self._parts() if isinstance(part, Physical) for check in part.node_checks(nodes)),
        ]

    def _light_checks(self, nodes: Any) -> list[Check]:
        """Bands do not overlap where light is given for bands and there are more nodes than those, see `by_band`."""
        bands = len(nodes.names)
        given = [
            name
            for name, declared, value in _numbers(self)
            if declared.unit.startswith("W")
            and declared.shape is not None
            and "node" in declared.shape
            and value.shape[declared.shape.index("node") - len(declared.shape)] in (1, bands)
        ]
        if not given or bands in (1, nodes.count):
            return []
        _, response = on_host(nodes.response)
        count = (response > 0).sum(axis=0)
        return [
            Check(f"{type(self).__name__}.{name}: bands of a node", count, count <= 1, "1, or light given node by node")
            for name in given
        ]

    def _parts(self) -> list[Any]:
        """The physical objects among the fields."""
        values = [getattr(self, entry.name) for entry in dataclasses.fields(self)]
        every = [one for value in values for one in (value if isinstance(value, tuple) else (value,))]
        return [one for one in every if hasattr(one, "checks")]


class AbstractSpectrum(Physical):
    """Light by its spectrum, in place of numbers for bands or nodes: an irradiance, a radiance or an intensity."""

    @property
    @abc.abstractmethod
    def batch(self) -> tuple[int, ...]:
        """How many spectra it is: () for one."""

    @abc.abstractmethod
    def on(self, nodes: Any) -> Float[Array, "*batch node"]:
        """Light in the bin of each node, in the unit of the field it stands for."""


if TYPE_CHECKING:  # what computations read, of lights on the nodes, is always an array
    SpectralLight = Array
else:
    SpectralLight = Float[Array, "*batch node"] | AbstractSpectrum


@program
def _compiled_relations(of: Physical) -> list[Check]:
    """`Physical.relations` as one program instead of one for each of its operations."""
    return of.relations()


def by_band(of: P, nodes: Any) -> P:
    """The same object, and all its parts, with what was given for bands spread over the nodes of the bands.

    A field whose node axis is as long as there are bands, and not as there are nodes, has one value for each band.
    Light (any unit of W) is divided among the bins of a band in proportion to their widths in wavenumber, also where
    one number was given for every band: on any nodes it is the light in the band. Everything else is the same at all
    nodes of a band.

    Args:
        of: the object.
        nodes: the spectral axis, `jaxir.Nodes`.

    Differentiable in the fields.
    """
    bands = len(nodes.names)
    if bands == nodes.count:
        return of
    inside = nodes.response > 0
    width = jnp.where(inside, (nodes.upper - nodes.lower)[None], 0)
    share = width / jnp.sum(width * nodes.weight[None], axis=1, keepdims=True)
    band = jnp.argmax(inside, axis=0)

    def spread(of: Any) -> Any:
        changed: dict[str, Any] = {}
        for name, declared, value in _numbers(of):
            shape = declared.shape
            if shape is None or "node" not in shape:
                continue
            axis = shape.index("node") - len(shape)
            if value.shape[axis] == bands and bands > 1:
                value = jnp.take(value, band, axis=axis)
            elif value.shape[axis] != 1:
                continue
            if declared.unit.startswith("W"):
                value = value * jnp.sum(share, axis=0).reshape((1,) * (value.ndim + axis) + (-1,) + (1,) * (-axis - 1))
            changed[name] = value
        for entry in dataclasses.fields(of):
            part = getattr(of, entry.name)
            if isinstance(part, Physical):
                changed[entry.name] = spread(part)
            elif isinstance(part, tuple) and any(isinstance(one, Physical) for one in part):
                changed[entry.name] = tuple(spread(one) if isinstance(one, Physical) else one for one in part)
        return _replaced(of, changed)

    return spread(of)


def brightened(of: P, factor: Array) -> P:
    """The same light with a factor on all that it shines.

    Args:
        of: a light on the nodes.
        factor: [].

    Raises:
        ValueError: it declares nothing in W.
    """
    changed = {name: value * factor for name, declared, value in _numbers(of) if declared.unit.startswith("W")}
    if not changed:
        raise ValueError(f"{type(of).__name__}: declares no field in W, expected one that says what it shines")
    return _replaced(of, changed)


def _replaced(of: P, changed: dict[str, Any]) -> P:
    """The same object with other values, not checked anew."""
    if not changed:
        return of
    names = list(changed)
    return eqx.tree_at(
        lambda part: [getattr(part, name) for name in names],
        of,
        [changed[name] for name in names],
        is_leaf=lambda leaf: leaf is None,
    )


def over_nodes(of: P, nodes: Any) -> P:
    """The same object with one number for each node in every field whose last axis is that of the nodes.

    Args:
        of: the object.
        nodes: the spectral axis, `jaxir.Nodes`.

    Raises:
        ValueError: a field has neither one value nor one for each node.
    """
    changed: dict[str, Any] = {}
    for name, declared in _declared(of):
        value = getattr(of, name)
        if value is None or not declared.shape or declared.shape[-1] != "node":
            continue
        if isinstance(value, AbstractSpectrum):
            value = value.on(nodes)
        if value.shape[-1] not in (1, nodes.count):
            raise ValueError(
                f"{type(of).__name__}.{name}: got {value.shape[-1]} spectral values, expected 1 or {nodes.count}, one "
                f"for each node of the bands {nodes.names}"
            )
        changed[name] = jnp.broadcast_to(value, (*value.shape[:-1], nodes.count))
    return _replaced(of, changed)


def _declared(of: Physical) -> Iterator[tuple[str, _Quantity]]:
    for entry in dataclasses.fields(of):
        if _DECLARED in entry.metadata:
            yield entry.name, entry.metadata[_DECLARED]


def _numbers(of: Physical) -> Iterator[tuple[str, _Quantity, Array]]:
    """The declared fields that hold numbers."""
    for name, declared in _declared(of):
        value = getattr(of, name)
        if value is not None and not isinstance(value, AbstractSpectrum):
            yield name, declared, value


def _require_axes(field: str, shape: tuple[int, ...], declared: _Quantity, known: dict[str, tuple[int, ...]]) -> None:
    """`ValueError` unless `shape` is that declared; `known` are the lengths that names stand for, and grows."""
    if declared.shape is not None:
        expected = _in_words(declared.shape, known)
        if not _fits(shape, declared.shape, known):
            raise ValueError(f"{field}: got shape {shape}, expected {expected}")
    if any(length < declared.least for length in shape):
        raise ValueError(f"{field}: got shape {shape}, expected a length of at least {declared.least}")


def _fits(shape: tuple[int, ...], axes: Axes, known: dict[str, tuple[int, ...]]) -> bool:
    if axes and str(axes[0]).startswith("*"):
        count = len(shape) - len(axes) + 1
        if count < 0 or (count > 0 and known.setdefault(str(axes[0]), shape[:count]) != shape[:count]):
            return False
        shape, axes = shape[count:], axes[1:]
    return len(shape) == len(axes) and all(
        length == axis
        if isinstance(axis, int)
        else (length == 1 and axis in _ONE_FOR_ALL) or known.setdefault(axis, (length,)) == (length,)
        for length, axis in zip(shape, axes, strict=True)
    )


def _in_words(axes: Axes, known: dict[str, tuple[int, ...]]) -> str:
    words = [
        ", ".join(map(str, known.get(str(axis), (axis,)))) + (" or 1" if axis in known and axis in _ONE_FOR_ALL else "")
        for axis in axes
    ]
    cells = " or one without cells" if axes and str(axes[0]).startswith("*") and axes[0] in known else ""
    return "(" + ", ".join(words) + ("," if len(words) == 1 and "," not in words[0] else "") + ")" + cells
