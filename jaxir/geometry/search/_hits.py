"""What one ray asks of a tree, and where it surely meets boxes and faces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxir.geometry import bits, greater, lesser
from jaxir.geometry.search._tree import Tree

NONE = -2  # no face
DOUBT = -1  # rounding leaves open whether a face is met that would come first
NEVER = 3e38  # the distance of what is not met [m]
_ROUNDING = 11.0  # bound of the rounding of an edge's moment, in units of the last place, see `verdict`


class Query(NamedTuple):
    """What single rays ask; every field has one row a ray.

    Attributes:
        origin: [ray, 3] [m].
        direction: [ray, 3], unit.
        near: hits lie beyond this distance [ray] [m].
        far: and before this one [ray] [m]; a ray with far <= near is inactive.
        skip: a face that is not met, -1 for none [ray].
        side: +1 meets only faces whose normal looks along the ray, -1 only faces that look against it, 0 both [ray].
        some: whether any face that is met will do, in place of the first [ray].
    """

    origin: Float[Array, "*ray 3"]
    direction: Float[Array, "*ray 3"]
    near: Float[Array, "*ray"]
    far: Float[Array, "*ray"]
    skip: Int[Array, "*ray"]
    side: Float[Array, "*ray"]
    some: Bool[Array, "*ray"]


def approach(tree: Tree, ray: Query, dtype: Any) -> Query:
    """A ray as searches take it: measured from the tree's centre, in `dtype`, rounded once.

    A distant ray starts its search near the mesh, where a float has the grain of the mesh.
    """
    double = jnp.float64
    origin = ray.origin.astype(double) - tree.centre.astype(double)
    direction = ray.direction.astype(double)
    radius = _radius(tree).astype(double)
    along = -jnp.sum(origin * direction)
    skipped = jnp.where(along > 3 * radius, along - 2 * radius, 0)
    origin = origin + skipped * direction
    near, far = (jnp.clip(t.astype(double) - skipped, -NEVER, NEVER).astype(dtype) for t in (ray.near, ray.far))
    turned = direction.astype(dtype)
    return ray._replace(origin=origin.astype(dtype), direction=turned, near=near, far=far, side=ray.side.astype(dtype))


def _radius(tree: Tree) -> Float[Array, ""]:
    """Distance from the tree's centre within which the mesh lies [m]."""
    return jnp.sqrt(jnp.sum(tree.extent * tree.extent))


def boxes_met(
    sides: Sequence[Float[Array, " box"]], lines: tuple[Array, Array], near: Array, best: Array
) -> Int[Array, ""]:
    """Bits of the boxes from lower x, y, z to upper x, y, z `sides` [m] that a ray of `slopes` may meet.

    Between the distances `near` and `best` [m].
    """
    inverse, shift = lines
    planes = [sides[k] * inverse[k % 3] - shift[k % 3] for k in range(6)]
    enter = [lesser(planes[k], planes[k + 3]) for k in range(3)]
    leave = [greater(planes[k], planes[k + 3]) for k in range(3)]
    start = greater(greater(enter[0], enter[1]), greater(enter[2], near))
    stop = lesser(lesser(leave[0], leave[1]), lesser(leave[2], best))
    return bits(start <= stop)


def slopes(ray: Query) -> tuple[Float[Array, " 3"], Float[Array, " 3"]]:
    """A plane x[k] = c lies at the distance c inverse[k] - shift[k] along a ray: (inverse [m/m], shift [m])."""
    inverse = 1 / jnp.where(jnp.abs(ray.direction) > 1e-20, ray.direction, 1e-20)
    return inverse, ray.origin * inverse


def answer(ray: Query, found: Int[Array, ""], doubt: Bool[Array, ""], settle: bool) -> Int[Array, ""]:
    """The face `found`; or `DOUBT`, unless told to settle or where any face will do and one was met."""
    return found if settle else jnp.where(ray.some & (found >= 0) | ~doubt, found, jnp.int32(DOUBT))


def rounding_bound(tree: Tree, ray: Query) -> Float[Array, ""]:
    """11 eps r of `verdict` [m]."""
    reach = _radius(tree).astype(ray.origin.dtype) + jnp.sqrt(jnp.sum(ray.origin * ray.origin))
    return _ROUNDING * float(jnp.finfo(ray.origin.dtype).eps) * reach


class Edges(NamedTuple):
    """Of the three edges of faces, see `verdict`.

    Attributes:
        moment: the ray's about each, in units of its error.
        error: of the moments [m2].
        depth: along the ray of the corner opposite to each [m].
    """

    moment: Sequence[Array]
    error: Sequence[Array]
    depth: Sequence[Array]


def moments(start: list[Array], stop: list[Array], direction: Array, bound: Array) -> tuple[Array, Array]:
    """Moments of a ray about edges from `start` to `stop`, relative to its origin, in units of their errors; these."""
    sx, sy, sz = (p + q for p, q in zip(start, stop, strict=True))
    ex, ey, ez = (q - p for p, q in zip(start, stop, strict=True))
    dx, dy, dz = direction[0], direction[1], direction[2]
    moment = dx * (sy * ez - sz * ey) + dy * (sz * ex - sx * ez) + dz * (sx * ey - sy * ex)
    error = bound * (jnp.abs(ex) + jnp.abs(ey) + jnp.abs(ez))
    # the division also keeps XLA from computing the moment anew for all that follows
    return moment / jnp.where(error > 0, error, 1), error


def verdict(
    edges: Edges, ray: Query, faces: Int[Array, "..."], best: Float[Array, ""], settle: bool
) -> tuple[Float[Array, "..."], Bool[Array, "..."]]:
    """Where a ray surely meets faces, and which others it may meet.

    With corners p, q of an edge relative to the ray's origin, the ray passes the edge on the side told by the sign of
    direction . ((p + q) x (q - p)), the ray's moment about the edge (Pluecker coordinates). What is computed is the
    moment about an edge whose ends were moved by rounding, plus the rounding of the products. A ray that keeps from
    the three moved edges a distance larger than both is truly inside or truly outside, because no edge crossed it on
    its way. With u = eps / 2, r the largest distance of a corner from the ray's origin and |e| the edge's length,
    moving an edge changes the moment by 4 u r |e| (corners 2 u r, each against the origin) and its products err by
    16.2 u r |e| (7 roundings of terms that sum up to 2 r |e| 2 / sqrt(3)), so by 11 eps r |e| together. Exchanging p
    and q negates every rounded intermediate, so two faces never disagree about the moment of a shared edge.

    Args:
        edges: of the faces.
        ray: one ray, as `approach` gives it.
        faces: their numbers; -1 where one is missing.
        best: distance before which faces are asked for [m].
        settle: a ray within the bound of an edge meets it, and a face that the bound cannot tell from one seen
            edge-on is not met, because its neighbours are.

    Returns:
        t: distances of faces that are met beyond `near`, whatever rounding did [m]; huge for the others.
        unsure: faces of which rounding leaves open whether they are met between `near` and `best`.
    """

    def fold(operation: Callable[..., Array], parts: Sequence[Array]) -> Array:
        return operation(operation(parts[0], parts[1]), parts[2])

    low, high = fold(lesser, edges.moment), fold(greater, edges.moment)
    weight = [moment * error for moment, error in zip(edges.moment, edges.error, strict=True)]
    volume = fold(jnp.add, weight)  # four times the face's area across the ray
    along, against = ray.side >= 0, ray.side <= 0
    first, last = fold(lesser, edges.depth), fold(greater, edges.depth)
    other = faces != ray.skip
    if settle:
        blur = fold(jnp.add, edges.error)
        met = (low >= -1) & along & (volume > blur) | (high <= 1) & against & (volume < -blur)
    else:
        met = (low >= 1) & along | (high <= -1) & against
    possible = ((low >= -1) & along | (high <= 1) & against) & (edges.error[0] > 0) & ~met
    unsure = possible & other & (last > ray.near) & (first < best)
    weighted = fold(jnp.add, [w * depth for w, depth in zip(weight, edges.depth, strict=True)])
    # a hit at or before `near` is none: weighted / volume > near, without a division
    met = met & other & (weighted * jnp.sign(volume) > ray.near * jnp.abs(volume))
    # a division comes last, or XLA computes all this anew for every use of t
    return jnp.where(met, weighted, NEVER) / jnp.where(met, volume, 1), unsure
