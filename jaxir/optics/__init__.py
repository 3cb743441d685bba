"""What matter does to light: spectra, gases, surfaces, particles, air, and the equation of transfer in a slab."""

from jaxir.optics._slab import SERIES_BELOW as SERIES_BELOW
from jaxir.optics._slab import across_layer as across_layer
from jaxir.optics._slab import attenuate as attenuate
from jaxir.optics._slab import phi1 as phi1
from jaxir.optics._slab import phi2 as phi2
from jaxir.optics._slab import thinning as thinning
from jaxir.optics._slab import through_layer as through_layer
