"""How long computations take, whatever else a machine does meanwhile, and how fast it is."""

import json
import time
from enum import Enum

import numpy as np
import pytest

from trocar import log
from trocar.log import machine_speed, timed


def busy(seconds):
    begin_s = time.thread_time()
    while time.thread_time() - begin_s < seconds:
        pass


def test_what_computes_takes_its_time_and_what_is_kept_waiting_does_not():
    assert timed(lambda: busy(0.05) or "found") == ("found", pytest.approx(0.05, rel=0.5))
    assert timed(lambda: time.sleep(0.1))[1] < 0.05


def test_what_several_processors_compute_takes_the_time_until_it_is_done(monkeypatch):
    """.1 s by the clock on the wall, .3 s of the processors."""
    wall, processors = iter([5.0, 5.1]), iter([7.0, 7.3])
    monkeypatch.setattr(log.time, "perf_counter", lambda: next(wall))
    monkeypatch.setattr(log.time, "process_time", lambda: next(processors))
    assert timed(lambda: None)[1] == pytest.approx(0.1)


def test_a_process_clock_that_stands_still_hides_no_computation(monkeypatch):
    """Where a process's time is limited, Linux moves its clock only every few milliseconds."""
    monkeypatch.setattr(time, "process_time", lambda: 1.0)
    assert timed(lambda: busy(0.02))[1] == pytest.approx(0.02, rel=0.5)


def test_a_machine_that_needs_twice_as_long_is_half_as_fast_and_is_measured_once(monkeypatch):
    took = iter([9.0, 2.0, *[3.0] * (log.REPEATS - 2)])  # once per process: a second measurement would find no more
    machine_speed.cache_clear()
    assert 0.01 < machine_speed() < 100
    machine_speed.cache_clear()
    monkeypatch.setattr(log, "timed", lambda function: (None, next(took) * log.REFERENCE_S))
    assert machine_speed() == machine_speed() == pytest.approx(0.5), "the quickest of several counts"
    machine_speed.cache_clear()


def test_a_span_is_begun_until_it_has_ended_however_it_ends():
    now_s = iter(range(9))
    kept = log.CellLog(lambda: float(next(now_s)))
    with kept.span("psm1", "grasp"):
        with pytest.raises(KeyError), kept.span("psm1", "motion"):
            assert kept.begun == [("psm1", "grasp", 0.0), ("psm1", "motion", 1.0)]
            raise KeyError
        assert kept.begun == [("psm1", "grasp", 0.0)]
    assert not kept.begun
    assert kept.spans == [log.Span("psm1", "motion", 1.0, 2.0), log.Span("psm1", "grasp", 0.0, 3.0)]


def test_whatever_a_script_notes_can_be_saved():
    """A trial of real arms cannot be run again because somebody noted a NumPy number."""

    class Grip(Enum):
        FIRM = 1

    kept = log.CellLog(lambda: 2.0)
    kept.event("grasp", found=np.bool_(True), angle_rad=np.float32(0.5), count=np.int64(3), gap_m=float("nan"))
    kept.event("grasp", at_m=np.array([0.1, np.inf]), grip=Grip.FIRM, seen={"a": (1, np.float64(2.0))}, plain=(1, "b"))
    one, other = json.loads(json.dumps(kept.events, allow_nan=False))
    assert one == {"name": "grasp", "time_s": 2.0, "found": True, "angle_rad": 0.5, "count": 3, "gap_m": None}
    assert other["at_m"] == [0.1, None] and other["grip"] == "Grip.FIRM" and other["seen"] == {"a": [1, 2.0]}
    assert kept.events[1]["plain"] == (1, "b"), "what JSON can hold stays as it is"
