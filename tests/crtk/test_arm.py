"""What is wrong with a live arm is told by its kind, and nothing more is sent to it then."""

import re
import time
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from crtk_partners import DOMAIN, LIMIT_S, controlled, served, until
from memory_bus import MemoryBus
from trocar.crtk.arm import HEARD_S, CrtkArm
from trocar.crtk.bus import open_bus, stamped
from trocar.crtk.dialect import PSM_JOINTS
from trocar.crtk.messages import Bool, Empty, Header, JointState, PoseStamped, StringStamped, TwistStamped
from trocar.errors import InvalidInput
from trocar.hardware.arm import ArmFault, Fault, LoopSettings
from trocar.lab import load_station
from trocar.lab.topics import Command, Dialect, Topics

pytestmark = pytest.mark.realtime
PARK = load_station("peg-transfer").arms["psm1"].park_q()
STALE_S = LoopSettings.stale_s


def controller(domain=DOMAIN):
    return controlled("crtk-1.0", [*PARK, 0.3], domain=domain)


def connected(dialect=Dialect.CRTK_1_0):
    arm = CrtkArm("psm1", Topics(domain=DOMAIN, dialect=dialect, loop={"stale_s": 5.0}))  # a busy machine is slow
    arm.commanded()
    return arm


def enabled():
    """Enable the served arm, which a test before this one may have paused or moved, and connect it when it rests."""
    state = open_bus(Topics(domain=DOMAIN)).publisher("/PSM1/state_command", StringStamped)
    arms = []

    def connects():
        state.send(StringStamped(stamped(), "resume"))
        try:
            arms.append(connected(Dialect.DVRK))
        except InvalidInput:  # it is not there yet, or not resumed
            return False
        return True

    def rests():
        before = arms[0].commanded()[0]
        time.sleep(0.1)
        return np.array_equal(arms[0].commanded()[0], before)

    until(connects)
    until(rests)
    return arms[0]


def sent_by(arm):
    """Return what is sent to an arm from now on, which its controller does not hear."""
    bus = MemoryBus()
    arm._out = bus.publisher("/seen/servo_jp", JointState)
    return bus.subscriber("/seen/servo_jp", JointState)


def fault_of(arm, meanwhile=lambda: None):
    """Read until the arm tells what is wrong."""
    end_s = time.monotonic() + LIMIT_S
    while time.monotonic() < end_s:
        meanwhile()
        try:
            arm.read()
        except ArmFault as error:
            return error
        time.sleep(0.01)
    raise AssertionError("it tells nothing")


@pytest.mark.parametrize(
    ("says", "fault", "detail"),
    [
        ("PAUSED 1", Fault.PAUSED, "/PSM1/operating_state is PAUSED"),
        ("DISABLED 1", Fault.DISABLED, "/PSM1/operating_state is DISABLED"),
        ("FAULT 1", Fault.CONTROLLER, "/PSM1/operating_state is FAULT"),
        ("ENABLED 0", Fault.UNHOMED, ""),
    ],
)
def test_what_its_controller_is_stops_it_for_good(says, fault, detail):
    with controller() as running:
        arm = connected()
        arm.read()
        sent = open_bus(Topics(domain=DOMAIN)).subscriber("/PSM1/servo_jp", JointState)
        until(lambda: arm.send(PARK, np.zeros(6), 0.3) or sent.take())
        running.stdin.write(f"{says}\n")
        running.stdin.flush()
        found = fault_of(arm)
        assert (found.fault, found.detail) == (fault, detail)
        sent.take()
        running.stdin.write("ENABLED 1\n")
        running.stdin.flush()
        until(lambda: arm._take() or (arm._state.last.state, arm._state.last.is_homed) == ("ENABLED", True))
        assert fault_of(arm) is found, "it stays stopped"
        arm.send(PARK, np.zeros(6), 0.3)
        again = open_bus(Topics(domain=DOMAIN)).publisher("/PSM1/servo_jp", JointState)
        again.send(JointState(stamped(), ["marker"], []))
        come = []
        until(lambda: come.extend(sent.take()) or come)
        assert [message.name for message in come] == [["marker"]], "nothing was sent"


def test_an_arm_that_does_not_listen_to_what_it_would_be_sent_is_not_connected():
    alone = DOMAIN + 1  # connections of the tests before this one subscribe to what others send
    topics = Topics(domain=alone, dialect=Dialect.CRTK_1_0, command=Command.MOVE)
    deaf = "'psm1' does not subscribe to /PSM1/move_jp and /PSM1/jaw/move_jp within"
    with controller(domain=alone), pytest.raises(InvalidInput, match=re.escape(deaf)):
        CrtkArm("psm1", topics)


def test_an_arm_whose_readings_two_robots_publish_is_not_connected():
    alone = DOMAIN + 2
    with controller(domain=alone), controller(domain=alone):
        reads = open_bus(Topics(domain=alone)).subscriber("/PSM1/measured_js", JointState)
        senders = set()
        until(lambda: (reads.take() and senders.update(reads.sent_by)) or len(senders) == 2)
        with pytest.raises(
            InvalidInput, match=r"'psm1' has its readings published by process \d+ .* and by process \d+"
        ):
            CrtkArm("psm1", Topics(domain=alone, dialect=Dialect.CRTK_1_0))


def test_an_arm_whose_controller_ends_is_lost():
    with controller() as running:
        arm = connected()
        arm.read()
        running.terminate()
        assert fault_of(arm).fault is Fault.LOST


@pytest.mark.parametrize(
    ("topic", "message"),
    [
        ("state_command", StringStamped(stamped(), "pause")),
        ("hold", Empty()),
        ("servo_jp", JointState(stamped(), [], PARK.tolist())),
        ("move_jp", JointState(stamped(), [], PARK.tolist())),
        ("servo_cp", PoseStamped(stamped())),
        ("jaw/move_jp", JointState(stamped(), [], [0.3])),
        ("use_gravity_compensation", Bool(True)),
        ("servo_cv", TwistStamped(stamped())),
    ],
)
def test_an_arm_that_somebody_else_commands_says_on_which_topic(topic, message, cell):
    arm = enabled()
    other = open_bus(Topics(domain=DOMAIN)).publisher(f"/PSM1/{topic}", type(message))
    until(lambda: other.readers() >= 2)  # the cell and the arm's connection
    other.send(message)
    found = fault_of(arm, lambda: arm.send(PARK, np.zeros(6), 0.3))
    said = f"/PSM1/{topic}, 'pause'" if topic == "state_command" else f"/PSM1/{topic}"
    assert (found.fault, found.detail) == (Fault.OTHERS, said)


@pytest.fixture(scope="module")
def cell():
    with served("--domain", str(DOMAIN), "--images-hz", "0") as running:
        yield running


@pytest.mark.parametrize(("joints", "jaw"), [(0.02, 0.0), (0.0, 0.1)])
def test_a_controller_that_does_not_hold_what_was_sent_is_named_although_the_readings_are_near(joints, jaw, cell):
    arm = enabled()
    q, jaw_rad = arm.commanded()
    arm._out = arm._jaw_out = MemoryBus().publisher("/lost/servo_jp", JointState)  # a network that loses what is sent
    goal, fresh_s = q + [joints, 0, 0, 0, 0, 0], time.monotonic()
    found = fault_of(arm, lambda: arm.send(goal, np.zeros(6), jaw_rad + jaw))
    assert found.fault is Fault.FOLLOWING and "/PSM1/setpoint_js is off" in found.detail
    assert time.monotonic() - fresh_s > HEARD_S


@pytest.mark.parametrize("which", ["_setpoint", "_jaw_setpoint"])
def test_a_controller_that_no_longer_tells_what_it_holds_is_lost_although_the_encoders_are_read(which, cell):
    arm = enabled()
    silent, told = MemoryBus().subscriber("/PSM1/setpoint_js", JointState), getattr(arm, which)
    silent.last, silent.at_s = told.last, told.at_s - 10.0
    setattr(arm, which, silent)
    found = fault_of(arm)
    assert found.fault is Fault.LOST and "/PSM1/setpoint_js or the jaws', for 10." in found.detail


@pytest.mark.parametrize("which", ["_setpoint", "_jaw_setpoint"])
def test_a_controller_that_says_that_it_holds_no_position_is_named_although_the_encoders_are_read(which, cell):
    """CRTK: a stamp of 0 says "not available", as where the controller drives its motors by efforts."""
    arm = enabled()
    told, bus = getattr(arm, which), MemoryBus()
    invalid = bus.subscriber("/PSM1/setpoint_js", JointState)
    invalid.last = JointState(Header(), told.last.name, told.last.position)
    invalid.at_s = time.monotonic() + 60.0  # it goes on telling so
    setattr(arm, which, invalid)
    found = fault_of(arm)
    assert found.fault is Fault.FOLLOWING and "/PSM1/setpoint_js or the jaws' tells no valid position" in found.detail


def test_an_arm_that_was_not_heard_of_for_long_is_not_taken_back_when_it_is(cell):
    arm = enabled()
    q, jaw_rad = arm.commanded()
    seen = sent_by(arm)
    arm._cut_s, take, arm._take = STALE_S, arm._take, lambda: None  # a network that is cut
    begin_s, last_s = time.monotonic(), 0.0
    while time.monotonic() < begin_s + HEARD_S:
        with suppress(ArmFault):
            arm.read()
        arm.send(q, np.zeros(6), jaw_rad)
        last_s = time.monotonic() - begin_s if seen.take() else last_s
        time.sleep(0.01)
    assert 0 < last_s < STALE_S + 0.05, "it goes on for a tenth of a second"
    for _ in range(20):
        arm.send(q, np.zeros(6), jaw_rad)
    assert not seen.take()
    arm._take = take
    found = fault_of(arm, lambda: arm.send(q, np.zeros(6), jaw_rad))
    assert found.fault is Fault.STALE and not seen.take()


def test_an_arm_that_was_moved_while_this_process_stood_still_is_not_taken_back(cell):
    """As by a dVRK's teleoperation, which no topic tells."""
    arm = enabled()
    q, jaw_rad = arm.commanded()
    for _ in range(30):
        arm.send(q, np.zeros(6), jaw_rad)
        arm.read()
        time.sleep(0.01)
    seen = sent_by(arm)
    arm._others.clear()
    other = open_bus(Topics(domain=DOMAIN)).publisher("/PSM1/move_jp", JointState)
    until(other.readers)
    moved = open_bus(Topics(domain=DOMAIN)).subscriber("/PSM1/setpoint_js", JointState)
    other.send(JointState(stamped(), [], (q + [0.1, 0, 0, 0, 0, 0]).tolist()))
    until(lambda: moved.take() and abs(moved.last.position[0] - q[0] - 0.1) < 1e-6)
    time.sleep(0.3)
    arm.send(q, np.zeros(6), jaw_rad)
    assert not seen.take(), "it looks before it sends"
    assert fault_of(arm).fault is Fault.FOLLOWING
    arm.send(q, np.zeros(6), jaw_rad)
    assert not seen.take()


def test_an_arm_that_a_person_moves_by_its_clutch_is_let_go(cell):
    arm = enabled()
    q, jaw_rad = arm.commanded()
    arm.read()
    arm._state.last = replace(arm._state.last, is_busy=True)
    assert fault_of(arm).fault is Fault.OTHERS
    seen = sent_by(arm)
    arm.send(q, np.zeros(6), jaw_rad)
    assert not seen.take()


def test_joints_are_sent_in_the_order_in_which_the_controller_has_them(cell):
    arm = enabled()
    q, jaw_rad = arm.commanded()
    seen = sent_by(arm)
    arm._names = tuple(reversed(PSM_JOINTS))
    arm.send(q, np.zeros(6), jaw_rad)
    (message,) = seen.take()
    assert message.name == list(reversed(PSM_JOINTS)) and message.position == list(reversed(q.tolist()))


def test_a_controller_that_holds_what_was_sent_a_little_later_is_well(cell):
    arm = enabled()
    q, jaw_rad = arm.commanded()
    for _ in range(2):
        goal, end_s = q + [0.02, 0, 0, 0, 0, 0], time.monotonic() + 2 * HEARD_S
        while time.monotonic() < end_s:
            arm.send(goal, np.zeros(6), jaw_rad + 0.1)
            arm.read()
            time.sleep(0.01)
        q, jaw_rad = arm.commanded()


def test_its_own_commands_are_not_somebody_elses(cell):
    arm, end_s = enabled(), time.monotonic() + 1.0
    q, jaw_rad = arm.commanded()
    while time.monotonic() < end_s:
        arm.send(q, np.zeros(6), jaw_rad)
        arm.read()
        time.sleep(0.01)
