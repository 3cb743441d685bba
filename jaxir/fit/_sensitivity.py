"""Where to paint: what every face's emissivity and temperature do to a signature."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from jaxir._arrays import key_or_default
from jaxir._programs import program
from jaxir.fit._measurement import Measurement
from jaxir.fit._observation import Observation, observe
from jaxir.scene import Scene


def sensitivity(
    scene: Scene, measurement: Measurement, band: str, *, key: Key[Array, ""] | None = None
) -> tuple[Float[Array, " face"], Float[Array, " face"]]:
    """Where to paint: derivatives of the summed prediction in every face's emissivity and temperature.

    Args:
        scene: with a `Lambert` skin.
        measurement: its views say what is summed; its values do not count.
        band: name of the band.
        key: random key of the points in the pixels.

    Returns:
        d(W/sr)/d(emissivity) [face] and d(W/sr)/dT [face] [K-1], by one reverse pass.

    Raises:
        ValueError: no Lambert skin, or a band that the measurement lacks.
    """
    names = measurement.nodes.names
    if (
        scene.skin is None
        or not scene.skin.brdf.diffuse
        or not hasattr(scene.skin.brdf, "emissivity")
        or band not in names
    ):
        skin = "no skin" if scene.skin is None else f"{type(scene.skin.brdf).__name__} skin"
        raise ValueError(f"sensitivity: got band {band!r} and {skin}; expected one of {names} and Lambert skin")
    observed = observe(scene, measurement.resolved(scene), key_or_default(key), moving=False)
    return _slopes(observed, scene, names.index(band))


@program
def _slopes(observed: Observation, scene: Scene, band: int) -> tuple[Array, Array]:
    assert scene.skin is not None
    emissivity = getattr(scene.skin.brdf, "emissivity")  # noqa: B009, of a Lambert skin
    per_face = jnp.broadcast_to(emissivity, (scene.skin.mesh.count, emissivity.shape[1]))

    def total(emissivity: Array, temperature: Array) -> Array:
        changed = eqx.tree_at(lambda s: (s.skin.brdf.emissivity, s.skin.temperature), scene, (emissivity, temperature))
        return observed.predict_halves(changed).mean(axis=(0, 1))[:, band].sum()

    by_emissivity, by_temperature = jax.grad(total, argnums=(0, 1))(per_face, scene.skin.temperature)
    return by_emissivity.sum(axis=1), by_temperature
