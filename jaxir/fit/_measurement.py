"""What was measured, and from where."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxir._arrays import Check, as_float, broadcast, enforce, positive, reshaped
from jaxir.geometry import Camera, view_checks
from jaxir.optics.spectrum import Band, Nodes, as_nodes
from jaxir.scene import Lit, Scene, on_nodes, scene_nodes
from jaxir.transport import Method, graded_cameras, with_scattered


class Measurement(eqx.Module):
    """Numbers with standard deviations, and how a scene predicts them.

    Attributes:
        value: measured [row, band].
        standard_deviation: of each value [row, band].
        cameras: the views, stacked leaf by leaf [view, ...].
        nodes: spectral axis of the prediction.
        method: how the prediction finds light, as in `render`.
        samples: rays per pixel; even.
        per_pixel: whether each row is a pixel's radiance (one view) or a view's radiant intensity.
        bands: whose nodes a scene is still to choose, see `resolved`; None where they are known.
    """

    value: Float[Array, "row band"]
    standard_deviation: Float[Array, "row band"]
    cameras: Camera
    nodes: Nodes
    method: Method
    samples: int = eqx.field(static=True)
    per_pixel: bool = eqx.field(static=True)
    bands: tuple[Band, ...] | None = None

    def resolved(self, scene: Scene) -> Measurement:
        """The same on the nodes that a scene needs, where bands were given."""
        if self.bands is None:
            return self
        return dataclasses.replace(self, nodes=scene_nodes(scene, self.bands), bands=None)

    def lit(self, scene: Scene) -> Lit:
        """A scene on its nodes, with what particles scatter found once for all rays where that is solved for."""
        return with_scattered(scene.on(self.nodes), self.method, told=False)

    def checks(self) -> list[Check]:
        """Values are finite, standard deviations positive."""
        return _checks(self.value, self.standard_deviation)


def measured_intensity(
    scene: Scene,
    views: Any,
    bands: Nodes | Band | Sequence[Band],
    value: Any,
    standard_deviation: Any,
    *,
    distance: Any = np.inf,
    shape: tuple[int, int] = (64, 64),
    samples: int = 2,
    method: Method | None = None,
) -> Measurement:
    """Measured contrast intensities over aspects, as `signature` predicts them.

    Args:
        scene: whose outline the images must hold, and whose brightness says where rays are worth most.
        views: azimuth and elevation [view, 2] [deg].
        bands: bands or nodes.
        value: [view, band] [W sr-1].
        standard_deviation: of each value, of each band, or one for all [W sr-1].
        distance: from the scene to the sensor [m].
        shape: rows and columns of the images that predict.
        samples: rays per pixel; even.
        method: as `render`; `Method(orders=0)` leaves out what particles scatter, and with it its noise.

    Returns:
        The measurement.

    Raises:
        ValueError: shapes disagree, values are not finite, standard deviations not positive.
    """
    nodes = scene_nodes(scene, bands)
    aspect = as_float(views, "views")
    if aspect.ndim != 2 or aspect.shape[1] != 2 or aspect.shape[0] == 0:
        raise ValueError(f"views: got shape {aspect.shape}, expected (view, 2): azimuth and elevation in degrees")
    nodes = enforce(nodes, [*scene.checks_on(nodes), *view_checks(aspect)])
    cameras = graded_cameras(on_nodes(scene, nodes), aspect, shape, as_float(distance, "distance"))
    wanted = (aspect.shape[0], len(nodes.names))
    return _measurement(value, standard_deviation, wanted, cameras, nodes, method, samples, False)


def measured_image(
    camera: Camera,
    bands: Nodes | Band | Sequence[Band],
    value: Any,
    standard_deviation: Any,
    *,
    samples: int = 2,
    method: Method | None = None,
) -> Measurement:
    """A measured radiance image; an image of one pixel is a measured band radiance.

    Args:
        camera: the view.
        bands: bands or nodes; bands become the nodes that the scene of a fit needs, as in `render`.
        value: [row, column, band] [W m-2 sr-1].
        standard_deviation: of each value, of each band, or one for all.
        samples: rays per pixel; even.
        method: as `render`; `Method(orders=0)` leaves out what particles scatter, and with it its noise.

    Returns:
        The measurement.

    Raises:
        ValueError: as `measured_intensity`.
    """
    nodes, several = as_nodes(bands), (bands,) if isinstance(bands, Band) else bands
    wanted = (*camera.shape, len(nodes.names))
    one = jax.tree.map(lambda leaf: broadcast(leaf, (1, *leaf.shape)), camera)
    made = _measurement(value, standard_deviation, wanted, one, nodes, method, samples, True)
    return made if isinstance(several, Nodes) else dataclasses.replace(made, bands=tuple(several))


def _measurement(
    value: Any,
    deviation: Any,
    shape: tuple[int, ...],
    cameras: Camera,
    nodes: Nodes,
    method: Method | None,
    samples: int,
    per_pixel: bool,
) -> Measurement:
    numbers, spread = as_float(value, "measurement.value"), as_float(deviation, "measurement.standard_deviation")
    if numbers.shape != shape:
        raise ValueError(f"measurement.value: got shape {numbers.shape}, expected {shape}: views or pixels, then bands")
    if spread.shape not in ((), shape[-1:], shape):
        raise ValueError(
            f"measurement.standard_deviation: got shape {spread.shape}, expected one value, {shape[-1:]} or {shape}"
        )
    numbers, spread = enforce((numbers, spread), _checks(numbers, spread))  # named as they were given
    rows = (math.prod(shape[:-1]), shape[-1])
    given, deviations = (reshaped(array, rows) for array in (numbers, broadcast(spread, shape)))
    return Measurement(given, deviations, cameras, nodes, Method() if method is None else method, samples, per_pixel)


def _checks(value: Float[Array, "*row band"], deviation: Float[Array, "..."]) -> list[Check]:
    return [
        Check("measurement.value", value, jnp.isfinite(value), "finite values"),
        positive("measurement.standard_deviation", deviation),
    ]
