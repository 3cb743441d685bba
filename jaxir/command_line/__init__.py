"""The command line: scenes from TOML files to images, signature tables and reports.

jaxir show scene.toml -o setup.png
jaxir render scene.toml -o image.npz
jaxir signature scene.toml -o table.csv
jaxir report scene.toml -o report.html
"""

from jaxir.command_line._main import main as main
from jaxir.command_line._main import run as run
