"""Results to files, and sweeps that survive being killed."""

from jaxir.io.result._afsim import require_afsim_name as require_afsim_name
from jaxir.io.result._afsim import require_full_table as require_full_table
from jaxir.io.result._afsim import save_afsim as save_afsim
from jaxir.io.result._maps import save_face_values as save_face_values
from jaxir.io.result._results import Conditions as Conditions
from jaxir.io.result._results import require_suffix as require_suffix
from jaxir.io.result._results import save_image as save_image
from jaxir.io.result._results import save_netcdf as save_netcdf
from jaxir.io.result._results import save_signature as save_signature
from jaxir.io.result._results import save_tiff as save_tiff
from jaxir.io.result._sweep import sweep as sweep
from jaxir.io.result._sweep import sweep_states as sweep_states
