"""Air paths, lines and tables of cross-sections from files."""

from jaxir.io.spectra._atmospheres import load_atmosphere_csv as load_atmosphere_csv
from jaxir.io.spectra._atmospheres import load_tape7 as load_tape7
from jaxir.io.spectra._atmospheres import load_tape7_sun as load_tape7_sun
from jaxir.io.spectra._hitran import check_line_file as check_line_file
from jaxir.io.spectra._k_tables import GasState as GasState
from jaxir.io.spectra._k_tables import KTables as KTables
from jaxir.io.spectra._k_tables import Spectra as Spectra
from jaxir.io.spectra._k_tables import load_k_tables as load_k_tables
from jaxir.io.spectra._k_tables import save_k_tables as save_k_tables
from jaxir.io.spectra._k_tables import slot_atmosphere as slot_atmosphere
from jaxir.io.spectra._k_tables import tabulate as tabulate
from jaxir.io.spectra._lines import line_spectra as line_spectra
