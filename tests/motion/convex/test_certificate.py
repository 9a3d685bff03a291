from dataclasses import replace

import numpy as np
import pytest

from ravens import STATION, asked, down, joints, swapping
from trocar.arms import fk
from trocar.motion import Capsule, Facing, MovingArm
from trocar.motion.convex.certificate import clearance, faces, in_range
from trocar.motion.convex.scene import joint_path
from trocar.trajectory import Trajectory

PROBLEM = asked(swapping(0.03))
ARMS = tuple(PROBLEM.arms.values())
START = np.concatenate([arm.waypoints[0] for arm in ARMS])
UPPER = np.concatenate([arm.model.upper for arm in ARMS])
LOWER = np.concatenate([arm.model.lower for arm in ARMS])


@pytest.mark.parametrize("joint", [2, 11])
@pytest.mark.parametrize("slack", [0.0, 0.01])
def test_what_a_parabola_hides_between_two_places_counts(joint, slack):
    """Four places: the two in the middle are equally far, the peak between them an eighth of the bend further."""
    for end, sign in ((UPPER, 1.0), (LOWER, -1.0)):
        bound = end[joint] + sign * slack * (UPPER - LOWER)[joint]
        for room, inside in ((1e-6, True), (-1e-6, False)):
            q = np.tile((LOWER + UPPER) / 2, (4, 1))
            bend = 1e-3
            q[:, joint] = bound - sign * (room + bend / 8 + bend * np.array([1.0, 0.0, 0.0, 1.0]))
            assert in_range(ARMS, q, slack) == inside


def test_all_places_are_looked_at_for_ranges():
    q = np.tile((LOWER + UPPER) / 2, (5, 1))
    assert in_range(ARMS, q, 0.0)
    for row in range(5):
        for end, joint in ((UPPER, 0), (LOWER, 6)):
            beyond = q.copy()
            beyond[row, joint] = end[joint] + np.sign(end[joint] - q[row, joint]) * 0.1
            assert not in_range(ARMS, beyond, 0.0)


@pytest.mark.parametrize("inner", [[0.3, 0.35, 0.2], [0.35, 0.3, 0.2], [0.1, 0.2, 0.35]])
def test_what_a_tip_faces_is_judged_between_the_first_place_and_the_last(inner):
    left, right = ARMS
    turns = [0.0, *inner, 0.9]
    q = np.tile(START, (5, 1))
    q[:, 6:] = [joints("right", down([-0.055, 0.0, -0.12], turn)) for turn in turns]
    facing = Facing([0.0, 1.0, 0.0], [-0.05, 0.5, -0.12], 3.0)
    angles = facing.angle_rad(right.T_world_base @ fk(right.model, q[:, 6:]))
    hidden = np.abs(np.diff(angles, n=2)).max() / 8
    least = angles[1:-1].max() + hidden
    assert hidden > 0.01 and angles[-1] > least > angles[1:-1].max()
    for off, kept in ((1e-6, True), (-1e-6, False)):
        limited = replace(right, facing=replace(facing, max_rad=float(least + off)))
        assert faces((left, limited), q) == kept
    assert faces((left, right), q)  # nothing is asked


def still_path():
    end = START + 1e-7
    return Trajectory(np.array([0.0, 1.0]), np.stack([end - START, START])[:, None])


def test_distances_on_a_path_are_those_of_both_arms_and_what_is_in_the_way():
    tip = ARMS[1].T_world_base @ fk(ARMS[1].model, ARMS[1].waypoints[0])
    ball = {"ball": Capsule(tip.translation_m + [0.0, 0.0, -0.011], radius_m=1e-3)}
    clear = clearance(replace(PROBLEM, obstacles=ball, min_distance_m=0.05), still_path())
    assert clear.between[1] == "ball" and clear.between[0].startswith("right")
    assert clear.sampled_m - clear.distance_m <= 1e-6 + 1e-9  # as closely as is certified
    assert 0 < clear.distance_m < 0.012


def test_a_path_that_leads_through_something_need_not_be_known_well():
    """More than 3 mm short of what was asked, one sample is enough; a little less, all are looked at."""
    left = ARMS[0]
    end = left.waypoints[0] + [0.3, 0, 0, 0, 0, 0]
    whole = np.concatenate([end - left.waypoints[0], np.zeros(6)])
    path = Trajectory(np.array([0.0, 1.0]), np.stack([whole, START])[:, None])
    tip = left.T_world_base @ fk(left.model, left.waypoints[0])
    ball = {"ball": Capsule(tip.translation_m + [0.0, 0.0, -0.02], radius_m=1e-3)}
    free = replace(PROBLEM, arms={"left": left}, obstacles=ball, min_distance_m=1.0)
    least_m = clearance(free, joint_path(path, 0)).sampled_m
    for wanted_m, exact in ((least_m + 2.9e-3, True), (least_m + 3.5e-3, False)):
        clear = clearance(replace(free, min_distance_m=wanted_m), joint_path(path, 0))
        assert (clear.sampled_m - clear.distance_m <= 1.1e-6) == exact


def test_others_count_until_they_rest():
    station = STATION.arms["right"]
    meets = ARMS[0].T_world_base @ fk(ARMS[0].model, ARMS[0].waypoints[0])
    hit = joints("right", meets)
    away = ARMS[1].waypoints[0]
    comes = Trajectory.hermite([0.0, 1.0], np.array([away, hit]), np.zeros((2, 6)))
    alone = replace(PROBLEM, arms={"left": ARMS[0]})
    path = joint_path(still_path(), 0)
    for start_s, hits in ((5.0, True), (-5.0, True)):
        other = MovingArm(station.model, comes, station.T_world_base, start_s)
        assert (clearance(replace(alone, others={"right": other}), path).distance_m < 0) == hits
    goes = Trajectory.hermite([0.0, 1.0], np.array([hit, away]), np.zeros((2, 6)))
    gone = MovingArm(station.model, goes, station.T_world_base, -5.0)
    assert clearance(replace(alone, others={"right": gone}), path).distance_m > 0
