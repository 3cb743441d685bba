"""The air: its profile, and the cold path through it."""

from jaxir.optics.air._profile import Profile as Profile
from jaxir.optics.air._profile import air_pressure as air_pressure
from jaxir.optics.air._profile import air_temperature as air_temperature
from jaxir.optics.air._profile import us_standard_1976 as us_standard_1976
from jaxir.optics.air._sight import Sight as Sight
from jaxir.optics.air._sight import air_along as air_along
from jaxir.optics.air._sight import horizon as horizon
from jaxir.optics.air._sight import to_ground as to_ground
from jaxir.optics.air._sight import to_sky as to_sky
from jaxir.optics.air._standard import EARTH_RADIUS as EARTH_RADIUS
from jaxir.optics.air._standard import PathAir as PathAir
from jaxir.optics.air._standard import altitude_along as altitude_along
from jaxir.optics.air._standard import path_air as path_air
from jaxir.optics.air._standard import path_emission as path_emission
from jaxir.optics.air._standard import path_transmittance as path_transmittance
from jaxir.optics.air._standard import slant_range as slant_range
from jaxir.optics.air._standard import slot_path as slot_path
