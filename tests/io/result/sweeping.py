"""A sweep to be killed: `python -m tests.io.result.sweeping FOLDER`."""

import sys

import numpy as np

import jaxir
from jaxir.io.result import sweep
from tests.scenes import plate

VIEWS = np.stack([np.linspace(-60.0, 60.0, 400), np.linspace(0.0, 30.0, 400)], axis=1)


def asked(temperature=400.0, count=400):
    """Scene, views, bands of the sweep."""
    return jaxir.Scene(plate(temperature=temperature)), VIEWS[:count], jaxir.LWIR


SHAPE = (24, 24)

if __name__ == "__main__":
    sweep(sys.argv[1], *asked(), shape=SHAPE)
