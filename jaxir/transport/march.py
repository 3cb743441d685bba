"""The exact radiance of a gridded medium along rays, streamed: no list of crossings, no stored step.

Cells are homogeneous, so the equation of transfer is integrated exactly cell by cell (`optics.layer`), back to front:

    R <- exp(-u) R + l phi1(u) j,    u = mu l.

This is the path integral itself, the estimator of zero variance. Radiance from behind is added at the end, attenuated
by the summed optical depth: next to a bright background the emission of thin cells would be rounded away one by one.

The tangent is marched along with the whole radiance R,

    dR <- exp(-u) dR + l phi1(u) dj - l (exp(-u) R + l thinning(u) j) dmu    (R: behind the cell),

and the adjoint near to far, with T the transmittance so far (1 at the eye) and Q the radiance still to come (all of
it at the eye), which needs neither stored steps nor divisions:

    dL/dj = T l phi1(u),    dL/dmu = l (T l phi2(u) j - Q),    Q <- Q - T l phi1(u) j,    T <- exp(-u) T,

and dL/dbehind is T behind the last cell.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from jaxir._arrays import require_shape
from jaxir.geometry.grid import Grid
from jaxir.geometry.ray import Rays
from jaxir.geometry.walk import Segments, Walk, slab_segments, start_walk
from jaxir.optics.layer import SERIES_BELOW, across_layer, attenuate, phi1, phi2, thinning
from jaxir.transport.streaming import is_active, register_jvp, register_linear, streaming_primitive, zero_like

CHUNK = 256  # consecutive rays marched together: enough to fill the vector units, few enough to stay alike
CHUNK_FLOATS = 16384  # rays x nodes marched together, so that the state of a chunk stays in the first-level cache

Lists = tuple[Array, ...]


def chunk_rays(rays: int, nodes: int) -> int:
    """How many rays are marched together."""
    return max(1, min(CHUNK, rays, CHUNK_FLOATS // max(nodes, 1)))


def _chunked(array: Array, size: int) -> Array:
    """[ray, ...] to [chunk, size, ...], filled up with zeros: a ray of direction 0 misses everything."""
    count = -(-array.shape[0] // size)
    padding = [(0, count * size - array.shape[0])] + [(0, 0)] * (array.ndim - 1)
    return jnp.pad(array, padding).reshape((count, size) + array.shape[1:])


def over_chunks(function: Callable, state: Any, size: int, geometry: Lists, per_ray: Lists, shape) -> tuple[Any, Any]:
    """Call `function(state, walk, *per_ray) -> (state, [ray, ...])` chunk after chunk of `size` rays."""
    origin, spacing, ray_origin, ray_direction, t_max = geometry
    grid = Grid(origin, spacing, shape)
    count = t_max.shape[0]

    def step(state, chunk):
        walk = jax.vmap(start_walk, in_axes=(None, 0, 0, 0))(grid, *chunk[:3])
        return function(state, walk, *chunk[3:])

    chunks = tuple(_chunked(array, size) for array in (ray_origin, ray_direction, t_max, *per_ray))
    state, out = lax.scan(step, state, chunks)
    return state, jax.tree.map(lambda x: x.reshape((-1,) + x.shape[2:])[:count], out)


def fold(walk: Walk, update: Callable, state: Any, near_to_far: bool) -> Any:
    """Carry `state` through the segments of a chunk of rays: `update(state, cell [ray], length [ray])`."""
    slabs = jnp.max(walk.last - walk.first)

    def body(i, state):
        slab = walk.first + i if near_to_far else walk.last - 1 - i
        on = (slab < walk.last) & (slab >= walk.first)
        segments: Segments = jax.vmap(slab_segments)(walk, slab, on)
        for cell, length in segments if near_to_far else segments[::-1]:
            state = update(state, cell, length)
        return state

    return lax.fori_loop(0, slabs, body, state)


def _fold_slabs(walk: Walk, update: Callable, state: Any) -> Any:
    """As `fold`, near to far, a whole slab at a time: `update(state, cell [3, ray], length [3, ray])`."""

    def body(i, state):
        slab = walk.first + i
        segments: Segments = jax.vmap(slab_segments)(walk, slab, slab < walk.last)
        cell, length = (jnp.stack(parts) for parts in zip(*segments, strict=True))
        return update(state, cell, length)

    return lax.fori_loop(0, jnp.max(walk.last - walk.first), body, state)


def _beside(length: Array, like: Array) -> Array:
    """Lengths [..., ray] spread over the nodes of `like`, if it has any."""
    return jnp.broadcast_to(length.reshape(length.shape + (1,) * (like.ndim - length.ndim)), like.shape)


def _at(field: Array, cell: Array) -> Array:
    """Rows [ray, node] of `field` [cell, node]; the walk never leaves the grid."""
    return field.at[cell].get(mode="promise_in_bounds")


def _alone(*arrays: Array) -> tuple[Array, ...]:
    """Drop a node axis of length 1: XLA makes faster loops of [ray] than of [ray, 1]."""
    return tuple(array[..., 0] if array.shape[-1] == 1 else array for array in arrays)


def _radiance(extinction, emission, behind, *geometry, shape):
    """Value: [ray, node]."""
    nodes = behind.shape[1:]
    extinction, emission, behind = _alone(extinction, emission, behind)

    def chunk(_, walk, behind):
        def emit(emitted, cell, length):
            mu, j = _at(extinction, cell), _at(emission, cell)
            return across_layer(emitted, mu, j, _beside(length, mu))

        def deepen(depth, cell, length):
            mu = _at(extinction, cell)
            return depth + _beside(length, mu) * mu

        dark = jnp.zeros_like(behind)
        emitted = fold(walk, emit, dark, near_to_far=False)
        # The summed depth is needed, and costs its own walk, only where there is something behind.
        depth = lax.cond(jnp.any(behind != 0), lambda: fold(walk, deepen, dark, near_to_far=False), lambda: dark)
        return (), emitted + jnp.exp(-depth) * behind

    size = chunk_rays(behind.shape[0], *nodes)
    radiance = over_chunks(chunk, (), size, geometry, (behind,), shape)[1]
    return [radiance.reshape((-1, *nodes))]


def _radiance_tangent(extinction, emission, behind, _, *rest, shape, wrt):
    """Tangent along those of (extinction, emission, behind) that `wrt` marks."""
    geometry, tangents = rest[:5], list(rest[5:])
    d_extinction = tangents.pop(0) if wrt[0] else None
    d_emission = tangents.pop(0) if wrt[1] else None
    d_behind = tangents.pop(0) if wrt[2] else jnp.zeros_like(behind)

    def chunk(_, walk, behind, d_behind):
        def update(state, cell, length):
            radiance, d_radiance = state
            mu, j = _at(extinction, cell), _at(emission, cell)
            length = _beside(length, mu)
            u = mu * length
            gain, passed = length * phi1(u), attenuate(radiance, u)
            radiance, d_radiance = across_layer(radiance, mu, j, length), attenuate(d_radiance, u)
            if d_emission is not None:
                d_radiance = d_radiance + gain * _at(d_emission, cell)
            if d_extinction is not None:
                d_radiance = d_radiance - length * (passed + length * thinning(u) * j) * _at(d_extinction, cell)
            return radiance, d_radiance

        return (), fold(walk, update, (behind, d_behind), near_to_far=False)[1]

    size = chunk_rays(*behind.shape)
    return [over_chunks(chunk, (), size, geometry, (behind, d_behind), shape)[1]]


def _radiance_adjoint(extinction, emission, behind, radiance, *rest, shape, wrt):
    """Cotangents of those of (extinction, emission, behind) that `wrt` marks."""
    geometry, shapes = rest[:5], (extinction.shape, emission.shape, behind.shape)
    size = chunk_rays(*behind.shape)
    extinction, emission, radiance, cotangent = _alone(extinction, emission, radiance, rest[5])
    sums = (jnp.zeros_like(extinction) if wrt[0] else None, jnp.zeros_like(emission) if wrt[1] else None)

    def chunk(sums, walk, radiance, cotangent):
        def update(state, cell, length):
            passed, remaining, (to_extinction, to_emission) = state  # passed and remaining are times the cotangent
            # Every barrier keeps XLA from computing what is before it once for each of its uses.
            cell, length = lax.optimization_barrier((cell, length))
            mu, j = lax.optimization_barrier((_at(extinction, cell), _at(emission, cell)))
            length = _beside(length, mu)
            u = mu * length
            gain, bend, kept = lax.optimization_barrier((length * phi1(u), length * phi2(u), jnp.exp(-u)))
            shares, gains, flat = [], [], cell.reshape((-1,))  # one scatter of flat indices is the fastest
            for k in range(3):
                gained = passed * gain[k]
                gains.append(gained)
                shares.append(length[k] * (passed * bend[k] * j[k] - remaining))
                thin = u[k] < SERIES_BELOW
                passed = jnp.where(thin, passed - gained * mu[k], kept[k] * passed)
                remaining = remaining - gained * j[k]
                passed, remaining = lax.optimization_barrier((passed, remaining))
            if to_extinction is not None:
                to_extinction = to_extinction.at[flat].add(jnp.concatenate(shares), mode="promise_in_bounds")
            if to_emission is not None:
                to_emission = to_emission.at[flat].add(jnp.concatenate(gains), mode="promise_in_bounds")
            return passed, remaining, (to_extinction, to_emission)

        passed, _, sums = _fold_slabs(walk, update, (cotangent, cotangent * radiance, sums))
        return sums, passed

    sums, passed = over_chunks(chunk, sums, size, geometry, (radiance, cotangent), shape)
    return [x.reshape(s) for x, s, wanted in zip((*sums, passed), shapes, wrt, strict=True) if wanted]


def _depth(*operands, shape):
    """Optical depth: [ray, node]; linear in the last operand, the extinction."""
    geometry, extinction = operands[:5], operands[5]

    def chunk(_, walk):
        def update(depth, cell, length):
            return depth + length[:, None] * _at(extinction, cell)

        start = jnp.zeros((walk.step.shape[0], extinction.shape[1]), extinction.dtype)
        return (), fold(walk, update, start, near_to_far=True)

    size = chunk_rays(geometry[4].shape[0], extinction.shape[1])
    return [over_chunks(chunk, (), size, geometry, (), shape)[1]]


def _depth_adjoint(*operands, shape):
    """Cotangent of the extinction."""
    geometry, cotangent = operands[:5], operands[5]

    def chunk(total, walk, cotangent):
        def update(total, cell, length):
            return total.at[cell].add(length[:, None] * cotangent, mode="promise_in_bounds")

        return fold(walk, update, total, near_to_far=True), ()

    cells = shape[0] * shape[1] * shape[2]
    start = jnp.zeros((cells, cotangent.shape[1]), cotangent.dtype)
    return [over_chunks(chunk, start, chunk_rays(*cotangent.shape), geometry, (cotangent,), shape)[0]]


def _like_ray(operands: tuple, node_axis_of: Any) -> Any:
    """Abstract [ray, node]: rays of t_max, nodes of `node_axis_of`."""
    return node_axis_of.update(shape=(operands[4].shape[0], node_axis_of.shape[1]))


radiance_p = streaming_primitive("march", _radiance, lambda *avals, shape: [avals[2]])
radiance_tangent_p = streaming_primitive("march_tangent", _radiance_tangent, lambda *avals, shape, wrt: [avals[2]])
radiance_adjoint_p = streaming_primitive(
    "march_adjoint",
    _radiance_adjoint,
    lambda *avals, shape, wrt: [aval for aval, wanted in zip(avals[:3], wrt, strict=True) if wanted],
)
depth_p = streaming_primitive("optical_depth", _depth, lambda *avals, shape: [_like_ray(avals, avals[5])])
depth_adjoint_p = streaming_primitive(
    "optical_depth_adjoint",
    _depth_adjoint,
    lambda *avals, shape: [avals[5].update(shape=(shape[0] * shape[1] * shape[2], avals[5].shape[1]))],
)


def _radiance_jvp(primals, tangents, *, shape):
    """Geometry is traced and has no derivative: the tangents of the operands after the third are not looked at."""
    results = radiance_p.bind(*primals, shape=shape)
    wrt = tuple(is_active(tangent) for tangent in tangents[:3])
    if not any(wrt):
        return results, [zero_like(jax.typeof(result)) for result in results]
    active = [tangent for tangent, wanted in zip(tangents[:3], wrt, strict=True) if wanted]
    d_results = radiance_tangent_p.bind(*primals[:3], results[0], *primals[3:], *active, shape=shape, wrt=wrt)
    return results, d_results


register_jvp(radiance_p, _radiance_jvp)
register_linear(radiance_tangent_p, radiance_adjoint_p, constants=9)
register_linear(radiance_adjoint_p, radiance_tangent_p, constants=9)
register_linear(depth_p, depth_adjoint_p, constants=5)
register_linear(depth_adjoint_p, depth_p, constants=5)


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

    Differentiable in extinction, emission, behind, once, in forward and reverse mode; not in grid, rays, t_max.
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
