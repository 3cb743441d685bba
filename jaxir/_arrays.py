"""Arrays and checks shared by every floor of the house.

Two rules live here. Every physical field becomes a floating array in its constructor, so that a new value never
recompiles and every field has a gradient. Every range check is one `Check`; all checks of one entry are enforced
together: eagerly with the field, the value and the place when the values are known, as one `eqx.error_if` when they
are traced.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

T = TypeVar("T")


def float_dtype() -> np.dtype:
    """The floating dtype in force: float32, or float64 when the user enabled x64."""
    return np.dtype(jnp.result_type(float))


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
    try:
        return jnp.asarray(value, dtype=float_dtype())
    except (TypeError, ValueError) as error:
        raise ValueError(f"{field}: got {value!r}, expected a number or an array of numbers") from error


def require_shape(field: str, array: Array, expected: tuple[int | str, ...]) -> None:
    """Raise `ValueError` unless `array` has the shape `expected`; a string stands for any length."""
    fits = array.ndim == len(expected) and all(
        isinstance(want, str) or have == want for have, want in zip(array.shape, expected, strict=True)
    )
    if not fits:
        want = "(" + ", ".join(str(item) for item in expected) + ("," if len(expected) == 1 else "") + ")"
        raise ValueError(f"{field}: got shape {array.shape}, expected {want}")


class Check(NamedTuple):
    """One range check: `ok` holds elementwise for `value` of `field`, else `expected` says what was wanted."""

    field: str
    value: Array
    ok: Array
    expected: str


def finite(field: str, value: Array) -> Check:
    """`value` has no NaN and no infinity."""
    return Check(field, value, jnp.isfinite(value), "finite values")


def positive(field: str, value: Array) -> Check:
    """`value` is finite and > 0."""
    return Check(field, value, jnp.isfinite(value) & (value > 0), "finite values > 0")


def non_negative(field: str, value: Array) -> Check:
    """`value` is finite and >= 0."""
    return Check(field, value, jnp.isfinite(value) & (value >= 0), "finite values >= 0")


def fraction(field: str, value: Array) -> Check:
    """`value` lies in [0, 1]."""
    return Check(field, value, (value >= 0) & (value <= 1), "values in [0, 1]")


def increasing(field: str, value: Array) -> Check:
    """`value` [sample] is finite and increases."""
    rising = jnp.concatenate([jnp.ones(1, bool), jnp.diff(value) > 0])
    return Check(field, value, jnp.isfinite(value) & rising, "increasing finite values")


def unit_vector(field: str, value: Array) -> Check:
    """The last axis of `value` is a vector of length 1."""
    tolerance = 1e-5
    length = jnp.sum(value * value, axis=-1)
    return Check(field, value, jnp.abs(length - 1) < tolerance, "vectors of length 1")


def _describe(check: Check) -> str:
    bad = np.argwhere(~np.asarray(check.ok))
    place = tuple(int(i) for i in bad[0])
    got = np.asarray(check.value)[place]
    where = f" at index {list(place)}" if place else ""
    more = f" ({len(bad)} values are wrong)" if len(bad) > 1 else ""
    return f"{check.field}: got {got}{where}, expected {check.expected}{more}"


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
    """
    traced: list[Check] = []
    for check in checks:
        if isinstance(check.ok, jax.core.Tracer):
            traced.append(check)
        elif not bool(check.ok.all()):
            raise ValueError(_describe(check))
    if not traced:
        return passed
    bad = jnp.stack([~check.ok.all() for check in traced])
    messages = [f"{check.field}: expected {check.expected}" for check in traced]
    return eqx.branched_error_if(passed, bad.any(), jnp.argmax(bad), messages)
