"""Transmittance and emission of a path through the cold atmosphere, from an embedded fit to LOWTRAN 7.

Per 50 cm-1 bin and absorber s (water lines, water continuum, uniformly mixed gases, ozone, nitrogen)

    transmittance = prod_s exp(-c_s W_s^a_s),      W_s = int rho_s (p / p0)^n_s (273.15 K / T)^m_s ds,

and the path emits L = int B(T) d(transmittance) as seen from the sensor. On 60 paths apart from those of the fit
(0-12 km, up to 50 km) the band means of transmittance err by .0009, .0007, .0022 rms in SWIR, MWIR, LWIR.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxir._arrays import Check, as_float, as_one_program, enforce
from jaxir._math import einsum, matmul
from jaxir.optics._slots import ColdCells, cell_shares, co2_slots, cold_cells, tabled
from jaxir.optics._tables import COLD_PATH_EDGES, COLD_PATH_SPECIES, cold_path, overlap_matrix
from jaxir.optics.air._profile import Profile
from jaxir.optics.spectrum import Nodes, band_radiance

EARTH_RADIUS = 6371.0e3  # m
_SEGMENTS = 24
_BOLTZMANN = 1.380649e-23  # J / K
_CO2_IN_AIR = 400e-6  # orders the slots; how much passes is the fit's
_OPAQUE = 1e-15  # transmittance up to which it does not matter how it is shared among slots
_GAUSS = (0.5 - 0.5 / 3**0.5, 0.5 + 0.5 / 3**0.5)


class PathAir(NamedTuple):
    """A path cut into segments, short near the sensor, where the emission of strong bins comes from.

    Attributes:
        temperature: of each segment [segment] [K].
        depth: optical depth from the sensor to the end of each segment, per bin of the fit [segment, bin].
        uniform: the part of `depth` of uniformly mixed gases [segment, bin].
        column: of air in each half of a segment [half] [m-2].
        state: temperature [K] and pressure [Pa] there [2, half].
    """

    temperature: Float[Array, " segment"]
    depth: Float[Array, "segment bin"]
    uniform: Float[Array, "segment bin"]
    column: Float[Array, " half"]
    state: Float[Array, "2 half"]


def slant_range(sensor_altitude: Any, target_altitude: Any, zenith: Any) -> Float[Array, ""]:
    """Distance to the first point at the target's altitude along a straight line over the round earth.

    Args:
        sensor_altitude: [m].
        target_altitude: [m]; below the sensor where that looks down.
        zenith: angle at the sensor between the vertical and the line [degree]: up to 90 to a target above it, beyond 90
            to one below it.

    Returns:
        Distance [m].

    Raises:
        ValueError: the line does not meet the target's altitude.

    Differentiable in all three.
    """
    angle = as_float(zenith, "zenith")
    distance, met = _first_at(as_float(sensor_altitude), as_float(target_altitude), angle)
    expected = "an angle at which the line meets the target's altitude: up to 90 if that is above, beyond if below"
    return enforce(distance, [Check("zenith", angle, met, expected)])


@as_one_program
def _first_at(
    sensor_altitude: Float[Array, ""], target_altitude: Float[Array, ""], zenith: Float[Array, ""]
) -> tuple[Float[Array, ""], Bool[Array, ""]]:
    """Distance to the first of two points at an altitude, and whether the line meets them."""
    radius = EARTH_RADIUS + sensor_altitude
    rise = target_altitude - sensor_altitude
    along = radius * jnp.cos(jnp.deg2rad(zenith))
    free = rise * (2 * radius + rise)
    square = along**2 + free
    half = jnp.sqrt(jnp.maximum(square, 0))
    met = (square >= 0) & (zenith >= 0) & (zenith <= 180) & jnp.where(rise >= 0, zenith <= 90, zenith > 90)
    return free / (along + jnp.where(rise >= 0, half, -half)), met  # of the two roots the one without cancellation


@as_one_program
def altitude_along(
    sensor_altitude: Float[Array, ""],
    target_altitude: Float[Array, ""],
    distance: Float[Array, ""],
    share: Float[Array, "*batch"],
) -> Float[Array, "*batch"]:
    """Altitude [m] at a share of the straight path over the round earth, 0 at the sensor. Differentiable."""
    # |r|^2 is quadratic in the share; r - R without the difference of two large numbers.
    square = [h * (2 * EARTH_RADIUS + h) for h in (sensor_altitude, target_altitude)]
    excess = square[0] * (1 - share) + square[1] * share - distance**2 * share * (1 - share)
    return excess / (EARTH_RADIUS + jnp.sqrt(EARTH_RADIUS**2 + excess))


@as_one_program
def path_air(
    profile: Profile,
    sensor_altitude: Float[Array, ""],
    target_altitude: Float[Array, ""],
    distance: Float[Array, ""],
) -> PathAir:
    """Optical depths along a path.

    Args:
        profile: the atmosphere.
        sensor_altitude: where the path starts [m].
        target_altitude: where it ends [m].
        distance: length of the straight path > 0 [m].

    Returns:
        Segments from the sensor to the target.

    Differentiable in the altitudes, the distance and the profile.
    """
    fit = cold_path()
    edge = np.linspace(0, 1, _SEGMENTS + 1) ** 2
    share = edge[:-1, None] + np.diff(edge)[:, None] * np.array(_GAUSS)
    weight = as_float(np.repeat(np.diff(edge)[:, None] / 2, 2, axis=1).ravel())
    air = profile.at(altitude_along(sensor_altitude, target_altitude, distance, as_float(share.ravel())))

    log_pressure = jnp.log(air.pressure / 101325.0)
    log_cold = jnp.log(273.15 / air.temperature)
    log_amount = {"h2o": jnp.log(air.h2o), "h2oc": jnp.log(air.h2o), "o3": jnp.log(1e6 * air.o3)}
    amounts = [log_amount.get(name, jnp.zeros_like(log_cold)) for name in COLD_PATH_SPECIES]
    log_density = (
        jnp.stack(amounts)[fit.species]
        + as_float(1 + fit.pressure_power)[:, None] * log_pressure[None, :]
        + as_float(1 + fit.temperature_power)[:, None] * log_cold[None, :]
    )
    pieces = jnp.exp(log_density) * (weight * distance / 1000)[None, :]
    column = jnp.cumsum(pieces.reshape(fit.species.size, _SEGMENTS, 2).sum(axis=-1), axis=-1)
    depth = jnp.exp(as_float(fit.log_strength)[:, None] + as_float(fit.power)[:, None] * jnp.log(column))
    mixed = jnp.where((fit.species == COLD_PATH_SPECIES.index("umix"))[:, None], depth, 0)
    total, uniform = (
        jax.ops.segment_sum(x, jnp.asarray(fit.row_bin), num_segments=COLD_PATH_EDGES.size - 1).T
        for x in (depth, mixed)
    )
    density = air.pressure / air.temperature / _BOLTZMANN
    state = jnp.stack([air.temperature, air.pressure])
    return PathAir(
        air.temperature.reshape(_SEGMENTS, 2).mean(axis=-1), total, uniform, density * weight * distance, state
    )


@as_one_program
def path_transmittance(air: PathAir, nodes: Nodes) -> Float[Array, " node"]:
    """Mean transmittance of the whole path in each node's bin [node]. Differentiable in `air`."""
    return matmul(_share(nodes), jnp.exp(-air.depth[-1]))


@as_one_program
def path_emission(air: PathAir, nodes: Nodes) -> Float[Array, " node"]:
    """Radiance that the air of the path sends into the sensor [node] [W m-2 sr-1]. Differentiable in `air`."""
    before = jnp.concatenate([jnp.zeros_like(air.depth[:1]), air.depth[:-1]])
    contribution = jnp.exp(-before) * -jnp.expm1(before - air.depth)
    return jnp.sum(band_radiance(air.temperature, nodes) * matmul(contribution, _share(nodes).T), axis=0)


def slot_path(air: PathAir, nodes: Nodes, hottest: Float[Array, ""]) -> tuple[Array, Array]:
    """Transmittance and emission of a path in front of CO2 as hot as `hottest` [K], each [node].

    Between 2000 and 2400 cm-1 a node gets the mean over the wavenumbers whose rank in the absorption of CO2 of that
    temperature falls into its slot. The mean over a bin stays that of the fit: with the transmittance t of CO2's own
    lines in a cell, <t> their mean in the bin and u the fit's of all uniformly mixed gases,

        t u / <t> where u <= <t>, as if something else absorbed too,    else 1 - (1 - t) (1 - u) / (1 - <t>).

    Elsewhere they are those of `path_transmittance` and `path_emission`. Differentiable in `air` and `hottest`.
    """
    cells = cold_cells(nodes, hottest)
    edges = co2_slots().edges
    rows = slice(*np.searchsorted(COLD_PATH_EDGES, [edges[0], edges[-1]]))
    own = _own_lines(air, cells)  # [2, segment, bin, slot]
    mean = matmul(own, as_float(cell_shares(own.shape[-1])))[..., None]
    fitted = jnp.exp(-air.uniform[:, rows])[None, :, :, None]
    some, others = mean > _OPAQUE, mean < 1  # squares of what is left out underflow where slopes divide by them
    darker = own * jnp.minimum(jnp.where(some, fitted, 1) / jnp.where(some, mean, 1), 1)
    brighter = 1 - (1 - own) * jnp.minimum(jnp.where(others, 1 - fitted, 1) / jnp.where(others, 1 - mean, 1), 1)
    through = jnp.where(fitted <= mean, darker, brighter)
    through = through * jnp.exp(-(air.depth - air.uniform)[:, rows])[None, :, :, None]
    through = through.reshape(*through.shape[:2], -1)
    after = einsum("r,rsc,rnc->sn", cells.blend, through, cells.share)
    before = jnp.concatenate([jnp.ones_like(after[:1]), after[:-1]])
    emitted = jnp.sum(band_radiance(air.temperature, nodes) * (before - after), axis=0)
    inside = tabled(nodes)
    return (
        jnp.where(inside, after[-1], path_transmittance(air, nodes)),
        jnp.where(inside, emitted, path_emission(air, nodes)),
    )


def _own_lines(air: PathAir, cells: ColdCells) -> Float[Array, "2 segment bin slot"]:
    """Transmittance of CO2's own lines from the sensor to the end of each segment in each slot."""
    table = co2_slots()
    hotter = _hats(as_float(-1000 / table.cold_temperature), -1000 / air.state[0])
    denser = _hats(as_float(np.log(table.cold_pressure)), jnp.log(air.state[1]))
    weight = (hotter[:, :, None] * denser[:, None, :]).reshape(hotter.shape[0], -1)
    log_section = einsum("hl,rlc->rhc", weight, cells.cold.reshape(2, weight.shape[1], -1))
    depth = jnp.exp(log_section + jnp.log(_CO2_IN_AIR * air.column)[None, :, None])
    until = jnp.cumsum(depth.reshape(2, _SEGMENTS, 2, -1).sum(axis=2), axis=1)
    return matmul(
        jnp.exp(-until).reshape(2, _SEGMENTS, *cells.cold.shape[3:]), as_float(cell_shares(cells.cold.shape[-1]))
    )


def _hats(levels: Float[Array, " level"], place: Float[Array, " half"]) -> Float[Array, "half level"]:
    """Weights of levels for a piecewise linear function, continued beyond its ends."""
    first = jnp.clip(jnp.searchsorted(levels, place, side="right") - 1, 0, levels.size - 2)
    part = ((place - levels[first]) / (levels[first + 1] - levels[first]))[:, None]
    level = jnp.arange(levels.size)[None, :]
    return jnp.where(level == first[:, None], 1 - part, 0) + jnp.where(level == first[:, None] + 1, part, 0)


def _share(nodes: Nodes) -> Float[Array, "node bin"]:
    return overlap_matrix(nodes.lower, nodes.upper, as_float(COLD_PATH_EDGES))
