"""Estimators of the radiance along a ray through a medium: the exact sum over cells and three sampled ones.

A sampled estimator draws the optical depth x at which a photon sent from the eye would be absorbed, P(x > t) =
exp(-t), and splits the source B between the point where that happens and the line that leads to it: for any w(t)

    S = w(x) B(x) [x < depth]  +  integral_0^min(x, depth) (1 - w(t)) B(t) dt  +  [x >= depth] R

has the mean integral exp(-t) B dt + exp(-depth) R, the radiance in front of the medium with R behind it. Point
integration is w = 1, equation (13) of Yu et al. (10.3788/IRLA20200241), line integration w = 0, equation (16), and
their combination w = 1 - exp(-t), equation (18); the last term is the event of passing through, without which (14)
and (15) as printed are too dark.

Sampling is detached: x fixes a place in a cell, places have no derivative, and the weights exp(-t) / exp(-t held)
carry it. So the derivatives of every estimator are unbiased, which those at a fixed random number are not.
"""

from __future__ import annotations

import abc
import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Key

from jaxir._arrays import require_shape
from jaxir._math import at_once, sum_before
from jaxir._programs import program
from jaxir.geometry import LIST_CHUNK, Crossings, Rays, crossings
from jaxir.medium import CellMedium, crossing_sum
from jaxir.optics import SERIES_BELOW, across_layer, phi1, phi2
from jaxir.scene import Lit
from jaxir.transport._paths import Paths
from jaxir.transport._through import Through
from jaxir.transport.evaluation import behind_plumes


class Layer(NamedTuple):
    """What the variance of one cell depends on; each [node].

    `kept` is exp(-u), `lost` 1 - exp(-u), `source` emission / extinction, `before` the optical depth between the eye
    and the cell, `behind` the radiance behind the cell.
    """

    u: Array
    kept: Array
    lost: Array
    source: Array
    before: Array
    behind: Array


class AbstractPathEstimator(eqx.Module):
    """A way to the radiance along rays whose crossings are known."""

    @abc.abstractmethod
    def radiance(
        self,
        lists: Crossings,
        extinction: Float[Array, "cell node"],
        emission: Float[Array, "cell node"],
        behind: Float[Array, "ray node"],
        u: Float[Array, " ray"],
    ) -> Float[Array, "ray node"]:
        """One sample of the radiance at the origin of each ray.

        Args:
            lists: the cells of each ray, near to far.
            extinction: [cell, node] [m-1], >= 0.
            emission: absorption times source [cell, node] [W m-3 sr-1]; 0 where the extinction is.
            behind: radiance that enters each ray at its end [ray, node] [W m-2 sr-1].
            u: a uniform random number of each ray in [0, 1) [ray].

        Returns:
            Radiance [ray, node] [W m-2 sr-1].

        Raises:
            ValueError: `u` is not one number per ray.

        Differentiable in extinction, emission, behind, without bias, in both modes; not in lists, u.
        """

    @abc.abstractmethod
    def variance(
        self,
        lists: Crossings,
        extinction: Float[Array, "cell node"],
        emission: Float[Array, "cell node"],
        behind: Float[Array, "ray node"],
    ) -> Float[Array, "ray node"]:
        """Variance of one sample of `radiance`, in closed form [ray, node]; arguments as there."""

    @abc.abstractmethod
    def relative_variance(self, depth: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Variance over squared radiance of a homogeneous medium of optical depth `depth` > 0 in front of black."""


class CellSum(AbstractPathEstimator):
    """The exact sum over cells: no variance, and no random number is looked at."""

    def radiance(self, lists, extinction, emission, behind, u):
        """See `AbstractPathEstimator.radiance`; this is `crossing_sum`."""
        return crossing_sum(lists, extinction, emission, behind)

    def variance(self, lists, extinction, emission, behind):
        """See `AbstractPathEstimator.variance`."""
        return jnp.zeros_like(behind)

    def relative_variance(self, depth):
        """See `AbstractPathEstimator.relative_variance`."""
        return jnp.zeros_like(depth)


class PointIntegration(AbstractPathEstimator):
    """The source where the sampled photon is absorbed, equation (13)."""

    def radiance(self, lists, extinction, emission, behind, u):
        """See `AbstractPathEstimator.radiance`."""
        return _sampled(lists, extinction, emission, behind, u, _point)

    def variance(self, lists, extinction, emission, behind):
        """See `AbstractPathEstimator.variance`: V <- kept V + lost kept (B - R)^2 from cell to cell."""

        def own(layer: Layer) -> Array:
            return layer.lost * layer.kept * (layer.source - layer.behind) ** 2

        return _variance(lists, extinction, emission, behind, own)

    def relative_variance(self, depth):
        """1 / (exp(depth) - 1)."""
        return 1 / jnp.expm1(depth)


class LineIntegration(AbstractPathEstimator):
    """The source summed along the way of the sampled photon, equation (16)."""

    def radiance(self, lists, extinction, emission, behind, u):
        """See `AbstractPathEstimator.radiance`."""
        return _sampled(lists, extinction, emission, behind, u, _line)

    def variance(self, lists, extinction, emission, behind):
        """See `AbstractPathEstimator.variance`.

        V <- kept V + B^2 h(u) + kept lost R^2 + 2 kept R B u (1 - phi1(u)), with h of `_line_spread`.
        """

        def own(layer: Layer) -> Array:
            both = 2 * layer.source * layer.u * (layer.u * phi2(layer.u))
            passing = layer.kept * layer.behind * (layer.lost * layer.behind + both)
            return layer.source**2 * _line_spread(layer.u) + passing

        return _variance(lists, extinction, emission, behind, own)

    def relative_variance(self, depth):
        """(1 - 2 depth exp(-depth) - exp(-2 depth)) / (1 - exp(-depth))^2."""
        return _line_spread(depth) / jnp.expm1(-depth) ** 2


class CombinedIntegration(AbstractPathEstimator):
    """Point and line integration weighted by 1 - transmittance and transmittance, equation (18)."""

    def radiance(self, lists, extinction, emission, behind, u):
        """See `AbstractPathEstimator.radiance`."""
        return _sampled(lists, extinction, emission, behind, u, _combined)

    def variance(self, lists, extinction, emission, behind):
        """See `AbstractPathEstimator.variance`.

        V <- kept V + lost^3 T^2 B^2 / 3 + lost kept ((1 - T) B - R)^2, T: transmittance in front of the cell.
        """

        def own(layer: Layer) -> Array:
            jump = -jnp.expm1(-layer.before) * layer.source - layer.behind
            inside = layer.lost**3 * (jnp.exp(-layer.before) * layer.source) ** 2 / 3
            return inside + layer.lost * layer.kept * jump**2

        return _variance(lists, extinction, emission, behind, own)

    def relative_variance(self, depth):
        """(1 - exp(-depth)) / 3."""
        return -jnp.expm1(-depth) / 3


class _Sample(NamedTuple):
    """The sampled photon in every cell of its ray [crossing, node]; geometry and held values carry no derivative."""

    absorbed: Array  # whether it ends in this cell
    length: Array  # how far it comes inside the cell [m]
    depth: Array  # optical depth where it leaves the cell or ends, held
    extinction: Array
    held: Array  # the same extinction, held
    emission: Array
    before: Array  # optical depth before the cell


def _point(s: _Sample) -> Array:
    """Contribution of each cell: j / mu held, times the ratio of the transmittances."""
    end = s.before + s.extinction * s.length
    ratio = jnp.exp(lax.stop_gradient(end) - end)
    return jnp.where(s.absorbed, s.emission / jnp.where(s.absorbed, s.held, 1) * ratio, 0)


def _line(s: _Sample) -> Array:
    """Contribution of each cell: j times the way inside it; the derivative of exp(-t) inside is that of phi1."""
    ratio = jnp.exp(lax.stop_gradient(s.before) - s.before)
    return s.emission * s.length * phi1((s.extinction - s.held) * s.length) * ratio


def _combined(s: _Sample) -> Array:
    """Contribution of each cell: the exact sum up to the end, and the point with weight 1 - exp(-depth)."""
    line = jnp.exp(-s.before) * s.length * phi1(s.extinction * s.length) * s.emission
    return line - jnp.expm1(-s.depth) * _point(s)


def _on_ray(lists: Crossings, *fields: Array) -> tuple[Array, ...]:
    """Fields [cell, node] in the cells of each ray [crossing, ray, node], and the lengths likewise."""
    values = tuple(field.at[lists.cell.T].get(mode="clip") for field in fields)
    return *values, jnp.broadcast_to(lists.length.T[:, :, None], values[0].shape)


def _sampled(lists, extinction, emission, behind, u, contribution):
    """Radiance of one sampled photon per ray; `u` becomes its optical depth, the same in all nodes."""
    require_shape("u", u, (behind.shape[0],))
    mu, j, length = _on_ray(lists, extinction, emission)
    x = -jnp.log1p(-u)[None, :, None]
    held = lax.stop_gradient(mu)
    own, own_held = mu * length, held * length
    before = sum_before(own, 0)
    start = lax.stop_gradient(before)
    come = jnp.clip(x - start, 0, own_held)
    absorbed = (x >= start) & (x - start < own_held)
    share = jnp.where(absorbed, come / jnp.where(absorbed, own_held, 1), jnp.where(x >= start, 1, 0))
    sample = _Sample(absorbed, length * share, start + come, mu, held, j, before)
    depth = jnp.sum(own, axis=0)
    total = lax.stop_gradient(depth)
    through = ~jnp.any(absorbed, axis=0)
    return jnp.sum(contribution(sample), axis=0) + jnp.where(through, jnp.exp(total - depth) * behind, 0)


def _variance(lists, extinction, emission, behind, own):
    """Far to near: V <- exp(-u) V + own(layer), a sum of positive terms, so nothing cancels."""
    mu, j, length = _on_ray(lists, extinction, emission)
    u = mu * length
    before = sum_before(u, 0)

    def step(carry, cell):
        radiance, variance = carry
        mu, j, length, before = cell
        u = mu * length
        source = jnp.where(mu > 0, j / jnp.where(mu > 0, mu, 1), 0)
        layer = Layer(u, jnp.exp(-u), u * phi1(u), source, before, radiance)
        return (across_layer(radiance, mu, j, length), layer.kept * variance + own(layer)), None

    return lax.scan(step, (behind, jnp.zeros_like(behind)), (mu, j, length, before), reverse=True)[0][1]


def _line_spread(u: Array) -> Array:
    """h(u) = 1 - 2 u exp(-u) - exp(-2 u): variance of min(x, u); u^3 / 3 where thin."""
    terms = 20
    small = jnp.minimum(u, SERIES_BELOW)
    series = jnp.zeros_like(u)
    for n in range(terms, 2, -1):
        series = (-1) ** n * (2 / math.factorial(n - 1) - 2**n / math.factorial(n)) + series * small
    large = jnp.maximum(u, SERIES_BELOW)
    thick = 1 - 2 * large * jnp.exp(-large) - jnp.exp(-2 * large)
    return jnp.where(u < SERIES_BELOW, small**3 * series, thick)


@program
def estimate(lit: Lit, paths: Paths, estimator: AbstractPathEstimator, key: Key[Array, ""]) -> Float[Array, "ray node"]:
    """As `evaluate`, with the radiance of a gridded plume along each ray by an estimator.

    Rays are walked `LIST_CHUNK` at a time, so that no list of all rays is stored.

    Args:
        lit: the scene on the nodes, with one gridded plume without particles.
        paths: `trace(scene, rays, method, key)` without bounces.
        estimator: how the radiance in front of skin or background is found.
        key: random key.

    Returns:
        Radiance [ray, node] [W m-2 sr-1].

    Raises:
        ValueError: another plume than one of cells without particles, or paths with bounces.

    Differentiable as `AbstractPathEstimator.radiance`.
    """
    medium = lit.medium
    if not isinstance(medium, CellMedium) or medium.scatters or paths.method.segments() > 1:
        raise ValueError(
            f"estimate: got {type(medium).__name__} and {paths.method.segments()} segments a path, expected one "
            "gridded plume without particles, and no bounces"
        )
    behind = behind_plumes(lit, paths.method, paths.first, True, True, Through(lit))()
    cells = (-1, lit.nodes.count)
    extinction, emission = medium.extinction.reshape(cells), medium.emission.reshape(cells)

    def one(ray: tuple[Array, ...]) -> Array:
        origin, direction, end, radiance, u = (x[None] for x in ray)
        lists = crossings(medium.grid, Rays(origin, direction), end)
        return estimator.radiance(lists, extinction, emission, radiance, u)[0]

    u = jax.random.uniform(key, (paths.rays.count,), behind.dtype)
    each = (paths.rays.origin, paths.rays.direction, paths.length, behind, u)
    return lit.through_air(lax.map(one, each, batch_size=at_once(LIST_CHUNK)))
