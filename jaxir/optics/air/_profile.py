"""The state of the atmosphere over altitude."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxir._arrays import Check, as_float, finite, fraction, positive, require_shape
from jaxir.optics._tables import rows


class AirState(NamedTuple):
    """Temperature [K], pressure [Pa], mole fractions of water vapour and ozone, all of one shape."""

    temperature: Float[Array, "*batch"]
    pressure: Float[Array, "*batch"]
    h2o: Float[Array, "*batch"]
    o3: Float[Array, "*batch"]


class Profile(eqx.Module):
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

    altitude: Float[Array, " level"]
    temperature: Float[Array, " level"]
    pressure: Float[Array, " level"]
    h2o: Float[Array, " level"]
    o3: Float[Array, " level"]

    def __init__(self, altitude: Any, temperature: Any, pressure: Any, h2o: Any, o3: Any):
        self.altitude = as_float(altitude, "Profile.altitude")
        self.temperature = as_float(temperature, "Profile.temperature")
        self.pressure = as_float(pressure, "Profile.pressure")
        self.h2o = as_float(h2o, "Profile.h2o")
        self.o3 = as_float(o3, "Profile.o3")
        require_shape("Profile.altitude", self.altitude, ("level",))
        if self.altitude.shape[0] < 2:
            raise ValueError("Profile.altitude: got one level, expected at least two")
        for name in ("temperature", "pressure", "h2o", "o3"):
            require_shape(f"Profile.{name}", getattr(self, name), self.altitude.shape)

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

    def checks(self) -> list[Check]:
        """Altitudes increase without gaps in the values; temperatures and pressures are positive."""
        rising = jnp.concatenate([jnp.ones(1, bool), jnp.diff(self.altitude) > 0])
        return [
            finite("Profile.altitude", self.altitude),
            Check("Profile.altitude", self.altitude, rising, "increasing altitudes"),
            positive("Profile.temperature", self.temperature),
            positive("Profile.pressure", self.pressure),
            *(positive(f"Profile.{name}", getattr(self, name)) for name in ("h2o", "o3")),
            *(fraction(f"Profile.{name}", getattr(self, name)) for name in ("h2o", "o3")),
        ]


def us_standard_1976() -> Profile:
    """The US Standard Atmosphere 1976 to 25 km, with AFGL's water vapour and ozone."""
    return Profile(*_us_standard_1976())


@functools.cache
def _us_standard_1976() -> tuple[np.ndarray, ...]:
    columns = ("altitude_km", "temperature_K", "pressure_hPa", "h2o_ppmv", "o3_ppmv")
    table = np.array([[float(row[name]) for name in columns] for row in rows("us_standard_1976.csv")])
    return tuple((table * [1e3, 1.0, 1e2, 1e-6, 1e-6]).T)
