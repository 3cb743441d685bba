"""Parameters of a scene from measured intensities and images, with their uncertainty, over optimistix."""

from jaxir.fit.descent import LevenbergMarquardt as LevenbergMarquardt
from jaxir.fit.measurement import Measurement as Measurement
from jaxir.fit.measurement import measured_image as measured_image
from jaxir.fit.measurement import measured_intensity as measured_intensity
from jaxir.fit.named import jet_parameter as jet_parameter
from jaxir.fit.named import mole_fraction_scale as mole_fraction_scale
from jaxir.fit.named import part_emissivity as part_emissivity
from jaxir.fit.named import part_temperature as part_temperature
from jaxir.fit.named import particle_loading as particle_loading
from jaxir.fit.named import temperature_scale as temperature_scale
from jaxir.fit.parameter import Bounds as Bounds
from jaxir.fit.parameter import Factor as Factor
from jaxir.fit.parameter import Leaf as Leaf
from jaxir.fit.parameter import PartValue as PartValue
from jaxir.fit.prior import NormalPrior as NormalPrior
from jaxir.fit.prior import SmoothPrior as SmoothPrior
from jaxir.fit.problem import prepare as prepare
from jaxir.fit.result import Fit as Fit
from jaxir.fit.result import Uncertainty as Uncertainty
from jaxir.fit.sensitivity import sensitivity as sensitivity
from jaxir.fit.solve import expected_uncertainty as expected_uncertainty
from jaxir.fit.solve import fit as fit
from jaxir.fit.solve import solve as solve
