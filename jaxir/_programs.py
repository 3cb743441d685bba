"""Programs that a later process finds ready: neither traced nor compiled again.

JAX keeps what XLA compiled under a key made of the traced program, so that a second process still traces, lowers and
only then looks it up: half of the time of its first answer. A function of a module under `@program` is compiled as by
`equinox.filter_jit`; where all its inputs are known and the package keeps programs (`jaxir._cache`), the executable is
kept under a key of what decides the trace: the function, the structure, types and shapes of its inputs, what is static
in them, JAX's settings, the versions of what traces and the package's own code.

What such a key cannot name is left to `equinox.filter_jit`: inputs with parts of kinds that others define, whose code
may be another tomorrow, functions inside of functions, and arrays on several devices.
"""

from __future__ import annotations

import dataclasses
import enum
import functools
import gc
import operator
import os
import pickle
import re
import sys
import threading
import weakref
import zlib
from collections.abc import Callable
from importlib.metadata import version
from typing import Any, TypeVar

import equinox as eqx
import jax
import numpy as np
from jax.experimental import serialize_executable

from jaxir._arrays import as_float
from jaxir._cache import compiled_anew, keep, keeps, kept
from jaxir._room import crowded, program_made

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")
_VERSIONED = ("jax", "jaxlib", "equinox", "numpy", "lineax", "optimistix")  # what traces, beside the package's own code
_NAMED = ("jaxir", "builtins", *_VERSIONED)
_PLAINLY = ("jax_debug_nans", "jax_debug_infs", "jax_disable_jit", "jax_check_tracer_leaks", "jax_default_device")


class _Unnamed(Exception):
    """A part of the inputs has no name that is the same in every process."""


@dataclasses.dataclass(frozen=True)
class _Place:
    """Where an array of a result is in a list, and of which kind of random keys it is; a leaf of trees."""

    index: int
    impl: str | None

    def of(self, arrays: list[Any]) -> Any:
        return _dressed(arrays[self.index], self.impl)


class _Ready:
    """An executable of a list of arrays, and what it returns, with places for arrays; whether it was kept on disk."""

    def __init__(self, executable: Callable[..., list[Any]], result: Any, loaded: bool = False):
        self._executable, self.loaded = executable, loaded
        self._leaves, self._structure = jax.tree.flatten(result)

    def __call__(self, arrays: list[Any]) -> Any:
        found = self._executable(*arrays)
        leaves = [leaf.of(found) if isinstance(leaf, _Place) else leaf for leaf in self._leaves]
        return jax.tree.unflatten(self._structure, leaves)


class _Program:
    """A function as `program` compiles it."""

    def __init__(self, function: Callable[..., Any]):
        functools.update_wrapper(self, function)
        self._function = function
        self._jitted: Any = eqx.filter_jit(function)
        self._held: dict[Any, _Ready | None] = {}  # None where it has to be `_jitted`
        self._making: dict[Any, threading.Lock] = {}  # threads that ask for one executable wait for it
        _EVERY.add(self)

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        if crowded():
            drop_all()
        args, kwargs = _values((args, kwargs))
        return self._run(*self._found(args, kwargs), args, kwargs)

    def _run(self, ready: _Ready | None, arrays: list[Any], signature: Any, args: tuple, kwargs: dict) -> Any:
        """By the executable, if there is one that holds all."""
        try:
            return self._jitted(*args, **kwargs) if ready is None else ready(arrays)
        except jax.errors.JaxRuntimeError:
            if ready is None or not ready.loaded:
                raise
        self._held[signature] = None  # what was kept lacks something
        return self._jitted(*args, **kwargs)

    def __get__(self, instance: Any, owner: Any = None) -> Callable[..., Any]:
        """A method of an object, as functions are."""
        return self if instance is None else functools.partial(self, instance)

    def _found(self, args: tuple, kwargs: dict) -> tuple[_Ready | None, list[Any], Any]:
        """The executable for these arguments, None where they are for `_jitted`; their arrays; where it is held."""
        if not keeps() or any(getattr(jax.config, name, False) for name in _PLAINLY):
            return None, [], None
        leaves, structure = jax.tree.flatten((args, kwargs))
        if any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
            return None, [], None
        signature = structure, tuple(map(_kind, leaves)), _settings()
        arrays = [_bare(leaf) for leaf in leaves if eqx.is_array(leaf)]
        held = self._held  # another thread may drop it
        if signature not in held:
            with self._making.setdefault(signature, threading.Lock()):
                if signature not in held:
                    held[signature] = _ready(self._function, structure, leaves, arrays, signature)
        return held[signature], arrays, signature

    def of_items(self, inputs: Any) -> Callable[[Any], Any]:
        """See `of_items`."""
        inputs = _values(inputs)
        known: list[tuple[_Ready | None, list[Any]]] = []  # the executable and the arrays of `inputs`, once found

        def of(item: Any) -> Any:
            if known and known[0][0] is not None:  # which places arrays faster than others do
                ready, arrays = known[0]
                return ready([*arrays, *jax.tree.leaves(item)])
            item = jax.device_put(item)  # all of its arrays at once
            own = jax.tree.leaves(item)
            if known:
                return self._jitted(inputs, item)
            ready, arrays, signature = self._found((inputs, item), {})
            result = self._run(ready, arrays, signature, (inputs, item), {})
            still = self._held.get(signature, ready)  # what was kept may have lacked something
            known.append((still, arrays[: len(arrays) - len(own)]))
            return result

        return of


_EVERY: weakref.WeakSet[_Program] = weakref.WeakSet()


def drop_all() -> None:
    """Drop every executable that is held here or by JAX: what is asked for again is read or compiled anew."""
    for each in list(_EVERY):
        each._held = {}
    jax.clear_caches()
    gc.collect()


def program(function: F) -> F:
    """Compile a pure function of a module as `equinox.filter_jit` does, and keep its executables; see the head."""
    return _Program(function)  # type: ignore[return-value]


def of_items(function: Callable[[Any, Any], Any], inputs: Any) -> Callable[[Any], Any]:
    """`function(inputs, item)` of many items, of arrays of numpy alike: a program looks at its inputs once."""
    if isinstance(function, _Program):
        return function.of_items(inputs)
    return lambda item: function(inputs, jax.device_put(item))


def _ready(
    function: Callable[..., Any], structure: jax.tree_util.PyTreeDef, leaves: list, arrays: list, signature: tuple
) -> _Ready | None:
    """The executable as it was kept, or compiled and kept; None where it cannot be."""
    device = jax.devices()[0]
    if any(array.devices() != {device} for array in arrays):
        return None
    try:
        key = _key(function, structure, signature)
    except _Unnamed:
        return None
    held = kept(key)
    found = None if held is None else _loaded(held, len(arrays), device)
    if found is not None:
        return found
    compiled, result, count = _compiled(function, structure, leaves, arrays)
    try:
        payload = serialize_executable.serialize(compiled)[0]
        keep(key, zlib.compress(pickle.dumps((payload, result, count)), 1))
    except Exception:  # it calls back, or holds what cannot be written: it serves this process alone
        pass
    return _Ready(compiled, result)


def _compiled(
    function: Callable[..., Any], structure: jax.tree_util.PyTreeDef, leaves: list, arrays: list
) -> tuple[jax.stages.Compiled, Any, int]:
    """An executable of a list of arrays, what it returns with places for arrays, and how many these are."""
    returned: list[Any] = []

    def flat(*given: Any) -> list[Any]:
        own = iter(given)
        filled = [_dressed(next(own), _impl(leaf)) if eqx.is_array(leaf) else leaf for leaf in leaves]
        args, kwargs = jax.tree.unflatten(structure, filled)
        found, form = jax.tree.flatten(function(*args, **kwargs))
        every = [leaf for leaf in found if eqx.is_array(leaf)]
        places = iter([_Place(i, _impl(leaf)) for i, leaf in enumerate(every)])
        held = [next(places) if eqx.is_array(leaf) else leaf for leaf in found]
        returned.append((jax.tree.unflatten(form, held), len(every)))
        return [_bare(leaf) for leaf in every]

    flat.__name__ = flat.__qualname__ = function.__name__
    lowered = jax.jit(flat, keep_unused=True).lower(*arrays)
    with compiled_anew():
        compiled = lowered.compile()
    return compiled, *returned[0]


def _loaded(held: bytes, count: int, device: Any) -> _Ready | None:
    """What was kept as an executable; None where it does not load."""
    try:
        payload, result, made = pickle.loads(zlib.decompress(held))
        if b"lapack" in payload:  # whose functions are looked up where programs that call them are traced
            from jaxlib import lapack

            lapack._lapack.initialize()
        taken = jax.tree.structure(((0,) * count, {}))
        given = jax.tree.structure([0] * made)
        loaded = serialize_executable.deserialize_and_load(payload, taken, given, execution_devices=[device])
        program_made()
        return _Ready(loaded, result, loaded=True)
    except Exception:  # of another kind than this process expects: it is compiled anew
        return None


# What decides a trace, in words that are the same in every process ----------------------------------------------------


def _key(function: Callable[..., Any], structure: jax.tree_util.PyTreeDef, signature: tuple) -> str:
    """The name under which an executable is kept."""
    _, kinds, settings = signature
    versions = [f"{name} {version(name)}" for name in _VERSIONED]
    state = re.sub(r" at 0x[0-9a-f]+", "", repr(settings))
    flags = os.environ.get("XLA_FLAGS", ""), jax.default_backend(), jax.devices()[0].device_kind
    leaves = [_static(kind if len(kind) > 2 else kind[1]) for kind in kinds]
    words = [function.__module__, function.__qualname__, _form(structure), *leaves, state, *versions, *flags]
    return "\n".join(["program", *words])


def _values(inputs: T) -> T:
    """The same with numbers of Python and arrays of weak types, set into fields, as arrays like those that were there.

    Else each such number, and each other set of fields that are weak, would compile a program of its own.
    """
    leaves = jax.tree.leaves(inputs)
    if any(isinstance(leaf, jax.core.Tracer) for leaf in leaves) or not any(map(_is_loose, leaves)):
        return inputs

    def firm(part: Any) -> Any:
        return jax.tree.map(lambda leaf: _firm(leaf) if _is_loose(leaf) else leaf, part) if _is_module(part) else part

    return jax.tree.map(firm, inputs, is_leaf=_is_module)


def _is_module(part: Any) -> bool:
    """Whether numbers of a part are values; those of solvers, of other packages, are counts and settings."""
    return isinstance(part, eqx.Module) and type(part).__module__.split(".")[0] not in _VERSIONED


def _is_loose(leaf: Any) -> bool:
    return type(leaf) in (int, float) or getattr(leaf, "weak_type", False)


def _firm(leaf: Any) -> jax.Array:
    return jax.device_put(np.asarray(leaf)) if eqx.is_array(leaf) else as_float(leaf)


def _settings() -> tuple:
    """JAX's settings that decide what is traced."""
    from jax._src import config

    return config.trace_context()


def _kind(leaf: Any) -> tuple:
    """What of a leaf decides the trace: the type of an array, or a value that is no array."""
    if not eqx.is_array(leaf):
        return type(leaf), leaf
    dtype = leaf.dtype if isinstance(leaf.dtype, np.dtype) else str(leaf.dtype)  # that of random keys
    return "array", leaf.shape, dtype, bool(getattr(leaf, "weak_type", False))


def _form(structure: jax.tree_util.PyTreeDef) -> str:
    node = structure.node_data()
    if node is None:
        return "*"
    kind, about = node
    if kind is type(None):
        return "None"
    inner = ",".join(map(_form, structure.children()))
    return f"{_static(kind)}{_static(about)}[{inner}]"


def _static(value: Any) -> str:
    """A value that is no array in words."""
    if isinstance(value, str | int | float | complex | bytes | type(None)):
        return f"{type(value).__name__} {value!r}"
    if isinstance(value, np.dtype):
        return f"dtype {value}"
    if isinstance(value, enum.Enum):
        return f"{_static(type(value))}.{value.name}"
    if isinstance(value, tuple | list):
        return f"{_static(type(value))}({','.join(map(_static, value))})"
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        held = (getattr(value, field.name) for field in dataclasses.fields(value))
        return f"{_static(type(value))}({','.join(map(_static, held))})"
    if isinstance(value, dict):
        return f"dict({','.join(f'{_static(k)}:{_static(v)}' for k, v in value.items())})"
    if callable(value) and hasattr(value, "__qualname__"):  # a class, or a function of a module
        name = f"{value.__module__}.{value.__qualname__}"
        if name.split(".")[0] in _NAMED and _is_found(value):
            return name
    elif type(value).__module__.startswith("equinox.") and repr(value) == "Missing":
        return "missing"
    raise _Unnamed


def _is_found(value: Any) -> bool:
    """Whether a class or function is what its module has under its name."""
    try:
        return operator.attrgetter(value.__qualname__)(sys.modules[value.__module__]) is value
    except (AttributeError, KeyError):
        return False


# Random keys are no arrays to an executable on disk -------------------------------------------------------------------


def _impl(leaf: Any) -> str | None:
    """The kind of random keys that an array holds; None for numbers."""
    return None if isinstance(leaf.dtype, np.dtype) else str(jax.random.key_impl(leaf))


def _bare(leaf: Any) -> Any:
    """An array of numbers on the device."""
    if _impl(leaf) is not None:
        return jax.random.key_data(leaf)
    return leaf if isinstance(leaf, jax.Array) else jax.device_put(leaf)


def _dressed(value: Any, impl: str | None) -> Any:
    return value if impl is None else jax.random.wrap_key_data(value, impl=impl)
