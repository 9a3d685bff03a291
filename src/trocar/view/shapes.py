"""Shapes of arms as triangles."""

from __future__ import annotations

import numpy as np

from trocar.arms import ArmModel
from trocar.geometry import SE3
from trocar.view.mesh import Mesh, hull, tube


def shaft(arm: ArmModel) -> Mesh:
    """Return the instrument's shaft in frame 4, from the wrist back towards the remote centre."""
    back = np.array([0.0, 0.0, arm.wrist_sign])
    return tube([0 * back, arm.instrument.shaft_length_m * back], arm.instrument.shaft_radius_m)


def wrist_link(arm: ArmModel) -> Mesh:
    """Return the piece between wrist pitch and yaw in frame 5."""
    return tube([[0.0, 0.0, 0.0], [arm.wrist_length_m, 0.0, 0.0]], arm.instrument.wrist_radius_m)


def finger(arm: ArmModel) -> Mesh:
    """Return one finger in a frame on the jaw axis, whose -z it points along; it closes against the plane x = 0."""
    T_jaw_joint = SE3(np.array([[0.0, 1, 0, 0], [0, 0, -1, 0], [-1, 0, 0, 0], [0, 0, 0, 1]]))
    return hull(T_jaw_joint.apply(arm.instrument.finger_m(1)))
