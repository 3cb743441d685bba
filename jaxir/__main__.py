"""`python -m jaxir`: see `jaxir.command_line`."""

from jaxir.command_line import run

run()
