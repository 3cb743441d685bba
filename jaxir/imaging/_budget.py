"""What is known of the error of radiant intensities, part by part."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxir._math import safe_sqrt
from jaxir._programs import program
from jaxir.imaging._left_out import Asked

PARTS = {
    "sampling": "of rays within pixels and of sampled light",
    "spectral": "of the spectral nodes",
    "quadrature": "of the integrals along rays through jets and sunlit cells",
    "truncation": "scattered light that is left out",
    "bounces": "bounces from skin beyond the last",
    "outside": "of the scene beyond the frame",
}
ABOUT = {**PARTS, "total": "in 19 of 20 cases: twice sampling, with the others, root of squares"}
ROUGH = 1.25  # times what is outside: brightness without rays errs by so much
COVERAGE = 2  # standard errors of sampling that the total counts


class ErrorBudget(eqx.Module):
    """Errors of radiant intensities, one standard deviation or an estimated bias each [W sr-1].

    Of the computation, that is: what the models of gas, air and surfaces err is not in it, nor what they were given.

    Attributes:
        intensity: what the errors are of [*view, band].
        sampling: standard error of the rays [*view, band].
        spectral: what the nodes err, from a comparison with finer ones on a few rays (`jaxir.scene.scene_nodes`)
            [*view, band]; None where that is not known.
        quadrature: what the panels of jets err, from twice as many on a few rays, and cells in parallel light, as it
            changes from one to the next [*view, band]; None where that is not known, as for bounces.
        truncation: what is left out of what particles scatter, see `Image.truncation` [*view, band].
        bounces: what bounces from skin beyond the last would add, from few paths followed further [*view, band]; None
            where that is not known: not looked for, inside jit, and with `Method.ambient`.
        outside: what of the scene lies beyond the frame, from where it is bright before any ray is traced
            [*view, band]; None inside jit.
        bands: band names.

    `print` it for a table.
    """

    intensity: Float[Array, "*view band"]
    sampling: Float[Array, "*view band"]
    spectral: Float[Array, "*view band"] | None
    quadrature: Float[Array, "*view band"] | None
    truncation: Float[Array, "*view band"]
    bounces: Float[Array, "*view band"] | None
    outside: Float[Array, "*view band"] | None
    bands: tuple[str, ...] = eqx.field(static=True)

    @property
    def parts(self) -> dict[str, Float[Array, "*view band"] | None]:
        """The parts by name; None for one that is not known."""
        return {name: getattr(self, name) for name in PARTS}

    @property
    def counted(self) -> dict[str, Float[Array, "*view band"] | None]:
        """The parts as they count in the total: that of sampling `COVERAGE` times."""
        return {**self.parts, "sampling": COVERAGE * self.sampling}

    @property
    def total(self) -> Float[Array, "*view band"]:
        """What the error stays below in about 19 of 20 cases [*view, band].

        Root of the sum of the squares of all parts that are known, of which sampling counts `COVERAGE` times.
        """
        return _total([part for part in self.counted.values() if part is not None])

    @property
    def brightest(self) -> ErrorBudget:
        """The budget [band] of the view that is brightest in the first band."""
        count = len(self.bands)
        view = int(np.argmax(np.abs(np.asarray(self.intensity).reshape(-1, count)[:, 0])))
        return jax.tree.map(lambda leaf: leaf.reshape(-1, count)[view], self)

    def __str__(self) -> str:
        """A table: a line for each part, of the view that is brightest in the first band."""
        one, views = self.brightest, self.intensity.size // len(self.bands)
        where = "" if views == 1 else f" of the brightest of {views} views"
        width = max(12, *(len(name) + 2 for name in self.bands))
        lines = [f"{f'[W/sr]{where}':12s}" + "".join(f"{name:>{width}s}" for name in self.bands)]
        for name, values in {"intensity": one.intensity, **one.written()}.items():
            sign, digits = ("", 5) if name == "intensity" else ("± ", 2)
            numbers = ["not known"] * len(self.bands)
            if values is not None:
                numbers = [f"{sign}{x:.{digits}g}" for x in np.asarray(values).tolist()]
            row = "".join(f"{number:>{width}s}" for number in numbers)
            lines.append(f"{name:12s}{row}  {ABOUT.get(name, '')}".rstrip())
        return "\n".join(lines)

    def described(self) -> str:
        """One line for files: the parts of the worst view of each band, as shares of its intensity."""

        def share(values: Array | None, band: int) -> str:
            if values is None:
                return "not known"
            return f"{np.max(self.shares(values).reshape(-1, len(self.bands))[:, band]):.2g}"

        several = " of the worst view of each band" if self.intensity.size > len(self.bands) else ""
        return f"as shares of the intensity{several}: " + "; ".join(
            f"{band}: " + ", ".join(f"{name} {share(values, index)}" for name, values in self.written().items())
            for index, band in enumerate(self.bands)
        )

    def shares(self, values: Array) -> Float[np.ndarray, "*view band"]:
        """Errors as shares of the intensity; of a dark band inf, or 0 where they are."""
        scale, errors = np.abs(np.asarray(self.intensity, np.float64)), np.asarray(values, np.float64)
        return np.divide(errors, scale, out=np.where(errors > 0, np.inf, 0.0), where=scale > 0)

    def written(self) -> dict[str, Float[Array, "*view band"] | None]:
        """The parts and the total by name, as they go into files."""
        return {**self.parts, "total": self.total}


def budget(
    intensity: Float[Array, "*view band"],
    sampling: Float[Array, "*view band"],
    contrast: Float[Array, "*view band"],
    spectral: Float[Array, "*each band"] | None,
    truncation: Float[Array, "*view band"],
    bands: tuple[str, ...],
    asked: Asked | None,
    look: bool,
) -> ErrorBudget:
    """The budget of intensities; orders come as shares of them, nodes as shares of the contrast.

    What nodes err of a hot plume stays where a cold plate beside it makes the intensity vanish. What is not known yet
    is found where it is known what was `asked`, by rays only with `look`.
    """
    left_out = _product(jnp.abs(intensity), truncation)
    of_views = intensity.ndim > 1
    outside = jnp.zeros_like(intensity) if of_views else None  # their frames hold the scene
    quadrature = bounces = None
    if asked is not None and not isinstance(intensity, jax.core.Tracer):
        spectral = asked.spectral(look) if spectral is None else spectral
        quadrature = asked.quadrature(look)
        outside = ROUGH * asked.outside() if outside is None else outside
        if asked.left is None or (look and of_views):  # what is known is of the worst view
            bounces = asked.bounces(look)
        else:
            bounces = _product(jnp.abs(intensity), asked.left)
    by_nodes = None if spectral is None else _product(contrast, spectral)
    return ErrorBudget(intensity, sampling, by_nodes, quadrature, left_out, bounces, outside, bands)


@program
def _total(parts: list[Array]) -> Array:
    square = jnp.sum(jnp.stack(parts) ** 2, axis=0)
    return jnp.where(jnp.isnan(square), square, safe_sqrt(square))


@program
def _product(whole: Array, share: Array) -> Array:
    share = jnp.broadcast_to(share, whole.shape)
    some = (share > 0) & (share < jnp.inf)
    return jnp.where(some, whole * jnp.where(some, share, 0), jnp.where(share > 0, jnp.inf, 0))
