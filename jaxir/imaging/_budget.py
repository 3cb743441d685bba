"""What is known of the error of radiant intensities, part by part."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxir._math import safe_sqrt

PARTS = {
    "sampling": "of rays within pixels and of sampled light",
    "spectral": "of the spectral nodes",
    "truncation": "orders of scattering beyond the last",
    "outside": "of the scene beyond the frame",
}


class ErrorBudget(eqx.Module):
    """Errors of radiant intensities, one standard deviation or an estimated bias each [W sr-1].

    Of the computation, that is: what the models of gas, air and surfaces err is not in it, nor what they were given.

    Attributes:
        intensity: what the errors are of [*view, band].
        sampling: standard error of the rays [*view, band].
        spectral: what the nodes err, from a comparison with finer ones on a few rays when they were chosen for the
            scene (`jaxir.scene.scene_nodes`) [*view, band]; None for nodes that were given.
        truncation: what orders of scattering beyond the last would add, from the fall of the last two [*view, band];
            0 without particles.
        outside: what of the scene lies beyond the frame, from where it is bright before any ray is traced
            [*view, band].
        bands: band names.

    `print` it for a table.
    """

    intensity: Float[Array, "*view band"]
    sampling: Float[Array, "*view band"]
    spectral: Float[Array, "*view band"] | None
    truncation: Float[Array, "*view band"]
    outside: Float[Array, "*view band"]
    bands: tuple[str, ...] = eqx.field(static=True)

    @property
    @eqx.filter_jit
    def total(self) -> Float[Array, "*view band"]:
        """Root of the sum of the squares of all parts that are known."""
        known = [part for part in (self.sampling, self.spectral, self.truncation, self.outside) if part is not None]
        return safe_sqrt(sum((part * part for part in known), start=jnp.zeros_like(self.intensity)))

    def __str__(self) -> str:
        """A table: a line for each part, of the view that is brightest in the first band."""
        host = jax.tree.map(np.asarray, (self.intensity, self.total, *(getattr(self, name) for name in PARTS)))
        whole = host[0].reshape(-1, len(self.bands))
        brightest = int(np.argmax(np.abs(whole[:, 0])))
        where = "" if len(whole) == 1 else f" of the brightest of {len(whole)} views"
        rows = {"intensity": host[0], **dict(zip(PARTS, host[2:], strict=True)), "total": host[1]}
        width = max(12, *(len(name) + 2 for name in self.bands))
        lines = [f"{f'[W/sr]{where}':12s}" + "".join(f"{name:>{width}s}" for name in self.bands)]
        for name, values in rows.items():
            if values is None:
                lines.append(f"{name:12s}" + f"{'not known':>{width}s}" * len(self.bands) + "  nodes were given")
                continue
            numbers = values.reshape(-1, len(self.bands))[brightest]
            sign = "" if name == "intensity" else "± "
            said = "".join(f"{f'{sign}{x:.{5 if not sign else 2}g}':>{width}s}" for x in numbers.tolist())
            lines.append(f"{name:12s}{said}" + (f"  {PARTS[name]}" if name in PARTS else ""))
        return "\n".join(lines)

    def described(self) -> str:
        """One line for files: the parts of the worst view of each band, in shares of the intensity."""
        host = {name: getattr(self, name) for name in PARTS}
        scale = np.abs(np.asarray(self.intensity, np.float64)).reshape(-1, len(self.bands))
        scale = np.where(scale > 0, scale, np.inf)

        def share(values: Array | None, band: int) -> str:
            if values is None:
                return "not known"
            worst = np.max(np.asarray(values, np.float64).reshape(scale.shape)[:, band] / scale[:, band])
            return f"{worst:.2g}"

        parts = {**host, "total": self.total}
        return "; ".join(
            f"{band}: " + ", ".join(f"{name} {share(values, index)}" for name, values in parts.items())
            for index, band in enumerate(self.bands)
        )


def budget(
    intensity: Float[Array, "*view band"],
    sampling: Float[Array, "*view band"],
    spectral: Float[Array, " band"] | None,
    truncation: Float[Array, "*view band"],
    outside: Float[Array, " band"] | None,
    bands: tuple[str, ...],
) -> ErrorBudget:
    """The budget of intensities whose errors but that of sampling come as shares of them."""

    def times(share: Array | None) -> Array | None:
        return None if share is None else _product(jnp.abs(intensity), share)

    left_out = times(truncation)
    beyond = None if outside is None else times(outside / (1 - outside))  # of what is seen
    assert left_out is not None
    none = jnp.zeros_like(intensity)
    return ErrorBudget(intensity, sampling, times(spectral), left_out, none if beyond is None else beyond, bands)


@jax.jit
def _product(intensity: Array, share: Array) -> Array:
    share = jnp.broadcast_to(share, intensity.shape)
    return jnp.where(share > 0, intensity * share, 0)
