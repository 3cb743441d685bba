"""The one setting of jaxir that belongs to the whole process.

XLA's CPU compiler turns a nest of while loops into native code only when it is small; the default limit keeps the
search of rays out, which then runs 4 to 10 times slower with the same results. The limit can only be set for a whole
process, before JAX starts a backend. So `import jaxir` sets it, unless a backend already runs, `XLA_FLAGS` already
names it, or the environment variable `JAXIR_NATIVE_LOOPS` is 0.
"""

from __future__ import annotations

import os

OPTION = "xla_cpu_small_while_loop_byte_threshold"
OPT_OUT = "JAXIR_NATIVE_LOOPS"
_BYTES = 10**9


def native_loops() -> str:
    """One line that says whether XLA compiles ray searches to native loops in this process, and who decided."""
    return _STATE


def _backend_runs() -> bool:
    """Whether JAX has started a backend; assumed so when it does not tell."""
    try:
        from jax._src import xla_bridge

        return bool(xla_bridge.backends_are_initialized())
    except (ImportError, AttributeError):
        return True


def _decide() -> str:
    flags = os.environ.get("XLA_FLAGS", "")
    if OPTION in flags:
        return "native loops: left as XLA_FLAGS says, which names the option itself"
    if os.environ.get(OPT_OUT, "").lower() in ("0", "false", "off", "no"):
        return f"native loops: off, because {OPT_OUT} says so"
    if _backend_runs():
        return "native loops: off, because a JAX backend was running before jaxir was imported"
    os.environ["XLA_FLAGS"] = f"{flags} --xla_backend_extra_options={OPTION}={_BYTES}".strip()
    return f"native loops: on, set by jaxir in XLA_FLAGS ({OPT_OUT}=0 prevents it)"


_STATE = _decide()
