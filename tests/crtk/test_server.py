"""The clock of a served robot."""

from types import SimpleNamespace

import numpy as np
import pytest

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

STALL_S, STALLS_AT_S, SECONDS = 0.1, 1.0, 2.0


def test_stamps_go_on_while_the_ticks_catch_up_after_a_stall(monkeypatch):
    laboratory, bus = build_cell(load_station("peg-transfer"), seed=1), MemoryBus()

    def machine_s():
        at_s = laboratory.now_s()
        return 1.7e9 + (max(at_s, STALLS_AT_S + STALL_S) if at_s > STALLS_AT_S else at_s)

    simulated = SimpleNamespace(time_ns=lambda: int(machine_s() * 1e9), time=machine_s)
    for module in (bus_module, server_module, served_arm):
        monkeypatch.setattr(module, "time", simulated)
    server, heard = CrtkServer(laboratory, Topics(), bus=bus), bus.subscriber("/PSM1/measured_js", JointState)
    laboratory.run(server.serve, SECONDS)
    stamps_s = np.array([seconds(message.header.stamp) for message in heard.take()])
    assert len(stamps_s) > 0.9 * SECONDS / 0.01
    assert (np.diff(stamps_s) > 0).all()
    assert np.diff(stamps_s).max() > STALL_S / 2, "it was late once"
    assert abs(stamps_s[-1] - machine_s()) < 0.05
