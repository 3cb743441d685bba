"""Reflectance of opaque skin; emissivity follows by Kirchhoff's law."""

from jaxir.optics.surface._brdf import AbstractBrdf as AbstractBrdf
from jaxir.optics.surface._brdf import cosine_density as cosine_density
from jaxir.optics.surface._brdf import cosine_direction as cosine_direction
from jaxir.optics.surface._brdf import facing as facing
from jaxir.optics.surface._brdf import parameter as parameter
from jaxir.optics.surface._ggx import RoughConductor as RoughConductor
from jaxir.optics.surface._lambert import Lambert as Lambert
from jaxir.optics.surface._measured import BrdfTable as BrdfTable
from jaxir.optics.surface._per_face import BrdfPerFace as BrdfPerFace
from jaxir.optics.surface._per_face import joined_brdf as joined_brdf
from jaxir.optics.surface._per_face import painted_brdf as painted_brdf
from jaxir.optics.surface._sandford_robertson import SandfordRobertson as SandfordRobertson
