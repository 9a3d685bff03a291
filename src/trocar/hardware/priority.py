"""Real-time priority, where the system permits it: what must not be late comes before what may wait."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

PRIORITY = 10
"""Under Linux's real-time scheduler: before everything ordinary, behind what the system itself runs there."""
THREADS = Path("/proc/self/task")


@contextlib.contextmanager
def ahead_of_others(priority: int = PRIORITY) -> Iterator[bool]:
    """Run all threads of this process before ordinary ones, those that they start included; yield whether they do.

    Where that is not permitted (it takes root, or an ``rtprio`` limit), or there is no such scheduler, nothing changes.

    Args:
        priority: from 1 to 99; 0: change nothing.
    """
    permitted = priority > 0 and hasattr(os, "sched_setscheduler") and _schedule(os.SCHED_FIFO, priority)
    try:
        yield permitted
    finally:
        if permitted:
            _schedule(os.SCHED_OTHER, 0)


def _schedule(policy: int, priority: int) -> bool:
    """Change the scheduling of all threads; return whether that is permitted."""
    for thread in [int(entry.name) for entry in THREADS.iterdir()]:
        try:
            os.sched_setscheduler(thread, policy, os.sched_param(priority))
        except ProcessLookupError:
            continue  # it has ended meanwhile
        except OSError:
            return False
    return True
