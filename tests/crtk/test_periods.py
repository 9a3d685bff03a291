"""What is told of the ticks is what was measured, once a second, on each arm's topic."""

from types import SimpleNamespace

import pytest

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from memory_bus import MemoryBus
from trocar.crtk import periods as module
from trocar.crtk.messages import IntervalStatistics
from trocar.crtk.periods import Periods


def test_each_second_of_ticks_is_told_to_those_who_listen(monkeypatch):
    clock = SimpleNamespace(now_s=0.0)
    monkeypatch.setattr(module, "time", SimpleNamespace(perf_counter=lambda: clock.now_s))
    bus = MemoryBus()
    heard = [bus.subscriber(f"/{arm}/period_statistics", IntervalStatistics) for arm in ("PSM1", "PSM2")]
    periods, clock.now_s = Periods(bus, ["/PSM1", "/PSM2"]), 5.0
    with periods.tick():
        pass  # nothing is known of the time before the first
    unit_s = 1 / 1024  # so that sums are exact
    for number in range(256):  # 128 ticks a second; one of the second second works for too long
        clock.now_s += (7 if number % 2 else 9) * unit_s
        worked_s = (10 if number == 150 else 2) * unit_s
        with periods.tick():
            clock.now_s += worked_s
        clock.now_s -= worked_s
    first, second = heard[0].take()
    assert [told.number_of_samples for told in (first, second)] == [128, 128] and len(heard[1].take()) == 2
    times = (first.period_avg, first.period_std_dev, first.period_min, first.period_max, first.statistics_interval)
    assert times == pytest.approx((8 * unit_s, unit_s, 7 * unit_s, 9 * unit_s, 1.0))
    assert (first.compute_time_avg, first.compute_time_std_dev) == pytest.approx((2 * unit_s, 0.0), abs=1e-9)
    assert (second.compute_time_min, second.compute_time_max) == pytest.approx((2 * unit_s, 10 * unit_s))
    assert (first.number_of_overruns, second.number_of_overruns) == (0, 1)
