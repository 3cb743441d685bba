"""Scattered light without samples, by discrete ordinates."""

from jaxir.transport.ordinates._medium import Scattered as Scattered
from jaxir.transport.ordinates._medium import lattice_error as lattice_error
from jaxir.transport.ordinates._medium import lattice_lacks as lattice_lacks
from jaxir.transport.ordinates._medium import solution_checks as solution_checks
from jaxir.transport.ordinates._posed import Posed as Posed
from jaxir.transport.ordinates._posed import posed as posed
from jaxir.transport.ordinates._scattered import Solution as Solution
from jaxir.transport.ordinates._scattered import finished as finished
from jaxir.transport.ordinates._scattered import solution as solution
