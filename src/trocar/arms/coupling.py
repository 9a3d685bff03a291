"""Actuator and joint angles of an instrument, which cables over shared pulleys couple."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms.model import ArmModel
from trocar.errors import InvalidInput
from trocar.geometry.arrays import finite


def joints_from_actuators(arm: ArmModel, actuators_rad: ArrayLike) -> NDArray[np.float64]:
    """Return roll, wrist pitch, wrist yaw and jaw (..., 4) from the four disks' angles (..., 4), rad.

    Raises:
        TrocarError: the arm's coupling is unknown, or the angles have another shape or are not finite.
    """
    return _four(arm, actuators_rad, "actuator angles") @ _matrix(arm).T


def actuators_from_joints(arm: ArmModel, joints_rad: ArrayLike) -> NDArray[np.float64]:
    """Return the four disks' angles (..., 4) from roll, wrist pitch, wrist yaw and jaw (..., 4), rad.

    Raises:
        TrocarError: the arm's coupling is unknown, or the angles have another shape or are not finite.
    """
    return _four(arm, joints_rad, "joint angles") @ np.linalg.inv(_matrix(arm)).T


def _matrix(arm: ArmModel) -> NDArray[np.float64]:
    if arm.coupling is None:
        raise InvalidInput(f"arm '{arm.name}'", "has no actuator coupling", "set ArmModel.coupling")
    return np.array(arm.coupling)


def _four(arm: ArmModel, values: ArrayLike, what: str) -> NDArray[np.float64]:
    return finite(f"{what} of arm '{arm.name}'", values, ..., 4)
