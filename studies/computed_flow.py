"""What does a computed flow of the paper's exhaust send (Fig. 12 of Yu et al.), and how far is a jet of few parameters?

The exhaust of Table 3, .15 kg/s of burnt pentane at 2000 K from a nozzle of .5 m into air of 26.5 kPa at 218 K, is
marched downstream in still air and in flight at Mach 1, written as a VTK file and read like any other solution.

The flow is that of a round turbulent jet at one pressure, in the boundary-layer approximation. With the stream function
m, dm = rho u r dr, velocity u, total enthalpy and exhaust fraction f obey

    d phi / d x = d / dm (r^2 rho u mu_t / sigma  d phi / dm),    mu_t = rho l^2 |du / dr|,    l = c width,

sigma being 1 for u and .7 else, width the distance between the places where u differs by 1 % from its values on the
axis and outside (a mixing length, Launder and Spalding, Lectures in Mathematical Models of Turbulence, Academic Press
1972). c is .07, theirs for mixing layers, as long as there is a core, and .088 beyond, with which the half radius of a
jet of one density in still air grows by .08 per length (.086 and .094 are measured). Steps are implicit; fluxes of
momentum and exhaust are kept to rounding. Heat capacities are constant, the dissipation that the different sigma imply
is left out, and still air moves at 1 % of the exhaust's speed, because the equations need it.
"""

import argparse
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import solve_banded

import jaxir
from jaxir.io.field import Axes, load_flow
from jaxir.scene.plume import AbstractPlume
from studies import aircraft
from studies._study import Run, study, subplots
from studies.stealth_aircraft import Conditions, exhaust

BANDS = (jaxir.SWIR, jaxir.MWIR, jaxir.LWIR)
LENGTH, RADIUS = 30.0, 1.5  # of the grid [m]
CELLS = (200, 48, 48)
VIEWS = ((90.0, 0.0), (150.0, 0.0), (30.0, 0.0))
HEAT = {"air": 1005.0, "exhaust": 1250.0}  # heat capacity [J kg-1 K-1]
GAS = 8.314 / 28.7e-3  # gas constant of both [J kg-1 K-1]
LAYER, ROUND, PRANDTL = 0.07, 0.088, 0.7
SOUND = 296.0  # in air at 218 K [m/s]


@dataclasses.dataclass(frozen=True)
class Jet:
    """What leaves the nozzle, and the air around."""

    speed: float  # [m/s]
    temperature: float  # [K]
    air_speed: float
    air_temperature: float
    pressure: float  # [Pa]
    diameter: float  # [m]

    def density(self, temperature: Any) -> Any:
        """By the ideal gas law [kg m-3]."""
        return self.pressure / (GAS * temperature)


@dataclasses.dataclass(frozen=True)
class Flow:
    """A solution on a half plane [station, ring]."""

    along: np.ndarray  # [station] [m]
    radius: np.ndarray  # [station, ring] [m]
    speed: np.ndarray  # [m/s]
    temperature: np.ndarray  # [K]
    fraction: np.ndarray  # of exhaust
    mass: np.ndarray  # of each ring [ring], dm [kg s-1 rad-1]


def state(jet: Jet, enthalpy: np.ndarray, speed: np.ndarray, fraction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Temperature [K] and density [kg m-3]."""
    heat = HEAT["air"] + fraction * (HEAT["exhaust"] - HEAT["air"])
    temperature = (enthalpy - speed**2 / 2) / heat
    return temperature, jet.density(temperature)


def march(jet: Jet, length: float, rings: int = 500, stations: int = 400) -> Flow:
    """Solve the jet from the nozzle to `length` [m]."""
    density = jet.density(np.array([jet.temperature, jet.air_temperature]))
    exit_flow = density[0] * jet.speed * (jet.diameter / 2) ** 2 / 2
    wide = jet.diameter / 2 + 0.35 * length
    outer = max(density[1] * jet.air_speed * wide**2 / 2, 0.5 * exit_flow * length / jet.diameter) + exit_flow
    edge = outer * np.linspace(0, 1, rings + 1) ** 3
    edge[np.argmin(np.abs(edge - exit_flow))] = exit_flow  # a ring ends where the nozzle does
    mass, apart = np.diff(edge), np.diff((edge[1:] + edge[:-1]) / 2)
    inside = edge[1:] <= exit_flow * (1 + 1e-9)
    fraction = inside.astype(float)
    speed = np.where(inside, jet.speed, jet.air_speed)
    heat = np.where(inside, HEAT["exhaust"], HEAT["air"])
    enthalpy = heat * np.where(inside, jet.temperature, jet.air_temperature) + speed**2 / 2
    place = np.concatenate([[0.0], np.geomspace(1e-3 * jet.diameter, length, stations - 1)])
    held = []
    for step in np.diff(place, prepend=0.0):
        for _ in range(4 if step else 0):  # smaller steps for what is taken from the station before
            temperature, rho = state(jet, enthalpy, speed, fraction)
            core = (speed[0] - speed[-1]) / (jet.speed - jet.air_speed) > 0.99
            spread = _exchange(mass, rho, speed, LAYER if core else ROUND)
            speed = _implicit(speed, spread, mass, apart, step / 4)
            enthalpy = _implicit(enthalpy, spread / PRANDTL, mass, apart, step / 4)
            fraction = _implicit(fraction, spread / PRANDTL, mass, apart, step / 4)
        temperature, rho = state(jet, enthalpy, speed, fraction)
        held.append((_radius(mass, rho, speed), speed, temperature, fraction))
    return Flow(place, *(np.array(each) for each in zip(*held, strict=True)), mass)


def _radius(mass: np.ndarray, density: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Radii of the rings' middles [m], each halving the area of its ring."""
    area = 2 * mass / (density * speed)
    return np.sqrt(np.cumsum(area) - area / 2)


def _exchange(mass: np.ndarray, density: np.ndarray, speed: np.ndarray, share: float) -> np.ndarray:
    """r^2 rho u mu_t between the rings [ring - 1], for a mixing length that is a `share` of the width."""
    middle = _radius(mass, density, speed)
    outer = np.sqrt(np.cumsum(2 * mass / (density * speed)))[:-1]
    excess = (speed - speed[-1]) / (speed[0] - speed[-1])
    first, last = (np.interp(-level, -excess, middle) for level in (0.99, 0.01))
    length = share * max(last - first, 1e-3 * outer[0])
    slope = np.abs(np.diff(speed) / np.diff(middle))
    rho, u = (np.sqrt(value[1:] * value[:-1]) for value in (density, speed))
    laminar = 1e-3 * rho[0] * abs(speed[0] - speed[-1]) * length
    return outer**2 * rho * u * (rho * length**2 * slope + laminar)


def _implicit(value: np.ndarray, exchange: np.ndarray, mass: np.ndarray, apart: np.ndarray, step: float) -> np.ndarray:
    """One step of diffusion without flux through axis and outer edge, which keeps sum(mass * value)."""
    flux = step * exchange / apart
    bands = np.zeros((3, len(value)))
    bands[1] = mass
    bands[1, :-1] += flux
    bands[1, 1:] += flux
    bands[0, 1:] = bands[2, :-1] = -flux
    return solve_banded((1, 1), bands, mass * value)


def write(path: Path, flow: Flow) -> None:
    """The half plane as a structured VTK file, x along the flow and y outward, from the axis on."""
    import pyvista

    along = np.repeat(flow.along[:, None], flow.radius.shape[1] + 1, axis=1)
    radius = np.concatenate([np.zeros((len(flow.along), 1)), flow.radius], axis=1)
    grid = pyvista.StructuredGrid(along[:, :, None], radius[:, :, None], np.zeros_like(along)[:, :, None])
    for name, field in (("T", flow.temperature), ("exhaust", flow.fraction)):
        grid.point_data[name] = np.concatenate([field[:, :1], field], axis=1).ravel(order="F")
    grid.save(path)


def plume(path: Path, gas: jaxir.NarrowBandGas) -> tuple[jaxir.GridPlume, str]:
    """A plume from the file, and what its resampling did."""
    back = (aircraft.TAIL_X - LENGTH, -RADIUS, -RADIUS), (aircraft.TAIL_X, RADIUS, RADIUS)
    flow = load_flow(
        path,
        {"T": aircraft.AMBIENT, "exhaust": 0.0},
        unit="m",
        shape=CELLS,
        box=back,
        axisymmetric="x",
        axes=Axes(nose="-x", up="+z", offset=(aircraft.TAIL_X, 0.0, 0.0)),
    )
    share = np.clip(flow.fields["exhaust"], 0, 1)
    own = gas.diluted(share, aircraft.AMBIENT / flow.fields["T"])
    return jaxir.GridPlume(flow.grid, flow.fields["T"], own), flow.describe()


def plumes(run: Run, given: Conditions) -> dict[str, tuple[AbstractPlume, Flow | None]]:
    gas, speed = exhaust(given)
    found: dict[str, tuple[AbstractPlume, Flow | None]] = {}
    for name, air in (("flow, still air", 0.01 * speed), ("flow, Mach 1", SOUND)):
        jet = Jet(speed, given.exit_temperature, air, aircraft.AMBIENT, given.pressure, aircraft.NOZZLE)
        flow = march(jet, LENGTH)
        path = run.bulk() / f"{name.replace(', ', '_').replace(' ', '_')}.vts"
        write(path, flow)
        own, said = plume(path, gas)
        found[name] = own, flow
        print(f"{name}: {said}")
    found["jet of few parameters"] = (
        jaxir.JetPlume(
            (aircraft.TAIL_X, 0.0, 0.0),
            (-1.0, 0.0, 0.0),
            aircraft.NOZZLE,
            given.exit_temperature,
            aircraft.AMBIENT,
            gas,
            length=LENGTH / aircraft.NOZZLE,
        ),
        None,
    )
    return found


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--rows", type=int, default=60, help="of an image (%(default)s)")


def main(run: Run) -> str:
    found = plumes(run, Conditions())
    figure, panels = subplots(len(found), 3, figsize=(15, 7), sharex="col")
    rows, side = [], {}
    camera = jaxir.orthographic_camera(
        90.0, 0.0, 3.0 / run.options.rows, (run.options.rows, 10 * run.options.rows), (aircraft.TAIL_X - 15, 0.0, 0.0)
    )
    z, r = np.linspace(0.02, LENGTH, 400), np.linspace(-RADIUS, RADIUS, 121)
    for row, (name, (own, flow)) in enumerate(found.items()):
        scene = jaxir.Scene(plumes=own)
        table = jaxir.signature(scene, VIEWS, BANDS)
        for (azimuth, _), value, error in zip(VIEWS, table.intensity, table.error_budget().total, strict=True):
            words = (f"{band.name}{what}_W_per_sr" for what in ("", "_error") for band in BANDS)
            numbers = np.concatenate([np.asarray(value), np.asarray(error)])
            rows.append({"plume": name, "azimuth_deg": azimuth} | dict(zip(words, numbers.tolist(), strict=True)))
        side[name] = np.asarray(table.intensity)[0]
        if flow is None:
            assert isinstance(own, jaxir.JetPlume)
            points = np.stack(np.broadcast_arrays(aircraft.TAIL_X - z[:, None], 0.0, r[None]), axis=-1)
            temperature = np.asarray(own.state(points)[0])
        else:
            across = np.array([np.interp(np.abs(r), a, b) for a, b in zip(flow.radius, flow.temperature, strict=True)])
            temperature = np.array([np.interp(z, flow.along, column) for column in across.T]).T
        image = np.asarray(jaxir.render(scene, camera, (jaxir.MWIR, jaxir.LWIR), samples=8).radiance)
        extent = (0.0, LENGTH, -RADIUS, RADIUS)
        drawn = [(temperature.T, "temperature [K]", 200, 2000)]
        drawn += [
            (np.log10(np.maximum(image[::-1, :, k], 1e-3)), f"{band} [log10 W m$^{{-2}}$ sr$^{{-1}}$]", -1, top)
            for k, (band, top) in enumerate((("MWIR", 3.5), ("LWIR", 2.5)))
        ]
        for axis, (field, label, low, high) in zip(panels[row], drawn, strict=True):
            shown = axis.imshow(
                field, extent=extent, aspect="auto", cmap="inferno", vmin=low, vmax=high, origin="lower"
            )
            axis.set_title(f"{name}: {label}", fontsize=9)
            figure.colorbar(shown, ax=axis)
        panels[row, 0].set_ylabel("m")
    for axis in panels[-1]:
        axis.set_xlabel("behind the nozzle [m]")
    run.table(rows)
    run.chart(figure, dpi=80)
    few = side["jet of few parameters"]
    said = [
        ", ".join(f"{band.name} {one:.2f}" for band, one in zip(BANDS, side[name] / few, strict=True))
        for name in list(found)[:2]
    ]
    return f"W/sr from the side over those of the jet of few parameters: in still air {said[0]}; at Mach 1 {said[1]}"


if __name__ == "__main__":
    study(main, options, needs=("matplotlib", "pyvista"))
