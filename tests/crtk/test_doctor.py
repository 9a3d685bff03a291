"""Each fault that can be planted in a served robot is found by the check that it is for, and a healthy one has none."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import trio

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from memory_bus import MemoryBus
from trocar.crtk import bus as bus_module
from trocar.crtk import served_arm
from trocar.crtk import server as server_module
from trocar.crtk.doctor import Verdict, examine_arm
from trocar.crtk.fault_kinds import KINDS
from trocar.crtk.faults import FaultyBus, fault_of
from trocar.crtk.listening import Listener, heard_by, published_by
from trocar.crtk.messages import JointState
from trocar.crtk.server import CrtkServer
from trocar.errors import TrocarError
from trocar.lab import load_station
from trocar.lab.laboratory import build_cell
from trocar.lab.topics import Topics
from trocar.motion import rest_to_rest

STATION, TOPICS = load_station("peg-transfer"), Topics()
ARMS = list(STATION.arms)
SECONDS = 4.0


@pytest.fixture(scope="module")
def tape():
    """Return what a served cell, whose first arm moves, publishes: (time, topic, message)."""
    laboratory, bus, heard = build_cell(STATION, seed=1), MemoryBus(), []

    def now_s():
        return 1.7e9 + laboratory.now_s()

    patched = pytest.MonkeyPatch()
    simulated = SimpleNamespace(time_ns=lambda: int(now_s() * 1e9), time=now_s, perf_counter=now_s)
    for module in (bus_module, server_module, served_arm):
        patched.setattr(module, "time", simulated)
    server, sources = CrtkServer(laboratory, TOPICS, bus=bus), {}
    for arm in ARMS:
        for topic, wanted in published_by(arm, TOPICS).items():
            sources[topic] = bus.subscriber(topic, wanted.kind, latched=wanted.latched)

    async def script(cell):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(server.serve, cell)
            start = cell.robot.setpoint("psm1").q
            goal = start + np.array([0.3, 0.2, -0.02, 0.5, 0.3, 0.3])
            nursery.start_soon(cell.robot.move, {"psm1": rest_to_rest(start, goal, STATION.arms["psm1"].limits)})
            for _ in range(round(SECONDS / 0.01)):
                await cell.clock.sleep(0.01)
                heard.extend((now_s(), topic, message) for topic, one in sources.items() for message in one.take())
            nursery.cancel_scope.cancel()

    laboratory.run(script, SECONDS + 5.0)
    patched.undo()
    return heard


def judged(tape, *faults, verdict=Verdict.FAIL, busy_s=0.0):
    """Return the names of the checks that fail, by arm, where a robot with these faults is heard.

    Once a second, the listener is busy with something for ``busy_s``, an image perhaps.
    """
    robot, clock = MemoryBus(), [tape[0][0]]
    faulty = FaultyBus(robot, [fault_of(text, ARMS) for text in faults], STATION, TOPICS, lambda: clock[0])
    publishers = {}
    for arm in ARMS:
        for topic, wanted in published_by(arm, TOPICS).items():
            publishers[topic] = faulty.publisher(topic, wanted.kind, latched=wanted.latched)
        for topic, kind in heard_by(arm, TOPICS).items():
            robot.subscriber(topic, kind)
    listener, last_s = Listener(MemoryBus(robot.wire, "/doctor"), STATION, TOPICS, ARMS), tape[0][0]
    for at_s, topic, message in tape:
        if at_s != last_s and (last_s - tape[0][0]) % 1.0 >= busy_s:
            listener.take(last_s + 0.0005)
            listener.take(at_s - 0.0005)
        clock[0] = last_s = at_s
        publishers[topic].send(message)
    listener.take(last_s + 0.0005)
    heard = listener.heard()
    checks = {arm: examine_arm(heard, STATION, TOPICS, arm) for arm in ARMS}
    return {arm: [check.name for check in found if check.verdict is verdict] for arm, found in checks.items()}


def test_nothing_is_wrong_with_a_healthy_robot(tape):
    assert judged(tape) == {"psm1": [], "psm2": []}


TIMES = {"gaps", "clock", "latency", "jitter"}


def test_what_a_busy_listener_finds_late_is_not_held_against_the_robot(tape):
    assert judged(tape, busy_s=0.15) == {"psm1": [], "psm2": []}
    passed = judged(tape, busy_s=0.15, verdict=Verdict.PASS)
    assert set(passed["psm1"]) >= TIMES and set(passed["psm2"]) >= TIMES
    late = judged(tape, "psm1:late", busy_s=0.15)
    assert "latency" in late["psm1"] and late["psm2"] == []


def test_a_listener_that_finds_most_messages_late_does_not_judge_when_they_came(tape):
    blind = judged(tape, busy_s=0.8, verdict=Verdict.NONE)
    assert set(blind["psm1"]) >= TIMES and set(blind["psm2"]) >= TIMES


@pytest.mark.parametrize("kind", KINDS)
def test_each_fault_is_found_by_its_check(tape, kind):
    arm, other = ("psm2", "psm1") if kind == "busy" else ("psm1", "psm2")  # an arm that moves may well be busy
    found = judged(tape, f"{arm}:{kind}")
    assert KINDS[kind].found_by in found[arm]
    assert kind == "swapped" or found[other] == [], "the other arm is well"


@pytest.mark.parametrize("what", ["measured_js", "setpoint_js", "jaw/measured_js", "local/measured_cp"])
def test_a_topic_that_falls_silent_while_the_doctor_listens_is_a_gap(tape, what):
    assert judged(tape, f"psm1:silent={what}@2s") == {"psm1": ["gaps"], "psm2": []}


def test_an_arm_that_dies_while_the_doctor_listens_is_not_well(tape):
    dead = [one for one in tape if one[0] < tape[0][0] + 2.0 or one[1].startswith("/PSM2")]
    assert judged(dead) == {"psm1": ["gaps"], "psm2": []}


def test_a_single_message_is_no_rate(tape):
    first = next(one for one in tape if one[1] == "/PSM1/measured_js")
    assert "rate" in judged([one for one in tape if one[1] != first[1] or one is first])["psm1"]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("psm1", "names no arm or no kind"),
        ("psm9:stale", "arm"),
        ("psm1:tired", "kind"),
        ("psm1:slow=fast", "above 0"),
        ("psm1:slow=-1", "above 0"),
        ("psm1:stale=3", "has none"),
    ],
)
def test_a_fault_that_cannot_be_is_told_in_a_sentence(text, says):
    with pytest.raises(TrocarError, match=says):
        fault_of(text, ARMS)


def test_a_fault_has_its_arm_kind_value_and_time():
    fault = fault_of("psm2:slow=5@20s", ARMS)
    assert (fault.arm, fault.kind, fault.value, fault.at_s) == ("psm2", "slow", 5.0, 20.0)
    assert math.isclose(fault_of("psm1:stale", ARMS).at_s, 0.0)


def test_only_those_who_are_named_may_command_and_others_are_counted():
    laboratory, robot = build_cell(STATION, seed=1), MemoryBus()
    server = CrtkServer(laboratory, TOPICS, allowed=["/console"], bus=robot)
    park = STATION.arms["psm1"].park_q()
    goals = {"/console": park + [0.05, 0, 0, 0, 0, 0], "/stranger": park - [0.2, 0, 0, 0, 0, 0]}
    senders = {
        node: MemoryBus(robot.wire, node, address="10.0.0.7").publisher("/PSM1/move_jp", JointState) for node in goals
    }

    async def script(cell):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(server.serve, cell)
            for node, goal in goals.items():
                senders[node].send(JointState(position=goal.tolist()))
            await cell.clock.sleep(2.0)
            nursery.cancel_scope.cancel()

    laboratory.run(script, 10.0)
    assert np.abs(laboratory.driver.setpoint("psm1").q - goals["/console"]).max() < 1e-9
    (count,) = server.refused.values()
    assert count == 1
    refused = [event for event in laboratory.log.events if event["name"] == "refused"]
    assert [event["topic"] for event in refused] == ["/PSM1/move_jp"] and "/stranger" in refused[0]["client"]
