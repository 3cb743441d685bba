"""Parameters by name: what is usually fitted, with its unit and the bounds that its field has."""

from __future__ import annotations

from typing import Any

from jaxir.fit._parameter import Bounds, Factor, Leaf, PartValue
from jaxir.optics.gas import CorrelatedK, NarrowBandGas
from jaxir.optics.particle import GrayParticles, Particles
from jaxir.scene.jet import JetPlume
from jaxir.scene.plume import GridPlume

POSITIVE = Bounds(0.0)
JET_UNITS = {
    "exit_temperature": "K",
    "ambient_temperature": "K",
    "diameter": "m",
    "core_length": "diameters",
    "spreading": "",
    "length": "diameters",
}


def part_emissivity(part: str) -> PartValue:
    """Emissivity of a part of a `Lambert` skin, between 0 and 1."""
    return PartValue(f"emissivity of {part}", _emissivity, Bounds(0.0, 1.0), part=part)


def part_temperature(part: str) -> PartValue:
    """Temperature of a part of the skin, positive."""
    return PartValue(f"temperature of {part}", _temperature, POSITIVE, "K", part=part)


def jet_parameter(field: str) -> Leaf:
    """A field of a `JetPlume` by its name, such as "exit_temperature"; positive, or free for "nozzle".

    Raises:
        ValueError: another name; where it is read, a scene without a jet.
    """
    named = field.replace("_", " ")
    if field == "nozzle":
        return Leaf(named, lambda scene: _jet(scene).nozzle, unit="m")
    if field not in JET_UNITS:
        raise ValueError(f"jet_parameter: got {field!r}, expected one of {('nozzle', *JET_UNITS)}")
    return Leaf(named, lambda scene: getattr(_jet(scene), field), POSITIVE, JET_UNITS[field])


def temperature_scale() -> Factor:
    """Factor on the temperatures of a `GridPlume`, all cells alike. ValueError for a scene without one."""
    return Factor("temperature scale", _grid_temperature)


def mole_fraction_scale() -> Factor:
    """Factor on the mole fractions of all gases that absorb. ValueError for a plume whose gas has none."""
    return Factor("mole fraction scale", _mole_fractions)


def particle_loading() -> Factor:
    """Factor on the number of particles in the plume. ValueError for a plume without."""
    return Factor("particle loading", _particles)


def _emissivity(scene: Any) -> Any:  # these are also called on scenes whose leaves stand for themselves
    return scene.skin.brdf.hemispherical_emissivity


def _temperature(scene: Any) -> Any:
    return scene.skin.temperature


def _jet(scene: Any) -> Any:
    if not isinstance(scene.plume, JetPlume):
        raise ValueError(f"jet_parameter: got {_kind(scene.plume)} as the scene's plume, expected a JetPlume")
    return scene.plume


def _grid_temperature(scene: Any) -> Any:
    if not isinstance(scene.plume, GridPlume):
        raise ValueError(f"temperature_scale: got {_kind(scene.plume)} as the scene's plume, expected a GridPlume")
    return scene.plume.temperature


def _mole_fractions(scene: Any) -> Any:
    gas = None if scene.plume is None else scene.plume.gas
    if isinstance(gas, NarrowBandGas):
        return tuple(amount for amount in (gas.h2o, gas.co2, gas.co) if amount is not None)
    if isinstance(gas, CorrelatedK):
        return tuple(gas.mole_fractions.values())
    raise ValueError(f"mole_fraction_scale: got {_kind(gas)} in the plume, expected a gas with mole fractions")


def _particles(scene: Any) -> Any:
    particles = None if scene.plume is None else scene.plume.particles
    if isinstance(particles, Particles):
        return particles.number_density
    if isinstance(particles, GrayParticles):
        return particles.extinction
    raise ValueError(f"particle_loading: got {_kind(particles)} in the plume, expected particles")


def _kind(thing: Any) -> str:
    return "nothing" if thing is None else type(thing).__name__
