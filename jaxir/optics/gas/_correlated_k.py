"""Gas from tables of cross-sections at the quantiles of bins, as line lists give them."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxir._arrays import Check, as_float, as_one_program, fraction, known, on_host, positive, require
from jaxir._fields import flag, quantity
from jaxir._math import matmul, tensordot
from jaxir._plausible import PASCAL, reach
from jaxir.optics.gas._gas import (
    COLD,
    AbstractGas,
    no_colder,
    require_cells,
    require_one_shape,
    require_uniform,
    sum_of_mole_fractions,
)
from jaxir.optics.gas._spline import spline_slopes, spline_weights
from jaxir.optics.spectrum import Nodes, quantile_index

BOLTZMANN = 1.380649e-23  # J / K, exact since 2019 (CODATA 2018)
_KELVIN = 1000.0  # scales 1/T to the order of 1
FAINTEST = 1e-36  # m2; stands for 0 where a logarithm is taken: at 1 atm no plume is long enough to show it


class Axis(eqx.Module):
    """One axis of a table.

    Attributes:
        levels: increasing [level]; from four on the table is a cubic spline over them, below that one polynomial.
        slopes: of the spline, see `jaxir.optics.gas._spline` [level, level].
    """

    levels: Float[Array, " level"]
    slopes: Float[Array, "level level"]

    def __init__(self, field: str, levels: Any):
        """Check and convert; the levels are known when the table is made."""
        given = np.asarray(levels, np.float64)
        rising = given.ndim == 1 and given.size > 0 and bool(np.all(np.isfinite(given)) and np.all(np.diff(given) > 0))
        if not rising:
            raise ValueError(f"{field}: got {levels!r}, expected increasing finite values, at least one")
        self.levels, self.slopes = as_float(given), as_float(spline_slopes(given))

    def weights(self, place: Float[Array, "*cell"]) -> Float[Array, "*cell level"]:
        """Weights of the levels at `place` [*cell, level]."""
        return spline_weights(self.levels, self.slopes, place)


class CrossSections(eqx.Module):
    """Absorption cross-sections of one species at the quantiles of nodes, over temperature, pressure, mole fraction.

    Attributes:
        species: name, which also says which quantile of a node counts (`quantile_index`).
        temperature: -1000 K / T at the levels.
        pressure: ln of the levels [Pa].
        mole_fraction: levels of the species' own mole fraction, which broadens its lines.
        log_cross_section: ln of m2 per molecule [temperature, pressure, mole_fraction, node].
        lower, upper: edges of the nodes' bins [node] [cm-1].
        g: quantile of the species in each node [node].

    Differentiable in `log_cross_section`.
    """

    species: str = eqx.field(static=True)
    temperature: Axis
    pressure: Axis
    mole_fraction: Axis
    log_cross_section: Float[Array, "temperature pressure mole_fraction node"]
    lower: Float[Array, " node"]
    upper: Float[Array, " node"]
    g: Float[Array, " node"]

    def __init__(
        self, species: str, nodes: Nodes, temperature: Any, pressure: Any, mole_fraction: Any, cross_section: Any
    ):
        """Take a table.

        Args:
            species: name.
            nodes: those of the table's last axis.
            temperature: increasing levels [level] [K].
            pressure: increasing levels [level] [Pa].
            mole_fraction: increasing levels of the species' own mole fraction [level].
            cross_section: [temperature, pressure, mole_fraction, node] [m2] >= 0.

        Raises:
            ValueError: levels that do not increase, a table of another shape, values that are negative or not finite.
        """
        name = f"CrossSections {species!r}"
        value = np.asarray(cross_section, np.float64)
        shape = (np.size(temperature), np.size(pressure), np.size(mole_fraction), nodes.count)
        if value.shape != shape:
            raise ValueError(f"{name}.cross_section: got shape {value.shape}, expected {shape}")
        if not (np.all(np.isfinite(value)) and np.all(value >= 0)):
            raise ValueError(f"{name}.cross_section: got values that are negative or not finite, expected >= 0")
        for field, levels in (("temperature", temperature), ("pressure", pressure)):
            if not np.all(np.asarray(levels) > 0):
                raise ValueError(f"{name}.{field}: got {levels!r}, expected values > 0")
        self.species = species
        self.temperature = Axis(f"{name}.temperature", -_KELVIN / np.asarray(temperature, np.float64))
        self.pressure = Axis(f"{name}.pressure", np.log(pressure))
        self.mole_fraction = Axis(f"{name}.mole_fraction", mole_fraction)
        self.log_cross_section = as_float(np.log(np.maximum(value, FAINTEST)))
        self.lower, self.upper = nodes.lower, nodes.upper
        self.g = nodes.g[:, quantile_index(species)]

    def levels(self) -> dict[str, np.ndarray]:
        """Levels of temperature [K], pressure [Pa] and mole fraction by name, on the host in double precision.

        NaN where they are not known.
        """
        inverse, log_pressure, amount = (
            np.atleast_1d(np.asarray(known(axis.levels), np.float64))
            for axis in (self.temperature, self.pressure, self.mole_fraction)
        )
        return {"temperature": -_KELVIN / inverse, "pressure": np.exp(log_pressure), "mole_fraction": amount}

    @as_one_program
    def at(
        self, temperature: Float[Array, "*cell"], pressure: Float[Array, "..."], mole_fraction: Float[Array, "..."]
    ) -> Float[Array, "*cell node"]:
        """Cross-section [*cell, node] [m2] at temperatures [K], pressures [Pa] and mole fractions, cells or scalars.

        Beyond the ends of an axis ln of the cross-section goes on along its tangent in 1/T, ln p or x; for temperature
        that is the Boltzmann factor of one energy, down to two thirds of the lowest level; see `no_colder` below that.

        Differentiable in all three.
        """
        weights = [
            self.temperature.weights(-_KELVIN / no_colder(temperature, -COLD * _KELVIN / self.temperature.levels[0])),
            self.pressure.weights(jnp.log(pressure)),
            self.mole_fraction.weights(mole_fraction),
        ]
        mean = jnp.mean(self.log_cross_section, axis=(0, 1, 2))  # weights sum to 1, and err for the rest alone
        table = self.log_cross_section - mean[None, None, None]
        for axis in (2, 1, 0):  # what is the same in every cell leaves the table before there are cells
            if weights[axis].ndim == 1:
                table = tensordot(weights.pop(axis), table, axes=(0, axis))
        if weights:
            joint = functools.reduce(_outer, weights)
            rows = table.reshape(joint.shape[-1], table.shape[-1])
            table = matmul(joint, rows)
        return jnp.exp(table + mean.reshape((1,) * (table.ndim - 1) + mean.shape))


def _outer(first: Float[Array, "*cell a"], second: Float[Array, "*cell b"]) -> Float[Array, "*cell ab"]:
    product = first[..., :, None] * second[..., None, :]
    return product.reshape(*first.shape[:-1], first.shape[-1] * second.shape[-1])


class CorrelatedK(AbstractGas):
    """Gas whose lines are tabulated: correlated-k, and line by line on nodes as narrow as lines.

    A species with the cross-section sigma at a node absorbs

        kappa = sigma(T, p, x) x p / (k T),

    and the coefficients of species add: CO2 takes the first quantile of a node, all other species the second, so that
    bins with squares of quantiles (`resolved_nodes`) let them overlap at random. ln sigma is a cubic spline in 1/T,
    ln p and x between the levels of the table; beyond them it goes on along its tangents, for temperature with the
    Boltzmann factor of one energy, which is bounded below two thirds of the lowest level. That keeps values and
    gradients smooth in cold cells and for hot iterates of a fit; it is untested against lines, so known
    temperatures below two thirds of the lowest or above the highest level, and pressures beyond the levels, are refused
    unless the gas was told to `extrapolate`.

    Accuracy. At one temperature only quadrature and interpolation err: 8 quantiles of 25 cm-1 bins are within 1 % of
    line by line for CO2 at 4.3 um (330-1500 K, 3 mm to 10 m at 0.3 atm). Where hot gas shines through colder gas of
    the same plume, the assumption that lines keep their rank in a bin fails: seven layers from 400 to 1500 K and back
    err by -2 % (20 cm each) and -5 % (2 cm) in vacuum, and more quantiles do not help. For cold air in front use the
    transmittance averaged over the slots of the quantiles (`jaxir.io.spectra.slot_atmosphere`), not its bin means.

    Attributes:
        tables: one for each species.
        pressure: total pressure [*cell] or scalar [Pa].
        mole_fractions: by species [*cell] or scalar; a species without one is absent and costs nothing.
        extrapolate: go on beyond the levels of the tables, with a `PlausibilityWarning`.

    Differentiable in every field but the levels of the tables.
    """

    tables: tuple[CrossSections, ...]
    pressure: Float[Array, "*cell"] = quantity("Pa", ("*cell",), (positive, PASCAL))
    mole_fractions: dict[str, Float[Array, "*cell"]]
    extrapolate: bool = flag()

    def __init__(
        self,
        tables: Sequence[CrossSections],
        pressure: Any,
        mole_fractions: Mapping[str, Any],
        *,
        extrapolate: bool = False,
    ):
        """Choose from `tables` the species that have a mole fraction."""
        known = {table.species: table for table in tables}
        unknown = sorted(set(mole_fractions) - set(known))
        if unknown or not mole_fractions:
            raise ValueError(
                f"CorrelatedK.mole_fractions: got {unknown or 'no species'}, expected some of {sorted(known)}"
            )
        self.pressure = as_float(pressure, "CorrelatedK.pressure")
        self.mole_fractions = {
            species: as_float(mole_fractions[species], f"CorrelatedK.mole_fractions.{species}")
            for species in sorted(mole_fractions)
        }
        self.tables = tuple(known[species] for species in self.mole_fractions)
        self.extrapolate = extrapolate
        require_one_shape("CorrelatedK", self._fields())

    def _fields(self) -> list[Array]:
        return [self.pressure, *self.mole_fractions.values()]

    @property
    def has_quantiles(self) -> bool:
        """See `Physical.has_quantiles`."""
        return True

    def node_checks(self, nodes: Nodes) -> list[Check]:
        """See `Physical.node_checks`: they are those of the tables."""
        return [check for table in self.tables for check in _matching(table, nodes)]

    def absorption(self, nodes: Nodes, temperature: Float[Array, "*cell"]) -> Float[Array, "*cell node"]:
        """See `AbstractGas.absorption`.

        Raises:
            ValueError: fields and temperature differ in shape; nodes, where known, that are not those of the tables.
        """
        require_cells("CorrelatedK", self._fields(), temperature)
        require(self.node_checks(nodes))
        density = self.pressure / temperature / BOLTZMANN  # the inverse square of k T is no float32
        parts = []
        for table in self.tables:
            amount = self.mole_fractions[table.species]
            sigma = table.at(temperature, self.pressure, amount)
            parts.append((density * amount)[..., None] * sigma)
        return functools.reduce(jnp.add, parts)

    def diluted(self, share: Float[Array, "*cell"], density: Float[Array, "*cell"]) -> CorrelatedK:
        """See `AbstractGas.diluted`: mole fractions are shares of this gas's.

        Raises:
            ValueError: the gas already differs from cell to cell.
        """
        require_uniform("CorrelatedK", self._fields())
        amounts = {species: share * amount for species, amount in self.mole_fractions.items()}
        return CorrelatedK(self.tables, self.pressure, amounts, extrapolate=self.extrapolate)

    def amounts(self) -> tuple[Any, ...]:
        """See `AbstractGas.amounts`: the mole fractions of all species."""
        return tuple(self.mole_fractions.values())

    def reaches(self, field: str, temperature: Float[Array, "*cell"]) -> list[Check]:
        """See `AbstractGas.reaches`: the levels of every table; somewhat colder gas hardly radiates."""
        return [self._within(table, "temperature", "K", field, temperature, COLD) for table in self.tables]

    def doubts(self) -> list[Check]:
        """Pressures lie between the levels of every table."""
        return [self._within(table, "pressure", "Pa", "CorrelatedK.pressure", self.pressure) for table in self.tables]

    def _within(
        self, table: CrossSections, axis: str, unit: str, field: str, value: Array, share: float = 1.0
    ) -> Check:
        """The levels of an axis of `table`, of which the lowest counts by a share of it, reach `value`."""
        lowest, highest = share * table.levels()[axis].min(), table.levels()[axis].max()
        return reach(field, value, lowest, highest, unit, f"the table of {table.species}", self.extrapolate)

    def relations(self) -> list[Check]:
        """Mole fractions lie in [0, 1] and sum to at most 1."""
        return [
            *(fraction(f"CorrelatedK.mole_fractions.{species}", x) for species, x in self.mole_fractions.items()),
            sum_of_mole_fractions("CorrelatedK", self.mole_fractions),
        ]


def _matching(table: CrossSections, nodes: Nodes) -> list[Check]:
    """The nodes of `table` are `nodes`.

    Raises:
        ValueError: they are not as many.
    """
    name = f"CorrelatedK: nodes of the table of {table.species}"
    if table.g.shape != nodes.weight.shape:
        raise ValueError(f"{name}: got {nodes.count} nodes, expected the table's {table.g.shape[0]}")
    xp, lower, upper, g, *made_for = on_host(nodes.lower, nodes.upper, nodes.g, table.lower, table.upper, table.g)
    got = {"lower": lower, "upper": upper, "g": g[:, quantile_index(table.species)]}
    slack = (1e-6 * made_for[0], 1e-6 * made_for[1], 1e-6)
    return [
        Check(f"{name}: {field}", value, xp.abs(value - own) <= near, "the nodes that the table was made for")
        for (field, value), own, near in zip(got.items(), made_for, slack, strict=True)
    ]
