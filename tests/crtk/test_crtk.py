"""A simulated cell that speaks CRTK, and arms that are driven over it, in processes of their own."""

import os
import re
import subprocess
import sys
import threading
import time
from functools import partial

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from crtk_partners import DOMAIN, said
from crtk_partners import served as serving
from trocar.arms import MotionLimits
from trocar.cli.crtk import doctor
from trocar.crtk.arm import CrtkArm
from trocar.crtk.bus import open_bus, stamped
from trocar.crtk.doctor import Verdict, examine_arm
from trocar.crtk.listening import Listener, listen
from trocar.crtk.messages import Empty, JointState, OperatingState, PoseStamped, StringStamped
from trocar.errors import InvalidInput
from trocar.hardware import HardwareLaboratory
from trocar.hardware.arm import LoopSettings
from trocar.lab import load_station
from trocar.lab.topics import Topics
from trocar.testing import check_robot

pytestmark = pytest.mark.realtime
STATION = load_station("peg-transfer")
ARM = STATION.arms["psm1"]
TOPICS = Topics(domain=DOMAIN, loop={"stale_s": 5.0})  # a busy machine is slow
PATIENT = LoopSettings(max_late=10_000, max_stall_s=60.0, watchdog_s=60.0, stale_s=5.0, lag_s=1.0)
"""A machine that runs other tests beside this one may be late."""


@pytest.fixture
def served():
    with serving("--domain", str(DOMAIN)) as cell:
        yield cell


@pytest.fixture(scope="module")
def bus():
    return open_bus(TOPICS)


class Client:
    """What any program would publish and subscribe to for one arm."""

    def __init__(self, bus, topic="/PSM1"):
        self.out = {
            name: bus.publisher(f"{topic}/{name}", JointState) for name in ("servo_jp", "move_jp", "jaw/move_jp")
        }
        self.out["move_cp"] = bus.publisher(f"{topic}/move_cp", PoseStamped)
        self.out["state_command"] = bus.publisher(f"{topic}/state_command", StringStamped)
        self.out["hold"] = bus.publisher(f"{topic}/hold", Empty)
        kinds = {"measured_js": JointState, "setpoint_js": JointState, "jaw/measured_js": JointState}
        kinds |= {"measured_cp": PoseStamped, "local/measured_cp": PoseStamped}
        self.came = {name: bus.subscriber(f"{topic}/{name}", kind) for name, kind in kinds.items()}
        self.came["operating_state"] = bus.subscriber(f"{topic}/operating_state", OperatingState, latched=True)

    def last(self, name):
        self.came[name].take()
        return self.came[name].last

    def until(self, holds, limit_s=60.0):
        end_s = time.monotonic() + limit_s
        while time.monotonic() < end_s:
            for source in self.came.values():
                source.take()
            if all(source.last is not None for source in self.came.values()) and holds():
                return
            time.sleep(0.01)
        raise AssertionError("it does not come to that")

    def q(self, name="setpoint_js"):
        return np.array(self.last(name).position)


@pytest.fixture
def client(bus, served):
    client = Client(bus)
    client.until(lambda: True)
    return client


def test_an_arm_over_the_network_keeps_the_promises_of_a_robot(served, client):
    slow = MotionLimits(ARM.limits.velocity / 4, ARM.limits.acceleration / 8)
    with HardwareLaboratory(STATION, partial(CrtkArm, topics=TOPICS), PATIENT) as laboratory:
        assert laboratory.run(lambda cell: check_robot(cell, "psm1", limits=slow), 120.0)
        assert max(laboratory.robot.limit_use("psm1")) <= 1.001
    end = said(served)
    assert end["received"]["psm1"] > 100 and max(end["limit_use"]["psm1"]) <= 1.001


def ended_with(verdict, checks):
    return {(check["of"], check["name"]) for check in checks if check["verdict"] == verdict}


def test_the_doctor_finds_an_arm_that_jitters_and_one_that_is_late(bus):
    judged, wanted, deadline_s = set(), {("psm1", "jitter"), ("psm2", "latency")}, time.monotonic() + 120.0
    with serving("--domain", str(DOMAIN), "--fault", "psm1:jittery", "--fault", "psm2:late") as cell:
        while not judged >= wanted and time.monotonic() < deadline_s:
            checks = doctor("peg-transfer", domain=DOMAIN).summary["checks"]
            judged = ended_with("pass", checks) | ended_with("fail", checks)
        said(cell)
    assert wanted <= ended_with("fail", checks)


def test_a_doctor_who_is_held_up_does_not_blame_a_healthy_robot(served, client, bus):
    listener, found = Listener(bus, STATION, TOPICS, list(STATION.arms)), []

    def give_way_and_listen():
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), 10)
        found.append(listen(listener, 5.0))

    burning = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(3 * (os.cpu_count() or 1))]
    try:
        thread = threading.Thread(target=give_way_and_listen)
        thread.start()
        thread.join()
    finally:
        for one in burning:
            one.kill()
            one.wait()
    checks = [check for arm in STATION.arms for check in examine_arm(found[0], STATION, TOPICS, arm)]
    times = [check for check in checks if check.name in ("gaps", "latency", "jitter")]
    assert [check.verdict for check in times] == 6 * [Verdict.NONE]
    # busy, or too slow: it found most messages late
    assert all("this machine is" in check.found for check in times), [check.found for check in times]
    assert ("clock", Verdict.FAIL) not in [(check.name, check.verdict) for check in checks]


def test_streamed_set_points_are_reached_and_counted(served, client):
    start = client.q()
    for k in range(200):
        q = start + np.array([0.05, 0.02, 0.002, 0.1, 0.05, 0.05]) * np.sin(k / 30)
        client.out["servo_jp"].send(JointState(stamped(), [], q.tolist()))
        time.sleep(0.01)
    client.until(lambda: np.abs(client.q() - q).max() < 1e-9)
    assert np.abs(client.q("measured_js") - q).max() < 1e-6  # encoders are on the commanded side of the cables
    end = said(served)
    assert end["received"]["psm1"] == 200 and end["received"]["psm2"] == 0


def test_a_jump_is_followed_within_the_limits_and_noted(served, client):
    start = client.q()
    goal = start + [0.5, 0, 0, 0, 0, 0]
    client.out["servo_jp"].send(JointState(stamped(), [], goal.tolist()))
    client.until(lambda: np.abs(client.q() - goal).max() < 1e-9)
    end = said(served)
    assert max(end["limit_use"]["psm1"]) == pytest.approx(1.0)
    (event,) = [event for event in end["events"] if event["name"] == "servo"]
    assert event["arm"] == "psm1" and event["share"] == pytest.approx(0.5 / (ARM.limits.velocity[0] * 0.01), rel=1e-3)


def test_hold_stops_a_motion_half_way(client):
    start = client.q()
    client.out["move_jp"].send(JointState(stamped(), [], (start + [0.4, 0, 0, 0, 0, 0]).tolist()))
    client.until(lambda: client.q()[0] > start[0] + 0.05)
    client.out["hold"].send(Empty())
    client.until(lambda: not client.came["operating_state"].last.is_busy)
    assert start[0] + 0.05 < client.q()[0] < start[0] + 0.39


def test_a_paused_arm_obeys_nothing_until_it_is_resumed_and_refuses_words_out_of_order(served, client):
    start = client.q()
    for word in ("pause", "enable", "dance"):
        client.out["state_command"].send(StringStamped(stamped(), word))
    client.until(lambda: client.came["operating_state"].last.state == "PAUSED")
    client.out["servo_jp"].send(JointState(stamped(), [], (start + 0.01).tolist()))
    with pytest.raises(InvalidInput, match=re.escape("CRTK arm 'psm1' is PAUSED, homed; enable and home it")):
        CrtkArm("psm1", TOPICS)
    assert np.array_equal(client.q(), start)
    client.out["state_command"].send(StringStamped(stamped(), "resume"))
    client.until(lambda: client.came["operating_state"].last.state == "ENABLED")
    refused = [event["reason"] for event in said(served)["events"] if event["name"] == "refused"]
    assert refused == ["'enable' does nothing when PAUSED", "'dance' does nothing when PAUSED"]
