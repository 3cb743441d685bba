"""Which constants of a polyad Hamiltonian give the levels and the line strengths of 12C16O2?

States |v1 v2 l v3> of equal P = 2 v1 + v2, l and v3 form a Fermi polyad. Its matrix has the anharmonic terms

    G = sum w_i a_i + sum x_ij a_i a_j + x_ll l^2 + cubic ones,    a = (v1 + 1/2, v2 + 1, v3 + 1/2),

on the diagonal and W / 2 sqrt(v1 ((v2 + 2)^2 - l^2)) between v1 v2 and v1 - 1 v2 + 2, where W is linear in the quanta.
A level's rotational constant is B0 - a1 v1 - a2 v2 - a3 v3, averaged over its members; distortion is that of the ground
state. From v3 to v3 + 1 the transition moment is sqrt(v3 + 1) (1 + k1 v1 + k2 v2 + k3 v3) times that of the ground
state. Left out: Coriolis and l-type interactions, the splitting of e and f levels, Herman-Wallis factors.

`CONSTANTS` come from this study: a least-squares fit to `studies/data/co2_levels.csv`. `studies.co2_lines` makes lines
of them.
"""

import argparse
import functools
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxir.optics.spectrum import SECOND_RADIATION as C2
from studies._study import Run, study, subplots
from studies.measurements import read_rows

DATA = Path(__file__).parent / "data"
B0, D0 = 0.390219, 1.3337e-7  # of the ground state [cm-1]
NU3 = 2349.143  # cm-1
SPEED_OF_LIGHT = 2.99792458e10  # cm / s
HIGHEST = 25000.0  # vibrational energy of the states that are counted [cm-1]; dissociation is at 44600
# w1 w2 w3 | x11 x12 x13 x22 x23 x33 x_ll | cubic terms in the order of `_cubic` | W and its slopes in v1, v2, v3 |
# a1 a2 a3 | k1 k2 k3 | Einstein coefficient of the ground state's band at NU3 over 400 / s
CONSTANTS = np.array(
    [
        *(1354.75, 673.15, 2396.72, -3.2949, 0.631697, -19.4128, 0.040284, -12.8296, -12.6104, 0.153358),
        *(-0.0404431, 0.0186977, 0.0386629, 0.0488659, 0.0533859, 0.00395475, 0.00791627, 0.0311026, 0.00222372),
        *(-0.0233075, -0.00342901, -0.00415592, -0.00846407, -52.5523, 0.328572, 0.326363, 0.579845),
        *(0.00121989, -0.000718694, 0.00305156, -0.0260554, -0.00243184, -0.00495694, 1.04648),
    ]
)


def _cubic(a, b, c, ll):
    return (
        a * a * c,
        a * b * c,
        b * b * c,
        a * c * c,
        b * c * c,
        ll * c,
        c**3,
        a**3,
        b**3,
        a * a * b,
        a * b * b,
        a * ll,
        b * ll,
    )


class Polyad(NamedTuple):
    """States of one polyad [state], and what they are made of.

    Attributes:
        energy: above the ground state, ascending [cm-1].
        mixture: [member, state].
        v1, v2: quanta of the members [member].
        rotational: constant B of the states [cm-1].
    """

    energy: np.ndarray
    mixture: np.ndarray
    v1: np.ndarray
    v2: np.ndarray
    rotational: np.ndarray


def _matrix(constants, total, angular, v3):
    v1 = np.arange((total - angular) // 2 + 1)
    v2 = total - 2 * v1
    a, b, c, ll = v1 + 0.5, v2 + 1.0, v3 + 0.5, float(angular * angular)
    terms = [a, b, c, a * a, a * b, a * c, b * b, b * c, c * c, ll, *_cubic(a, b, c, ll)]
    matrix = np.diag(sum(k * (term + 0 * a) for k, term in zip(constants, terms, strict=False)))
    w, slope = constants[23], constants[24:27]
    for i in range(1, v1.size):
        coupling = w + slope[0] * v1[i] + slope[1] * (v2[i] + 2) + slope[2] * c
        matrix[i, i - 1] = matrix[i - 1, i] = coupling / 2 * np.sqrt(v1[i] * ((v2[i] + 2) ** 2 - ll))
    return v1, v2, matrix


def polyad(constants: np.ndarray, total: int, angular: int, v3: int) -> Polyad:
    """The states of P = `total`, l and v3."""
    v1, v2, matrix = _matrix(constants, total, angular, v3)
    energy, mixture = np.linalg.eigh(matrix)
    a1, a2, a3 = constants[27:30]
    rotational = (mixture**2).T @ (B0 - a1 * v1 - a2 * v2 - a3 * v3)
    return Polyad(energy - _matrix(constants, 0, 0, 0)[2][0, 0], mixture, v1, v2, rotational)


def moments(constants: np.ndarray, lower: Polyad, upper: Polyad, v3: int) -> np.ndarray:
    """Squares of the transition moments from v3 to v3 + 1 over that of the ground state [lower state, upper state]."""
    k1, k2, k3 = constants[30:33]
    growth = 1 + k1 * lower.v1 + k2 * lower.v2 + k3 * v3
    return (v3 + 1) * (lower.mixture.T @ (growth[:, None] * upper.mixture)) ** 2


@functools.cache
def polyads() -> dict[tuple[int, int, int], Polyad]:
    """All polyads by P, l, v3 that begin below `HIGHEST`, and those that lines lead to."""
    found = {}
    for v3 in range(16):
        for total in range(46):
            for angular in range(total % 2, total + 1, 2):
                one = polyad(CONSTANTS, total, angular, v3)
                if one.energy[0] > HIGHEST + 2500:
                    break
                found[total, angular, v3] = one
    return found


def term(rotational, j):
    """Rotational energy [cm-1]."""
    return rotational * j * (j + 1) - D0 * (j * (j + 1)) ** 2


def rotations(angular: int, v3: int, highest: int = 200) -> np.ndarray:
    """J of the levels that exist, the spin of 16O being 0."""
    return np.arange(v3 % 2, highest, 2.0) if angular == 0 else np.arange(angular, highest, 1.0)


@functools.cache
def partition(temperature: float) -> float:
    """Total internal partition sum: over vibrational states up to `HIGHEST` and their rotation."""
    energy, count = _levels()
    return float(np.sum(count * np.exp(-C2 * energy / temperature)))


@functools.cache
def _levels() -> tuple[np.ndarray, np.ndarray]:
    """Energies of the states that are counted [level] [cm-1], and 2 J + 1."""
    energies, counts = [], []
    for (_, angular, v3), states in polyads().items():
        j = rotations(angular, v3)[:, None]
        own = states.energy < HIGHEST
        energy = states.energy[own] + term(states.rotational[own], j)
        energies.append(energy.ravel())
        counts.append(np.broadcast_to(2 * j + 1, energy.shape).ravel())
    return np.concatenate(energies), np.concatenate(counts)


def honl_london(angular: int, j: np.ndarray, step: int) -> np.ndarray:
    """Share of a lower level's strength in the branch J -> J + step of a parallel band; the three sum to 1."""
    two = 2 * j + 1
    if step == 0:
        return angular**2 / np.maximum(j * (j + 1), 1)
    larger = np.maximum(j, j + step)
    return np.maximum(larger**2 - angular**2, 0) / np.maximum(larger, 1) / two


# What the constants are fitted to.
class Published(NamedTuple):
    """Rows of co2_levels.csv: v1, l, v3, r [row, 4] as HITRAN writes them, with P; the rest of those with a branch."""

    states: list[tuple[int, int, int, int]]
    energy: np.ndarray
    step: np.ndarray
    j: np.ndarray
    wavenumber: np.ndarray
    einstein: np.ndarray


def published(lines: bool) -> Published:
    """Vibrational levels, or lines."""
    text = (DATA / "co2_levels.csv").read_text(encoding="utf-8")
    rows = [row for row in read_rows(text) if bool(row["branch"]) == lines]
    states = [(2 * int(r["v1"]) + int(r["v2"]), int(r["l"]), int(r["v3"]), int(r["r"])) for r in rows]
    energy = np.array([float(r["energy_cm-1"]) for r in rows])
    if not lines:
        none = np.zeros(len(rows))
        return Published(states, energy, none, none, none, none)
    step = np.array(["PQR".index(r["branch"]) - 1 for r in rows])
    numbers = (np.array([float(r[name]) for r in rows]) for name in ("J", "wavenumber_cm-1", "einstein_s-1"))
    return Published(states, energy, step, *numbers)


def level_errors(constants: np.ndarray) -> np.ndarray:
    """Vibrational levels minus the published ones [cm-1]."""
    given = published(lines=False)
    own = [polyad(constants, total, angular, v3).energy[-r] for total, angular, v3, r in given.states]
    return np.array(own) - given.energy


def line_errors(constants: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ours minus the published lines': lower energies, wavenumbers [cm-1], ln of Einstein coefficients."""
    given = published(lines=True)
    found = []
    for (total, angular, v3, r), step, j in zip(given.states, given.step, given.j, strict=True):
        lower, upper = polyad(constants, total, angular, v3), polyad(constants, total, angular, v3 + 1)
        energy = lower.energy[-r] + term(lower.rotational[-r], j)
        nu = upper.energy[-r] + term(upper.rotational[-r], j + step) - energy
        share = honl_london(angular, np.array(j), step) * (2 * j + 1) / (2 * (j + step) + 1)
        moment = moments(constants, lower, upper, v3)[-r, -r]
        found.append((energy, nu, np.log(400 * constants[33] * moment * (nu / NU3) ** 3 * share)))
    energy, nu, log_einstein = np.array(found).T
    return energy - given.energy, nu - given.wavenumber, log_einstein - np.log(given.einstein)


def fit() -> np.ndarray:
    """Constants by least squares from those of Gordon and McCubbin (J. Mol. Spectrosc. 19, 1966, 137).

    Levels count by 0.1 cm-1, lines by 1 and 0.3 cm-1 and 3 %, robustly because single ones are perturbed; cubic terms
    are held near 0 by 0.05 cm-1 and those of B near their published values by 2e-5 cm-1.
    """
    from scipy.optimize import least_squares

    rotational = np.array([0.00122, -0.00072, 0.003076])
    start = np.zeros(34)
    start[:10] = 1354.07, 672.95, 2396.30, -3.10, -5.37, -19.27, 1.59, -12.51, -12.50, -1.01
    start[23], start[27:30], start[30:34] = -52.8, rotational, (-0.02, -0.002, -0.006, 1.05)

    def robust(x):
        return np.sign(x) * np.sqrt(2 * (np.sqrt(1 + x * x) - 1))

    def apart(constants):
        energy, nu, einstein = line_errors(constants)
        held = [constants[10:23] / 0.05, constants[24:27] / 0.05, (constants[27:30] - rotational) / 2e-5]
        return np.concatenate(
            [level_errors(constants) / 0.1, robust(energy), robust(nu / 0.3), robust(einstein / 0.03), *held]
        )

    return least_squares(apart, start, x_scale=np.maximum(np.abs(start), 0.01), max_nfev=80).x


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--fit", action="store_true", help="fit anew and print the constants")


def main(run: Run) -> str:
    constants = fit() if run.options.fit else CONSTANTS
    if run.options.fit:
        print(np.array2string(constants, separator=", ", max_line_width=110, formatter={"float": lambda x: f"{x:.6g}"}))
    level, (energy, nu, einstein) = level_errors(constants), line_errors(constants)
    given = published(lines=True)
    harmonic = line_errors(np.concatenate([constants[:30], np.zeros(3), constants[33:]]))[2]
    run.table(
        [
            {
                "v1 v2 l v3 r": f"{(p - angular) // 2} {angular} {angular} {v3} {r}",
                "J": j,
                "energy": e,
                "energy_error": a,
                "wavenumber_error": b,
                "einstein_error_percent": 100 * np.expm1(c),
                "with_harmonic_moments_percent": 100 * np.expm1(d),
            }
            for (p, angular, v3, r), j, e, a, b, c, d in zip(
                given.states, given.j, given.energy, energy, nu, einstein, harmonic, strict=True
            )
        ]
    )
    figure, axis = subplots(figsize=(6, 4))
    axis.plot(given.energy, 100 * np.expm1(einstein), "o", label="ours")
    axis.plot(given.energy, 100 * np.expm1(harmonic), "x", label="harmonic moments")
    axis.set(xlabel="energy of the lower state [cm-1]", ylabel="error of the Einstein coefficient [%]")
    axis.legend()
    run.chart(figure)
    rms = [float(np.sqrt(np.mean(x**2))) for x in (level, energy, nu, einstein, harmonic)]
    return (
        f"34 constants leave {rms[0]:.2f} cm-1 rms in {level.size} vibrational levels; of {energy.size} lines, up to "
        f"{given.energy.max():.0f} cm-1, {rms[1]:.1f} cm-1 in energies, {rms[2]:.2f} cm-1 in positions and "
        f"{100 * rms[3]:.1f} % in Einstein coefficients ({100 * rms[4]:.0f} % with harmonic moments)"
    )


if __name__ == "__main__":
    study(main, options)
