import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trocar.arms import ARMS, fk
from trocar.geometry import SE3
from trocar.tasks.suture.planning import DIRECTIONS, PRESETS, Insertion, SutureSetup, suture_joints
from trocar.tasks.suture.planning.primitive import (
    driven_steps,
    grasp_pose,
    needle_poses,
    path_samples,
    steps,
    tip_poses,
    turned_to,
    unwound,
)

SETUP = SutureSetup()
THETAS = np.radians(np.arange(0.0, 360.0, 5.0))
NEEDLE_TIP = [0.0, -SETUP.needle.radius_m, 0.0]


def needle_tip(setup, advance, turn):
    """Where the needle's tip is, in the circle's frame; (2, k, 3)."""
    return needle_poses(setup, advance, turn).apply(NEEDLE_TIP)


def test_the_tip_enters_at_theta_along_the_entry_angle():
    setup = replace(SETUP, insertion=Insertion(theta_is="entry"))
    start, end = needle_tip(setup, [0.0, 0.010], [0.0, 0.0]).swapaxes(0, 1)
    np.testing.assert_allclose(start, [[0.03, 0, 0]] * 2, atol=1e-15)
    move = end - start
    # clockwise is minus the counterclockwise tangent (0, 1, 0) at theta = 0; 30 deg down, 1.0 cm (paper, Fig. 2)
    c, s = 0.01 * math.cos(math.radians(30)), 0.01 * math.sin(math.radians(30))
    np.testing.assert_allclose(move, [[0, -c, -s], [0, c, -s]], atol=1e-15)


def test_the_tip_moves_on_along_the_wire_without_a_corner():
    h = 1e-6
    at, after = needle_tip(SETUP, [0.01, 0.01], [0.0, h])[0]
    before = needle_tip(SETUP, [0.01 - h * SETUP.needle.radius_m], [0.0])[0, 0]
    np.testing.assert_allclose(after - at, at - before, atol=1e-13)


def test_the_needle_turns_about_a_centre_that_stays():
    T = needle_poses(SETUP, np.full(5, 0.01), np.linspace(0, 2, 5))
    assert np.ptp(T.translation_m, axis=1).max() < 1e-15
    tips = T.apply(NEEDLE_TIP)
    np.testing.assert_allclose(np.linalg.norm(tips - T.translation_m, axis=-1), 0.0083, atol=1e-15)


@pytest.mark.parametrize(("theta_is", "ends"), [("entry", (0.0, 1.0)), ("middle", (-0.5, 0.5))])
def test_the_bite_begins_at_theta_or_is_centred_there_and_ends_at_the_surface(theta_is, ends):
    setup = replace(SETUP, insertion=Insertion(theta_is=theta_is))
    entry, out = (needle_tip(setup, [a], [t])[:, 0] for a, t in ((0.0, 0.0), (0.01, setup.exit_turn_rad)))
    for point, share in ((entry, ends[0]), (out, ends[1])):
        np.testing.assert_allclose(point, [[0.03, -d * share * SETUP.bite_m, 0] for d in DIRECTIONS], atol=1e-15)
    assert steps(setup)[-1].needle_rad[1] > setup.exit_turn_rad


@pytest.mark.parametrize("order", [steps, driven_steps])
def test_the_steps_follow_on_and_the_needle_moves_only_with_the_jaws(order):
    path = order(SETUP)
    assert [step.name for step in path] == ["penetrate", "rotate", "regrasp 1", "push 1", "regrasp 2", "push 2"]
    for before, after in pairwise(path):
        for name in ("advance_m", "jaws_rad", "needle_rad"):
            assert getattr(before, name)[1] == pytest.approx(getattr(after, name)[0])
    for step in path:
        needle = step.needle_rad[1] - step.needle_rad[0]
        jaws = step.jaws_rad[1] - step.jaws_rad[0]
        assert needle == pytest.approx(jaws if step.holds else 0.0)
    assert math.degrees(path[-1].needle_rad[1]) == pytest.approx(140.0)


def lets_go_deg(setup, order):
    """Return the needle's rotations at which the jaws let go of it, against that at which its tip comes out."""
    return [
        math.degrees(step.needle_rad[0] - setup.exit_turn_rad) for step in order(setup) if step.name.startswith("reg")
    ]


@given(rotation=st.floats(40.0, 110.0), regrasp=st.floats(10.0, 35.0), pushes=st.integers(0, 2))
def test_an_arm_holds_the_needle_while_its_tip_comes_out(rotation, regrasp, pushes):
    turns = {"rotation_rad": math.radians(rotation), "regrasp_rad": math.radians(regrasp), "pushes": pushes}
    setup = replace(SETUP, insertion=Insertion(**turns))
    driven = driven_steps(setup)
    assert driven[-1].needle_rad[1] == pytest.approx(steps(setup)[-1].needle_rad[1])
    for step in driven:
        assert -1e-9 <= min(step.jaws_rad) <= max(step.jaws_rad) <= setup.insertion.rotation_rad + 1e-9
        assert step.needle_rad[1] >= step.needle_rad[0] - 1e-9
    if regrasp > 20.0:  # else there is no room between one grip and the next
        assert all(not -12.0 + 1e-6 < away < 8.0 - 1e-6 for away in lets_go_deg(setup, driven_steps))


def test_the_default_suture_lets_go_past_its_exit_and_not_right_at_it():
    np.testing.assert_allclose(lets_go_deg(SETUP, steps), [-34.7, 0.3], atol=0.05)
    np.testing.assert_allclose(lets_go_deg(SETUP, driven_steps), [-34.7, 8.0], atol=0.05)


def test_the_jaws_hold_the_wire_where_the_grasp_says():
    point = grasp_pose(SETUP).translation_m
    assert np.linalg.norm(point) == pytest.approx(0.0083)
    tip = np.array(NEEDLE_TIP)
    assert math.degrees(math.acos(point @ tip / 0.0083**2)) == pytest.approx(120.0)
    # behind the tip: opposite to the tip's motion along x
    assert point[0] < 0


@given(theta=st.floats(-7.0, 7.0))
def test_a_suture_anywhere_is_the_first_turned_about_the_circles_axis(theta):
    here = turned_to(tip_poses(SETUP, [0.005], [0.0]), [theta]).matrix
    at_zero = tip_poses(SETUP, [0.005], [0.0]).matrix
    c, s = math.cos(theta), math.sin(theta)
    turn = SE3(np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]]))
    np.testing.assert_allclose(here[:, 0], (turn @ SE3(at_zero)).matrix, atol=1e-14)


@pytest.mark.parametrize("name", PRESETS)
def test_samples_hold_every_end_of_a_movement(name):
    setup = PRESETS[name].setup
    along = path_samples(setup)
    ends = {(step.advance_m[i], round(step.jaws_rad[i], 9)) for step in steps(setup) for i in (0, 1)}
    marked = set(zip(along.advance_m[along.station], np.round(along.jaws_rad[along.station], 9), strict=True))
    assert ends == marked
    assert len(marked) == along.station.sum()


# The arm's joints along it.


def over(arm):
    """The demo with another arm: its tools start near the middle of their ranges over the circle."""
    setup = PRESETS["paper-demo"].setup
    if arm.name.startswith("psm"):
        return replace(setup, arm=arm)
    T_base_tip = fk(arm, arm.middle)
    T_world_tip = SE3.from_parts(translation_m=[0.0, 0.0, 0.0])
    return replace(setup, arm=arm, T_world_base=T_world_tip @ T_base_tip.inverse())


@pytest.mark.parametrize("arm", ARMS.values(), ids=lambda arm: arm.name)
def test_the_joints_put_the_tip_on_the_primitive(arm):
    setup = over(arm)
    joints = suture_joints(setup, THETAS)
    along = path_samples(setup)
    wanted = turned_to(tip_poses(setup, along.advance_m, along.jaws_rad), THETAS).matrix
    real = np.isfinite(joints.q).all(-1)
    assert real.mean() > 0.5
    reached = setup.T_base_circle.inverse() @ fk(arm, joints.q[real])
    np.testing.assert_allclose(reached.matrix, wanted[real], atol=1e-11)


def test_the_roll_neither_jumps_nor_winds_needlessly():
    for preset in PRESETS.values():
        joints = suture_joints(preset.setup, THETAS)
        roll = joints.q[..., 3]
        # elsewhere the wrist may point along the shaft's axis backwards, where the roll turns at once
        assert np.abs(np.diff(roll[joints.feasible], axis=-1)).max() < 0.6
        for other in (roll - 2 * np.pi, roll + 2 * np.pi):
            assert (np.abs(other).max(-1) >= np.abs(roll).max(-1) - 1e-12).all()


def test_unwinding_crosses_the_seam_of_half_a_turn():
    roll = np.radians([170.0, 179.0, -175.0, -160.0])
    np.testing.assert_allclose(np.degrees(unwound(roll)), [-190, -181, -175, -160])
    np.testing.assert_allclose(np.degrees(unwound(np.radians([350.0, 370.0]))), [-10, 10], atol=1e-12)


def test_feasibility_is_limits_and_safe_depth():
    setup = PRESETS["default"].setup
    joints = suture_joints(setup, THETAS)
    q, arm = joints.q, setup.arm
    inside = ((q >= arm.lower) & (q <= arm.upper)).all((2, 3))
    np.testing.assert_array_equal(joints.feasible, inside)
    assert 0 < inside.mean() < 1
    worst = np.maximum(arm.lower - q, q - arm.upper).max(2)
    np.testing.assert_allclose(joints.excess, np.maximum(worst, 0))

    needed = (q[..., 2] - 0.0156).min(2) - 1e-4  # PSM: depth of the wrist is q3 - 15.6 mm
    shy = replace(setup, arm=replace(arm, safe_depth_m=float(np.median(needed))))
    shallow = suture_joints(shy, THETAS)
    np.testing.assert_array_equal(shallow.too_shallow_m > 0, needed + 1e-4 < np.median(needed))
    assert (shallow.feasible <= inside).all()
    assert shallow.feasible.sum() < inside.sum()


def test_stations_bound_what_lies_between_them():
    # start and end poses bound the angles in between to within 2.2 deg, on the demo
    joints = suture_joints(PRESETS["paper-demo"].setup, THETAS)
    chosen = joints.feasible[..., None]
    dense = np.abs(joints.q[..., 3:]).max(2)
    more = np.where(chosen, dense - joints.largest_wrist_rad, 0.0)
    assert more.min() >= -1e-12
    assert math.degrees(more.max()) < 5.0
