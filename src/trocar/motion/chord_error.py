"""How far the parts of a moving arm can deviate from straight lines between samples."""

from __future__ import annotations

from math import factorial

import numpy as np
from numpy.typing import NDArray

from trocar.arms import SOLIDS, ArmModel, wrist_depth_m
from trocar.motion.moving_arm import MovingArm

INSERTION = 2
"""Index of the joint that slides; all axes before it and the roll after it pass through the remote centre."""


def greatest_accelerations(
    arm: MovingArm, begin_s: NDArray[np.float64], end_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return bounds on the acceleration of every point of the instrument's capsules: (n, 4) m/s^2.

    Over an interval of length h between two samples, a point is never further than ``h^2 / 8`` times this from the
    straight line between its sampled positions, so nothing is hidden between samples.

    With ``l_k`` the greatest distance of the point from the axis of joint k (1 for the joint that slides), each
    joint adds ``l_k (|a_k| + |v_k| (|v_k| + 2 sum of |v_j| over the joints j before it))``, where only revolute joints
    count among the velocities in brackets, because they rotate the motion of the joints after them.

    Args:
        arm: on its trajectory.
        begin_s: (n,) starts of the intervals; none holds a knot of the trajectory inside.
        end_s: (n,) their ends.
    """
    middle, half = (begin_s + end_s) / 2, (end_s - begin_s)[:, None] / 2
    speed, push = _greatest_rates(arm, middle, half)
    turning = speed.copy()
    turning[:, INSERTION] = 0.0
    before = np.cumsum(turning, axis=1) - turning
    depth = np.abs(wrist_depth_m(arm.model, arm.joints(middle)))
    levers = _levers(arm.model, depth, speed[:, INSERTION] * half[:, 0])
    return np.einsum("nkj,nj->nk", levers, push + speed * (turning + 2 * before))


def _greatest_rates(
    arm: MovingArm, middle_s: NDArray[np.float64], half_s: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return bounds (n, 6) of the joints' speeds and accelerations over intervals, from finite Taylor series.

    Between two knots a trajectory is a polynomial, so the series about the middle ends at its degree.
    """
    orders = [np.abs(arm.joints(middle_s, order)) for order in range(1, len(arm.trajectory.coefficients))]
    factors = [half_s**k / factorial(k) for k in range(len(orders))]
    still = np.zeros((len(middle_s), len(arm.model.joints)))
    speed = sum((f * order for f, order in zip(factors, orders, strict=True)), still)
    push = sum((f * order for f, order in zip(factors, orders[1:], strict=False)), still)
    return speed, push


def _levers(arm: ArmModel, depth_m: NDArray[np.float64], slid_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the greatest distances of the capsules' points from the joints' axes over intervals: (n, 4, 6).

    The axes of yaw, pitch and roll pass through the remote centre, and the shaft lies on the axis of the roll.

    Args:
        arm: whose instrument.
        depth_m: (n,) of the wrist beyond the remote centre, in the middle.
        slid_m: (n,) how far the insertion can move from there.
    """
    wrist, finger = arm.wrist_length_m, arm.instrument.finger_length_m
    lower = depth_m + slid_m
    upper = np.abs(arm.instrument.shaft_length_m - depth_m) + slid_m
    levers = np.zeros((len(depth_m), len(SOLIDS), len(arm.joints)))
    levers[:, :, INSERTION] = 1.0
    for k, reach_m in enumerate((0.0, wrist, wrist + finger, wrist + finger)):  # from the wrist's pitch axis
        levers[:, k, :INSERTION] = (np.maximum(lower, upper) if k == 0 else lower + reach_m)[:, None]
        levers[:, k, 3:5] = reach_m
    levers[:, 2:, 5] = finger
    return levers
