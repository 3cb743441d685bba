"""Radiance split by where its light comes from."""

from jaxir.transport.components._components import AIR as AIR
from jaxir.transport.components._components import BACKGROUND as BACKGROUND
from jaxir.transport.components._components import KINDS as KINDS
from jaxir.transport.components._components import Components as Components
from jaxir.transport.components._components import components_of as components_of
from jaxir.transport.components._components import empty_components as empty_components
from jaxir.transport.components._components import evaluate_components as evaluate_components
from jaxir.transport.components._components import with_own_media as with_own_media
