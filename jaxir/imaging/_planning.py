"""Accuracy in, method out: what each term of a scene is computed by, and what that will cost."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from jaxir._arrays import as_float, float_dtype, is_traced, key_or_default, placed
from jaxir._programs import program
from jaxir.geometry import Camera
from jaxir.imaging._adaptive import Look, seconds_of
from jaxir.imaging._choices import (
    FEW,
    Choice,
    Trial,
    best_way,
    by_few_orders,
    few_rays,
    rays_to_see,
    suffices,
    with_bounces,
    with_skin_light,
)
from jaxir.imaging._chunks import Pass, as_number, first_pass, parts_for
from jaxir.imaging._division import division
from jaxir.imaging._left_out import further, left_out, lights_its_skin
from jaxir.imaging._tolerance import Goal, Tolerance, goal_of
from jaxir.optics.spectrum import Band, Nodes
from jaxir.scene import Lit, Scene
from jaxir.transport import ClosedForm, Method

VIEWED = 5  # views that decide how light is found in all of a signature
CALLS = 3  # that are timed: other work may disturb one


class Term(NamedTuple):
    """One part of the transport.

    Attributes:
        name: what it is.
        exact: whether nothing in it is sampled.
        sentence: how it is computed, and why so.
    """

    name: str
    exact: bool
    sentence: str


class Plan(NamedTuple):
    """How an image will be computed.

    Attributes:
        terms: of the transport, in the order in which light meets them on its way back from the eye.
        method: what `render` is to take.
        samples: rays per pixel, in the mean where `render(rtol=)` places them where pixels vary.
        seconds: predicted, of a call of `render` with this method and so many rays on the device in force; compiling,
            and solving for the light in plumes, come on top.
        compile_seconds: what compiling the chosen method's pilot took, and solving for the light in plumes, once.
        tolerance: asked.
        expected: predicted standard error over intensity, of the worst band.
        truncation: estimated share of the intensity that is left out of what particles scatter, or that sunlit cells
            err as they are lit as their centres, of the worst band.
        bounces: and of what skin reflects more often than the method's `bounces`; None where a method was given.
    """

    terms: tuple[Term, ...]
    method: Method
    samples: int
    seconds: float
    compile_seconds: float
    tolerance: Tolerance
    expected: float
    truncation: float
    bounces: float | None

    def __str__(self) -> str:
        """One sentence per term."""
        return "\n".join(f"{term.name}: {term.sentence}." for term in self.terms)


def plan(
    scene: Scene,
    camera: Camera,
    bands: Nodes | Band | Sequence[Band],
    rtol: float | None = None,
    *,
    atol: float | None = None,
    key: Key[Array, ""] | None = None,
    method: Method | None = None,
    max_samples: int = 4096,
    max_seconds: float | None = None,
) -> Plan:
    """How to meet a tolerance on the intensity of every band, and at what cost, before an image is computed.

    Bands become spectral nodes that err by a tenth of `rtol`, at most by it (`optimal_nodes`). What has no variance is
    chosen without trial: the exact sum over cells, delta sources. For reflected light, by a closed form where its
    conditions hold or sampled, every candidate computes a few chunks of the image; variance as it falls with the rays
    (`ErrorLaw`), and time, as it grows with them, decide. So for light that particles scatter, sampled up to few or
    more orders or solved on a coarse or finer lattice: among those that leave out, and err in sunlit cells, less than
    the error asked for, if there are any. Where skin may meet the light of skin or plumes, few paths are followed
    further first, and bounces are the fewest beyond which they bring at most half of what is asked. Where less than a
    thousandth of the skin sends most of its light, skin and particles look for it (`SkinLight`). Where the rays or
    seconds allowed suffice by no way it is that of least error.

    Args:
        scene: the scene.
        camera: the eye.
        bands: bands or nodes.
        rtol: standard error of the radiant intensity of every band over the intensity.
        atol: the standard error that is good enough whatever the intensity [W sr-1]; with rtol, the larger of the two.
        key: random key of the pilots.
        method: kept if given; else its `bounces` are chosen, its `direct` and `sampler`, where the scene has sources
            with an extent, or else, where it has particles, `orders` or `scattering`.
        max_samples: rays per pixel that must suffice.
        max_seconds: of the image without compiling, that must suffice.

    Returns:
        The plan; `print` it.

    Raises:
        ValueError: as `jaxir.render`; no tolerance, or one <= 0 or beyond the precision in force, with the precision
            it needs.
    """
    goal = goal_of(rtol, atol, None, max_samples, max_seconds)
    if goal is None:
        raise ValueError("rtol: got None, expected rtol or atol")
    if is_traced((scene, camera, key, method)):
        raise ValueError("plan: got traced values (inside jit, grad or vmap), expected a call outside it")
    key = key_or_default(key)
    given = Method() if method is None else method
    first = first_pass(scene, camera, bands, key, FEW, given, rtol=rtol)
    few = few_rays(rays_to_see(first, goal), max_samples)
    times = []
    for _ in range(CALLS):  # once more, now that all of it is compiled
        began = time.perf_counter()
        first_pass(scene, camera, bands, key, FEW, Method(), rtol=rtol)
        times.append(time.perf_counter() - began)
    call = min(times)
    goal = goal._replace(seconds=max(goal.seconds - call, 0.0))
    return plan_pass(first.of(few), goal, method is not None, call)[0]


def plan_pass(
    first: Pass, goal: Goal, asked: bool, call: float | None = None
) -> tuple[Plan, Look | None, Float[np.ndarray, " band"] | None]:
    """`plan` for a pass of `few_rays` that was checked, what tells where its rays go, if not everywhere, and `left`.

    That is the share that bounces leave out [band]; None where the method was asked for.

    Args:
        first: the pass.
        goal: what is asked of the intensity.
        asked: whether the method is not to be chosen.
        call: seconds that a call takes before its first ray; None where nobody asks for seconds.
    """
    scene, tolerance = first.lit.scene, goal.tolerance
    first, left = (first, None) if asked else with_bounces(first, goal)
    most = None if left is None else float(left.max())
    trials, chosen, look = best_way(first, goal, asked)
    trial = chosen.trial
    if call is not None:
        rays = chosen.seconds if look is None else look.seconds + seconds_of(trial.first, goal, look)
        chosen = chosen._replace(seconds=rays + call)
    terms = (
        *_spectrum(first.lit.nodes),
        *_along_the_ray(first.lit, first.camera),
        *_by_particles(scene, trials, chosen),
        *_at_the_skin(scene, trials, chosen, asked),
        *_between_skin(trial.method, most),
        *_beyond(scene),
        _pixels(chosen, tolerance, look),
    )
    ready = trial.pilot.compile_seconds + trial.solving
    cost = chosen.samples, chosen.seconds, ready
    return Plan(terms, trial.method, *cost, tolerance, chosen.expected, trial.truncation, most), look, left


def way_for_views(
    lit: Lit, cameras: Camera, key: Key[Array, ""], goal: Goal
) -> tuple[Method, Float[np.ndarray, " band"]]:
    """How light is found in all views of a signature, as the most demanding of some asks for.

    Of `VIEWED`, spread evenly, and in each band of that in which bounces bring most. And the largest share of their
    intensities that bounces leave out [band].

    Args:
        lit: the scene on the nodes.
        cameras: [view].
        key: random key of the pilots.
        goal: what is asked of each view.
    """
    scene, bounces, left = lit.scene, 0, np.zeros(lit.nodes.response.shape[0])
    several, lit_by_skin = bool(scene.area_sources) or scene.scatters, lights_its_skin(scene)
    if not (several or lit_by_skin):
        return Method(), left
    method = Method().resolved(scene)
    chosen: Choice | None = None
    count = cameras.frame.shape[0]
    looked_at = np.linspace(0, count - 1, VIEWED).round().astype(np.int32)
    if lit_by_skin and count > VIEWED:
        method = with_skin_light(lit, method)
        brought = np.asarray(left_out(lit, cameras, further(by_few_orders(method))))[:, 0]
        looked_at = np.concatenate([looked_at, np.argmax(brought, axis=0).astype(np.int32)])
    for view in np.unique(looked_at):
        camera = jax.tree.map(lambda leaf, view=view: placed(np.asarray(leaf)[view]), cameras)
        first = Pass(lit, camera, key, as_number(0), division(FEW, True), method, parts_for())
        first, own = with_bounces(first, goal)
        bounces, left = max(bounces, first.method.bounces), np.maximum(left, own)
        if several and (chosen is None or (scene.scatters and not suffices(chosen, first, goal))):
            chosen = best_way(first, goal, False, count)[1]
    method = first.method if chosen is None else chosen.trial.method
    return dataclasses.replace(method, bounces=bounces), left


def _spectrum(nodes: Nodes) -> list[Term]:
    if nodes.error is None:
        return []
    count = int((np.asarray(nodes.weight) > 0).sum())
    sentence = f"{count} nodes, chosen for this scene, which err by at most {float(np.max(nodes.error)):.2g}"
    return [Term("Spectrum", True, sentence)]


def _along_the_ray(lit: Lit, camera: Camera) -> list[Term]:
    if lit.medium is None:
        return []
    each = ", ".join(plume.described() for plume in lit.scene.plumes)
    depth = float(_depth(lit, camera.undivided()))
    sentence = f"{each}: integrated along every ray, no sampling; the largest optical depth is {depth:.2g}"
    return [Term("Plume", True, sentence)]


def _by_particles(scene: Scene, trials: list[Trial], chosen: Choice) -> list[Term]:
    if not scene.scatters:
        return []
    once = "parallel light scattered once is summed over the cells, " if scene.summed_beams else ""
    method, left = chosen.trial.method, f"lacks about {chosen.trial.truncation:.2g} of the intensity"
    others = "; ".join(f"{_way(t.method)} would lack {t.truncation:.2g}" for t in trials if t is not chosen.trial)
    others = others and f" ({others})"
    if method.scattering is not None:
        exact = method.scattering.orders == 0
        return [Term("Particles", exact, f"light scattered however often, by {_way(method)}, which {left}{others}")]
    if method.orders == 0:
        return [Term("Particles", True, f"{once}light scattered more often is left out, as asked")]
    return [Term("Particles", False, f"{once}the rest by {_way(method)}, which {left}{others}")]


def _way(method: Method) -> str:
    """How what particles scatter is found."""
    if method.scattering is None:
        return f"forced collision up to {method.orders} times"
    lattice, orders = f"a lattice of {method.scattering.along} x {method.scattering.across} points", method.orders
    return f"{lattice}, what it errs sampled up to {orders} times" if orders else f"{lattice}, without samples"


@program
def _depth(lit: Lit, camera: Camera) -> Array:
    """The largest optical depth on a raster of 16 x 16 rays across the image."""
    assert lit.medium is not None
    place = (np.arange(16) + 0.5) / 8 - 1
    screen = as_float(np.stack(np.meshgrid(place, place), axis=-1).reshape(-1, 2)) * camera.half_size()[None]
    rays = camera.bundle(screen, lit.scene.start(camera)).rays()
    passed = lit.medium.transmittance(rays, jnp.full(rays.count, jnp.inf, screen.dtype))
    return -jnp.log(jnp.maximum(jnp.min(passed), jnp.finfo(passed.dtype).tiny))


def _at_the_skin(scene: Scene, trials: list[Trial], chosen: Choice, asked: bool) -> list[Term]:
    if scene.skin is None:
        return []
    terms = [
        Term("Emission", True, f"Planck's and Kirchhoff's laws at every point met of {scene.skin.mesh.count} faces")
    ]
    if scene.delta_sources:
        sentence = f"{len(scene.delta_sources)} without extent, each evaluated with its shadow at every point met"
        terms.append(Term("Sources", True, sentence))
    method = chosen.trial.method.resolved(scene)
    if method.direct is None:
        return terms
    name = _name(method)
    exact = isinstance(method.direct, ClosedForm)
    if asked or len(trials) == 1:
        sentence = f"by {name}, as {'asked' if asked else 'by default'}"
    elif exact:
        sentence = f"by {name}, whose conditions hold: no samples and no variance of its own"
    else:
        others = [t for t in trials if t is not chosen.trial]
        sentence = f"sampled by {name}, the cheapest of {len(trials)} in pilots: " + ", ".join(
            f"{_efficiency(chosen.trial, other):.2g} times the time of {_name(other.method)}" for other in others
        )
    return [*terms, Term("Reflected light", exact, sentence)]


def _between_skin(method: Method, left: float | None) -> list[Term]:
    """Light that goes from skin to skin, where it may."""
    if not left and method.bounces == 0:
        return []
    more = "" if left is None else f", and more of them would add about {left:.2g} of the intensity"
    return [Term("Bounces", method.bounces == 0, f"paths go on from skin {method.bounces} times{more}")]


def _name(method: Method) -> str:
    counts = ", ".join(f"{n} of {what}" for n, what in zip(method.counts, ("each light", "the brdf"), strict=True) if n)
    samples = f"({counts}) with {type(method.sampler).__name__} points" if counts else ""
    return f"{type(method.direct).__name__}{samples}"


def _efficiency(one: Trial, other: Trial) -> float:
    """Time of one to equal variance, in that of the other; of the worst band, by their pilots."""
    ratio = one.pilot.variance / np.maximum(other.pilot.variance, np.finfo(float).tiny)
    return float(np.max(ratio)) * one.pilot.seconds / other.pilot.seconds


def _beyond(scene: Scene) -> list[Term]:
    terms = []
    if scene.background is not None:
        terms.append(Term("Background", True, "its radiance in the direction of every ray that meets no skin"))
    if scene.atmosphere is not None:
        terms.append(Term("Air", True, "one transmittance and one path radiance of each node for the whole image"))
    return terms


def _pixels(chosen: Choice, tolerance: Tolerance, look: Look | None) -> Term:
    short = chosen.excess > 1
    rays = f"{chosen.samples} rays each, two in each of {chosen.samples // 2} strata"
    if look is not None:
        rays = f"{chosen.samples} rays each in the mean, {look.rays} of them to find where the others are needed"
    reached = f"which is all that is allowed and reaches {chosen.expected:.2g}" if short else "which reaches"
    goal = f"instead of {tolerance}" if short else f"{chosen.expected:.2g} of the {tolerance} asked"
    sentence = (
        f"{rays}, {reached} {goal} in about "
        f"{chosen.seconds:.2g} s (and {chosen.trial.pilot.compile_seconds:.2g} s to compile, once), for which "
        f"{float_dtype()} suffices"
    )
    return Term("Pixels", False, sentence)
