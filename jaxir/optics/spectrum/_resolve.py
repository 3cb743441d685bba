"""Nodes that resolve a spectrum: bins of wavenumber times places in the distribution of the absorption inside a bin.

Inside a bin the absorption coefficient of a gas takes each value k with a frequency, and the mean transmittance of
the bin needs nothing but that distribution: int exp(-k(g) u) dg over the quantile g. Two gases whose lines are
unrelated need two quantiles.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float

from jaxir._math import gauss_legendre
from jaxir.optics.spectrum._band import (
    SECOND_RADIATION,
    Band,
    Nodes,
    as_bands,
    bin_edges,
    build_nodes,
    gray_nodes,
    told_apart,
)

CO2_H2O_OVERLAP = ((800.0, 1150.0), (3300.0, 3800.0), (4800.0, 5150.0))
"""Where CO2 and H2O of combustion products both matter [cm-1]: elsewhere between 800 and 9300 cm-1 a common quantile
changes the radiance of SWIR, MWIR or LWIR by less than 0.3 % (1e-3 rms)."""

LEAST = 1e-5  # of its wavenumber is a bin wide that may be halved, in single precision
COLD = 250.0  # temperature whose blackbody changes fast with the wavenumber [K]
OF_RESPONSE = 2e-3  # of a band may be what responses err that act by their means over bins
HALVINGS, FINE_HALVINGS = 6, 16  # of bins at most: for responses alone, and where tables have narrow lines
_GRAIN = 1e-9  # of edges that went through `Nodes.edge`
_STRETCH = 3  # g = 1 - (1 - s)^3 crowds the points where the few strong values of k lie


def quantiles(points: int) -> tuple[np.ndarray, np.ndarray]:
    """Quadrature over the quantile g of one gas: Gauss-Legendre in s, g = 1 - (1 - s)^3.

    Over Malkmus' distribution with shapes b = e^-6 ... e^4, 8 points err in the absorptance 1 - T by 1.3 % rms, 6 by
    3.5 %, 12 by 0.2 %; plain Gauss-Legendre with 8 points errs by 17 %. For b >= e^-2 the 8 points are within 0.3 % of
    the absorptance at any depth. The transmittance T errs by the same .0024 at most, which is more and more of itself
    where little passes: at most 0.2 % for -ln T up to 1, 1 % up to 2, 4 % up to 3, but 23 % at 4.6 and all of it beyond
    10 (12 points: 0.1, 0.4, 1.5, 9 %), as for a hot gas behind a cold one of the same lines.

    Args:
        points: number of points >= 1.

    Returns:
        g [point] and weights [point], which sum to 1.
    """
    s, weight = gauss_legendre(points)
    weight = weight * (1 - s) ** (_STRETCH - 1)
    return 1 - (1 - s) ** _STRETCH, weight / weight.sum()


def resolved_nodes(
    bands: Band | Sequence[Band],
    width: float = 50.0,
    points: int = 8,
    pair_points: int = 5,
    overlap: Sequence[tuple[float, float]] = CO2_H2O_OVERLAP,
    cuts: Sequence[float] = (),
) -> Nodes:
    """Nodes for gases and atmospheres: bins on multiples of `width`, clipped to the bands, each with a set of g.

    In a bin where one gas matters both quantiles of a node are equal. In bins touched by `overlap` the nodes form a
    square of `pair_points` x `pair_points` quantiles, one for CO2 and one for H2O: the two gases overlap at random.
    For 3 to 300 cm of combustion products at 0.3 and 1 atm, 600-2000 K, the error that the overlap leaves in the
    in-band radiance is, rms and at most,

        | nodes in overlap bins | SWIR       | MWIR      | LWIR      |
        | 8, equal quantiles    | 4.7, 12 %  | 0.1, 0.3  | 1.7, 4.8  |
        | 5 x 5                 | 0.6, 2.5 % | 0.1, 0.3  | 0.4, 1.5  |
        | 6 x 6                 | 0.3, 1.0 % | 0.1, 0.3  | 0.1, 0.3  |

    Args:
        bands: at least one band; bands may overlap and then share bins.
        width: bin width [cm-1]; less where a band's response varies inside a bin, so that its product with Planck's law
            errs by 2e-3 of the band at most, at 250 K. The embedded tables have 50 cm-1; wider bins group their rows,
            narrower ones repeat them (and resolve Planck's law and a user's table better).
        points: quantiles in a bin with one important gas; 1 for spectra that are smooth inside a bin.
        pair_points: quantiles per gas in overlap bins; 0 keeps equal quantiles there too.
        overlap: wavenumber intervals [cm-1] with two important gases.
        cuts: wavenumbers [cm-1] at which bins end besides, see `cuts_for`.

    Returns:
        Nodes in ascending wavenumber, none where no band responds; `Nodes.response` is each band's mean response over
        the bin, 0 outside the band. Where every band has one node, they are in the order of the bands.

    Raises:
        ValueError: no band, a width that is not > 0, or a number of points out of range.
    """
    bands = as_bands(bands)
    if not (np.isfinite(width) and width > 0):
        raise ValueError(f"width: got {width}, expected a number > 0 [cm-1]")
    if not 1 <= points <= 64 or not 0 <= pair_points <= 64:
        raise ValueError(f"points, pair_points: got {points}, {pair_points}, expected 1 ... 64 and 0 ... 64")

    edges = np.array([(1e4 / band.upper, 1e4 / band.lower) for band in bands])
    lower, upper = _cut_by_response(bands, edges, *_bins(edges, width, cuts))
    response = _in_bins(bands, edges, lower, upper, Band.mean_response)
    some = response.any(axis=0) if response.any() else slice(None)
    each = lower[some], upper[some], response[:, some]
    return _with_quantiles(*each, points, pair_points, overlap, [band.name for band in bands])


def _in_bins(
    bands: Sequence[Band], edges: np.ndarray, lower: np.ndarray, upper: np.ndarray, of: Callable
) -> Float[np.ndarray, "band bin"]:
    """What `of` a band says of bins inside it; 0 of others."""
    middle = (lower + upper) / 2
    found = np.zeros((len(bands), lower.size))
    for band, (low, high), row in zip(bands, edges, found, strict=True):
        inside = (middle > low) & (middle < high)
        row[inside] = of(band, lower[inside], upper[inside])
    return found


def _cut_by_response(
    bands: Sequence[Band], edges: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Bins halved where a response varies with the blackbody of `COLD` in them, and acts otherwise than by its mean.

    With r the response and x = nu - nu_middle, a bin errs by c2 / T mean(r x) of its width to first order; all bins
    of a band together by `OF_RESPONSE` of it at most, if `HALVINGS` suffice.
    """
    if all(band.response is None for band in bands):
        return lower, upper
    for _ in range(HALVINGS):
        width = upper - lower
        whole = (_in_bins(bands, edges, lower, upper, Band.mean_response) * width).sum(axis=1, keepdims=True)
        moment = _in_bins(bands, edges, lower, upper, Band.response_moment)
        errs = np.abs(moment) * width * SECOND_RADIATION / COLD
        cut = (errs * lower.size > OF_RESPONSE * whole).any(axis=0)
        if not cut.any():
            break
        lower, upper = _halved(lower, upper, cut)
    return lower, upper


def _halved(lower: np.ndarray, upper: np.ndarray, cut: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bins that do not overlap, some of them cut in their middle."""
    middle = (lower[cut] + upper[cut]) / 2
    return np.sort(np.concatenate([lower, middle])), np.sort(np.concatenate([upper, middle]))


class Table(NamedTuple):
    """A function of the wavenumber, smooth between some of them [cm-1]."""

    samples: np.ndarray
    at: Callable[[Any], Any]


def cuts_for(
    band: Band,
    alone: Sequence[Table],
    pairs: Sequence[tuple[Table, Table]],
    width: float,
    rtol: float,
) -> tuple[list[float], float]:
    """Where bins of a width have to end besides, so that means over them serve for what depends on the wavenumber.

    In a bin the mean of a product of a response, of light and of what passes air is taken for the product of their
    means, which errs where both vary in it. Bins are halved until all of the band errs by `rtol` of it at most for each
    two of them, signs taken into account, `FINE_HALVINGS` times at most.

    Args:
        band: the band.
        alone: what is multiplied by its response.
        pairs: what is multiplied by one another.
        width: of the bins [cm-1].
        rtol: what may be left; `OF_RESPONSE` at most.

    Returns:
        Wavenumbers in ascending order [cm-1], and what is left of a band, by the worst two.
    """
    rtol, left = min(rtol, OF_RESPONSE), 0.0
    edges = np.array([[1e4 / band.upper, 1e4 / band.lower]])
    lower, upper = _cut_by_response([band], edges, *_bins(edges, width))
    without = lower
    own = [] if band.response is None else [_response(band)]
    for one, other in [*((one, other) for one in own for other in alone), *pairs]:
        for _ in range(FINE_HALVINGS):
            errs, whole = _products(one, other, lower, upper)
            if abs(errs.sum()) <= rtol * whole:
                break
            cut = (np.abs(errs) * errs.size > rtol * whole) & (upper - lower > LEAST * upper)
            lower, upper = _halved(lower, upper, cut)
        left = max(left, abs(errs.sum()) / whole if whole else 0.0)
    return np.setdiff1d(lower, without).tolist(), left


def _response(band: Band) -> Table:
    wavelength, response = np.array(band.response).T
    return Table(1e4 / wavelength[::-1], lambda x: np.interp(1e4 / x, wavelength, response))


def _products(one: Table, other: Table, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, float]:
    """What bins lack of the integral of a product where it is taken for that of the means [bin], and all of it."""
    x = np.unique(np.concatenate([one.samples, other.samples, lower, upper]))
    x = x[(x >= lower[0]) & (x <= upper[-1])]
    place = [x[:-1] * (1 - share) + x[1:] * share for share in (1e-9, 0.5, 1 - 1e-9)]  # tables may jump
    f, g = (np.stack([table.at(each) for each in place]) for table in (one, other))
    simpson = (np.diff(x) / 6)[None] * np.array([[1.0], [4.0], [1.0]])
    sums = [np.append(0.0, np.cumsum((simpson * each).sum(axis=0))) for each in (f * g, f, g)]
    first, last = np.searchsorted(x, lower), np.searchsorted(x, upper)
    both, of_one, of_other = (each[last] - each[first] for each in sums)
    return both - of_one * of_other / (upper - lower), float(both.sum())


def finer_nodes(nodes: Nodes, cuts: Sequence[float] = ()) -> Nodes:
    """The bins of nodes cut at multiples of the finest width, with as many quantiles as the finest resolution has.

    They end at `cuts` besides [cm-1]. A response stays the mean one over each bin. On the host.
    """
    width, points, pair_points = RESOLUTIONS[-1]
    lower, upper = bin_edges(nodes)
    bins = np.unique(np.vstack([lower, upper, np.asarray(nodes.response, np.float64)]), axis=1)
    pieces = []
    for low, high, *response in bins.T.tolist():
        even = width * np.arange(np.floor(low / width) + 1, np.ceil(high / width))
        inner = np.union1d(even, cuts)
        ends = np.concatenate([[low], inner[(inner > low * (1 + _GRAIN)) & (inner < high * (1 - _GRAIN))], [high]])
        pieces.append(np.vstack([ends[:-1], ends[1:], np.repeat(np.array(response)[:, None], ends.size - 1, axis=1)]))
    lower, upper, *response = np.hstack(pieces)
    return _with_quantiles(lower, upper, np.array(response), points, pair_points, CO2_H2O_OVERLAP, nodes.names)


def _with_quantiles(
    lower: np.ndarray,
    upper: np.ndarray,
    response: np.ndarray,
    points: int,
    pair_points: int,
    overlap: Sequence[tuple[float, float]],
    names: Sequence[str],
) -> Nodes:
    """Nodes of bins [bin] and responses [band, bin], see `resolved_nodes`."""
    g, weight = quantiles(points)
    single = np.stack([g, g], axis=-1), weight
    pair = _square(pair_points) if pair_points else single
    limits = np.asarray(overlap, np.float64).reshape(-1, 2)
    low, high = (lower * (1 + _GRAIN))[:, None], (upper * (1 - _GRAIN))[:, None]
    touched = np.any((low < limits[:, 1]) & (high > limits[:, 0]), axis=1)
    sets = [pair if two else single for two in touched.tolist()]
    repeat = np.repeat(np.arange(lower.size), [weight.size for _, weight in sets])
    order, factor = told_apart(response[:, repeat])
    repeat = repeat[order]
    return build_nodes(
        lower=lower[repeat],
        upper=upper[repeat],
        g=np.concatenate([g for g, _ in sets])[order],
        weight=np.concatenate([weight for _, weight in sets])[order] * factor,
        response=response[:, repeat],
        names=names,
    )


class Resolution(NamedTuple):
    """Arguments of `resolved_nodes`: bin width [cm-1], quantiles per bin, quantiles per gas in overlap bins."""

    width: float
    points: int
    pair_points: int


RESOLUTIONS = (
    Resolution(200.0, 1, 0),
    Resolution(50.0, 1, 0),
    Resolution(200.0, 4, 3),
    Resolution(50.0, 2, 2),
    Resolution(50.0, 4, 3),
    Resolution(50.0, 6, 4),
    Resolution(50.0, 8, 5),
    Resolution(50.0, 12, 8),
)


def nodes_for(
    radiance: Callable[[Nodes], Float[Array, "*batch band"]],
    bands: Band | Sequence[Band],
    rtol: float,
    resolutions: Sequence[Resolution] = RESOLUTIONS,
) -> Nodes:
    """The fewest nodes that a scene needs: one per band if nothing in it depends on the wavenumber.

    Gray nodes, then each of `resolutions` from few nodes to many, are compared with the one of most nodes; the first
    that agrees is returned. Each try compiles for its number of nodes.

    Args:
        radiance: in-band results of a few typical rays, e.g. a function that renders a coarse image on given nodes;
            equal random numbers in every call.
        bands: at least one band.
        rtol: largest relative difference of any result.
        resolutions: candidates, at least one; the finest is the reference.

    Returns:
        Nodes. The reference itself if nothing coarser meets `rtol`.

    Raises:
        ValueError: as `resolved_nodes`; rtol not > 0; results that are not finite.
    """
    if not (np.isfinite(rtol) and rtol > 0):
        raise ValueError(f"rtol: got {rtol}, expected a number > 0")
    bands = as_bands(bands)
    if not resolutions:
        raise ValueError("resolutions: got none, expected at least one")
    fine = sorted((resolved_nodes(bands, *resolution) for resolution in resolutions), key=lambda nodes: nodes.count)
    reference = np.asarray(radiance(fine[-1]), np.float64)
    if not np.all(np.isfinite(reference)):
        raise ValueError("radiance: got values that are not finite on the finest nodes")
    for nodes in (gray_nodes(bands), *fine[:-1]):
        if np.all(np.abs(np.asarray(radiance(nodes), np.float64) - reference) <= rtol * np.abs(reference)):
            return nodes
    return fine[-1]


def _square(points: int) -> tuple[np.ndarray, np.ndarray]:
    g, weight = quantiles(points)
    first, second = np.meshgrid(g, g, indexing="ij")
    return np.stack([first.ravel(), second.ravel()], axis=-1), np.outer(weight, weight).ravel()


def _bins(edges: np.ndarray, width: float, cuts: Sequence[float] = ()) -> tuple[np.ndarray, np.ndarray]:
    """Intervals between all multiples of `width`, all band edges and all cuts that lie in at least one band."""
    multiples = np.arange(np.floor(edges.min() / width), np.ceil(edges.max() / width) + 1) * width
    ends = np.unique(np.concatenate([multiples, edges.ravel(), np.asarray(cuts, np.float64)]))
    ends = ends[np.concatenate([[True], np.diff(ends) > 1e-9 * ends[1:]])]  # 1e4/8 is 1250 only up to rounding
    lower, upper = ends[:-1], ends[1:]
    middle = (lower + upper) / 2
    used = ((middle > edges[:, :1]) & (middle < edges[:, 1:])).any(axis=0)
    return lower[used], upper[used]
