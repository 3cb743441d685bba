"""The state of the atmosphere over altitude."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxir._arrays import (
    Check,
    as_float,
    as_one_program,
    enforce,
    fraction,
    increasing,
    non_negative,
    positive,
    thermal,
)
from jaxir._fields import Physical, quantity
from jaxir._plausible import KELVIN, PASCAL, usual
from jaxir.optics._tables import rows


class AirState(NamedTuple):
    """Temperature [K], pressure [Pa], mole fractions of water vapour and ozone, all of one shape."""

    temperature: Float[Array, "*batch"]
    pressure: Float[Array, "*batch"]
    h2o: Float[Array, "*batch"]
    o3: Float[Array, "*batch"]


class Profile(Physical):
    """Temperature, pressure, water vapour and ozone at levels of altitude.

    Between levels temperature and the logarithms of the others follow a cubic with the slopes of the neighbouring
    levels: value and slope are continuous in altitude.

    Attributes:
        altitude: increasing [level] [m].
        temperature: [level] [K].
        pressure: [level] [Pa].
        h2o: mole fraction of water vapour [level], > 0.
        o3: mole fraction of ozone [level], > 0.

    Differentiable in every field but `altitude`.
    """

    altitude: Float[Array, " level"] = quantity("m", ("level",), increasing, least=2)
    temperature: Float[Array, " level"] = quantity("K", ("level",), (thermal, KELVIN))
    pressure: Float[Array, " level"] = quantity("Pa", ("level",), positive)
    h2o: Float[Array, " level"] = quantity("1", ("level",), (positive, fraction))
    o3: Float[Array, " level"] = quantity("1", ("level",), (positive, fraction))

    def doubts(self) -> list[Check]:
        """The profile reaches from the thick air at the ground to the height of clouds at least."""
        return [
            usual(200, 1e6, "m", below="is it in km?")("Profile: highest altitude", self.altitude, np.max),
            PASCAL("Profile: highest pressure", self.pressure, np.max),
        ]

    @as_one_program
    def at(self, altitude: Float[Array, "*batch"]) -> AirState:
        """The state at `altitude` [m] inside the levels. Differentiable in altitude and in the profile."""
        level = jnp.searchsorted(self.altitude, altitude, side="right").astype(jnp.int32) - 1
        level = jnp.clip(level, 0, self.altitude.shape[0] - 2)
        step = self.altitude[level + 1] - self.altitude[level]
        t = (altitude - self.altitude[level]) / step

        def cubic(value: Array) -> Array:
            secant = jnp.diff(value) / jnp.diff(self.altitude)
            slope = jnp.concatenate([secant[:1], (secant[1:] + secant[:-1]) / 2, secant[-1:]])
            start, end = value[level], value[level + 1]
            rise = (end - start) * t * t * (3 - 2 * t)
            return start + rise + step * t * (1 - t) * (slope[level] * (1 - t) - slope[level + 1] * t)

        logs = (jnp.exp(cubic(jnp.log(value))) for value in (self.pressure, self.h2o, self.o3))
        return AirState(cubic(self.temperature), *logs)


def us_standard_1976() -> Profile:
    """The US Standard Atmosphere 1976 to 25 km, with AFGL's water vapour and ozone."""
    return Profile(*(as_float(column) for column in _us_standard_1976()))


TURBULENT = 0.89  # recovery factor of a turbulent boundary layer, the cube root of the Prandtl number of air
HEATS = 1.4  # ratio of specific heats of air


def air_temperature(altitude: Any, mach: Any = 0.0, recovery: Any = TURBULENT) -> Float[Array, "*batch"]:
    """Temperature that air in flight has at an adiabatic wall, T (1 + r (g - 1) / 2 M^2).

    Of the US Standard Atmosphere 1976; White, *Viscous Fluid Flow*, "recovery factor". At Mach 0 the temperature of the
    air itself, and with r = 1 that of the stagnation point. It is what a thin skin has that nothing heats or cools.

    Args:
        altitude: 0 to 25 km [*batch] [m].
        mach: of the flight, >= 0 [*batch].
        recovery: r, 0 to 1: .89 under a turbulent boundary layer, .85 under a laminar one, 1 at a nose [*batch].

    Returns:
        The temperature [*batch] [K].

    Raises:
        ValueError: values out of range.

    Differentiable in all arguments.
    """
    mach, recovery = as_float(mach, "mach"), as_float(recovery, "recovery")
    heated = 1 + recovery * (HEATS - 1) / 2 * mach**2
    own = _in_reach(altitude, [non_negative("mach", mach), fraction("recovery", recovery)])
    return us_standard_1976().at(own).temperature * heated


def air_pressure(altitude: Any) -> Float[Array, "*batch"]:
    """Pressure of the US Standard Atmosphere 1976 [*batch] [Pa] at an altitude of 0 to 25 km [*batch] [m].

    Raises:
        ValueError: an altitude out of range.

    Differentiable in altitude.
    """
    return us_standard_1976().at(_in_reach(altitude, [])).pressure


def _in_reach(altitude: Any, more: list[Check]) -> Float[Array, "*batch"]:
    """An altitude that the profile has."""
    altitude = as_float(altitude, "altitude")
    top = float(_us_standard_1976()[0][-1])
    return enforce(
        altitude, [Check("altitude", altitude, (altitude >= 0) & (altitude <= top), f"0 to {top:g} m"), *more]
    )


@functools.cache
def _us_standard_1976() -> tuple[np.ndarray, ...]:
    columns = ("altitude_km", "temperature_K", "pressure_hPa", "h2o_ppmv", "o3_ppmv")
    table = np.array([[float(row[name]) for name in columns] for row in rows("us_standard_1976.csv")])
    return tuple((table * [1e3, 1.0, 1e2, 1e-6, 1e-6]).T)
