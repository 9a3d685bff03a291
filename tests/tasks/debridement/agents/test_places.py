"""Where grippers go: how a fragment is grasped beside others, and on which side of the receptacle arms wait."""

import numpy as np
import pytest

from trocar.lab import load_station
from trocar.tasks.debridement.agents.places import NEAR_M, TURNS_RAD, Places
from trocar.tasks.debridement.agents.settings import best, paper
from trocar.tasks.debridement.goals import Receptacle
from trocar.tasks.debridement.perception.fragments import SeenFragment

STATION = load_station("raven-pair")
TABLE, RECEPTACLE = (STATION.T_world_fixture[name] for name in ("table", "receptacle"))
TABLE_M = float(TABLE.translation_m[2])
ARM = STATION.arms["left"].model
FINGER_M = ARM.instrument.finger_length_m
LONG_M, SHORT_M = 0.012, 0.008
SIDES = {"left": 1, "right": -1}


def lying(x, y, yaw_rad=np.pi / 2):
    return SeenFragment(np.array([x, y, TABLE_M + 0.004]), np.array([LONG_M, SHORT_M]), yaw_rad, 0.004, 500)


FRAGMENT = lying(-0.07, -0.07)
"""Jaws without a turn close along x, across its short side."""


def grasps(fragment=FRAGMENT, others=(), turn_rad=0.0, settings=None, failures=0):
    return Places(TABLE, RECEPTACLE, settings or best()).grasps(fragment, others, ARM, turn_rad, failures)


def ends_of(grasp):
    """Where the fingers of closed jaws end."""
    return grasp.T_world_grasp.apply([0.0, 0.0, ARM.tip_length_m - FINGER_M])


def turn_of(T_world_tip):
    across = T_world_tip.rotation.matrix[:, 0]
    return float(np.arctan2(across[1], across[0]))


def gap_m(grasp):
    return 2 * FINGER_M * np.sin(grasp.open_rad / 2)


# Grasps.


def test_fingers_end_just_over_the_work_surface_with_the_fragment_between_them():
    for grasp in grasps():
        back, ends = grasp.T_world_grasp.rotation.matrix[:, 2], ends_of(grasp)
        assert ends[2] == pytest.approx(TABLE_M + best().ends_above_m[0])
        up = FRAGMENT.p_world_m - ends
        np.testing.assert_allclose(np.cross(up, back), 0.0, atol=1e-9, err_msg="the approach goes through its middle")
        above = grasp.T_world_above.translation_m - grasp.T_world_grasp.translation_m
        np.testing.assert_allclose(above, best().above_m * back, atol=1e-12)
        assert back[2] > 0.9 and back[1] < 0.0, "it points down, and its marks face the camera"


def test_after_a_failure_the_next_way_is_tried_and_deeper_but_not_below_the_surface():
    first = [turn_of(grasp.T_world_grasp) for grasp in grasps()]
    for failures in range(1, 9):
        again, way = grasps(failures=failures), failures % len(first)
        assert [turn_of(grasp.T_world_grasp) for grasp in again] == [*first[way:], *first[:way]]
        heights = {round(float(ends_of(grasp)[2] - TABLE_M), 9) for grasp in again}
        assert heights == {best().ends_above_m[min(failures, 2)]}
    assert list(best().ends_above_m) == sorted(best().ends_above_m, reverse=True) and best().ends_above_m[-1] > 0
    (straight,) = grasps(settings=paper(), failures=3)
    assert ends_of(straight)[2] == pytest.approx(TABLE_M + paper().ends_above_m[0]), (
        "the paper's program repeats itself"
    )


@pytest.mark.parametrize(("yaw_rad", "width_m"), [(np.pi / 2, SHORT_M), (0.0, LONG_M)])
def test_jaws_open_a_little_wider_than_the_fragment_unless_they_always_open_alike(yaw_rad, width_m):
    fragment = lying(-0.07, -0.07, yaw_rad)
    straight = next(grasp for grasp in grasps(fragment) if abs(turn_of(grasp.T_world_grasp)) < 1e-9)
    assert gap_m(straight) == pytest.approx(width_m + best().hug_m)
    assert [grasp.open_rad for grasp in grasps(fragment, settings=paper())] == [paper().open_rad]
    huge = SeenFragment(FRAGMENT.p_world_m, np.array([0.05, 0.05]), 0.0, 0.004, 500)
    assert {grasp.open_rad for grasp in grasps(huge)} == {best().open_rad}, "no wider than they should"


@pytest.mark.parametrize("yaw_rad", [np.pi / 2 + 0.4, np.pi / 2 - 0.4])
def test_a_turn_that_closes_across_the_fragment_comes_first(yaw_rad):
    strip = SeenFragment(FRAGMENT.p_world_m, np.array([0.020, 0.005]), yaw_rad, 0.004, 500)
    first, *_, last = (turn_of(grasp.T_world_grasp) for grasp in grasps(strip))
    assert np.sign(first) == np.sign(yaw_rad - np.pi / 2) == -np.sign(last)
    assert len(grasps(settings=paper())) == 1, "the paper's program does not turn"


@pytest.mark.parametrize("present_rad", [-0.7, 0.7])
def test_of_equally_good_turns_the_one_near_the_gripper_s_comes_first(present_rad):
    ball = SeenFragment(FRAGMENT.p_world_m, np.array([0.010, 0.010]), 0.3, 0.004, 500)
    assert turn_of(grasps(ball, turn_rad=present_rad)[0].T_world_grasp) == pytest.approx(present_rad, abs=0.01)


@pytest.mark.parametrize("side", [-1, 1])
def test_a_turn_that_leaves_a_neighbour_alone_comes_before_a_narrower_one(side):
    """The neighbour lies where a finger would come down, along x and a little to one side."""
    neighbour = lying(-0.07 + 0.014, -0.07 + side * 0.006)
    first, *others = grasps(others=[neighbour])
    assert first.crowded == 0 and np.sign(turn_of(first.T_world_grasp)) == -side
    straight = next(grasp for grasp in others if abs(turn_of(grasp.T_world_grasp)) < 1e-9)
    assert straight.crowded == 1
    assert all(grasp.crowded == 0 for grasp in grasps(others=[lying(-0.07 + 0.03, -0.07), lying(-0.07, -0.09)]))


# Beside and over the receptacle.


def test_an_arm_s_side_is_where_its_base_stands():
    places = Places(TABLE, RECEPTACLE, best())
    assert {name: places.side(arm.T_world_base) for name, arm in STATION.arms.items()} == SIDES


@pytest.mark.parametrize("side", SIDES.values())
def test_arms_let_go_inside_the_receptacle_and_wait_outside_on_their_side(side):
    places, (length, width) = Places(TABLE, RECEPTACLE, best()), Receptacle().size_m
    drop, hold, home = (
        np.array([RECEPTACLE.inverse().apply(T.translation_m) for T in kind(side, 0.1)])
        for kind in (places.drop, places.hold, places.home)
    )
    for there in (drop, hold, home):
        assert (side * there[:, 0] > -1e-9).all()
        assert len({tuple(p) for p in there.round(6).tolist()}) == len(NEAR_M), "if one is out of reach, try another"
    assert (np.abs(drop[:, :2]) < [length / 2 - 0.01, width / 2 - 0.003]).all(), "anywhere near the first choice, too"
    assert hold[0, 1] < 0.0, "towards the fragments"
    np.testing.assert_allclose(home - hold, np.tile([0.0, 0.0, home[0, 2] - hold[0, 2]], (len(home), 1)), atol=1e-12)
    assert home[0, 2] > hold[0, 2] == pytest.approx(best().hold_high_m)
    assert drop[0, 2] == pytest.approx(best().drop_high_m) and drop[0, 2] > Receptacle().height_m


@pytest.mark.parametrize("side", SIDES.values())
def test_places_have_the_present_turn_first_where_it_is_within_what_marks_allow(side):
    turns = [turn_of(T) for T in Places(TABLE, RECEPTACLE, best()).drop(side, 0.1)]
    assert turns[0] == pytest.approx(0.1) and turns[2] == pytest.approx(0.35 * side), "then outwards"
    assert turn_of(Places(TABLE, RECEPTACLE, best()).drop(side, 2.0)[0]) == pytest.approx(TURNS_RAD.max())
    assert turn_of(Places(TABLE, RECEPTACLE, paper()).drop(side, 0.1)[0]) == 0.0
