"""Parameters by name: what is usually fitted, with its unit and the bounds that its field has."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from jaxir._arrays import COLDEST_AND_HOTTEST
from jaxir.fit._parameter import Bounds, Factor, Leaf, PartValue

POSITIVE, THERMAL = Bounds(0.0), Bounds(COLDEST_AND_HOTTEST[0])
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
    return PartValue(f"temperature of {part}", _temperature, THERMAL, "K", part=part)


def jet_parameter(field: str, plume: int = 0) -> Leaf:
    """A field of a `JetPlume` by its name, such as "exit_temperature"; positive, or free for "nozzle".

    Args:
        field: its name.
        plume: which of the scene's plumes.

    Raises:
        ValueError: another name; where it is read, a scene without that jet.
    """
    named = _named(field.replace("_", " "), plume)
    if field != "nozzle" and field not in JET_UNITS:
        raise ValueError(f"jet_parameter: got {field!r}, expected one of {('nozzle', *JET_UNITS)}")

    of = _Read(_field, (plume, field, "jet_parameter", "a JetPlume"))
    if field == "nozzle":
        return Leaf(named, of, unit="m")
    return Leaf(named, of, THERMAL if JET_UNITS[field] == "K" else POSITIVE, JET_UNITS[field])


def temperature_scale(plume: int = 0) -> Factor:
    """Factor on the temperatures of a `GridPlume`, all cells alike. ValueError for a scene without one."""
    of = _Read(_field, (plume, "temperature", "temperature_scale", "a GridPlume"))
    return Factor(_named("temperature scale", plume), of)


def mole_fraction_scale(plume: int = 0) -> Factor:
    """Factor on the mole fractions of all that absorbs in a plume. ValueError for a gas that has none."""
    return Factor(_named("mole fraction scale", plume), _Read(_mole_fractions, (plume,)))


def particle_loading(plume: int = 0) -> Factor:
    """Factor on the number of particles in a plume. ValueError for a plume without."""
    return Factor(_named("particle loading", plume), _Read(_loading, (plume,)))


def _named(name: str, plume: int) -> str:
    return f"{name} of plume {plume}" if plume else name


@dataclasses.dataclass(frozen=True)
class _Read:
    """A function of a scene: equal to another of the same words, so that one program serves every fit that asks so."""

    function: Callable[..., Any]
    words: tuple[int | str, ...]

    def __call__(self, scene: Any) -> Any:
        return self.function(scene, *self.words)


def _mole_fractions(scene: Any, plume: int) -> Any:
    gas = _field(scene, plume, "gas", "mole_fraction_scale", "a plume with a gas")
    if not gas.amounts():
        raise ValueError(
            f"mole_fraction_scale: got {type(gas).__name__} in the plume, expected a gas with mole fractions"
        )
    return gas.amounts()


def _loading(scene: Any, plume: int) -> Any:
    particles = _field(scene, plume, "particles", "particle_loading", "a plume with particles")
    if particles is None:
        raise ValueError("particle_loading: got nothing in the plume, expected particles")
    return particles.amount


def _emissivity(scene: Any) -> Any:  # these are also called on scenes whose leaves stand for themselves
    return scene.skin.brdf.emissivity


def _temperature(scene: Any) -> Any:
    return scene.skin.temperature


def _field(scene: Any, plume: int, field: str, asked_by: str, expected: str) -> Any:
    """A field of one of a scene's plumes, or `ValueError`."""
    chosen = scene.plumes[plume] if 0 <= plume < len(scene.plumes) else None
    if chosen is None or all(entry.name != field for entry in dataclasses.fields(chosen)):
        got = "nothing" if chosen is None else type(chosen).__name__
        which = f"plume {plume}" if plume else "the scene's plume"
        raise ValueError(f"{asked_by}: got {got} as {which}, expected {expected}")
    return getattr(chosen, field)
