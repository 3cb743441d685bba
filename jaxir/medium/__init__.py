"""How radiance passes through matter on the spectral nodes: cells, jets, and sums of them."""

from jaxir.medium._cells import CellMedium as CellMedium
from jaxir.medium._cells import cell_cuts as cell_cuts
from jaxir.medium._crossing_sum import crossing_sum as crossing_sum
from jaxir.medium._distance import Distance as Distance
from jaxir.medium._distance import sample_in_cells as sample_in_cells
from jaxir.medium._distance import sample_in_panels as sample_in_panels
from jaxir.medium._jet import JetMedium as JetMedium
from jaxir.medium._jet import tabulated_jet as tabulated_jet
from jaxir.medium._jet_layers import panel_weights as panel_weights
from jaxir.medium._jet_shape import JetShape as JetShape
from jaxir.medium._jet_shape import meets_jet as meets_jet
from jaxir.medium._jet_shape import panel_edges as panel_edges
from jaxir.medium._march import march as march
from jaxir.medium._march import optical_depth as optical_depth
from jaxir.medium._march import transmittance as transmittance
from jaxir.medium._medium import AbstractMedium as AbstractMedium
from jaxir.medium._medium import AbstractScatterer as AbstractScatterer
from jaxir.medium._medium import Capsules as Capsules
from jaxir.medium._medium import MediumOptics as MediumOptics
from jaxir.medium._medium import medium_optics as medium_optics
from jaxir.medium._primitives import register_linear as register_linear
from jaxir.medium._primitives import streaming_primitive as streaming_primitive
from jaxir.medium._sum import MediumSum as MediumSum
from jaxir.medium._sum import merged_cuts as merged_cuts
from jaxir.medium._sum import panel_points as panel_points
from jaxir.medium._sum import radiance_between as radiance_between
