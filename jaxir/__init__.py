"""jaxir: differentiable infrared radiometry of aircraft skin and exhaust plumes, in JAX."""

from jaxir import _process
from jaxir._process import native_loops as native_loops

_process.apply()
