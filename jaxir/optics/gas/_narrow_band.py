"""Hot H2O, CO2 and CO from the embedded narrow-band table: the gas that works out of the box."""

from __future__ import annotations

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxir._arrays import Check, as_float, as_one_program, fraction, positive, require
from jaxir._fields import flag, quantity
from jaxir._math import matmul, tensordot
from jaxir._plausible import PASCAL, doubt, reach
from jaxir.optics._slots import co2_slots, hot_cross_sections, tabled
from jaxir.optics._tables import ABSENT, HOT_GAS_EDGES, HOT_GAS_TEMPERATURE, hot_gas, overlap_matrix
from jaxir.optics.gas._combustion import NITROGEN_PER_OXYGEN
from jaxir.optics.gas._gas import (
    COLD,
    AbstractGas,
    no_colder,
    require_cells,
    require_uniform,
    sum_of_mole_fractions,
)
from jaxir.optics.gas._k_distribution import log_quantile, quantile_series
from jaxir.optics.gas._spline import spline_slopes, spline_weights
from jaxir.optics.spectrum import Nodes, bins_inside, quantile_index

ATMOSPHERE = 101325.0  # Pa
# Lorentz half-widths at 273 K and 1 atm [cm-1] in CO2, H2O, CO, O2, N2; resonant part of the own species (NASA
# SP-3080, Ludwig et al. 1973).
_WIDTH = {
    "CO2": ((0.09, 0.07, 0.06, 0.055, 0.07), 0.01),
    "H2O": ((0.12, 0.09, 0.10, 0.04, 0.09), 0.44),
    "CO": ((0.07, 0.06, 0.06, 0.05, 0.06), 0.0),
}
_MOLAR_MASS = {"CO2": 44.01, "H2O": 18.015, "CO": 28.01}
_KELVIN = 1000.0  # scales 1/T to the order of 1
_LOSCHMIDT = ATMOSPHERE / (1.380649e-23 * 273)  # molecules at 1 atm and 273 K [m-3]
_DOPPLER = 3.581163e-7  # half-width / (nu sqrt(T / M)): sqrt(2 ln 2 k N_A / c^2) with M in g/mol


class NarrowBandGas(AbstractGas):
    """Combustion gas by Malkmus' statistical model, as a k-distribution.

    In each bin the absorption coefficient of a species at quantile g is

        kappa = k(T) p x (273 K / T) y(g, b),    b = 4 gamma / d(T),

    with the table's mean coefficient k and effective line spacing d, partial pressure p x, the inverse Gaussian
    quantile y of `jaxir.optics.gas`, and the half-width gamma of a Voigt line (Olivero and Longbothum 1977)
    from the Lorentz width of the mixture and the Doppler width. CO2 takes the first quantile of a node, H2O and CO the
    second; the coefficients of species add. Malkmus' model is one of Lorentz lines: with the Voigt width it is right
    for weak lines and, at low pressure, too wide in the wings of strong ones.

    CO2 between 2000 and 2400 cm-1, in bins inside this range, is not Malkmus' but tabulated from lines
    (`studies.co2_tables`): quantiles of their spectrum over 250-3200 K and 50 to 2500 hPa, with one half-width for all
    mixtures. Behind air, `StandardAtmosphere` averages over the same quantiles. Bins of several 50 cm-1 order the
    quantiles of all as they are at 900 K.

    Accuracy. At 4.3 um the radiance is within 1.5 % of the lines (1000 and 1500 K, 0.1-1 atm, 3-100 cm), and 5 % low
    where hot gas shines through a thin layer of colder gas of the same plume; the lines' own strengths are within 4 %
    of CDSD-HITEMP (`studies.co2_levels`), and they give 1.3 times the one spectrum measured at 2200-3400 K, for reasons
    that are open (`studies.validation`).
    H2O between its bands, at 800-1200 and 2000-3300 cm-1, has the parameters of Riviere and Soufiani (2012), made from
    HITEMP; those of NASA SP-3080 (1973), which H2O has elsewhere, CO everywhere and CO2 beside 4.3 um, would give 1.1
    to 1.5 times as much at 8-12 um and 1000 to 2000 K, a third at 600 K (`studies.h2o_windows`).
    Radiances of 1 m of combustion products at 0.3 atm, phi = 0.5, by SP-3080's own curve of growth are higher: Malkmus'
    model lies at -5 and -7 % of them in SWIR and MWIR at 1500 K. With the Voigt width in place of the Lorentz width, it
    errs at 4.3 um by -9 ... +8 %. For better accuracy use line lists.

    ln k and ln 1/d are cubic splines in ln T between 300 and 2500 K (they err by less than 1 % where the gas matters)
    and straight lines in ln T beyond, in T below 200 K: values and gradients stay smooth and finite through cold cells
    and hot iterates, and are untested outside the range: known temperatures below 200 or above 2500 K are refused
    unless the gas was told to `extrapolate`. The table spans 800-9300 cm-1 (1.08-12.5 um); above it the gas is
    transparent.

    Attributes:
        pressure: total pressure [*cell] or scalar [Pa].
        h2o, co2, co: mole fractions [*cell] or scalars; a species given as None is absent and costs nothing.
        o2: mole fraction of oxygen, which broadens lines; the rest of the mixture counts as N2.
        extrapolate: go on beyond 200 to 2500 K, with a `PlausibilityWarning`.

    Differentiable in every field; not in the quantiles of the nodes.
    """

    pressure: Float[Array, "*cell"] = quantity("Pa", ("*cell",), (positive, PASCAL))
    h2o: Float[Array, "*cell"] | None = quantity("1", ("*cell",), fraction, default=None)
    co2: Float[Array, "*cell"] | None = quantity("1", ("*cell",), fraction, default=None)
    co: Float[Array, "*cell"] | None = quantity("1", ("*cell",), fraction, default=None)
    o2: Float[Array, "*cell"] = quantity("1", ("*cell",), fraction, default=0.0)
    extrapolate: bool = flag()

    def __check_init__(self) -> None:
        if self.h2o is None and self.co2 is None and self.co is None:
            raise ValueError("NarrowBandGas: got no species, expected a mole fraction for h2o, co2 or co")

    @property
    def has_spectrum(self) -> bool:
        """See `Physical.has_spectrum`."""
        return True

    def node_checks(self, nodes: Nodes) -> list[Check]:
        """See `Physical.node_checks`: bins lie above 800 cm-1."""
        return bins_inside("NarrowBandGas", nodes, HOT_GAS_EDGES, transparent_above=True)

    def absorption(self, nodes: Nodes, temperature: Float[Array, "*cell"]) -> Float[Array, "*cell node"]:
        """See `AbstractGas.absorption`.

        Raises:
            ValueError: fields and temperature differ in shape; a bin, where bins are known, reaches below 800 cm-1,
                where the table ends.
        """
        require_cells("NarrowBandGas", jax.tree.leaves(self), temperature)
        require(self.node_checks(nodes))
        present = {"CO2": self.co2, "H2O": self.h2o, "CO": self.co}
        pressure = jnp.broadcast_to(self.pressure / ATMOSPHERE, temperature.shape)
        parts = [
            _species_absorption(
                _SpeciesTable(species, nodes),
                temperature,
                jnp.log(self.pressure),
                pressure * jnp.broadcast_to(amount, temperature.shape),
                self._lorentz(species, pressure, temperature),
            )
            for species, amount in present.items()
            if amount is not None
        ]
        return functools.reduce(jnp.add, parts)

    def diluted(self, share: Float[Array, "*cell"], density: Float[Array, "*cell"]) -> NarrowBandGas:
        """See `AbstractGas.diluted`: mole fractions are shares of this gas's, and air brings its oxygen.

        Raises:
            ValueError: the gas already differs from cell to cell.
        """
        require_uniform("NarrowBandGas", jax.tree.leaves(self))
        h2o, co2, co = (None if x is None else share * x for x in (self.h2o, self.co2, self.co))
        o2 = share * self.o2 + (1 - share) / (1 + NITROGEN_PER_OXYGEN)
        return NarrowBandGas(self.pressure, h2o, co2, co, o2, extrapolate=self.extrapolate)

    def _lorentz(
        self, species: str, pressure: Float[Array, "*cell"], temperature: Float[Array, "*cell"]
    ) -> Float[Array, "*cell"]:
        """Lorentz half-width of a species' lines [*cell] [cm-1]; `pressure` in atm."""
        known = (self.co2, self.h2o, self.co, self.o2)
        others = [jnp.zeros_like(pressure) if x is None else jnp.broadcast_to(x, pressure.shape) for x in known]
        nitrogen = 1 - (others[0] + others[1] + others[2] + others[3])
        foreign, resonant = _WIDTH[species]
        width = functools.reduce(jnp.add, [w * x for w, x in zip(foreign, [*others, nitrogen], strict=True)])
        cold = 273 / temperature
        own = {"CO2": others[0], "H2O": others[1], "CO": others[2]}[species]
        return pressure * (width * jnp.sqrt(cold) + resonant * own * cold)

    def amounts(self) -> tuple[Any, ...]:
        """See `AbstractGas.amounts`: the mole fractions of the species that absorb."""
        return tuple(amount for amount in (self.h2o, self.co2, self.co) if amount is not None)

    def reaches(self, field: str, temperature: Float[Array, "*cell"]) -> list[Check]:
        """See `AbstractGas.reaches`: the table ends at 300 and 2500 K; somewhat colder gas hardly radiates."""
        lowest, highest = COLD * HOT_GAS_TEMPERATURE[0], HOT_GAS_TEMPERATURE[-1]
        return [reach(field, temperature, lowest, highest, "K", "NarrowBandGas", self.extrapolate)]

    def doubts(self) -> list[Check]:
        """Where there is exhaust, H2O and CO2 are not as the mass fractions of burnt kerosene or pentane."""
        if self.h2o is None or self.co2 is None:
            return []

        def by_mole(h2o: np.ndarray, co2: np.ndarray) -> np.ndarray:
            by_mass = (h2o > 0.36 * co2) & (h2o < 0.495 * co2)
            exhaust = co2 > 0.02
            return np.asarray(~(exhaust & by_mass & np.all(by_mass | ~exhaust)))

        expected = "at least half of co2, as fuels leave it (kerosene .96); are these mass fractions?"
        return [doubt("NarrowBandGas.h2o", by_mole, expected, self.h2o, self.co2)]

    def relations(self) -> list[Check]:
        """Mole fractions sum to at most 1."""
        amounts = {"h2o": self.h2o, "co2": self.co2, "co": self.co, "o2": self.o2}
        given = {name: value for name, value in amounts.items() if value is not None}
        return [sum_of_mole_fractions("NarrowBandGas", given)]


class _SpeciesTable(eqx.Module):
    """What a species needs per node: ln k and ln(4 / d) at the table's temperatures, quantiles, Doppler width.

    For CO2 also whether a node lies among its tabulated lines, and ln of the coefficient there.
    """

    log_coefficient: Float[Array, "level node"]
    log_lines: Float[Array, "level node"]
    series: Float[Array, "term node"]
    doppler: Float[Array, " node"]
    lined: Bool[Array, " node"] | None = None
    log_lined: Float[Array, "temperature pressure node"] | None = None

    def __init__(self, species: str, nodes: Nodes):
        table = hot_gas(species)
        share = overlap_matrix(nodes.lower, nodes.upper, as_float(HOT_GAS_EDGES))
        mean = matmul(share, as_float(table.coefficient.T)) + ABSENT
        # Means of k and of sqrt(k / d) keep a group's weak and its strong limit.
        strong = matmul(share, as_float(np.sqrt(table.coefficient * table.inverse_spacing).T)) + np.sqrt(ABSENT)
        self.log_coefficient = jnp.log(mean).T
        self.log_lines = (2 * jnp.log(strong) - jnp.log(mean)).T + np.log(4)
        self.series = quantile_series(nodes.g[:, quantile_index(species)])
        self.doppler = (_DOPPLER / _MOLAR_MASS[species] ** 0.5 / 2) * (nodes.lower + nodes.upper)
        if species == "CO2":
            self.lined = tabled(nodes)
            self.log_lined = hot_cross_sections(nodes) + np.log(_LOSCHMIDT / 100)


@as_one_program
@jax.checkpoint  # the gradient recomputes what has a cell and a node axis instead of keeping it
def _species_absorption(
    table: _SpeciesTable,
    temperature: Float[Array, "*cell"],
    log_pressure: Float[Array, "..."],
    partial_pressure: Float[Array, "*cell"],
    lorentz: Float[Array, "*cell"],
) -> Float[Array, "*cell node"]:
    """Absorption coefficient of one species [*cell, node] [m-1]; ln of the pressure in Pa, the partial one in atm."""
    amount = 100 * 273 * partial_pressure / temperature  # 100: cm-1 to m-1
    strength = jnp.exp(_log_strength(table, temperature, lorentz, log_pressure))
    return _spread(amount, strength) * strength


# Every node depends on three numbers of its cell, so three slopes per (cell, node) are the whole derivative; reverse
# mode through the operations themselves would keep some thirty arrays of that size.
@jax.custom_jvp
def _log_strength(
    table: _SpeciesTable,
    temperature: Float[Array, "*cell"],
    lorentz: Float[Array, "*cell"],
    log_pressure: Float[Array, "..."],
) -> Float[Array, "*cell node"]:
    """ln k y: the coefficient at 273 K density [cm-1 atm-1] at the nodes' quantiles, by Malkmus or from lines."""
    level = _level_weights(temperature)
    log_k, log_lines = _blend(level, table.log_coefficient), _blend(level, table.log_lines)
    node = (1,) * temperature.ndim + table.doppler.shape
    doppler = table.doppler.reshape(node) * jnp.sqrt(temperature)[..., None]
    lorentz = lorentz[..., None]
    # Olivero and Longbothum's Voigt half-width, within 2e-4.
    width = 0.5346 * lorentz + jnp.sqrt(0.2166 * lorentz**2 + doppler**2)
    statistical = log_k + log_quantile(table.series, log_lines + jnp.log(width))
    if table.lined is None:
        return statistical
    lined = jnp.broadcast_to(table.lined.reshape(node), statistical.shape)
    return jnp.where(lined, _log_lined(table, temperature, log_pressure), statistical)


@_log_strength.defjvp
def _log_strength_jvp(primals: tuple, tangents: tuple) -> tuple:
    table, temperature, lorentz, log_pressure = primals
    one = jnp.ones_like(temperature)
    value, hotter = jax.jvp(lambda t: _log_strength.fun(table, t, lorentz, log_pressure), (temperature,), (one,))
    _, wider = jax.jvp(lambda w: _log_strength.fun(table, temperature, w, log_pressure), (lorentz,), (one,))
    change = hotter * _spread(tangents[1], value) + wider * _spread(tangents[2], value)
    if table.lined is None:
        return value, change
    unit = jnp.ones_like(log_pressure)
    _, denser = jax.jvp(lambda p: _log_strength.fun(table, temperature, lorentz, p), (log_pressure,), (unit,))
    return value, change + denser * _spread(jnp.broadcast_to(tangents[3], temperature.shape), value)


def _log_lined(
    table: _SpeciesTable, temperature: Float[Array, "*cell"], log_pressure: Float[Array, "..."]
) -> Float[Array, "*cell node"]:
    """ln of the coefficient of tabulated lines [*cell, node]: cubic splines in 1/T and ln p, beyond their tangents."""
    assert table.log_lined is not None
    held = no_colder(temperature, COLD * co2_slots().hot_temperature[0])
    temperatures, pressures = (as_float(x) for x in _lined_levels()[:2])
    hotter = spline_weights(temperatures, as_float(_lined_levels()[2]), -_KELVIN / held)
    denser = spline_weights(pressures, as_float(_lined_levels()[3]), log_pressure)
    if denser.ndim == 1:  # one pressure for all cells
        return _blend(hotter, tensordot(denser, table.log_lined, axes=(0, 1)))
    joint = (hotter[..., :, None] * denser[..., None, :]).reshape(*denser.shape[:-1], -1)
    return _blend(joint, table.log_lined.reshape(-1, table.log_lined.shape[-1]))


@functools.cache
def _lined_levels() -> tuple[np.ndarray, ...]:
    """Levels of -1000 K / T and ln p, and the slopes of their splines."""
    levels = -_KELVIN / co2_slots().hot_temperature, np.log(co2_slots().hot_pressure)
    return *levels, *(spline_slopes(x) for x in levels)


def _spread(per_cell: Float[Array, "*cell"], like: Float[Array, "*cell node"]) -> Float[Array, "*cell node"]:
    """`per_cell` at every node, as a product with ones.

    Its transpose, the sum over nodes in a gradient, is then a matrix product, which XLA's CPU backend feeds from one
    fused loop; for a plain sum it stores every operation in front of it.
    """
    return matmul(per_cell[..., None], jnp.ones((1, like.shape[-1]), like.dtype))


def _blend(level: Float[Array, "*cell level"], table: Float[Array, "level node"]) -> Float[Array, "*cell node"]:
    # A sum of products instead of a matrix product, which would store its result for every cell and node.
    shape = (1,) * (level.ndim - 1) + table.shape[1:]
    products = (level[..., i, None] * table[i].reshape(shape) for i in range(table.shape[0]))
    return functools.reduce(jnp.add, products)


@functools.cache
def _spline() -> tuple[np.ndarray, np.ndarray]:
    levels = np.log(HOT_GAS_TEMPERATURE)
    return levels, spline_slopes(levels)


def _level_weights(temperature: Float[Array, "*cell"]) -> Float[Array, "*cell level"]:
    """Weights of the table's temperatures: a cubic spline in ln T, continued by its tangents, see `no_colder`."""
    levels, slopes = _spline()
    held = no_colder(temperature, COLD * HOT_GAS_TEMPERATURE[0])
    return spline_weights(as_float(levels), as_float(slopes), jnp.log(held))
