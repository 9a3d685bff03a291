import math
from dataclasses import replace

import numpy as np
import pytest

from trocar.arms import ARMS, fk
from trocar.geometry import SE3
from trocar.tasks.suture.planning import PRESETS, suture_joints
from trocar.tasks.suture.planning.joints import unwound
from trocar.tasks.suture.planning.primitive import path_samples, tip_poses, turned_to

THETAS = np.radians(np.arange(0.0, 360.0, 5.0))


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
        roll = suture_joints(preset.setup, THETAS).q[..., 3]
        assert np.abs(np.diff(roll, axis=-1)).max() < 0.6
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
    # facts/suture.md: start and end poses bound the angles in between to within 2.2 deg, on the demo
    joints = suture_joints(PRESETS["paper-demo"].setup, THETAS)
    chosen = joints.feasible[..., None]
    dense = np.abs(joints.q[..., 3:]).max(2)
    more = np.where(chosen, dense - joints.largest_wrist_rad, 0.0)
    assert more.min() >= -1e-12
    assert math.degrees(more.max()) < 5.0
