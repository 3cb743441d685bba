"""Spectral bands and the nodes on which every spectral quantity lives.

A node is one (bin, g) pair: a wavenumber bin, a place in the cumulative distribution of the absorption coefficient
inside it, and a quadrature weight. Radiance at a node is integrated over the node's bin, so the in-band radiance is

    L_band = sum_node response[band, node] * weight[node] * L_node,

and a gray band is one node of weight 1.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from jaxir._arrays import Check, as_float, float_dtype, known, on_host, require
from jaxir._math import matmul
from jaxir._plausible import usual

_MICROMETRES = usual(0.1, 100, "um", below="is it in m?", above="is it in nm or cm-1?")
_INSIDE = (np.arange(256) + 0.5) / 256  # places in a bin where a response is read
SECOND_RADIATION = 1.4387768775039337  # c2 = h c / k [cm K], exact since 2019 (CODATA 2018)


class Band(eqx.Module):
    """A wavelength interval with a name and, if it is a sensor's, a spectral response.

    Attributes:
        name: how results are labelled.
        lower: shorter wavelength [um].
        upper: longer wavelength [um].
        response: relative spectral response as (wavelength [um], response) pairs, linear between them; None is 1
            from edge to edge. See `sensor_band`.
    """

    name: str = eqx.field(static=True)
    lower: float = eqx.field(static=True)
    upper: float = eqx.field(static=True)
    response: tuple[tuple[float, float], ...] | None = eqx.field(static=True)

    def __init__(self, name: str, lower: float, upper: float, response: tuple[tuple[float, float], ...] | None = None):
        """Check and keep the edges; they are structure, so a new band compiles anew."""
        self.name, self.lower, self.upper = str(name), float(lower), float(upper)
        self.response = response
        if not self.name.isprintable() or not self.name.strip():
            raise ValueError(f"Band.name: got {self.name!r}, expected a name that prints on one line")
        if not (math.isfinite(self.lower) and math.isfinite(self.upper) and 0 < self.lower < self.upper):
            raise ValueError(
                f"Band {self.name!r}: got edges {self.lower}, {self.upper} um, expected 0 < lower < upper, finite"
            )
        require([_MICROMETRES(f"Band {self.name!r}", min(max(1.0, self.lower), self.upper))])  # what is nearest to 1 um
        if self.response is not None:
            wavelength = [pair[0] for pair in self.response]
            if wavelength != sorted(set(wavelength)) or (wavelength[0], wavelength[-1]) != (self.lower, self.upper):
                raise ValueError(
                    f"Band {self.name!r}.response: got wavelengths {wavelength[:3]} ... {wavelength[-1:]}, expected "
                    f"increasing ones from {self.lower} to {self.upper} um; `sensor_band` takes the edges from them"
                )
            if not all(math.isfinite(value) and value >= 0 for _, value in self.response):
                raise ValueError(f"Band {self.name!r}.response: expected finite values >= 0")

    def mean_response(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Mean response over wavenumber bins [bin] (edges in cm-1, inside the band), in double precision."""
        return self._at(lower, upper).mean(axis=1)

    def response_moment(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Mean over bins of the response times the distance from the bin's middle [bin] [cm-1]."""
        return (self._at(lower, upper) * (_INSIDE - 0.5)).mean(axis=1) * (upper - lower)

    def _at(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Response at even places of bins [bin, place]."""
        if self.response is None:
            return np.ones((lower.size, 1))
        wavelength, response = np.array(self.response).T
        inside = lower[:, None] + (upper - lower)[:, None] * _INSIDE
        return np.interp(1e4 / inside, wavelength, response)


def sensor_band(name: str, wavelength: ArrayLike, response: ArrayLike) -> Band:
    """A band with a tabulated relative spectral response.

    Args:
        name: how results are labelled.
        wavelength: increasing wavelengths [sample] [um]; the first and the last are the band's edges.
        response: response at them [sample], >= 0, linear between; results are weighted with it as it is, so a peak
            of 1 gives the radiance that a perfect sensor of that peak would report.

    Returns:
        The band.

    Raises:
        ValueError: fewer than two samples, unequal lengths, wavelengths not increasing, negative response.
    """
    where, value = np.asarray(wavelength, np.float64), np.asarray(response, np.float64)
    if where.ndim != 1 or where.shape != value.shape or where.size < 2:
        raise ValueError(
            f"sensor_band {name!r}: got wavelength {where.shape} and response {value.shape}, "
            "expected two equal lengths >= 2"
        )
    return Band(name, float(where[0]), float(where[-1]), tuple(zip(where.tolist(), value.tolist(), strict=True)))


SWIR = Band("SWIR", 1.0, 3.0)
MWIR = Band("MWIR", 3.0, 5.0)
LWIR = Band("LWIR", 8.0, 12.0)


class Nodes(eqx.Module):
    """The spectral axis of a computation.

    Attributes:
        lower: lower wavenumber edge of each node's bin [node] [cm-1].
        upper: upper wavenumber edge [node] [cm-1].
        edge: c2 * (lower, upper) as a leading part and a remainder [node, 2, 2] [K]; the remainder keeps the
            exponent of Planck's law right in float32.
        g: quantiles in the distribution of the absorption coefficient [node, 2] (two, because two gases overlap
            independently); 1/2 for a gray node.
        slot: for which share of its bin, ranked by absorption, a node stands: where it begins, and how large it is, for
            either quantile [node, 2, 2]; 0 and 1 for a gray node. Nodes of one quantile share it.
        weight: quadrature weight of the node inside its bin [node]; sums to 1 over a bin, but for nodes that stand for
            others, too, see `jaxir.optimal_nodes`.
        response: sensor response of each band at each node [band, node]; 0 outside the band.
        names: band labels.
        error: relative error that the nodes leave in the bands of the scene for which they were chosen, estimated
            [band]; None where they were not chosen for one.
    """

    lower: Float[Array, " node"]
    upper: Float[Array, " node"]
    edge: Float[Array, "node 2 2"]
    g: Float[Array, "node 2"]
    slot: Float[Array, "node 2 2"]
    weight: Float[Array, " node"]
    response: Float[Array, "band node"]
    names: tuple[str, ...] = eqx.field(static=True)
    error: Float[Array, " band"] | None = None

    @property
    def count(self) -> int:
        """Number of nodes."""
        return self.weight.shape[0]

    def in_band(self, radiance: Float[Array, "*batch node"]) -> Float[Array, "*batch band"]:
        """Sum node radiances [W m-2 sr-1] into bands. Differentiable in `radiance`."""
        return matmul(radiance, (self.response * self.weight[None, :]).T)


def quantile_index(species: str) -> int:
    """Which of a node's two quantiles orders the lines of a species: the first for CO2, the second for all others.

    Lines of different molecules lie at random to one another; among the gases of an exhaust CO2 and H2O overlap where
    both are strong.
    """
    return 0 if species == "CO2" else 1


def bin_edges(nodes: Nodes) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper edge of each node's bin [node] [cm-1] on the host, in double precision as they were given."""
    exact = np.asarray(nodes.edge, np.float64).sum(axis=-1) / SECOND_RADIATION
    return exact[:, 0], exact[:, 1]


def build_nodes(
    lower: np.ndarray,
    upper: np.ndarray,
    g: np.ndarray,
    weight: np.ndarray,
    response: np.ndarray,
    names: Sequence[str],
) -> Nodes:
    """Assemble `Nodes` from host arrays in double precision (shapes as in `Nodes`; edges in cm-1)."""
    exact = SECOND_RADIATION * np.stack([lower, upper], axis=-1).astype(np.float64)
    leading = exact.astype(float_dtype())
    remainder = exact - leading.astype(np.float64)
    return Nodes(
        lower=as_float(lower),
        upper=as_float(upper),
        edge=as_float(np.stack([leading.astype(np.float64), remainder], axis=-1)),
        g=as_float(g),
        slot=as_float(_slots(lower, upper, np.asarray(g, np.float64), np.asarray(weight, np.float64))),
        weight=as_float(weight),
        response=as_float(response),
        names=tuple(names),
    )


def _slots(lower: np.ndarray, upper: np.ndarray, g: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """See `Nodes.slot`: of a quantile, the weights in its bin below it, and its own."""
    bins = np.unique(np.stack([lower, upper], axis=1), axis=0, return_inverse=True)[1].reshape(-1)
    found = []
    for quantile in g.T:
        each, place = np.unique(np.stack([bins, quantile], axis=1), axis=0, return_inverse=True)
        of_bin, place = each[:, 0].astype(int), place.reshape(-1)
        share: np.ndarray = np.bincount(place, weight)
        whole = np.bincount(of_bin, share)
        share = share / np.where(whole > 0, whole, 1)[of_bin]
        below = np.cumsum(share) - share
        before = below - below[np.searchsorted(of_bin, of_bin)]  # less what is below the first of its bin
        found.append(np.stack([before, share], axis=1)[place])
    return np.stack(found, axis=1)


def as_bands(bands: Band | Sequence[Band]) -> tuple[Band, ...]:
    """One band or several, as a tuple; ValueError where there is none, or something that is not a `Band`."""
    several = (bands,) if isinstance(bands, Band) else tuple(bands)
    if not several or not all(isinstance(band, Band) for band in several):
        raise ValueError(f"bands: got {bands!r}, expected at least one Band, e.g. (jaxir.MWIR, jaxir.LWIR)")
    return several


def gray_nodes(bands: Band | Sequence[Band]) -> Nodes:
    """One node per band: for gray surfaces and gray media nothing more is needed.

    Args:
        bands: one or more; they may overlap.

    Returns:
        Nodes with one node per band, weight 1; a band's response acts by its mean.

    Raises:
        ValueError: no band, or something that is not a `Band`.
    """
    bands = as_bands(bands)
    count = len(bands)
    lower = np.array([1e4 / band.upper for band in bands])
    upper = np.array([1e4 / band.lower for band in bands])
    return build_nodes(
        lower=lower,
        upper=upper,
        g=np.full((count, 2), 0.5),
        weight=np.ones(count),
        response=np.diag([band.mean_response(lower[[i]], upper[[i]])[0] for i, band in enumerate(bands)]),
        names=[band.name for band in bands],
    )


def with_error(nodes: Nodes, error: np.ndarray) -> Nodes:
    """The same nodes with another `Nodes.error`."""
    value = jax.device_put(error.astype(nodes.weight.dtype))
    return eqx.tree_at(lambda n: n.error, nodes, value, is_leaf=lambda leaf: leaf is None)


def padded_nodes(nodes: Nodes, count: int, begin: int = 0) -> Nodes:
    """Nodes from one on, and copies of the last with weight 0, `count` together: one program serves several axes."""
    every = begin + np.arange(count)
    padded = some_of(nodes, np.minimum(every, nodes.count - 1))
    weight = np.asarray(padded.weight)
    return dataclasses.replace(
        padded, weight=jax.device_put(np.where(every < nodes.count, weight, 0).astype(weight.dtype))
    )


def some_of(nodes: Nodes, place: np.ndarray) -> Nodes:
    """Nodes by their numbers, without what they err; on the host."""

    def of(leaf: Array, axis: int = 0) -> Array:
        return jax.device_put(np.take(np.asarray(leaf), place, axis))

    each = {name: of(getattr(nodes, name)) for name in ("lower", "upper", "edge", "g", "slot", "weight")}
    return Nodes(**each, response=of(nodes.response, 1), names=nodes.names)


def told_apart(response: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Order of nodes, by their response [band, node], and factors on weights, so that none is taken for a band.

    Where there are as many nodes as bands, values for bands are values for nodes: where every band has a node of its
    own, they take the order of the bands; else there is one more, of weight 0. On the host.
    """
    inside, every = response > 0, np.arange(response.shape[1])
    if len(inside) != every.size:
        return every, np.ones(every.size)
    if (inside.sum(axis=0) == 1).all() and (inside.sum(axis=1) == 1).all():
        return np.argmax(inside, axis=1), np.ones(every.size)
    return np.append(every, every[-1]), np.append(np.ones(every.size), 0.0)


def as_nodes(bands: Nodes | Band | Sequence[Band]) -> Nodes:
    """`bands` as nodes: `Nodes` pass through, bands become gray nodes."""
    return bands if isinstance(bands, Nodes) else gray_nodes(bands)


def wavelength_to_wavenumber(wavelength: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """Wavenumber [cm-1] of a vacuum wavelength [um]: 1e4 / wavelength."""
    return jnp.asarray(1e4, wavelength.dtype) / wavelength


def bins_inside(
    name: str, nodes: Nodes, wavenumber: Float[Array, " sample"] | np.ndarray, transparent_above: bool = False
) -> list[Check]:
    """Every bin lies between the ends of the table of `name` over increasing wavenumbers [sample] [cm-1].

    With `transparent_above` bins may lie above it, too. And its width is known to half a per cent: edges in float32
    have a grain.
    """
    _, lower, upper, samples = on_host(nodes.lower, nodes.upper, wavenumber)
    covered = lower >= samples[0] * (1 - 1e-5)
    if not transparent_above:
        covered = covered & (upper <= samples[-1] * (1 + 1e-5))
    table = _in_words(samples[:1], samples[-1:]) + (" or above" if transparent_above else "")
    expected = f"bins inside the table of {name}, {table}; asked were {_in_words(lower, upper)}"
    grain = 25 * np.finfo(nodes.lower.dtype).eps
    wide = f"bins of at least {grain:.1g} of their wavenumber, which {nodes.lower.dtype} resolves, or float64"
    return [
        Check("nodes.lower", lower, covered, expected),
        Check("nodes: width of bins", upper - lower, upper - lower >= grain * upper, wide),
    ]


def _in_words(lower: Any, upper: Any) -> str:
    """The span of bins in both units, where known."""
    ends = known(lower), known(upper)
    if ends[0] is None or ends[1] is None:
        return "known at run time"
    low, high = float(ends[0].min()), float(ends[1].max())
    return f"{low:.5g} to {high:.5g} cm-1 ({1e4 / high:.4g} to {1e4 / low:.4g} um)"
