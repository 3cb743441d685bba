"""Light that enters plumes from skin: more of it than a rule of few directions meets."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxir._arrays import as_float
from jaxir._math import scan_anew
from jaxir.geometry import Rays, Sobol, harmonics, no_hit, turned
from jaxir.geometry.search import closest_hit
from jaxir.scene import Lit, Scene
from jaxir.transport._direct import mis_weight
from jaxir.transport._lights import Drawn, Met, SampledLight, emitted, lights_at_particles
from jaxir.transport._method import DirectSampling, Method, SkinLight
from jaxir.transport._paths import Paths
from jaxir.transport._through import Answer, Through
from jaxir.transport._trace import trace

SAMPLES = 128  # directions from a point of the lattice, and again as many to places on the skin
EVERYWHERE = 1 / (4 * np.pi)  # density of the former [sr-1]


def length_of(scene: Scene, rays: Rays) -> Float[Array, " ray"]:
    """How far rays go to the skin [ray] [m]; inf where they leave the scene."""
    return lax.stop_gradient(no_hit(rays.origin) if scene.skin is None else closest_hit(scene.skin.mesh, rays)).t


class Level(NamedTuple):
    """Radiance behind the plumes as it were if there was no skin.

    `closed` is whether no ray leaves the scene: then `glow`, the mean emission of the faces [node].
    """

    closed: Bool[Array, ""]
    glow: Float[Array, " node"]

    def toward(self, lit: Lit, direction: Float[Array, "*batch 3"]) -> Float[Array, "*batch node"]:
        """Radiance that comes from directions."""
        return jnp.where(self.closed, self.glow, lit.surroundings(direction))


def level_of(lit: Lit, length: Array) -> Level:
    """The level of a scene in which rays go that far."""
    if lit.scene.skin is None:
        return Level(jnp.asarray(False), jnp.zeros(lit.nodes.count, length.dtype))
    count = lit.scene.skin.mesh.count
    glow = emitted(lit, jnp.arange(count, dtype=jnp.int32), jnp.ones(count, length.dtype))
    return Level(~jnp.any(jnp.isinf(length)), jnp.mean(glow, axis=0))


def entering(
    lit: Lit,
    method: Method,
    point: Float[Array, "point 3"],
    order: int,
    level: Level,
    behind: Callable[[Lit, Paths, Through], Answer],
) -> Float[Array, "point harmonic node"]:
    """Coefficients of the light that arrives from skin, over the `level` that is there without it.

    The skin's outline lies between the directions of a rule of few: a plate beside a jet is met by more or less of them
    than it should be, and a small nozzle by none. It is looked for in `SAMPLES` directions and at as many places on it,
    drawn by area and temperature, weighted by (9). What that errs varies from point to point of the lattice, of which a
    ray sees many; it is the same whenever a scene is solved.
    """
    scene = lax.stop_gradient(lit.scene)
    none = jnp.zeros((point.shape[0], (order + 1) ** 2, lit.nodes.count), point.dtype)
    if scene.skin is None:
        return none
    begin = lax.stop_gradient(point)
    (lamp,) = lights_at_particles(Scene(scene.skin), Method(direct=DirectSampling(), skin_light=SkinLight()))
    keys = jax.random.split(jax.random.key(0), len(begin))
    drawn = jax.vmap(lambda key, at: _drawn(lamp, key, at), out_axes=1)(keys, begin)

    def add(total: Array, own: tuple[Drawn, Array]) -> tuple[Array, None]:
        drawn, key = own
        paths = trace(scene, Rays(begin, drawn.omega), method, key)
        weight = _weight(lamp, drawn, begin, Met(paths.face, paths.length))
        through = Through(lit)
        passed = through.passed(point, drawn.omega, jnp.where(weight > 0, paths.length, 0))
        reached = behind(lit, paths, through)
        came = (reached() - level.toward(lit, drawn.omega)) * passed() * weight[:, None]
        return total + harmonics(-drawn.omega, order)[:, :, None] * came[:, None], None

    return scan_anew(add, none, (drawn, jax.random.split(jax.random.key(1), 2 * SAMPLES)))[0]


def _drawn(lamp: SampledLight, key: Array, point: Float[Array, " 3"]) -> Drawn:
    """Directions from a point, where any face may be met, face -1, and towards faces that were drawn [sample]."""
    for_all, for_face, for_place = jax.random.split(key, 3)
    u = Sobol().draw(for_all, SAMPLES)
    omega = jax.vmap(turned, (0, 0, None))(1 - 2 * u[:, 0], u[:, 1], as_float(np.array([0.0, 0.0, 1.0])))
    far, everywhere = (jnp.full(SAMPLES, value, omega.dtype) for value in (jnp.inf, EVERYWHERE))
    some = Drawn(omega, far, everywhere, jnp.full(SAMPLES, -1, jnp.int32))
    others = lamp.sample(lambda k: Sobol().draw((for_face, for_place)[k], SAMPLES), point, point)
    return jax.tree.map(lambda *each: jnp.concatenate(each), some, others)


def _weight(lamp: SampledLight, drawn: Drawn, point: Array, met: Met) -> Float[Array, " point"]:
    """Weight (9) over number and density of a direction from each point [point] [sr]; 0 where it met no such face."""
    own, by_lamp = drawn.face >= 0, jax.vmap(lamp.meet)(drawn.omega, point, point, met)[1]
    good = (drawn.pdf > 0) & (met.face >= 0) & (~own | (met.face == drawn.face))
    share = mis_weight(SAMPLES, drawn.pdf, SAMPLES, jnp.where(own, EVERYWHERE, by_lamp))
    return jnp.where(good, share / (SAMPLES * jnp.where(good, drawn.pdf, 1)), 0)
