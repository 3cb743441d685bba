"""Random legal scenes, and the laws that the radiance of every one of them obeys.

A structure is a combination of parts; its numbers are drawn anew for every scene, over the legal ranges and often at
their ends, and enter one compiled program, forty scenes at a time. The laws, along eight rays through each scene:

    legal       every check of the scene holds: what is drawn is what a user may give
    finite      radiance, its gradient in every number, and its derivative along a random direction
    sign        no radiance below 0
    furnace     with everything at one temperature and no other light nothing outshines the blackbody: along each ray
                where no sampling weight exceeds 1, else on average over all scenes of the structure
    equality    in the furnace, where nothing is left out, all that is seen is the blackbody
    hottest     without other light nothing outshines the hottest part, along each ray, as above
    linear      in light: L(2 a) - L(0) = 2 (L(a) - L(0)) on the same paths
    modes       forward mode = reverse mode

    python -m tests.random_scenes --scenes 100000 --seed 1

with JAX_ENABLE_X64=1 in double precision.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxir
from jaxir.optics.gas import CrossSections
from jaxir.transport import evaluate, trace

BATCH, RAYS = 40, 8
BANDS = (jaxir.MWIR, jaxir.LWIR)
GRAY = 2  # nodes of BANDS
LIGHT = ("irradiance", "radiance", "intensity", "path_radiance")
TINY = {"float32": 1e-36, "float64": 1e-300}
CLOSE = {"float32": 2e-5, "float64": 1e-10}
MODES = {"float32": 2e-3, "float64": 1e-8}
BOX = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)]) - 0.5
BOX_FACES = np.array(
    [t for a, b, c, d in ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
     for t in ((a, b, c), (a, c, d))]
)  # fmt: skip


class Draw:
    """Numbers over wide ranges, often at an end."""

    def __init__(self, rng: np.random.Generator):
        self.rng = rng
        self.size = self.log(1e-2, 1e3)  # of the scene [m]

    def log(self, low: float, high: float, shape: tuple = (), zero: bool = False) -> np.ndarray:
        """Even in the logarithm; one in twelve each at an end, and at 0 if it may be."""
        value = np.exp(self.rng.uniform(np.log(low), np.log(high), shape))
        at = self.rng.integers(0, 12, shape)
        value = np.where(at == 0, low, np.where(at == 1, high, value))
        return np.where((at == 2) & zero, 0.0, value)

    def unit(self, shape: tuple = ()) -> np.ndarray:
        """Between 0 and 1, one in six at each end or next to it."""
        at = self.rng.integers(0, 12, shape)
        value = self.rng.uniform(0, 1, shape)
        return np.select([at == 0, at == 1, at == 2, at == 3], [0.0, 1.0, 1e-7, 1 - 1e-6], value)

    def even(self, low: float, high: float, shape: tuple = ()) -> np.ndarray:
        return self.rng.uniform(low, high, shape)

    def kelvin(self, shape: tuple = ()) -> np.ndarray:
        return np.where(self.rng.uniform(size=shape) < 0.5, self.even(200, 3000, shape), self.log(1.0, 5000.0, shape))

    def direction(self) -> np.ndarray:
        """A unit vector, every fourth along an axis."""
        if self.rng.integers(4) == 0:
            return np.roll([0.0, 0.0, self.rng.choice([-1.0, 1.0])], self.rng.integers(3))
        value = self.rng.normal(size=3)
        return value / np.linalg.norm(value)

    def place(self, low: float = 0.0, high: float = 3.0) -> np.ndarray:
        """A point between low and high sizes of the scene from its middle."""
        return self.direction() * self.even(low, high) * self.size


@dataclasses.dataclass(frozen=True)
class Part:
    """A part of a scene: its numbers by name, fixed and differentiated, and what is built from both.

    `interpolated` says that its optics come from between tabulated states, to more than rounding in double precision.
    """

    draw: Callable[[Draw], tuple[dict, dict]]
    build: Callable[[dict, dict], Any]
    interpolated: bool = False


def _light(d: Draw) -> np.ndarray:
    return d.log(1e-6, 1e5, (GRAY,), zero=True)


# Skin -----------------------------------------------------------------------------------------------------------------


def _lambert(faces: int) -> Part:
    return Part(lambda d: ({}, {"emissivity": d.unit((faces, GRAY))}), lambda g, v: jaxir.Lambert(v["emissivity"]))


def _paint(faces: int) -> Part:
    def draw(d: Draw) -> tuple[dict, dict]:
        grazing = d.unit((faces,))
        most = d.even(0.1, 0.499, (faces,))  # 2 / G(b) is at most 2
        emissivity = most * d.unit((faces,))
        return {}, {
            "emissivity": emissivity,
            "diffuse_reflectance": (most - emissivity) * d.unit((faces,)),
            "lobe_width": d.log(1e-4, 1.0, (faces,)),
            "grazing": grazing,
        }

    return Part(draw, lambda g, v: jaxir.SandfordRobertson(**v))


def _metal(faces: int) -> Part:
    def draw(d: Draw) -> tuple[dict, dict]:
        extinction = d.log(1e-6, 100.0, (faces,), zero=True)
        index = d.log(0.1, 30.0, (faces,))
        index = np.where(d.rng.integers(0, 6, faces) == 0, 1.0, index)
        index = np.where(extinction == 0, np.maximum(index, 1.0), index)  # total reflection has an onset
        return {}, {"index": index, "extinction": extinction, "roughness": d.log(1e-4, 1.0, (faces,))}

    return Part(draw, lambda g, v: jaxir.RoughConductor(**v))


def _table(faces: int) -> Part:
    def draw(d: Draw) -> tuple[dict, dict]:
        value = d.unit((1, 5, 5, 4, GRAY))
        return {}, {"value": value * 0.9 / np.pi * d.unit()}

    return Part(draw, lambda g, v: jaxir.BrdfTable(v["value"]))


def _mixed(faces: int) -> Part:
    kinds = [make(faces) for make in (_lambert, _paint, _metal)]

    def draw(d: Draw) -> tuple[dict, dict]:
        return {}, {str(i): kind.draw(d)[1] for i, kind in enumerate(kinds)}

    def build(g: dict, v: dict) -> Any:
        return jaxir.BrdfPerFace([kind.build({}, v[str(i)]) for i, kind in enumerate(kinds)], np.arange(faces) % 3)

    return Part(draw, build)


def _corners_of(d: Draw, shape: str) -> np.ndarray:
    if shape == "box":
        turn = np.linalg.qr(d.rng.normal(size=(3, 3)))[0]
        turn = turn * np.sign(np.linalg.det(turn)) if d.rng.integers(2) else np.eye(3)
        return (BOX * d.log(1e-2, 1.0, (3,)) * d.size) @ turn.T
    if shape == "plate":
        side = d.log(1e-3, 1.0, (2,))
        return np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]]) * np.array([0, *side]) * d.size / 2
    if shape == "cavity":
        return BOX * d.log(0.05, 1.0, (3,)) * d.size
    corners = d.even(-0.5, 0.5, (8, 3, 3)) * d.size  # eight triangles
    corners[1, 2] = corners[1, 1] + 1e-4 * (corners[1, 2] - corners[1, 1])  # a sliver
    corners[2] = corners[2, :1] + 1e-4 * (corners[2] - corners[2, :1])  # tiny
    corners[3] = corners[3] * 100  # huge
    corners[4, 2] = (corners[4, 0] + corners[4, 1]) / 2  # without area, but for rounding
    corners[5, 0] = corners[0, 0]  # a shared corner
    corners[6, :2] = corners[0, :2]  # a shared edge
    return corners.reshape(-1, 3)


FACES = {
    "box": BOX_FACES,
    "plate": np.array([[0, 1, 2], [0, 2, 3]]),
    "cavity": BOX_FACES[2:],  # a box without its left side
    "soup": np.arange(24).reshape(8, 3),
}


def _skin(shape: str, brdf: Callable[[int], Part]) -> Part:
    faces = FACES[shape]
    own = brdf(len(faces))
    template = jaxir.Mesh(BOX, faces) if shape == "box" else None

    def draw(d: Draw) -> tuple[dict, dict]:
        g, v = own.draw(d)
        return {"vertices": _corners_of(d, shape)}, {"temperature": d.kelvin((len(faces),)), "brdf": v}

    def build(g: dict, v: dict) -> Any:
        mesh = jaxir.Mesh(g["vertices"], faces) if template is None else template.refit(g["vertices"])
        return jaxir.Skin(mesh, v["temperature"], own.build({}, v["brdf"]))

    return Part(draw, build)


# Plumes ---------------------------------------------------------------------------------------------------------------


def _gray(cells: tuple) -> Part:
    """Optical depths of the scene from 0 to 1e6."""
    shape = (*cells, GRAY) if cells else (GRAY,)
    return Part(
        lambda d: ({}, {"coefficient": d.log(1e-6, 1e6, shape, zero=True) / d.size}),
        lambda g, v: jaxir.GrayGas(v["coefficient"]),
    )


def _lines(cells: tuple) -> Part:
    def draw(d: Draw) -> tuple[dict, dict]:
        some = d.unit((2, *cells)) / 2
        return {}, {"pressure": d.log(1e3, 1e6, cells), "h2o": some[0], "co2": some[1]}

    return Part(draw, lambda g, v: jaxir.NarrowBandGas(v["pressure"], h2o=v["h2o"], co2=v["co2"]))


NARROW = jaxir.resolved_nodes((jaxir.Band("narrow", 4.2, 4.5),), 100.0, 1, 0)


def _tables(cells: tuple) -> Part:
    sigma = np.exp(np.random.default_rng(0).uniform(-60, -45, (3, 2, 1, NARROW.count)))

    def build(g: dict, v: dict) -> Any:
        table = CrossSections("CO2", NARROW, [300.0, 1000.0, 2500.0], [1e4, 1e5], [0.1], sigma)
        return jaxir.CorrelatedK((table,), v["pressure"], {"CO2": v["fraction"]})

    return Part(lambda d: ({}, {"pressure": d.log(3e3, 3e5, cells), "fraction": d.unit(cells)}), build)


def _isotropic(cells: tuple) -> Part:
    return _suspension(cells, lambda d: {}, lambda v: jaxir.Isotropic())


def _forward(cells: tuple) -> Part:
    return _suspension(
        cells,
        lambda d: {"asymmetry": np.array(d.rng.choice([-0.99, -0.5, 0.0, 1e-6, 0.5, 0.9, 0.99]))},
        lambda v: jaxir.HenyeyGreenstein(v["asymmetry"]),
    )


def _measured(cells: tuple) -> Part:
    cosine = np.cos(np.linspace(np.pi, 0, 12))
    cosine[[0, -1]] = -1, 1
    return _suspension(
        cells, lambda d: {"value": d.unit((12,)) + 1e-3}, lambda v: jaxir.TabulatedPhase(cosine, v["value"])
    )


def _suspension(cells: tuple, draw_phase: Callable, phase: Callable) -> Part:
    shape = (*cells, GRAY) if cells else (GRAY,)

    def draw(d: Draw) -> tuple[dict, dict]:
        extinction = d.log(1e-4, 30.0, shape, zero=True) / d.size
        return {}, {"extinction": extinction, "albedo": d.unit(), "phase": draw_phase(d)}

    return Part(draw, lambda g, v: jaxir.GrayParticles(v["extinction"], v["albedo"], phase(v["phase"])))


def _grid(cells: tuple, gas: Callable, particles: Callable | None = None, shift: float = 0.0) -> Part:
    parts = [gas(cells)] + ([particles(cells)] if particles else [])

    def draw(d: Draw) -> tuple[dict, dict]:
        spacing = d.log(0.01, 1.0, (3,)) * d.size / np.array(cells)
        origin = -spacing * np.array(cells) / 2 + shift * d.even(-1, 1, (3,)) * d.size
        return {"origin": origin, "spacing": spacing}, {
            "temperature": d.kelvin(cells),
            "parts": [p.draw(d)[1] for p in parts],
        }

    def build(g: dict, v: dict) -> Any:
        grid = jaxir.Grid(g["origin"], g["spacing"], cells)
        return jaxir.GridPlume(
            grid, v["temperature"], *(p.build({}, n) for p, n in zip(parts, v["parts"], strict=True))
        )

    return Part(draw, build)


def _jet(gas: Callable, particles: Callable | None = None) -> Part:
    parts = [gas(())] + ([particles(())] if particles else [])

    def draw(d: Draw) -> tuple[dict, dict]:
        place = {
            "nozzle": d.place(0, 0.3),
            "axis": d.direction() * d.log(0.1, 10),
            "diameter": 0.03 * d.size * d.log(0.3, 3),
            "core_length": d.log(0.1, 20),
            "spreading": d.log(0.01, 2),
            "length": d.log(0.5, 100),
        }
        heat = {"exit_temperature": d.kelvin(), "ambient_temperature": d.kelvin()}
        return {}, {"place": place, **heat, "parts": [p.draw(d)[1] for p in parts]}

    def build(g: dict, v: dict) -> Any:
        matter = [p.build({}, n) for p, n in zip(parts, v["parts"], strict=True)]
        heat = (v["exit_temperature"], v["ambient_temperature"])
        p = v["place"]
        return jaxir.JetPlume(
            p["nozzle"],
            p["axis"],
            p["diameter"],
            *heat,
            matter[0],
            core_length=p["core_length"],
            spreading=p["spreading"],
            length=p["length"],
            panels=2,
            particles=matter[1] if particles else None,
        )

    return Part(draw, build, interpolated=True)


# Light and air --------------------------------------------------------------------------------------------------------

SUN = Part(
    lambda d: ({"direction": d.direction()}, {"irradiance": _light(d)}),
    lambda g, v: jaxir.ParallelSource(g["direction"], v["irradiance"]),
)
LAMP = Part(
    lambda d: ({"position": d.place()}, {"intensity": _light(d) * d.size**2}),
    lambda g, v: jaxir.PointSource(g["position"], v["intensity"]),
)
DISC = Part(
    lambda d: (
        {"centre": d.place(0.5), "normal": d.direction(), "radius": d.log(1e-3, 10) * d.size},
        {"radiance": _light(d)},
    ),
    lambda g, v: jaxir.DiscSource(g["centre"], g["normal"], g["radius"], v["radiance"]),
)
BALL = Part(
    lambda d: ({"centre": d.place(), "radius": d.log(1e-3, 3) * d.size}, {"radiance": _light(d)}),
    lambda g, v: jaxir.SphereSource(g["centre"], g["radius"], v["radiance"]),
)


def _plate_corners(d: Draw) -> np.ndarray:
    side, up = np.linalg.qr(d.rng.normal(size=(3, 2)))[0].T * d.log(1e-3, 10, (2, 1)) * d.size
    return d.place(0.5)[None] + np.array([-side - up, side - up, side + up, up - side])


PLATE_LIGHT = Part(
    lambda d: ({"corners": _plate_corners(d)}, {"radiance": _light(d)}),
    lambda g, v: jaxir.PolygonSource(g["corners"], v["radiance"]),
)
WARM = Part(lambda d: ({}, {"temperature": d.kelvin()}), lambda g, v: jaxir.BlackbodyBackground(v["temperature"]))
EVEN = Part(lambda d: ({}, {"radiance": _light(d)}), lambda g, v: jaxir.UniformBackground(v["radiance"]))
SKY = Part(
    lambda d: ({"elevation": np.sort(d.even(-90, 90, (4,)))}, {"radiance": d.log(1e-6, 1e5, (4, GRAY), zero=True)}),
    lambda g, v: jaxir.ElevationTable(g["elevation"], v["radiance"]),
)
HAZE = Part(
    lambda d: (
        {"distance": d.log(1, 1e6)},
        {"extinction": d.log(1e-9, 1, (GRAY,), zero=True), "temperature": d.kelvin()},
    ),
    lambda g, v: jaxir.UniformAtmosphere(v["extinction"], g["distance"], v["temperature"]),
)
FIXED = Part(
    lambda d: ({}, {"transmittance": d.unit((GRAY,)), "path_radiance": _light(d)}),
    lambda g, v: jaxir.FixedPath(v["transmittance"], v["path_radiance"]),
)


@dataclasses.dataclass(frozen=True)
class Structure:
    """A combination of parts, and how its light is found.

    `bounded` says that no weight of a path exceeds 1, `whole` that nothing is left out of the furnace.
    """

    skin: Part | None = None
    plumes: tuple[Part, ...] = ()
    sources: tuple[Part, ...] = ()
    background: Part | None = None
    air: Part | None = None
    method: jaxir.Method = jaxir.Method()
    nodes: Any = BANDS
    how: str = "paths"  # or "image", or the name of an estimator
    bounded: bool = False
    whole: bool = False

    def parts(self) -> dict[str, Part]:
        """Every part by name."""
        named = {f"plume{i}": part for i, part in enumerate(self.plumes)}
        named |= {f"source{i}": part for i, part in enumerate(self.sources)}
        alone = {"skin": self.skin, "background": self.background, "air": self.air}
        return named | {name: part for name, part in alone.items() if part is not None}

    def draw(self, rng: np.random.Generator) -> tuple[dict, dict]:
        """What is fixed, with the rays, and what is differentiated."""
        d = Draw(rng)
        drawn = {name: part.draw(d) for name, part in self.parts().items()}
        fixed = {name: g for name, (g, _) in drawn.items()}
        return fixed | {"rays": self._rays(d, fixed)}, {name: v for name, (_, v) in drawn.items()}

    def _rays(self, d: Draw, fixed: dict) -> dict:
        """Rays to corners, edges and faces of the skin and into the middle, from near and far."""
        aims = d.even(-0.3, 0.3, (RAYS, 3)) * d.size
        if self.skin is not None:
            corner = fixed["skin"]["vertices"]
            share = d.rng.dirichlet(np.ones(3), RAYS)
            share[0], share[1] = (1, 0, 0), (0.5, 0.5, 0)
            face = d.rng.integers(0, len(corner) // 3, RAYS - 2)
            aims[: RAYS - 2] = np.einsum("rc,rcx->rx", share[: RAYS - 2], corner[3 * face[:, None] + np.arange(3)])
        toward = np.array([d.direction() for _ in range(RAYS)])
        far = d.log(2.0 if self.whole else 0.01, 100.0, (RAYS, 1)) * d.size  # inside a box other skin is seen by skin
        camera = {"azimuth": d.even(-180, 180), "elevation": d.even(-90, 90), "distance": d.log(100, 1e5) * d.size}
        return {"origin": aims - far * toward, "direction": toward, "size": d.size, **camera}

    def scene(self, fixed: dict, values: dict) -> jaxir.Scene:
        """The scene of these numbers."""
        built = {name: part.build(fixed[name], values[name]) for name, part in self.parts().items()}
        return jaxir.Scene(
            built.get("skin"),
            tuple(built[f"plume{i}"] for i in range(len(self.plumes))),
            tuple(built[f"source{i}"] for i in range(len(self.sources))),
            built.get("background"),
            built.get("air"),
        )

    def spectrum(self) -> jaxir.Nodes:
        """Its spectral nodes."""
        return jaxir.gray_nodes(self.nodes) if isinstance(self.nodes, tuple) else self.nodes

    def radiance(self, scene: jaxir.Scene, rays: dict, key: Any) -> Callable[[jaxir.Scene], jax.Array]:
        """Of every ray or pixel and node, of scenes of the geometry of `scene`."""
        nodes = self.spectrum()
        if self.how == "image":
            shape, turn = (3, 4), (rays["azimuth"], rays["elevation"])
            pixel = rays["size"] / 4 / rays["distance"]
            camera = jaxir.perspective_camera(*turn, rays["distance"], pixel, shape)

            def image(scene: jaxir.Scene) -> jax.Array:
                image = jaxir.render(scene, camera, nodes, samples=2, key=key, method=self.method)
                return jnp.where(image.standard_error >= 0, image.radiance, jnp.nan)

            return image
        paths = trace(scene, jaxir.Rays(rays["origin"], rays["direction"]), self.method, key)
        if self.how == "paths":
            return lambda scene: evaluate(scene.on(nodes), paths)
        return lambda scene: jaxir.estimate(scene.on(nodes), paths, getattr(jaxir, self.how)(), key)


CELLS = (3, 4, 2)
BOUNCE = jaxir.Method(bounces=2)
STRUCTURES: dict[str, Structure] = {
    "plate": Structure(_skin("plate", _lambert), background=WARM, bounded=True, whole=True),
    "box in the sun": Structure(_skin("box", _lambert), sources=(SUN,), bounded=True),
    "box among lights": Structure(
        _skin("box", _lambert), sources=(SUN, LAMP, DISC, BALL, PLATE_LIGHT), background=WARM, bounded=True, whole=True
    ),
    "box under a sky": Structure(_skin("box", _paint), background=SKY),
    "slivers": Structure(_skin("soup", _lambert), sources=(SUN, LAMP), background=WARM, method=BOUNCE),
    "slivers of metal": Structure(_skin("soup", _metal), sources=(SUN, BALL), background=WARM, method=BOUNCE),
    "cavity": Structure(
        _skin("cavity", _lambert), background=WARM, method=jaxir.Method(bounces=4, sampler=jaxir.Stratified())
    ),
    "cavity by its glow": Structure(
        _skin("cavity", _paint), background=WARM, method=jaxir.Method(bounces=2, skin_light=jaxir.SkinLight())
    ),
    "cavity of metal": Structure(
        _skin("cavity", _metal), sources=(DISC,), method=jaxir.Method(bounces=2, sampler=jaxir.Sobol())
    ),
    "painted box": Structure(_skin("box", _paint), sources=(SUN, DISC), background=EVEN),
    "metal box": Structure(_skin("box", _metal), sources=(SUN, BALL), background=WARM),
    "measured box": Structure(_skin("box", _table), sources=(SUN, PLATE_LIGHT), background=WARM),
    "box of everything": Structure(_skin("box", _mixed), sources=(SUN, WARM), method=BOUNCE),
    "closed form": Structure(
        _skin("box", _lambert), sources=(PLATE_LIGHT,), background=WARM, method=jaxir.Method(direct=jaxir.ClosedForm()),
        bounded=True, whole=True,
    ),
    "left out": Structure(
        _skin("box", _metal), sources=(SUN, LAMP), background=WARM, method=jaxir.Method(direct=None), bounded=True
    ),
    "box in haze": Structure(_skin("box", _lambert), background=WARM, air=HAZE, bounded=True, whole=True),
    "box behind a fixed path": Structure(_skin("box", _lambert), sources=(SUN,), air=FIXED, bounded=True),
    "gray grid": Structure(plumes=(_grid(CELLS, _gray),), background=WARM, bounded=True, whole=True),
    "one cell": Structure(plumes=(_grid((1, 1, 1), _gray),), air=HAZE, bounded=True),
    "body in a grid": Structure(
        _skin("box", _lambert), (_grid(CELLS, _gray),), sources=(SUN, LAMP), background=WARM, bounded=True
    ),
    "two grids": Structure(
        plumes=(_grid(CELLS, _gray), _grid((2, 2, 2), _gray, shift=0.3)), background=WARM, bounded=True, whole=True
    ),
    "jet": Structure(plumes=(_jet(_gray),), background=WARM, bounded=True, whole=True),
    "two jets and a grid": Structure(
        plumes=(_jet(_gray), _jet(_gray), _grid((2, 2, 2), _gray)), background=WARM, bounded=True, whole=True
    ),
    "body and jet": Structure(_skin("box", _paint), (_jet(_gray),), sources=(SUN, DISC), background=WARM),
    "grid of lines": Structure(
        plumes=(_grid((2, 2, 2), _lines),), background=WARM, nodes=jaxir.resolved_nodes((jaxir.MWIR,), 200.0, 1, 0),
        bounded=True, whole=True,
    ),
    "jet of lines": Structure(
        plumes=(_jet(_lines),), background=WARM, nodes=jaxir.resolved_nodes((jaxir.LWIR,), 100.0, 1, 0),
        bounded=True, whole=True,
    ),
    "grid of tables": Structure(
        plumes=(_grid((2, 2, 2), _tables),), background=WARM, nodes=NARROW, bounded=True, whole=True
    ),
    "cloud": Structure(
        plumes=(_grid(CELLS, _gray, _isotropic),), sources=(SUN,), background=WARM, method=jaxir.Method(orders=3)
    ),
    "cloud and lights": Structure(
        plumes=(_grid((2, 2, 2), _gray, _forward),), sources=(LAMP, DISC, BALL), background=SKY,
        method=jaxir.Method(orders=2),
    ),
    "body in a cloud": Structure(
        _skin("box", _lambert), (_grid((2, 2, 2), _gray, _measured),), sources=(SUN,), background=WARM,
        method=jaxir.Method(bounces=2, orders=2),
    ),
    "jet of particles": Structure(
        plumes=(_jet(_gray, _forward),), sources=(SUN, LAMP), background=WARM, method=jaxir.Method(orders=2)
    ),
    "clouds that overlap": Structure(
        plumes=(_grid((2, 2, 2), _gray, _isotropic), _jet(_gray, _forward)),
        sources=(SUN,),
        method=jaxir.Method(orders=2),
    ),
    "body by the plume's glow": Structure(
        _skin("box", _paint), (_grid(CELLS, _gray),), background=WARM,
        method=jaxir.Method(bounces=1, plume_light=jaxir.PlumeLight()),
    ),
    "image": Structure(
        _skin("box", _lambert), (_jet(_gray),), sources=(SUN,), background=WARM, how="image", bounded=True
    ),
    "image of slivers": Structure(_skin("soup", _metal), (_grid(CELLS, _gray),), sources=(SUN,), how="image"),
    "point integration": Structure(
        _skin("box", _lambert), (_grid(CELLS, _gray),), background=WARM, how="PointIntegration", bounded=True
    ),
    "line integration": Structure(plumes=(_grid(CELLS, _gray),), background=WARM, how="LineIntegration"),
    "combined integration": Structure(plumes=(_grid(CELLS, _gray),), background=WARM, how="CombinedIntegration"),
}  # fmt: skip


# Laws -----------------------------------------------------------------------------------------------------------------


def _named(change: Callable[[str, Any], Any], values: dict) -> dict:
    """`change` of the innermost name and value of every leaf."""

    def one(path: Any, leaf: Any) -> Any:
        names = [str(entry.key) for entry in path if hasattr(entry, "key")]
        return change(names[-1], leaf)

    return jax.tree_util.tree_map_with_path(one, values)


def _laws(structure: Structure, fixed: dict, values: dict, weight: dict, key: Any) -> dict:
    """What is known of one scene: the measures of the laws."""
    tiny = TINY[str(values_dtype := jnp.result_type(float))]
    interpolated = any(part.interpolated for part in structure.plumes)
    close, modes = CLOSE["float32" if interpolated else str(values_dtype)], MODES[str(values_dtype)]
    nodes, scene = structure.spectrum(), structure.scene(fixed, values)
    radiance = structure.radiance(scene, fixed["rays"], key)

    def seen(v: dict) -> jax.Array:
        return radiance(structure.scene(fixed, v))

    heat = [leaf for path, leaf in jax.tree_util.tree_leaves_with_path(values) if "temperature" in str(path[-1])]
    hottest = jnp.max(jnp.concatenate([leaf.reshape(-1) for leaf in heat]))

    def lit(factor: float) -> dict:
        return _named(lambda name, leaf: leaf * factor if name in LIGHT else leaf, values)

    def furnace(name: str, leaf: Any) -> Any:
        return jnp.full_like(leaf, hottest) if "temperature" in name else leaf

    cases = [values, lit(0.0), lit(2.0), _named(furnace, lit(0.0))]
    # relative changes of every number of the first case; and weights that make every ray count
    tangent = jax.tree.map(lambda v, w: v * w, values, weight["values"])
    still = jax.tree.map(jnp.zeros_like, tangent)
    both = [jax.tree.map(lambda *x: jnp.stack(x), *every) for every in (cases, [tangent, still, still, still])]
    (once, dark, twice, isothermal), (along, *_) = jax.lax.map(lambda own: jax.jvp(seen, own[:1], own[1:]), tuple(both))

    cotangent = weight["rays"][: once.shape[0], : once.shape[1]] if once.ndim == 2 else jnp.ones_like(once)
    gradient = jax.grad(lambda v: jnp.sum(seen(v) * cotangent))(values)
    forward = jnp.sum(along * cotangent)
    products = jax.tree.leaves(jax.tree.map(lambda g, t: jnp.where(t != 0, g * t, 0), gradient, tangent))
    reverse = sum(jnp.sum(p) for p in products)
    blackbody = jaxir.band_radiance(hottest, nodes)
    # of what is behind an optical depth of 64 the adjoint sees nothing: e^-64 of what is there at most
    scale = sum(jnp.sum(jnp.abs(p)) for p in products) + jnp.sum(jnp.abs(once) + jnp.abs(along))
    scale = scale + 1e-18 * blackbody.max() + 1e6 * tiny
    blackbody = blackbody if structure.how != "image" else nodes.in_band(blackbody)
    blackbody = blackbody.reshape((1,) * (once.ndim - 1) + (-1,))
    light = jnp.abs(twice) + jnp.abs(dark) + tiny
    shown = blackbody > 100 * tiny / jnp.finfo(values_dtype).eps
    ratio = jnp.where(shown, isothermal / jnp.where(shown, blackbody, 1), 0)
    checks = [*scene.checks_on(nodes), *structure.method.resolved(scene).checks_for(scene)]
    legal = jnp.stack([jnp.all(jnp.asarray(check.ok)) for check in checks if not check.doubt])
    finite = [jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(gradient)]
    bound = blackbody * (1 + close) + tiny
    result = {
        "legal": legal.all(),
        "finite": jnp.isfinite(once).all() & jnp.isfinite(isothermal).all(),
        "finite slope": jnp.stack(finite).all() & jnp.isfinite(along).all(),
        "sign": jnp.min(once) >= 0,
        "linear": jnp.all(jnp.abs(twice - dark - 2 * (once - dark)) <= 4 * close * light + tiny),  # tiny: underflow
        "modes": jnp.abs(forward - reverse) <= modes * scale,
    }
    if structure.background is not SKY and structure.background is not EVEN and structure.air is not FIXED:
        if structure.bounded:
            result["hottest"] = jnp.all(dark <= bound)
            result["furnace"] = jnp.all(isothermal <= bound)
        if structure.whole:
            # At a corner itself rounding may put the point inside the body, where skin sees skin; so it may, where no
            # higher precision looks again, on the edge where a ray along a face of a box ends.
            equal = jnp.abs(isothermal - blackbody) <= 2 * close * blackbody + tiny
            along_faces = jnp.any(fixed["rays"]["direction"] == 0, axis=1, keepdims=True)
            equal = equal | along_faces if structure.skin is not None and values_dtype == jnp.float64 else equal
            result["equality"] = jnp.all(equal[0 if structure.skin is None else 2 :])
    usable = jnp.any(shown) & result["legal"]
    return result | {"mean": jnp.where(usable, jnp.mean(ratio, where=jnp.broadcast_to(shown, ratio.shape)), jnp.nan)}


def draw_batch(structure: Structure, seed: tuple[int, ...], count: int = BATCH) -> tuple:
    """Numbers of `count` scenes: fixed, differentiated, weights, keys."""
    drawn = []
    for number in range(count):
        rng = np.random.default_rng((*seed, number))
        fixed, values = structure.draw(rng)
        ones = jax.tree.map(lambda v, rng=rng: rng.normal(size=np.shape(v)), values)
        weight = {"rays": rng.uniform(0.1, 1, (RAYS, 64)), "values": ones}
        drawn.append((fixed, values, weight))
    dtype = jnp.result_type(float)
    arrays = jax.tree.map(lambda *x: np.stack([np.asarray(one, np.float64) for one in x]).astype(dtype), *drawn)
    keys = jax.vmap(lambda n: jax.random.fold_in(jax.random.key(abs(hash(seed)) % 2**31), n))(jnp.arange(count))
    return (*arrays, keys)


def program(structure: Structure) -> Callable[..., dict]:
    """The laws of a batch of scenes of a structure, as one compiled program."""
    return jax.jit(lambda *arrays: jax.lax.map(lambda own: _laws(structure, *own), arrays))


def broken(found: dict) -> dict[str, list[int]]:
    """Scenes of a batch that break a law, by law; those that are not legal count for none but that."""
    legal = np.asarray(found["legal"])
    laws = [name for name in found if name not in ("legal", "mean")]
    return {name: np.flatnonzero(legal & ~np.asarray(found[name])).tolist() for name in laws}


def outshines(means: np.ndarray) -> bool:
    """Whether the furnace shines brighter than the blackbody on average, by 5 standard errors."""
    known_means = means[np.isfinite(means)]
    if known_means.size < 2:
        return False
    return known_means.mean() > 1 + 1e-3 + 5 * known_means.std(ddof=1) / np.sqrt(known_means.size)


def main() -> None:
    """Run every structure for many scenes and print what broke."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=4000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=np.inf)
    parser.add_argument("--only", nargs="*", default=list(STRUCTURES))
    given = parser.parse_args()
    begin = time.monotonic()
    each = -(-given.scenes // len(given.only) // BATCH)
    for name in given.only:
        structure = STRUCTURES[name]
        index = list(STRUCTURES).index(name)
        run, counts, means, where = program(structure), Counter(), [], {}
        until = begin + 60 * given.minutes * (given.only.index(name) + 1) / len(given.only)
        for batch in range(each):
            if time.monotonic() > until and batch:
                break
            seed = (given.seed, index, batch)
            found = jax.device_get(run(*draw_batch(structure, seed)))
            counts["scenes"] += int(found["legal"].sum())
            counts["not legal"] += int((~found["legal"]).sum())
            means.append(found["mean"])
            for law, scenes in broken(found).items():
                counts[law] += len(scenes)
                if scenes:
                    where.setdefault(law, (seed, scenes[0]))
        counts["on average"] = int(outshines(np.concatenate(means)))
        wrong = {law: n for law, n in counts.items() if n and law not in ("scenes", "not legal")}
        mean = np.nanmean(np.concatenate(means))
        said = f"{counts['scenes']} scenes, {counts['not legal']} not legal, mean {mean:.4f}, broken {wrong or 'none'}"
        print(f"{time.monotonic() - begin:6.0f} s  {name:28s} {said} {where or ''}", flush=True)


if __name__ == "__main__":
    main()
