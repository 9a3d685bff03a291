"""The keys that move an arm in a person's hands."""

import numpy as np
import pytest

pytest.importorskip("viser")
from live_scene import MadeUpScene, console_moment
from visitor import busy, visitor_of

from trocar.geometry import SO3
from trocar.view.arm_keys import as_seen
from trocar.view.console_view import ConsoleView
from trocar.view.wishes import KEYS, Step, Wish

TIP = (np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))


@pytest.fixture
def page():
    said = []
    view = ConsoleView(MadeUpScene(), "made up", console_moment(0), port=0, say=said.append)
    with visitor_of(view.server) as visitor:
        yield view, visitor, said
    view.close()


def facing(yaw_rad, tilt_rad=0.6):
    """Return the quaternion of a camera that looks along y, turned to the left by ``yaw_rad``, and down."""
    level = SO3.axis("x", -np.pi / 2)  # right is x, and forward, the camera's z, is y
    return (SO3.axis("z", yaw_rad) @ SO3.axis("x", -tilt_rad) @ level).as_quaternion()


@pytest.mark.parametrize(
    ("yaw_rad", "right", "away"),
    [(0.0, (1, 0, 0), (0, 1, 0)), (np.pi / 2, (0, 1, 0), (-1, 0, 0)), (np.pi, (-1, 0, 0), (0, -1, 0))],
)
@pytest.mark.parametrize("tilt_rad", [0.0, 0.6, 1.5])
def test_ways_are_those_of_the_picture_level_and_upright(yaw_rad, right, away, tilt_rad):
    wxyz = facing(yaw_rad, tilt_rad)
    for by_m, wanted in (((1, 0, 0), right), ((0, 1, 0), away), ((0, 0, 1), (0, 0, 1))):
        np.testing.assert_allclose(as_seen(np.array(by_m), wxyz), wanted, atol=1e-12)


def test_keys_make_steps_of_the_arm_in_hand_as_they_are_pressed(page):
    view, visitor, said = page
    visitor.camera.wxyz = facing(np.pi / 2)
    view.show(console_moment(1, hands={"psm2": TIP}))
    with busy(view.server):
        for label in ("Tip right by 1 mm", "Tip near by 5 mm", "Tip down by 1 mm"):
            visitor.trigger(label)
    assert {(one.wish, one.arm, one.source) for one in said} == {(Wish.HOLD, "psm2", KEYS)}
    assert all(isinstance(one.value, Step) for one in said)
    steps_mm = [1e3 * one.value.by_m for one in said]
    np.testing.assert_allclose(steps_mm, [(0, 1, 0), (5, 0, 0), (0, 0, -1)], atol=1e-9)


@pytest.mark.parametrize(("label", "share"), [("close", 0.0), ("a third", 1 / 3), ("open", 1.0)])
def test_keys_move_the_jaws_as_the_buttons_do(page, label, share):
    view, visitor, said = page
    view.show(console_moment(1, hands={"psm1": TIP}))
    visitor.trigger(f"Jaws: {label}")
    (one,) = said
    assert (one.wish, one.arm, one.value, one.source) == (Wish.JAW, "psm1", share, "")


def test_keys_do_nothing_while_no_arm_is_in_hand(page):
    view, visitor, said = page
    for label in ("Tip up by 1 mm", "Jaws: close", "Keys move psm1"):
        visitor.trigger(label)
    assert not said and not view._keys._line.visible


def test_of_two_arms_a_digit_chooses_the_one_that_keys_move(page):
    view, visitor, said = page

    def moved(hands):
        view.show(console_moment(1, hands=dict.fromkeys(hands, TIP)))
        said.clear()
        visitor.trigger("Tip up by 1 mm")
        (one,) = said
        assert f"Keys move <b>{one.arm}</b>" in view._keys._line.content
        return one.arm

    assert moved(["psm1", "psm2"]) == "psm1" and "2 for psm2" in view._keys._line.content
    visitor.trigger("Keys move psm2")
    assert moved(["psm1", "psm2"]) == "psm2" and "1 for psm1" in view._keys._line.content
    assert moved(["psm1"]) == "psm1", "the other one was handed back"


def test_keys_of_a_page_without_the_controls_move_and_choose_nothing(page):
    view, visitor, said = page
    view.show(console_moment(1, hands=dict.fromkeys(["psm1", "psm2"], TIP)))
    view._may = lambda event: False
    view._keys._may = view._may
    for label in ("Tip up by 1 mm", "Jaws: open", "Keys move psm2"):
        visitor.trigger(label)
    assert not said and "Keys move <b>psm1</b>" in view._keys._line.content
