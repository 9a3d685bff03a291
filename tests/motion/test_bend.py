"""Bounds on the acceleration of an instrument's parts, against what is known in closed form."""

import numpy as np
import pytest

from trocar.arms import ARMS, wrist_depth_m
from trocar.motion import MovingArm
from trocar.motion.bodies import _greatest_rates, _levers, greatest_accelerations
from trocar.trajectory import Trajectory

PSM = ARMS["psm-classic"]


def moving(coefficients, seconds=1.0, model=PSM):
    return MovingArm(model, Trajectory(np.array([0.0, seconds]), np.array(coefficients, dtype=float)[:, None]))


def bound(arm, begin=0.0, end=1e-9):
    return greatest_accelerations(arm, np.array([begin]), np.array([end]))[0]


@pytest.mark.parametrize("model", ARMS.values(), ids=lambda model: model.name)
def test_levers_are_the_greatest_distances_from_the_axes(model):
    depth_m, slid_m = np.array([0.1, 0.3]), np.array([0.01, 0.0])
    levers = _levers(model, depth_m, slid_m)
    wrist, finger, shaft = model.wrist_length_m, model.instrument.finger_length_m, model.instrument.shaft_length_m
    reach = [0.0, wrist, wrist + finger, wrist + finger]
    for row, (depth, slid) in enumerate(zip(depth_m, slid_m, strict=True)):
        shaft_m = max(depth + slid, abs(shaft - depth) + slid)  # its lower end or its upper one
        for joint in (0, 1):
            wanted = [shaft_m, *(depth + slid + r for r in reach[1:])]
            np.testing.assert_allclose(levers[row, :, joint], wanted)
        np.testing.assert_allclose(levers[row, :, 2], 1.0)
        for joint in (3, 4):
            np.testing.assert_allclose(levers[row, :, joint], reach)
        np.testing.assert_allclose(levers[row, :, 5], [0.0, 0.0, finger, finger])


def test_rates_within_an_interval_are_bounded_by_their_series_about_its_middle():
    """t^4 - t^2 and 2 t^3 about t = 0.5 +- 0.25: sums of all terms' sizes, exact where they have one sign."""
    arm = moving(np.stack([np.eye(6)[0], 2 * np.eye(6)[1], -np.eye(6)[0], np.eye(6)[3], PSM.middle]))
    speed, push = _greatest_rates(arm, np.array([0.5]), np.array([[0.25]]))
    h = 0.25
    first = abs(4 * 0.125 - 2 * 0.5) + abs(12 * 0.25 - 2) * h + 24 * 0.5 * h**2 / 2 + 24 * h**3 / 6
    np.testing.assert_allclose(speed[0, :4], [first, 6 * 0.25 + 12 * 0.5 * h + 12 * h**2 / 2, 0.0, 1.0])
    np.testing.assert_allclose(push[0, :4], [abs(12 * 0.25 - 2) + 24 * 0.5 * h + 24 * h**2 / 2, 6.0 + 12 * h, 0.0, 0.0])


def test_joints_that_turn_add_centripetal_and_coriolis_shares():
    """l v^2 alone; with a joint w before it l v (v + 2 w); a sliding one 2 w v more, and l a if it is pushed."""
    depth = abs(float(wrist_depth_m(PSM, PSM.middle)))
    tip = depth + PSM.wrist_length_m + PSM.instrument.finger_length_m
    reach = PSM.wrist_length_m + PSM.instrument.finger_length_m
    still = np.zeros(6)
    cases = [
        ([still, [2.0, 0, 0, 0, 0, 0]], tip * 4.0),
        ([still, [2.0, 3.0, 0, 0, 0, 0]], tip * (4.0 + 3.0 * (3.0 + 4.0))),
        ([still, [2.0, 0, 0.1, 0, 0, 0]], tip * 4.0 + 0.1 * 4.0),
        ([still, [0, 0, 0.1, 3.0, 0, 0]], reach * 9.0),
        ([still, [1.0, 0, 0, 2.0, 3.0, 0]], tip + reach * 2 * (2 + 2) + reach * 3 * (3 + 6)),
        ([[0.5, 0, 0.25, 0, 0, 0], still], tip * 1.0 + 0.5),
    ]
    for (push, rate), wanted in cases:
        arm = moving([push, rate, PSM.middle])
        assert bound(arm)[3] == pytest.approx(wanted, rel=1e-6)


def test_what_slides_in_an_interval_makes_the_levers_longer():
    arm = moving([[1.0, 0, 0.04, 0, 0, 0], PSM.middle])
    longer, shorter = bound(arm, 0.0, 1.0), bound(arm)
    np.testing.assert_allclose(longer[1:] - shorter[1:], 0.02 + 0.02, rtol=1e-3)  # the middle is .02 m from both
