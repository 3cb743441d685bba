"""The exact radiance of a gridded medium along rays, streamed: no list of crossings, no stored step.

Cells are homogeneous, so the equation of transfer is integrated exactly cell by cell (`optics.layer`), back to front:

    R <- exp(-u) R + l phi1(u) j,    u = mu l.

This is the path integral itself, the estimator of zero variance. Radiance from behind is added at the end, attenuated
by the summed optical depth: next to a bright background the emission of thin cells would be rounded away one by one.

The tangent is marched along with the whole radiance R,

    dR <- exp(-u) dR + l phi1(u) dj - l (exp(-u) R + l thinning(u) j) dmu    (R: behind the cell),

and the adjoint near to far, with T the transmittance so far (1 at the eye) and Q the radiance still to come (all of
it at the eye), which needs neither stored steps nor divisions:

    dL/dj = T l phi1(u),    Q <- Q - T l phi1(u) j,    dL/dmu = -l (T l thinning(u) j + Q),    T <- exp(-u) T,

and dL/dbehind is T behind the last cell. Q is a difference, wrong by the rounding of what is in front, which dL/dmu
brings up by u; behind a cell of u > 64 it is set to the 0 that it is to 2e-28.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend.core import Primitive
from jaxtyping import Array, Float

from jaxir._arrays import require_shape
from jaxir._math import INSIDE
from jaxir.geometry import Grid, Rays, crossings
from jaxir.medium._primitives import (
    along_active,
    is_active,
    partly,
    register_jvp,
    register_linear,
    streaming_primitive,
    zero_like,
)
from jaxir.medium._segments import (
    Lists,
    adjoint_rays,
    alone,
    beside,
    chunk_rays,
    fold,
    fold_threes,
    geometry_parts,
    over_chunks,
    rows,
)
from jaxir.optics import SERIES_BELOW, across_layer, attenuate, phi1, thinning, through_layer

OPAQUE = 64.0  # optical depth of a cell through which nothing is seen


def _radiance(extinction, emission, behind, *geometry, shape):
    """Value: [ray, node]."""
    nodes = behind.shape[1:]
    extinction, emission, behind = alone(extinction, emission, behind)

    def chunk(_, route, behind):
        def emit(emitted, cell, length):
            mu, j = rows(extinction, cell), rows(emission, cell)
            return across_layer(emitted, mu, j, beside(length, mu))

        def deepen(depth, cell, length):
            mu = rows(extinction, cell)
            return depth + beside(length, mu) * mu

        dark = jnp.zeros_like(behind)
        emitted = fold(route, emit, dark, near_to_far=False)
        # The summed depth is needed, and costs its own walk, only where there is something behind.
        depth = lax.cond(jnp.any(behind != 0), lambda: fold(route, deepen, dark, near_to_far=False), lambda: dark)
        return (), emitted + jnp.exp(-depth) * behind

    size = chunk_rays(behind.shape[0], *nodes)
    radiance = over_chunks(chunk, (), size, geometry, (behind,), shape)[1]
    return [radiance.reshape((-1, *nodes))]


def _radiance_tangent(extinction, emission, behind, _, *rest, shape, wrt):
    """Tangent along those of (extinction, emission, behind) that `wrt` marks."""
    parts = geometry_parts(shape)
    geometry, tangents = rest[:parts], list(rest[parts:])
    d_extinction = tangents.pop(0) if wrt[0] else None
    d_emission = tangents.pop(0) if wrt[1] else None
    d_behind = tangents.pop(0) if wrt[2] else jnp.zeros_like(behind)

    def chunk(_, route, behind, d_behind):
        def update(state, cell, length):
            radiance, d_radiance = state
            mu, j = rows(extinction, cell), rows(emission, cell)
            length = beside(length, mu)
            u = mu * length
            gain, passed = length * phi1(u), attenuate(radiance, u)
            radiance, d_radiance = across_layer(radiance, mu, j, length), attenuate(d_radiance, u)
            if d_emission is not None:
                d_radiance = d_radiance + gain * rows(d_emission, cell)
            if d_extinction is not None:
                d_radiance = d_radiance - length * (passed + length * thinning(u) * j) * rows(d_extinction, cell)
            return radiance, d_radiance

        return (), fold(route, update, (behind, d_behind), near_to_far=False)[1]

    size = chunk_rays(*behind.shape)
    return [over_chunks(chunk, (), size, geometry, (behind, d_behind), shape)[1]]


def _radiance_adjoint(extinction, emission, behind, radiance, *rest, shape, wrt):
    """Cotangents of those of (extinction, emission, behind) that `wrt` marks."""
    parts = geometry_parts(shape)
    geometry, shapes = rest[:parts], (extinction.shape, emission.shape, behind.shape)
    size = adjoint_rays(*behind.shape, cells=extinction.shape[0])
    extinction, emission, radiance, cotangent = alone(extinction, emission, radiance, rest[parts])
    sums = (jnp.zeros_like(extinction) if wrt[0] else None, jnp.zeros_like(emission) if wrt[1] else None)

    def chunk(sums, route, radiance, cotangent):
        def update(state, cell, length):
            passed, remaining, (to_extinction, to_emission) = state  # passed and remaining are times the cotangent
            # Every barrier keeps XLA from computing what is before it once for each of its uses.
            cell, length = lax.optimization_barrier((cell, length))
            mu, j = lax.optimization_barrier((rows(extinction, cell), rows(emission, cell)))
            length = beside(length, mu)
            u = mu * length
            gain, bend, kept = lax.optimization_barrier((length * phi1(u), length * thinning(u), jnp.exp(-u)))
            shares, gains, flat = [], [], cell.reshape((-1,))  # one scatter of flat indices is the fastest
            for k in range(3):
                gained = passed * gain[k]
                gains.append(gained)
                remaining = jnp.where(u[k] > OPAQUE, 0, remaining - gained * j[k])
                shares.append(-length[k] * (passed * bend[k] * j[k] + remaining))
                passed = jnp.where(u[k] < SERIES_BELOW, passed - gained * mu[k], kept[k] * passed)
                passed, remaining = lax.optimization_barrier((passed, remaining))
            if to_extinction is not None:
                to_extinction = to_extinction.at[flat].add(jnp.concatenate(shares), **INSIDE)
            if to_emission is not None:
                to_emission = to_emission.at[flat].add(jnp.concatenate(gains), **INSIDE)
            return passed, remaining, (to_extinction, to_emission)

        passed, _, sums = fold_threes(route, update, (cotangent, cotangent * radiance, sums))
        return sums, passed

    sums, passed = over_chunks(chunk, sums, size, geometry, (radiance, cotangent), shape)
    return [x.reshape(s) for x, s, wanted in zip((*sums, passed), shapes, wrt, strict=True) if wanted]


def _depth(*operands, shape):
    """Optical depth: [ray, node]; linear in the last operand, the extinction."""
    geometry, extinction = operands[:5], operands[5]

    def chunk(_, route):
        def update(depth, cell, length):
            return depth + length[:, None] * rows(extinction, cell)

        start = jnp.zeros((route.step.shape[0], extinction.shape[1]), extinction.dtype)
        return (), fold(route, update, start, near_to_far=True)

    size = chunk_rays(geometry[4].shape[0], extinction.shape[1])
    return [over_chunks(chunk, (), size, geometry, (), shape)[1]]


def _depth_adjoint(*operands, shape):
    """Cotangent of the extinction."""
    geometry, cotangent = operands[:5], operands[5]

    def chunk(total, route, cotangent):
        def update(total, cell, length):
            return total.at[cell].add(length[:, None] * cotangent, **INSIDE)

        return fold(route, update, total, near_to_far=True), ()

    cells = shape[0] * shape[1] * shape[2]
    start = jnp.zeros((cells, cotangent.shape[1]), cotangent.dtype)
    size = adjoint_rays(*cotangent.shape, cells=cells)
    return [over_chunks(chunk, start, size, geometry, (cotangent,), shape)[0]]


def _like_ray(operands: tuple, node_axis_of: Any) -> Any:
    """Abstract [ray, node]: rays of t_max, nodes of `node_axis_of`."""
    return node_axis_of.update(shape=(operands[4].shape[0], node_axis_of.shape[1]))


depth_p = streaming_primitive("optical_depth", _depth, lambda *avals, shape: [_like_ray(avals, avals[5])])
depth_adjoint_p = streaming_primitive(
    "optical_depth_adjoint",
    _depth_adjoint,
    lambda *avals, shape: [avals[5].update(shape=(shape[0] * shape[1] * shape[2], avals[5].shape[1]))],
)


register_linear(depth_p, depth_adjoint_p, constants=5)
register_linear(depth_adjoint_p, depth_p, constants=5)


def radiance_primitive(name: str, parts: int, plain: Callable[..., Array]) -> Primitive:
    """The radiance [ray, node] as a primitive of (extinction, emission, behind, *geometry), with its derivatives.

    Args:
        name: shown in jaxprs.
        parts: how many arrays the geometry is, see `segments`.
        plain: the same in ordinary operations with the same `shape`, for second derivatives and those along the
            geometry.

    Returns:
        The primitive; its static parameter `shape` is that of the grid, None for lists.
    """

    def wanted(avals: tuple, wrt: tuple[bool, ...]) -> list:
        return [aval for aval, wants in zip(avals[:3], wrt, strict=True) if wants]

    radiance = streaming_primitive(name, _radiance, lambda *avals, shape: [avals[2]])
    tangent = streaming_primitive(f"{name}_tangent", _radiance_tangent, lambda *avals, shape, wrt: [avals[2]])
    adjoint = streaming_primitive(f"{name}_adjoint", _radiance_adjoint, lambda *a, shape, wrt: wanted(a, wrt))

    def jvp(primals, tangents, *, shape):
        if any(is_active(x) for x in tangents[3:]):
            return along_active(lambda *operands: [plain(*operands, shape=shape)], primals, tangents)
        results = radiance.bind(*primals, shape=shape)
        wrt = tuple(is_active(x) for x in tangents[:3])
        if not any(wrt):
            return results, [zero_like(jax.typeof(result)) for result in results]
        marched = tangent.bind(*primals[:3], *results, *primals[3:], *wanted(tangents, wrt), shape=shape, wrt=wrt)
        return results, marched

    def of_wanted(operands, shape, wrt):
        fixed = (*operands[:3], *operands[4 : 4 + parts])
        places = [place for place, wants in enumerate(wrt) if wants]
        return partly(partial(plain, shape=shape), fixed, places), [fixed[place] for place in places]

    def plain_tangent(*operands, shape, wrt):
        function, values = of_wanted(operands, shape, wrt)
        return [jax.jvp(function, values, list(operands[4 + parts :]))[1]]

    def plain_adjoint(*operands, shape, wrt):
        function, values = of_wanted(operands, shape, wrt)
        return list(jax.vjp(function, *values)[1](operands[4 + parts]))

    register_jvp(radiance, jvp)
    register_linear(tangent, adjoint, 4 + parts, plain_tangent)
    register_linear(adjoint, tangent, 4 + parts, plain_adjoint)
    return radiance


def listed_sum(
    extinction: Array, emission: Array, behind: Array, cell: Array, length: Array, shape: None = None
) -> Array:
    """`crossing_sum` in ordinary operations: any derivative exists, and memory grows with the crossings."""
    cell, length = cell.T, length.T
    mu, j = extinction.at[cell].get(mode="clip"), emission.at[cell].get(mode="clip")
    length = jnp.broadcast_to(length[:, :, None], mu.shape)
    # Radiance from behind is added at the end: next to it the emission of thin cells would be rounded away.
    emitted = lax.scan(
        lambda radiance, layer: (through_layer(radiance, *layer), None),
        jnp.zeros_like(behind),
        (mu, j, length),
        reverse=True,
    )[0]
    return emitted + jnp.exp(-jnp.sum(mu * length, axis=0)) * behind


def _walked_sum(
    extinction: Array, emission: Array, behind: Array, *geometry: Array, shape: tuple[int, int, int]
) -> Array:
    """`march` in ordinary operations: the cells are listed first."""
    origin, spacing, begin, direction, t_max = geometry
    lists = crossings(Grid(origin, spacing, shape), Rays(begin, direction), t_max)
    return listed_sum(extinction, emission, behind, lists.cell, lists.length)


radiance_p = radiance_primitive("march", 5, _walked_sum)


def _geometry(grid: Grid, rays: Rays, t_max: Array) -> Lists:
    require_shape("t_max", t_max, (rays.count,))
    return lax.stop_gradient((grid.origin, grid.spacing, rays.origin, rays.direction, t_max))


def _cells(field: str, grid: Grid, values: Array) -> Array:
    """[nx, ny, nz, node] as [cell, node]."""
    require_shape(field, values, (*grid.shape, "node"))
    return values.reshape((-1, values.shape[-1]))


def march(
    grid: Grid,
    extinction: Float[Array, "nx ny nz node"],
    emission: Float[Array, "nx ny nz node"],
    rays: Rays,
    t_max: Float[Array, " ray"],
    behind: Float[Array, "ray node"],
) -> Float[Array, "ray node"]:
    """Radiance at the origins of `rays` of an emitting and absorbing medium in front of `behind`, exact per cell.

    Call it once for all rays of an image: the memory it needs does not grow with the cells that rays cross, and the
    gradient of the fields is summed in place over all rays of one call. Neighbours in the list of rays should be
    neighbours in space, because `CHUNK` of them are marched together for as long as the longest.

    Args:
        grid: the cells.
        extinction: [nx, ny, nz, node] [m-1], >= 0.
        emission: absorption times source [nx, ny, nz, node] [W m-3 sr-1].
        rays: may start inside the grid; in float32 they should start near it.
        t_max: where each ray ends, e.g. on the skin [ray] [m]; inf allowed.
        behind: radiance that enters the ray at its end [ray, node] [W m-2 sr-1].

    Returns:
        Radiance [ray, node] [W m-2 sr-1].

    Raises:
        ValueError: shapes disagree.

    Differentiable in extinction, emission, behind, in forward and reverse mode, to any order; beyond the first memory
    grows with crossings times nodes. Not in grid, rays, t_max.
    """
    geometry = _geometry(grid, rays, t_max)
    extinction, emission = _cells("extinction", grid, extinction), _cells("emission", grid, emission)
    require_shape("emission", emission, extinction.shape)
    require_shape("behind", behind, (rays.count, extinction.shape[1]))
    if rays.count == 0:
        return behind
    return radiance_p.bind(extinction, emission, behind, *geometry, shape=grid.shape)[0]


def optical_depth(
    grid: Grid, extinction: Float[Array, "nx ny nz node"], rays: Rays, t_max: Float[Array, " ray"]
) -> Float[Array, "ray node"]:
    """Optical depth of the medium along rays, the sum of extinction times length over the cells crossed.

    Args:
        grid: the cells.
        extinction: [nx, ny, nz, node] [m-1], >= 0.
        rays: as for `march`.
        t_max: where each ray ends [ray] [m]; inf allowed.

    Returns:
        Optical depth [ray, node].

    Raises:
        ValueError: shapes disagree.

    Differentiable in extinction, forward and reverse, to any order (it is linear); not in grid, rays, t_max.
    """
    geometry = _geometry(grid, rays, t_max)
    extinction = _cells("extinction", grid, extinction)
    if rays.count == 0:
        return jnp.zeros((0, extinction.shape[1]), extinction.dtype)
    return depth_p.bind(*geometry, extinction, shape=grid.shape)[0]


def transmittance(
    grid: Grid, extinction: Float[Array, "nx ny nz node"], rays: Rays, t_max: Float[Array, " ray"]
) -> Float[Array, "ray node"]:
    """exp(-optical depth) along rays; arguments, errors and derivatives as for `optical_depth`.

    Returns:
        Transmittance [ray, node].
    """
    return jnp.exp(-optical_depth(grid, extinction, rays, t_max))
