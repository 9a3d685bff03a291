"""Jaws whose cable has play, driven by an encoder at their motor."""

from contextlib import nullcontext

import numpy as np
import pytest
import trio
import trio.testing

from trocar.cell import Cell
from trocar.lab.transmission import JawCable
from trocar.tasks.peg_transfer.agents.hand import PegHand

PLAY_RAD = 0.03


class Jaws:
    """A robot that is nothing but a pair of jaws, which a stop keeps from closing further."""

    def __init__(self):
        self.cable, self.followed, self.commanded, self.stop = JawCable(0.02, PLAY_RAD), 0.5, 0.5, 0.0

    @property
    def fingers_rad(self):
        return max(self.followed, self.stop)

    async def jaw(self, _, angle_rad):
        for commanded in np.linspace(self.commanded, angle_rad, 50):
            _, self.followed = self.cable.step(self.followed, commanded)
        self.commanded = angle_rad

    def read(self, _):
        return type("Reading", (), {"jaw_rad": self.cable.read(self.fingers_rad + 0.02, self.commanded)})


@pytest.fixture
def hand(monkeypatch):
    jaws = Jaws()
    cell = Cell.__new__(Cell)
    for name, value in {"robot": jaws, "arms": {"a": None}}.items():
        object.__setattr__(cell, name, value)
    hand = PegHand(cell, "a", 0.0, jaw_play_rad=2 * PLAY_RAD)
    trio.run(hand.drive_jaw, -0.2)
    hand.jaw_zero_rad = hand.jaw_rad
    return hand, jaws


@pytest.mark.parametrize("told", [[0.36], [0.2, 0.3, 0.36], [0.45, 0.36], [0.45, 0.2, 0.36], [0.36, 0.36]])
def test_fingers_open_as_far_as_they_are_told_whatever_came_before(hand, told):
    hand, jaws = hand
    for angle_rad in told:
        trio.run(hand.drive_jaw, angle_rad)
    assert jaws.fingers_rad == pytest.approx(0.36, abs=1e-9) and hand.jaw_rad == pytest.approx(0.36, abs=1e-9)


def test_a_wall_is_read_as_thick_as_it_is_and_let_go_by_as_much_as_asked(hand):
    hand, jaws = hand
    trio.run(hand.drive_jaw, 0.36)
    jaws.stop = 0.21
    trio.run(hand.drive_jaw, -0.2)
    assert hand.jaw_rad == pytest.approx(0.21, abs=1e-9)
    trio.run(hand.drive_jaw, hand.jaw_rad + 0.14)
    assert jaws.fingers_rad == pytest.approx(0.35, abs=1e-9) and hand.jaw_rad == pytest.approx(0.35, abs=1e-9)


class Fingers(Jaws):
    """The same jaws over time: 6 rad/s, then .05 s of rest; a person stops them at an opening, if one is given."""

    def __init__(self):
        super().__init__()
        self.asked, self.held_rad = [], None

    async def jaw(self, _, angle_rad):
        self.asked.append(angle_rad)
        way_rad = angle_rad - self.commanded
        for commanded in np.linspace(self.commanded, angle_rad, 1 + int(np.ceil(abs(way_rad) / 0.06)))[1:]:
            await trio.sleep(0.01)
            await super().jaw("a", commanded)
            if self.held_rad is not None and commanded < self.held_rad:
                for share in 1 - 0.6 ** np.arange(1, 30):  # the fingers come to rest as fast as a servo lets them
                    await trio.sleep(0.01)
                    await super().jaw("a", commanded - 0.09 * share)
                self.held_rad = None
        await trio.sleep(0.05)

    def read(self, _):
        reading = super().read(_)
        reading.time_s = trio.current_time()
        return reading


@pytest.fixture
def timed_hand(hand):
    hand, _ = hand
    fingers, log = Fingers(), type("Log", (), {"span": lambda *_: nullcontext()})()
    clock = type("Clock", (), {"sleep": staticmethod(trio.sleep)})
    for name, value in {"robot": fingers, "log": log, "clock": clock}.items():
        object.__setattr__(hand.cell, name, value)
    fingers.followed = fingers.commanded = hand.jaw_zero_rad + 0.4 + 2 * PLAY_RAD
    hand.waits = False
    return hand, fingers


def taken_s(action, *how):
    """Run an action; return how long it takes on a clock that skips all waits, and its result."""

    async def script():
        begin_s = trio.current_time()
        result = await action(*how)
        return trio.current_time() - begin_s, result

    return trio.run(script, clock=trio.testing.MockClock(autojump_threshold=0))


def reads(monkeypatch, hand, *read_rad, repeated=1):
    """Let the encoder read these openings, each so many times over."""
    asked, robot = iter(np.repeat([*read_rad, *[read_rad[-1]] * 40], repeated)), hand.cell.robot
    times_s = iter(np.repeat(np.arange(80) * 0.01, repeated))
    at = {}

    def read(_):
        now_s = trio.current_time()
        if now_s not in at:
            reading = type("Reading", (), {"jaw_rad": hand.jaw_zero_rad + next(asked), "time_s": next(times_s)})
            at[now_s] = reading
        return at[now_s]

    monkeypatch.setattr(robot, "read", read)


@pytest.mark.parametrize("wall_rad", [0.14, 0.21, 0.3])
def test_closing_ends_as_soon_as_a_wall_stops_the_jaws(timed_hand, wall_rad):
    hand, fingers = timed_hand
    fingers.stop = wall_rad
    took_s, stopped_rad = taken_s(hand.close_on, 0.0)
    assert stopped_rad == pytest.approx(wall_rad, abs=1e-9) and took_s < 0.1


def test_jaws_that_nothing_stops_are_waited_for(timed_hand):
    hand, _ = timed_hand
    took_s, stopped_rad = taken_s(hand.close_on, 0.0)
    assert abs(stopped_rad) < 0.01 and took_s >= 0.05 + 0.4 / 6.0


def test_jaws_that_a_person_stops_have_not_been_stopped_by_a_wall(timed_hand):
    hand, fingers = timed_hand
    fingers.held_rad = 0.3
    took_s, stopped_rad = taken_s(hand.close_on, 0.0)
    assert took_s > 0.3 and abs(stopped_rad) < 0.01, "they went on when the person let them, and closed on nothing"


def test_jaws_that_are_to_be_waited_for_are(timed_hand):
    hand, fingers = timed_hand
    hand.waits, fingers.stop = True, 0.2
    took_s, stopped_rad = taken_s(hand.close_on, -0.17)
    assert took_s >= 0.05 + 0.57 / 6.0 and stopped_rad == pytest.approx(0.2, abs=1e-9)


CLOSING = (0.4, 0.38, 0.34, 0.29, 0.24, 0.19)


def test_fingers_that_rebound_have_been_stopped(timed_hand, monkeypatch):
    hand, _ = timed_hand
    reads(monkeypatch, hand, *CLOSING, 0.2, 0.21, 0.2)
    assert taken_s(hand.close_on, 0.0) == (pytest.approx(0.08), pytest.approx(0.2))


def test_jaws_that_slip_off_an_edge_have_not_been_stopped(timed_hand, monkeypatch):
    hand, _ = timed_hand
    reads(monkeypatch, hand, *CLOSING, *np.linspace(0.185, 0.06, 12), *np.zeros(20))
    assert taken_s(hand.close_on, 0.0)[0] > 0.11


def test_a_reading_that_is_repeated_tells_nothing(timed_hand, monkeypatch):
    """The loop may report more rarely than this is asked."""
    hand, _ = timed_hand
    reads(monkeypatch, hand, *CLOSING[:3], *[0.3] * 3, repeated=4)
    assert taken_s(hand.close_on, 0.0)[0] > 0.11


def test_an_arm_may_go_once_its_jaws_have_parted_and_they_go_on(timed_hand):
    hand, fingers = timed_hand
    fingers.stop = 0.2
    taken_s(hand.jaw, 0.0)
    took_s, _ = taken_s(hand.part, 0.4)
    assert took_s < 0.1 and 0.28 < fingers.fingers_rad < 0.36
    taken_s(hand.go_on_with_jaw)
    assert fingers.fingers_rad == pytest.approx(0.4, abs=1e-9)
    asked = len(fingers.asked)
    taken_s(hand.go_on_with_jaw)
    assert len(fingers.asked) == asked, "they have arrived"
