"""A round turbulent jet of exhaust as a function of a few parameters."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from jaxir._arrays import Check, as_float, finite, positive, require_shape
from jaxir._math import frame_around
from jaxir.geometry import Grid
from jaxir.optics.gas import AbstractGas
from jaxir.optics.particle import AbstractParticles
from jaxir.scene.plume import GridPlume


class JetPlume(eqx.Module):
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
        particles: those in pure exhaust at exit temperature, the same everywhere; they follow the gas. None for none.
        core_length: z_core / d.
        spreading: slope of the edge.
        length: where the jet ends [diameters].
        panels: quadrature panels in each of the four pieces of a ray; `resolve_jet` chooses them for a tolerance.

    Differentiable in every field but `panels`, its place and shape included.
    """

    nozzle: Float[Array, " 3"]
    axis: Float[Array, " 3"]
    diameter: Float[Array, ""]
    exit_temperature: Float[Array, ""]
    ambient_temperature: Float[Array, ""]
    gas: AbstractGas
    particles: AbstractParticles | None
    core_length: Float[Array, ""]
    spreading: Float[Array, ""]
    length: Float[Array, ""]
    panels: int = eqx.field(static=True)

    def __init__(
        self,
        nozzle: Any,
        axis: Any,
        diameter: Any,
        exit_temperature: Any,
        ambient_temperature: Any,
        gas: AbstractGas,
        *,
        core_length: Any = 5.0,
        spreading: Any = 0.22,
        length: Any = 50.0,
        panels: int = 4,
        particles: AbstractParticles | None = None,
    ):
        """Convert every parameter to an array; fields as in the class."""
        for name, value, shape in (
            ("nozzle", nozzle, (3,)),
            ("axis", axis, (3,)),
            ("diameter", diameter, ()),
            ("exit_temperature", exit_temperature, ()),
            ("ambient_temperature", ambient_temperature, ()),
            ("core_length", core_length, ()),
            ("spreading", spreading, ()),
            ("length", length, ()),
        ):
            array = as_float(value, f"JetPlume.{name}")
            require_shape(f"JetPlume.{name}", array, shape)
            setattr(self, name, array)
        if panels < 1:
            raise ValueError(f"JetPlume.panels: got {panels}, expected an integer >= 1")
        self.gas = gas
        self.particles = particles
        self.panels = panels

    @property
    def direction(self) -> Float[Array, " 3"]:
        """`axis` with length 1."""
        return self.axis * lax.rsqrt(jnp.sum(self.axis * self.axis))

    @property
    def core_end(self) -> Float[Array, ""]:
        """Distance from the nozzle to the core's end [m]."""
        return self.core_length * self.diameter

    @property
    def end(self) -> Float[Array, ""]:
        """Distance from the nozzle to the jet's end [m]."""
        return self.length * self.diameter

    def stations(self, share: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Distances from the nozzle [*batch] [m] at shares [*batch] of the jet's length, even in ln(z + d / 2)."""
        lip = self.diameter / 2
        return lip * jnp.expm1(share * jnp.log1p(self.end / lip))

    def fraction(self, along: Float[Array, "*batch"], across_squared: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Exhaust fraction f at distances z downstream [*batch] [m] and r^2 from the axis [*batch] [m2]."""
        inside = (along > 0) & (along <= self.end)
        # Nearer to the lip than a millionth of a diameter the shear layer stays as thin as there.
        z = jnp.maximum(jnp.where(inside, along, self.core_end), 1e-6 * self.diameter)
        r, radius = _sqrt(across_squared), self.diameter / 2
        core = radius * jnp.maximum(1 - z / self.core_end, 0)
        layer = self.spreading * z + radius * jnp.minimum(z / self.core_end, 1)
        eta = jnp.clip((r - core) / layer, 0, 1)
        fraction = jnp.minimum(self.core_end / z, 1) * (1 - eta * _sqrt(eta))
        return jnp.where(inside, fraction, 0)

    def temperature(self, fraction: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Temperature of gas with an exhaust fraction [*batch] [K]."""
        return self.ambient_temperature + fraction * (self.exit_temperature - self.ambient_temperature)

    def state(self, points: Float[Array, "*batch 3"]) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Temperature [*batch] [K] and exhaust fraction [*batch] at points [*batch, 3] [m].

        Differentiable in the jet's fields and in `points`, almost everywhere.
        """
        lead = (None,) * (points.ndim - 1)
        offset, axis = points - self.nozzle[lead], self.direction[lead]
        along = jnp.sum(offset * axis, axis=-1)
        across = offset - along[..., None] * axis
        fraction = self.fraction(along, jnp.sum(across * across, axis=-1))
        return self.temperature(fraction), fraction

    def mixture(self, fraction: Float[Array, "*cell"]) -> AbstractGas:
        """The gas at exhaust fractions [*cell], diluted by air and as dense as its temperature makes it."""
        return self.gas.diluted(fraction, self.exit_temperature / self.temperature(fraction))

    def suspension(self, fraction: Float[Array, "*cell"]) -> AbstractParticles | None:
        """The particles at exhaust fractions [*cell], diluted and as dense as the gas; None without."""
        if self.particles is None:
            return None
        return self.particles.diluted(fraction * self.exit_temperature / self.temperature(fraction))

    def with_panels(self, panels: int) -> JetPlume:
        """The same jet, integrated with another number of panels."""
        return JetPlume(
            self.nozzle,
            self.axis,
            self.diameter,
            self.exit_temperature,
            self.ambient_temperature,
            self.gas,
            core_length=self.core_length,
            spreading=self.spreading,
            length=self.length,
            panels=panels,
            particles=self.particles,
        )

    def to_grid(self, grid: Grid) -> GridPlume:
        """The same jet cell by cell, each cell with the state at its centre.

        Differentiable in the jet's fields, almost everywhere.
        """
        temperature, fraction = self.state(grid.centres())
        return GridPlume(grid, temperature, self.mixture(fraction), self.suspension(fraction))

    def extent(self) -> Float[Array, "8 3"]:
        """Points whose convex hull holds the jet [8, 3] [m]: squares about its two ends."""
        u, v, w = frame_around(self.direction)
        near, far = self.diameter / 2, self.diameter / 2 + self.spreading * self.end
        return jnp.stack(
            [
                self.nozzle + z * w + r * (a * u + b * v)
                for z, r in ((jnp.zeros_like(near), near), (self.end, far))
                for a in (-1, 1)
                for b in (-1, 1)
            ]
        )

    def checks(self) -> list[Check]:
        """Lengths and temperatures are positive, the axis has a direction, the gas's fields are in range."""
        square = jnp.sum(self.axis * self.axis)
        return [
            finite("JetPlume.nozzle", self.nozzle),
            Check("JetPlume.axis: squared length", square, jnp.isfinite(square) & (square > 0), "a vector not 0"),
            positive("JetPlume.diameter", self.diameter),
            positive("JetPlume.exit_temperature", self.exit_temperature),
            positive("JetPlume.ambient_temperature", self.ambient_temperature),
            positive("JetPlume.core_length", self.core_length),
            positive("JetPlume.spreading", self.spreading),
            positive("JetPlume.length", self.length),
            *self.gas.checks(),
            *([] if self.particles is None else self.particles.checks()),
        ]


def _sqrt(value: Array) -> Array:
    """Square root of a number >= 0 with a derivative of 0 at 0."""
    return jnp.where(value > 0, jnp.sqrt(jnp.where(value > 0, value, 1)), 0)
