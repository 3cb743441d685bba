"""The settings of jaxir that belong to the whole process: two options of XLA's CPU compiler.

- `xla_cpu_small_while_loop_byte_threshold`: a nest of while loops is turned into native code only when it is small; the
  default limit keeps the search of rays out, which then runs 4 to 10 times slower with the same results.
- `xla_cpu_disable_new_fusion_emitters`: the newer emitters of fused kernels make an MLIR context for each, a third or
  more of the time that a program of many kernels takes to compile; the older ones make kernels of the same speed in
  most scenes (README's image: compiled in 7.9 instead of 10.9 s of one core, a jet's gradient in 9 instead of 16 s),
  and slower ones where a plume's cells are crossed in large numbers (480,000 cells, 120,000 rays: 144 instead of 123 ms
  an image). Who renders such a scene for hours names the option in `XLA_FLAGS` and turns it off.

Options can only be set for a whole process, before JAX starts a backend. So `import jaxir` sets them, unless a backend
already runs, `XLA_FLAGS` already names them, or the environment variable `JAXIR_COMPILER_OPTIONS` is 0. A compiler that
does not know an option passes over it.
"""

from __future__ import annotations

import os

OPT_OUT = "JAXIR_COMPILER_OPTIONS"
OPTIONS = {"xla_cpu_small_while_loop_byte_threshold": f"={10**9}", "xla_cpu_disable_new_fusion_emitters": ""}


def compiler_options() -> str:
    """One line that says which options of XLA's compiler jaxir has set for this process, or why none."""
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
    ours = [name + value for name, value in OPTIONS.items() if name not in flags]
    if not ours:
        return "compiler options: left as XLA_FLAGS says, which names them itself"
    if os.environ.get(OPT_OUT, "").lower() in ("0", "false", "off", "no"):
        return f"compiler options: none set, because {OPT_OUT} says so"
    if _backend_runs():
        return "compiler options: none set, because a JAX backend was running before jaxir was imported"
    os.environ["XLA_FLAGS"] = f"{flags} --xla_backend_extra_options={','.join(ours)}".strip()
    return f"compiler options: {', '.join(ours)}, set by jaxir in XLA_FLAGS ({OPT_OUT}=0 prevents it)"


_STATE = _decide()
