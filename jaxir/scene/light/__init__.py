"""Lights: parallel and point sources, discs, polygons, spheres, and what surrounds a scene."""

from jaxir.scene.light._background import BlackbodyBackground as BlackbodyBackground
from jaxir.scene.light._background import UniformBackground as UniformBackground
from jaxir.scene.light._clear_sky import ClearSky as ClearSky
from jaxir.scene.light._disc import DiscSource as DiscSource
from jaxir.scene.light._light import AbstractAreaSource as AbstractAreaSource
from jaxir.scene.light._light import AbstractBackground as AbstractBackground
from jaxir.scene.light._light import AbstractDeltaSource as AbstractDeltaSource
from jaxir.scene.light._light import AbstractExtendedLight as AbstractExtendedLight
from jaxir.scene.light._light import AbstractLight as AbstractLight
from jaxir.scene.light._light import Arrival as Arrival
from jaxir.scene.light._light import area_sources as area_sources
from jaxir.scene.light._light import backgrounds as backgrounds
from jaxir.scene.light._light import delta_sources as delta_sources
from jaxir.scene.light._light import spread as spread
from jaxir.scene.light._light import towards as towards
from jaxir.scene.light._light import within_scene as within_scene
from jaxir.scene.light._parallel import ParallelSource as ParallelSource
from jaxir.scene.light._point import PointSource as PointSource
from jaxir.scene.light._polygon import PolygonSource as PolygonSource
from jaxir.scene.light._sky import ElevationTable as ElevationTable
from jaxir.scene.light._sphere import SphereSource as SphereSource
from jaxir.scene.light._sun import Sun as Sun
from jaxir.scene.light._sun import sun_at as sun_at
from jaxir.scene.light._sun import sun_position as sun_position
from jaxir.scene.light._sun import sunlight as sunlight
