"""Two computations that do not wait for one another, side by side.

JAX's CPU backend runs a program on the thread that calls it, and most of it on one core. Two programs that are called
by two threads are compiled and run at the same time.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from typing import TypeVar

import jax

A = TypeVar("A")
B = TypeVar("B")

# What `with` sets in JAX holds for one thread; these decide what a program computes.
SETTINGS = ("enable_x64", "default_device", "default_matmul_precision", "numpy_dtype_promotion", "debug_nans")


def side_by_side(aside: Callable[[], A], here: Callable[[], B]) -> tuple[A, B]:
    """What two functions return; the first runs on a thread of its own, with the `SETTINGS` in force here.

    What one of them raises is raised when both have ended; if both raise, that of `here`.
    """
    held = {name: getattr(jax.config, f"jax_{name}") for name in SETTINGS}

    def under_settings() -> A:
        with ExitStack() as stack:
            for name, value in held.items():
                stack.enter_context(getattr(jax, name)(value))
            return aside()

    with ThreadPoolExecutor(1) as pool:
        other = pool.submit(under_settings)
        own = here()
        return other.result(), own
