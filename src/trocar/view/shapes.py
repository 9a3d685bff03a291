"""Shapes of arms and needles as triangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel
from trocar.geometry import SE3
from trocar.sutures import Needle
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


def needle_arc_m(needle: Needle, corners: int = 49) -> NDArray[np.float64]:
    """Return the needle's centre line (k, 3) in its frame, from tip to tail."""
    angle = -np.linspace(0.0, needle.arc_rad, corners)
    return needle.radius_m * np.stack([np.sin(angle), -np.cos(angle), 0 * angle], -1)


def wire(needle: Needle) -> Mesh:
    """Return the needle, with a pointed tip, in its own frame."""
    line = needle_arc_m(needle)
    radii = np.full(len(line), needle.wire_m / 2)
    radii[:3] *= [0.05, 0.45, 0.85]
    return tube(line, radii, sides=12)
