"""Jaws whose cable has play, driven by an encoder at their motor."""

import numpy as np
import pytest
import trio

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
