"""The house stands: imports run downward only, and a scene compiles no more than it holds."""

import ast
import functools
import re
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest

import jaxir
from jaxir.geometry import Rays
from jaxir.imaging import _chunks as chunks_module
from jaxir.optics import surface
from jaxir.optics.spectrum import gray_nodes
from jaxir.scene import light, plume
from jaxir.scene.light import ParallelSource
from jaxir.transport import _direct as direct_module
from jaxir.transport import evaluate, trace
from tests import random_scenes
from tests.scenes import gray_box, plate

PACKAGE = Path(jaxir.__file__).parent
FLOORS = {
    "optics": 0,
    "geometry": 0,
    "medium": 1,
    "scene": 2,
    "transport": 3,
    "quantity": 3,
    "imaging": 4,
    "fit": 4,
    "io": 5,
    "plot": 5,
    "command_line": 6,
}
FAMILIES = {"scene/plume": plume, "scene/light": light, "optics/surface": surface}


def _room(module: str) -> str | None:
    parts = module.split(".")
    return parts[1] if parts[0] == "jaxir" and len(parts) > 1 else None


def _imports(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
        elif isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
    return found


def test_imports_run_downward_only():
    seen = 0
    for path in PACKAGE.rglob("*.py"):
        inside = path.relative_to(PACKAGE)
        room = inside.parts[0].removesuffix(".py")
        if room.startswith("_") and room != "__main__":
            if room != "__init__":
                assert all(_room(m) is None or _room(m).startswith("_") for m in _imports(path)), path
            continue
        if room not in FLOORS:
            continue
        for module in _imports(path):
            other = _room(module)
            if other is None or other.startswith("_"):
                continue
            seen += 1
            allowed = other == room or FLOORS[other] < FLOORS[room]
            assert allowed, f"{inside} imports {module}: upward or across the wings"
    assert seen > 20


@functools.cache
def _asked_for(path: Path) -> set[str]:
    """Names of the types that a file asks objects for."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("isinstance", "issubclass"):
            found |= {part.id for part in ast.walk(node.args[1]) if isinstance(part, ast.Name)}
    return found


def test_nobody_asks_which_plume_light_or_brdf_it_is():
    asked = 0
    for folder, family in FAMILIES.items():
        names = {name for name, value in vars(family).items() if isinstance(value, type)}
        assert len(names) > 3
        for path in PACKAGE.rglob("*.py"):
            asked += len(_asked_for(path))
            if not path.relative_to(PACKAGE).as_posix().startswith(folder):
                assert not _asked_for(path) & names, path
    assert asked > 20


def test_no_file_is_longer_than_it_can_be_read():
    for path in PACKAGE.rglob("*.py"):
        assert len(path.read_text().splitlines()) <= 400, path
    assert len(list((PACKAGE / "transport").glob("_[a-z]*.py"))) <= 8


def _equations(jaxpr):
    """All equations, those of inner jaxprs included."""
    for equation in jaxpr.eqns:
        yield equation
        for value in equation.params.values():
            for inner in value if isinstance(value, (tuple, list)) else (value,):
                inner = getattr(inner, "jaxpr", inner)
                if hasattr(inner, "eqns"):
                    yield from _equations(inner)


def _primitives(jaxpr) -> set[str]:
    return {equation.primitive.name for equation in _equations(jaxpr)}


LOOPS = {"while", "scan"}
RANDOM = {"random_bits", "threefry2x32", "random_seed"}


def _rays(count=4):
    return Rays(jnp.tile(jnp.array([[2.0, 0.1, 0.2]]), (count, 1)), jnp.tile(jnp.array([[-1.0, 0.0, 0.0]]), (count, 1)))


def _evaluation(scene):
    nodes = gray_nodes((jaxir.MWIR,))
    paths = eqx.filter_eval_shape(trace, scene, _rays())
    return _primitives(jax.make_jaxpr(lambda s, p: evaluate(s.on(nodes), p))(scene, paths).jaxpr)


def test_a_scene_compiles_no_more_than_it_holds():
    skin = jaxir.Scene(plate())
    assert not _evaluation(skin) & (LOOPS | RANDOM)
    marched = _evaluation(jaxir.Scene(plate(), gray_box((1.0, 1.0, 1.0), 0.5))) - _evaluation(skin)
    assert marched <= {"march", "reshape"}
    assert "march" in marched


def test_nothing_is_sampled_without_lights_of_an_extent_or_bounces():
    sun = jaxir.Scene(plate(), sources=(jaxir.ParallelSource((-1.0, 0.0, 0.0), 1.0),))
    key = jax.random.key(0)
    traced = _primitives(jax.make_jaxpr(lambda s: trace(s, _rays(), None, key))(sun).jaxpr)
    unasked = _primitives(jax.make_jaxpr(lambda s: trace(s, _rays()))(sun).jaxpr)
    random = {"random_bits", "random_split", "random_fold_in", "threefry2x32"}
    assert not (traced | unasked) & random
    disc = jaxir.DiscSource((3.0, 0.0, 0.0), (-1.0, 0.0, 0.0), 1.0, 1.0)
    lamp = jaxir.Scene(plate(), sources=(disc,))
    asked = _primitives(jax.make_jaxpr(lambda s: trace(s, _rays(), None, key))(lamp).jaxpr)
    assert asked & random
    left_out = _primitives(jax.make_jaxpr(lambda s: trace(s, _rays(), jaxir.Method(direct=None), key))(lamp).jaxpr)
    assert not left_out & random


STRUCTURES_THAT_MULTIPLY = ("measured box", "box under a sky", "jet of lines", "image")


@pytest.mark.parametrize("name", STRUCTURES_THAT_MULTIPLY)
def test_products_are_in_full_precision_on_every_device(name):
    """Graphics cards round the factors of a float32 product to 11 bits unless they are told not to."""
    structure = random_scenes.STRUCTURES[name]
    numbers = random_scenes.draw_batch(structure, (2, 5), 1)
    jaxpr = jax.make_jaxpr(random_scenes.program(structure))(*numbers).jaxpr
    products = [each for each in _equations(jaxpr) if each.primitive.name == "dot_general"]
    full = (jax.lax.Precision.HIGHEST, jax.lax.Precision.HIGHEST)
    assert products
    for product in products:
        assert product.params["precision"] == full, product.source_info.traceback


def test_no_product_of_arrays_is_asked_of_jax_itself():
    for path in PACKAGE.rglob("*.py"):
        if path.name != "_math.py":
            assert not re.search(r"jnp\.(matmul|einsum|tensordot|dot|inner|vdot|vecdot)\b", path.read_text()), path


@pytest.mark.parametrize("bundled", [True, False])
def test_shadow_rays_are_traced_for_sources_only(monkeypatch, bundled):
    """Of a bundle in its own search, of unrelated rays in that of all that is asked from their points."""
    asked, found = [], direct_module.face_met
    monkeypatch.setattr(ParallelSource, "hidden", lambda self, mesh, point, face, active: asked.append(1) or face > 99)
    monkeypatch.setattr(direct_module, "face_met", lambda *args: asked.append(0) or found(*args))
    sun = jaxir.ParallelSource((-1.0, 0.0, 0.0), 1.0)
    camera = jaxir.orthographic_camera(0.0, 4.0, 0.07, (17, 19))

    def ask(scene):
        jax.eval_shape(
            lambda: trace.__wrapped__(
                scene, camera.bundle(jnp.zeros((4, 2)), jnp.asarray(-5.0)) if bundled else _rays()
            )
        )

    ask(jaxir.Scene(plate()))
    assert not asked
    ask(jaxir.Scene(plate(), sources=(sun,)))
    assert asked == [int(bundled)]


def test_new_values_never_compile_again(monkeypatch):
    traced = []
    monkeypatch.setattr(chunks_module, "trace", lambda *args: traced.append(1) or trace(*args))

    def run(temperature, emissivity, absorption, irradiance, azimuth):
        scene = jaxir.Scene(
            skin=jaxir.Skin(plate().mesh, temperature, jaxir.Lambert(emissivity)),
            plumes=gray_box((1.0, 1.0, 1.0), absorption, temperature=temperature),
            sources=(jaxir.ParallelSource((-1.0, 0.0, 0.0), irradiance),),
        )
        turned = jaxir.orthographic_camera(azimuth, 4.0, 0.07, (17, 19))
        return float(jaxir.render(scene, turned, jaxir.MWIR, samples=2).radiant_intensity()[0])

    first = run(300.0, 0.5, 1.0, 10.0, 0.0)
    compiled = len(traced)
    assert compiled > 0
    assert run(310, 0.6, 1.5, 20, 10) != first
    assert len(traced) == compiled
