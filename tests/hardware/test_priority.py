"""Threads of a process that come before others, where that is permitted."""

import os
import threading
from pathlib import Path

import pytest

from trocar.hardware import priority
from trocar.hardware.priority import PRIORITY, ahead_of_others


def policies():
    """Return the scheduling of all threads of this process."""
    return {os.sched_getscheduler(int(thread.name)) for thread in Path("/proc/self/task").iterdir()}


@pytest.mark.skipif(not hasattr(os, "sched_setscheduler"), reason="no real-time scheduler on this system")
def test_all_threads_come_first_and_then_no_longer():
    waits = threading.Event()
    thread = threading.Thread(target=waits.wait)
    thread.start()
    try:
        with ahead_of_others() as permitted:
            if not permitted:
                pytest.skip("this user may not use the real-time scheduler")
            assert policies() == {os.SCHED_FIFO}
            assert os.sched_getparam(0).sched_priority == PRIORITY
        assert policies() == {os.SCHED_OTHER}
    finally:
        waits.set()
        thread.join()


def test_nothing_changes_where_it_is_not_permitted(monkeypatch):
    def refused(*_):
        raise PermissionError

    monkeypatch.setattr(priority.os, "sched_setscheduler", refused, raising=False)
    before = policies()
    with ahead_of_others() as permitted:
        assert not permitted and policies() == before


def test_priority_0_is_ordinary():
    with ahead_of_others(0) as permitted:
        assert not permitted and os.SCHED_FIFO not in policies()
