"""What the quadrature of plumes errs: few rays through jets, once with their panels and once with twice as many.

And through cells in the light of parallel sources, each of which is lit as its centre is, see `Method`.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxir._math import dot, matmul
from jaxir._programs import program
from jaxir.geometry import Camera
from jaxir.imaging._devices import stacked
from jaxir.optics.spectrum import Nodes
from jaxir.scene import Lit, Scene, on_nodes
from jaxir.scene.plume import AbstractPlume
from jaxir.transport import Method, Paths, evaluate, trace

SIDE = 32  # rays along each side of a plume's outline on the screen
EDGES = 4  # times what cells miss to second order: many are lit through sides that no next cell tells of
SLOW = 2  # times the change, as where panels are optically thick doubling leaves half of the error


def refined(scene: Scene) -> list[tuple[AbstractPlume, Scene]]:
    """Every plume that is integrated by quadrature, and the scene with that plume's quadrature twice as fine."""
    finer = [(index, plume.refined()) for index, plume in enumerate(scene.plumes)]
    return [
        (scene.plumes[k], dataclasses.replace(scene, plumes=(*scene.plumes[:k], plume, *scene.plumes[k + 1 :])))
        for k, plume in finer
        if plume is not None
    ]


def beams_in_cells(scene: Scene, method: Method) -> bool:
    """Whether cells are lit as their centres are."""
    return method.scattering is None and bool(scene.summed_beams)


def cells_error(lit: Lit, camera: Camera, method: Method) -> Float[np.ndarray, " band"]:
    """What `quadrature_error` tells of sunlit cells in an image [band] [W sr-1]; 0 where there are none."""
    if not beams_in_cells(lit.scene, method):
        return np.zeros(lit.nodes.response.shape[0])
    return np.asarray(_changes((lit, [], True), camera.undivided()), np.float64)


def quadrature_error(scene: Scene, nodes: Nodes, cameras: Camera, method: Method) -> Float[Array, "view band"]:
    """About what the quadrature of the plumes errs in the intensity of views [view, band] [W sr-1].

    `SLOW` times the change of I = sum L dA / (1 + tan^2)^2 as panels are doubled, by `SIDE`^2 rays spread evenly over
    the rectangle about each plume inside the frame. The fourth-order rule leaves 1/16 of its error then, in panels that
    are optically thick up to half. What particles scatter and what skin reflects of a jet is not looked for. Of cells
    in parallel light it is `EDGES` times `AbstractMedium.missed`, one to two times the error of cubes of 4 to 16 unlike
    cells a side, .1 to .5 deep each.

    Args:
        scene: with plumes.
        nodes: the spectral axis.
        cameras: [view].
        method: how light is found.
    """
    both = [(plume, on_nodes(finer, nodes)) for plume, finer in refined(scene)]
    asked = on_nodes(scene, nodes), both, beams_in_cells(scene, method)
    return stacked(_changes, asked, jax.vmap(Camera.undivided)(cameras), "quadrature")


@program
def _changes(asked: tuple[Lit, list[tuple[AbstractPlume, Lit]], bool], camera: Camera) -> Float[Array, " band"]:
    """What `quadrature_error` adds up of one view."""
    lit, both, beams = asked
    total = jnp.zeros(lit.nodes.response.shape[0], camera.pixel.dtype)

    def look(plume: AbstractPlume) -> tuple[Array, Paths]:
        """Weights and paths of rays through a plume."""
        screen, weight = camera.spread_over(plume.extent(), SIDE)
        rays = camera.bundle(screen, lit.scene.start(camera)).rays()
        return weight, trace(lit.scene, rays, Method(direct=None, orders=0))

    for plume, finer in both:
        weight, paths = look(plume)
        change = evaluate(finer, paths) - evaluate(lit, paths)
        total = total + SLOW * jnp.abs(lit.nodes.in_band(matmul(weight, change)))
    if beams:
        assert lit.scene.plume is not None and lit.medium is not None
        weight, paths = look(lit.scene.plume)
        rays, length = paths.first.rays, paths.first.length
        for source, irradiance in zip(lit.scene.summed_beams, lit.beams, strict=True):
            assert source.travel is not None
            lacks = lit.medium.missed(irradiance, source.travel, rays.direction[0])
            sent = lit.medium.in_scattered(lacks, dot(rays.direction, -source.travel[None]), rays, length)
            missed = matmul(weight, sent)
            total = total + EDGES * lit.nodes.in_band(missed if lit.air is None else missed * lit.air.transmittance)
    return total
