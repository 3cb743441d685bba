"""Ways to find light, tried in pilots, and the cheapest of them for a tolerance."""

from __future__ import annotations

import dataclasses
import time
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float

from jaxir._arrays import as_float, require
from jaxir.geometry import AbstractSampler, Sobol
from jaxir.imaging._adaptive import Look, looked, looks
from jaxir.imaging._chunks import Pass, scattered_for
from jaxir.imaging._left_out import enough_bounces, lights_its_skin, shining_share
from jaxir.imaging._pilot import ErrorLaw, Pilot, error_law, pilot, well_shaped
from jaxir.imaging._quadrature import cells_error
from jaxir.imaging._tolerance import Goal
from jaxir.scene import Lit, Scene
from jaxir.transport import (
    ClosedForm,
    DirectSampling,
    DiscreteOrdinates,
    Method,
    SkinLight,
    faces_in_sight,
    unaimed,
    what_shines,
)

FEW = 2  # rays per pixel of the first pilots
MET = 64  # rays of an image that go where the scene shines, at least
HITS = 8  # and to the brightest of it that brings more than may be missed
MORE = (12, 128)  # at least and at most, of the second
LEAST_GROWTH = 0.25  # share of a pilot's time that its rays take at least: clocks are coarse, other work disturbs
FEW_ORDERS = 2  # of scattering, tried first
SOON = 2.0  # seconds of sampling for which no lattice is tried: it takes longer to solve
LATTICES = (DiscreteOrdinates(), DiscreteOrdinates(41, 9))
SAMPLED = 4  # orders of scattering in which what a lattice errs is sampled
EVEN = 4  # times the rays of a pilot that all pixels take, beyond which it is looked where they are needed
LITTLE = 2**22  # work of an image that is done before it is known where its rays are needed
MARGIN = 0.95  # of the tolerance that is aimed at, for what two pilots do not know
SMALL = 1e-3  # of the skin's area that emits most of its light, below which it is looked for
LEFT = 0.5  # of the tolerance that bounces beyond the last may add, or what is too small for its rays may bring


class Trial(NamedTuple):
    """One way to find light: a pass by it, what its pilot found, and what came before.

    Attributes:
        first: a pass of few rays per pixel, see `few_rays`.
        pilot: of it; what sunlit cells err, see `cells_error`, is in its truncation.
        left_out: of what particles scatter, over the error asked for, of the worst band.
        solving: seconds until the light in the plumes was solved for, which later images of the scene do not spend.
    """

    first: Pass
    pilot: Pilot
    left_out: float
    solving: float

    @property
    def truncation(self) -> float:
        """Share of the intensity that is left out of what particles scatter, of the worst band."""
        return float(np.max(self.pilot.truncation))

    @property
    def method(self) -> Method:
        return self.first.method

    @property
    def few(self) -> int:
        """Rays per pixel of the pilot."""
        return self.first.samples

    def law(self) -> ErrorLaw:
        """As if all variance were that of lights."""
        none = np.zeros_like(self.pilot.variance)
        return ErrorLaw(self.pilot.variance * self.few, none, none)


def rays_to_see(first: Pass, goal: Goal) -> float:
    """Rays per pixel of which `MET` go where the scene shines, and `HITS` to the brightest that may not be missed.

    Of few, what is bright and small may be missed. What hides what is looked for only where something small seems to
    shine.
    """
    lit, frame = first.lit, first.camera.undivided()
    missed = as_float(LEFT * np.array(goal.of_intensity))

    def wanted(in_sight: Array | None) -> float:
        shown = what_shines(lit, frame, in_sight, missed)
        patch, brightest = (np.asarray(area, np.float64).min() for area in shown)
        area = np.prod(np.asarray(first.camera.pixel, np.float64))
        return float(area * max(MET / patch, HITS / brightest)) if patch > 0 else 0.0

    rays = wanted(None)
    return wanted(faces_in_sight(lit, frame)) if rays > FEW and lit.scene.skin is not None else rays


def few_rays(wanted: float, most: int) -> int:
    """Rays per pixel of first pilots, at most `most`, where so many are wanted, see `rays_to_see`."""
    return next((count for count in well_shaped(most) if count >= max(wanted, FEW)), well_shaped(most)[-1])


def with_skin_light(lit: Lit, method: Method) -> Method:
    """A method that looks for the light of the skin on other skin or particles where next to none of its area sends it.

    Paths that go on by chance would meet it in few of an image's pixels, or in none.
    """
    if lit.scene.skin is None or method.skin_light is not None:
        return method
    if float(np.min(shining_share(lit))) >= SMALL:
        return method
    direct = method.direct if isinstance(method.direct, DirectSampling) else DirectSampling()
    return dataclasses.replace(method, direct=direct, skin_light=SkinLight())


def by_few_orders(method: Method) -> Method:
    """A method by which bounces are looked for."""
    return dataclasses.replace(method, orders=min(FEW_ORDERS, method.orders))


def with_bounces(first: Pass, goal: Goal) -> tuple[Pass, Float[np.ndarray, " band"]]:
    """A pass of as many bounces as leave out at most `LEFT` of what is asked, and the share they leave out [band].

    Of the intensity that a pilot of the pass finds, with what more bounces would add to it.
    """
    lit, lit_by_skin = first.lit, lights_its_skin(first.lit.scene)
    if lit_by_skin or lit.scene.scatters:
        first = first._replace(method=with_skin_light(lit, first.method))
    if not lit_by_skin:
        return first, np.zeros(lit.nodes.response.shape[0])
    few = by_few_orders(first.method)

    def allowed(intensity: np.ndarray) -> np.ndarray:
        return LEFT * np.min([asked.allowed(intensity) for asked in goal.of_intensity], axis=0)

    bounces, left, intensity = enough_bounces(
        lit, first.camera, few, lambda: pilot(first._replace(method=few)).intensity, allowed
    )
    share = np.divide(left, intensity, out=np.where(left > 0, np.inf, 0.0), where=intensity > 0)
    return first._replace(method=dataclasses.replace(first.method, bounces=bounces)), share


def best_way(first: Pass, goal: Goal, asked: bool, images: int = 1) -> tuple[list[Trial], Choice, Look | None]:
    """What was tried of a pass of few rays per pixel, the best of it, and what tells where rays go, if not everywhere.

    Only what is given is tried where the method is `asked` for. Of light that particles scatter, lattices are tried
    where no number of orders is `SOON` done: what the finest errs is sampled where none leaves out as little as asked.

    Args:
        first: the pass.
        goal: what is asked.
        asked: whether the method is not to be chosen.
        images: how many are like this one, all of which one lattice serves.
    """
    scene = first.lit.scene
    by_particles = scene.scatters and not scene.area_sources and not asked
    if by_particles:
        trials = _by_orders(first, goal)
    else:
        ways = [first.method] if asked else _candidates(scene, first.method)
        trials = [_trial(first._replace(method=method), goal) for method in ways]
    chosen = cheapest(trials, goal)
    if not by_particles:
        return trials, *where_it_varies(chosen, goal)
    if trials[-1].left_out <= 1 and chosen.seconds / chosen.samples * looks(first.samples) * images < SOON:
        placed, look = where_it_varies(chosen, goal)
        if placed.excess <= 1 and placed.seconds * images < SOON:
            return trials, placed, look
    trials += _by_lattices(first, goal)
    return trials, *where_it_varies(cheapest(trials, goal), goal)


def suffices(chosen: Choice, first: Pass, goal: Goal) -> bool:
    """Whether a way that was chosen for another camera leaves out no more than is asked, or no less could be had."""
    trial = chosen.trial
    if trial.left_out > 1:
        return True
    method = dataclasses.replace(trial.method, bounces=first.method.bounces)
    return _trial(first._replace(method=method).seeing(unaimed(trial.first.lit)), goal).left_out <= 1


def _trial(first: Pass, goal: Goal, solving: float = 0.0) -> Trial:
    found = pilot(first)
    cells, size = cells_error(first.lit, first.camera, first.method), np.abs(found.intensity)
    lacks = found.truncation + np.divide(cells, size, out=np.zeros_like(size), where=size > 0)
    found = found._replace(truncation=lacks)
    return Trial(first, found, float(goal.tolerance.beyond(np.abs(found.intensity), found.truncation)), solving)


def _by_orders(first: Pass, goal: Goal) -> list[Trial]:
    """By rising orders until one leaves out no more than is asked."""
    trials = []
    for orders in sorted({min(FEW_ORDERS, first.method.orders), first.method.orders}):
        trials.append(_trial(first._replace(method=dataclasses.replace(first.method, orders=orders)), goal))
        if trials[-1].left_out <= 1:
            break
    return trials


def _by_lattices(first: Pass, goal: Goal) -> list[Trial]:
    """By finer lattices until one leaves out no more than is asked; what the finest errs is sampled if none does."""
    trials, held = [], None
    for ordinates in LATTICES:
        solved = _on_lattice(first, goal, ordinates)
        if solved is None:  # this lattice cannot hold the light, a finer one may
            continue
        held = ordinates
        trials.append(solved)
        if solved.left_out <= 1:
            return trials
    mended = None if held is None else _on_lattice(first, goal, dataclasses.replace(held, orders=SAMPLED))
    return trials if mended is None else [*trials, mended]


def _on_lattice(first: Pass, goal: Goal, ordinates: DiscreteOrdinates) -> Trial | None:
    """What a lattice comes to; None where it cannot hold the light."""
    method, began = dataclasses.replace(first.method, orders=0, scattering=ordinates), time.perf_counter()
    try:
        taken = jax.block_until_ready(scattered_for(first, method.resolved(first.lit.scene)))
    except ValueError:
        return None
    spent = time.perf_counter() - began
    return _trial(taken, goal, spent)


class Choice(NamedTuple):
    """What one way needs for a tolerance.

    Attributes:
        trial: the way.
        law: how its variance falls.
        samples: rays per pixel, pilots among them where they tell where the others go.
        seconds: of them.
        expected: standard error over intensity, of the worst band.
        excess: standard error over what is asked, of the worst band.
    """

    trial: Trial
    law: ErrorLaw
    samples: int
    seconds: float
    expected: float
    excess: float


def _candidates(scene: Scene, given: Method) -> list[Method]:
    """Ways to find direct light; where one without variance applies, it and the cheapest draw."""
    if scene.skin is None or not scene.area_sources:  # nothing to choose
        return [given]
    # each way takes long to compile, many samples are lost on what is reflected, no form is closed
    if given.bounces or given.skin_light is not None:
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
    both = [by(DirectSampling(1, 1)), by(DirectSampling(8, 8), Sobol())]
    if not scene.skin.brdf.diffuse:  # of one kind those that matter may be so rare that a pilot meets none
        return both
    return [by(DirectSampling(1, 0)), both[0], by(DirectSampling(16, 0), Sobol()), both[1]]


def cheapest(trials: list[Trial], goal: Goal) -> Choice:
    """First as if all variance were that of lights; then with the silhouettes' share, from a second pilot."""
    few = trials[0].few
    choices = [_choice(trial, trial.law(), 1 / few, goal) for trial in trials]
    best = min(range(len(trials)), key=lambda i: _cost(choices[i]))
    chosen = choices[best]
    if chosen.samples == few:
        return chosen
    least, largest = (max(count, 2 * few) for count in MORE)
    count = well_shaped(min(max(chosen.samples // 4, least), largest))[-1]
    more = pilot(trials[best].first.of(count))
    law = error_law((few, trials[best].pilot), (count, more))._replace(noise=np.zeros_like(more.variance))
    little = trials[best].pilot.seconds
    each = (more.seconds - little) / (count - few)
    alike = little - few * each  # what an image costs, however light is found
    choices = []
    for trial in trials:
        samples, seen = (count, more) if trial is trials[best] else (few, trial.pilot)
        noise = np.maximum(seen.variance - law.variance(samples), 0) * samples
        growth = max(1 - alike / trial.pilot.seconds, LEAST_GROWTH) / few
        choices.append(_choice(trial, law._replace(noise=noise), growth, goal))
    least = min(range(len(trials)), key=lambda i: _cost(choices[i]))
    if least != best:
        return choices[least]
    growth = max(each / little, LEAST_GROWTH / (count - few))  # was timed with more rays
    return _choice(trials[best], choices[best].law, growth, goal)


def where_it_varies(chosen: Choice, goal: Goal) -> tuple[Choice, Look | None]:
    """The choice with its rays where pixels vary, where that takes fewer of them, pilot included; what the pilot saw.

    Pilots are few rays where `EVEN` times as many do not suffice. Of `LITTLE` work none is saved.
    """
    first = chosen.trial.first
    if chosen.samples <= EVEN * looks(first.samples) or first.work(chosen.samples) <= LITTLE:
        return chosen, None
    noise = np.any(chosen.law.noise / chosen.samples > chosen.law.variance(chosen.samples) / 2)
    look = looked(first, goal, first.samples, first.noisy and bool(noise))
    count = look.strata(goal.most, goal.seconds - look.seconds)
    samples = look.rays + 2 * float(count.mean())
    excess = look.law.excess(count)
    if (max(excess, 1), samples) >= (max(chosen.excess, 1), chosen.samples):
        return chosen, None
    seconds = look.seconds + chosen.seconds / chosen.samples * (samples - look.rays)
    expected = chosen.expected * excess / chosen.excess
    return chosen._replace(samples=round(samples), seconds=seconds, expected=expected, excess=excess), look


def _cost(choice: Choice) -> tuple[float, float]:
    """What errs least beyond what is asked, by sampling or by what is left out; if alike, by time."""
    return max(choice.excess, choice.trial.left_out, 1.0), choice.seconds


def _choice(trial: Trial, law: ErrorLaw, growth: float, goal: Goal) -> Choice:
    """Rays per pixel and time that a method needs; `growth` of the time with each ray more, in that of a pilot."""
    intensity = np.abs(trial.pilot.intensity)
    in_time = trial.few + (goal.seconds / trial.pilot.seconds - 1) / growth
    most = max(int(min(goal.most, in_time)), trial.few)
    samples = max(law.samples((MARGIN * goal.tolerance.allowed(intensity)) ** 2, most), trial.few)
    error = np.sqrt(law.variance(samples))
    expected = float(np.max(np.divide(error, intensity, out=np.full_like(error, np.inf), where=intensity > 0)))
    seconds = trial.pilot.seconds * (1 + growth * (samples - trial.few))
    excess = float(goal.tolerance.excess(intensity, error))
    return Choice(trial, law, samples, seconds, expected if error.any() else 0.0, excess)
