"""Waypoints follow the plan in time, joints and poses agree, and the jaws hold the needle where it is pushed."""

import math
from itertools import pairwise

import numpy as np
import pytest

from trocar.arms import ARMS, MOTION_LIMITS, fk
from trocar.crtk.dialect import PSM_JOINTS as JOINTS
from trocar.geometry import SO3
from trocar.tasks.suture.planning import CLOCKWISE, DIRECTIONS, PRESETS, Suture, dexterity, plan_even, sutures_at
from trocar.tasks.suture.planning.clearance import JAW_OPEN_RAD
from trocar.tasks.suture.planning.primitive import needle_poses
from trocar.tasks.suture.planning.segments import (
    BACK_M_S,
    DRIVING_M_S,
    FREE_M_S,
    JAW_CLOSED_RAD,
    minimum_jerk,
    suture_segments,
)
from trocar.tasks.suture.planning.waypoints import COLUMNS, JAW_S, JOINT_NAMES, rows, waypoints, waypoints_values

SETUP = PRESETS["default"].setup
PLAN = plan_even(dexterity(SETUP))
STITCHES = [waypoints(suture) for suture in sutures_at(SETUP, PLAN.positions_rad, PLAN.directions)]


@pytest.mark.parametrize("number", range(4))
def test_joints_are_those_of_the_segments_one_after_the_other_and_poses_their_kinematics(number):
    found, segments = STITCHES[number], suture_segments(STITCHES[number].suture)
    for segment in segments:
        at = [k for k, name in enumerate(found.segments) if name == segment.name]
        q = found.q[at]
        assert min(np.abs(q[-1] - segment.back.q[-1 if segment.beyond else 0]).max(), 1) < 1e-9
        for wanted in segment.q[1:]:
            assert np.abs(q - wanted).max(1).min() < 1e-12
    T = fk(SETUP.arm, found.q)
    np.testing.assert_allclose(found.poses[:, :3], T.translation_m)
    wxyz = np.roll(found.poses[:, 3:], 1, axis=-1)
    np.testing.assert_allclose(SO3.from_quaternion(wxyz).matrix, T.rotation.matrix, atol=1e-12)


@pytest.mark.parametrize("number", range(4))
def test_time_goes_on_within_the_arms_limits_at_the_speeds_of_the_segments(number):
    found = STITCHES[number]
    assert found.times_s[0] == 0.0 and (np.diff(found.times_s) > 0).all()
    rates = np.abs(np.diff(found.q, axis=0)) / np.diff(found.times_s)[:, None]
    assert (rates.max(0) <= MOTION_LIMITS["paper"].velocity).all()
    jaws = sum(name in ("open", "close") for name in found.segments)
    seconds = 0.0
    for part in suture_segments(found.suture):
        if len(part.q) > 1:
            to_m_s = BACK_M_S if part.regrasps else FREE_M_S.get(part.name, DRIVING_M_S)
            seconds += part.length_m / to_m_s + part.beyond * part.length_m / (len(part.q) - 1) / DRIVING_M_S
    assert found.times_s[-1] == pytest.approx(seconds + jaws * JAW_S)


def test_jaws_are_closed_where_they_move_the_needle_and_open_where_they_go_back_and_leave():
    for found in STITCHES:
        for name, jaw in zip(found.segments, found.jaw_rad, strict=True):
            opened = name.startswith(("regrasp", "withdraw", "rise", "open"))
            assert jaw == (JAW_OPEN_RAD if opened else JAW_CLOSED_RAD), name
        changes = [(a, b) for a, b in pairwise(found.jaw_rad) if a != b]
        assert len(changes) == 5, "two regrasps, and the end"
        still = [k for k, name in enumerate(found.segments) if name in ("open", "close")]
        np.testing.assert_array_equal(found.q[still], found.q[np.array(still) - 1])


def test_each_movement_begins_and_ends_at_rest():
    found = STITCHES[0]
    rotate = [k for k, name in enumerate(found.segments) if name == "rotate"]
    speed = np.linalg.norm(np.diff(found.poses[:, :3], axis=0), axis=1) / np.diff(found.times_s)
    inner = speed[rotate[0] : rotate[-1]]
    assert max(inner[0], inner[-1]) < 0.5 * inner.max()
    share = minimum_jerk(np.array([0.0, 0.5, 1.0]))
    np.testing.assert_allclose(share, [0.0, 0.5, 1.0])


def test_the_table_has_crtks_names_with_units_and_a_row_for_each_waypoint():
    assert COLUMNS[:3] == ("stitch", "segment", "time_s")
    assert tuple(name.rpartition("_")[0] for name in COLUMNS[3:9]) == JOINTS == JOINT_NAMES
    for arm in ARMS.values():
        assert tuple(name.rpartition("_")[2] for name in COLUMNS[3:9]) == tuple(joint.unit for joint in arm.joints)
    table = list(rows(STITCHES))
    assert len(table) == sum(len(stitch.times_s) for stitch in STITCHES)
    assert {len(row) for row in table} == {len(COLUMNS)}
    q = np.array([[float(cell) for cell in row[3:9]] for row in table if row[0] == "2"])
    np.testing.assert_allclose(q, STITCHES[1].q, atol=1e-8)


def test_values_name_joints_units_and_the_frame_of_the_poses():
    found = waypoints_values(STITCHES)
    assert found["joint_names"] == list(JOINTS)
    assert found["joint_units"] == ["rad", "rad", "m", "rad", "rad", "rad"]
    assert [len(stitch["times_s"]) for stitch in found["stitches"]] == [len(stitch.times_s) for stitch in STITCHES]
    assert found["stitches"][1]["theta_rad"] == pytest.approx(PLAN.positions_rad[1])


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_the_needle_comes_out_where_the_plan_says_if_an_arm_follows_them(direction):
    """Forward kinematics of the waypoints, with the needle in closed jaws from its first grasp on."""
    theta = math.radians(90 if direction == CLOCKWISE else 270)
    suture = Suture(SETUP, theta, direction)
    found = waypoints(suture)
    first = found.segments.index("penetrate") - 1
    T = SETUP.T_base_circle.inverse() @ fk(SETUP.arm, found.q)
    T_needle = suture.turned(needle_poses(SETUP, [0.0], [0.0]))[0]
    held = T[first].inverse() @ T_needle
    tips = []
    for k in range(first, len(found.q)):
        if found.jaw_rad[k] == JAW_CLOSED_RAD:
            T_needle = T[k] @ held
        else:
            held = T[k].inverse() @ T_needle
        tips.append(T_needle.apply(SETUP.needle.p_tip_m))
    heights = np.array(tips)[:, 2]
    assert heights[0] == pytest.approx(0.0, abs=1e-9)
    out = np.flatnonzero((heights[:-1] < 0) & (heights[1:] >= 0))
    assert np.linalg.norm(np.array(tips)[out[-1]] - suture.exit_m) < 0.3e-3
