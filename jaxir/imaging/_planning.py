"""Accuracy in, method out: what each term of a scene is computed by, and what that will cost."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from jaxir._arrays import enforce, float_dtype, is_traced, key_or_default, require
from jaxir._programs import program
from jaxir.geometry import AbstractSampler, Camera, Sobol, pixel_strata
from jaxir.imaging._chunks import Pass, first_pass
from jaxir.imaging._pilot import ErrorLaw, Pilot, error_law, pilot, well_shaped
from jaxir.imaging._repeated import require_rtol
from jaxir.optics.spectrum import Band, Nodes
from jaxir.scene import Lit, Scene
from jaxir.transport import (
    ClosedForm,
    DirectSampling,
    DiscreteOrdinates,
    Method,
    lattice_error,
    solution_checks,
    with_scattered,
)

FEW = 2  # rays per pixel of the first pilots
MORE = (12, 128)  # at least and at most, of the second
LEAST_GROWTH = 0.25  # share of a pilot's time that its rays take at least: clocks are coarse, other work disturbs
FEW_ORDERS = 2  # of scattering, tried first
SOON = 2.0  # seconds of sampling for which no lattice is tried: it takes longer to solve
LATTICES = (DiscreteOrdinates(), DiscreteOrdinates(41, 9))
SAMPLED = 4  # orders of scattering in which what a lattice errs is sampled
MARGIN = 0.95  # of the tolerance that is aimed at, for what two pilots do not know


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
        samples: rays per pixel, in one pass.
        seconds: predicted, of the rays on the device in force; compiling and the call, some milliseconds, come on top.
        compile_seconds: what compiling the chosen method's pilot took, and solving for the light in plumes, once.
        rtol: asked.
        expected: predicted standard error over intensity, of the worst band.
        truncation: estimated share of the intensity that is left out of what particles scatter, of the worst band.
    """

    terms: tuple[Term, ...]
    method: Method
    samples: int
    seconds: float
    compile_seconds: float
    rtol: float
    expected: float
    truncation: float

    def __str__(self) -> str:
        """One sentence per term."""
        return "\n".join(f"{term.name}: {term.sentence}." for term in self.terms)


def plan(
    scene: Scene,
    camera: Camera,
    bands: Nodes | Band | Sequence[Band],
    rtol: float,
    *,
    key: Key[Array, ""] | None = None,
    method: Method | None = None,
    max_samples: int = 4096,
) -> Plan:
    """How to meet a tolerance on the intensity of every band, and at what cost, before an image is computed.

    What has no variance is chosen without trial: the exact sum over cells, delta sources. For reflected light, by a
    closed form where its conditions hold or sampled, every candidate computes a few chunks of the image; variance as
    it falls with the rays (`ErrorLaw`), and time, as it grows with them, decide. So for light that particles scatter,
    sampled up to few or more orders or solved on a coarse or finer lattice: among those that leave out less of the
    intensity than `rtol`, if there are any.

    Args:
        scene: the scene.
        camera: the eye.
        bands: bands or nodes.
        rtol: standard error of the radiant intensity of every band over the intensity.
        key: random key of the pilots.
        method: kept if given; else its `direct` and `sampler` are chosen, where the scene has sources with an extent,
            or else, where it has particles, `orders` or `scattering`.
        max_samples: rays per pixel that must suffice.

    Returns:
        The plan; `print` it.

    Raises:
        ValueError: as `jaxir.render`; rtol <= 0 or beyond the precision in force, with the precision it needs.
    """
    require_rtol(rtol)
    if is_traced((scene, camera, key, method)):
        raise ValueError("plan: got values known only inside jit, expected a call outside it")
    key = key_or_default(key)
    given = Method() if method is None else method
    return plan_pass(first_pass(scene, camera, bands, key, FEW, given), rtol, max_samples, method is not None)


def plan_pass(first: Pass, rtol: float, most: int, asked: bool) -> Plan:
    """`plan` for a pass of `FEW` rays per pixel that was checked; `asked`: its method is not to be chosen."""
    scene = first.lit.scene
    if asked:
        trials = [_trial(first)]
    elif scene.scatters and not scene.area_sources:
        trials = _ways_to_scatter(first, rtol, most)
    else:
        trials = [_trial(first._replace(method=method)) for method in _candidates(scene, first.method)]
    chosen = _cheapest(trials, rtol, most)
    trial = chosen.trial
    terms = (
        *_along_the_ray(first.lit, first.camera),
        *_by_particles(scene, trials, chosen),
        *_at_the_skin(scene, trials, chosen, asked),
        *_beyond(scene),
        _pixels(chosen, rtol, most),
    )
    ready = trial.pilot.compile_seconds + trial.solving
    return Plan(terms, trial.method, chosen.samples, chosen.seconds, ready, rtol, chosen.expected, trial.truncation)


class _Trial(NamedTuple):
    """One way to find light: a pass by it, what its pilot found, and what came before.

    Attributes:
        first: a pass of `FEW` rays per pixel.
        pilot: of it.
        truncation: share of the intensity that is left out of what particles scatter, of the worst band.
        solving: seconds until the light in the plumes was solved for, which later images of the scene do not spend.
    """

    first: Pass
    pilot: Pilot
    truncation: float
    solving: float

    @property
    def method(self) -> Method:
        return self.first.method

    def law(self) -> ErrorLaw:
        """As if all variance were that of lights."""
        return ErrorLaw(self.pilot.variance * FEW, np.zeros_like(self.pilot.variance))


def _trial(first: Pass, solving: float = 0.0) -> _Trial:
    found = pilot(first, _lattice_error(first.lit, first.camera))
    return _Trial(first, found, float(np.max(found.truncation)), solving)


_lattice_error = program(lattice_error)


def _ways_to_scatter(first: Pass, rtol: float, most: int) -> list[_Trial]:
    """By rising orders, and if that is not soon done by finer lattices, until one leaves out no more than is asked.

    Where none does, what the finest errs is sampled.
    """
    trials = []
    for orders in sorted({min(FEW_ORDERS, first.method.orders), first.method.orders}):
        trials.append(_trial(first._replace(method=dataclasses.replace(first.method, orders=orders))))
        if trials[-1].truncation <= rtol:
            choice = _choice(trials[-1], trials[-1].law(), 1 / FEW, rtol, most)
            if choice.expected <= rtol and choice.seconds < SOON:
                return trials
            break
    held = None
    for ordinates in LATTICES:
        solved = _on_lattice(first, ordinates)
        if solved is None:  # this lattice cannot hold the light, a finer one may
            continue
        held = ordinates
        trials.append(solved)
        if solved.truncation <= rtol:
            return trials
    mended = None if held is None else _on_lattice(first, dataclasses.replace(held, orders=SAMPLED))
    return trials if mended is None else [*trials, mended]


def _on_lattice(first: Pass, ordinates: DiscreteOrdinates) -> _Trial | None:
    """What a lattice comes to; None where it cannot hold the light."""
    method, began = dataclasses.replace(first.method, orders=0, scattering=ordinates), time.perf_counter()
    try:
        lit = with_scattered(first.lit, method)
        lit = jax.block_until_ready(enforce(lit, solution_checks(lit)))
    except ValueError:
        return None
    spent = time.perf_counter() - began
    return _trial(first._replace(method=method.resolved(lit.scene), lit=lit), spent)


class _Choice(NamedTuple):
    trial: _Trial
    law: ErrorLaw
    samples: int
    seconds: float
    expected: float


def _candidates(scene: Scene, given: Method) -> list[Method]:
    """Ways to find direct light; where one without variance applies, it and the cheapest draw."""
    if scene.skin is None or not scene.area_sources:  # nothing to choose
        return [given]

    def by(direct: DirectSampling | ClosedForm, sampler: AbstractSampler | None = None) -> Method:
        chosen = given.sampler if sampler is None else sampler
        return dataclasses.replace(given, direct=direct, sampler=chosen)

    closed = by(ClosedForm())
    try:
        require(closed.checks_for(scene))
        return [closed, by(DirectSampling(1, 0))]
    except ValueError:
        pass
    ways = [
        by(DirectSampling(1, 0)),
        by(DirectSampling(1, 1)),
        by(DirectSampling(16, 0), Sobol()),
        by(DirectSampling(8, 8), Sobol()),
    ]
    return ways if scene.skin.brdf.diffuse else [*ways, by(DirectSampling(0, 1))]


def _cheapest(trials: list[_Trial], rtol: float, most: int) -> _Choice:
    """First as if all variance were that of lights; then with the silhouettes' share, from a second pilot."""
    choices = [_choice(trial, trial.law(), 1 / FEW, rtol, most) for trial in trials]
    best = min(range(len(trials)), key=lambda i: _cost(choices[i], rtol))
    chosen = choices[best]
    if chosen.samples == FEW:
        return chosen
    count = well_shaped(min(max(chosen.samples // 4, MORE[0]), MORE[1]))[-1]
    more = pilot(trials[best].first._replace(strata=pixel_strata(count)))
    edge = error_law((FEW, trials[best].pilot), (count, more)).edge
    little = trials[best].pilot.seconds
    each = (more.seconds - little) / (count - FEW)
    alike = little - FEW * each  # what an image costs, however light is found
    choices = []
    for trial in trials:
        samples, seen = (count, more) if trial is trials[best] else (FEW, trial.pilot)
        noise = np.maximum(seen.variance * samples - edge / samples**0.5, 0)
        growth = max(1 - alike / trial.pilot.seconds, LEAST_GROWTH) / FEW
        choices.append(_choice(trial, ErrorLaw(noise, edge), growth, rtol, most))
    cheapest = min(range(len(trials)), key=lambda i: _cost(choices[i], rtol))
    if cheapest != best:
        return choices[cheapest]
    growth = max(each / little, LEAST_GROWTH / (count - FEW))  # was timed with more rays
    return _choice(trials[best], choices[best].law, growth, rtol, most)


def _cost(choice: _Choice, rtol: float) -> tuple[bool, float, float]:
    """Methods that meet the tolerance first, then those that leave out no more than it or the least, then by time."""
    return choice.expected > rtol, max(choice.trial.truncation, rtol), choice.seconds


def _choice(trial: _Trial, law: ErrorLaw, growth: float, rtol: float, most: int) -> _Choice:
    """Rays per pixel and time that a method needs; `growth` of the time with each ray more, in that of a pilot."""
    intensity = np.abs(trial.pilot.intensity)
    samples = law.samples((MARGIN * rtol * intensity) ** 2, most)
    error = np.sqrt(law.variance(samples))
    expected = float(np.max(np.divide(error, intensity, out=np.full_like(error, np.inf), where=intensity > 0)))
    seconds = trial.pilot.seconds * (1 + growth * (samples - FEW))
    return _Choice(trial, law, samples, seconds, expected if error.any() else 0.0)


def _along_the_ray(lit: Lit, camera: Camera) -> list[Term]:
    if lit.medium is None:
        return []
    each = ", ".join(plume.described() for plume in lit.scene.plumes)
    depth = float(_depth(lit, camera))
    sentence = f"{each}: integrated along every ray, no sampling; the largest optical depth is {depth:.2g}"
    return [Term("Plume", True, sentence)]


def _by_particles(scene: Scene, trials: list[_Trial], chosen: _Choice) -> list[Term]:
    if not scene.scatters:
        return []
    once = "parallel light scattered once is summed over the cells, " if scene.summed_beams else ""
    method, left = chosen.trial.method, f"leaves out about {chosen.trial.truncation:.2g} of the intensity"
    others = "; ".join(f"{_way(t.method)} would leave out {t.truncation:.2g}" for t in trials if t is not chosen.trial)
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


def _depth(lit: Lit, camera: Camera) -> Array:
    """The largest optical depth on a raster of 16 x 16 rays across the image."""
    assert lit.medium is not None
    place = (np.arange(16) + 0.5) / 16 - 0.5
    size = np.asarray(camera.pixel) * np.array(camera.shape[::-1])
    x, y = np.meshgrid(place * size[0], place * size[1])
    screen = jnp.asarray(np.stack([x.ravel(), y.ravel()], axis=1), camera.pixel.dtype)
    rays = camera.bundle(screen, lit.scene.start(camera)).rays()
    passed = lit.medium.transmittance(rays, jnp.full(rays.count, jnp.inf, screen.dtype))
    return -jnp.log(jnp.maximum(jnp.min(passed), jnp.finfo(passed.dtype).tiny))


def _at_the_skin(scene: Scene, trials: list[_Trial], chosen: _Choice, asked: bool) -> list[Term]:
    if scene.skin is None:
        return []
    terms = [
        Term("Emission", True, f"Planck's and Kirchhoff's laws at every point met of {scene.skin.mesh.count} faces")
    ]
    if scene.delta_sources:
        sentence = f"{len(scene.delta_sources)} without extent, each evaluated with its shadow at every point met"
        terms.append(Term("Sources", True, sentence))
    method = chosen.trial.method.resolved(scene)
    if method.direct is None and method.bounces == 0:
        return terms
    name = _name(method)
    exact = isinstance(method.direct, ClosedForm) and method.bounces == 0
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


def _name(method: Method) -> str:
    light = "nothing" if method.direct is None else type(method.direct).__name__
    counts = ", ".join(f"{n} of {what}" for n, what in zip(method.counts, ("each light", "the brdf"), strict=True) if n)
    samples = f"({counts}) with {type(method.sampler).__name__} points" if counts else ""
    return f"{light}{samples}{f' and {method.bounces} bounces' if method.bounces else ''}"


def _efficiency(one: _Trial, other: _Trial) -> float:
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


def _pixels(chosen: _Choice, rtol: float, most: int) -> Term:
    short = chosen.expected > rtol
    reached = f"which is all that is allowed and reaches {chosen.expected:.2g}" if short else "which reaches"
    goal = f"instead of {rtol:.2g}" if short else f"{chosen.expected:.2g} of the {rtol:.2g} asked"
    sentence = (
        f"{chosen.samples} rays each, two in each of {chosen.samples // 2} strata, {reached} {goal} in about "
        f"{chosen.seconds:.2g} s (and {chosen.trial.pilot.compile_seconds:.2g} s to compile, once), for which "
        f"{float_dtype()} suffices"
    )
    return Term("Pixels", False, sentence)
