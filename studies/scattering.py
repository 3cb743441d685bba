"""What does each way of finding light that particles scatter cost, and where does it fail?

A warm jet with gray particles beside a hot plate under the sun, over the optical depth of scattering across its nozzle,
the albedo and the asymmetry of Henyey and Greenstein's phase function, seen from the side and from ahead, the plate edge-on. Each way is
compared with long forced collision, and with what it tells of its own error: standard error and truncation.
"""

import argparse
import time
from collections.abc import Iterator
from typing import NamedTuple

import jax
import numpy as np
from tqdm import tqdm

import jaxir
from jaxir import DiscreteOrdinates, Method
from studies._study import Run, study, subplots

DEPTHS = (0.1, 1.0, 5.0, 20.0, 50.0)
ALBEDOS = (0.3, 0.9, 1.0)
ASYMMETRIES = (0.0, 0.6, 0.95)
LIGHTS = ("own", "plate", "sun")  # in turn
ASPECTS = ((90.0, 0.0), (20.0, 0.0))  # the plate edge-on
DIAMETER = 0.5
SHAPE = (24, 48)
WAYS = {
    "once": (Method(orders=1), 64),
    "10 orders": (Method(orders=10), 64),
    "lattice 13 x 5": (Method(scattering=DiscreteOrdinates(13, 5)), 2),
    "lattice 25 x 7": (Method(scattering=DiscreteOrdinates()), 2),
    "lattice 41 x 9, order 5": (Method(scattering=DiscreteOrdinates(41, 9, 5)), 2),
}
CLOSE = 1e-3  # the longest reference's standard error
LEFT = 0.01  # share of a reference beyond its last order at most


class Case(NamedTuple):
    """Optics of the particles, and what lights them."""

    depth: float
    albedo: float
    asymmetry: float
    light: str

    def scene(self, warmer: float = 0.0) -> jaxir.Scene:
        """Alike in structure for all; `warmer` [K] makes it another one."""
        phase = jaxir.HenyeyGreenstein(self.asymmetry)
        particles = jaxir.GrayParticles(self.depth / DIAMETER / self.albedo, self.albedo, phase)
        hot = {"own": 700.0, "plate": 250.0, "sun": 250.0}[self.light]
        jet = jaxir.JetPlume(
            (0.0, 0.0, 0.0),
            (-1.0, 0.0, 0.0),
            DIAMETER,
            hot + warmer,
            250.0,
            jaxir.GrayGas(0.05),
            length=8.0,
            panels=8,
            particles=particles,
        )
        corners = [(-3.0, -1.0, -1.5), (0.0, -1.0, -1.5), (0.0, 1.0, -1.5), (-3.0, 1.0, -1.5)]
        plate = jaxir.Mesh(corners, [(0, 1, 2), (0, 2, 3)])
        skin = jaxir.Skin(plate, 900.0 if self.light == "plate" else 100.0, jaxir.Lambert(1.0))
        sun = jaxir.ParallelSource((0.0, 0.6, -0.8), 100.0 if self.light == "sun" else 0.0)
        return jaxir.Scene(skin, jet, sun)


def cases() -> Iterator[Case]:
    index = 0
    for depth in DEPTHS:
        for albedo in ALBEDOS:
            for asymmetry in ASYMMETRIES:
                yield Case(depth, albedo, asymmetry, LIGHTS[index % 3])
                index += 1


def plume_alone(case: Case, method: Method, samples: int, key: int = 0, warmer: float = 0.0) -> jaxir.Signature:
    return jaxir.signature(
        case.scene(warmer),
        ASPECTS,
        [jaxir.MWIR],
        shape=SHAPE,
        samples=samples,
        method=method,
        key=jax.random.key(key),
    )
