"""What the first answer costs: programs compiled, once for one structure, kept on disk, and what import loads."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import monitoring

import jaxir
from jaxir import MWIR, _cache
from jaxir._cache import _SUFFIX
from jaxir._programs import program
from jaxir.imaging import _adaptive, _chunks
from jaxir.optics.spectrum import gray_nodes
from jaxir.scene import _resolution
from jaxir.transport import with_scattered

ROOT = Path(__file__).parent.parent
GRID = jaxir.Grid((-1.0, -0.5, -0.5), (0.25, 0.25, 0.25), (4, 4, 4))
PLATE = jaxir.Mesh([[0.0, -1, -1], [0, 1, -1], [0, 0, 1]], [[0, 1, 2]])
SUN = jaxir.ParallelSource((-1.0, 0.0, 0.0), 10.0)
CAMERA = jaxir.orthographic_camera(0, 10, 0.1, (16, 16))
COMPILED = []
monitoring.register_event_duration_secs_listener(
    lambda event, seconds, **_: COMPILED.append(seconds) if event.endswith("backend_compile_duration") else None
)


def scene(x, sources=(SUN,)):
    """A sunlit plate behind hot gas; x: emissivity, temperature of the gas."""
    skin = jaxir.Skin(PLATE, 300.0, jaxir.Lambert(x[0]))
    return jaxir.Scene(skin, jaxir.GridPlume(GRID, x[1], jaxir.GrayGas(0.5)), sources)


def unlit(x):
    """Without the sun: how often a program is compiled does not depend on what it does."""
    return scene(x, ())


def along_rays(x):
    lit = unlit(x).on(gray_nodes((MWIR,)))
    rays = jaxir.Rays(jnp.array([[-5.0, 0.0, 0.0]]), jnp.array([[1.0, 0.0, 0.0]]))
    return jaxir.evaluate(lit, jaxir.trace(lit.scene, rays)).sum()


QUANTITIES = {
    "rays": along_rays,
    "render": lambda x: jaxir.render(unlit(x), CAMERA, MWIR, samples=2).radiant_intensity()[0],
    "signature": lambda x: jaxir.signature(unlit(x), [(0, 10)], MWIR, samples=2, shape=(16, 16)).intensity[0, 0],
    "faces": lambda x: jaxir.unoccluded_intensity(
        jaxir.Scene(jaxir.Skin(PLATE, x[1] / 3, jaxir.Lambert(x[0]))), 0, 10, MWIR
    )[0],
    "plume": lambda x: jaxir.plume_intensity(jaxir.Scene(None, scene(x).plumes), 0, 10, MWIR, rays=64)[0],
}
TRANSFORMATIONS = {
    "grad": jax.grad,
    "jvp": lambda f: lambda x: jax.jvp(f, (x,), (x,)),
    "jacfwd": jax.jacfwd,
    "vmap": lambda f: lambda x: jax.vmap(f)(jnp.stack([x, x * 0.9])),
}


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("transformation", TRANSFORMATIONS)
def test_no_program_is_compiled_twice_for_one_structure(quantity, transformation):
    found = TRANSFORMATIONS[transformation](QUANTITIES[quantity])
    first = found(jnp.asarray([0.8, 900.0]))
    del COMPILED[:]
    second = found(jnp.asarray([0.7, 800.0]))
    assert not COMPILED
    assert all(np.any(a != b) for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True))


def test_light_that_is_solved_for_compiles_nothing_again():
    """Of a plume in the sun, differentiated without `jax.jit`."""
    method = jaxir.Method(scattering=jaxir.DiscreteOrdinates(4, 4, 1))

    def light(x):
        particles = jaxir.GrayParticles(x[0], 0.9, jaxir.HenyeyGreenstein(0.5))
        cloud = jaxir.GridPlume(GRID, x[1], jaxir.GrayGas(0.5), particles=particles)
        lit = with_scattered(jaxir.Scene(None, cloud, (SUN,)).on(gray_nodes((MWIR,))), method)
        return lit.medium.parts[0].moments.sum()

    for of in (light, TRANSFORMATIONS["jvp"](light)):
        first = of(jnp.asarray([0.8, 900.0]))
        del COMPILED[:]
        second = of(jnp.asarray([0.7, 800.0]))
        assert not COMPILED
        assert all(a != b for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True))


def test_numbers_set_into_fields_compile_nothing():
    hot = jaxir.Lambert(0.5)

    @program
    def doubled(surface):
        return 2 * surface.emissivity

    def of(value):
        return doubled(eqx.tree_at(lambda surface: surface.emissivity, hot, value))

    values = [0.25, 1, jnp.asarray(0.75), np.float64(0.5), np.float32(0.125)]
    assert of(jnp.float32(0.5)) == 1
    del COMPILED[:]
    assert [float(of(value)) for value in values] == [0.5, 2.0, 1.5, 1.0, 0.25]
    assert not COMPILED


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="on a graphics card an image is one chunk")
@pytest.mark.parametrize("asked", [{"samples": 8}, {"pixel_rtol": 0.05, "method": jaxir.Method()}], ids=str)
def test_images_of_other_shapes_trace_no_rays(asked, monkeypatch):
    """Only what puts their pixels together is compiled again."""
    traced, see = [], _chunks.see

    def counted(*args):
        traced.append(args)
        return see(*args)

    for module in (_chunks, _adaptive):
        monkeypatch.setattr(module, "see", counted)
    fan = jaxir.Mesh([[0.0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1], [0, -1, 1]], [[0, 1, 2], [0, 2, 3], [0, 3, 4]])
    seen = jaxir.Scene(jaxir.Skin(fan, 300.0, jaxir.Lambert(0.5)))
    exact = float(jaxir.unoccluded_intensity(seen, 0, 10, MWIR)[0])
    once = None
    for shape in ((20, 30), (16, 16), (30, 100), (90, 128)):
        image = jaxir.render(seen, jaxir.fitted_camera(0, 10, seen.extent(), shape), MWIR, **asked)
        np.testing.assert_allclose(image.radiant_intensity()[0], exact, rtol=0.03)
        once = len(traced) if once is None else once
    assert len(traced) == once > 0


def test_other_numbers_and_shapes_of_views_compile_nothing():
    seen = [jaxir.signature(unlit((0.8, 900.0)), [(0, 10)], MWIR, samples=2, shape=(16, 16))]
    del COMPILED[:]
    views = [(0, 10), (40, 0), (0, 10), (80, -30), (180, 0)]
    seen += [jaxir.signature(unlit((0.8, 900.0)), views, MWIR, samples=2, shape=(16, 16))]
    assert not COMPILED
    np.testing.assert_array_equal(seen[1].intensity[0], seen[0].intensity[0])
    assert (np.asarray(seen[1].intensity)[1:] != np.asarray(seen[0].intensity)).all()  # by random keys of their own
    for shape in ((30, 100), (90, 128)):
        del COMPILED[:]
        other = jaxir.signature(unlit((0.8, 900.0)), views, MWIR, samples=2, shape=shape)
        assert not COMPILED
        np.testing.assert_allclose(other.intensity, seen[1].intensity, rtol=0.05)


def test_hessian_of_a_gridded_plume_is_the_slope_of_its_gradient(x64):
    grid = jaxir.Grid((-1.0, -0.5, -0.5), (0.25, 0.25, 0.25), (4, 4, 4))

    def intensity(x):
        return jaxir.plume_intensity(
            jaxir.Scene(None, jaxir.GridPlume(grid, x[1], jaxir.GrayGas(x[0]))), 30, 10, MWIR, rays=64
        )[0]

    x, step = np.array([0.5, 900.0]), 1e-5
    slope = jax.grad(intensity)
    slopes = jax.jit(jax.jacfwd(lambda x: (slope(x),) * 2, has_aux=True))  # the hessian, and the gradient
    hessian, _ = slopes(x)
    for axis, size in enumerate(x):
        change = step * size * np.eye(2)[axis]
        above, below = (np.asarray(slopes(there)[1]) for there in (x + change, x - change))
        np.testing.assert_allclose(hessian[axis], (above - below) / (2 * step * size), rtol=1e-6)


@pytest.fixture(scope="module")
def uncached():
    """What a process without a cache says: heavy modules after the import, the cache's state, programs of a render."""
    code = """
import sys
import jaxir
print([m for m in ("matplotlib", "optimistix", "scipy.sparse", "trimesh") if m in sys.modules])
print(jaxir.compilation_cache())
from test_cold_start import CAMERA, COMPILED, MWIR, scene
image = jaxir.render(scene((0.8, 900.0)), CAMERA, MWIR)
image.radiant_intensity()
print(len(COMPILED))
"""
    return run(code, JAXIR_CACHE="0")


def test_a_render_compiles_five_programs(uncached):
    # the key, the scene on the nodes, a chunk of the image, the whole image, its intensity
    assert int(uncached[-1]) <= 5


def test_import_loads_no_heavy_library(uncached):
    assert uncached[0] == "[]"


# The cache on disk ----------------------------------------------------------------------------------------------------

ANSWER = """
from test_cold_start import CAMERA, MWIR, jaxir, scene
print(jaxir.compilation_cache())
print(jaxir.plume_intensity(jaxir.Scene(None, scene((0.8, 900.0)).plumes), 0, 10, MWIR, rays=64))
"""
IMAGE = """
print(jaxir.render(jaxir.Scene(scene((0.8, 900.0)).skin), CAMERA, MWIR).radiant_intensity())
"""
TRACED = """
import equinox as eqx
import jax
from jax import monitoring
seen = []
monitoring.register_event_duration_secs_listener(
    lambda event, seconds, **own: seen.append(own.get("fun_name")) if event.endswith("trace_duration") else None
)
"""


def run(code, **variables):
    path = f"{ROOT}{os.pathsep}{ROOT / 'tests'}"
    environment = {**os.environ, "PYTHONPATH": path, "JAX_PLATFORMS": "cpu"} | variables
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    return done.stdout.strip().splitlines()


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    """A folder with the programs of `ANSWER` and `IMAGE`, and what these printed."""
    folder = tmp_path_factory.mktemp("cache") / "programs"
    return folder, run(ANSWER + IMAGE, JAXIR_CACHE=str(folder))


@pytest.fixture(scope="module")
def found_again(filled):
    """Files of the folder before a second process, what that printed, what it traced, and the files after it."""
    folder, _ = filled
    before = {file.name for file in folder.iterdir()}
    *printed, traced = run(TRACED + ANSWER + IMAGE + "print(sorted(set(seen)))", JAXIR_CACHE=str(folder))
    return before, printed, eval(traced), {file.name for file in folder.iterdir()}


def test_programs_are_kept_in_a_private_folder_and_found_again(filled, found_again):
    folder, said = filled
    assert said[0] == f"compilation cache: {folder}, set by jaxir (JAXIR_CACHE=0 prevents it)"
    assert folder.stat().st_mode & 0o777 == 0o700
    before, printed, _, after = found_again
    assert len(before) >= 4 and all(name.endswith(_SUFFIX) for name in before)
    assert printed == said
    assert after == before


def test_a_second_process_traces_nothing_of_an_image(found_again):
    assert set(found_again[2]) <= {
        "threefry_seed",
        "_threefry_seed",
        "random_seed",
        "radius_about",
    }  # of JAX, and for a mesh


def test_what_jax_kept_of_other_code_is_not_kept_as_an_executable(tmp_path, filled):
    """XLA cannot write an executable again that it has read."""
    folder = shutil.copytree(filled[0], tmp_path / "p")
    changed = "import jaxir._cache\njaxir._cache._of_this_code = lambda: 'changed'\n"
    for _ in range(2):  # the first compiles and keeps, the second loads
        assert run(changed + ANSWER, JAXIR_CACHE=str(folder))[1:] == filled[1][1:2]


def test_damaged_files_are_compiled_anew(tmp_path, filled):
    folder = shutil.copytree(filled[0], tmp_path / "p")
    rng = np.random.default_rng(0)
    for number, file in enumerate(sorted(folder.iterdir())):
        content = bytearray(file.read_bytes())
        if number % 3 == 0:
            content[int(rng.integers(len(content)))] ^= 1 << int(rng.integers(8))
        file.write_bytes((bytes(content), content[: len(content) // 2], b"")[number % 3])
    assert run(ANSWER + IMAGE, JAXIR_CACHE=str(folder))[1:] == filled[1][1:]


def test_folders_that_cannot_be_used_are_left_alone(tmp_path, filled):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    open_to_all = tmp_path / "open"
    open_to_all.mkdir()
    open_to_all.chmod(0o777)
    for folder, why in ((blocked / "programs", "Not a directory"), (open_to_all, "others can write")):
        state, answer = run(ANSWER, JAXIR_CACHE=str(folder))
        assert state.startswith("compilation cache: off, because") and why in state
        assert answer == filled[1][1]
    assert list(open_to_all.iterdir()) == []


def test_the_user_decides(uncached):
    assert uncached[1] == "compilation cache: off, because JAXIR_CACHE says so"
    named = "import jax; jax.config.update('jax_compilation_cache_dir', '/named'); "
    assert run(named + "import jaxir; print(jaxir.compilation_cache())", JAXIR_CACHE="") == [
        "compilation cache: /named, as jax_compilation_cache_dir says"
    ]


OTHERS = """
import sys
import equinox as eqx, jax, jax.numpy as jnp, numpy as np, jaxir
from jaxir import _programs

kept = []
_programs.keep = lambda key, value, put=_programs.keep: (kept.append(key), put(key, value))
"""


SOLVED = """
from jaxir._programs import program
import jaxir._math
def solve(a, b):
    return jnp.linalg.solve(a, b), jax.random.key_data(jax.random.key(1)), jax.random.key(2)
solve.__module__ = "jaxir._math"
own = program(solve)
print(own(2 * jnp.eye(2), jnp.ones(2))[0].tolist(), jax.random.uniform(own(jnp.eye(2), jnp.ones(2))[2]), len(kept))
"""
UNNAMED = """
class Dull(jaxir.Lambert):  # a user's, who may change its code
    pass

mesh = jaxir.Mesh([[0.0, -1, -1], [0, 1, -1], [0, 0, 1]], [[0, 1, 2]])
for kind in (jaxir.Lambert, Dull):
    del kept[:]
    skin = jaxir.Skin(mesh, 300.0, kind(0.5))
    print(float(jaxir.unoccluded_intensity(jaxir.Scene(skin), 0, 0, jaxir.MWIR)[0]), len(kept) > 0)
"""
SETTINGS = """
del kept[:]
from jaxir.imaging._image import truncated_share
for x64 in (False, True):
    with jax.enable_x64(x64):
        print(truncated_share(jnp.asarray([[0.1], [0.3]]), jnp.asarray([2.0])).dtype)
print(len(set(kept)))
"""
CROWDED = """
del kept[:]
truncated_share._held = {}
import pathlib
from jaxir import _room
asked = lambda n: truncated_share(jnp.full((2, n), 0.1), jnp.full(n, 2.0))
held = lambda: sum(1 for line in open("/proc/self/maps") if "r-xp" in line)
mine = truncated_share._held
first = [asked(n) for n in range(1, 20)]  # far from it: all are held
before = held(), len(truncated_share._held), truncated_share._held is mine
_room._GRANTED, _room.OFTEN = pathlib.Path("HERE"), 0
again = asked(1)
print(before[1:], truncated_share._held is mine, len(truncated_share._held), held() < before[0] - 10)
print(bool((again == first[0]).all()), len(kept))
"""


@pytest.fixture(scope="module")
def others(tmp_path_factory):
    """What the code above prints in one process, with a folder of its own, by name; and `SOLVED` in a second."""
    folder = tmp_path_factory.mktemp("others")
    (folder / "granted").write_text("1")
    codes = {"solved": SOLVED, "unnamed": UNNAMED, "settings": SETTINGS}
    codes["crowded"] = CROWDED.replace("HERE", str(folder / "granted"))
    said = run(OTHERS + "print('---')\n".join(codes.values()), JAXIR_CACHE=str(folder / "p"))
    parts = [part.strip().splitlines() for part in "\n".join(said).split("---")]
    second = run(OTHERS + SOLVED, JAXIR_CACHE=str(folder / "p"))
    return {**dict(zip(codes, parts, strict=True)), "second": second}


def test_what_a_key_cannot_name_is_not_kept(others):
    (own, own_kept), (other, other_kept) = (line.split() for line in others["unnamed"])
    assert own == other and own_kept == "True" and other_kept == "False"


def test_settings_of_jax_and_flags_have_programs_of_their_own(others):
    assert others["settings"] == ["float32", "float64", "2"]


def test_programs_with_linear_algebra_find_its_functions_in_a_second_process(others):
    first, second = others["solved"], others["second"]
    assert first[0].startswith("[0.5, 0.5]") and first[0].endswith(" 1") and second[0] == first[0][:-1] + "0"


def test_programs_are_dropped_before_the_system_ends_the_process(others):
    """Where nearly all the mappings of memory that it grants are held; what is asked for again is read."""
    assert others["crowded"] == ["(19, True) False 1 True", "True 19"]


class OtherGas(jaxir.NarrowBandGas):
    """A gas of a user's, who may change its code."""


def test_a_choice_of_nodes_is_found_by_later_processes(tmp_path, monkeypatch):
    grid = jaxir.Grid((0.0, -0.4, -0.4), (0.8, 0.8, 0.8), (1, 1, 1))

    def slab(temperature, kind=jaxir.NarrowBandGas):
        return jaxir.Scene(None, jaxir.GridPlume(grid, temperature, kind(101325.0, h2o=0.1, co2=0.1)))

    calls, fewest = [], _resolution._fewest
    monkeypatch.setattr(_cache, "_FOLDERS", [_cache._Folder(tmp_path)])
    monkeypatch.setattr(_resolution, "_fewest", lambda *given: calls.append(0) or fewest(*given))

    def chosen(scene):
        monkeypatch.setattr(_resolution, "_chosen", {})  # as in another process
        nodes = jaxir.scene_nodes(scene, MWIR)
        return nodes.count, nodes.error.tolist(), len(calls)

    first = chosen(slab(950.0))
    (file,) = tmp_path.iterdir()
    assert chosen(slab(950.0)) == first and first[2] == 1
    file.write_bytes(file.read_bytes()[:-1])
    assert chosen(slab(950.0)) == (*first[:2], 2)  # what is damaged is found anew
    assert chosen(slab(960.0))[2] == 3 and len(list(tmp_path.iterdir())) == 2
    assert [chosen(slab(950.0, OtherGas))[2] for _ in range(2)] == [4, 5]  # another file may define it tomorrow
    monkeypatch.setattr(_cache, "_of_this_code", lambda: "changed")
    assert chosen(slab(950.0))[2] == 6
