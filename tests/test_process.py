"""The process setting: what import does, who may prevent it, and that results do not depend on it."""

import functools
import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir._process import OPT_OUT, OPTIONS
from jaxir.geometry import Bundle, Rays
from jaxir.geometry.search import Mesh, any_hit, closest_hit

ROOT = Path(__file__).parent.parent
PRINT_FACES = """
import jaxir
from test_process import scene
from jaxir.geometry.search import closest_hit
mesh, rays, bundle = scene()
print(jaxir.compiler_options())
print(closest_hit(mesh, rays).face.tolist())
print(closest_hit(mesh, bundle).face.tolist())
"""


def scene():
    rng = np.random.default_rng(0)
    vertices = rng.normal(size=(600, 1, 3)) + 0.3 * rng.normal(size=(600, 3, 3))
    mesh = Mesh(vertices.reshape(-1, 3), np.arange(1800).reshape(-1, 3))
    origin = jnp.asarray(rng.normal(size=(300, 3)), jnp.float32)
    rays = Rays(origin, jnp.tile(jnp.asarray([[0.6, 0.0, 0.8]], jnp.float32), (300, 1)))
    point = [jnp.asarray(x, jnp.float32) for x in (0.0, 6.0)]
    screen = jnp.asarray(rng.uniform(-2, 2, size=(256, 2)), jnp.float32)
    return mesh, rays, Bundle(jnp.zeros(3, jnp.float32), jnp.eye(3, dtype=jnp.float32), *point, screen)


@functools.cache
def compiled(search, bundled):
    """A search of the scene's bundle, or of its rays, as one program."""
    mesh, *shapes = scene()
    return jax.jit(lambda m, r: search(m, r)).lower(mesh, shapes[bundled]).compile()


def run(code, **variables):
    environment = {k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", OPT_OUT)}
    environment |= {"PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'tests'}", "JAX_PLATFORMS": "cpu"} | variables
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip().splitlines()


def test_results_are_the_same_without_compiler_options():
    mesh, rays, bundle = scene()
    line, single, tiles = run(PRINT_FACES, **{OPT_OUT: "0"})
    assert line == f"compiler options: none set, because {OPT_OUT} says so"
    assert single == str(compiled(closest_hit, False)(mesh, rays).face.tolist())
    assert tiles == str(compiled(closest_hit, True)(mesh, bundle).face.tolist())


def test_import_sets_the_option_and_keeps_other_flags():
    code = "import os, jaxir, jax; jax.devices(); print(jaxir.compiler_options()); print(os.environ['XLA_FLAGS'])"
    line, flags = run(code, XLA_FLAGS="--xla_force_host_platform_device_count=2")
    assert "set by jaxir" in line
    assert flags.startswith("--xla_force_host_platform_device_count=2 ") and all(name in flags for name in OPTIONS)


def test_a_running_backend_and_a_named_option_are_left_alone():
    code = (
        "import os, jax; jax.devices(); import jaxir; print(jaxir.compiler_options()); print('XLA_FLAGS' in os.environ)"
    )
    line, changed = run(code)
    assert "a JAX backend was running" in line and changed == "False"
    code = "import os, jaxir, jax; jax.devices(); print(jaxir.compiler_options()); print(os.environ['XLA_FLAGS'])"
    loops, emitters = OPTIONS
    given = f"--xla_backend_extra_options={loops}=1024"
    line, flags = run(code, XLA_FLAGS=given)
    assert loops not in line and flags == f"{given} --xla_backend_extra_options={emitters}"
    given = f"--xla_backend_extra_options={loops}=1024,{emitters}=true"
    line, flags = run(code, XLA_FLAGS=given)
    assert "names them itself" in line and flags == given


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="native loops are a matter of the CPU compiler")
@pytest.mark.skipif("set by jaxir" not in jaxir.compiler_options(), reason="another owner of the process")
@pytest.mark.parametrize("search", [closest_hit, any_hit])
def test_the_compiled_search_holds_native_loops(search):
    for bundled, nests in ((False, 2), (True, 4)):
        text = compiled(search, bundled).as_text()
        assert text.count('xla_cpu_small_call="true"') >= nests
