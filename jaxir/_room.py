"""Room for programs: a process that holds too many is ended.

XLA maps the code of every kernel into memory for itself, three mappings each, and Linux grants a process some 65,000 of
them (`vm.max_map_count`). A large program has hundreds of kernels, so that some twenty scenes of different structure
are enough; one mapping too many ends the process with "Unable to allocate section memory", however much memory is free.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax

SHARE = 0.6  # of the mappings granted, beyond which programs are to be dropped
OFTEN = 8  # programs after whose making the mappings are counted: that takes some ten milliseconds
_HELD, _GRANTED = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")
_MADE = [0]  # programs since they were counted


def program_made() -> None:
    """Note that a program was made or read."""
    _MADE[0] += 1


def crowded() -> bool:
    """Whether programs were made since the last look and this process holds most of the mappings that it is granted.

    False where the system does not tell.
    """
    if _MADE[0] < OFTEN:
        return False
    _MADE[0] = 0
    try:
        with _HELD.open("rb") as held:
            return sum(1 for _ in held) > SHARE * int(_GRANTED.read_text())
    except (OSError, ValueError):
        return False


def _listen(event: str, *_: Any, **__: Any) -> None:
    if event.endswith("backend_compile_duration"):
        program_made()


jax.monitoring.register_event_duration_secs_listener(_listen)
