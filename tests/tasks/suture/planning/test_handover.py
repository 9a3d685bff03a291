"""Where one arm hands the needle to the other: both reach it, in the taker's own grasp, and neither meets the other."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from trocar.arms import capsules, fk
from trocar.errors import OutOfReach
from trocar.geometry import SE3
from trocar.geometry.capsules import capsule_distances_m
from trocar.lab import load_station
from trocar.tasks.suture.planning import PRESETS, handover
from trocar.tasks.suture.planning.clearance import APART_M, JAW_OPEN_RAD
from trocar.tasks.suture.planning.handover import FACES, OTHERWISE_RAD, Holder, handover_places, plan_handovers, taking
from trocar.tasks.suture.planning.primitive import grasp_pose
from trocar.tasks.suture.planning.pull import HOLDING_RAD, ROOM_RAD, out_segments, room_rad
from trocar.tasks.suture.planning.two_arms import SecondArm, plan_two_arms
from trocar.tasks.suture.task import CircleSutures

TASK = CircleSutures(variant="two-arms")
STATION = TASK.at(load_station(TASK.usual_station))
FIRST, SECOND = STATION.arms.values()
EYE_M = STATION.cameras["close"].T_world_camera.translation_m
EACH = pytest.mark.parametrize("number", range(TASK.sutures - 1))


@cache
def plan():
    return TASK.plan_with(STATION)


def pair(number=0):
    """Return how the needle is pulled out of a suture, and the handovers that may follow."""
    return plan().pulls[number], plan().handovers[number]


def test_there_is_a_handover_between_each_two_sutures_and_alternatives_that_differ():
    assert len(plan().pulls) == len(TASK.goals()) == len(plan().handovers) + 1
    for alternatives in plan().handovers:
        turns = [each.T_circle_needle.rotation for each in alternatives]
        for k, one in enumerate(turns):
            for other in turns[:k]:
                assert np.linalg.norm((one.inverse() @ other).log()) > OTHERWISE_RAD


@EACH
def test_both_arms_hold_the_needle_in_their_own_grasps(number):
    pull, alternatives = pair(number)
    giver, taker = pull.grips[-1].setup, TASK.setup
    for each in alternatives:
        for setup, q in ((taker, each.take.q[-1]), (giver, each.part.q[0])):
            T_circle_tip = setup.T_base_circle.inverse() @ fk(setup.arm, q)
            wanted = each.T_circle_needle @ grasp_pose(setup)
            np.testing.assert_allclose(T_circle_tip.matrix, wanted.matrix, atol=1e-6)


@EACH
def test_neither_arm_meets_the_other_and_both_have_room(number):
    for each in plan().handovers[number]:
        for way in (each.take, each.part):
            assert room_rad(FIRST.model, way.q).min() > ROOM_RAD
        takes = capsules(FIRST.model, each.take.q, JAW_OPEN_RAD).moved(FIRST.T_world_base)
        gives = capsules(SECOND.model, each.part.q[0], HOLDING_RAD).moved(SECOND.T_world_base)
        assert capsule_distances_m(takes, gives).min() >= each.apart_m - 1e-9 >= APART_M - 1e-9


def test_the_camera_sees_the_needles_plane_in_front_of_the_tissue():
    for each in (one for alternatives in plan().handovers for one in alternatives):
        sight = EYE_M - each.T_circle_needle.translation_m
        facing = abs(each.T_circle_needle.matrix[:3, 2] @ sight) / np.linalg.norm(sight)
        assert facing > FACES
        place = each.T_circle_needle.translation_m
        behind = place - sight * place[2] / sight[2]
        assert np.linalg.norm(behind) < TASK.setup.circle.radius_m


def test_a_roll_is_in_the_turn_from_which_the_arm_comes_unless_that_is_out_of_range():
    pull, (first, *_) = pair()
    setup = pull.grips[-1].setup
    plain = taking(setup, first.T_circle_needle).q
    turn = np.array([0.0, 0.0, 0.0, 2 * np.pi, 0.0, 0.0])
    np.testing.assert_allclose(taking(setup, first.T_circle_needle, plain[-1] + 2 * turn).q, plain)
    np.testing.assert_allclose(taking(setup, first.T_circle_needle, plain[-1]).q, plain)
    wide = replace(setup, arm=replace(setup.arm, joints=tuple(map(doubled, setup.arm.joints))))
    np.testing.assert_allclose(taking(wide, first.T_circle_needle, plain[-1] + turn).q, plain + turn)


def doubled(joint):
    """Return a joint with twice the range, if it turns about the shaft."""
    return replace(joint, lower=2 * joint.lower, upper=2 * joint.upper) if joint.name == "roll" else joint


def test_arms_that_never_meet_are_refused_in_a_sentence():
    pull, start = plan().pulls[0], plan().handovers[0][0].part.q[0]
    away = SE3.from_parts(translation_m=[-0.30, 0.45, 0.0]) @ SECOND.T_world_base
    far = Holder(replace(pull.grips[-1].setup, T_world_base=away), start, start)
    with pytest.raises(OutOfReach, match=r"nowhere over the circle .*; place the arms elsewhere"):
        plan_handovers(far, Holder(TASK.setup, FIRST.park_q(), FIRST.park_q()), handover_places(TASK.setup, EYE_M))


def test_handovers_with_the_arms_too_near_to_each_other_are_not_taken(monkeypatch):
    pull, alternatives = pair()
    nearest_m = min(each.apart_m for each in alternatives)
    giver = Holder(pull.grips[-1].setup, SECOND.park_q(), out_segments(pull.grips[-1])[-1].q[-1])
    taker, places = Holder(TASK.setup, FIRST.park_q(), FIRST.park_q()), handover_places(TASK.setup, EYE_M)
    found = plan_handovers(giver, taker, places)
    assert [each.room_rad for each in found] == pytest.approx([each.room_rad for each in alternatives])
    monkeypatch.setattr(handover, "APART_M", 3.0 * nearest_m)
    with pytest.raises(OutOfReach):
        plan_handovers(giver, taker, places)


def test_a_grasp_beside_which_open_jaws_meet_the_wire_is_named():
    pull = plan().pulls[0]
    giver = Holder(pull.grips[-1].setup, SECOND.park_q(), out_segments(pull.grips[-1])[-1].q[-1])
    leaning = replace(TASK.setup, grasp=PRESETS["paper-demo"].setup.grasp)
    with pytest.raises(OutOfReach, match=r"open jaws would meet the wire beside their grasp; .*grasp_lean_deg"):
        plan_handovers(giver, Holder(leaning, FIRST.park_q(), FIRST.park_q()), handover_places(leaning, EYE_M))


def test_the_needle_in_its_stand_is_out_of_reach_if_the_stand_is():
    away = SE3.from_parts(translation_m=[0.5, 0.0, 0.0])
    second = SecondArm(SECOND.model, SECOND.T_world_base, SECOND.park_q())
    cameras = [camera.T_world_camera for camera in STATION.cameras.values()]
    with pytest.raises(OutOfReach, match="put the fixture 'stand' elsewhere"):
        plan_two_arms(TASK.goals(), FIRST.park_q(), second, away, cameras)
