"""What the quadrature of jets errs: few rays through each, once with its panels and once with twice as many."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._math import matmul
from jaxir._programs import program
from jaxir.geometry import Camera
from jaxir.imaging._devices import stacked
from jaxir.optics.spectrum import Nodes
from jaxir.scene import Lit, Scene, on_nodes
from jaxir.scene.plume import AbstractPlume
from jaxir.transport import Method, evaluate, trace

SIDE = 32  # rays along each side of a plume's outline on the screen
SLOW = 2  # times the change, as where panels are optically thick doubling leaves half of the error


def refined(scene: Scene) -> list[tuple[AbstractPlume, Scene]]:
    """Every plume that is integrated by quadrature, and the scene with that plume's quadrature twice as fine."""
    finer = [(index, plume.refined()) for index, plume in enumerate(scene.plumes)]
    return [
        (scene.plumes[k], dataclasses.replace(scene, plumes=(*scene.plumes[:k], plume, *scene.plumes[k + 1 :])))
        for k, plume in finer
        if plume is not None
    ]


def quadrature_error(scene: Scene, nodes: Nodes, cameras: Camera) -> Float[Array, "view band"]:
    """About what the quadrature of the plumes errs in the intensity of views [view, band] [W sr-1].

    `SLOW` times the change of I = sum L dA / (1 + tan^2)^2 as panels are doubled, by `SIDE`^2 rays spread evenly over
    the rectangle about each plume inside the frame. The fourth-order rule leaves 1/16 of its error then, in panels that
    are optically thick up to half. What particles scatter and what skin reflects of the plume is not looked for.

    Args:
        scene: with plumes.
        nodes: the spectral axis.
        cameras: [view].
    """
    both = [(plume.extent(), on_nodes(finer, nodes)) for plume, finer in refined(scene)]
    return stacked(_changes, (on_nodes(scene, nodes), both), jax.vmap(Camera.undivided)(cameras), "quadrature")


@program
def _changes(asked: tuple[Lit, list[tuple[Array, Lit]]], camera: Camera) -> Float[Array, " band"]:
    """`SLOW` times what changes in one view as the panels of each plume are doubled."""
    lit, both = asked
    total = jnp.zeros(lit.nodes.response.shape[0], camera.pixel.dtype)
    for extent, finer in both:
        screen, weight = camera.spread_over(extent, SIDE)
        rays = camera.bundle(screen, lit.scene.start(camera)).rays()
        paths = trace(lit.scene, rays, Method(direct=None, orders=0))
        change = evaluate(finer, paths) - evaluate(lit, paths)
        total = total + jnp.abs(lit.nodes.in_band(matmul(weight, change)))
    return SLOW * total
