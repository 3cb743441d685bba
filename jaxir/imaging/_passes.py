"""A radiance image, in one pass or in as many as a tolerance asks for."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Sequence

import equinox as eqx
import jax
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Float, Key

from jaxir._arrays import as_float, is_traced, key_or_default, require
from jaxir._programs import of_items
from jaxir.geometry import Camera
from jaxir.imaging._adaptive import PILOT, adapted, even_image, looked, looks
from jaxir.imaging._choices import FEW, few_rays, rays_to_see, with_bounces
from jaxir.imaging._chunks import Pass, estimate_chunk, first_pass, parts_for, scattered_for
from jaxir.imaging._devices import shared_by
from jaxir.imaging._entry import miss_doubts
from jaxir.imaging._image import Image, Outcome, few_tell, joined
from jaxir.imaging._left_out import Asked
from jaxir.imaging._pilot import well_shaped
from jaxir.imaging._planning import plan_pass
from jaxir.imaging._quadrature import cells_error
from jaxir.imaging._tolerance import FIRST, Goal, goal_of
from jaxir.optics.spectrum import Band, Nodes
from jaxir.scene import Scene
from jaxir.transport import Method


def render(
    scene: Scene,
    camera: Camera,
    bands: Nodes | Band | Sequence[Band],
    *,
    samples: int | None = None,
    key: Key[Array, ""] | None = None,
    method: Method | None = None,
    rtol: float | None = None,
    atol: float | None = None,
    pixel_rtol: float | None = None,
    max_samples: int = 4096,
    max_seconds: float | None = None,
    devices: Mesh | None = None,
    components: str | None = None,
) -> Image:
    """Radiance image of a scene.

    Every pixel is cut into samples / 2 strata, and each stratum gets a point of each of two independent sets, whose
    points keep apart along both axes (`jaxir.geometry._pixels`). So with A and B the means over the sets

        L = (A + B) / 2,      se^2 = (A - B)^2 / 4,

    without bias: of one pixel as uncertain as one difference is, of a sum over pixels the surer the more they are.
    Where only n pixels vary, 36 / (36 + n^2) of se^2 is by the differences in strata, which tell more surely, and for a
    target in one pixel up to 1.9 times too much.
    Everything along a ray is exact, so a pixel that sees a uniform field has a standard error of 0. The variance of a
    smooth field falls as samples^-2 or faster, across a silhouette as samples^-3/2. Light from area sources and
    bounces is sampled anew, independently, at every point, so the standard error counts it.

    Args:
        scene: the scene.
        camera: the eye.
        bands: bands (one gray node each) or spectral nodes.
        samples: rays per pixel; even. By default 8, or with rtol or atol what `jaxir.plan` finds.
        key: random key; a fixed one by default, so results repeat. Where rtol or atol lets ways to find light be tried,
            their times decide, which other work may change: with a method given the numbers are always the same.
        method: how light is found; by default `Method()`, with rtol or atol alone as `jaxir.plan` finds cheapest, with
            samples beside them or pixel_rtol `Method()` of as many bounces as leave out half of it in the mean.
        rtol: keep adding passes until the standard error of the radiant intensity of every band is at most rtol times
            the intensity: passes of `samples` if given (of more where a target smaller than a pixel asks for many),
            else as `jaxir.plan` foretells, which places many rays where the error is (see `jaxir.imaging._adaptive`).
            None takes one pass. `Image.outcome` says whether it was met.
            Bands become spectral nodes that err by a tenth of it, at most by it (`optimal_nodes`); so with pixel_rtol.
        atol: the standard error of an intensity that is good enough whatever it is [W sr-1], for contrasts near 0; with
            rtol, the larger of the two counts.
        pixel_rtol: place rays where the error is until the root mean square standard
            error over the pixels that see the target is at most this share of their mean contrast to the empty image,
            in every band; with rtol or atol, both. Every pixel gets two rays of the image, and those that a pilot of
            eight, or of more where the target is smaller than a pixel, finds to vary strata of their own, and where
            these are many a scout of a quarter of them; `samples` has no meaning.
        max_samples: rays per pixel at which to give up.
        max_seconds: of the rays, at which to give up: so many are taken as fit, by the time that the first took.
            Compiling and what `jaxir.plan` tries come on top. Where it does not suffice, the same key does not give the
            same numbers again.
        devices: a mesh with the one axis `devices`, all of which share the image, in one process or, after
            `jax.distributed.initialize`, in many; every process gets the whole image. The numbers are those of one
            device; for more than 8 CPUs and fewer than 8 full chunks they are drawn anew.
        components: "sources" splits the radiance by where its light comes from (`Image.parts`): the skin's emission,
            what it and particles send on of each source and of the surroundings, each plume, the background, the air.
            "parts" splits the skin's emission by its parts, too. On the same paths, each for about an evaluation.

    Returns:
        The image. Memory beyond it is bounded by the rays of `TILES_AT_ONCE` tiles, 256 each;
        of 32 times as many on a graphics card.

    Raises:
        ValueError: wrong shapes, values out of range, an eye inside the scene, tolerances inside jit, <= 0 or beyond
            the precision in force, `samples` beside `pixel_rtol`, `max_seconds` without a tolerance.

    Differentiable, in both modes, in every radiometric leaf of the scene and in the place and shape of a jet; other
    geometry is seen as fixed.
    """
    first, goal = prepare_image(
        scene,
        camera,
        bands,
        samples=samples,
        key=key,
        method=method,
        rtol=rtol,
        atol=atol,
        pixel_rtol=pixel_rtol,
        max_samples=max_samples,
        max_seconds=max_seconds,
        components=components,
    )
    mesh = shared_by(devices, first.tiles, "tiles of 16 x 16 pixels")

    def ended(image: Image, met: bool | None, left: Float[np.ndarray, " band"] | None = None) -> Image:
        if met is not None:
            outcome = Outcome.tolerance_met if met else Outcome.samples_spent
            if met and goal is not None and leaves_out(image, goal, left, cells_error(first.lit, camera, first.method)):
                outcome = Outcome.left_out
            image = eqx.tree_at(lambda i: i.outcome, image, outcome, is_leaf=lambda x: isinstance(x, type(outcome)))
        asked = Asked(scene, first.lit.nodes, camera, first.method, None if left is None else as_float(left))
        return image if is_traced((image, asked)) else dataclasses.replace(image, asked=asked)

    parts = parts_for(1 if devices is None else devices.size)
    planned, left = samples is None and pixel_rtol is None, None
    samples = 8 if samples is None else samples
    if goal is None:
        require(miss_doubts(scene, camera, samples))
        return ended(even_image(first._replace(parts=parts), 0, samples, mesh), None)
    wanted, look = rays_to_see(first, goal), None
    few = few_rays(wanted, max_samples)
    tried = first._replace(components=None).of(few)
    if planned:
        found, look, left = plan_pass(tried, goal, method is not None)
        first = scattered_for(first, found.method)
        samples = found.samples
    elif method is None:
        followed, left = with_bounces(tried, goal)
        first = first._replace(method=followed.method)
    first = first._replace(parts=parts)
    if pixel_rtol is None and look is None:
        image, met = repeated(first, goal, samples, planned, few, mesh)
    else:
        if look is None or (look.ends(goal) and first.components is not None):  # of the answer no parts were asked
            look = looked(first, goal, few, first.noisy, mesh)
        image, met = adapted(first, goal, look, mesh)
    return ended(image, met and wanted <= max_samples, left)


def leaves_out(
    image: Image, goal: Goal, left: Float[np.ndarray, " band"] | None, cells: Float[np.ndarray, " band"]
) -> bool:
    """Whether what particles or bounces leave out of an intensity, or nodes or cells err, is more than asked."""
    intensity, contrast = (np.abs(np.asarray(x, np.float64)) for x in (image.radiant_intensity(), image.contrast()))
    shares = ((image.truncation, intensity), (left, intensity), (image.spectral, contrast))
    known = [(share, of) for share, of in shares if share is not None]
    return any(
        asked.excess(intensity, cells) > 1 or any(asked.beyond(intensity, share, of) > 1 for share, of in known)
        for asked in goal.of_intensity
    )


def repeated(
    first: Pass, goal: Goal, samples: int, planned: bool, few: int, mesh: Mesh | None = None
) -> tuple[Image, bool]:
    """An image of as many passes as a tolerance on its intensity takes, and whether that is met.

    Args:
        first: a pass of the image.
        goal: what is asked.
        samples: rays per pixel of a pass, at least: four passes hold `few`.
        planned: whether they are what a plan foretold.
        few: rays per pixel, of fewer of which a target may have been missed.
        mesh: devices that share it, of `shared_by`.
    """
    samples = max(samples, looks(few) // PILOT)
    if goal.seconds < math.inf:  # so that no pass is timed while it compiles
        taken = first.of(samples)
        jax.block_until_ready(of_items(estimate_chunk, taken.of_chunks())(taken.chunks().each()[0]))
    image, more, spent, count, worst = None, samples, 0.0, 0, np.zeros(())
    while True:
        began = time.perf_counter()
        own = jax.block_until_ready(even_image(first, count, more, mesh))
        took = time.perf_counter() - began
        spent, count = spent + took, count + 1
        worst = np.maximum(worst, np.asarray(own.intensity_error()))
        image = own if image is None else joined(image, own)
        intensity = np.asarray(image.radiant_intensity())
        excess = float(goal.tolerance.excess(intensity, np.asarray(image.intensity_error())))
        foretold = planned and not few_tell(image)
        sure = foretold or not by_luck(count, float(goal.tolerance.excess(intensity, worst)))
        met = int(image.samples) >= few and excess <= 1 and sure
        each, more = took / more, top_up(image, excess, samples) if foretold else samples
        if met or int(image.samples) + samples > goal.most or spent + each * more > goal.seconds:
            return image, met


def by_luck(count: int, worst: float) -> bool:
    """Whether a tolerance may be met because passes of equally many samples missed what is rare.

    The error that a pass tells is as uncertain as what it found, and small where it missed what is bright. So one pass
    suffices only with `FIRST` of the tolerance, and several with the error of the worst of them: stopping at the first
    small error would err by a quarter more than was asked, root mean square over keys.

    Args:
        count: of passes.
        worst: error of the worst of them over the error asked for.
    """
    return worst > FIRST if count == 1 else worst > count**0.5


def prepare_image(
    scene: Scene,
    camera: Camera,
    bands: Nodes | Band | Sequence[Band],
    *,
    samples: int | None,
    key: Key[Array, ""] | None,
    method: Method | None,
    rtol: float | None,
    atol: float | None,
    pixel_rtol: float | None,
    max_samples: int,
    max_seconds: float | None,
    components: str | None,
) -> tuple[Pass, Goal | None]:
    """Check what `render` is asked and make its first pass ready, and what errors it asks for; as there."""
    key = key_or_default(key)
    goal = goal_of(rtol, atol, pixel_rtol, max_samples, max_seconds)
    if goal is not None and is_traced((scene, camera, key, method)):
        names = [name for name, asked in (("rtol", rtol), ("atol", atol), ("pixel_rtol", pixel_rtol)) if asked]
        said = f"a call outside it, or {', '.join(f'{name}=None' for name in names)}"
        raise ValueError(f"{', '.join(names)}: got traced values (inside jit, grad or vmap), expected {said}")
    if pixel_rtol is not None and samples is not None:
        raise ValueError(f"samples: got {samples} beside pixel_rtol, expected None: pixels get what they need")
    least = samples if samples is not None else 8 if goal is None else FEW
    if goal is not None and max_samples < least:
        raise ValueError(f"max_samples: got {max_samples}, expected at least samples = {least}")
    method, relative = Method() if method is None else method, None if goal is None else goal.relative
    return first_pass(scene, camera, bands, key, least, method, components, relative), goal


def top_up(image: Image, excess: float, most: int) -> int:
    """Rays per pixel that an image lacks to meet a tolerance, at most `most`: its variance falls as theirs grow."""
    wanted = min((excess**2 - 1) * int(image.samples) * 1.1, most)
    return next((count for count in well_shaped(most) if count >= wanted), well_shaped(most)[-1])
