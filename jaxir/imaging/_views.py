"""Radiant intensity over aspects."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.sharding import Mesh
from jaxtyping import Array, Bool, Float, Int, Key

from jaxir._arrays import as_float, enforce, is_traced, key_or_default, on_host, placed, require
from jaxir.geometry import Camera, in_front, pixel_strata, view_checks
from jaxir.imaging._budget import ErrorBudget, budget
from jaxir.imaging._chunks import eye_outside
from jaxir.imaging._devices import shared_by, stacked
from jaxir.imaging._division import division
from jaxir.imaging._entry import path_doubts, require_parts
from jaxir.imaging._left_out import Asked
from jaxir.imaging._look import Look, Shared, chunks_of, view_intensity
from jaxir.imaging._planning import way_for_views
from jaxir.imaging._quadrature import beams_in_cells
from jaxir.imaging._repeated import Repeats, repeats, until_met
from jaxir.imaging._tolerance import tolerance_of
from jaxir.optics.spectrum import Band, Nodes, as_nodes
from jaxir.scene import Lit, Scene, nodes_within, on_nodes
from jaxir.transport import (
    Method,
    components_of,
    graded_cameras,
    lattice_error,
    lattice_lacks,
    solution_checks,
    with_own_media,
    with_scattered,
)

# Names that tables have, so that no axis of `Signature.axes` may bear them.
_COLUMNS = ("view", "azimuth", "elevation", "band", "component", "intensity", "standard_error")


def is_column(name: str) -> bool:
    """Whether tables or their files have a column of that name."""
    return name.removesuffix("_deg") in _COLUMNS or name.endswith("_W_per_sr")


class Signature(eqx.Module):
    """Radiant intensity over aspects.

    Attributes:
        azimuth: of each view [view] [deg].
        elevation: of each view [view] [deg].
        intensity: contrast intensity, see `Image.radiant_intensity` [view, band] [W sr-1].
        standard_error: of `intensity` [view, band] [W sr-1].
        bands: band names.
        truncation: estimated share of `intensity` that is left out of what particles scatter, see `Image.truncation`
            [view, band].
        spectral: what the spectral nodes err, as a share of `contrast` [band], or [view, band] of several states;
            None where they were given.
        asked: what it is the signature of, for `error_budget`; None where values were known only inside jit, and of
            several states.
        components: names of what `parts` holds, where `signature` was asked for components.
        parts: the intensities by where their light comes from, see `Image.component_intensity`
            [view, component, band] [W sr-1]; they add up to `intensity`.
        parts_error: standard error of `parts`, see `Image.component_error`.
        axes: names of what else varies from row to row than the aspect, see `jaxir.io.result.sweep`.
        state: its values [view, axis].
        contrast: of which `spectral` is a share, see `Image.contrast` [view, band] [W sr-1]; None for the intensity's.
    """

    azimuth: Float[Array, " view"]
    elevation: Float[Array, " view"]
    intensity: Float[Array, "view band"]
    standard_error: Float[Array, "view band"]
    bands: tuple[str, ...] = eqx.field(static=True)
    truncation: Float[Array, "view band"]
    spectral: Float[Array, "*each band"] | None = None
    asked: Asked | None = None
    components: tuple[str, ...] = eqx.field(static=True, default=())
    parts: Float[Array, "view component band"] | None = None
    parts_error: Float[Array, "view component band"] | None = None
    axes: tuple[str, ...] = eqx.field(static=True, default=())
    state: Float[Array, "view axis"] | None = None
    contrast: Float[Array, "view band"] | None = None

    def error_budget(self, look: bool = True) -> ErrorBudget:
        """The intensities with all that is known of their errors, see `Image.error_budget`.

        Every view holds the whole scene.
        """
        contrast = jnp.abs(self.intensity) if self.contrast is None else self.contrast
        own = self.intensity, self.standard_error, contrast, self.spectral, self.truncation
        return budget(*own, self.bands, self.asked, look)

    def meets(self, rtol: float | None = None, atol: float | None = None) -> Bool[np.ndarray, " view"]:
        """Whether every band of a view is within a tolerance, as `jaxir.signature` means it.

        The standard error, what is left out of what particles scatter, what the nodes err, and what sunlit cells err,
        where `asked` tells of them, each for itself.
        """
        asked = tolerance_of(rtol, atol)
        if asked is None:
            return np.ones(len(self.azimuth), bool)
        intensity = np.abs(np.asarray(self.intensity, np.float64))
        sampled = asked.excess(intensity, np.asarray(self.standard_error))
        contrast = None if self.contrast is None else np.asarray(self.contrast, np.float64)
        by_nodes = asked.beyond(intensity, 0.0 if self.spectral is None else self.spectral, contrast)
        each = [sampled, by_nodes, asked.beyond(intensity, self.truncation)]
        if self.asked is not None and beams_in_cells(self.asked.scene, self.asked.method):
            each.append(asked.excess(intensity, np.asarray(self.asked.quadrature(True), np.float64)))
        return np.maximum.reduce(each) <= 1


class Views(NamedTuple):
    """What is seen from where, ready to be computed view by view.

    Attributes:
        shared: what looks at views have in common.
        cameras: of all views [view].
        aspect: azimuth and elevation [view, 2] [deg].
        left: share that bounces leave out [band], where the method was chosen, else None.
        lacking: of `lattice_error` [view, band]; None where nothing was solved for.
    """

    shared: Shared
    cameras: Camera
    aspect: Array
    left: Array | None
    lacking: Array | None


def signature(
    scene: Scene,
    views: Any,
    bands: Nodes | Band | Sequence[Band],
    *,
    distance: Any = np.inf,
    shape: tuple[int, int] = (128, 128),
    samples: int = 2,
    key: Key[Array, ""] | None = None,
    method: Method | None = None,
    rtol: float | None = None,
    atol: float | None = None,
    max_samples: int = 4096,
    max_seconds: float | None = None,
    devices: Mesh | None = None,
    components: str | None = None,
) -> Signature:
    """Radiant intensity of a scene over aspects, all of them under one compilation.

    Every view is an image that just holds the scene's outline, with its rows and columns close together where the
    scene is bright (`jaxir.geometry.graded`), so the accuracy is that of the raster whatever the aspect; more rows and
    columns buy more than more samples.

    Args:
        scene: the scene.
        views: azimuth and elevation of each view [view, 2] [deg].
        bands: bands or nodes.
        distance: from the scene to the sensor [m]; infinite by default.
        shape: rows and columns of the images.
        samples: rays per pixel; even.
        key: random key.
        method: how light is found; by default `Method()`, or with rtol or atol as `jaxir.plan` finds cheapest for
            `VIEWED` of the views, spread evenly, by times that other work may change.
        rtol: standard error of every band's intensity at most, as a share of it, in every view. A first look of
            `samples` decides how many more a view takes (see `jaxir.imaging._repeated`); where it errs by less than a
            third of what is asked it is the answer, else it is no part of it. Bands become spectral nodes that err by
            a tenth of it, at most by it (`optimal_nodes`). `Signature.meets` says which views kept to it. None takes
            one look.
        atol: the standard error that is good enough whatever the intensity [W sr-1], for contrasts near 0; with rtol,
            the larger of the two counts.
        max_samples: rays per pixel of a view at which to give up.
        max_seconds: of all looks together at which to give up, without compiling and what is tried before; one look at
            each view is taken in any case. Where it does not suffice, the same key does not give the same numbers
            again.
        devices: as `render`; views are shared out.
        components: as `render`, for `Signature.parts`.

    Returns:
        The table.

    Raises:
        ValueError: as `render`; `views` of another shape; more devices than views.

    Differentiable as `render`.
    """
    until = repeats(rtol, atol, samples, max_samples, max_seconds)
    asked = prepare_views(
        scene,
        views,
        bands,
        distance=distance,
        shape=shape,
        samples=samples,
        key=key,
        method=method,
        until=until,
        components=components,
    )
    index = np.arange(asked.aspect.shape[0], dtype=np.int32)
    mesh = shared_by(devices, index.size, "views")
    if is_traced(asked):
        own = jax.vmap(Camera.endless)(asked.cameras), asked.lacking, chunks_of(asked.shared, asked.cameras)
        looks = Look(placed(index), placed(np.zeros(index.size, np.int32)), *own)
        return whole_table(asked, stacked(view_intensity, asked.shared, looks, "signature", mesh))
    found: list[Any] = [None] * index.size
    for view, values in each_view(asked, index, until, "signature", mesh):
        found[view] = values
    every = tuple(placed(np.stack(part)) for part in zip(*found, strict=True))
    return remembering(whole_table(asked, every), scene, asked)


def each_view(
    views: Views, index: Int[np.ndarray, " some"], until: Repeats | None, label: str, devices: Mesh | None
) -> Iterator[tuple[int, list[np.ndarray]]]:
    """Views and what `view_intensity` finds of them, each as it is ready.

    Args:
        views: all of them.
        index: of those to look at.
        until: what is asked of each; None for one look.
        label: of the progress bar.
        devices: of `shared_by`; None for one.
    """
    eyes, cameras = jax.vmap(Camera.endless)(views.cameras), jax.tree.map(np.asarray, views.cameras)
    seen = *jax.tree.map(np.asarray, (eyes, views.lacking)), chunks_of(views.shared, cameras)

    def looks_at(view: Int[np.ndarray, " look"], number: Int[np.ndarray, " look"]) -> Look:
        return Look(view, number, *jax.tree.map(lambda leaf: leaf[view], seen))

    return until_met(view_intensity, views.shared, index, looks_at, until, label, devices)


def remembering(table: Signature, scene: Scene, views: Views) -> Signature:
    """The table with what it was asked of, where all of it is known."""
    asked = Asked(scene, views.shared.lit.nodes, views.cameras, views.shared.method, views.left)
    return table if is_traced((table, asked)) else dataclasses.replace(table, asked=asked)


def whole_table(views: Views, found: tuple[Array, ...]) -> Signature:
    """The table of what `view_intensity` found in all views."""
    intensity, error, truncation, contrast, *parts = found
    _, aspect = on_host(views.aspect)
    azimuth, elevation = (placed(angle) for angle in aspect.T)
    shared, nodes = views.shared, views.shared.lit.nodes
    names = () if shared.components is None else shared.components.names
    own = nodes.names, truncation, nodes.error, None, names, *(parts or (None, None))
    return Signature(azimuth, elevation, intensity, error, *own, contrast=contrast)


def prepare_views(
    scene: Scene,
    views: Any,
    bands: Nodes | Band | Sequence[Band],
    *,
    distance: Any,
    shape: tuple[int, int],
    samples: int,
    key: Key[Array, ""] | None,
    method: Method | None,
    until: Repeats | None,
    components: str | None = None,
) -> Views:
    """Check what `signature` is asked and make it ready; arguments and errors as there."""
    if until is not None and is_traced((scene, views, distance, key, method)):
        raise ValueError(
            "rtol, atol: got traced values (inside jit, grad or vmap), expected a call outside it, or neither of them"
        )
    given, left = Method() if method is None else method, None
    nodes = nodes_within(scene, bands, None if until is None else until.tolerance.rtol)
    aspect, nodes, away = _checked(scene, views, nodes, distance, given)
    lit = on_nodes(scene, nodes)
    cameras = graded_cameras(lit, aspect, shape, away)
    lit = enforce(lit, [*cameras.checks(), *eye_outside(scene, 1 / on_host(away)[1])])
    key = key_or_default(key)
    if method is None and until is not None:
        given, found = way_for_views(lit, cameras, key, until.goal(samples))
        left = as_float(found)
    method = given.resolved(scene)
    bare, lacking = lit, None
    lit = with_scattered(bare, method)
    if lit is not bare:
        lit = enforce(lit, solution_checks(lit))
        held, eyes = lax.stop_gradient((lit, cameras))  # an error has no derivative
        lacks = stacked(lattice_lacks, held.in_vacuum(), jax.vmap(Camera.undivided)(eyes), "lattice")
        lacking = lattice_error(held, lacks)
    split = with_own_media(scene, nodes, method, components_of(scene, method, components))
    strata = division(samples, not is_traced((lit, cameras, key)))
    return Views(Shared(lit, key, strata, method, split), cameras, aspect, left, lacking)


def check_views(
    scene: Scene,
    views: Any,
    bands: Nodes | Band | Sequence[Band],
    *,
    distance: Any,
    shape: tuple[int, int],
    samples: int,
    method: Method | None,
    rtol: float | None,
    atol: float | None,
    max_samples: int,
    max_seconds: float | None,
    components: str | None,
) -> None:
    """Raise what `signature` would, before anything is computed; arguments and errors as there."""
    repeats(rtol, atol, samples, max_samples, max_seconds)
    aspect, nodes, away = _checked(scene, views, bands, distance, Method() if method is None else method)
    pixel_strata(samples)
    resolved = (Method() if method is None else method).resolved(scene)
    components_of(scene, resolved, components)

    def ready(*asked: Any) -> Lit:
        return with_scattered(on_nodes(*asked), resolved)

    eqx.filter_eval_shape(ready, scene, nodes)  # parts that do not suit the nodes
    enforce(nodes, eye_outside(scene, 1 / on_host(away)[1]))


def _checked(
    scene: Scene, views: Any, bands: Nodes | Band | Sequence[Band], distance: Any, method: Method
) -> tuple[Array, Nodes, Array]:
    """Aspects, nodes and the distance, once all values are in range."""
    require_parts(scene, method)
    aspect, nodes = as_float(views, "views"), as_nodes(bands)  # range checks need no more
    if aspect.ndim != 2 or aspect.shape[1] != 2 or aspect.shape[0] == 0:
        raise ValueError(f"views: got shape {aspect.shape}, expected (view, 2): azimuth and elevation in degrees")
    checks = [*scene.checks_on(nodes), *view_checks(aspect), *method.checks_for(scene), *method.node_checks(nodes)]
    away = as_float(distance, "distance")
    require([in_front("distance", away)])
    return aspect, enforce(nodes, [*checks, *path_doubts(scene, 1 / on_host(away)[1])]), away
