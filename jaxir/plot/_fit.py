"""Fits."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxir.fit import Fit
from jaxir.plot._figure import figure_of


def fit_report(fit: Fit) -> Any:
    """A fit at a glance: values with standard deviations, residuals against a normal law, correlations.

    Args:
        fit: the result of `jaxir.fit.fit`.

    Returns:
        The figure.

    Raises:
        ImportError: matplotlib is not installed.
    """
    figure = figure_of(13, 4.2)
    values, residuals, correlations = figure.subplots(1, 3)
    found = fit.uncertainty
    value, spread = np.asarray(found.value, np.float64), np.asarray(found.standard_deviation, np.float64)
    place = np.arange(value.size)
    share = np.divide(spread, np.abs(value), out=np.full_like(spread, np.inf), where=value != 0)
    known = np.isfinite(share)
    values.barh(place[known], share[known])
    values.set_xscale("log" if (share[known] > 0).any() else "linear")
    units = [f" {unit}" if unit else "" for unit in found.units]
    said = [
        f"{label}\n{number:.5g} ± {error:.2g}{unit}"
        for label, number, error, unit in zip(found.labels, value, spread, units, strict=True)
    ]
    values.set_yticks(place, said)
    values.invert_yaxis()
    values.set_xlabel("standard deviation / value")
    values.set_title("parameters")

    every = np.concatenate([np.asarray(residual).ravel() for residual in fit.residual])
    span = max(4.0, float(np.abs(every).max(initial=0)))
    residuals.hist(every, bins=np.linspace(-span, span, 41), density=True)
    x = np.linspace(-span, span, 400)
    residuals.plot(x, np.exp(-x * x / 2) / np.sqrt(2 * np.pi), label="normal law")
    residuals.set_xlabel("(prediction - measured) / standard deviation")
    chi = f"chi-squared {float(fit.chi_squared):.4g} for {fit.degrees_of_freedom} degrees of freedom"
    residuals.set_title(f"{'converged' if fit.converged else 'not converged'}, {chi}", fontsize="small")
    residuals.legend()

    shown = correlations.imshow(np.asarray(found.correlation), vmin=-1, vmax=1, cmap="RdBu")
    correlations.set_xticks(place, found.labels, rotation=45, ha="right")
    correlations.set_yticks(place, found.labels)
    correlations.set_title("correlation")
    figure.colorbar(shown, ax=correlations)
    return figure
