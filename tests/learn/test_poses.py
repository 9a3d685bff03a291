"""Tips as numbers and back."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from trocar.arms import PSM_CLASSIC, fk
from trocar.errors import OutOfReach
from trocar.geometry import SE3, SO3
from trocar.learn.poses import action_names, joints, state_names, vectors

BASE = SE3.from_parts(SO3.exp([0.3, -0.8, 0.4]), [0.1, -0.2, 0.3])
START = np.array([0.1, 0.2, 0.15, 0.5, 0.3, -0.2, 0.4])
WAVES = START + 0.02 * np.sin(np.outer(np.linspace(0, 20, 60), [1, 1.3, 0.3, 2, 1.7, 1.1, 3]))


def test_names_are_those_of_dvrks():
    first = ["psm1_pose.position.x", "psm1_pose.position.y", "psm1_pose.position.z", "psm1_pose.orientation.x"]
    assert state_names(["psm1", "psm2"])[:4] == first
    assert state_names(["psm1", "psm2"])[7:9] == ["psm1_jaw", "psm2_pose.position.x"]
    assert action_names(["psm1", "psm2"])[6:8] == ["psm1_sp.orientation.w", "psm1_jaw_sp"]
    assert len(state_names(["psm1", "psm2"])) == len(action_names(["psm1", "psm2"])) == 16


def test_numbers_are_the_tip_in_the_world_and_the_jaw_and_lead_back_to_the_joints():
    numbers = vectors(PSM_CLASSIC, BASE, WAVES)
    tip = BASE @ fk(PSM_CLASSIC, WAVES[:, :6])
    assert_allclose(numbers[:, :3], tip.translation_m)
    x, y, z, w = numbers[:, 3:7].T
    assert_allclose(SO3.from_quaternion(np.stack([w, x, y, z], 1)).matrix, tip.rotation.matrix, atol=1e-12)
    assert_allclose(numbers[:, 7], WAVES[:, 6])
    assert_allclose(joints(PSM_CLASSIC, BASE, numbers.astype(np.float32).astype(float), START[:6]), WAVES, atol=1e-5)


def test_quaternions_begin_on_one_side_and_do_not_jump():
    roll = np.tile(START, (200, 1))
    roll[:, 3] = np.linspace(-4, 4, 200)  # more than a turn
    quaternions = vectors(PSM_CLASSIC, BASE, roll)[:, 3:7]
    assert ((quaternions[1:] * quaternions[:-1]).sum(axis=1) > 0.99).all()
    for row in (0, 70, 199):
        alone = vectors(PSM_CLASSIC, BASE, roll[row : row + 1])[0, 3:7]
        assert alone[np.abs(alone).argmax()] > 0


def test_a_pose_out_of_reach_is_named_by_its_frame():
    numbers = vectors(PSM_CLASSIC, BASE, WAVES[:5])
    numbers[3, :3] += [0.0, 0.0, 2.0]
    with pytest.raises(OutOfReach, match=r"^frame 3: "):
        joints(PSM_CLASSIC, BASE, numbers, START[:6])
