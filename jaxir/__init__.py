"""jaxir: differentiable infrared radiometry of aircraft skin and exhaust plumes, in JAX."""
