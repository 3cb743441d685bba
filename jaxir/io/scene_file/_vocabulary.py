"""What a scene file may hold: the constructors of every kind of object, and how their parameters are read.

A new gas, brdf, light, atmosphere is one line here; a new parameter of one is none, unless its values are no numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxir.geometry import Grid, Independent, Lattice, Sobol, Stratified, orthographic_camera, perspective_camera
from jaxir.geometry.selection import (
    AbovePlane,
    Complement,
    Connected,
    Facing,
    InBox,
    InCylinder,
    OfMaterial,
    OfPart,
    Union,
)
from jaxir.io.mesh import METRES, Axes
from jaxir.io.scene_file._entries import (
    Entry,
    Reader,
    build,
    construct,
    integer,
    number,
    numbers,
    one_of,
    text,
)
from jaxir.io.spectra import load_atmosphere_csv, load_k_tables, load_tape7, load_tape7_sun
from jaxir.optics.air import Profile, us_standard_1976
from jaxir.optics.gas import CorrelatedK, CrossSections, GrayGas, NarrowBandGas, combustion_products
from jaxir.optics.particle import GrayParticles, HenyeyGreenstein, Isotropic, Particles, TabulatedPhase, mie_table
from jaxir.optics.spectrum import LWIR, MWIR, SWIR, Band, BlackbodySpectrum, Nodes, TabulatedSpectrum, sensor_band
from jaxir.optics.surface import BrdfTable, Lambert, RoughConductor, SandfordRobertson
from jaxir.scene.air import FixedPath, PathToSpace, StandardAtmosphere, TableAtmosphere, UniformAtmosphere
from jaxir.scene.light import (
    BlackbodyBackground,
    ClearSky,
    DiscSource,
    ElevationTable,
    ParallelSource,
    PointSource,
    PolygonSource,
    SphereSource,
    Sun,
    UniformBackground,
    sun_at,
)
from jaxir.scene.plume import GridPlume, JetPlume
from jaxir.transport import KINDS, ClosedForm, DirectSampling, DiscreteOrdinates, PlumeLight, SkinLight


def combustion_gas(
    pressure: Any, carbon: float, hydrogen: float, equivalence_ratio: Any, extrapolate: bool = False
) -> NarrowBandGas:
    """The products of complete combustion as a gas, see `combustion_products`.

    Args:
        pressure: [Pa].
        carbon: atoms of carbon in a molecule of fuel.
        hydrogen: atoms of hydrogen.
        equivalence_ratio: in [0, 1].
        extrapolate: see `NarrowBandGas`.

    Returns:
        The gas. Differentiable in `pressure` and `equivalence_ratio`.
    """
    products = combustion_products(carbon, hydrogen, equivalence_ratio)
    return NarrowBandGas(pressure, h2o=products.h2o, co2=products.co2, o2=products.o2, extrapolate=extrapolate)


def _band(name: str, lower: float, upper: float) -> Band:
    return Band(name, lower, upper)


def _read_band(entry: Entry) -> Band:
    if isinstance(entry.value, dict):
        return build(entry, {"Band": _band, "sensor_band": sensor_band}, READERS, default="Band")
    return BANDS[one_of(list(BANDS))(entry)]


def band_list(entry: Entry) -> tuple[Band, ...]:
    """Bands by name, or as tables; no two of one name."""
    bands = tuple(_read_band(item) for item in entry.items())
    names = [band.name for band in bands]
    if not bands or len(set(names)) < len(names):
        raise entry.wrong("at least one band, and different names")
    return bands


def k_nodes(path: Path) -> Nodes:
    """The nodes of tables of cross-sections, see `jaxir.io.spectra`."""
    return load_k_tables(path).nodes


def k_air(path: Path) -> FixedPath:
    """The air of tables of cross-sections, on their nodes.

    Raises:
        ValueError: the file holds none.
    """
    air = load_k_tables(path).air
    if air is None:
        raise ValueError(f"{path}: holds no air, expected tables saved with that of `slot_atmosphere`")
    return air


def _k_tables(entry: Entry) -> tuple[CrossSections, ...]:
    def tables(path: Path) -> tuple[CrossSections, ...]:
        return load_k_tables(path).tables

    return construct(entry, tables, READERS)


def _refractive_index(entry: Entry) -> Any:
    """n - i k of `{ n, k }`, numbers or one per wavelength."""
    parts = entry.only(["n", "k"], ["n", "k"])
    return np.asarray(numbers(parts["n"])) - 1j * np.asarray(numbers(parts["k"]))


def _mie(entry: Entry) -> Any:
    readers = {"index": _refractive_index, "angles": integer, "sizes": integer}
    return build(entry, {"mie_table": mie_table}, readers)


def _number_table(entry: Entry) -> dict[str, Any]:
    return {name: numbers(child) for name, child in entry.children().items()}


def _field_values(entry: Entry) -> dict[str, float]:
    return {name: number(child) for name, child in entry.children().items()}


def _unit(entry: Entry) -> str | float:
    """The name of a length unit, or its metres."""
    return number(entry) if isinstance(entry.value, (int, float)) else one_of(list(METRES))(entry)


def _direction(entry: Entry) -> Any:
    """A direction by name, or three numbers."""
    return text(entry) if isinstance(entry.value, str) else numbers(entry)


def _per_node(entry: Entry) -> float | np.ndarray:
    """Numbers; a field over a grid holds in every node."""
    value = numbers(entry)
    return value[..., None] if isinstance(value, np.ndarray) and value.ndim == 3 else value


def _key(entry: Entry) -> Any:
    return jax.random.key(integer(entry))


AXES: dict[str, Callable] = {"Axes": Axes}
BANDS = {band.name: band for band in (SWIR, MWIR, LWIR)}
BRDFS: dict[str, Callable] = {
    "Lambert": Lambert,
    "SandfordRobertson": SandfordRobertson,
    "RoughConductor": RoughConductor,
    "BrdfTable": BrdfTable,
}
GASES: dict[str, Callable] = {
    "GrayGas": GrayGas,
    "NarrowBandGas": NarrowBandGas,
    "CorrelatedK": CorrelatedK,
    "combustion_gas": combustion_gas,
}
PARTICLES: dict[str, Callable] = {"Particles": Particles, "GrayParticles": GrayParticles}
PHASES: dict[str, Callable] = {
    "Isotropic": Isotropic,
    "HenyeyGreenstein": HenyeyGreenstein,
    "TabulatedPhase": TabulatedPhase,
}
PLUMES: dict[str, Callable] = {"GridPlume": GridPlume, "JetPlume": JetPlume}
SUNS: dict[str, Callable] = {"Sun": Sun, "sun_at": sun_at}
SOURCES: dict[str, Callable] = {
    "ParallelSource": ParallelSource,
    "PointSource": PointSource,
    "DiscSource": DiscSource,
    "PolygonSource": PolygonSource,
    "SphereSource": SphereSource,
    **SUNS,
}
SPECTRA: dict[str, Callable] = {
    "BlackbodySpectrum": BlackbodySpectrum,
    "TabulatedSpectrum": TabulatedSpectrum,
    "load_tape7_sun": load_tape7_sun,
}
BACKGROUNDS: dict[str, Callable] = {
    "UniformBackground": UniformBackground,
    "BlackbodyBackground": BlackbodyBackground,
    "ElevationTable": ElevationTable,
    "ClearSky": ClearSky,
}
ATMOSPHERES: dict[str, Callable] = {
    "StandardAtmosphere": StandardAtmosphere,
    "UniformAtmosphere": UniformAtmosphere,
    "FixedPath": FixedPath,
    "PathToSpace": PathToSpace,
    "TableAtmosphere": TableAtmosphere,
    "load_atmosphere_csv": load_atmosphere_csv,
    "load_tape7": load_tape7,
    "k_air": k_air,
}
PROFILES: dict[str, Callable] = {"us_standard_1976": us_standard_1976, "Profile": Profile}
CAMERAS: dict[str, Callable] = {
    "perspective_camera": perspective_camera,
    "orthographic_camera": orthographic_camera,
}
DIRECT: dict[str, Callable] = {"DirectSampling": DirectSampling, "ClosedForm": ClosedForm}
SAMPLERS: dict[str, Callable] = {
    "Independent": Independent,
    "Stratified": Stratified,
    "Sobol": Sobol,
    "Lattice": Lattice,
}


SELECTIONS: dict[str, Callable] = {
    "InBox": InBox,
    "InCylinder": InCylinder,
    "AbovePlane": AbovePlane,
    "Facing": Facing,
    "Connected": Connected,
    "OfPart": OfPart,
    "OfMaterial": OfMaterial,
    "Union": Union,
    "Complement": Complement,
}


def _selections(entry: Entry) -> Any:
    """A selection of faces, or several."""
    if isinstance(entry.value, list):
        return tuple(build(item, SELECTIONS, READERS) for item in entry.items())
    return build(entry, SELECTIONS, READERS)


def _texts(entry: Entry) -> tuple[str, ...]:
    """A string or several."""
    return tuple(text(item) for item in entry.items()) if isinstance(entry.value, list) else (text(entry),)


def _direct(entry: Entry) -> Any:
    """How direct light is found; the text "none" leaves it out."""
    return None if entry.value == "none" else build(entry, DIRECT, READERS, default="DirectSampling")


def _light(entry: Entry) -> Any:
    """Numbers, or a spectrum."""
    typed = isinstance(entry.value, dict) and "type" in entry.value
    return build(entry, SPECTRA, READERS) if typed else numbers(entry)


def _of(constructors: dict[str, Callable]) -> Reader:
    return lambda entry: build(entry, constructors, READERS)


# How the values of parameters are read, whatever constructor they belong to; those not named here by their types.
READERS: dict[str, Reader] = {
    "air": _of(ATMOSPHERES),
    "axes": _of(AXES),
    "axisymmetric": one_of(list("xyz")),
    "bands": band_list,
    "bounces": integer,
    "brdf": _of(BRDFS),
    "brdfs": integer,
    "coefficient": _per_node,
    "direct": _direct,
    "extinction": _per_node,
    "fields": _field_values,
    "gas": _of(GASES),
    "grid": _of({"Grid": Grid}),
    "intensity": _light,
    "irradiance": _light,
    "lights": integer,
    "materials": _texts,
    "mole_fractions": _number_table,
    "molar_masses": _field_values,
    "name": text,
    "order": integer,
    "nose": _direction,
    "of": _selections,
    "orders": integer,
    "pair_points": integer,
    "panels": integer,
    "particles": _of(PARTICLES),
    "parts": _texts,
    "phase": _of(PHASES),
    "plume_light": _of({"PlumeLight": PlumeLight}),
    "points": integer,
    "profile": _of(PROFILES),
    "radiance": _light,
    "sampler": _of(SAMPLERS),
    "samples": integer,
    "scattering": _of({"DiscreteOrdinates": DiscreteOrdinates}),
    "skin_light": _of({"SkinLight": SkinLight}),
    "sun": lambda entry: build(entry, SUNS, READERS, default="Sun"),
    "table": _mie,
    "tables": _k_tables,
    "up": _direction,
    "unit": _unit,
}
RENDER_READERS: dict[str, Reader] = {
    **READERS,
    "components": one_of(KINDS),
    "key": _key,
    "max_samples": integer,
}
