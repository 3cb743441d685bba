"""Scattered light that is solved for: once for a scene, and kept while its values stay the same."""

from __future__ import annotations

import dataclasses
import threading

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Int

from jaxir._arrays import fingerprint, is_traced
from jaxir._concurrent import each_of
from jaxir._programs import of_items, program
from jaxir.geometry import Camera
from jaxir.medium import AbstractMedium
from jaxir.scene import Lit
from jaxir.transport._method import DiscreteOrdinates, Method
from jaxir.transport._paths import Paths
from jaxir.transport._through import Answer, Through
from jaxir.transport.evaluation._segments import behind_plumes
from jaxir.transport.ordinates import Posed, Scattered, Solution, finished, posed, solution


def with_scattered(lit: Lit, method: Method, told: bool = True) -> Lit:
    """The scene with what its particles scatter, where the method finds that on a lattice; else as it is.

    Done once, it serves all paths; `evaluate` does it unless it was done. Of known values the last solution is kept:
    neither cameras and the air before them nor bands ask for another. Two of three solutions only tell what the lattice
    errs, where that is not sampled: unless it shall be `told`, they are left out.
    """
    if method.scattering is None or lit.medium is None or not lit.medium.scatters:
        return lit
    bare = lit.in_vacuum()
    ordinates = dataclasses.replace(method.scattering, orders=min(method.scattering.orders, 1))  # however many more
    once = dataclasses.replace(method, bounces=0, scattering=ordinates, skin_light=None, plume_light=None)
    once = once.resolved(bare.scene)
    return eqx.tree_at(lambda lit: lit.medium, lit, _remembered((bare, once), told and ordinates.orders == 0))


def aimed(lit: Lit, camera: Camera) -> Lit:
    """A scene with its scattered light, see `with_scattered`, ready for many rays of a camera."""
    if not isinstance(lit.medium, Scattered):
        return lit
    return eqx.tree_at(lambda lit: lit.medium, lit, lit.medium.aimed_at(camera.eye))


def unaimed(lit: Lit) -> Lit:
    """The same before it was `aimed`."""
    if not isinstance(lit.medium, Scattered):
        return lit
    parts = tuple(dataclasses.replace(part, aimed=None) for part in lit.medium.parts)
    return eqx.tree_at(lambda lit: lit.medium, lit, dataclasses.replace(lit.medium, parts=parts))


def _remembered(asked: tuple[Lit, Method], told: bool) -> AbstractMedium:
    """The medium with its scattered light, or as it was found for the same values before."""
    if is_traced(asked):
        return _solved(*asked, told)
    key = jax.tree.structure(asked), fingerprint(asked), told
    with _SOLVING:
        found = _held.get(key)
        if found is None:
            found = _solved(*asked, told)
            _held.clear()
            _held[key] = found
    return found


_held: dict[tuple, AbstractMedium] = {}
_SOLVING = threading.Lock()  # threads that ask for one solution wait for it


def _solved(lit: Lit, method: Method, told: bool) -> AbstractMedium:
    """Solve for the light in the plumes; groups of nodes side by side where all is known."""
    ordinates = method.scattering
    assert ordinates is not None
    equations = _posed(lit, method)
    asked = equations, ordinates, told
    if is_traced(equations):
        solutions = _solutions(asked)
    else:
        of_group = of_items(_solution, asked)
        groups = np.arange(equations.groups.unscattered.shape[0], dtype=np.int32)
        each = each_of(lambda group: jax.block_until_ready(of_group(group)), groups, ready=len(groups) > 1)
        solutions = jax.tree.map(lambda *some: jnp.stack(some), *each)
    return _finished(equations, ordinates, solutions).settled()


@program
def _posed(lit: Lit, method: Method) -> Posed:
    assert method.scattering is not None
    alone = dataclasses.replace(method, orders=0, scattering=dataclasses.replace(method.scattering, orders=0))

    def behind(lit: Lit, paths: Paths, through: Through) -> Answer:
        around = jnp.ones(paths.length.shape, bool) if paths.first.sees_surroundings is None else None
        first = dataclasses.replace(paths.first, sees_surroundings=around)
        return behind_plumes(lit, alone, first, False, True, through)

    return posed(lit, alone, behind)


@program
def _solution(asked: tuple[Posed, DiscreteOrdinates, bool], group: Int[Array, ""]) -> Solution:
    equations, ordinates, told = asked
    return solution(equations, ordinates, group, told)


@program
def _solutions(asked: tuple[Posed, DiscreteOrdinates, bool]) -> Solution:
    equations, ordinates, told = asked
    groups = jnp.arange(equations.groups.unscattered.shape[0], dtype=jnp.int32)
    return lax.map(lambda group: solution(equations, ordinates, group, told), groups)


@program
def _finished(equations: Posed, ordinates: DiscreteOrdinates, solutions: Solution) -> Scattered:
    return finished(equations, ordinates, solutions)
