"""What does hot water radiate between its bands, by a list of lines and by the tables of 1973?

Between its bands, at 800-1200 and 2000-3300 cm-1, the table of `jaxir.NarrowBandGas` holds means over 50 cm-1 of the
parameters of Riviere and Soufiani (2012), which rest on HITEMP; those of 1973 that it had there before do not. Compared
are mean coefficients and Planck means of both, and how far the table's spline in temperature is from the parameters at
temperatures that are not in it. `--write` puts the means into the table.

A bin of 50 cm-1 is half its middle band of 25 cm-1 and a quarter of both neighbours. Its coefficient is their mean; its
spacing is that of the same strong lines: sqrt(k / d) = mean sqrt(k_i / d_i). The table's k is that at 273 K, which is
k T / 273; and 1/d is scaled so that its product with the width of lines in nitrogen is kept, .079 cm-1 (296 K) there
and .09 cm-1 (273 K) here.
"""

import argparse
from pathlib import Path

import jax.numpy as jnp
import numpy as np

import jaxir
from jaxir.optics.spectrum import band_radiance
from studies._study import HERE, Run, study, subplots
from studies.measurements import read_rows

PATH = Path(jaxir.__file__).parent / "data" / "hot_gas_narrow_band_50cm.csv"
WINDOWS = {"800-1200": (800, 1200), "2000-3300": (2000, 3300)}
LEVELS = (300, 600, 1000, 1500, 2000, 2500)
BIN, SHARES = 50, {0: 0.25, 25: 0.5, 50: 0.25}
WIDTHS = 0.079 / 0.09 * (296 / 273) ** 0.5  # of lines in nitrogen, there over here

Parameters = dict[tuple[int, int], tuple[float, float]]  # (T [K], start of the bin [cm-1]): k, 1/d


def since_2012() -> Parameters:
    """Means over the table's bins, at every temperature of the excerpt that a bin has."""
    rows = read_rows((HERE / "data" / "h2o_em2c_2012.csv").read_text(encoding="utf-8"))
    given = {
        (int(row["temperature_K"]), int(row["wavenumber_cm-1"])): (
            float(row["k_cm-1_atm-1"]),
            float(row["inverse_spacing_cm"]),
        )
        for row in rows
    }
    made = {}
    for kelvin, start in given:
        bands = [(share, given.get((kelvin, start + step))) for step, share in SHARES.items()]
        if start % BIN == 0 and all(band is not None for _, band in bands):
            mean = sum(share * band[0] for share, band in bands if band)
            strong = sum(share * (band[0] * band[1]) ** 0.5 for share, band in bands if band)
            made[kelvin, start] = mean * kelvin / 273, strong**2 / mean * WIDTHS
    return made


def of_1973() -> Parameters:
    """What the table had before."""
    rows = read_rows((HERE / "data" / "h2o_1973.csv").read_text(encoding="utf-8"))
    return {(int(row["T_K"]), int(row["nu_lo"])): (float(row["k"]), float(row["dinv"])) for row in rows}


def lines_of_table(made: Parameters) -> list[str]:
    """Lines of the table's file, those between the bands made anew."""
    held = PATH.read_text(encoding="utf-8").splitlines()
    new = {
        (kelvin, start): f"H2O,{kelvin},{start},{start + BIN},{k:.4g},{inverse:.3g}"
        for (kelvin, start), (k, inverse) in made.items()
        if kelvin in LEVELS
    }
    water = {(int(c[1]), int(c[2])): line for line in held if (c := line.split(","))[0] == "H2O"} | new
    rest = [line for line in held if not line.startswith("H2O,")]
    head = next(i for i, line in enumerate(rest) if line.startswith("species")) + 1
    return rest[:head] + [water[key] for key in sorted(water)] + rest[head:]


def bin_from(start: int) -> jaxir.Band:
    """The bin that starts there [cm-1]."""
    return jaxir.Band("bin", 1e4 / (start + BIN), 1e4 / start)


def planck_mean(parameters: Parameters, kelvin: int, window: tuple[int, int]) -> float:
    """Of k over a window [cm-1 atm-1]; bins that are left out count as 0."""
    starts = range(*window, BIN)
    black = np.asarray(band_radiance(float(kelvin), [bin_from(start) for start in starts]), np.float64)
    k = [parameters.get((kelvin, start), (0.0, 0.0))[0] for start in starts]
    return float(black @ k / black.sum())


def by_spline(made: Parameters) -> list[float]:
    """ln of what the gas has over what the excerpt has, where its temperature is not one of the table's."""
    apart = []
    gas = jaxir.NarrowBandGas(101325.0, h2o=0.1)
    for (kelvin, start), (k, _) in made.items():
        if kelvin not in LEVELS and kelvin < max(LEVELS):
            nodes = jaxir.resolved_nodes(bin_from(start), BIN, 24, 0)
            mean = jnp.sum(nodes.weight * gas.absorption(nodes, jnp.asarray(float(kelvin)))) / jnp.sum(nodes.weight)
            apart.append(float(np.log(float(mean) / (100 * k * 0.1 * 273 / kelvin))))
    return apart


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--write", action="store_true", help=f"write {PATH.name} anew")


def main(run: Run) -> str:
    made, before = since_2012(), of_1973()
    if run.options.write:
        PATH.write_text("\n".join(lines_of_table(made)) + "\n", encoding="utf-8")
    rows = [
        {
            "window_cm-1": name,
            "temperature_K": kelvin,
            "planck_mean_1973": planck_mean(before, kelvin, window),
            "planck_mean_2012": planck_mean(made, kelvin, window),
        }
        for name, window in WINDOWS.items()
        for kelvin in LEVELS
    ]
    for row in rows:
        row["ratio"] = row["planck_mean_1973"] / row["planck_mean_2012"]
    run.table(rows)
    figure, axes = subplots(1, 2, figsize=(12, 4), sharey=True)
    for axis, (name, window) in zip(axes, WINDOWS.items(), strict=True):
        for colour, kelvin in enumerate(LEVELS):
            starts = np.arange(*window, BIN)
            for style, parameters in (("--", before), ("-", made)):
                k = [parameters.get((kelvin, start), (np.nan, 0))[0] for start in starts]
                label = f"{kelvin} K" if style == "-" else None
                axis.semilogy(starts + BIN / 2, k, style, color=f"C{colour}", label=label)
        axis.set(xlabel="wavenumber [cm-1]", title=f"{name} cm-1")
    axes[0].set_ylabel("k of H2O [cm-1 atm-1 at 273 K]\nlines: 2012, dashes: 1973")
    axes[1].legend()
    run.chart(figure)
    apart = np.abs(by_spline(made))
    said = [
        f"{name} cm-1 " + ", ".join(f"{row['ratio']:.2g}" for row in rows if row["window_cm-1"] == name)
        for name in WINDOWS
    ]
    return (
        f"Planck means of 1973 over those of 2012 at {', '.join(map(str, LEVELS))} K: {'; '.join(said)}; the table's "
        f"spline in temperature errs by {100 * np.median(apart):.1f} % (median) and {100 * apart.max():.0f} % at most"
    )


if __name__ == "__main__":
    study(main, options)
