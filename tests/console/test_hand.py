"""Steps of a held arm by keys; what else a hand does is tested at a console."""

import numpy as np
import pytest
import trio

from driven import ARM, PAPER, PlainArms
from trocar.cell import Cell
from trocar.console.hand import AHEAD_M, STEP_S, Hand
from trocar.geometry import SE3
from trocar.log import CellLog
from trocar.robots import ArmGuard, Guarded
from trocar.sim.laboratory import SimClock
from trocar.view.wishes import KEYS, Held, Step

MM = 1e-3
STILL = np.array([1.0, 0.0, 0.0, 0.0])


class Lent:
    """A plain arm in a hand, with the tip's place at each tick and whether it is held."""

    def __init__(self, limits=PAPER):
        self.arms = PlainArms(limits=limits)
        guard = Guarded(self.arms.driver, {"a": ArmGuard(ARM, limits)})
        base, log = {"a": SE3.identity()}, CellLog(self.arms.now_s)
        cell = Cell(guard, {}, {"a": ARM}, {"a": limits}, base, {}, {}, SimClock(self.arms.now_s), log)
        self.hand = Hand(cell, "a")
        self.tips_m, self.held, self.refused = [], [], []

    def play(self, *inputs, lasts_s=2.0):
        """Follow these inputs, each (time in s, value, source), for a while; return how far (3,) the tip moved."""
        left = sorted(inputs, key=lambda one: one[0])

        def each():
            while left and left[0][0] <= self.arms.now_s():
                self.hand.hold(left[0][1], 0.0, left.pop(0)[2])
            self.tips_m.append(self.hand.tip.translation_m)
            self.held.append(self.hand.held)
            self.refused.append(self.hand.refused)

        async def follow():
            with trio.move_on_after(lasts_s):
                await self.hand.follow()

        self.arms.each_tick.append(each)
        self.arms.run(follow)
        return self.tips_m[-1] - self.tips_m[0]


def key(at_s, *by_m):
    return at_s, Step(np.array(by_m)), KEYS


@pytest.mark.parametrize("by_m", [(MM, 0, 0), (0, -MM, 0), (0, 0, MM), (-5 * MM, 0, 0), (0, 0, -5 * MM)])
def test_a_key_moves_the_tip_by_its_step_along_a_line_and_then_lets_go(by_m):
    lent, along = Lent(), np.array(by_m) / np.linalg.norm(by_m)
    np.testing.assert_allclose(lent.play(key(0.1, *by_m)), by_m, atol=1e-9)
    way_m = np.array(lent.tips_m) - lent.tips_m[0]
    assert np.abs(way_m - np.outer(way_m @ along, along)).max() < 0.1 * MM
    assert (way_m @ along).max() < np.linalg.norm(by_m) + 0.1 * MM
    assert any(lent.held) and not any(lent.held[50:]) and len(lent.hand.latencies_s) == 1
    assert max(lent.arms.use("a")) <= 1.001


def test_keys_one_after_the_other_add_up_and_go_back():
    ways = [(MM, 0, 0), (0, 5 * MM, 0), (0, 0, MM), (-MM, 0, 0)]
    lent = Lent()
    np.testing.assert_allclose(
        lent.play(*(key(0.4 * k, *way) for k, way in enumerate(ways))), np.sum(ways, 0), atol=1e-9
    )


@pytest.mark.parametrize("step_m", [MM, 5 * MM])
@pytest.mark.parametrize("every_s", [0.033, 0.001])
def test_a_key_that_is_held_keeps_the_tip_going_until_it_is_let_go(step_m, every_s):
    """However fast it repeats: a busy browser sends many at once, and late."""
    lent = Lent()
    moved_m = lent.play(*(key(0.1 + every_s * k, step_m, 0, 0) for k in range(30)), lasts_s=3.0)
    last = round((0.1 + every_s * 29) / 0.01) + 1
    after_m = np.linalg.norm(lent.tips_m[-1] - lent.tips_m[last])
    assert after_m <= step_m + AHEAD_M + 1e-6
    assert moved_m[0] == pytest.approx(step_m * round(moved_m[0] / step_m), abs=1e-9) and moved_m[0] >= step_m
    if every_s > 0.03:
        assert moved_m[0] > 15 * MM, "it keeps going"


@pytest.mark.parametrize("by_m", [*(MM * np.eye(3)), *(-MM * np.eye(3))])
def test_of_two_presses_at_once_one_counts(by_m):
    lent = Lent()
    np.testing.assert_allclose(lent.play(key(0.1, *by_m), key(0.1, *by_m)), by_m, atol=1e-9)


def test_a_step_is_ignored_while_the_handle_is_dragged():
    lent = Lent()
    drag = [(at_s, Held(np.array([0.0, y, 0.0]), STILL), "") for at_s, y in ((0.1, 0.0), (0.2, 2 * MM))]
    np.testing.assert_allclose(lent.play(*drag, key(0.3, 5 * MM, 0, 0)), [0, 2 * MM, 0], atol=1e-9)


def test_a_step_that_cannot_be_made_is_given_up_and_what_was_in_the_way_stays_told():
    lent = Lent()
    np.testing.assert_allclose(lent.play(key(0.1, 0, 0, 1.0), lasts_s=3.0)[:2], 0.0, atol=0.05)
    tips_m = np.array(lent.tips_m)
    ended = round((0.1 + STEP_S) / 0.01) + 5
    assert not any(lent.held[ended:])
    np.testing.assert_allclose(tips_m[-1], tips_m[ended + 20], atol=1e-12)
    assert max(lent.arms.use("a")) <= 1.001


def test_a_refused_step_tells_why_until_the_next_one():
    lent = Lent()
    lent.play(*(key(0.1 + 0.033 * k, 0, 0, -5 * MM) for k in range(200)), lasts_s=9.0)
    assert "reach" in lent.refused[-1] and not lent.held[-1]
    assert max(lent.arms.use("a")) <= 1.001
    before_m = lent.tips_m[-1]
    lent.play(key(lent.arms.now_s() + 0.1, 0, 0, MM))
    np.testing.assert_allclose(lent.tips_m[-1] - before_m, [0, 0, MM], atol=1e-9)
    assert lent.refused[-1] == ""
