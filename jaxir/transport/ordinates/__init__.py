"""Scattered light without samples, by discrete ordinates."""

from jaxir.transport.ordinates._scattered import Scattered as Scattered
from jaxir.transport.ordinates._scattered import error_of_bands as error_of_bands
from jaxir.transport.ordinates._scattered import scattered as scattered
from jaxir.transport.ordinates._scattered import solution_checks as solution_checks
