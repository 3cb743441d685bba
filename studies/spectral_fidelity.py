"""How much spectral detail does a hot plume behind cold air need, and what does it cost?

Hot CO2 at 4.3 um (2000-2400 cm-1, 0.3 atm) seen in vacuum, through 5 km of air at 10 km and from the ground 11.5 km
away, by every spectral model that jaxir has: error of the in-band radiance against a line-by-line sum, and CPU time of
a ray through seven cells. The lines are the nu3 bands of `studies.co2_lines`, made of published constants: no
HITRAN file is needed, and CO2 is the only absorber. The air's emission is left out. The method "line by line" runs on
the grid of the reference: its error is that of single precision alone.

"As bands are" is what a user gets who asks for the band: `NarrowBandGas`, `StandardAtmosphere` and the nodes that
`scene_nodes` takes. Its reference has the same air: lines of CO2 whose mean transmittance in each 50 cm-1 is, as
`slot_path` says, that of the fit to LOWTRAN 7, which holds N2O, 13CO2, water and sub-Lorentzian wings, too.
"""

import argparse
import time
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

import jaxir
from jaxir.geometry import Rays
from jaxir.io.spectra import tabulate
from jaxir.optics.air import path_air
from jaxir.optics.gas import bins_of, slot_means
from jaxir.scene import scene_nodes
from studies import co2_lines as lines
from studies._study import Run, study, subplots

LOW, HIGH = 2000.0, 2400.0
BAND = jaxir.Band("4.3 um", 1e4 / HIGH, 1e4 / LOW)
PRESSURE, CO2_IN_AIR = 0.3 * lines.ATMOSPHERE, 400e-6
PATHS = {
    "vacuum": None,
    "5 km at 10 km": jaxir.StandardAtmosphere(10e3, 10e3, 5e3),
    "11.5 km to ground": jaxir.StandardAtmosphere(0.0, 10e3, 11544.0),
}
LAYERS = (400.0, 650.0, 1000.0, 1500.0, 1000.0, 650.0, 400.0)
PLUMES = {  # temperatures of the cells [K], mole fraction, thickness of a cell [m]
    "1500 K, thick": ((1500.0,) * 7, 0.06, 0.3),
    "1500 K, thin": ((1500.0,) * 7, 0.06, 0.005),
    "1000 K, thick": ((1000.0,) * 7, 0.06, 0.3),
    "1000 K, dilute": ((1000.0,) * 7, 0.006, 0.015),
    "400-1500 K, thick": (LAYERS, 0.06, 0.2),
    "400-1500 K, thin": (LAYERS, 0.06, 0.02),
}
DEFAULT = "as bands are"
INSIDE = (lines.GRID > LOW - 1e-6) & (lines.GRID < HIGH - 1e-6)


class Method(NamedTuple):
    """A spectral model: nodes, gas of (temperatures, mole fraction), whether the air is averaged over slots."""

    name: str
    nodes: jaxir.Nodes
    gas: Callable
    slots: bool


def per_cell(values):
    """[cell, ...] on the grid, whose cells lie along x towards the eye."""
    value = np.asarray(values)[::-1]
    return value.reshape(value.shape[0], 1, 1, *value.shape[1:])


def gray_gas(nodes):
    """Planck means of the absorption over each bin."""

    def gas(temperatures, amount):
        def means(temperature):
            kappa, planck = lines.absorption(temperature, PRESSURE, amount), lines.planck(temperature)
            return [
                np.average(kappa[each.samples], weights=planck[each.samples]) for each in bins_of(nodes, lines.GRID)
            ]

        return jaxir.GrayGas(per_cell([means(t) for t in temperatures]))

    return gas


def table_gas(nodes, temperatures=None):
    """Tables at the default temperatures, or at those of the plumes alone."""
    axes = {} if temperatures is None else {"temperature": temperatures}
    table = tabulate(lines.SPECTRA, nodes, pressure=[PRESSURE], mole_fraction=[0.0], progress=False, **axes)
    return lambda _, amount: jaxir.CorrelatedK(table, PRESSURE, {"CO2": amount})


def methods():
    """All of them, one after the other."""

    def bins(width, points):
        return jaxir.resolved_nodes(BAND, width, points, pair_points=0)

    nodes = jaxir.gray_nodes([BAND])
    yield Method("gray", nodes, gray_gas(nodes), False)
    nodes = bins(25.0, 1)
    yield Method("gray in bins", nodes, gray_gas(nodes), False)
    narrow = lambda _, amount: jaxir.NarrowBandGas(PRESSURE, co2=amount)  # noqa: E731
    for points in (2, 4, 8, 16):
        yield Method(f"narrow-band, {points} g", bins(50.0, points), narrow, False)
    yield Method("narrow-band, 8 g, air in slots", bins(50.0, 8), narrow, True)
    nodes = bins(25.0, 8)
    gas = table_gas(nodes)
    yield Method("correlated-k, 8 g", nodes, gas, False)
    yield Method("correlated-k, 8 g, air in slots", nodes, gas, True)
    for points in (2, 4, 16):
        nodes = bins(25.0, points)
        yield Method(f"correlated-k, {points} g, air in slots", nodes, table_gas(nodes), True)
    nodes = bins(lines.STEP, 1)
    yield Method("line by line", nodes, table_gas(nodes, sorted(set(LAYERS))), True)


def transmittance(method, depth, hottest):
    """Of the air on the nodes of a method."""
    nodes = method.nodes
    if depth is None:
        return np.ones(nodes.count)
    if method.slots:
        ranked_by = lines.absorption(hottest, PRESSURE, 0.06)
        none = np.zeros_like(depth)
        return slot_means(nodes, lines.GRID, np.stack([ranked_by, none]), np.stack([depth, none]))
    result = np.empty(nodes.count)
    for each in bins_of(nodes, lines.GRID):
        result[each.nodes] = np.exp(-depth[each.samples]).mean()
    return result


def fitted(air, depth):
    """Transmittance on the grid of lines of CO2 whose means in bins are those of the air [sample]."""
    path = path_air(air.profile, air.sensor_altitude, air.target_altitude, air.distance)
    uniform, total = np.asarray(path.uniform[-1], float), np.asarray(path.depth[-1], float)
    through = np.exp(-depth)
    for low in np.arange(LOW, HIGH, 50.0):
        row, inside = int((low - 800) / 50), (lines.GRID > low - 1e-6) & (lines.GRID < low + 50 - 1e-6)
        wanted, mean = np.exp(-uniform[row]), through[inside].mean()
        darker, brighter = through[inside] * wanted / mean, 1 - (1 - through[inside]) * (1 - wanted) / (1 - mean)
        through[inside] = np.exp(uniform[row] - total[row]) * (darker if wanted <= mean else brighter)
    return through


def as_bands_are(depths, repeat):
    """Rows of the method that a user gets who asks for a band."""
    rays, rows = parallel_rays(4096), []
    for name, air in PATHS.items():
        front = 1.0 if air is None else fitted(air, depths[name])
        for label, (temperatures, amount, thickness) in PLUMES.items():
            layers = [(t, PRESSURE, amount, thickness) for t in temperatures]
            spectrum = front * lines.radiance(layers, 0.0)
            truth = spectrum[INSIDE].mean() * (HIGH - LOW)
            method = Method(DEFAULT, None, lambda _, amount: jaxir.NarrowBandGas(PRESSURE, co2=amount), True)
            scene = scene_of(method, PLUMES[label], air)
            nodes = scene_nodes(scene, BAND)
            paths = jaxir.trace(scene, rays)
            added = 0.0 if air is None else nodes.in_band(scene.on(nodes).air.path_radiance[None])[0, 0]
            value = float(jax.block_until_ready(seen(scene, nodes, paths))[0, 0] - added)
            spent = []
            for _ in range(repeat):
                began = time.process_time()
                jax.block_until_ready(seen(scene, nodes, paths))
                spent.append(time.process_time() - began)
            rows.append(
                {
                    "method": DEFAULT,
                    "nodes": nodes.count,
                    "path": name,
                    "plume": label,
                    "line_by_line": truth,
                    "radiance": value,
                    "error_percent": 100 * (value / truth - 1),
                    "cpu_microseconds_a_ray": 1e6 * min(spent) / rays.origin.shape[0],
                }
            )
    return rows


@eqx.filter_jit
def seen(scene, nodes, paths):
    return nodes.in_band(jaxir.evaluate(scene.on(nodes), paths))


def scene_of(method, plume, air):
    """Seven cells behind a path: transmittances on the method's nodes, or an atmosphere, or none."""
    temperatures, amount, thickness = plume
    grid = jaxir.Grid((-7 * thickness, -1.0, -1.0), (thickness, 2.0, 2.0), (7, 1, 1))
    gas = method.gas(temperatures, amount)
    path = air if air is None or isinstance(air, jaxir.StandardAtmosphere) else jaxir.FixedPath(air)
    return jaxir.Scene(plumes=jaxir.GridPlume(grid, per_cell(temperatures), gas), atmosphere=path)


def parallel_rays(count):
    start = jnp.stack([jnp.ones(count), jnp.linspace(-0.9, 0.9, count), jnp.zeros(count)], axis=-1)
    return Rays(start, jnp.tile(jnp.asarray([[-1.0, 0.0, 0.0]]), (count, 1)))


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--repeat", type=int, default=3, help="evaluations of which the fastest counts (%(default)s)")


def main(run: Run) -> str:
    chosen = run.options

    depths = {name: None if air is None else lines.air_depth(air, CO2_IN_AIR) for name, air in PATHS.items()}
    truth = {}
    for name, depth in depths.items():
        for label, (temperatures, amount, thickness) in PLUMES.items():
            layers = [(t, PRESSURE, amount, thickness) for t in temperatures]
            spectrum = lines.radiance(layers, 0.0 if depth is None else depth)
            truth[name, label] = spectrum[INSIDE].mean() * (HIGH - LOW)

    rows = []
    for method in tqdm(methods(), desc="methods"):
        fastest, rays = np.inf, parallel_rays(int(np.clip(1_000_000 // method.nodes.count, 64, 8192)))
        for name, depth in depths.items():
            airs = {}
            for label, plume in PLUMES.items():
                hottest = max(plume[0])
                if hottest not in airs:
                    airs[hottest] = transmittance(method, depth, hottest)
                scene = scene_of(method, plume, airs[hottest])
                paths = jaxir.trace(scene, rays)
                value = jax.block_until_ready(seen(scene, method.nodes, paths))
                if name == "vacuum":
                    for _ in range(chosen.repeat):
                        began = time.process_time()
                        jax.block_until_ready(seen(scene, method.nodes, paths))
                        fastest = min(fastest, (time.process_time() - began) / rays.origin.shape[0])
                rows.append(
                    {
                        "method": method.name,
                        "nodes": method.nodes.count,
                        "path": name,
                        "plume": label,
                        "line_by_line": truth[name, label],
                        "radiance": float(value[0, 0]),
                        "error_percent": 100 * (float(value[0, 0]) / truth[name, label] - 1),
                    }
                )
        for row in rows:
            if row["method"] == method.name:
                row["cpu_microseconds_a_ray"] = 1e6 * fastest
    rows += as_bands_are(depths, chosen.repeat)
    run.table(rows, digits=5)
    run.chart(chart(rows), dpi=80)
    return report(rows)


def worst(rows, name, place):
    return max(abs(row["error_percent"]) for row in rows if (row["method"], row["path"]) == (name, place))


def chart(rows):
    """Largest error over the plumes against CPU time, one panel per path; series of growing g are joined."""
    cost = {row["method"]: row["cpu_microseconds_a_ray"] for row in rows}
    series = {
        "gray": ["gray"],
        "gray in bins": ["gray in bins"],
        "narrow-band k, 2 4 8 16 g": [f"narrow-band, {n} g" for n in (2, 4, 8, 16)],
        "narrow-band k, 8 g, air in slots": ["narrow-band, 8 g, air in slots"],
        "correlated-k, 8 g": ["correlated-k, 8 g"],
        "as bands are": [DEFAULT],
        "correlated-k, 2 4 8 16 g, air in slots": [f"correlated-k, {n} g, air in slots" for n in (2, 4, 8, 16)],
        "line by line": ["line by line"],
    }
    figure, axes = subplots(1, 3, figsize=(13, 4.6), sharey=True)
    for axis, place in zip(axes, PATHS, strict=True):
        for (label, names), marker in zip(series.items(), "xDosvP^*", strict=True):
            axis.plot([cost[n] for n in names], [worst(rows, n, place) for n in names], marker=marker, label=label)
        axis.axhline(2, color="k", lw=0.6, ls=":")
        axis.set(xscale="log", yscale="log", title=place, xlabel="CPU time of a ray [us]")
    axes[0].set_ylabel("largest error of the in-band radiance [%]")
    axes[1].legend(fontsize=8)
    return figure


def report(rows):
    """Print one line per method: nodes, time, range of the error on each path. Return what to pick."""
    print(f"{'method':34s}{'nodes':>7s}{'us a ray':>10s}" + "".join(f"{place:>22s}" for place in PATHS))
    for name in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == name]
        spans = []
        for place in PATHS:
            error = [row["error_percent"] for row in own if row["path"] == place]
            spans.append(f"{min(error):+.1f} ... {max(error):+.1f} %")
        cost = own[0]["cpu_microseconds_a_ray"]
        print(f"{name:34s}{own[0]['nodes']:7d}{cost:10.2f}" + "".join(f"{s:>22s}" for s in spans))
    most = {
        name: max(worst(rows, name, p) for p in list(PATHS)[1:]) for name in dict.fromkeys(r["method"] for r in rows)
    }
    return (
        f"bands as they are err by {worst(rows, DEFAULT, 'vacuum'):.1f} % in vacuum and {most[DEFAULT]:.1f} % through "
        f"air; on nodes of one's own the gas needs 4 to 8 g (vacuum: within "
        f"{worst(rows, 'narrow-band, 8 g', 'vacuum'):.0f} %; through air {most['narrow-band, 8 g']:.0f} %, "
        f"{most['narrow-band, 8 g, air in slots']:.0f} % with the air in slots), correlated-k with 8 g and the air in "
        f"slots for {most['correlated-k, 8 g, air in slots']:.1f} % through air (in vacuum "
        f"{worst(rows, 'correlated-k, 8 g, air in slots', 'vacuum'):.0f} % where hot gas shines through a thin colder "
        "layer), line by line to check the two, gray for tests alone"
    )


if __name__ == "__main__":
    study(main, options)
