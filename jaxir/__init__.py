"""jaxir: differentiable infrared radiometry of aircraft skin and exhaust plumes, in JAX.

The names below are grouped by task: what a scene is made of, what its gas does, whence it is seen, what is computed,
and how. Fits are in `jaxir.fit`, files in `jaxir.io`.
"""

# isort: off
from jaxir._cache import compilation_cache as compilation_cache
from jaxir._process import compiler_options as compiler_options
from jaxir._version import __version__ as __version__

# A scene
from jaxir.scene import Lit as Lit
from jaxir.scene import Scene as Scene
from jaxir.scene import Skin as Skin
from jaxir.geometry import Grid as Grid
from jaxir.geometry.search import Mesh as Mesh

# Its parts: faces by place, direction, connection and name
from jaxir.geometry.selection import AbovePlane as AbovePlane
from jaxir.geometry.selection import Connected as Connected
from jaxir.geometry.selection import Facing as Facing
from jaxir.geometry.selection import InBox as InBox
from jaxir.geometry.selection import InCylinder as InCylinder
from jaxir.geometry.selection import OfMaterial as OfMaterial
from jaxir.geometry.selection import OfPart as OfPart

# Its surfaces
from jaxir.optics.surface import BrdfPerFace as BrdfPerFace
from jaxir.optics.surface import BrdfTable as BrdfTable
from jaxir.optics.surface import Lambert as Lambert
from jaxir.optics.surface import RoughConductor as RoughConductor
from jaxir.optics.surface import SandfordRobertson as SandfordRobertson

# Its plumes: where they are, the gas and the particles in them
from jaxir.scene.plume import GridPlume as GridPlume
from jaxir.scene.plume import JetPlume as JetPlume
from jaxir.scene.plume import resolve_jet as resolve_jet
from jaxir.optics.gas import CorrelatedK as CorrelatedK
from jaxir.optics.gas import GrayGas as GrayGas
from jaxir.optics.gas import NarrowBandGas as NarrowBandGas
from jaxir.optics.gas import combustion_products as combustion_products
from jaxir.optics.particle import GrayParticles as GrayParticles
from jaxir.optics.particle import HenyeyGreenstein as HenyeyGreenstein
from jaxir.optics.particle import Isotropic as Isotropic
from jaxir.optics.particle import Particles as Particles
from jaxir.optics.particle import TabulatedPhase as TabulatedPhase
from jaxir.optics.particle import mie_table as mie_table
from jaxir.optics.particle import number_density as number_density

# Its lights and surroundings
from jaxir.optics.spectrum import BlackbodySpectrum as BlackbodySpectrum
from jaxir.optics.spectrum import TabulatedSpectrum as TabulatedSpectrum
from jaxir.scene.light import BlackbodyBackground as BlackbodyBackground
from jaxir.scene.light import ClearSky as ClearSky
from jaxir.scene.light import DiscSource as DiscSource
from jaxir.scene.light import ElevationTable as ElevationTable
from jaxir.scene.light import ParallelSource as ParallelSource
from jaxir.scene.light import PointSource as PointSource
from jaxir.scene.light import PolygonSource as PolygonSource
from jaxir.scene.light import SphereSource as SphereSource
from jaxir.scene.light import Sun as Sun
from jaxir.scene.light import sun_at as sun_at
from jaxir.scene.light import UniformBackground as UniformBackground

# The air in front of it
from jaxir.optics.air import air_pressure as air_pressure
from jaxir.optics.air import air_temperature as air_temperature
from jaxir.optics.air import slant_range as slant_range
from jaxir.optics.air import us_standard_1976 as us_standard_1976
from jaxir.scene.air import FixedPath as FixedPath
from jaxir.scene.air import PathToSpace as PathToSpace
from jaxir.scene.air import StandardAtmosphere as StandardAtmosphere
from jaxir.scene.air import TableAtmosphere as TableAtmosphere
from jaxir.scene.air import UniformAtmosphere as UniformAtmosphere

# Bands and spectral nodes
from jaxir.optics.spectrum import LWIR as LWIR
from jaxir.optics.spectrum import MWIR as MWIR
from jaxir.optics.spectrum import SWIR as SWIR
from jaxir.optics.spectrum import Band as Band
from jaxir.optics.spectrum import Nodes as Nodes
from jaxir.optics.spectrum import band_radiance as band_radiance
from jaxir.optics.spectrum import brightness_temperature as brightness_temperature
from jaxir.optics.spectrum import gray_nodes as gray_nodes
from jaxir.optics.spectrum import nodes_for as nodes_for
from jaxir.optics.spectrum import resolved_nodes as resolved_nodes
from jaxir.scene import optimal_nodes as optimal_nodes
from jaxir.scene import scene_nodes as scene_nodes
from jaxir.optics.spectrum import sensor_band as sensor_band

# Views
from jaxir.geometry import Camera as Camera
from jaxir.geometry import Rays as Rays
from jaxir.geometry import fitted_camera as fitted_camera
from jaxir.geometry import orthographic_camera as orthographic_camera
from jaxir.geometry import perspective_camera as perspective_camera
from jaxir.geometry.search import visible_faces as visible_faces

# Images and intensities
from jaxir.imaging import ErrorBudget as ErrorBudget
from jaxir.imaging import Image as Image
from jaxir.imaging import Outcome as Outcome
from jaxir.imaging import Plan as Plan
from jaxir.imaging import Signature as Signature
from jaxir.imaging import Term as Term
from jaxir.imaging import plan as plan
from jaxir.imaging import plume_intensity as plume_intensity
from jaxir.imaging import render as render
from jaxir.imaging import signature as signature
from jaxir.imaging import unoccluded_intensity as unoccluded_intensity
from jaxir.quantity import alone as alone
from jaxir.quantity import at_target as at_target

# How light is found
from jaxir.geometry import Independent as Independent
from jaxir.geometry import Lattice as Lattice
from jaxir.geometry import Sobol as Sobol
from jaxir.geometry import Stratified as Stratified
from jaxir.transport import ClosedForm as ClosedForm
from jaxir.transport import DirectSampling as DirectSampling
from jaxir.transport import DiscreteOrdinates as DiscreteOrdinates
from jaxir.transport import Method as Method
from jaxir.transport import PlumeLight as PlumeLight
from jaxir.transport import SkinLight as SkinLight

# Rays by hand: trace once, evaluate often
from jaxir.transport import Paths as Paths
from jaxir.transport import evaluate as evaluate
from jaxir.transport import store_route as store_route
from jaxir.transport import trace as trace

# The paper's estimators of the radiance along a ray
from jaxir.transport import CellSum as CellSum
from jaxir.transport import CombinedIntegration as CombinedIntegration
from jaxir.transport import LineIntegration as LineIntegration
from jaxir.transport import PointIntegration as PointIntegration
from jaxir.transport import estimate as estimate

# What is legal and hardly meant is warned of
from jaxir._arrays import PlausibilityWarning as PlausibilityWarning
# isort: on
