"""What a fit found and how well the data determine it."""

from __future__ import annotations

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from jaxir._arrays import is_traced
from jaxir.fit._parameter import numbered
from jaxir.scene import Scene

UNLIKELY = 1e-3  # probability below which a model is said not to explain the data
DOUBTFUL = 0.05  # and hardly to explain them
UNDETERMINED = 0.5  # standard deviation in natural steps (half an e-fold) from which a combination counts as unknown


class Uncertainty(eqx.Module):
    """Linearised uncertainty of parameters from the Jacobian of the residuals, in units of their noise.

    With J = d residual / dz in the natural coordinate z and its singular values s_k and right vectors v_k, the
    covariance in z is sum_k v_k v_k^T / s_k^2, and D C D in physical units with D = dx/dz. A combination v_k whose
    standard deviation 1 / s_k exceeds `UNDETERMINED` natural steps is one that the data do not determine.

    Attributes:
        labels: one for every number.
        units: likewise.
        value: where it was linearised [p].
        standard_deviation: [p]; inf where the data (and priors) say nothing.
        covariance: [p, p]; entries of undetermined numbers are inf.
        correlation: [p, p], of the determined part.
        singular_values: of J, descending [p].
        combinations: rows v_k, in the order of the singular values [p, p].
    """

    labels: tuple[str, ...] = eqx.field(static=True)
    units: tuple[str, ...] = eqx.field(static=True)
    value: Float[Array, " p"]
    standard_deviation: Float[Array, " p"]
    covariance: Float[Array, "p p"]
    correlation: Float[Array, "p p"]
    singular_values: Float[Array, " p"]
    combinations: Float[Array, "p p"]

    def open_directions(self) -> np.ndarray:
        """The combinations that the data do not determine [direction, p]."""
        return np.asarray(self.combinations, np.float64)[np.asarray(self.singular_values) * UNDETERMINED < 1]

    def undetermined(self) -> list[str]:
        """The combinations that the data do not determine, each as a sum of natural steps, worst last."""
        said = []
        for s, row in zip(np.asarray(self.singular_values), np.asarray(self.combinations), strict=True):
            if s * UNDETERMINED >= 1:
                continue
            big = np.argsort(-np.abs(row))[:4]
            terms = [f"{row[i]:+.2f} {self.labels[i]}" for i in big if abs(row[i]) > 0.1]
            spread = f"{1 / s:.3g}" if s > 0 else "unbounded"
            said.append(f"{' '.join(terms)} (standard deviation {spread} natural steps)")
        return said

    def __str__(self) -> str:
        """A table of values with standard deviations, and what is not determined."""
        width = max(len(label) for label in self.labels)
        lines = [f"{'parameter':<{width}}  {'value':>12}  {'std. dev.':>10}  unit"]
        rows = zip(self.labels, np.asarray(self.value), np.asarray(self.standard_deviation), self.units, strict=True)
        lines += [f"{label:<{width}}  {value:12.6g}  {spread:10.3g}  {unit}" for label, value, spread, unit in rows]
        lines += [f"not determined: {text}" for text in self.undetermined()]
        return "\n".join(lines)


def uncertainty(
    labels: tuple[str, ...],
    units: tuple[str, ...],
    value: Float[Array, " p"],
    slope: Float[Array, " p"],
    jacobian: Float[Array, "row p"],
) -> Uncertainty:
    """`Uncertainty` from the Jacobian in natural coordinates; host side, in double precision.

    Args:
        labels: [p].
        units: [p].
        value: physical values [p].
        slope: dx/dz [p].
        jacobian: d residual / dz, residuals in units of their standard deviation [row, p].

    Returns:
        The uncertainty.
    """
    if is_traced(jacobian):
        raise ValueError("uncertainty: got traced values (inside jit, grad or vmap), expected a call outside it")
    j = np.asarray(jacobian, np.float64)
    count = j.shape[1]
    j = np.concatenate([j, np.zeros((max(0, count - j.shape[0]), count))])
    size = column_norms(j)
    _, s, v = np.linalg.svd(j / size, full_matrices=False)
    blind = s <= 30 * np.finfo(np.asarray(jacobian).dtype).eps * max(s[0], 1e-300)
    seen = np.where(blind, 0.0, s)
    inverse = np.divide(1.0, seen, out=np.zeros_like(s), where=~blind)
    known = (v.T * inverse**2) @ v / size[:, None] / size[None, :]
    unknown = np.abs(v[blind]).max(axis=0, initial=0.0) > 1e-3
    _, s, v = np.linalg.svd(seen[:, None] * v * size[None, :])
    s[count - np.count_nonzero(blind) :] = 0.0
    d = np.asarray(slope, np.float64)
    covariance = d[:, None] * known * d[None, :]
    spread = np.sqrt(np.diag(covariance))
    pairs = spread[:, None] * spread[None, :]
    correlation = np.divide(covariance, pairs, out=np.zeros_like(covariance), where=pairs > 0)
    covariance[unknown, :] = covariance[:, unknown] = np.inf
    return Uncertainty(
        labels,
        units,
        value,
        jnp.asarray(np.where(unknown, np.inf, spread), value.dtype),
        jnp.asarray(covariance, value.dtype),
        jnp.asarray(correlation, value.dtype),
        jnp.asarray(s, value.dtype),
        jnp.asarray(v, value.dtype),
    )


def column_norms(jacobian: Float[np.ndarray, "row p"]) -> Float[np.ndarray, " p"]:
    """By which columns are divided before they are compared, as rounding is relative to each; 1 of empty ones."""
    size = np.linalg.norm(jacobian, axis=0)
    return np.where(size > 0, size, 1)


class Fit(eqx.Module):
    """The result of a fit.

    Attributes:
        scene: with the fitted values.
        uncertainty: values, standard deviations, covariance, singular values, what is not determined.
        reach: lowest and highest value of each parameter among fits as good as this one, found along the directions
            that the data leave open; the value itself where there are none [2, p].
        at_bounds: what is said of values at their bounds.
        bands: of each measurement.
        robust: residual from which the loss grows linearly; inf for squares.
        residual: (prediction - measured) / standard deviation of every measured number, one array per measurement
            [row, band].
        prior_residual: (value - what was known) / standard deviation, of each parameter that has a prior [m].
        chi_squared: sum of squared residuals, priors included, without the robust loss [].
        degrees_of_freedom: measured numbers and priors less fitted numbers.
        sampling_error: standard error that the finite number of rays puts into each value, from the two independent
            halves of the rays of every row [p]; compare it with the standard deviation. With few rays it is a rough
            estimate.
        sampling_residual: what each block of the rays of a row puts into its residual, from its two halves, whose
            squares, summed over blocks, have the sampling variance of `residual` as their mean [block, row, band].
        steps: of the solver, for the start that was best.
        starts: loss reached from every start with the rays traced first, by fewer rays where such lead [start].
        rounds: how often rays were traced.
        samples: rays per pixel of each measurement, those given and those taken; more of them where the noise of those
            given exceeded that of the data.
        effective_share: of the directions that the traced brdf drew, for the fitted one; 1 where none were drawn [].
        drifted: whether rays should have been traced once more.
        solver_result: optimistix's result code of the best start.
    """

    scene: Scene
    uncertainty: Uncertainty
    reach: Float[Array, "2 p"]
    at_bounds: tuple[str, ...] = eqx.field(static=True)
    bands: tuple[tuple[str, ...], ...] = eqx.field(static=True)
    robust: float = eqx.field(static=True)
    residual: tuple[Float[Array, "row band"], ...]
    prior_residual: dict[str, Float[Array, " m"]]
    chi_squared: Float[Array, ""]
    degrees_of_freedom: int = eqx.field(static=True)
    sampling_error: Float[Array, " p"]
    sampling_residual: tuple[Float[Array, "block row band"], ...]
    steps: int = eqx.field(static=True)
    starts: Float[Array, " start"]
    rounds: int = eqx.field(static=True)
    samples: tuple[tuple[int, int], ...] = eqx.field(static=True)
    effective_share: Float[Array, ""]
    drifted: bool = eqx.field(static=True)
    solver_result: optx.RESULTS

    @property
    def converged(self) -> bool:
        """Whether the solver says it converged."""
        return bool(self.solver_result == optx.RESULTS.successful)

    @property
    def sampling_chi_squared(self) -> float:
        """By how much the sampling error of the prediction raises `chi_squared`."""
        return float(sum(np.sum(np.asarray(e, np.float64) ** 2) for e in self.sampling_residual))

    @property
    def standard_deviation(self) -> np.ndarray:
        """Of each value [p]: of the noise of the data, of the rays' own, and half its reach where data leave it open.

        The root of the sum of the squares of the first two, or the last if it is larger; `inf` as in `Uncertainty`.
        """
        noise, rays = (np.asarray(x, np.float64) for x in (self.uncertainty.standard_deviation, self.sampling_error))
        span = np.ptp(np.asarray(self.reach, np.float64), axis=0) / 2
        return np.maximum(np.hypot(noise, rays), span)

    @property
    def probability(self) -> float:
        """With which data of the stated noise would fit as badly or worse, if the model is right; nan without freedom.

        Of chi-squared over its expectation n (1 + v), with n degrees of freedom and the mean v of the rays' own
        variance, as a ratio of two variances (F): chi-squared has n degrees of freedom of the noise and m of the rays,
        1 + v has k of the rays (Satterthwaite, Biometrics Bulletin 2, 1946). They are (sum v_i)^2 / sum v_i^2 over
        rows and over rows and blocks, which share nothing; bands share rays.
        """
        from scipy.special import chdtrc, fdtrc  # takes as long to import as all of jaxir

        n, found = self.degrees_of_freedom, float(self.chi_squared)
        if n <= 0:
            return math.nan
        square = [np.sum(np.asarray(e, np.float64) ** 2, axis=2) for e in self.sampling_residual]
        sums, rows = sum(float(np.sum(s)) for s in square), sum(s.shape[1] for s in square)
        v = sums / sum(part.size for part in self.residual)
        if not v > 0:
            return float(chdtrc(n, found))
        # each square has one degree of freedom, so that the mean of its square is 3 times the square of its mean
        by_block = sum(float(np.sum(s**2)) for s in square) / 3
        by_row = sum(float(np.sum(s.sum(axis=0) ** 2)) for s in square) - 2 * by_block
        whole = sums**2 - 2 * by_block
        m, k = min(whole / by_row, rows), min(whole / by_block, sum(s.size for s in square))
        return float(fdtrc(n * (1 + v) ** 2 / (1 + n * v**2 / m), k * (1 + 1 / v) ** 2, found / (n * (1 + v))))

    def worst(self, count: int = 3) -> list[tuple[float, str]]:
        """The largest residuals in standard deviations, of data and of priors, each with its place."""
        found = [
            (float(r[row, band]), f"measurement {k}, row {row}, {self.bands[k][band]}")
            for k, r in enumerate(np.asarray(part) for part in self.residual)
            for row, band in zip(*np.unravel_index(np.argsort(-np.abs(r), axis=None)[:count], r.shape), strict=True)
        ]
        for name, r in self.prior_residual.items():
            found += zip(r.tolist(), numbered(f"prior of {name}", r.size), strict=True)
        return sorted(found, key=lambda one: -abs(one[0]))[:count]

    def __str__(self) -> str:
        """A table, the goodness of fit and every warning."""
        spread = np.asarray(self.uncertainty.standard_deviation)
        return "\n".join(
            [
                self._table(),
                *(f"not determined: {text}" for text in self.uncertainty.undetermined()),
                *self._wide(),
                *(f"{text}: its standard deviation does not count" for text in self.at_bounds),
                *self._goodness(),
                *self._of_rays(spread),
                f"solver: {'converged' if self.converged else optx.RESULTS[self.solver_result]} after {self.steps} "
                "steps",
            ]
        )

    def _table(self) -> str:
        labels, units = self.uncertainty.labels, self.uncertainty.units
        width = max(len(label) for label in labels)
        columns = (self.uncertainty.value, self.standard_deviation, self.uncertainty.standard_deviation)
        rows = zip(labels, *(np.asarray(c) for c in columns), np.asarray(self.sampling_error), units, strict=True)
        head = f"{'parameter':<{width}}  {'value':>12}  {'std. dev.':>10}  {'of noise':>10}  {'of rays':>10}  unit"
        return "\n".join(
            [head, *(f"{n:<{width}}  {v:12.6g}  {t:10.3g}  {s:10.3g}  {r:10.3g}  {u}" for n, v, t, s, r, u in rows)]
        )

    def _wide(self) -> list[str]:
        """Values that are open although they look determined where the solver stopped."""
        low, high = np.asarray(self.reach)
        spread = np.asarray(self.uncertainty.standard_deviation)
        wide = np.isfinite(spread) & (high - low > 4 * spread) & (high > low)
        return [
            f"not determined: {label} from {a:.4g} to {b:.4g} fits as well, with others that change along"
            for label, a, b, so in zip(self.uncertainty.labels, low, high, wide, strict=True)
            if so
        ]

    def _goodness(self) -> list[str]:
        said = (
            f"chi-squared {float(self.chi_squared):.4g} for {self.degrees_of_freedom} degrees of freedom, "
            f"of which {self.sampling_chi_squared:.2g} from the finite number of rays"
        )
        p = self.probability
        if not p < UNLIKELY:
            how = "hardly explained" if p < DOUBTFUL else "explained"
            return [said + ("" if math.isnan(p) else f": the data are {how} (probability {p:.2g})")]
        worst = self.worst()
        lines = [
            f"{said}: THE MODEL DOES NOT EXPLAIN THE DATA (probability {p:.2g}), so that standard deviations are "
            "too small",
            "largest residuals: " + "; ".join(f"{r:+.1f} standard deviations, {where}" for r, where in worst),
        ]
        every = np.concatenate([np.abs(np.asarray(part)).ravel() for part in self.residual])
        if math.isinf(self.robust) and worst and abs(worst[0][0]) > 5 * max(np.median(every), 1):
            lines.append("few data stand out: try robust=3, which lets outliers pull less")
        return lines

    def _of_rays(self, spread: np.ndarray) -> list[str]:
        shift = np.asarray(self.sampling_error)
        ratio = float(np.max(np.where(np.isfinite(spread) & (spread > 0), shift / np.where(spread > 0, spread, 1), 0)))
        share = 100 * float(self.effective_share)
        more = [f"measurement {k} {a} to {b}" for k, (a, b) in enumerate(self.samples) if b > a]
        return [
            f"rays put at most {ratio:.2g} standard deviations of the noise into a value"
            + ("; give more samples, max_samples or larger shapes" if ratio > 1 else ""),
            *([f"rays put in too much, so more were traced, per pixel: {', '.join(more)}"] if more else []),
            f"rays traced {self.rounds} times, {share:.0f} % of sampled directions count"
            + ("; they suit the solution badly: allow more rounds" if self.drifted else ""),
        ]
