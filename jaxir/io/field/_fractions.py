"""Mole fractions from the mass fractions of a computed flow."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

SLACK = 0.01  # by which mass fractions may miss the sum 1


def mole_fractions(
    file: Path, mass: Mapping[str, np.ndarray], molar_masses: Mapping[str, float]
) -> dict[str, np.ndarray]:
    """Mole fractions x_i = (Y_i / M_i) / sum_j (Y_j / M_j) of mass fractions Y.

    Args:
        file: named in errors.
        mass: mass fractions of the species that the file holds, by name [value].
        molar_masses: M of every species, in one unit; at most one of them is not in the file, which is the rest.

    Returns:
        Mole fractions of the species that the file holds [value].

    Raises:
        ValueError: molar masses that are not positive, no species or more than one that is not in the file, mass
            fractions that do not sum to 1.
    """
    for name, value in molar_masses.items():
        if not 0 < value < np.inf:
            raise ValueError(f"molar_masses[{name!r}]: got {value}, expected a number > 0")
    absent = [name for name in molar_masses if name not in mass]
    if len(absent) > 1 or not mass:
        raise ValueError(
            f"{file}: molar_masses: got {', '.join(absent) or 'none'}, which the file does not hold, expected its "
            f"species and at most one more that is the rest"
        )
    total = np.sum(list(mass.values()), axis=0)
    wrong = np.flatnonzero((total > 1 + SLACK) if absent else np.abs(total - 1) > SLACK)
    if wrong.size:
        raise ValueError(
            f"{file}: the mass fractions of {', '.join(mass)} sum to {total[wrong[0]]:.4g} at entry {wrong[0]}, "
            f"expected {'at most ' if absent else ''}1: molar_masses needs every species, and one that the file does "
            f"not hold is the rest"
        )
    moles = {name: value / molar_masses[name] for name, value in mass.items()}
    whole = np.sum(list(moles.values()), axis=0) + sum((1 - total) / molar_masses[name] for name in absent)
    return {name: value / whole for name, value in moles.items()}
