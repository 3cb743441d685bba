"""Entries: radiance image with standard error, radiant intensity, signature over aspects."""

from jaxir.imaging._chunks import Pass as Pass
from jaxir.imaging._chunks import estimate_chunk as estimate_chunk
from jaxir.imaging._chunks import whole_image as whole_image
from jaxir.imaging._devices import is_traced as is_traced
from jaxir.imaging._devices import item_by_item as item_by_item
from jaxir.imaging._devices import shared_by as shared_by
from jaxir.imaging._faces import unoccluded_intensity as unoccluded_intensity
from jaxir.imaging._image import Image as Image
from jaxir.imaging._image import Outcome as Outcome
from jaxir.imaging._passes import render as render
from jaxir.imaging._pilot import ErrorLaw as ErrorLaw
from jaxir.imaging._pilot import Pilot as Pilot
from jaxir.imaging._pilot import error_law as error_law
from jaxir.imaging._pilot import pilot as pilot
from jaxir.imaging._pilot import well_shaped as well_shaped
from jaxir.imaging._planning import Plan as Plan
from jaxir.imaging._planning import Term as Term
from jaxir.imaging._planning import plan as plan
from jaxir.imaging._plumes import entering as entering
from jaxir.imaging._plumes import plume_intensity as plume_intensity
from jaxir.imaging._views import Signature as Signature
from jaxir.imaging._views import Views as Views
from jaxir.imaging._views import prepare_views as prepare_views
from jaxir.imaging._views import signature as signature
from jaxir.imaging._views import view_intensity as view_intensity
