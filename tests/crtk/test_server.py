"""The clock of a served robot, and what it tells of its ticks."""

from types import SimpleNamespace

import numpy as np
import pytest
import trio

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from memory_bus import MemoryBus
from trocar.crtk import bus as bus_module
from trocar.crtk import served_arm
from trocar.crtk import server as server_module
from trocar.crtk.convert import seconds
from trocar.crtk.messages import IntervalStatistics, JointState
from trocar.crtk.server import CrtkServer, Periods
from trocar.lab import load_station
from trocar.lab.laboratory import build_cell
from trocar.lab.topics import Topics

SECONDS, STALL_AT_S = 2.0, 1.0


@pytest.mark.parametrize(("stall_s", "hurries"), [(0.08, True), (0.12, True), (0.3, False)])
def test_stamps_go_on_and_are_never_ahead_after_a_stall_that_ticks_catch_up_with_or_do_not(
    stall_s, hurries, monkeypatch
):
    laboratory, bus, heard = build_cell(load_station("peg-transfer"), seed=1), MemoryBus(), []

    def machine_s():
        at_s = laboratory.now_s()
        after_s = max(at_s, STALL_AT_S + stall_s) if hurries else at_s + stall_s
        return 1.7e9 + (after_s if at_s > STALL_AT_S else at_s)

    simulated = SimpleNamespace(time_ns=lambda: int(machine_s() * 1e9), time=machine_s, perf_counter=machine_s)
    for module in (bus_module, server_module, served_arm):
        monkeypatch.setattr(module, "time", simulated)
    server, source = CrtkServer(laboratory, Topics(), bus=bus), bus.subscriber("/PSM1/measured_js", JointState)

    async def script(cell):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(server.serve, cell)
            while cell.clock.now_s() < SECONDS:
                heard.extend((machine_s(), seconds(message.header.stamp)) for message in source.take())
                await cell.clock.sleep(0.01)
            nursery.cancel_scope.cancel()

    laboratory.run(script, SECONDS + 1.0)
    at_s, stamps_s = np.array(heard).T
    assert len(stamps_s) > 0.9 * SECONDS / 0.01
    assert (np.diff(stamps_s) > 0).all()
    assert (stamps_s - at_s).max() < 0.01
    assert abs(stamps_s[-1] - at_s[-1]) < 0.011


def test_each_second_of_ticks_is_told_to_those_who_listen(monkeypatch):
    clock = SimpleNamespace(now_s=0.0)
    monkeypatch.setattr(server_module, "time", SimpleNamespace(perf_counter=lambda: clock.now_s))
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
