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
    """The same jaws over time: 6 rad/s, .05 s of rest, and fingers that rebound once from what stops them."""

    async def jaw(self, _, angle_rad):
        self.asked = [*getattr(self, "asked", []), angle_rad]
        way_rad = angle_rad - self.commanded
        for commanded in np.linspace(self.commanded, angle_rad, 1 + int(np.ceil(abs(way_rad) / 0.06)))[1:]:
            await trio.sleep(0.01)
            await super().jaw("a", commanded)
        await trio.sleep(0.05)


@pytest.fixture
def timed_hand(hand):
    hand, _ = hand
    fingers, log = Fingers(), type("Log", (), {"span": lambda *_: nullcontext()})()
    clock = type("Clock", (), {"sleep": staticmethod(trio.sleep)})
    for name, value in {"robot": fingers, "log": log, "clock": clock}.items():
        object.__setattr__(hand.cell, name, value)
    fingers.followed = fingers.commanded = hand.jaw_zero_rad + 0.4 + 2 * PLAY_RAD
    return hand, fingers


def taken_s(action, *how):
    """Run an action; return how long it takes on a clock that skips all waits."""

    async def script():
        begin_s = trio.current_time()
        await action(*how)
        return trio.current_time() - begin_s

    return trio.run(script, clock=trio.testing.MockClock(autojump_threshold=0))


@pytest.mark.parametrize("wall_rad", [0.14, 0.21, 0.3])
def test_closing_ends_as_soon_as_a_wall_stops_the_jaws(timed_hand, wall_rad):
    hand, fingers = timed_hand
    fingers.stop = wall_rad
    took_s = taken_s(hand.close_on, 0.0)
    assert hand.jaw_rad == pytest.approx(wall_rad, abs=1e-9) and took_s < 0.1


def test_jaws_that_nothing_stops_are_waited_for(timed_hand):
    hand, _ = timed_hand
    took_s = taken_s(hand.close_on, 0.0)
    assert abs(hand.jaw_rad) < 0.01 and took_s >= 0.05 + 0.4 / 6.0


def test_fingers_that_rebound_have_been_stopped(timed_hand, monkeypatch):
    hand, _ = timed_hand
    seen = iter([0.4, 0.36, 0.3, 0.24, 0.17, 0.19, 0.2, 0.18, *[0.18] * 9])
    monkeypatch.setattr(PegHand, "jaw_rad", property(lambda self: next(seen)))
    assert taken_s(hand.close_on, 0.0) == pytest.approx(0.05)


def test_jaws_that_slip_off_an_edge_have_not_been_stopped(timed_hand, monkeypatch):
    hand, _ = timed_hand
    slipping = [0.4, 0.36, 0.3, 0.25, *np.linspace(0.25, 0.06, 12)]
    seen = iter([*slipping, *[0.0] * 20])
    monkeypatch.setattr(PegHand, "jaw_rad", property(lambda self: next(seen)))
    assert taken_s(hand.close_on, 0.0) > 0.11


def test_an_arm_may_go_once_its_jaws_have_parted_and_they_go_on(timed_hand):
    hand, fingers = timed_hand
    fingers.stop = 0.2
    taken_s(hand.jaw, 0.0)
    took_s = taken_s(hand.open_by, 0.4, 0.08)
    assert took_s < 0.1 and 0.28 < fingers.fingers_rad < 0.36
    taken_s(hand.go_on_with_jaw)
    assert hand.jaw_rad == pytest.approx(0.4, abs=0.03)
    asked = len(fingers.asked)
    taken_s(hand.go_on_with_jaw)
    assert len(fingers.asked) == asked, "they have arrived"
