"""What does an aircraft with its plume look like in the infrared, how many W/sr does it send where, what hides it?

Section 3 of Yu et al. (10.3788/IRLA20200241): an aircraft plain and suppressed, seen from the ground and from the air,
as images (Fig. 15) and as radiant intensity around three axes (Fig. 14), with the paper's conclusions checked against
the numbers. `--mesh FILE --unit m` does the same for your own mesh.

The three bands are computed on one set of spectral nodes, chosen for the air of both places, in vacuum; air multiplies
every node afterwards.
"""

import argparse
import dataclasses
import platform
import time
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxir
from jaxir import plot
from jaxir.imaging import Signature
from jaxir.io.mesh import METRES, load_mesh
from jaxir.io.result import save_image, save_signature, save_tiff, sweep
from studies import aircraft
from studies._study import Run, study, subplots

MOST_RAYS = 512  # of a pixel of a signature
KEPT = ("azimuth", "elevation", "intensity", "standard_error", "bands", "truncation")  # of a signature
BANDS = (jaxir.SWIR, jaxir.MWIR, jaxir.LWIR)
SUN_SURFACE = 5772.0  # effective temperature, which spreads the sun's light over SWIR [K]


@dataclasses.dataclass(frozen=True)
class Conditions:
    """Table 3, and what the paper leaves open (marked *)."""

    plain_emissivity: float = 0.8
    suppressed_emissivity: float = 0.2
    fuel_flow: float = 0.15  # n-pentane [kg/s]
    equivalence_ratio: float = 0.62  # * adiabatic at 2000 K from 650 K
    exit_temperature: float = 2000.0  # [K]
    pressure: float = 26500.0  # of the air at 10 km [Pa]
    particle_flow: float = 2.0  # [kg/s]
    particle_diameter: float = 10.0  # [um]
    particle_spread: float = 0.1  # * standard deviation of ln diameter; equal spheres ripple
    particle_index: tuple[float, float] = (2.0, 5e-5)  # n, k
    particle_density: float = 2200.0  # * of the substance [kg/m3]
    sun_irradiance: float = 10.0  # SWIR, along -z; * the paper's "10 W m-2 sr-1" read as irradiance [W m-2]


@dataclasses.dataclass(frozen=True)
class Effort:
    """How finely the study looks."""

    step: float  # between aspects [deg]
    view: int  # pixels across a view of the signature
    pixels: int  # across an image
    samples: int  # rays per pixel of an image
    rtol: float  # what spectral nodes may err of a ray in a band
    depth: int  # largest number of reflections; 10 in Table 3
    error: float  # standard error of an intensity at most, as a share of it
    points: tuple[int, ...]  # of the lattice of scattered light along the plume and across it, and its order

    @property
    def method(self) -> jaxir.Method:
        """What particles scatter is solved for: however often, and without noise."""
        return jaxir.Method(bounces=self.depth, scattering=jaxir.DiscreteOrdinates(*self.points))


FULL = Effort(step=5.0, view=96, pixels=500, samples=4, rtol=0.02, depth=10, error=0.02, points=(41, 10, 5))
QUICK = Effort(step=15.0, view=48, pixels=400, samples=4, rtol=0.1, depth=6, error=1.0, points=(41, 9))


def exhaust(given: Conditions) -> tuple[jaxir.NarrowBandGas, float]:
    """Gas at the nozzle, and its speed there [m/s]: what .15 kg/s of pentane burn, by the ideal gas law."""
    products = jaxir.combustion_products(5, 12, given.equivalence_ratio)
    gas = jaxir.NarrowBandGas(given.pressure, h2o=products.h2o, co2=products.co2, o2=products.o2)
    air_per_fuel = 8 * (31.998 + 3.7738 * 28.15) / 72.15 / given.equivalence_ratio  # C5H12 + 8 O2; N2 with argon
    flow = given.fuel_flow * (1 + air_per_fuel)
    density = given.pressure * 28.7e-3 / (8.314 * given.exit_temperature)
    return gas, flow / (density * np.pi / 4 * aircraft.NOZZLE**2)


def particles(given: Conditions, speed: float) -> jaxir.Particles:
    """The suppressed plume's particles as they leave the nozzle."""
    index = given.particle_index[0] - 1j * given.particle_index[1]
    wavelength = np.geomspace(1.0, 12.5, 81)
    table = jaxir.mie_table(given.particle_diameter, index, wavelength, given.particle_spread, angles=181, sizes=9)
    area = np.pi / 4 * aircraft.NOZZLE**2
    return jaxir.Particles(
        jaxir.number_density(given.particle_flow, given.particle_density, speed, area, table.volume), table
    )


def sun(nodes: jaxir.Nodes, given: Conditions) -> jaxir.ParallelSource:
    """Light along -z, in SWIR alone, spread over its nodes like sunlight."""
    spread = np.asarray(jaxir.band_radiance(jnp.asarray(SUN_SURFACE), nodes)) * np.asarray(nodes.response)[0]
    total = float(np.sum(spread * np.asarray(nodes.weight)))
    return jaxir.ParallelSource((0.0, 0.0, -1.0), given.sun_irradiance * spread / total)


class Aircraft(NamedTuple):
    """One of the two, in vacuum, on nodes that serve what is seen of it from both places."""

    scene: jaxir.Scene
    nodes: jaxir.Nodes


Made = dict[str, Aircraft]


def aircraft_of(mesh: jaxir.Mesh, temperature: np.ndarray, effort: Effort, given: Conditions) -> Made:
    """Plain and suppressed."""
    gas, speed = exhaust(given)
    back = float(np.asarray(mesh.vertices)[:, 0].min())
    share = given.sun_irradiance / float(jaxir.band_radiance(SUN_SURFACE, jaxir.SWIR)[0])
    daylight = jaxir.ParallelSource((0.0, 0.0, -1.0), jaxir.BlackbodySpectrum(SUN_SURFACE, share))
    made = {}
    for name, emissivity, load in (
        ("plain", given.plain_emissivity, None),
        ("suppressed", given.suppressed_emissivity, particles(given, speed)),
    ):
        skin = jaxir.Skin(mesh, temperature, jaxir.Lambert(emissivity))
        jet = jaxir.JetPlume(
            (back, 0.0, 0.0),
            (-1.0, 0.0, 0.0),
            aircraft.NOZZLE,
            given.exit_temperature,
            aircraft.AMBIENT,
            gas,
            length=60.0,
            particles=load,
        )
        seen = [through(jaxir.Scene(skin, jet, (daylight,)), place) for place in PLACES]
        nodes = jaxir.optimal_nodes(seen, BANDS, effort.rtol)
        made[name] = Aircraft(jaxir.Scene(skin, jet, (sun(nodes, given),)), nodes)
    return made


# Where the sensor is: altitude [m], range to the aircraft at 10 km [m], angular resolution [rad].
PLACES = {"ground": (0.0, 11_547.0, 5e-6), "air": (10_000.0, 5_000.0, 1e-5)}


def path_of(place: str) -> jaxir.StandardAtmosphere:
    altitude, distance, _ = PLACES[place]
    return jaxir.StandardAtmosphere(altitude, 10_000.0, distance)


def through(scene: jaxir.Scene, place: str) -> jaxir.Scene:
    """A scene behind the air of a place."""
    return eqx.tree_at(lambda s: s.atmosphere, scene, path_of(place), is_leaf=lambda x: x is None)


def circles(step: float) -> dict[str, np.ndarray]:
    """Aspects [view, 2] [deg] as the aircraft turns about its three axes before the sensor."""
    turn = np.arange(0.0, 360.0, step)
    rise = np.round(np.rad2deg(np.arcsin(np.sin(np.deg2rad(turn)))), 9)
    front = np.cos(np.deg2rad(turn)) > -1e-9
    return {
        "yaw": np.stack([turn, np.zeros_like(turn)], 1),
        "pitch": np.stack([np.where(front, 0.0, 180.0), rise], 1),
        "roll": np.stack([np.where(front, 90.0, 270.0), rise], 1),
    }


def each_node(nodes: jaxir.Nodes) -> jaxir.Nodes:
    """The same nodes, every one its own band: air multiplies node by node, so one sweep serves every path of air."""
    names = tuple(f"{low:.0f} cm-1" for low in np.asarray(nodes.lower))
    return dataclasses.replace(nodes, response=jnp.eye(nodes.count, dtype=nodes.weight.dtype), names=names, error=None)


def through_air(table: Signature, own: Aircraft, place: str) -> Signature:
    """In-band contrast intensities behind the air, from those of the nodes in vacuum.

    The nodes of a view share their rays, so their standard errors are added: an upper bound.
    """
    nodes, plume = own.nodes, own.scene.plume
    assert plume is not None
    factor = nodes.response * path_of(place).in_front_of(nodes, plume.hottest()).transmittance[None, :]
    intensity, error = table.intensity @ factor.T, table.standard_error @ factor.T
    added = jnp.where(jnp.isfinite(table.truncation), table.truncation * table.intensity, 0) @ factor.T
    return Signature(table.azimuth, table.elevation, intensity, error, nodes.names, added / intensity)


Tables = dict[tuple[str, str, str], Signature]  # by aircraft, place, axis


def signatures(made: Made, effort: Effort, folder: Path | None) -> Tables:
    """Intensities around three axes; in a folder every finished view is kept, so that a run that was killed goes on."""
    views = circles(effort.step)
    tables: Tables = {}
    for name, own in made.items():
        vacuum = close(own, np.concatenate(list(views.values())), effort, folder and folder / name)
        for place in PLACES:
            whole, begin = through_air(vacuum, own, place), 0
            for axis, aspects in views.items():
                part = slice(begin, begin + len(aspects))
                tables[name, place, axis] = Signature(
                    whole.azimuth[part],
                    whole.elevation[part],
                    whole.intensity[part],
                    whole.standard_error[part],
                    whole.bands,
                    whole.truncation[part],
                )
                begin += len(aspects)
    return tables


def close(own: Aircraft, aspects: np.ndarray, effort: Effort, folder: Path | None) -> Signature:
    """Intensities of nodes in vacuum; aspects whose error is too large are looked at again with four times the rays."""
    how = {"distance": 5_000.0, "shape": (effort.view // 2, effort.view), "method": effort.method}
    whole, left, rays = None, np.arange(len(aspects)), 2
    while len(left):
        asked = own.scene, aspects[left], each_node(own.nodes)
        more = {**how, "samples": rays, "key": jax.random.key(rays)}
        found = jaxir.signature(*asked, **more) if folder is None else sweep(Path(f"{folder}_{rays}"), *asked, **more)
        found = Signature(*(getattr(found, field) for field in KEPT))
        whole = found if whole is None else jax.tree.map(lambda all, some, at=left: all.at[at].set(some), whole, found)
        tables = [through_air(found, own, place) for place in PLACES]
        apart = np.max([np.asarray(table.standard_error / table.intensity) for table in tables], axis=(0, 2))
        left = left[apart > effort.error] if rays < MOST_RAYS else left[:0]
        rays *= 4
    assert whole is not None
    return whole


def camera_at(place: str, pixels: int) -> jaxir.Camera:
    """Fig. 15's view with so many rows: from below behind on the ground, from the side in the air."""
    _, distance, resolution = PLACES[place]
    azimuth, elevation = (120.0, -60.0) if place == "ground" else (90.0, 0.0)
    pixel = resolution * FULL.pixels / pixels
    return jaxir.perspective_camera(azimuth, elevation, distance, pixel, (pixels, pixels), target=(-4.0, 0.0, 0.0))


def look(own: Aircraft, place: str, camera: jaxir.Camera, effort: Effort) -> jaxir.Image:
    """An image through the air; alike in structure for all cameras of as many pixels."""
    # the plume is looked for from the skin, where it is a thousandth of the intensity, and grain if met by chance
    method = dataclasses.replace(effort.method, plume_light=jaxir.PlumeLight())
    return jaxir.render(through(own.scene, place), camera, own.nodes, samples=effort.samples, method=method)


def images(made: Made, effort: Effort) -> dict[str, jaxir.Image]:
    """Fig. 15."""
    return {
        f"{name}, {place}": look(own, place, camera_at(place, effort.pixels), effort)
        for place in PLACES
        for name, own in made.items()
    }


def image_panels(seen: dict[str, jaxir.Image]) -> Any:
    """Fig. 15, without what is empty above and below."""
    figure = plot.radiance_panels(seen)
    wide, high = figure.get_size_inches()
    figure.set_size_inches(wide, 0.7 * high)
    for axis in figure.axes:
        if axis.images:
            axis.set_ylim(-6.0, 10.0)
    return figure


def intensities_around(tables: Tables, step: float) -> Any:
    """Fig. 14: radiant intensity over the turn about each axis, logarithmic; suppressed dashed."""
    from matplotlib.ticker import NullFormatter

    axes = list(circles(step))
    figure, panels = subplots(len(PLACES), len(axes), figsize=(13, 9), subplot_kw={"projection": "polar"})
    for row, place in enumerate(PLACES):
        for panel, axis in zip(panels[row], axes, strict=True):
            for name, style in (("plain", "-"), ("suppressed", "--")):
                value = np.asarray(tables[name, place, axis].intensity)
                turn = np.deg2rad(np.arange(len(value) + 1) * step)
                for column, band in enumerate(BANDS):
                    closed = np.append(value[:, column], value[0, column])
                    panel.plot(turn, closed, style, color=f"C{column}", label=f"{band.name}, {name}")
            panel.set_rscale("log")
            panel.yaxis.set_minor_formatter(NullFormatter())  # labels of less than decades lie over one another
            panel.set_title(f"from the {place}, {axis} [W/sr]")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=6, fontsize="small")
    return figure


@dataclasses.dataclass(frozen=True)
class Side:
    """What is seen from the side in the air, by band, without what the air itself sends."""

    skin: np.ndarray  # intensity of the pixels that see skin [W sr-1]
    plume: np.ndarray  # and of the others
    brightest: np.ndarray  # radiance of the brightest pixel beside the skin [W m-2 sr-1]
    area: np.ndarray  # of pixels at least a thousandth as bright as the brightest of the plain plume [m2]


def from_the_side(made: Made, mesh: jaxir.Mesh, effort: Effort) -> dict[str, Side]:
    """Skin and plume apart, by what the middles of pixels see."""
    pixels = effort.pixels
    distance, across = PLACES["air"][1], 80.0  # [m]
    camera = jaxir.perspective_camera(
        90, 0, distance, across / distance / pixels, (pixels, pixels), target=(aircraft.TAIL_X - 15.0, 0, 0)
    )
    skin = np.asarray(jaxir.visible_faces(mesh, camera)) >= 0
    size = np.asarray(camera.pixel_area())[:, :, None]
    found: dict[str, Side] = {}
    for name, own in made.items():
        image = look(own, "air", camera, effort)
        radiance = np.asarray(image.radiance) - np.asarray(image.empty)
        brightest = radiance[~skin].max(axis=0)
        least = (found["plain"].brightest if found else brightest) / 1000
        sums = [(size * radiance * where[:, :, None]).sum((0, 1)) for where in (skin, ~skin)]
        found[name] = Side(*sums, brightest, (size * ((radiance > least) & ~skin[:, :, None])).sum((0, 1)))
    return found


def jets_aside(scene: jaxir.Scene, effort: Effort, skin: np.ndarray) -> list[str]:
    """What the plain plume sends to the side, by the air around it; and how bands rank by how hot the exhaust is."""
    jet = scene.plume
    assert isinstance(jet, jaxir.JetPlume)
    airs = {
        "here: at 10 km, and 255 K once it rests on the skin": (26500.0, aircraft.AMBIENT),
        "Table 3 as printed": (30000.0, 255.0),
    }
    kelvins = (600.0, 800.0, 1000.0, 1400.0, 2000.0)
    jets = [
        eqx.tree_at(lambda p: (p.gas.pressure, p.ambient_temperature), jet, tuple(map(jnp.asarray, air)))
        for air in airs.values()
    ]
    jets += [eqx.tree_at(lambda p: p.exit_temperature, jet, jnp.asarray(kelvin)) for kelvin in kelvins]
    alone = [jaxir.Scene(None, one, atmosphere=path_of("air")) for one in jets]
    nodes = jaxir.optimal_nodes(alone, BANDS, effort.rtol)
    aside = [
        np.asarray(jaxir.signature(one, [[90.0, 0.0]], nodes, distance=5_000.0, shape=(32, 128)).intensity)[0]
        for one in alone
    ]
    said = ["what the air does:"]
    for (name, (pressure, kelvin)), value in zip(airs.items(), aside[: len(airs)], strict=True):
        values = ", ".join(f"{band.name} {one:.4g}" for band, one in zip(BANDS, value, strict=True))
        said.append(f"plume in air of {pressure:.0f} Pa and {kelvin:.0f} K ({name}): {values} W/sr")
    said.append("what decides it:")
    for kelvin, plume in zip(kelvins, aside[len(airs) :], strict=True):
        whole = skin + plume
        order = " > ".join(BANDS[i].name for i in np.argsort(-whole))
        values = ", ".join(f"{band.name} {value:.3g}" for band, value in zip(BANDS, whole, strict=True))
        said.append(f"exhaust of {kelvin:.0f} K: {order} ({values} W/sr; plume {plume[2] / whole[2]:.0%} of LWIR)")
    return said


def covered(mesh: jaxir.Mesh) -> dict[str, int]:
    """Pixels of the paper's images, 500 by 500, that see the skin from each place (Fig. 13 has 35,000)."""
    return {
        place: int(np.sum(np.asarray(jaxir.visible_faces(mesh, camera_at(place, FULL.pixels))) >= 0))
        for place in PLACES
    }


def conclusions(tables: Tables, side: dict[str, Side]) -> list[str]:
    """The paper's conclusions, each with what was found here."""
    axes = sorted({axis for _, _, axis in tables})
    stack = {
        (name, place): np.concatenate([np.asarray(tables[name, place, axis].intensity) for axis in axes])
        for name in ("plain", "suppressed")
        for place in PLACES
    }
    height = np.concatenate([np.asarray(tables["plain", "air", axis].elevation) for axis in axes])
    mean = {key: value.mean(0) for key, value in stack.items()}
    said = []

    def check(what: str, holds: np.ndarray | bool, numbers: str) -> None:
        share = float(np.mean(holds))
        said.append(f"{'holds' if share == 1 else f'holds in {share:.0%}'}: {what} ({numbers})")

    def means(name: str, place: str) -> str:
        return ", ".join(f"{band.name} {value:.3g}" for band, value in zip(BANDS, mean[name, place], strict=True))

    for name in ("plain", "suppressed"):
        fainter = stack[name, "ground"] < stack[name, "air"]
        check(
            f"{name}: fainter from the ground than in the air, every aspect and band",
            fainter,
            f"mean W/sr ground {means(name, 'ground')}; air {means(name, 'air')}",
        )
    for place in PLACES:
        s, m, w = stack["plain", place].T
        check(f"plain, {place}: LWIR > MWIR > SWIR", (w > m) & (m > s), f"mean W/sr {means('plain', place)}")
        s, m, w = stack["suppressed", place].T
        check(f"suppressed, {place}: LWIR > SWIR > MWIR", (w > s) & (s > m), f"mean W/sr {means('suppressed', place)}")
    ratio = stack["suppressed", "air"] / stack["plain", "air"]
    for band, column in (("MWIR", 1), ("LWIR", 2)):
        r = ratio[:, column]
        check(f"suppression lowers {band} at every aspect", r < 1, f"to {r.min():.2f} ... {r.max():.2f}")
    r = ratio[height > 10, 0]
    check("suppression raises SWIR seen from the sunlit side", r > 1, f"to {r.min():.2f} ... {r.max():.2f}")
    plain, covered = side["plain"], side["suppressed"]
    share = plain.plume / (plain.plume + plain.skin)
    shares = ", ".join(f"{band.name} {value:.1%}" for band, value in zip(BANDS, share, strict=True))
    check("the plain plume is invisible in LWIR: less than 5 % of the intensity from the side", share[2] < 0.05, shares)
    dimmer, larger = covered.brightest / plain.brightest, covered.area / plain.area
    for column, band in enumerate(BANDS[:2]):
        check(
            f"the suppressed plume is dimmer but larger in {band.name}",
            bool(dimmer[column] < 1 < larger[column]),
            f"brightest pixel x {dimmer[column]:.2f}, area x {larger[column]:.2f}",
        )
    return said


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--quick", action="store_true", help="few aspects and nodes: two to three minutes")
    parser.add_argument("--mesh", help="your own mesh (STL, OBJ, PLY, GLB), nose along +x, z up")
    parser.add_argument("--unit", choices=list(METRES), help="length unit of --mesh (required with it)")
    parser.add_argument("--temperature", type=float, default=255.0, help="skin temperature of --mesh [K] (%(default)s)")
    parser.add_argument(
        "--density", type=float, default=2200.0, help="of the particles' substance [kg/m3] (%(default)s)"
    )
    parser.add_argument("--sun", type=float, default=10.0, help="SWIR irradiance along -z [W m-2] (%(default)s)")


def main(run: Run) -> str:
    chosen = run.options
    if (chosen.mesh is None) != (chosen.unit is None):
        raise ValueError("--mesh and --unit go together: files do not say their unit")
    effort = QUICK if chosen.quick else FULL
    given = Conditions(particle_density=chosen.density, sun_irradiance=chosen.sun)
    out = run.bulk("quick" if chosen.quick else "full")
    if chosen.mesh is None:
        vertices, faces, _ = aircraft.generic_aircraft()
        mesh, temperature = jaxir.Mesh(vertices, faces), aircraft.skin_temperature(vertices, faces)
    else:
        mesh = load_mesh(chosen.mesh, unit=chosen.unit).mesh
        temperature = np.full(mesh.count, chosen.temperature)
    made = aircraft_of(mesh, temperature, effort, given)

    began = time.perf_counter()
    views = None if chosen.quick else out / "views"
    if views is not None:
        views.mkdir(exist_ok=True)
    with ThreadPoolExecutor(1) as pool:  # most of a program compiles and runs on one core
        looking = pool.submit(images, made, effort)
        tables = signatures(made, effort, views)
        seen = looking.result()
    spent = time.perf_counter() - began
    for (name, place, axis), table in tables.items():
        save_signature(out / f"{name}_{place}_{axis}.csv", table)
    run.chart(intensities_around(tables, effort.step), "stealth_intensities", dpi=110)
    for name, image in seen.items():
        stem = out / name.replace(", ", "_")
        save_image(stem.with_suffix(".npz"), image)
        save_tiff(stem.with_suffix(".tif"), image)
    run.chart(image_panels(seen), dpi=110, bbox_inches="tight")
    side = from_the_side(made, mesh, effort)
    said = conclusions(tables, side)
    whole, every = sum(line.startswith("holds:") for line in said), len(said)
    said += jets_aside(made["plain"].scene, effort, side["plain"].skin)

    worst = {
        " ".join(key): float(np.max(np.asarray(table.standard_error) / np.abs(np.asarray(table.intensity))))
        for key, table in tables.items()
    }
    report = {
        "conditions": dataclasses.asdict(given) | {"exhaust_speed_m_s": exhaust(given)[1], "mesh": chosen.mesh},
        "effort": dataclasses.asdict(effort),
        "nodes": {name: own.nodes.count for name, own in made.items()},
        "what nodes err, of a ray in each band, at most": {
            name: np.asarray(own.nodes.error).tolist() for name, own in made.items()
        },
        "versions": {"jaxir": version("jaxir"), "jax": jax.__version__, "python": platform.python_version()},
        "seconds of signatures and images": spent,
        "largest relative standard error of an intensity": worst,
        "share of the intensity that the lattice of scattered light lacks, at most": {
            " ".join(key): float(np.max(np.asarray(table.truncation))) for key, table in tables.items()
        },
        "pixels of 500 x 500 that see the skin": covered(mesh),
        "conclusions": said,
    }
    run.record(report)
    print("\n".join(said))
    return f"{whole} of {every} conclusions of the paper hold throughout; the rest is in {out}"


if __name__ == "__main__":
    study(main, options, needs=("matplotlib", "miepython", "tifffile"), published="--quick")
