"""Entries: radiance image with standard error, radiant intensity, signature over aspects."""

from jaxir.render.faces import unoccluded_intensity as unoccluded_intensity
from jaxir.render.image import Image as Image
from jaxir.render.image import Outcome as Outcome
from jaxir.render.passes import render as render
from jaxir.render.planning import Plan as Plan
from jaxir.render.planning import Term as Term
from jaxir.render.planning import plan as plan
from jaxir.render.plumes import plume_intensity as plume_intensity
from jaxir.render.views import Signature as Signature
from jaxir.render.views import signature as signature
