"""Gases that absorb: gray, narrow-band, correlated-k; combustion products."""

from jaxir.optics.gas._combustion import combustion_products as combustion_products
from jaxir.optics.gas._correlated_k import BOLTZMANN as BOLTZMANN
from jaxir.optics.gas._correlated_k import CorrelatedK as CorrelatedK
from jaxir.optics.gas._correlated_k import CrossSections as CrossSections
from jaxir.optics.gas._gas import AbstractGas as AbstractGas
from jaxir.optics.gas._gray import GrayGas as GrayGas
from jaxir.optics.gas._k_distribution import inverse_gaussian_cdf as inverse_gaussian_cdf
from jaxir.optics.gas._k_distribution import log_quantile as log_quantile
from jaxir.optics.gas._k_distribution import log_quantile_exact as log_quantile_exact
from jaxir.optics.gas._k_distribution import quantile_series as quantile_series
from jaxir.optics.gas._narrow_band import ATMOSPHERE as ATMOSPHERE
from jaxir.optics.gas._narrow_band import NarrowBandGas as NarrowBandGas
from jaxir.optics.gas._ranking import at_quantiles as at_quantiles
from jaxir.optics.gas._ranking import bins_of as bins_of
from jaxir.optics.gas._ranking import slot_means as slot_means
