"""The loop of real arms, tick by tick: what goes wrong is named, and brakes the arm within its limits."""

import numpy as np
import pytest

from driven import ARM, HOME, PAPER
from echo_arms import EchoArm
from trocar.cell import MotionEnd
from trocar.errors import ArmMoving, InvalidInput, StartMismatch
from trocar.hardware.arm import ArmFault, DrivenArm, Fault, HardwareReading, LoopSettings
from trocar.hardware.loop import HardwareLoop
from trocar.hardware.messages import Clear, Close, Emergency, Jaw, Reason, Start, Stop
from trocar.motion import move_to, rest_to_rest
from trocar.testing.hardware import PLANTED, FaultyArm

GOAL = HOME + np.array([0.2, 0.15, -0.03, 0.9, 0.5, -0.6])
TICK_S = 0.01
WATCHDOG_S = 60.0
"""A machine that is busy with other things may be silent for seconds."""


class Bench:
    """A loop whose ticks take no time, and what its arms were sent."""

    def __init__(self, plant="", after=8, names=("a",), **settings):
        self.arms = {name: FaultyArm(EchoArm(), plant if name == names[0] else "", after) for name in names}
        self.sent = {name: [HOME.copy()] for name in names}
        tolerated = LoopSettings(watchdog_s=WATCHDOG_S, **settings)
        self.loop = HardwareLoop(dict.fromkeys(names, DrivenArm(ARM, PAPER)), self.connect, tolerated)
        self.reports = []

    def connect(self, name):
        arm, sent, send = self.arms[name], self.sent[name], self.arms[name].send

        def noted(q, velocity, jaw_rad):
            send(q, velocity, jaw_rad)
            sent.append(q.copy())

        arm.send = noted
        return arm

    def say(self, message):
        self.loop.inbox.put(message)

    def tick(self, count=1, late_s=0.0):
        for _ in range(count):
            self.reports.append(self.loop.tick(late_s))
        return self.reports[-1]

    def until_over(self, key, late_s=0.0):
        """Tick until a motion is over; return how it ended."""
        for _ in range(1000):
            for ended, _, ending in self.tick(late_s=late_s).over:
                if ended == key:
                    return ending
        raise AssertionError(f"motion {key} does not end")

    def use(self, name="a"):
        """Return the largest shares of velocity and acceleration limits in what was sent."""
        q = np.array(self.sent[name])
        velocity, acceleration = np.diff(q, axis=0) / TICK_S, np.diff(q, 2, axis=0) / TICK_S**2
        return np.abs(velocity / PAPER.velocity).max(), np.abs(acceleration / PAPER.acceleration).max()

    def at_rest(self, name="a"):
        self.tick(5)
        return np.array_equal(self.sent[name][-1], self.sent[name][-4])


def there(start=HOME, goal=GOAL):
    return rest_to_rest(start, goal, PAPER)


def on_its_way(ticks, *bench, **settings):
    """Return a bench whose first arm has been on its way to the goal for so many ticks."""
    made = Bench(*bench, **settings)
    made.say(Start(1, {"a": there()}))
    for _ in range(ticks):
        made.tick()
    return made


def test_a_motion_is_sent_as_it_was_planned():
    bench = on_its_way(0)
    assert bench.until_over(1).ended is MotionEnd.DONE
    times = TICK_S * np.arange(len(bench.sent["a"]))
    assert np.abs(np.array(bench.sent["a"]) - there()(times)).max() < 1e-12


@pytest.mark.parametrize(
    ("plant", "fault"), [(plant, fault) for plant, fault in PLANTED.items() if plant not in ("send raises", "stall")]
)
def test_a_faulty_arm_brakes_within_its_limits_and_names_the_fault(plant, fault):
    bench = on_its_way(0, plant)
    ending = bench.until_over(1)
    assert ending.ended is MotionEnd.FAULT
    assert isinstance(ending.cause, ArmFault) and (ending.cause.arm, ending.cause.fault) == ("a", fault)
    assert bench.at_rest() and max(bench.use()) <= 1.001
    assert [found.fault for report in bench.reports for found in report.faults].count(fault) == 1
    assert np.abs(bench.sent["a"][-1] - GOAL).max() > 1e-3  # it stopped on the way


def test_an_arm_that_cannot_be_sent_to_gets_nothing_more_and_its_motion_ends():
    bench = on_its_way(0, "send raises")
    ending = bench.until_over(1)
    assert ending.cause.fault is Fault.DEVICE and "no such device" in str(ending.cause)
    count = len(bench.sent["a"])
    bench.say(Clear(("a",)))
    bench.say(Start(2, {"a": there()}))
    assert bench.until_over(2).cause.fault is Fault.DEVICE  # a broken connection is not cleared by a word
    assert len(bench.sent["a"]) == count


def test_encoders_that_freeze_are_noticed_before_the_arm_is_far():
    """A tenth of a second and .05 rad."""
    bench = on_its_way(0, "frozen", after=40)
    bench.until_over(1)
    first = next(report for report in bench.reports if report.faults)
    frozen_at = bench.sent["a"][40]
    assert np.abs(first.arms["a"].sent[:6] - frozen_at)[[0, 1, 3, 4, 5]].max() < 0.05 + 0.12 * PAPER.velocity.max()
    assert first.tick - 40 < 30


def test_one_late_tick_is_forgiven_and_delays_the_motion_but_never_hurries_it():
    bench = on_its_way(20)
    bench.tick(late_s=0.09)
    assert bench.until_over(1).ended is MotionEnd.DONE
    assert max(bench.use()) <= 1.001


def test_a_long_stall_is_a_fault():
    bench = on_its_way(20)
    bench.tick(late_s=0.11)
    assert bench.until_over(1).cause.fault is Fault.LATE
    assert max(bench.use()) <= 1.001


def test_late_ticks_are_a_fault_when_there_are_too_many_in_a_second():
    bench = on_its_way(10, max_late=3)
    bench.tick(3, late_s=0.006)
    assert not bench.reports[-1].faults
    bench.tick(2, late_s=0.004)  # less than half a period is not late
    assert not bench.reports[-1].faults
    assert bench.tick(late_s=0.006).faults[0].fault is Fault.LATE
    assert bench.until_over(1).ended is MotionEnd.FAULT


def test_an_arm_at_rest_does_not_mind_a_late_loop_or_a_silent_script(monkeypatch):
    bench = Bench()
    assert not bench.tick(late_s=5.0).faults
    monkeypatch.setattr("time.monotonic", lambda: 1e9)
    assert not bench.tick().faults


def test_a_script_that_is_silent_for_too_long_is_not_waited_for(monkeypatch):
    bench = on_its_way(10)
    heard_s = bench.loop._heard_s
    monkeypatch.setattr("time.monotonic", lambda: heard_s + WATCHDOG_S + 0.01)
    assert bench.until_over(1).cause.fault is Fault.WATCHDOG
    assert max(bench.use()) <= 1.001


def test_the_end_of_the_scripts_process_stops_all_arms_and_closes_them():
    bench = Bench(names=("a", "b"))
    bench.say(Start(1, {"a": there(), "b": there()}))
    bench.tick(30)
    bench.say(None)
    bench.tick(200)
    assert bench.loop.closed
    assert max(*bench.use("a"), *bench.use("b")) <= 1.001
    assert bench.reports[30].faults[0].fault is Fault.ORPHANED


def test_the_emergency_stop_lasts_until_it_is_cleared():
    bench = on_its_way(30, names=("a", "b"))
    bench.say(Emergency("pressed"))
    assert bench.until_over(1).cause.fault is Fault.EMERGENCY
    bench.say(Start(2, {"b": there()}))
    assert bench.until_over(2).cause.fault is Fault.EMERGENCY
    bench.say(Jaw(3, "b", 0.3))
    assert bench.until_over(3).cause.fault is Fault.EMERGENCY
    bench.say(Clear(()))
    bench.say(Start(4, {"b": there()}))
    assert bench.until_over(4).ended is MotionEnd.DONE
    assert max(*bench.use("a"), *bench.use("b")) <= 1.001


def taking_over(bench, key=2, lead=3):
    """Return a motion back home from where the arm will be in three ticks, as a script asks for it."""
    at = bench.reports[-1].arms["a"].setpoint
    return Start(key, {"a": move_to(at.q, at.velocity, HOME, PAPER)}, bench.reports[-1].tick + lead)


def test_a_motion_takes_over_at_the_tick_for_which_it_was_planned():
    bench = on_its_way(40)
    start = taking_over(bench)
    bench.tick(2)  # it is on its way meanwhile
    bench.say(start)
    assert bench.until_over(1).ended is MotionEnd.REPLACED
    assert bench.until_over(2).ended is MotionEnd.DONE
    assert np.abs(bench.sent["a"][-1] - HOME).max() < 1e-9
    assert max(bench.use()) <= 1.001


def test_a_motion_that_comes_too_late_to_take_over_is_refused_and_the_other_goes_on():
    bench = on_its_way(40)
    start = taking_over(bench)
    bench.tick(4)
    bench.say(start)
    (refused,) = bench.tick().refused
    assert refused[0] == 2 and isinstance(refused[1], StartMismatch)
    assert bench.until_over(1).ended is MotionEnd.DONE


def test_a_stop_drops_what_was_to_take_over():
    bench = on_its_way(40)
    bench.say(taking_over(bench))
    bench.say(Stop(("a",), MotionEnd.HELD, Reason(0)))
    assert [key for key, _ in bench.tick().refused] == [2]
    assert bench.until_over(1).ended is MotionEnd.HELD
    assert bench.at_rest() and max(bench.use()) <= 1.001


def test_a_motion_from_elsewhere_or_of_a_moving_arm_is_refused():
    bench = Bench()
    bench.say(Start(1, {"a": there(GOAL, HOME)}))
    ((_, refusal),) = bench.tick().refused
    assert isinstance(refusal, StartMismatch) and "starts 0.900000 rad (or m) away" in str(refusal)
    bench.say(Start(1, {"a": move_to(HOME, PAPER.velocity / 2, GOAL, PAPER)}))
    ((_, refusal),) = bench.tick().refused
    assert isinstance(refusal, StartMismatch) and "starts with another velocity than its set-point" in str(refusal)
    bench.say(Start(2, {"a": there()}))
    bench.tick(5)
    bench.say(Start(3, {"a": there()}))
    assert isinstance(bench.tick().refused[0][1], ArmMoving)
    assert bench.until_over(2).ended is MotionEnd.DONE


def test_jaws_arrive_and_a_second_goal_replaces_the_first():
    bench = Bench()
    bench.say(Jaw(1, "a", 0.8))
    bench.tick(3)
    bench.say(Jaw(2, "a", 0.2))
    assert bench.until_over(1).ended is MotionEnd.REPLACED
    assert bench.until_over(2).ended is MotionEnd.DONE
    assert bench.arms["a"].read().jaw_rad == pytest.approx(0.2)


def test_jaws_that_are_told_to_stay_do_so_where_they_are_commanded_now():
    bench = Bench()
    bench.say(Jaw(1, "a", 0.8))
    bench.tick(5)
    on_the_way = bench.loop.driver.jaw_command_rad("a")
    bench.say(Jaw(1, "a", None))
    assert bench.until_over(1).ended is MotionEnd.DONE
    bench.tick(20)
    assert 0.1 < on_the_way < 0.7
    assert bench.loop.driver.jaw_command_rad("a") == pytest.approx(on_the_way)


def test_jaws_that_follow_another_command_do_not_stop_for_the_one_before():
    bench = Bench()
    bench.say(Jaw(1, "a", 0.8))
    bench.tick(3)
    bench.say(Jaw(2, "a", 0.2))
    bench.say(Jaw(1, "a", None))
    assert bench.until_over(2).ended is MotionEnd.DONE
    assert bench.loop.driver.jaw_command_rad("a") == pytest.approx(0.2)


def test_an_arm_that_is_elsewhere_than_its_controller_says_is_sent_nothing():
    arm, sent = EchoArm(), []
    arm.read = lambda: HardwareReading(HOME + [0.04, 0, 0.02, 0, 0, 0], 0.1)  # the first is tolerated
    arm.send = lambda *what: sent.append(what)
    with pytest.raises(ArmFault, match=r"sent yet, and 'insertion' reads 0\.0200 m off") as told:
        HardwareLoop({"a": DrivenArm(ARM, PAPER)}, lambda name: arm, LoopSettings())
    assert told.value.fault is Fault.FOLLOWING and not sent


def test_where_arms_are_is_asked_once_all_are_connected():
    """To connect one takes seconds, in which somebody may move another."""
    arms = {"a": EchoArm(), "b": EchoArm()}

    def connect(name):
        if name == "b":
            arms["a"].q = HOME + 0.2
        return arms[name]

    loop = HardwareLoop(dict.fromkeys(arms, DrivenArm(ARM, PAPER)), connect, LoopSettings())
    loop.tick()
    np.testing.assert_allclose(arms["a"].q, HOME + 0.2)


def test_a_loop_that_is_told_to_close_comes_to_rest_first():
    bench = on_its_way(30)
    bench.say(Close())
    assert bench.until_over(1).ended is MotionEnd.HELD
    bench.tick()
    assert bench.loop.closed and max(bench.use()) <= 1.001


def test_a_loop_that_closes_moves_nothing_any_more():
    """It was ended by a signal, of which its script does not know."""
    bench = on_its_way(30)
    bench.say(Close())
    bench.say(Jaw(2, "a", 0.8))
    assert bench.until_over(2).cause.fault is Fault.GONE
    bench.until_over(1)
    bench.tick(2)
    assert bench.loop.closed and bench.arms["a"].read().jaw_rad == pytest.approx(0.1)


def test_arms_that_are_connected_are_closed_if_another_cannot_be():
    arms, closed = {"a": EchoArm()}, []
    arms["a"].close = lambda: closed.append("a")
    with pytest.raises(KeyError, match="b"):
        HardwareLoop(dict.fromkeys("ab", DrivenArm(ARM, PAPER)), arms.__getitem__, LoopSettings())
    assert closed == ["a"]


class InParts(EchoArm):
    """As a Raven: it passes on a little of its set-point at a time."""

    MOST = np.array([2.5e-3, 2.5e-3, 5e-5, 2.5e-3, 2.5e-3, 2.5e-3])
    behind = False

    def send(self, q, velocity, jaw_rad):
        self.q = self.q + np.clip(q - self.q, -self.MOST, self.MOST)
        self.behind = bool(np.abs(q - self.q).max() > 1e-9)
        self.jaw = jaw_rad


@pytest.mark.parametrize("stop", [None, Stop(("a",), MotionEnd.HELD, Reason(7)), Emergency("now")])
def test_motions_wait_for_an_arm_that_takes_set_points_in_parts_and_nothing_is_left_to_come_when_it_stops(stop):
    bench = Bench(names=("a", "b"))
    part = InParts()
    bench.arms["a"] = FaultyArm(part, "", 8)
    bench.loop = HardwareLoop(dict.fromkeys("ab", DrivenArm(ARM, PAPER)), bench.connect, bench.loop.settings)
    bench.say(Start(1, {"a": there(), "b": there()}))
    began = bench.loop._ticks
    for tick in range(2000):
        before = part.q
        if tick == 100 and stop is not None:
            bench.say(stop)
            bench.tick()
            stopped = bench.sent["a"][-1]
        else:
            bench.tick()
        assert (np.abs(part.q - before) <= InParts.MOST + 1e-12).all()
        assert np.allclose(bench.sent["a"][-1], bench.sent["b"][-1]) or stop, "the other arm waits, too"
        if bench.loop.driver.idle("a") and not part.behind:
            break
    assert bench.loop._ticks - began < tick, "motions took longer"
    where = part.q.copy()
    bench.tick(50)
    assert np.array_equal(part.q, where) and np.allclose(where, bench.sent["a"][-1], atol=1e-9)
    if stop is None:
        assert np.allclose(where, GOAL, atol=1e-9)
    else:
        assert 1e-4 < np.abs(where - stopped).max() < 0.2 and np.abs(where - GOAL).max() > 0.01, "it brakes"


def test_a_set_point_beyond_the_limits_is_never_sent():
    """Not even if the package is mistaken: a motion too fast for the limits that no guard has seen."""
    bench = Bench()
    fast = there().stretched(0.4)
    bench.say(Start(1, {"a": fast}))
    assert bench.until_over(1).cause.fault is Fault.STEP
    assert len(bench.sent["a"]) == 1


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"tick_s": 0.0}, "is 0.0 s; give .001 s"),
        ({"tick_s": 1.0}, "is 1.0 s; give .001 s"),
        ({"stale_s": 0.0}, "stale_s of a hardware loop is 0.0; give a finite number above 0"),
        ({"watchdog_s": float("nan")}, "watchdog_s of a hardware loop is nan"),
        ({"lag_s": float("inf")}, "lag_s of a hardware loop is inf; give a finite number above 0"),
        ({"lead_ticks": 0}, "lead_ticks of a hardware loop is 0; give a whole number, 1 or more"),
        ({"max_late": 2.5}, "max_late of a hardware loop is 2.5; give a whole number, 0 or more"),
        ({"max_late": float("nan")}, "max_late of a hardware loop is nan; give a whole number"),
        ({"priority": 100}, "priority of a hardware loop is 100; give a whole number, 0 to 99"),
        ({"priority": -1}, "priority of a hardware loop is -1; give a whole number, 0 to 99"),
    ],
)
def test_settings_are_checked(wrong, says):
    with pytest.raises(InvalidInput, match=says):
        LoopSettings(**wrong)
