"""Computations that do not wait for one another, side by side.

JAX's CPU backend runs a program on the thread that calls it, and most of it on one core: what a loop holds is native
code of one thread. Programs that several threads call are compiled and run at the same time.
"""

from __future__ import annotations

import collections
import itertools
import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import cache
from typing import TypeVar

import jax

A = TypeVar("A")
B = TypeVar("B")

# What `with` sets in JAX holds for one thread; these decide what a program computes.
SETTINGS = ("enable_x64", "default_device", "default_matmul_precision", "numpy_dtype_promotion", "debug_nans")
MOST = 8  # threads: each needs memory of its own
_INSIDE = threading.local()


def side_by_side(aside: Callable[[], A], here: Callable[[], B]) -> tuple[A, B]:
    """What two functions return; the first runs on a thread of its own, with the `SETTINGS` in force here.

    What one of them raises is raised when both have ended; if both raise, that of `here`.
    """
    with _threads(1) as pool:
        other = pool.submit(aside)
        own = here()
        return other.result(), own


def each_of(work: Callable[[A], B], items: Iterable[A], ready: bool = False) -> Iterator[B]:
    """What a function returns of every item, in order; as many threads call it as there are `cores`.

    What a call raises is raised where its result would come, and calls that have not begun are not made. Few items are
    taken before their turn.

    Args:
        work: the function.
        items: its arguments.
        ready: whether all that is called was compiled before; else the first item is done before the others begin.
    """
    left, count = iter(items), cores()
    yield from map(work, itertools.islice(left, 0 if ready else 1))
    if count == 1:
        yield from map(work, left)
        return
    pool = _threads(count)
    try:
        waiting = collections.deque(pool.submit(work, item) for item in itertools.islice(left, 2 * count))
        while waiting:
            yield waiting.popleft().result()
            waiting.extend(pool.submit(work, item) for item in itertools.islice(left, 1))
    finally:
        pool.shutdown(cancel_futures=True)


@cache
def cores() -> int:
    """How many programs run at a time: 1 where the device is no CPU, which runs one after another, at most `MOST`."""
    if jax.default_backend() != "cpu":
        return 1
    allowed = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else range(os.cpu_count() or 1)
    return min(len(allowed), MOST)


def _threads(count: int) -> ThreadPoolExecutor:
    """Threads with the `SETTINGS` in force here."""
    held = {name: getattr(jax.config, f"jax_{name}") for name in SETTINGS}

    def set_up() -> None:
        _INSIDE.stack = stack = ExitStack()  # until the thread ends
        for name, value in held.items():
            stack.enter_context(getattr(jax, name)(value))

    return ThreadPoolExecutor(count, initializer=set_up)
