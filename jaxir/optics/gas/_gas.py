"""Absorbing gases: from the state of a cell to an absorption coefficient per node."""

from __future__ import annotations

import abc
import functools
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._arrays import Check, as_float, fraction, non_negative
from jaxir.optics.spectrum import Nodes


class AbstractGas(eqx.Module):
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
    def checks(self) -> list[Check]:
        """What must hold of the fields' values."""


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


def mixture_checks(name: str, amounts: Mapping[str, Array]) -> list[Check]:
    """Mole fractions of the gas `name` lie in [0, 1] and sum to at most 1."""
    total = functools.reduce(jnp.add, jnp.broadcast_arrays(*amounts.values()))
    return [
        *(fraction(f"{name}.{species}", value) for species, value in amounts.items()),
        Check(f"{name}: sum of mole fractions", total, total <= 1 + 1e-5, "a sum <= 1"),
    ]


class GrayGas(AbstractGas):
    """A gas whose absorption coefficient is given, whatever its temperature.

    Attributes:
        coefficient: absorption coefficient [m-1]; shape [*cell, node], where the node axis may have length 1 (the
            same in every node) and the cell axes may be absent (the same in every cell).

    Differentiable in `coefficient`.
    """

    coefficient: Float[Array, "..."]

    def __init__(self, coefficient: Any):
        value = as_float(coefficient, "GrayGas.coefficient")
        self.coefficient = value[None] if value.ndim == 0 else value

    def absorption(self, nodes: Nodes, temperature: Float[Array, "*cell"]) -> Float[Array, "*cell node"]:
        """See `AbstractGas.absorption`; independent of temperature."""
        value = self.coefficient
        shape = temperature.shape + (nodes.count,)
        cells, node = value.shape[:-1], value.shape[-1]
        if cells not in ((), temperature.shape) or node not in (1, nodes.count):
            raise ValueError(
                f"GrayGas.coefficient: got shape {value.shape}, expected [*cell, node] with cells "
                f"{temperature.shape} (or none) and {nodes.count} nodes (or 1)"
            )
        spread = value.reshape((1,) * (len(shape) - value.ndim) + value.shape)
        return jnp.broadcast_to(spread, shape)

    def diluted(self, share: Float[Array, "*cell"], density: Float[Array, "*cell"]) -> GrayGas:
        """See `AbstractGas.diluted`: the coefficient is proportional to the number of absorbers in a volume.

        Raises:
            ValueError: the coefficient already differs from cell to cell.
        """
        if self.coefficient.ndim != 1:
            raise ValueError(
                f"GrayGas.coefficient: got shape {self.coefficient.shape}, expected one value or (node,): gas that is "
                "the same everywhere before it is diluted"
            )
        absorbers = share * density
        return GrayGas(absorbers[..., None] * self.coefficient.reshape((1,) * absorbers.ndim + (-1,)))

    def checks(self) -> list[Check]:
        """Coefficients are finite and >= 0."""
        return [non_negative("GrayGas.coefficient", self.coefficient)]
