"""The second arm pulls the needle through in two grips that jaws can hold, clear of tissue and of the first arm."""

import numpy as np
import pytest

from trocar.arms import capsules, fk
from trocar.errors import OutOfReach
from trocar.geometry import SE3
from trocar.geometry.capsules import capsule_distances_m
from trocar.lab import load_station
from trocar.tasks.suture.planning import pull
from trocar.tasks.suture.planning.clearance import JAW_OPEN_RAD, fingers_above_m
from trocar.tasks.suture.planning.pull import (
    APART_M,
    DEEP_M,
    DRAWN_RAD,
    OVER_TISSUE_M,
    ROOM_RAD,
    drawn_out_m,
    grip_segments,
    holding_still,
    out_segments,
    over_tissue_m,
    plan_pull,
    room_rad,
    tail_out_rad,
)
from trocar.tasks.suture.task import CircleSutures

TASK = CircleSutures(variant="two-arms")
STATION = TASK.at(load_station(TASK.usual_station))
FIRST, SECOND = STATION.arms.values()
GOALS = TASK.goals()
PULLS = [plan_pull(goal, SECOND.model, SECOND.T_world_base, FIRST.park_q()) for goal in GOALS]
NEEDLE = TASK.setup.needle


def heights_m(grip, turns_rad, at_rad):
    return grip.T_circle_needle(np.atleast_1d(turns_rad)).apply(NEEDLE.point_m(np.atleast_1d(at_rad)))[:, 2]


def tip_in_again_rad():
    """Return the needle's rotation at which its tip, having come round, would go into the tissue again."""
    return 2 * np.pi - TASK.setup.exit_turn_rad + 2.0 * TASK.setup.insertion.entry_angle_rad


def test_tail_and_tip_cross_the_surface_where_it_is_said():
    grip = PULLS[0].grips[0]
    assert heights_m(grip, tail_out_rad(TASK.setup), NEEDLE.arc_rad) == pytest.approx(0.0, abs=1e-9)
    assert heights_m(grip, tip_in_again_rad(), 0.0) == pytest.approx(0.0, abs=1e-9)
    assert heights_m(grip, tip_in_again_rad() + 0.1, 0.0) < 0.0


@pytest.mark.parametrize("planned", PULLS, ids=str)
def test_the_grips_follow_each_other_from_where_the_first_arm_stops_to_where_little_is_in(planned):
    one, two = planned.grips
    assert one.turn_rad[0] == pytest.approx(TASK.setup.insertion.turn_rad)
    assert one.turn_rad[1] == two.turn_rad[0]
    assert two.turn_rad[1] == pytest.approx(tail_out_rad(TASK.setup) - DRAWN_RAD)
    assert two.turn_rad[1] < tip_in_again_rad()
    for grip in planned.grips:
        assert grip.setup.grasp.holdable


@pytest.mark.parametrize("planned", PULLS, ids=str)
def test_joints_keep_room_and_instruments_stay_out_of_the_tissue(planned):
    for grip in planned.grips:
        ways = grip_segments(grip)
        path = np.concatenate([way.q for way in ways])
        assert room_rad(SECOND.model, path).min() > ROOM_RAD
        assert over_tissue_m(grip.setup, path).min() > OVER_TISSUE_M
        T_circle_tip = grip.setup.T_base_circle.inverse() @ fk(SECOND.model, ways[1].q)
        opened = np.isin(np.arange(len(ways[1].q)), (0, len(ways[1].q) - 1))
        assert (
            fingers_above_m(SECOND.model, SE3.unchecked(T_circle_tip.matrix[None]), opened).min() > OVER_TISSUE_M - 1e-6
        )


@pytest.mark.parametrize(("goal", "planned"), list(zip(GOALS, PULLS, strict=True)), ids=str)
def test_the_second_arm_comes_clear_of_the_first_and_never_closer_than_it_says(goal, planned):
    coming = capsules(SECOND.model, grip_segments(planned.grips[0])[0].q, JAW_OPEN_RAD).moved(SECOND.T_world_base)
    apart = capsule_distances_m(coming, holding_still(goal)).min()
    assert APART_M <= planned.apart_m <= apart + 1e-9


@pytest.mark.parametrize("planned", PULLS, ids=str)
def test_the_jaws_are_where_they_hold_the_needle_all_along(planned):
    for grip in planned.grips:
        reach, turned, leave = grip_segments(grip)
        turns = np.linspace(*grip.turn_rad, len(turned.q))
        point = NEEDLE.point_m(np.array([grip.setup.grasp.behind_tip_rad]))
        held = grip.T_circle_needle(turns).apply(point)
        in_jaws = (grip.setup.T_base_circle.inverse() @ fk(SECOND.model, turned.q)).apply([0.0, 0.0, DEEP_M])
        np.testing.assert_allclose(in_jaws, held, atol=1e-6)
        np.testing.assert_allclose(reach.q[-1], turned.q[0], atol=1e-9)
        np.testing.assert_allclose(leave.q[0], turned.q[-1], atol=1e-9)


@pytest.mark.parametrize("planned", PULLS, ids=str)
def test_drawn_out_the_whole_needle_is_over_the_tissue(planned):
    last = planned.grips[-1]
    wire = NEEDLE.point_m(np.linspace(0.0, NEEDLE.arc_rad, 60))
    before = last.T_circle_needle(np.array([last.turn_rad[1]])).apply(wire)
    assert before[:, 2].min() < 0.0
    assert (before + drawn_out_m(last))[:, 2].min() > 2e-3
    draw, lift = out_segments(last)
    tips = [(last.setup.T_base_circle.inverse() @ fk(SECOND.model, way.q)).translation_m for way in (draw, lift)]
    np.testing.assert_allclose(tips[0][-1] - tips[0][0], drawn_out_m(last), atol=1e-6)
    assert tips[1][-1][2] > tips[1][0][2] + 0.019
    np.testing.assert_allclose(draw.q[0], grip_segments(last)[1].q[-1], atol=1e-6)


@pytest.mark.parametrize("share", [1.02, 1.5])
def test_a_grip_that_comes_too_near_to_the_first_arm_is_not_taken(share, monkeypatch):
    """With a larger distance to keep than the best grip's, another one is found, or none."""
    least_m = share * PULLS[1].apart_m
    monkeypatch.setattr(pull, "APART_M", least_m)
    try:
        found = plan_pull(GOALS[1], SECOND.model, SECOND.T_world_base, FIRST.park_q())
    except OutOfReach:
        return
    assert found.apart_m >= least_m and found.room_rad <= PULLS[1].room_rad


def test_an_arm_that_stands_too_far_away_is_refused_in_a_sentence():
    away = SE3.from_parts(translation_m=[0.4, 0.0, 0.0]) @ SECOND.T_world_base
    with pytest.raises(OutOfReach, match=r"cannot pull the needle through at .*; place it elsewhere"):
        plan_pull(GOALS[0], SECOND.model, away, FIRST.park_q())
