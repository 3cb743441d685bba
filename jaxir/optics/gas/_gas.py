"""Absorbing gases: from the state of a cell to an absorption coefficient per node."""

from __future__ import annotations

import abc
import functools
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._arrays import Check
from jaxir._fields import Physical
from jaxir.optics.spectrum import Nodes

COLD = 2 / 3  # share of the lowest temperature of a table down to which gas may be colder: it hardly radiates


class AbstractGas(Physical):
    """A gas: absorption coefficient per node as a function of temperature and of the gas's own fields."""

    @abc.abstractmethod
    def absorption(self, nodes: Nodes, temperature: Float[Array, "*cell"]) -> Float[Array, "*cell node"]:
        """Absorption coefficient [*cell, node] [m-1] at `temperature` [*cell] [K]."""

    @abc.abstractmethod
    def diluted(self, share: Float[Array, "*cell"], density: Float[Array, "*cell"]) -> AbstractGas:
        """This gas, the same everywhere, mixed with air that does not absorb.

        Args:
            share: its mole fraction in the mixture [*cell].
            density: molar density of the mixture over that for which the gas was given [*cell]; a gas that knows its
                pressure and is asked with its temperature has no use for it.

        Returns:
            A gas with fields per cell.
        """

    @abc.abstractmethod
    def amounts(self) -> tuple[Any, ...]:
        """The leaves that are amounts of what absorbs, all to be scaled by one factor; () where none is known.

        Of any kind, because fits ask for them in gases whose leaves stand for themselves.
        """

    def reaches(self, field: str, temperature: Float[Array, "*cell"]) -> list[Check]:
        """Checks that the gas's data reach temperatures [*cell] [K], a `field` of the plume; here none."""
        return []


def no_colder(temperature: Float[Array, "*cell"], limit: Any) -> Float[Array, "*cell"]:
    """The temperature [*cell] [K] at which tables are read: T, and limit exp(T / limit - 1) below a limit [K].

    That is once continuously differentiable and at least limit / e, so that what is extrapolated stays finite down to
    0 K.
    """
    return jnp.where(temperature < limit, limit * jnp.exp(jnp.minimum(temperature / limit, 1) - 1), temperature)


def require_cells(name: str, fields: list[Array], temperature: Array) -> None:
    """Raise `ValueError` unless every field of the gas `name` is a scalar or has the cells of `temperature`."""
    if any(field.shape not in ((), temperature.shape) for field in fields):
        got = [field.shape for field in fields]
        raise ValueError(f"{name}: got fields of shapes {got}, expected cells {temperature.shape} or scalars")


def require_one_shape(name: str, fields: list[Array]) -> None:
    """Raise `ValueError` unless the fields of the gas `name` are scalars or of one shape."""
    shapes = {field.shape for field in fields} - {()}
    if len(shapes) > 1:
        raise ValueError(f"{name}: got fields of shapes {sorted(shapes)}, expected one shape and scalars")


def require_uniform(name: str, fields: list[Array]) -> None:
    """Raise `ValueError` if a field of the gas `name` already differs from cell to cell."""
    shapes = sorted({field.shape for field in fields} - {()})
    if shapes:
        raise ValueError(
            f"{name}: got fields of shapes {shapes}, expected scalars: gas that is the same everywhere before it is "
            "diluted"
        )


def sum_of_mole_fractions(name: str, amounts: Mapping[str, Array]) -> Check:
    """Mole fractions of the gas `name` sum to at most 1."""
    total = functools.reduce(jnp.add, jnp.broadcast_arrays(*amounts.values()))
    return Check(f"{name}: sum of mole fractions", total, total <= 1 + 1e-5, "a sum <= 1")
