"""How high fingers, wrist and shaft of an instrument stay above the tissue while it drives a needle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel
from trocar.geometry import SE3, SO3

JAW_OPEN_RAD = 0.40
"""An opening that clears the wire."""
FINGER, CLOSING = np.array([0.0, 0.0, -1.0]), np.array([-1.0, 0.0, 0.0])
"""In the frame of an arm's tip: along the jaws, and out of the plane in which they meet."""


def fingers_above_m(arm: ArmModel, T_circle_tip: SE3, opened: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the height (2, k) of the fingers' lowest corner above the tissue's plane.

    Args:
        arm: whose instrument.
        T_circle_tip: (2, k) poses of its tip at theta = 0; other positions only turn them about the vertical.
        opened: (k,) whether the jaws are open there, at some time.
    """
    closed, wide = (_lowest_m(arm, T_circle_tip, jaw) for jaw in (0.0, JAW_OPEN_RAD))
    return np.where(opened, np.minimum(closed, wide), closed)


def _lowest_m(arm: ArmModel, T_circle_tip: SE3, jaw_rad: float) -> NDArray[np.float64]:
    """Return the height (2, k) of the lowest corner of fingers with this opening."""
    x, y, z = np.concatenate(
        [arm.instrument.finger_m(side) @ SO3.axis("z", side * jaw_rad / 2).matrix.T for side in (1, -1)]
    ).T
    in_tip = np.stack([y, z, arm.tip_length_m - x])
    return T_circle_tip.matrix[..., 2, 3] + (T_circle_tip.matrix[..., 2, :3] @ in_tip).min(-1)


def above_tissue_m(
    arm: ArmModel, T_circle_tip: SE3, opened: NDArray[np.bool_], wrist_yaw_rad: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the least height (2, n) of the instrument above the tissue's plane along sutures; NaN counts as high.

    The wrist and the lower end of the shaft are a ball at the wrist's pitch axis, the boss of the jaws is one at their
    axis. Further up, the shaft rises to the port.

    Args:
        arm: whose instrument.
        T_circle_tip: as above.
        opened: as above.
        wrist_yaw_rad: (2, n, k) its last joint.
    """
    shape, up = arm.instrument, T_circle_tip.matrix[..., 2, :3]
    along, aside = (up @ FINGER)[:, None], (up @ CLOSING)[:, None]
    turned = wrist_yaw_rad + arm.offsets[5]
    yaw_axis = T_circle_tip.matrix[..., 2, 3][:, None] - arm.tip_length_m * along
    pitch_axis = yaw_axis - arm.wrist_length_m * (np.cos(turned) * along + np.sin(turned) * aside)
    wrist = np.fmin.reduce(pitch_axis, axis=-1) - max(shape.shaft_radius_m, shape.wrist_radius_m)
    jaws = np.minimum(fingers_above_m(arm, T_circle_tip, opened), yaw_axis[:, 0] - shape.knuckle_radius_m).min(-1)
    return np.fmin(jaws[:, None], wrist)
