"""Particles that scatter: their optics, phase functions, Mie tables."""

from jaxir.optics.particle._gray import GrayParticles as GrayParticles
from jaxir.optics.particle._mie import mie_table as mie_table
from jaxir.optics.particle._particles import EXAMPLE as EXAMPLE
from jaxir.optics.particle._particles import AbstractParticles as AbstractParticles
from jaxir.optics.particle._particles import number_density as number_density
from jaxir.optics.particle._phase import AbstractPhase as AbstractPhase
from jaxir.optics.particle._phase import HenyeyGreenstein as HenyeyGreenstein
from jaxir.optics.particle._phase import Isotropic as Isotropic
from jaxir.optics.particle._phase import TabulatedPhase as TabulatedPhase
from jaxir.optics.particle._tabulated import Particles as Particles
from jaxir.optics.particle._tabulated import ParticleTable as ParticleTable
