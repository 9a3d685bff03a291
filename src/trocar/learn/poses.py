"""Poses of tips as in dVRK data sets: position, quaternion xyzw and jaw of each arm, in metres and rad.

Poses are in the world, by the registered base of each arm. A quaternion and its negative are the same rotation. In the
first quaternion of an episode, where arms are parked, the largest component is positive; each later one has the sign
that is nearer to the one before. So episodes do not differ by signs, and numbers do not jump.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, fk, ik
from trocar.errors import OutOfReach
from trocar.geometry import SE3, SO3, steady

WIDTH = 8
"""Numbers per arm."""
_PARTS = (*(f"position.{axis}" for axis in "xyz"), *(f"orientation.{axis}" for axis in "xyzw"))


def state_names(arms: Sequence[str]) -> list[str]:
    """Return the names of measured numbers, as in Open-H's dVRK data sets."""
    return [name for arm in arms for name in (*(f"{arm}_pose.{part}" for part in _PARTS), f"{arm}_jaw")]


def action_names(arms: Sequence[str]) -> list[str]:
    """Return the names of set-points' numbers, as in Open-H's dVRK data sets."""
    return [name for arm in arms for name in (*(f"{arm}_sp.{part}" for part in _PARTS), f"{arm}_jaw_sp")]


def turn_beside(xyzw: NDArray[np.float64], before: NDArray[np.float64] | None) -> NDArray[np.float64]:
    """Return a quaternion (4,) or its negative: the one nearer to ``before``; None: with its largest part positive."""
    side = xyzw[np.abs(xyzw).argmax()] if before is None else before @ xyzw
    return -xyzw if side < 0 else xyzw


def vectors(arm: ArmModel, T_world_base: SE3, rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the numbers (n, 8) of one arm from joints and jaw (n, 7)."""
    tip = T_world_base @ fk(arm, rows[:, :6])
    quaternions = steady(tip.rotation.as_quaternion())
    if quaternions[0, np.abs(quaternions[0]).argmax()] < 0:
        quaternions = -quaternions
    return np.column_stack([tip.translation_m, quaternions[:, [1, 2, 3, 0]], rows[:, 6]])


def joints(arm: ArmModel, T_world_base: SE3, values: NDArray[np.float64], start: NDArray[np.float64]) -> NDArray:
    """Return joints and jaw (n, 7) from the numbers (n, 8) of one arm, each solution near the one before.

    Args:
        arm: the robot type.
        T_world_base: pose of its base.
        values: as :func:`vectors` returns them.
        start: (6,) joints near the first solution.

    Raises:
        OutOfReach: a pose has no solution within the limits; says which one.
        InvalidInput: a quaternion is zero.
    """
    tips = T_world_base.inverse() @ SE3.from_parts(SO3.from_quaternion(values[:, [6, 3, 4, 5]]), values[:, :3])
    found = np.empty((len(values), 7))
    for row in range(len(values)):
        try:
            start = found[row, :6] = ik(arm, tips[row], start)
        except OutOfReach as error:
            raise error.worded(f"frame {row}: {error}") from None
    found[:, 6] = values[:, 7]
    return found
