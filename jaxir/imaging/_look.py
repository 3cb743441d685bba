"""One look at a view: an image of which the sums over its pixels are wanted alone."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from jaxir._arrays import is_traced
from jaxir._programs import program
from jaxir.geometry import Camera
from jaxir.imaging._chunks import Pass, as_number, estimate_chunk, parts_for
from jaxir.imaging._division import Chunk, Division
from jaxir.imaging._image import totals
from jaxir.scene import Lit
from jaxir.transport import Components, Method, aimed


class Shared(NamedTuple):
    """What looks at views have in common.

    Attributes:
        lit: the scene on the nodes.
        key: random key; that of a view does not depend on how many follow.
        strata: in a pixel.
        method: how radiance is found.
        components: by which intensities are split; None for none.
    """

    lit: Lit
    key: Array
    strata: Division
    method: Method
    components: Components | None


class Look(NamedTuple):
    """A look at a view, or stacked ones.

    Attributes:
        view: number of the view.
        number: of the look at it.
        camera: the eye, `Camera.endless`.
        lacking: of `lattice_error`; None where nothing was solved for.
        chunks: of the view, stacked.
    """

    view: Array | np.ndarray
    number: Array | np.ndarray
    camera: Camera
    lacking: Any
    chunks: Chunk


@program
def view_intensity(shared: Shared, look: Look) -> tuple[Array, ...]:
    """Intensity of one view, its error, the share left out, `Image.contrast` [band]; by component, with errors.

    A program for views of many shapes, as are those of images.
    """
    lit, camera, key = shared.lit, look.camera, jax.random.fold_in(shared.key, look.view)
    own = key, jnp.asarray(look.number, jnp.uint32), shared.strata, shared.method, 0
    taken = Pass(aimed(lit, camera), camera, *own, components=shared.components)
    chunks = jax.tree.map(jnp.asarray, look.chunks)
    every = lax.map(lambda chunk: estimate_chunk(taken, chunk), chunks)
    found, edges = jax.tree.map(lambda value: value.reshape(-1, *value.shape[2:]), (every, chunks.edges))
    if taken.uniform:
        found = found._replace(empty=found.empty[:1])
    names = () if shared.components is None else shared.components.names
    return totals(camera.tile_area(edges), found, look.lacking, names)


def chunks_of(shared: Shared, cameras: Camera) -> Chunk:
    """Chunks of all views [view, chunk, ...]."""
    one = Pass(shared.lit, cameras, shared.key, as_number(0), shared.strata, shared.method, parts_for())
    tile = one.spread(one.parts)

    def of_view(camera: Camera) -> Chunk:
        return one._replace(camera=camera).holding(tile)

    if is_traced(cameras):
        return jax.vmap(of_view)(cameras)
    views = range(cameras.frame.shape[0])
    every = [of_view(jax.tree.map(lambda leaf, k=k: leaf[k], cameras)) for k in views]
    return jax.tree.map(lambda *own: np.stack(own), *every)
