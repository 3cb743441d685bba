"""Strict settings for every test: types checked at run time, strict promotion, both precisions.

Programs are kept beside pytest's own cache: files share many, workers do, and so do the next tests run.
"""

import gc
import importlib
import os
from pathlib import Path

# Most of the time of the tests is that of the compiler, whose second level is a tenth faster than its third; to cut
# every program in pieces for cores that other tests keep busy takes another tenth.
os.environ["XLA_FLAGS"] = (
    f"{os.environ.get('XLA_FLAGS', '')} --xla_backend_optimization_level=2 --xla_cpu_parallel_codegen_split_count=1"
).strip()
os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "1"  # of processes that tests begin; `pytest_runtest_setup` sets its own
os.environ.setdefault("JAXIR_CACHE", str(Path(__file__).parent.parent / ".pytest_cache" / "programs"))

import jax
import pytest
from jaxtyping import install_import_hook

import tests.checked  # noqa: F401, the hook looks it up by name

jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_traceback_in_locations_limit", 1)  # below pytest and checked types stacks are deep: a fifth

MOST_MEMORY = 4e9  # bytes

gc.set_threshold(100_000, 50, 100)  # tracing makes many objects that live: looking through them takes a tenth of a test

install_import_hook("jaxir", "tests.checked.checked")  # for the whole run: modules imported later are checked too

# Tests put other functions in the place of the package's own, which the key of a kept executable does not tell.
importlib.import_module("jaxir._programs").keeps = lambda: False


def pytest_configure(config):
    """Physics is tested at odd values on purpose; `test_plausible.py` looks at what is warned of."""
    config.addinivalue_line("filterwarnings", "ignore::jaxir.PlausibilityWarning")
    config.addinivalue_line(
        "markers", "optimised: of programs that run long, or whose last bits count, compiled in full"
    )


def pytest_runtest_setup(item):
    """Programs of most tests run for moments: to compile them without optimisation takes three quarters of the time."""
    jax.config.update("jax_disable_most_optimizations", item.get_closest_marker("optimised") is None)


@pytest.fixture(params=["float32", "float64"])
def precision(request):
    """Run the test in single and in double precision; the value is the dtype's name."""
    with jax.enable_x64(request.param == "float64"):
        yield request.param


@pytest.fixture
def x64():
    """Run the test in double precision."""
    with jax.enable_x64(True):
        yield


@pytest.fixture
def one_program(monkeypatch):
    """For images of all numbers of rays, whose strata are else traced in groups of different sizes."""
    monkeypatch.setattr("jaxir.imaging._division.TOGETHER", (1,))


@pytest.fixture(autouse=True, scope="module")
def bounded_memory():
    """Drop compiled programs between files once they hold gigabytes; until then files share them."""
    yield
    if _resident() > MOST_MEMORY:
        jax.clear_caches()


def _resident() -> float:
    """Memory that this process holds [bytes]; inf where the system does not tell."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return float("inf")
