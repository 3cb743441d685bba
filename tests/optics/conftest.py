import pytest

from studies import co2_lines as truth


@pytest.fixture(scope="session")
def co2_lines():
    """(temperature, partial pressure [atm], Lorentz half-width [cm-1]) -> wavenumber, absorption [m-1]."""

    def absorption(temperature, partial, width):
        wavenumber, cross_section = truth.spectrum(temperature, width)
        return wavenumber, cross_section * partial * truth.ATMOSPHERE / (truth.BOLTZMANN * temperature)

    return absorption
