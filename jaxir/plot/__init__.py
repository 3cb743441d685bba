"""Looking at things: images, signatures, spectra, fits, and a scene with its cameras before a long run.

Every function returns a `matplotlib.figure.Figure` that belongs to nobody: `figure.savefig("name.png")` writes it, a
notebook shows it. matplotlib is imported on the first call and is an optional extra: `pip install "jaxir[plot]"`.
"""

from jaxir.plot._components import component_bars as component_bars
from jaxir.plot._components import component_signature as component_signature
from jaxir.plot._errors import error_bars as error_bars
from jaxir.plot._films import film as film
from jaxir.plot._films import film_strip as film_strip
from jaxir.plot._fit import fit_report as fit_report
from jaxir.plot._images import QUANTITIES as QUANTITIES
from jaxir.plot._images import SCALES as IMAGE_SCALES
from jaxir.plot._images import component_panels as component_panels
from jaxir.plot._images import radiance_image as radiance_image
from jaxir.plot._images import radiance_panels as radiance_panels
from jaxir.plot._polar import SCALES as POLAR_SCALES
from jaxir.plot._polar import polar_signature as polar_signature
from jaxir.plot._scene import COLOURS as COLOURS
from jaxir.plot._scene import scene_view as scene_view
from jaxir.plot._spectrum import spectrum as spectrum

PICTURE_SCALES = {"render": IMAGE_SCALES, "film": IMAGE_SCALES, "signature": tuple(POLAR_SCALES)}
