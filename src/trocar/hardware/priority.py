"""Real-time priority for threads that must not be late, where the system permits it."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

PRIORITY = 10
"""Under Linux's real-time scheduler: above ordinary processes, below the system's own threads there."""
HIGHEST = 99
THREADS = Path("/proc/self/task")


@contextlib.contextmanager
def ahead_of_others(priority: int = PRIORITY) -> Iterator[bool]:
    """Give all threads of this process, and those they start, real-time priority; yield whether they have it.

    Nothing changes where this is not permitted (it takes root, or an ``rtprio`` limit) or there is no such scheduler.

    Args:
        priority: from 1 to ``HIGHEST``; 0: change nothing.
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
