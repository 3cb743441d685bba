"""Arrays and checks shared by every floor of the house.

Three rules live here. Every physical field becomes a floating array in its constructor, so that a new value never
recompiles and every field has a gradient. What is known is checked and set up by numpy on the host: as operations of
JAX each of those steps would be a program of its own to compile. Every range check is one `Check`; all checks of one
entry are enforced together: at once with the field, the value and the place where the values are known, as one
`eqx.error_if` inside a user's own jit, where they are not. A doubt is a check that warns, of known values alone.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import sys
import warnings
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

COLDEST_AND_HOTTEST = 1e-3, 1e12  # [K]
FINELY = 30  # parts of an edge or a cell that coordinates must tell
T = TypeVar("T")
as_one_program = functools.partial(jax.jit, inline=True)  # of arrays alone: one compilation, and no trace inside others
_BETWEEN = ("jaxir", "jax", "equinox", "jaxtyping", "beartype")  # packages between a user's line and a check


class PlausibilityWarning(UserWarning):
    """A value is legal and hardly meant, as 27 K for a skin of 27 degrees Celsius, or beyond what a model was made for.

    The message names field, value, what is usual and, where one fits, the unit in which the value was probably given.
    """


def float_dtype() -> np.dtype:
    """The floating dtype in force: float32, or float64 when the user enabled x64."""
    return np.dtype(jnp.result_type(float))


def known(value: Any) -> np.ndarray | None:
    """The values of an array on the host, also below `jax.grad` and `jax.vmap`; None where jit has not got them yet.

    Axes over which `jax.vmap` maps come first.
    """
    if not isinstance(value, jax.core.Tracer):
        return np.asarray(value)
    if hasattr(value, "primal"):  # of forward and reverse mode
        return known(value.primal)
    if not hasattr(value, "batch_dim"):
        return None
    inner, axis = known(value.val), value.batch_dim
    if inner is None or not isinstance(axis, int):  # not mapped over
        return inner
    return np.moveaxis(inner, axis + inner.ndim - np.ndim(value.val), 0)


def is_traced(inputs: Any) -> bool:
    """Whether any value is known only inside a transformation."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(inputs))


def fingerprint(inputs: Any) -> bytes:
    """A digest of all known values, with their types and shapes: the same for the same values."""
    digest = hashlib.sha256()
    for value in map(np.asarray, jax.tree.leaves(inputs)):
        digest.update(f"{value.dtype}{value.shape}".encode() + value.tobytes())
    return digest.digest()


def remembered(answers: dict[Any, T], asked: Any, find: Callable[[], T], most: int) -> T:
    """What `find` says of what is `asked`, or said before; the last `most` answers are kept."""
    if asked not in answers:
        while len(answers) >= most:
            del answers[next(iter(answers))]
        answers[asked] = find()
    return answers[asked]


def on_host(*values: Any) -> tuple[Any, ...]:
    """numpy and values for it where all of them are known as they are, else `jax.numpy` and the values."""
    if any(isinstance(value, jax.core.Tracer) for value in values):
        return jnp, *values
    return np, *(np.asarray(value) for value in values)


def evaluated_now() -> contextlib.AbstractContextManager[None]:
    """A context in which what is known is computed at once, inside `jax.jit`, too.

    In JAX's own context for it every program is compiled anew, also those that are there; it is entered inside alone.
    """
    traced = isinstance(jax.device_put(np.zeros((), np.float32)), jax.core.Tracer)
    return jax.ensure_compile_time_eval() if traced else contextlib.nullcontext()


def placed(value: Any) -> Array:
    """An array of numpy on the device, as it is, by no program; others unchanged."""
    return jax.device_put(value) if isinstance(value, np.ndarray | np.generic) else value


def broadcast(value: Array, shape: tuple[int, ...]) -> Array:
    """`value` repeated to `shape`."""
    xp, x = on_host(value)
    return placed(xp.broadcast_to(x, shape))


def reshaped(value: Array, shape: tuple[int, ...]) -> Array:
    """`value` in another shape."""
    xp, x = on_host(value)
    return placed(xp.reshape(x, shape))


def as_float(value: Any, field: str = "value") -> Array:
    """`value` as an array of the floating dtype in force.

    Args:
        value: number, sequence or array.
        field: name for the error message.

    Returns:
        An array of the same shape.

    Raises:
        ValueError: `value` is not numeric.
    """
    dtype = float_dtype()
    if isinstance(value, jax.Array) and (isinstance(value, jax.core.Tracer) or value.dtype == dtype):
        return jnp.asarray(value, dtype)
    try:
        given = np.asarray(value)
        if given.dtype.kind in "biuf":
            return jax.device_put(given.astype(dtype))
        return jnp.asarray(value, dtype)  # numbers of other kinds, and errors
    except jax.errors.TracerArrayConversionError:  # a sequence with traced numbers
        return jnp.asarray(value, dtype)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{field}: got {value!r}, expected a number or an array of numbers") from error


def require_precision(*parts: Any) -> None:
    """Raise `ValueError` unless all floating arrays of each part are of the floating dtype in force."""
    for part in parts:
        for leaf in jax.tree.leaves(part):
            if eqx.is_inexact_array(leaf) and leaf.dtype != float_dtype():
                raise ValueError(
                    f"{type(part).__name__}: got {leaf.dtype} arrays, expected {float_dtype()}, the precision in "
                    "force; build it anew after jax_enable_x64 is changed"
                )


def key_or_default(key: Any) -> Key[Array, ""]:
    """The random key, by default always the same; one of `jax.random.PRNGKey` as a typed one.

    Raises:
        ValueError: it is none.
    """
    if key is None:
        return jax.random.key(jax.device_put(np.uint32(0)))
    if isinstance(key, jax.Array) and key.dtype == np.uint32 and key.ndim == 1:
        key = jax.random.wrap_key_data(key)
    if not isinstance(key, jax.Array) or not jnp.issubdtype(key.dtype, jax.dtypes.prng_key) or key.shape:
        got = f"{key.dtype} of shape {key.shape}" if isinstance(key, jax.Array | np.ndarray) else repr(key)
        raise ValueError(f"key: got {got}, expected one key, e.g. jax.random.key(1)")
    return key


def require_shape(field: str, array: Array, expected: tuple[int | str, ...]) -> None:
    """Raise `ValueError` unless `array` has the shape `expected`; a string stands for any length."""
    fits = array.ndim == len(expected) and all(
        isinstance(want, str) or have == want for have, want in zip(array.shape, expected, strict=True)
    )
    if not fits:
        want = "(" + ", ".join(str(item) for item in expected) + ("," if len(expected) == 1 else "") + ")"
        raise ValueError(f"{field}: got shape {array.shape}, expected {want}")


class Check(NamedTuple):
    """One range check: `ok` holds elementwise for `value` of `field`, else `expected` says what was wanted.

    A value in `doubt` is warned of instead of refused; see `jaxir._plausible`.
    """

    field: str
    value: Array | np.ndarray
    ok: Array | np.ndarray
    expected: str
    doubt: bool = False


def _values(value: Any) -> tuple[Any, Any]:
    """numpy and the values where they are known, else `jax.numpy` and the array."""
    here = known(value)
    return (jnp, value) if here is None else (np, here)


def finite(field: str, value: Array) -> Check:
    """`value` has no NaN and no infinity."""
    xp, x = _values(value)
    return Check(field, x, xp.isfinite(x), "finite values")


def positive(field: str, value: Array) -> Check:
    """`value` is finite and > 0."""
    xp, x = _values(value)
    return Check(field, x, xp.isfinite(x) & (x > 0), "finite values > 0")


def thermal(field: str, value: Array) -> Check:
    """`value` is a temperature > 0 [K], neither so low nor so high that Planck's law leaves single precision."""
    xp, x = _values(value)
    low, high = COLDEST_AND_HOTTEST
    return Check(field, x, (x >= low) & (x <= high), f"finite values > 0, from {low:g} to {high:g} K")


def non_negative(field: str, value: Array) -> Check:
    """`value` is finite and >= 0."""
    xp, x = _values(value)
    return Check(field, x, xp.isfinite(x) & (x >= 0), "finite values >= 0")


def fraction(field: str, value: Array) -> Check:
    """`value` lies in [0, 1]."""
    _, x = _values(value)
    return Check(field, x, (x >= 0) & (x <= 1), "values in [0, 1]")


def below(field: str, value: Array, limit: float, unit: str) -> Check:
    """The size of `value` is less than a limit."""
    xp, x = _values(value)
    return Check(field, x, xp.abs(x) < limit, f"values below {limit:g} {unit}")


def told_apart(field: str, place: Any, length: Any, what: str) -> Check:
    """The precision in force tells coordinates `FINELY` times as finely as the lengths of what lies there."""
    xp, x, size = on_host(place, length)
    step = float(jnp.finfo(x.dtype).eps) * xp.abs(x)
    expected = f"coordinates near enough to 0 for {x.dtype} to tell 1/{FINELY} of its {what}: move the scene there"
    return Check(field, x, FINELY * step <= size, expected)


def increasing(field: str, value: Array) -> Check:
    """`value` [sample] is finite and increases."""
    xp, x = _values(value)
    rising = xp.concatenate([xp.ones((*x.shape[:-1], 1), bool), xp.diff(x) > 0], axis=-1)
    return Check(field, x, xp.isfinite(x) & rising, "increasing finite values")


def unit_vector(field: str, value: Array) -> Check:
    """The last axis of `value` is a vector of length 1."""
    xp, x = _values(value)
    tolerance = 1e-5
    length = xp.sum(x * x, axis=-1)
    return Check(field, x, xp.abs(length - 1) < tolerance, "vectors of length 1")


def _describe(check: Check, ok: np.ndarray) -> str:
    bad = np.argwhere(~ok)
    place = tuple(int(i) for i in bad[0])
    value = known(check.value)
    assert value is not None
    got = value[place]
    where = f" at index {list(place)}" if place else ""
    more = f" ({len(bad)} such values)" if len(bad) > 1 else ""
    return f"{check.field}: got {got!s}{where}, expected {check.expected}{more}"


def require(checks: Iterable[Check]) -> None:
    """Raise `ValueError` for the first check that fails on known values; what jit does not know passes.

    If none fails, `PlausibilityWarning` says the first doubt of each field.
    """
    doubts: dict[str, str] = {}
    for check in checks:
        ok = known(check.ok)
        if ok is None or ok.all():
            continue
        if not check.doubt:
            raise ValueError(_describe(check, ok))
        doubts.setdefault(check.field, _describe(check, ok))
    for doubt in doubts.values():
        warnings.warn(doubt, PlausibilityWarning, stacklevel=_depth_of_caller())


def _depth_of_caller() -> int:
    """How many frames above the caller of this function the first line outside the package is, as `stacklevel`."""
    frame, depth = sys._getframe(1), 1
    while frame.f_back is not None and str(frame.f_globals.get("__name__")).partition(".")[0] in _BETWEEN:
        frame, depth = frame.f_back, depth + 1
    return depth


def enforce(passed: T, checks: Iterable[Check]) -> T:
    """Return `passed` unchanged once every check holds.

    Args:
        passed: a pytree with at least one array; traced checks are tied to it, so use what is returned.
        checks: what must hold.

    Returns:
        `passed`.

    Raises:
        ValueError: a check on known values fails; names the field, the value, the index, what was expected.
        RuntimeError: a check on traced values fails, at run time, naming the field and what was expected.

    Doubts of known values are warned of, see `require`.
    """
    every = list(checks)
    require(every)
    traced = [check for check in every if known(check.ok) is None]
    if not traced:
        return passed
    bad = jnp.stack([~jnp.all(check.ok) for check in traced])
    messages = [f"{check.field}: expected {check.expected}" for check in traced]
    return eqx.branched_error_if(passed, bad.any(), jnp.argmax(bad), messages)
