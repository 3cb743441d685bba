"""`python -m jaxir`: see `jaxir.command_line`."""

import sys

from jaxir.command_line import main

sys.exit(main(sys.argv[1:]))
