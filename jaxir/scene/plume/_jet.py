"""A round turbulent jet of exhaust as a function of a few parameters."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxir._arrays import Check, as_float, as_one_program, positive, thermal
from jaxir._fields import count, quantity, require_part
from jaxir._math import dot, frame_around, matmul
from jaxir._plausible import KELVIN, doubt, usual
from jaxir.geometry import Grid, Pieces, Rays, pdf_box
from jaxir.medium import (
    Distance,
    JetMedium,
    JetShape,
    MediumOptics,
    medium_optics,
    meets_jet,
    panel_edges,
    tabulated_jet,
)
from jaxir.optics.gas import AbstractGas
from jaxir.optics.particle import EXAMPLE, AbstractParticles
from jaxir.optics.spectrum import Nodes
from jaxir.scene.plume._grid import GridPlume
from jaxir.scene.plume._plume import AbstractPlume, Proposal, sample_between

STRETCHED = 0.5  # of a jet's length, from which on rays follow its end
CORE = 6  # diameters, about the length of a core: so far rays follow the lip, and less and less as far again
SLABS, LEVELS = 10, 3  # pieces along the axis, and boxes within one another across it
_SQUARE = np.array([[-1, -1, 1, 1], [-1, 1, -1, 1]])  # corners of a square across the axis, 2 wide


class JetPlume(AbstractPlume):
    """A round turbulent jet in still air, self-similar, with a potential core.

    At the distance z downstream of the nozzle and r from the axis the mole fraction of exhaust is

        f = f_axis(z) (1 - eta^1.5),    eta = (r - r_core(z)) / (r_edge(z) - r_core(z)) in [0, 1],
        f_axis = 1 up to the core's end z_core and z_core / z beyond,
        r_core = (d / 2) max(1 - z / z_core, 0),    r_edge = d / 2 + spreading z,

    and zero beyond r_edge, before the nozzle and after the jet's end. Temperature mixes like exhaust (turbulent Lewis
    number 1, equal molar heat capacities): T = T_ambient + f (T_exit - T_ambient). The profile is that of excess
    temperature in Abramovich, The Theory of Turbulent Jets (MIT Press 1963); the straight core and the decay as 1 / z
    are those of Albertson, Dai, Jensen and Rouse, "Diffusion of submerged jets" (Trans. ASCE 115, 1950). Unlike
    Abramovich, who gives the initial region a linear profile, one profile serves both regions, so that the field is
    continuous. Round jets have cores of 4 to 6 diameters and an edge that spreads by 0.2 to 0.27 (both books). Shocks,
    afterburning, buoyancy and a moving atmosphere are not in it.

    Attributes:
        nozzle: centre of the nozzle's exit [3] [m].
        axis: direction in which exhaust flows [3]; any length but 0.
        diameter: d of the nozzle [m].
        exit_temperature: T_exit [K].
        ambient_temperature: T_ambient [K].
        gas: pure exhaust at exit temperature, the same everywhere; mixed with air by `AbstractGas.diluted`.
        core_length: z_core / d.
        spreading: slope of the edge.
        length: where the jet ends [diameters].
        panels: quadrature panels in each of the four pieces of a ray; `resolve_jet` chooses them for a tolerance, and
            `Image.error_budget` tells what they err.
        particles: those in pure exhaust at exit temperature, the same everywhere; they follow the gas. None for none.

    Differentiable in every field but `panels`, once; its place and shape included, but for its ends in images from
    straight abeam, see docs/limits.md.
    """

    nozzle: Float[Array, " 3"] = quantity("m", (3,))
    axis: Float[Array, " 3"] = quantity("1", (3,))
    diameter: Float[Array, ""] = quantity("m", (), (positive, usual(0.01, 10, "m", above="is it in mm?")))
    exit_temperature: Float[Array, ""] = quantity("K", (), (thermal, KELVIN))
    ambient_temperature: Float[Array, ""] = quantity("K", (), (thermal, KELVIN))
    gas: AbstractGas
    core_length: Float[Array, ""] = quantity("1", (), positive, default=5.0, kw_only=True)
    spreading: Float[Array, ""] = quantity("1", (), positive, default=0.22, kw_only=True)
    length: Float[Array, ""] = quantity("1", (), positive, default=50.0, kw_only=True)
    panels: int = count(default=4, kw_only=True)
    particles: AbstractParticles | None = dataclasses.field(default=None, kw_only=True)

    def structure(self) -> None:
        """See `Physical.structure`."""
        require_part("JetPlume.gas", self.gas, AbstractGas, "a gas, e.g. jaxir.GrayGas({})")
        if self.particles is not None:
            require_part("JetPlume.particles", self.particles, AbstractParticles, EXAMPLE)

    @property
    def direction(self) -> Float[Array, " 3"]:
        """`axis` with length 1."""
        return self.axis * lax.rsqrt(jnp.sum(self.axis * self.axis))

    @property
    def shape(self) -> JetShape:
        """Where its exhaust is."""
        core_end, end = self.core_length * self.diameter, self.length * self.diameter
        return JetShape(self.nozzle, self.direction, self.diameter, core_end, end, self.spreading, self.panels)

    def temperature(self, fraction: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Temperature of gas with a mixture fraction [*batch] [K]."""
        return self.ambient_temperature + fraction * (self.exit_temperature - self.ambient_temperature)

    @as_one_program
    def state(self, points: Float[Array, "*batch 3"]) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Temperature [*batch] [K] and mixture fraction [*batch] at points [*batch, 3] [m].

        Differentiable in the jet's fields and in `points`, almost everywhere.
        """
        fraction = self.shape.at(points)
        return self.temperature(fraction), fraction

    def mixture(self, fraction: Float[Array, "*cell"]) -> AbstractGas:
        """The gas at mixture fractions [*cell], diluted by air and as dense as its temperature makes it."""
        return self.gas.diluted(fraction, self.exit_temperature / self.temperature(fraction))

    def suspension(self, fraction: Float[Array, "*cell"]) -> AbstractParticles | None:
        """The particles at mixture fractions [*cell], diluted and as dense as the gas; None without."""
        if self.particles is None:
            return None
        return self.particles.diluted(fraction * self.exit_temperature / self.temperature(fraction))

    def with_panels(self, panels: int) -> JetPlume:
        """The same jet, integrated with another number of panels."""
        return dataclasses.replace(self, panels=panels)

    def refined(self) -> JetPlume:
        """See `AbstractPlume.refined`."""
        return self.with_panels(2 * self.panels)

    def to_grid(self, grid: Grid) -> GridPlume:
        """The same jet cell by cell, each cell with the state at its centre.

        Differentiable in the jet's fields, almost everywhere.
        """
        temperature, fraction = self.state(grid.centres())
        return GridPlume(grid, temperature, self.mixture(fraction), self.suspension(fraction))

    def extent(self) -> Float[Array, "8 3"]:
        """See `AbstractPlume.extent`: squares about its two ends."""
        u, v, w = frame_around(self.direction)
        end = self.shape.end
        near, far = self.diameter / 2, self.shape.edge(end)
        across, up = as_float(_SQUARE)[:, :, None]
        square = across * u[None] + up * v[None]
        return self.nozzle[None] + jnp.concatenate([near * square, end * w[None] + far * square])

    def carried(self, rays: Rays) -> tuple[Rays, Float[Array, " ray"]]:
        """See `AbstractPlume.carried`: as if drawn on a plane through the nozzle, along the axis or across it.

        Beyond `STRETCHED` of the length they move on with the end, and near the lip with that. Elsewhere they neither
        grow with the jet nor stretch: between hot edges that a ray crosses and areas that grow little is left of much.
        """
        rays, held = lax.stop_gradient((rays, self))
        own, was = self._plane(rays.direction[0]), held._plane(rays.direction[0])
        first, second, end = was
        normal = jnp.cross(first, second)
        offset = rays.origin - held.nozzle[None]
        depth = matmul(offset, normal) / dot(rays.direction[0], normal)
        offset = offset - depth[:, None] * rays.direction
        a, b = matmul(offset, first), matmul(offset, second)

        lengthwise, long = end > 0, jnp.where(end > 0, end, 1)
        share = jnp.where(lengthwise, jnp.clip((a / long - STRETCHED) / (1 - STRETCHED), 0, 1), 0)
        further = jnp.where((share > 0) & (share < 1), (own[2] - end) / ((1 - STRETCHED) * long), 0)
        wider = self.diameter / held.diameter - 1  # nothing, with its derivative
        away = jnp.sqrt(a * a + b * b) / held.diameter
        near = jnp.where(lengthwise, jnp.clip(2 - a / (CORE * held.diameter), 0, 1), jnp.clip((3 - away) / 2, 0, 1))
        falls = jnp.where((near > 0) & (near < 1), away / 2, 0)  # across it: how much sooner circles end to grow
        in_first = jnp.where(lengthwise, 0, near * wider)
        in_second = near * wider

        def area(plane: tuple[Array, Array, Array]) -> Array:
            return jnp.abs(dot(jnp.cross(plane[0], plane[1]), rays.direction[0]))

        place = self.nozzle[None] + (a * (1 + in_first) + share * (own[2] - end))[:, None] * own[0][None]
        place = place + (b * (1 + in_second))[:, None] * own[1][None]
        moved = place - (held.nozzle[None] + a[:, None] * first[None] + b[:, None] * second[None])
        grown = (1 + further) * (1 + jnp.where(lengthwise, 0, (near - falls) * wider)) * (1 + in_second)
        return Rays(rays.origin + moved, rays.direction), grown * area(own) / area(was)

    def _plane(self, toward: Float[Array, " 3"]) -> tuple[Array, Array, Array]:
        """Two directions of a plane that rays cross steeply, and where along the first the jet ends; 0 across it."""
        u, v, w = frame_around(self.direction)
        beside = jnp.cross(w, toward)
        square = dot(beside, beside)
        along = lax.stop_gradient(square) > 0.25
        beside = beside * lax.rsqrt(jnp.where(along, square, 1))
        return jnp.where(along, w, u), jnp.where(along, beside, v), jnp.where(along, self.shape.end, 0)

    def medium(self, nodes: Nodes) -> JetMedium:
        """See `AbstractPlume.medium`. Differentiable in the jet's fields."""

        def optics(fraction: Array) -> MediumOptics:
            return medium_optics(self.mixture(fraction), self.suspension(fraction), nodes, self.temperature(fraction))

        return tabulated_jet(self.shape, optics, None if self.particles is None else self.particles.optics(nodes).phase)

    def meets(self, rays: Rays, t_max: Float[Array, " ray"]) -> Bool[Array, " ray"]:
        """See `AbstractPlume.meets`."""
        return meets_jet(self.shape, rays, t_max)

    def route(self, rays: Rays, t_max: Float[Array, " ray"]) -> None:
        """See `AbstractPlume.route`: a jet moves with its parameters."""
        return None

    def cuts(self, rays: Rays, t_max: Float[Array, " ray"]) -> Float[Array, "ray cut"]:
        """See `AbstractPlume.cuts`."""
        return panel_edges(self.shape, rays, t_max)

    def pieces(self, exponent: Float[Array, ""]) -> Pieces:
        """See `AbstractPlume.pieces`: slabs along the axis, each of boxes whose densities add up to the emission."""
        shape = self.shape
        z = shape.stations(as_float(np.arange(2 * SLABS + 1) / (2 * SLABS)))  # slabs as long as they are wide, about
        begin, middle, end = z[:-1:2], z[1::2], z[2::2]
        level = as_float((np.arange(LEVELS) + 0.5) / LEVELS)
        r = level[None] * shape.edge(middle)[:, None]
        fraction = shape.mixture_fraction(jnp.broadcast_to(middle[:, None], r.shape), r * r)
        temperature = self.temperature(fraction)
        warmth = temperature / self.exit_temperature
        emitted = fraction * (self.exit_temperature / temperature) * warmth**exponent
        step = jnp.maximum(emitted - jnp.pad(emitted[:, 1:], ((0, 0), (0, 1))), 0)
        width = as_float((np.arange(LEVELS) + 1) / LEVELS)[None] * shape.edge(end)[:, None]
        along = jnp.broadcast_to((end - begin)[:, None] / 2, width.shape)
        half = jnp.stack([width, width, along]).reshape(3, -1)
        frame = frame_around(self.direction)
        place = jnp.broadcast_to((begin + end)[:, None] / 2, width.shape).reshape(1, -1)
        centre = matmul(frame, self.nozzle)[:, None] + jnp.pad(place, ((2, 0), (0, 0)))
        return Pieces(frame, centre, half, step.reshape(-1) / pdf_box(half))

    @property
    def parametric(self) -> bool:
        """See `AbstractPlume.parametric`."""
        return True

    @property
    def scatters(self) -> bool:
        """See `AbstractPlume.scatters`."""
        return self.particles is not None

    @property
    def sums_beams(self) -> bool:
        """See `AbstractPlume.sums_beams`."""
        return False

    def proposals(self, point: Float[Array, "ray 3"]) -> tuple[Proposal, ...]:
        """See `AbstractPlume.proposals`."""
        if self.particles is None:
            return ()
        extinction, phase = self.particles.proposal()
        temperature, fraction = self.state(point)
        return (Proposal(extinction * fraction * self.exit_temperature / temperature, phase),)

    def sample_distance(
        self, rays: Rays, t_max: Float[Array, " ray"], u: Float[Array, " ray"], forced: Bool[Array, " ray"]
    ) -> Distance:
        """See `AbstractPlume.sample_distance`."""
        return sample_between(self, rays, t_max, u, forced)

    def hottest(self) -> Float[Array, ""]:
        """See `AbstractPlume.hottest`."""
        return jnp.maximum(self.exit_temperature, self.ambient_temperature)

    def described(self) -> str:
        """See `AbstractPlume.described`."""
        return "jet"

    def outlines(self) -> list[np.ndarray]:
        """See `AbstractPlume.outlines`: rings about the axis, and lines along the edge."""
        nozzle, along = np.asarray(self.nozzle, np.float64), np.asarray(self.direction, np.float64)
        side = np.linalg.svd(along[None])[2][1:]
        turn = np.linspace(0, 2 * np.pi, 33)
        around = np.cos(turn)[:, None] * side[0] + np.sin(turn)[:, None] * side[1]
        radius, end, spread = float(self.diameter) / 2, float(self.shape.end), float(self.spreading)
        rings = [nozzle + z * along + (radius + spread * z) * around for z in np.linspace(0, end, 6)]
        return [*rings, *(np.stack([rings[0][k], rings[-1][k]]) for k in range(0, 32, 8))]

    def doubts(self) -> list[Check]:
        """Exhaust is warmer than the air, and the gas's data reach both."""
        leaving, still = self.exit_temperature, self.ambient_temperature
        swapped = "at least ambient_temperature as a rule; are the two swapped?"
        return [
            doubt("JetPlume.exit_temperature", np.greater_equal, swapped, leaving, still),
            *self.gas.reaches("JetPlume.exit_temperature", leaving),
            *self.gas.reaches("JetPlume.ambient_temperature", still),
        ]

    def relations(self) -> list[Check]:
        """The axis has a direction."""
        square = jnp.sum(self.axis * self.axis)
        return [Check("JetPlume.axis: squared length", square, jnp.isfinite(square) & (square > 0), "a vector not 0")]
