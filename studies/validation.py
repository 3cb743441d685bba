"""Where does jaxir agree with measurements and other codes, and where does it fail?

Comparisons that need nothing that does not ship, each with what it assumes. `docs/validation.md` says what they mean
and lists those that other commands make.

- The torch: a plasma at 2200-3409 K with traces of CO2 behind 6 m of room air (`studies.torch`), by lines, by the
  embedded narrow-band table alone, and by the default gas and air; NO in the same spectrum checks its scale.
- The motor: burnt ammonium perchlorate and HTPB as a round jet of `JetPlume`. Assumed: equilibrium of the elements with
  water-gas shift at 1900 K, expansion to 1 bar at 1450 K and 2300 m/s, .447 kg/s; no afterburning, or all of it as
  an exit temperature of 2200 K; no soot, no HCl, no air in front.
- Total emissivities of Leckner (1972) and Planck means of the TNF workshop: both hold what lies below 800 cm-1, where
  the table ends.
"""

import argparse
import warnings

import jax.numpy as jnp
import numpy as np

import jaxir
from jaxir.optics.spectrum import STEFAN, band_radiance
from studies import torch
from studies._study import Run, study, subplots
from studies.measurements import read_columns

WIDE = jaxir.Band("800-9300 cm-1", 1e4 / 9300, 1e4 / 800)
ATMOSPHERE = 101325.0
LECKNER = {  # at 1, 10 and 100 bar cm, 1 atm, mole fraction .1
    ("h2o", 1000.0): (0.0356, 0.1504, 0.3771),
    ("h2o", 1500.0): (0.0200, 0.1086, 0.3397),
    ("h2o", 2000.0): (0.0116, 0.0764, 0.2930),
    ("co2", 1000.0): (0.0530, 0.1146, 0.1695),
    ("co2", 1500.0): (0.0384, 0.0975, 0.1564),
    ("co2", 2000.0): (0.0234, 0.0712, 0.1270),
}
TNF = {  # coefficients of (1000 K / T)^n [1 / (m atm)]: Barlow, Karpetis, Frank, Chen, Comb. Flame 127 (2001) 2102
    "h2o": (-0.23093, -1.12390, 9.41530, -2.99880, 0.51382, -1.86840e-5),
    "co2": (18.741, -121.310, 273.500, -194.050, 56.310, -5.8169),
}
MOTOR = {"h2o": 0.387, "co2": 0.134, "co": 0.110}
MOTOR_RADIUS = {1450.0: 0.0170, 2200.0: 0.0209}  # [m] at 1 bar, for .447 kg/s at 2300 m/s


def row(what, reference, ours, unit, note=""):
    return {
        "comparison": what,
        "reference": reference,
        "ours": ours,
        "unit": unit,
        "ratio": ours / reference,
        "note": note,
    }


def black_radiance(temperature):
    """Of a blackbody over the whole spectrum [W m-2 sr-1]."""
    return STEFAN * np.pi**4 / 15 * temperature**4


def planck_mean(gas, temperature, nodes):
    """Of the absorption over the nodes, over the whole spectrum's emission [m-1]."""
    hot = jnp.asarray(temperature)
    emitted = nodes.in_band((gas.absorption(nodes, hot) * band_radiance(hot, nodes))[None])
    return float(emitted[0, 0]) / black_radiance(temperature)


def totals():
    """Leckner's emissivities and the TNF's Planck means."""
    nodes, rows = jaxir.resolved_nodes(WIDE, pair_points=0), []
    for (species, kelvin), known in LECKNER.items():
        gas = jaxir.NarrowBandGas(ATMOSPHERE, **{species: 0.1})
        kappa, black = gas.absorption(nodes, jnp.asarray(kelvin)), band_radiance(jnp.asarray(kelvin), nodes)
        for column, reference in zip((1.0, 10.0, 100.0), known, strict=True):
            path = column * 0.01 / (0.1 * 1.01325)
            ours = float(nodes.in_band((black * -jnp.expm1(-path * kappa))[None])[0, 0]) / black_radiance(kelvin)
            rows.append(
                row(f"{species}, total emissivity, {kelvin:.0f} K, {column:g} bar cm", reference, ours, "1", "Leckner")
            )
    for species, series in TNF.items():
        for kelvin in (1000.0, 1500.0, 2000.0):
            reference = sum(c * (1000 / kelvin) ** n for n, c in enumerate(series))
            ours = planck_mean(jaxir.NarrowBandGas(ATMOSPHERE, **{species: 0.01}), kelvin, nodes) / 0.01
            rows.append(
                row(f"{species}, Planck mean, {kelvin:.0f} K", reference, ours, "1/(m atm)", "TNF, whole spectrum")
            )
    return rows


def motor():
    """The motor's spectral intensity at two exit temperatures."""
    wavelength, measured = read_columns(
        torch.DATA / "motor_2001.csv", ("wavelength_um", "spectral_intensity_W_sr-1_um-1"), gap=10.0
    )
    bands = [jaxir.Band(f"{x:.2f}", x - 0.05, x + 0.05) for x in wavelength]
    nodes, found = jaxir.resolved_nodes(bands, 50.0, 4, 3), []
    for kelvin, radius in MOTOR_RADIUS.items():
        gas = jaxir.NarrowBandGas(1e5, **MOTOR)
        jet = jaxir.JetPlume((0.0, 0.0, 0.0), (-1.0, 0.0, 0.0), 2 * radius, kelvin, 290.0, gas)
        found.append(np.asarray(jaxir.plume_intensity(jaxir.Scene(plumes=jet), 90.0, 0.0, nodes)) / 0.1)
    rows = []
    for x, known, low, high in zip(wavelength, measured, *found, strict=True):
        note = f"{high:.3g} with an exit at 2200 K"
        rows.append(row(f"motor, {x:.2f} um", known, float(low), "W/sr/um", note))
    return rows


def torch_rows(run, quick):
    """The torch by every model, with its chart and table."""
    given = torch.torch()
    measured = torch.means(given.wavelength, given.measured, torch.BINS)
    thin_co, no = torch.companions(given)
    co = torch.means(given.wavelength, thin_co, torch.BINS)
    spectra = {"default gas and air": torch.by_default(given)}
    if not quick:
        slabs = torch.line_by_line(given)
        spectra = {
            "lines": torch.means(given.wavelength, slabs.sum(axis=0) + thin_co, torch.BINS),
            "narrow-band table alone": torch.by_table(given) + co,
            **spectra,
        }
    run.table(
        [
            {
                "from_um": a,
                "to_um": b,
                "measured": m,
                "of which CO": c,
                **{k: v[i] for k, v in spectra.items()},
                **{f"{k}, ratio": v[i] / m for k, v in spectra.items()},
            }
            for i, (a, b, m, c) in enumerate(zip(torch.BINS, torch.BINS[1:], measured, co, strict=False))
        ],
        "validation_torch",
    )
    middle = (torch.BINS[1:] + torch.BINS[:-1]) / 2
    counted = (middle > 4.34) & (middle < 4.9)
    seen = torch.means(given.wavelength, given.measured, torch.NO_BINS)
    rows = [row("torch, NO at 4.96-5.20 um", seen.sum(), no.sum(), "W m-2 sr-1 / um", "scale and core of the profile")]
    for name, spectrum in spectra.items():
        apart = spectrum[counted] / measured[counted]
        note = f"by bin {apart.min():.2f} to {apart.max():.2f}"
        rows.append(
            row(
                f"torch, 4.36-4.88 um, {name}",
                measured[counted].sum(),
                spectrum[counted].sum(),
                "W m-2 sr-1 / um",
                note,
            )
        )
    if not quick:
        rows += asked_for(given, slabs, thin_co)
    figure, (top, low) = subplots(2, 1, figsize=(8, 7), sharex=True)
    top.plot(given.wavelength, given.measured, "k", lw=0.8, label="measured, Packan et al. 2003")
    if not quick:
        top.plot(given.wavelength, slabs.sum(axis=0) + thin_co, lw=0.8, label="lines")
    top.plot(given.wavelength, thin_co, lw=0.8, label="of which CO")
    for name, spectrum in spectra.items():
        low.step(torch.BINS, np.append(spectrum / measured, np.nan), where="post", label=name)
    low.step(torch.NO_BINS, np.append(no / seen, np.nan), where="post", label="NO")
    low.axhspan(0.9, 1.1, color="0.9")
    top.set(ylabel="W m-2 sr-1 / um", ylim=(0, 8), title="Torch at 2200-3409 K behind 6 m of room air")
    low.set(xlabel="wavelength [um]", ylabel="predicted / measured", ylim=(0, 2.5), xlim=(4.15, 5.2))
    top.legend(fontsize=8)
    low.legend(fontsize=8)
    run.chart(figure, "validation_torch")
    return rows


def asked_for(given, slabs, thin_co):
    """Amounts of CO2 in the core and at the rim, and of CO, that the spectrum itself asks for."""
    from scipy.optimize import nnls

    used = (given.wavelength >= 4.34) & (given.wavelength < 4.9)
    rim = given.radius > 0.475
    parts = np.stack([slabs[~rim].sum(axis=0), slabs[rim].sum(axis=0), thin_co])[:, used]
    (inside, outside, co), left = nnls(parts.T, given.measured[used])
    carbon = np.array([given.co[~rim].mean(), given.co2[~rim].mean()])
    ours = float(co * carbon[0] + inside * carbon[1])
    rms = left / used.sum() ** 0.5
    note = f"CO2 x {inside:.2f} inside 0.48 cm and x {outside:.2f} beyond, CO x {co:.2f}, rms {rms:.2f}"
    return [
        row("torch, carbon inside 0.48 cm that the spectrum asks for", float(carbon.sum()), ours, "mole fraction", note)
    ]


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--quick", action="store_true", help="leave out what needs millions of lines")


def main(run: Run) -> str:
    warnings.simplefilter("ignore", jaxir.PlausibilityWarning)  # a room is a short path, a motor a small nozzle
    rows = [*torch_rows(run, run.options.quick), *motor(), *totals()]
    run.table(rows)
    for each in rows:
        print(
            f"{each['comparison']:58s}{each['reference']:10.4g}{each['ours']:10.4g}{each['ratio']:7.2f}  {each['note']}"
        )
    ratio = {each["comparison"]: each["ratio"] for each in rows}
    lined = [f"{name.split(', ')[-1]} {x:.2f}" for name, x in ratio.items() if name.startswith("torch, 4")]
    total = [x for name, x in ratio.items() if "total" in name]
    planck = [x for name, x in ratio.items() if "Planck" in name]
    fired = [x for name, x in ratio.items() if "motor" in name]
    return (
        f"torch at 2200-3409 K, predicted over measured: {', '.join(lined)} (goal .9 to 1.1), "
        f"NO {ratio['torch, NO at 4.96-5.20 um']:.2f}; total emissivities {min(total):.2f} to {max(total):.2f} of "
        f"Leckner's and Planck means {min(planck):.2f} to {max(planck):.2f} of TNF's, both without what lies below 800 "
        f"cm-1; a motor {min(fired):.2f} to {max(fired):.2f} by wavelength without its afterburning"
    )


if __name__ == "__main__":
    study(main, options)
