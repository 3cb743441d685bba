"""What a fit may change: leaves of a scene, with bounds and the coordinate in which the solver moves.

The solver works in an unbounded coordinate z in which a unit step is a natural one:

    bounded on both sides   x = lower + (upper - lower) / (1 + e^{-z})      (logit)
    bounded below           x = lower + e^z                                 (log)
    unbounded               x = x_start + scale z

so a fit never leaves its bounds and a damped step means the same for an emissivity and for a temperature.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxir._arrays import as_float, float_dtype
from jaxir.scene import Scene

Where = Callable[[Scene], Any]


NEAR_BOUND = 1e-3  # share of the interval, or of the way from the start, within which a value is at its bound


class Bounds(eqx.Module):
    """Limits of a parameter and the coordinate that keeps it inside.

    Attributes:
        lower: -inf for none.
        upper: inf for none; a finite upper bound needs a finite lower one.
        scale: natural step of an unbounded parameter, in its unit; None for the size of its start, 1 where that is 0.
    """

    lower: float = eqx.field(static=True)
    upper: float = eqx.field(static=True)
    scale: float | None = eqx.field(static=True)

    def __init__(self, lower: float = -math.inf, upper: float = math.inf, scale: float | None = None):
        """Check and keep; the limits are structure, so other limits compile anew."""
        self.lower, self.upper, self.scale = float(lower), float(upper), None if scale is None else float(scale)
        if not self.lower < self.upper or not (self.scale is None or 0 < self.scale < math.inf):
            raise ValueError(f"Bounds: got {lower}, {upper}, scale {scale}; expected lower < upper and scale > 0")
        if math.isinf(self.lower) and not math.isinf(self.upper):
            raise ValueError(f"Bounds: got an upper bound {upper} without a lower one, expected both or only the lower")

    def to_coordinate(self, value: Float[Array, " k"]) -> Float[Array, " k"]:
        """The unbounded coordinate z of values inside the bounds (z = 0 for unbounded ones: they start there)."""
        if math.isinf(self.lower):
            return jnp.zeros_like(value)
        if math.isinf(self.upper):
            return jnp.log(value - self.lower)
        share = (value - self.lower) / (self.upper - self.lower)
        return jnp.log(share) - jnp.log1p(-share)

    def step(self, start: Float[Array, " k"]) -> Float[Array, " k"]:
        """Natural steps of unbounded values that have such a start, in their unit."""
        if self.scale is not None:
            return jnp.full_like(start, self.scale)
        return lax.stop_gradient(jnp.where(start != 0, jnp.abs(start), 1))

    def to_value(self, z: Float[Array, " k"], start: Float[Array, " k"]) -> Float[Array, " k"]:
        """The value at coordinate z; `start` is where an unbounded parameter has z = 0. Differentiable in z."""
        if math.isinf(self.lower):
            return start + self.step(start) * z
        if math.isinf(self.upper):
            return self.lower + jnp.exp(z)
        return self.lower + (self.upper - self.lower) * jax.nn.sigmoid(z)


class AbstractParameter(eqx.Module):
    """A named vector of numbers that a fit may change in a scene.

    Attributes:
        name: how results are labelled.
        where: picks the leaf, as in `equinox.tree_at`.
        bounds: limits.
        unit: for the table.
    """

    name: eqx.AbstractVar[str]
    where: eqx.AbstractVar[Where]
    bounds: eqx.AbstractVar[Bounds]
    unit: eqx.AbstractVar[str]

    @abc.abstractmethod
    def read(self, scene: Scene) -> Float[Array, " k"]:
        """Its value in a scene [k]."""

    @abc.abstractmethod
    def write(self, scene: Scene, value: Float[Array, " k"]) -> Scene:
        """The scene with another value. Differentiable in `value`."""


class Leaf(AbstractParameter):
    """Every number of one leaf of the scene; unbounded unless told otherwise. Attributes as `AbstractParameter`."""

    name: str = eqx.field(static=True)
    where: Where = eqx.field(static=True)
    bounds: Bounds = Bounds()
    unit: str = eqx.field(static=True, default="")

    def read(self, scene: Scene) -> Float[Array, " k"]:
        """See `AbstractParameter.read`."""
        return self.where(scene).reshape(-1)

    def write(self, scene: Scene, value: Float[Array, " k"]) -> Scene:
        """See `AbstractParameter.write`."""
        return eqx.tree_at(self.where, scene, value.reshape(self.where(scene).shape))


class PartValue(AbstractParameter):
    """One value of a per-face leaf [face or 1, ...] for all faces of one part of the skin.

    Attributes:
        name, where, bounds, unit: as `AbstractParameter`.
        part: the part's name, among `Skin.part_names`.
    """

    name: str = eqx.field(static=True)
    where: Where = eqx.field(static=True)
    bounds: Bounds = Bounds()
    unit: str = eqx.field(static=True, default="")
    part: str = eqx.field(static=True, kw_only=True)

    def _faces(self, scene: Scene) -> Array:
        if scene.skin is None or self.part not in scene.skin.part_names:
            names = () if scene.skin is None else scene.skin.part_names
            raise ValueError(f"{self.name}: got part {self.part!r}, expected one of {names}")
        return scene.skin.part == scene.skin.part_names.index(self.part)

    def read(self, scene: Scene) -> Float[Array, " k"]:
        """See `AbstractParameter.read`: the value of the part's first face."""
        leaf = self.where(scene)
        first = jnp.argmax(self._faces(scene))
        return leaf[first if leaf.shape[0] > 1 else 0].reshape(-1)

    def write(self, scene: Scene, value: Float[Array, " k"]) -> Scene:
        """See `AbstractParameter.write`."""
        leaf = self.where(scene)
        faces = self._faces(scene)
        spread = jnp.broadcast_to(leaf, faces.shape + leaf.shape[1:])
        mine = faces.reshape(faces.shape + (1,) * (leaf.ndim - 1))
        return eqx.tree_at(self.where, scene, jnp.where(mine, value.reshape((1,) + leaf.shape[1:]), spread))


class Factor(AbstractParameter):
    """One factor, 1 at the start, on leaves of the scene as they stand: scales a field and keeps its form.

    Attributes:
        name, bounds, unit: as `AbstractParameter`; positive unless told otherwise.
        where: picks one leaf, or several as a tuple, such as the mole fractions of one exhaust.
    """

    name: str = eqx.field(static=True)
    where: Where = eqx.field(static=True)
    bounds: Bounds = Bounds(0.0)
    unit: str = eqx.field(static=True, default="")

    def read(self, scene: Scene) -> Float[Array, " k"]:
        """See `AbstractParameter.read`: 1."""
        if not jax.tree.leaves(self.where(scene)):
            raise TypeError("got no leaf")
        return jnp.ones((1,), float_dtype())

    def write(self, scene: Scene, value: Float[Array, " k"]) -> Scene:
        """See `AbstractParameter.write`."""
        return eqx.tree_at(self.where, scene, replace_fn=lambda leaf: leaf * value.reshape((1,) * leaf.ndim))


class Coordinates(eqx.Module):
    """All parameters of a fit as one vector z.

    Attributes:
        parameters: in order.
        start: the scene at the start.
        sizes: how many numbers each parameter has.
    """

    parameters: tuple[AbstractParameter, ...]
    start: Scene
    sizes: tuple[int, ...] = eqx.field(static=True)

    def __init__(self, parameters: Any, start: Scene):
        """Read the start; names must differ and start values lie inside the bounds."""
        self.parameters = tuple(parameters)
        self.start = start
        names = [p.name for p in self.parameters]
        if not names or len(set(names)) != len(names):
            raise ValueError(f"parameters: got names {names}, expected at least one and no name twice")
        values = [_read(p, start) for p in self.parameters]
        self.sizes = tuple(value.shape[0] for value in values)
        for p, value in zip(self.parameters, values, strict=True):
            inside = (value > p.bounds.lower) & (value < p.bounds.upper)
            if not isinstance(inside, jax.core.Tracer) and not bool(inside.all()):
                raise ValueError(
                    f"{p.name}: got start {float(value[jnp.argmin(inside)]):.6g}, "
                    f"expected it inside its bounds ({p.bounds.lower}, {p.bounds.upper})"
                )

    @property
    def count(self) -> int:
        """How many numbers are fitted."""
        return sum(self.sizes)

    @property
    def labels(self) -> tuple[str, ...]:
        """A label for every number."""
        each = zip(self.parameters, self.sizes, strict=True)
        return tuple(label for p, size in each for label in numbered(p.name, size))

    @property
    def units(self) -> tuple[str, ...]:
        """A unit for every number."""
        return tuple(p.unit for p, size in zip(self.parameters, self.sizes, strict=True) for _ in range(size))

    def pieces(self, vector: Float[Array, " p"]) -> list[Array]:
        """The numbers of each parameter."""
        ends = [sum(self.sizes[: i + 1]) for i in range(len(self.sizes))]
        return [vector[end - size : end] for end, size in zip(ends, self.sizes, strict=True)]

    def origin(self) -> Float[Array, " p"]:
        """z of the start."""
        return jnp.concatenate([p.bounds.to_coordinate(p.read(self.start)) for p in self.parameters])

    def values(self, z: Float[Array, " p"]) -> Float[Array, " p"]:
        """Physical values at z. Differentiable."""
        pieces = zip(self.parameters, self.pieces(z), strict=True)
        return jnp.concatenate([p.bounds.to_value(piece, p.read(self.start)) for p, piece in pieces])

    def scene(self, values: Float[Array, " p"]) -> Scene:
        """The scene with physical values. Differentiable."""
        scene = self.start
        for parameter, piece in zip(self.parameters, self.pieces(values), strict=True):
            scene = parameter.write(scene, piece)
        return scene

    def slope(self, z: Float[Array, " p"]) -> Float[Array, " p"]:
        """dx/dz of every number at z."""
        return jax.jvp(self.values, (z,), (jnp.ones_like(z),))[1]


def _read(parameter: AbstractParameter, start: Scene) -> Float[Array, " k"]:
    """Its value at the start, or `ValueError` where the scene has not what `where` picks."""
    try:
        return parameter.read(start)
    except (AttributeError, IndexError, TypeError) as error:
        raise ValueError(f"{parameter.name}: where: {error}, expected arrays that the scene has") from error


def at_bounds(coordinates: Coordinates, values: Float[Array, " p"]) -> tuple[str, ...]:
    """What is said of the fitted numbers that lie at a bound, as far as their coordinate can bring them there."""
    said, label = [], iter(coordinates.labels)
    for p, piece in zip(coordinates.parameters, coordinates.pieces(values), strict=True):
        start = np.asarray(p.read(coordinates.start), np.float64)
        low, high = p.bounds.lower, p.bounds.upper
        for value, begin in zip(np.asarray(piece, np.float64), start, strict=True):
            name = next(label)
            span = high - low if math.isfinite(high) else begin - low
            if math.isfinite(low) and value - low < NEAR_BOUND * span:
                said.append(f"{name} is at its lower bound {low:g}")
            elif math.isfinite(high) and high - value < NEAR_BOUND * span:
                said.append(f"{name} is at its upper bound {high:g}")
    return tuple(said)


def at_values(coordinates: Coordinates, values: Any) -> Float[Array, " p"]:
    """z of given physical values [p] inside the bounds."""
    vector = as_float(values, "values")
    pieces = coordinates.pieces(vector)
    z = []
    for p, piece in zip(coordinates.parameters, pieces, strict=True):
        if math.isinf(p.bounds.lower):
            begin = p.read(coordinates.start)
            z.append((piece - begin) / p.bounds.step(begin))
        else:
            z.append(p.bounds.to_coordinate(piece))
    return jnp.concatenate(z)


def numbered(name: str, count: int) -> list[str]:
    """A label for every number of what bears a name."""
    return [name] if count == 1 else [f"{name}[{i}]" for i in range(count)]
