"""The air between target and sensor."""

from jaxir.scene.air._air import AbstractAtmosphere as AbstractAtmosphere
from jaxir.scene.air._air import AirPath as AirPath
from jaxir.scene.air._fixed import FixedPath as FixedPath
from jaxir.scene.air._standard import StandardAtmosphere as StandardAtmosphere
from jaxir.scene.air._table import TableAtmosphere as TableAtmosphere
from jaxir.scene.air._to_space import TARGET_ALTITUDE as TARGET_ALTITUDE
from jaxir.scene.air._to_space import PathToSpace as PathToSpace
from jaxir.scene.air._to_space import or_us_standard as or_us_standard
from jaxir.scene.air._uniform import UniformAtmosphere as UniformAtmosphere
