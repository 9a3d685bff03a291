"""The clock of a served robot."""

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
from trocar.crtk.messages import JointState
from trocar.crtk.server import CrtkServer
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

    simulated = SimpleNamespace(time_ns=lambda: int(machine_s() * 1e9), time=machine_s)
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
