"""Plumes: cell by cell, as jets, and several of them."""

from jaxir.scene.plume._grid import GridPlume as GridPlume
from jaxir.scene.plume._jet import JetPlume as JetPlume
from jaxir.scene.plume._plume import AbstractPlume as AbstractPlume
from jaxir.scene.plume._plume import Proposal as Proposal
from jaxir.scene.plume._plume import pdf_direction as pdf_direction
from jaxir.scene.plume._plume import sample_direction as sample_direction
from jaxir.scene.plume._resolve import resolve_jet as resolve_jet
from jaxir.scene.plume._sum import PlumeSum as PlumeSum
from jaxir.scene.plume._sum import together as together
