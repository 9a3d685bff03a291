"""One suture, frame by frame: needle and joints along the primitive."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, ik_unbounded
from trocar.errors import TrocarError
from trocar.geometry import SE3, shown
from trocar.tasks.suture.planning.drive import Suture
from trocar.tasks.suture.planning.joints import unwound
from trocar.tasks.suture.planning.primitive import needle_poses, steps, tip_poses

OPEN_RAD = math.radians(40.0)
"""Opening of the jaws while they move back along the needle; for drawing only."""


@dataclass(frozen=True, eq=False)
class SutureMotion:
    """A suture as a sequence of frames to draw.

    Attributes:
        arm: the arm.
        step: (k,) name of the primitive's step in each frame.
        q: (k, 6) joints, rad and m.
        T_world_tip: (k,) pose of the arm's tip that the primitive asks for.
        T_world_needle: (k,) pose of the needle.
        opening_rad: (k,) opening of the jaws.
    """

    arm: ArmModel
    step: tuple[str, ...]
    q: NDArray[np.float64]
    T_world_tip: SE3
    T_world_needle: SE3
    opening_rad: NDArray[np.float64]

    def joint_table(self, place: int) -> str:
        """Return the joints at one frame as a Markdown table: value, range, distance to the nearer limit."""
        rows = ["| joint | value | range | to limit |", "|:--|--:|:-:|--:|"]
        for joint, value in zip(self.arm.joints, self.q[place].tolist(), strict=True):
            scale, _ = joint.shown_scale
            left = min(value - joint.lower, joint.upper - value)
            to_limit = f"{scale * left:.0f}" if left >= 0 else f"**{scale * left:.0f} outside**"
            rows.append(
                f"| {joint.name.replace('_', ' ')} | {joint.shown(value)} | "
                f"{scale * joint.lower:.0f} to {scale * joint.upper:.0f} | {to_limit} |"
            )
        return "\n".join(rows)


def suture_motion(suture: Suture, frames_a_step: int = 16) -> SutureMotion:
    """Return one suture with this number of frames for each step of the primitive.

    Raises:
        TrocarError: the arm has no solution for part of it.
    """
    setup, names, coordinates = suture.setup, [], []
    for step in steps(setup):
        names += [step] * frames_a_step
        ends = np.array([step.advance_m, step.jaws_rad, step.needle_rad])
        coordinates.append(np.linspace(ends[:, 0], ends[:, 1], frames_a_step))
    advance, jaws, needle = np.concatenate(coordinates).T
    T_world_tip = setup.circle.T_world_circle @ suture.turned(tip_poses(setup, advance, jaws))
    q = ik_unbounded(setup.arm, setup.T_world_base.inverse() @ T_world_tip)
    if not np.isfinite(q).all():
        raise TrocarError(
            f"the suture at {shown(suture.theta_rad, 'rad', '.0f')} cannot be drawn: arm '{setup.arm.name}' cannot "
            "point its instrument there; move the circle or the base"
        )
    q[:, 3] = unwound(q[:, 3], setup.arm.middle_floats[3])
    return SutureMotion(
        setup.arm,
        tuple(step.name for step in names),
        q,
        T_world_tip,
        setup.circle.T_world_circle @ suture.turned(needle_poses(setup, advance, needle)),
        np.array([0.0 if step.holds else OPEN_RAD for step in names]),
    )
