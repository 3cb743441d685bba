"""What does each way of finding light that particles scatter cost, and where does it fail?

A warm jet with gray particles beside a hot plate under the sun, over the optical depth of scattering across its nozzle,
the albedo and the asymmetry of Henyey and Greenstein's phase function, seen from the side and from ahead, the plate
edge-on. Each way is compared with long forced collision, and with what it tells of its own error: standard error and
truncation. Where neither it nor the reference leaves out more than a part of that, its deviation in standard errors, z,
tells whether it has a bias.
"""

import argparse
import time
from collections.abc import Iterator
from typing import NamedTuple

import jax
import numpy as np
from tqdm import tqdm

import jaxir
from jaxir import DiscreteOrdinates, Method, SkinLight
from studies._study import Run, study, subplots

DEPTHS = (0.1, 1.0, 5.0, 20.0, 50.0)
ALBEDOS = (0.3, 0.9, 1.0)
ASYMMETRIES = (0.0, 0.6, 0.95)
LIGHTS = ("own", "plate", "sun")  # in turn
ASPECTS = ((90.0, 0.0), (20.0, 0.0))  # the plate edge-on
DIAMETER = 0.5
SHAPE = (24, 48)
WAYS = {
    "once": (Method(orders=1, skin_light=SkinLight()), 16),
    "10 orders": (Method(orders=10, skin_light=SkinLight()), 16),
    "lattice 13 x 5, sampled": (Method(scattering=DiscreteOrdinates(13, 5, orders=8), skin_light=SkinLight()), 16),
    "lattice 13 x 5": (Method(scattering=DiscreteOrdinates(13, 5)), 2),
    "lattice 25 x 7": (Method(scattering=DiscreteOrdinates()), 2),
    "lattice 41 x 9, order 5": (Method(scattering=DiscreteOrdinates(41, 9, 5)), 2),
}
CLOSE = 1e-3  # the longest reference's standard error
LEFT = 0.01  # share of a reference beyond its last order at most
PART = 0.3  # of standard errors that may be left out where z is looked at


class Case(NamedTuple):
    """Optics of the particles, and what lights them."""

    depth: float
    albedo: float
    asymmetry: float
    light: str

    def scene(self, warmer: float = 0.0) -> jaxir.Scene:
        """Alike in structure for all; `warmer` [K] makes it another one."""
        phase = jaxir.HenyeyGreenstein(self.asymmetry)
        particles = jaxir.GrayParticles(self.depth / DIAMETER / self.albedo, self.albedo, phase)
        hot = {"own": 700.0, "plate": 250.0, "sun": 250.0}[self.light]
        jet = jaxir.JetPlume(
            (0.0, 0.0, 0.0),
            (-1.0, 0.0, 0.0),
            DIAMETER,
            hot + warmer,
            250.0,
            jaxir.GrayGas(0.05),
            length=8.0,
            panels=8,
            particles=particles,
        )
        corners = [(-3.0, -1.0, -1.5), (0.0, -1.0, -1.5), (0.0, 1.0, -1.5), (-3.0, 1.0, -1.5)]
        plate = jaxir.Mesh(corners, [(0, 1, 2), (0, 2, 3)])
        skin = jaxir.Skin(plate, 900.0 if self.light == "plate" else 100.0, jaxir.Lambert(1.0))
        sun = jaxir.ParallelSource((0.0, 0.6, -0.8), 100.0 if self.light == "sun" else 0.0)
        return jaxir.Scene(skin, jet, sun)


def cases() -> Iterator[Case]:
    index = 0
    for depth in DEPTHS:
        for albedo in ALBEDOS:
            for asymmetry in ASYMMETRIES:
                yield Case(depth, albedo, asymmetry, LIGHTS[index % 3])
                index += 1


def plume_alone(case: Case, method: Method, samples: int, key: int = 0, warmer: float = 0.0) -> jaxir.Signature:
    return jaxir.signature(
        case.scene(warmer),
        ASPECTS,
        [jaxir.MWIR],
        shape=SHAPE,
        samples=samples,
        method=method,
        key=jax.random.key(key),
    )


def orders_for(case: Case) -> int:
    """So many that little is left beyond them; few numbers of them, for each is a program of its own. 0: too many."""
    if case.albedo == 1 and case.depth > 5:
        return 0
    if case.albedo < 0.5 or case.depth < 0.5:
        return 12
    if case.depth < 2:
        return 30
    return 80 if case.albedo < 1 else 150


def reference(case: Case, seconds: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Long forced collision: intensity [view], its standard error and what is left beyond the last order [view]."""
    orders = orders_for(case)
    if orders == 0:
        return np.ones(2), np.full(2, np.nan), np.full(2, np.nan)
    method = Method(orders=orders, skin_light=SkinLight())
    passes, begin = [], time.perf_counter()
    while True:
        found = plume_alone(case, method, 4, 100 + len(passes))
        passes.append([np.asarray(x, float)[:, 0] for x in (found.intensity, found.truncation)])
        value = np.array([intensity for intensity, _ in passes])
        mean = value.mean(axis=0)
        error = value.std(axis=0, ddof=1) / np.sqrt(len(value)) if len(value) > 2 else np.full(2, np.inf)
        if np.all(error < CLOSE * mean) or (time.perf_counter() - begin > seconds and len(value) > 7):
            return mean, error, np.median([left for _, left in passes], axis=0) * mean


def measured(case: Case, method: Method, samples: int, compile_first: bool) -> tuple[jaxir.Signature, float]:
    """A signature, and its seconds without compilation; of a scene that was not solved for before."""
    if compile_first:
        plume_alone(case, method, samples, 1, warmer=0.01)
    begin = time.perf_counter()
    found = plume_alone(case, method, samples, 2)
    jax.block_until_ready(found.intensity)
    return found, time.perf_counter() - begin


def rows_of(case: Case, seconds: float, compiled: list[tuple]) -> Iterator[dict]:
    mean, error, left = reference(case, seconds)
    for way, (method, samples) in WAYS.items():
        try:
            kind = way, case.depth, case.light  # where a plume is deep light of the sun is looked for along rays
            found, taken = measured(case, method, samples, kind not in compiled)
            compiled.append(kind)
            value, deviation, share = (
                np.asarray(x, float)[:, 0] for x in (found.intensity, found.standard_error, found.truncation)
            )
            refused = ""
        except ValueError as reason:
            value = deviation = share = np.full(2, np.nan)
            taken, refused = np.nan, str(reason).split(":")[1].strip()
        for view, (azimuth, _) in enumerate(ASPECTS):
            known = left[view] < LEFT * mean[view]
            noise = np.hypot(deviation[view], error[view])
            seen = known and left[view] + share[view] * value[view] < PART * noise
            yield {
                **case._asdict(),
                "azimuth_deg": azimuth,
                "way": way,
                "seconds": taken,
                "error_percent": 100 * (value[view] / mean[view] - 1) if known else np.nan,
                "told_percent": 100 * (deviation[view] + share[view] * value[view]) / mean[view],
                "reference_percent": 100 * (error[view] + left[view]) / mean[view],
                "z": (value[view] - mean[view]) / noise if seen else np.nan,
                "refused": refused,
            }


def honest(row: dict) -> bool:
    """Whether the truth may lie within twice what was told, three standard errors of the reference aside."""
    return abs(row["error_percent"]) <= 2 * row["told_percent"] + 3 * row["reference_percent"]


def chart(run: Run, rows: list[dict]) -> None:
    """Error over depth for every albedo and asymmetry, and error over time."""
    from matplotlib.ticker import NullFormatter

    figure, axes = subplots(len(ALBEDOS), len(ASYMMETRIES) + 1, figsize=(13, 8))
    colours = {way: f"C{index}" for index, way in enumerate(WAYS)}
    floor = 0.02  # [%]
    for across, albedo in zip(axes, ALBEDOS, strict=True):
        for axis, asymmetry in zip(across, ASYMMETRIES, strict=False):
            own = [row for row in rows if (row["albedo"], row["asymmetry"]) == (albedo, asymmetry)]
            for way, colour in colours.items():
                found = [(r["depth"], r["error_percent"]) for r in own if r["way"] == way]
                depth = sorted({at for at, _ in found})
                worst = [max(max(abs(e) for at, e in found if at == d), floor) for d in depth]
                axis.loglog(depth, worst, "o-", color=colour, label=way)
            known = [r for r in own if np.isfinite(r["reference_percent"])]
            noise = {r["depth"]: max(k["reference_percent"] for k in known if k["depth"] == r["depth"]) for r in known}
            axis.fill_between(list(noise), floor, [max(x, floor) for x in noise.values()], color="0.85", zorder=0)
            axis.set(title=f"albedo {albedo:g}, g = {asymmetry:g}", ylim=(floor, 150))
        axis = across[-1]
        for way, colour in colours.items():
            own = [r for r in rows if r["way"] == way and r["albedo"] == albedo]
            axis.loglog(
                [r["seconds"] for r in own], [max(abs(r["error_percent"]), floor) for r in own], ".", color=colour
            )
        axis.set(title=f"albedo {albedo:g}, all", ylim=(floor, 150))
        axis.xaxis.set_minor_formatter(NullFormatter())
    for axis in axes[-1][:-1]:
        axis.set_xlabel("optical depth of scattering")
    axes[-1][-1].set_xlabel("seconds for two views, warm")
    for across in axes:
        across[0].set_ylabel("error [%], worse of two views")
    figure.legend(*axes[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=len(WAYS))
    run.chart(figure)


def main(run: Run) -> str:
    chosen, compiled = list(cases())[:: run.options.every], []
    rows = [row for case in tqdm(chosen, "cases") for row in rows_of(case, run.options.seconds, compiled)]
    run.table(rows)
    chart(run, rows)
    parts = []
    for way in WAYS:
        own = [row for row in rows if row["way"] == way]
        met = [row for row in own if np.isfinite(row["error_percent"])]
        error = np.abs([row["error_percent"] for row in met])
        told, refused = sum(honest(row) for row in met), sum(bool(row["refused"]) for row in own)
        seconds = np.nanmedian([row["seconds"] for row in own])
        z = np.array([row["z"] for row in own if np.isfinite(row["z"])])
        unbiased = f", z of {len(z)}: rms {np.sqrt(np.mean(z**2)):.2f}, worst {np.abs(z).max():.1f}" if len(z) else ""
        parts.append(
            f"{way}: {np.median(error):.2g} % (worst {error.max():.2g} %) in {seconds:.2g} s, "
            f"told in {told} of {len(met)}, refused {refused} of {len(own)}{unbiased}"
        )
    return "; ".join(parts)


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seconds", type=float, default=8.0, help="for a reference (%(default)s)")
    parser.add_argument("--every", type=int, default=1, help="take every so many cases only (%(default)s)")


if __name__ == "__main__":
    study(main, options)
