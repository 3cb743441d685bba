"""What is known of parameters before measuring, as further residuals of a fit."""

from __future__ import annotations

import abc
import math
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxir._arrays import as_float, require_shape


class AbstractPrior(eqx.Module):
    """Knowledge of one parameter: residuals in units of their standard deviation."""

    @abc.abstractmethod
    def count(self, size: int) -> int:
        """How many residuals there are for a parameter of `size` numbers; `ValueError` where it does not suit."""

    @abc.abstractmethod
    def residual(self, value: Float[Array, " k"]) -> Float[Array, " m"]:
        """The residuals at values [k] of the parameter. Differentiable."""


class NormalPrior(AbstractPrior):
    """Every number of a parameter is `mean`, give or take `standard_deviation`: (value - mean) / deviation.

    Attributes:
        mean: in the parameter's unit.
        standard_deviation: likewise.
    """

    mean: Float[Array, ""]
    standard_deviation: Float[Array, ""]

    def __init__(self, mean: Any, standard_deviation: Any):
        """Convert and check."""
        self.mean = as_float(mean, "NormalPrior.mean")
        self.standard_deviation = _deviation("NormalPrior", standard_deviation)
        require_shape("NormalPrior.mean", self.mean, ())

    def count(self, size: int) -> int:
        """See `AbstractPrior.count`: one each."""
        return size

    def residual(self, value: Float[Array, " k"]) -> Float[Array, " m"]:
        """See `AbstractPrior.residual`."""
        return (value - self.mean) / self.standard_deviation


class SmoothPrior(AbstractPrior):
    """Neighbours in a field differ by `standard_deviation`: (value - next value) / deviation along every axis.

    Independent steps between neighbours: a discrete Gauss-Markov random field. It says nothing of the field's mean.

    Attributes:
        shape: of the field, such as `Grid.shape`; its numbers are the parameter's.
        standard_deviation: of the difference of two neighbours, in the parameter's unit.
    """

    shape: tuple[int, ...] = eqx.field(static=True)
    standard_deviation: Float[Array, ""]

    def __init__(self, shape: tuple[int, ...], standard_deviation: Any):
        """Convert and check."""
        self.shape = tuple(int(n) for n in shape)
        self.standard_deviation = _deviation("SmoothPrior", standard_deviation)

    def count(self, size: int) -> int:
        """See `AbstractPrior.count`: one for every pair of neighbours."""
        if math.prod(self.shape) != size:
            raise ValueError(f"SmoothPrior.shape: got {self.shape}, expected a field of the parameter's {size} numbers")
        return sum(size // n * (n - 1) for n in self.shape)

    def residual(self, value: Float[Array, " k"]) -> Float[Array, " m"]:
        """See `AbstractPrior.residual`."""
        field = value.reshape(self.shape)
        steps = [jnp.diff(field, axis=axis).reshape(-1) for axis in range(field.ndim)]
        return jnp.concatenate(steps) / self.standard_deviation


def _deviation(name: str, value: Any) -> Float[Array, ""]:
    deviation = as_float(value, f"{name}.standard_deviation")
    require_shape(f"{name}.standard_deviation", deviation, ())
    if not (np.isfinite(deviation) and deviation > 0):
        raise ValueError(f"{name}.standard_deviation: got {float(deviation):.6g}, expected a finite number > 0")
    return deviation
