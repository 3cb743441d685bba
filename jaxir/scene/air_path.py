"""Paths through the atmosphere: the standard one, a tabulated one, air that attenuates uniformly."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._arrays import Check, as_float, finite, fraction, non_negative, positive, require_shape
from jaxir.optics._tables import COLD_PATH_EDGES, sample_weights
from jaxir.optics.air import (
    PathAir,
    Profile,
    altitude_along,
    path_air,
    path_emission,
    path_transmittance,
    us_standard_1976,
)
from jaxir.optics.spectrum import Nodes, band_radiance, bins_inside
from jaxir.scene.atmosphere import AbstractAtmosphere
from jaxir.scene.source import per_node, spectral


class StandardAtmosphere(AbstractAtmosphere):
    """Molecular absorption and emission of a straight path, from the embedded fit to LOWTRAN 7 (no haze, no clouds).

    The path runs over the round earth, slant or level; refraction is left out. Equations and accuracy are those of
    `jaxir.optics.air`, made for altitudes up to 12 km and paths up to 60 km through the US Standard Atmosphere.
    Scattered sunlight is not part of the path radiance. LOWTRAN 7 gives its lowest kilometre the mean temperature of
    the layer; here each segment has its own, so a sensor on the ground sees 288 K instead of 285 K where the air is
    opaque.

    Use it with `resolved_nodes`: the transmittance of a node is the mean over the node's bin, and a mean over a whole
    band is the wrong factor for anything whose spectrum follows that of the air (for a 360 K surface seen from the
    ground the SWIR transmittance is .15, its band mean .50). It cannot be right for hot CO2 behind cold CO2, either,
    whose lines coincide: product and truth differ by +3 % (1500 K, thick) to +37 % (1000 K, dilute) at 4.3 um. With
    lists of lines `jaxir.io.spectra.slot_atmosphere` averages the path over the slots of a node's quantile instead.

    Attributes:
        sensor_altitude: [m].
        target_altitude: [m].
        distance: from sensor to target [m]; see `jaxir.optics.air.slant_range`.
        profile: state of the air over altitude.

    Differentiable in every field but `profile.altitude`.
    """

    sensor_altitude: Float[Array, ""]
    target_altitude: Float[Array, ""]
    distance: Float[Array, ""]
    profile: Profile

    def __init__(self, sensor_altitude: Any, target_altitude: Any, distance: Any, profile: Profile | None = None):
        """Convert; without `profile` the air is the US Standard Atmosphere 1976."""
        self.sensor_altitude = as_float(sensor_altitude, "StandardAtmosphere.sensor_altitude")
        self.target_altitude = as_float(target_altitude, "StandardAtmosphere.target_altitude")
        self.distance = as_float(distance, "StandardAtmosphere.distance")
        for name in ("sensor_altitude", "target_altitude", "distance"):
            require_shape(f"StandardAtmosphere.{name}", getattr(self, name), ())
        self.profile = us_standard_1976() if profile is None else profile

    def _air(self) -> PathAir:
        return path_air(self.profile, self.sensor_altitude, self.target_altitude, self.distance)

    def transmittance(self, nodes: Nodes) -> Float[Array, " node"]:
        """See `AbstractAtmosphere.transmittance`. Bins must lie within 800-10000 cm-1 (1-12.5 um)."""
        nodes = bins_inside("StandardAtmosphere", nodes, as_float(COLD_PATH_EDGES[[0, -1]]))
        return path_transmittance(self._air(), nodes)

    def path_radiance(self, nodes: Nodes) -> Float[Array, " node"]:
        """See `AbstractAtmosphere.path_radiance`: the air's own emission."""
        return path_emission(self._air(), nodes)

    def checks(self) -> list[Check]:
        """The path is long enough for its two altitudes and stays within the profile."""
        lowest, highest = self.profile.altitude[0], self.profile.altitude[-1]
        share = as_float(jnp.linspace(0, 1, 33))
        along = altitude_along(self.sensor_altitude, self.target_altitude, self.distance, share)
        within = (along >= lowest - 1) & (along <= highest + 1)
        rise = jnp.abs(self.target_altitude - self.sensor_altitude)
        return [
            *self.profile.checks(),
            finite("StandardAtmosphere.sensor_altitude", self.sensor_altitude),
            finite("StandardAtmosphere.target_altitude", self.target_altitude),
            positive("StandardAtmosphere.distance", self.distance),
            Check(
                "StandardAtmosphere.distance",
                self.distance,
                self.distance * (1 + 1e-5) >= rise,
                "at least the difference of the altitudes",
            ),
            Check("StandardAtmosphere: altitude along the path", along, within, "altitudes inside the profile"),
        ]


class TableAtmosphere(AbstractAtmosphere):
    """A path tabulated over wavenumber by another program, linear between samples and averaged over each bin.

    `jaxir.io.spectra` reads it from CSV and from MODTRAN's tape7.

    Attributes:
        wavenumber: increasing [sample] [cm-1].
        table_transmittance: [sample].
        table_radiance: spectral radiance that the path adds [sample] [W m-2 sr-1 / cm-1].

    Differentiable in transmittance and radiance.
    """

    wavenumber: Float[Array, " sample"]
    table_transmittance: Float[Array, " sample"]
    table_radiance: Float[Array, " sample"]

    def __init__(self, wavenumber: Any, transmittance: Any, spectral_path_radiance: Any = None):
        """Convert; without `spectral_path_radiance` the path adds nothing."""
        self.wavenumber = as_float(wavenumber, "TableAtmosphere.wavenumber")
        self.table_transmittance = as_float(transmittance, "TableAtmosphere.transmittance")
        added = jnp.zeros_like(self.wavenumber) if spectral_path_radiance is None else spectral_path_radiance
        self.table_radiance = as_float(added, "TableAtmosphere.spectral_path_radiance")
        require_shape("TableAtmosphere.wavenumber", self.wavenumber, ("sample",))
        if self.wavenumber.shape[0] < 2:
            raise ValueError("TableAtmosphere.wavenumber: got one sample, expected at least two")
        require_shape("TableAtmosphere.transmittance", self.table_transmittance, self.wavenumber.shape)
        require_shape("TableAtmosphere.spectral_path_radiance", self.table_radiance, self.wavenumber.shape)

    def _mean(self, nodes: Nodes, value: Float[Array, " sample"]) -> Float[Array, " node"]:
        """Mean over each bin of the piecewise linear `value`."""
        nodes = bins_inside("TableAtmosphere", nodes, self.wavenumber[jnp.array([0, -1])])
        return sample_weights(nodes.lower, nodes.upper, self.wavenumber) @ value

    def transmittance(self, nodes: Nodes) -> Float[Array, " node"]:
        """See `AbstractAtmosphere.transmittance`. Bins must lie within the table."""
        return self._mean(nodes, self.table_transmittance)

    def path_radiance(self, nodes: Nodes) -> Float[Array, " node"]:
        """See `AbstractAtmosphere.path_radiance`."""
        return self._mean(nodes, self.table_radiance) * (nodes.upper - nodes.lower)

    def checks(self) -> list[Check]:
        """Wavenumbers increase, transmittances lie in [0, 1], radiances are not negative."""
        rising = jnp.concatenate([jnp.ones(1, bool), jnp.diff(self.wavenumber) > 0])
        return [
            positive("TableAtmosphere.wavenumber", self.wavenumber),
            Check("TableAtmosphere.wavenumber", self.wavenumber, rising, "increasing wavenumbers"),
            fraction("TableAtmosphere.transmittance", self.table_transmittance),
            non_negative("TableAtmosphere.spectral_path_radiance", self.table_radiance),
        ]


class UniformAtmosphere(AbstractAtmosphere):
    """Air with one extinction coefficient along the path: transmittance = exp(-extinction * distance).

    Attributes:
        extinction: [node or 1] [m-1].
        distance: [m].
        temperature: of the air, which then emits (1 - transmittance) B(T) [K]; None adds no radiance.

    Differentiable in every field.
    """

    extinction: Float[Array, " node"]
    distance: Float[Array, ""]
    temperature: Float[Array, ""] | None

    def __init__(self, extinction: Any, distance: Any, temperature: Any = None):
        """Convert; `extinction` is one value or one per node."""
        self.extinction = spectral("UniformAtmosphere.extinction", extinction)
        self.distance = as_float(distance, "UniformAtmosphere.distance")
        require_shape("UniformAtmosphere.distance", self.distance, ())
        self.temperature = None
        if temperature is not None:
            self.temperature = as_float(temperature, "UniformAtmosphere.temperature")
            require_shape("UniformAtmosphere.temperature", self.temperature, ())

    def transmittance(self, nodes: Nodes) -> Float[Array, " node"]:
        """See `AbstractAtmosphere.transmittance`."""
        return jnp.exp(-self.distance * per_node("UniformAtmosphere.extinction", self.extinction, nodes))

    def path_radiance(self, nodes: Nodes) -> Float[Array, " node"]:
        """See `AbstractAtmosphere.path_radiance`: 0 without a temperature."""
        if self.temperature is None:
            return jnp.zeros_like(nodes.weight)
        absorbed = -jnp.expm1(-self.distance * per_node("UniformAtmosphere.extinction", self.extinction, nodes))
        return absorbed * band_radiance(self.temperature, nodes)

    def checks(self) -> list[Check]:
        """Extinction and distance are not negative, the temperature is positive."""
        checks = [
            non_negative("UniformAtmosphere.extinction", self.extinction),
            non_negative("UniformAtmosphere.distance", self.distance),
        ]
        if self.temperature is not None:
            checks.append(positive("UniformAtmosphere.temperature", self.temperature))
        return checks
