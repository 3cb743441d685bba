"""A radiance image, in one pass or in as many as a tolerance asks for."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Key

from jaxir._arrays import is_traced, key_or_default
from jaxir.geometry import Camera
from jaxir.imaging._adaptive import PILOT, Goal, adapted, even_image, looked
from jaxir.imaging._choices import FEW, few_rays, rays_to_see
from jaxir.imaging._chunks import PARTS, Pass, first_pass
from jaxir.imaging._devices import shared_by
from jaxir.imaging._image import Image, Outcome, few_tell, joined, meets
from jaxir.imaging._left_out import Asked
from jaxir.imaging._pilot import well_shaped
from jaxir.imaging._planning import plan_pass
from jaxir.imaging._repeated import require_rtol
from jaxir.optics.spectrum import Band, Nodes
from jaxir.scene import Scene
from jaxir.transport import Method, with_scattered


def render(
    scene: Scene,
    camera: Camera,
    bands: Nodes | Band | Sequence[Band],
    *,
    samples: int | None = None,
    key: Key[Array, ""] | None = None,
    method: Method | None = None,
    rtol: float | None = None,
    pixel_rtol: float | None = None,
    max_samples: int = 4096,
    devices: Mesh | None = None,
    components: str | None = None,
) -> Image:
    """Radiance image of a scene.

    Every pixel is cut into samples / 2 strata, and each stratum gets a point of each of two independent sets, whose
    points keep apart along both axes (`jaxir.geometry._pixels`). So with A and B the means over the sets

        L = (A + B) / 2,      se^2 = (A - B)^2 / 4,

    without bias: of one pixel as uncertain as one difference is, of a sum over pixels the surer the more they are.
    Everything along a ray is exact, so a pixel that sees a uniform field has a standard error of 0. The variance of a
    smooth field falls as samples^-2 or faster, across a silhouette as samples^-3/2. Light from area sources and
    bounces is sampled anew, independently, at every point, so the standard error counts it.

    Args:
        scene: the scene.
        camera: the eye.
        bands: bands (one gray node each) or spectral nodes.
        samples: rays per pixel; even. By default 8, or with rtol what `jaxir.plan` finds.
        key: random key; a fixed one by default, so results repeat.
        method: how light is found; by default `Method()`, or with rtol alone as `jaxir.plan` finds cheapest.
        rtol: keep adding passes until the standard error of the radiant intensity of every band is at most rtol times
            the intensity: passes of `samples` if given, else as `jaxir.plan` foretells, which places many rays where
            the error is (see `jaxir.imaging._adaptive`). None takes one pass. `Image.outcome` says whether it was met.
        pixel_rtol: place rays where the error is until the root mean square standard
            error over the pixels that see the target is at most this share of their mean contrast to the empty image,
            in every band; with rtol, both. Every pixel gets two rays of the image, and those that a pilot of eight,
            or of more where the target is smaller than a pixel, finds to vary strata of their own, so `samples` has no
            meaning.
        max_samples: rays per pixel at which to give up.
        devices: a mesh with the one axis `devices`, all of which share the image, in one process or, after
            `jax.distributed.initialize`, in many; every process gets the whole image. The numbers are those of one
            device; for more than `PARTS` = 8 devices and fewer than 8 full chunks they are drawn anew.
        components: "sources" splits the radiance by where its light comes from (`Image.parts`): the skin's emission,
            what it and particles send on of each source and of the surroundings, each plume, the background, the air.
            "parts" splits the skin's emission by its parts, too. On the same paths, each for about an evaluation.

    Returns:
        The image. Memory beyond it is bounded by the rays of `TILES_AT_ONCE` tiles, 256 each.

    Raises:
        ValueError: wrong shapes, values out of range, an eye inside the scene, tolerances inside jit, <= 0 or beyond
            the precision in force, `samples` beside `pixel_rtol`.

    Differentiable, in both modes, in every radiometric leaf of the scene and in the place and shape of a jet; other
    geometry is seen as fixed.
    """
    first = prepare_image(
        scene,
        camera,
        bands,
        samples=samples,
        key=key,
        method=method,
        rtol=rtol,
        pixel_rtol=pixel_rtol,
        max_samples=max_samples,
        components=components,
    )
    mesh = shared_by(devices, first.tiles, "tiles of 16 x 16 pixels")
    goal, look = Goal(rtol, pixel_rtol), None
    planned = samples is None and rtol is not None and pixel_rtol is None
    samples = 8 if samples is None else samples
    wanted = 0.0 if rtol is None and pixel_rtol is None else rays_to_see(first)
    few = few_rays(wanted, max_samples)
    if planned and rtol is not None:
        found, look = plan_pass(first._replace(components=None).of(few), rtol, max_samples, method is not None)
        first = first._replace(method=found.method, lit=with_scattered(first.lit, found.method))
        samples = found.samples
    first = first._replace(parts=PARTS if devices is None else max(PARTS, devices.size))

    def ended(image: Image, met: bool | None) -> Image:
        if met is not None:
            outcome = Outcome.tolerance_met if met else Outcome.samples_spent
            image = eqx.tree_at(lambda i: i.outcome, image, outcome, is_leaf=lambda x: isinstance(x, type(outcome)))
        asked = Asked(scene, first.lit.nodes, camera, first.method)
        return image if is_traced((image, asked)) else dataclasses.replace(image, asked=asked)

    if pixel_rtol is not None or look is not None:
        if look is None or (look.met and first.components is not None):  # the answer, of which no parts were asked
            look = looked(first, goal, mesh, well_shaped(few // PILOT)[-1])
        image, met = adapted(first, goal, look, max_samples, mesh)
        return ended(image, met and wanted <= max_samples)
    image = even_image(first, 0, samples, mesh, alone=rtol is None)
    if rtol is None:
        return ended(image, None)
    passes = [image]

    def foretold(image: Image) -> bool:
        return planned and not few_tell(image)

    def enough() -> bool:
        seen = wanted <= max_samples and int(image.samples) >= few  # what is smaller than a pixel may have been missed
        return seen and meets(image, rtol) and (foretold(image) or not by_luck(passes, image, rtol))

    while not enough() and int(image.samples) + samples <= max_samples:
        more = top_up(image, rtol, samples) if foretold(image) else samples
        passes.append(even_image(first, len(passes), more, mesh))
        image = joined(image, passes[-1])
    return ended(image, enough())


def by_luck(passes: list[Image], image: Image, rtol: float) -> bool:
    """Whether a tolerance may be met because passes of equally many samples missed what is rare.

    The error that a pass tells is as uncertain as what it found, and small where it missed what is bright. So one pass
    suffices only with a third of the tolerance, and several with the error of the worst of them: stopping at the first
    small error would err by a quarter more than was asked, root mean square over keys.
    """
    worst = np.max([np.asarray(one.intensity_error()) for one in passes], axis=0)
    error = 3 * worst if len(passes) == 1 else worst / len(passes) ** 0.5
    return bool((error > rtol * np.abs(np.asarray(image.radiant_intensity()))).any())


def prepare_image(
    scene: Scene,
    camera: Camera,
    bands: Nodes | Band | Sequence[Band],
    *,
    samples: int | None,
    key: Key[Array, ""] | None,
    method: Method | None,
    rtol: float | None,
    pixel_rtol: float | None,
    max_samples: int,
    components: str | None,
) -> Pass:
    """Check what `render` is asked and make its first pass ready; arguments and errors as there."""
    key = key_or_default(key)
    for name, tolerance in (("rtol", rtol), ("pixel_rtol", pixel_rtol)):
        if tolerance is None:
            continue
        if is_traced((scene, camera, key, method)):
            raise ValueError(f"{name}: got values known only inside jit, expected a call outside it, or {name}=None")
        require_rtol(tolerance, name)
    if pixel_rtol is not None and samples is not None:
        raise ValueError(f"samples: got {samples} beside pixel_rtol, expected None: pixels get what they need")
    least = samples if samples is not None else 8 if rtol is None and pixel_rtol is None else FEW
    if max_samples < least:
        raise ValueError(f"max_samples: got {max_samples}, expected at least samples = {least}")
    return first_pass(scene, camera, bands, key, least, Method() if method is None else method, components)


def top_up(image: Image, rtol: float, most: int) -> int:
    """Rays per pixel that an image lacks to meet a tolerance, at most `most`: its variance falls as theirs grow."""
    error, intensity = np.asarray(image.intensity_error()), np.abs(np.asarray(image.radiant_intensity()))
    short = np.max(np.divide(error, rtol * intensity, out=np.full_like(error, np.inf), where=intensity > 0))
    wanted = min((short**2 - 1) * int(image.samples) * 1.1, most)
    return next((count for count in well_shaped(most) if count >= wanted), well_shaped(most)[-1])
