"""One suture, frame by frame: where needle and joints are along the primitive."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, ik_unbounded
from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.sutures.drive import Suture
from trocar.sutures.joints import unwound
from trocar.sutures.primitive import needle_poses, steps, tip_poses

OPEN_RAD = math.radians(40.0)
"""Between the fingers while they go back along the needle, drawn only."""


@dataclass(frozen=True, eq=False)
class SutureMotion:
    """A suture as it is drawn.

    Attributes:
        arm: whose.
        step: (k,) name of the primitive's step of each frame.
        q: (k, 6) joints, rad and m.
        T_world_tip: (k,) the arm's tip as the primitive wants it.
        T_world_needle: (k,) the needle.
        opening_rad: (k,) between the fingers.
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
            scale, unit = (1e3, "mm") if joint.prismatic else (180 / math.pi, "deg")
            left = min(value - joint.lower, joint.upper - value)
            shown = f"{scale * left:.0f}" if left >= 0 else f"**{scale * left:.0f} outside**"
            rows.append(
                f"| {joint.name.replace('_', ' ')} | {scale * value:.1f} {unit} | "
                f"{scale * joint.lower:.0f} to {scale * joint.upper:.0f} | {shown} |"
            )
        return "\n".join(rows)


def suture_motion(suture: Suture, frames_a_step: int = 16) -> SutureMotion:
    """Return one suture in so many frames for each step of the primitive.

    Raises:
        TrocarError: the arm has no joint values for some of it.
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
            f"the suture at {math.degrees(suture.theta_rad):.0f} deg cannot be drawn: arm '{setup.arm.name}' cannot "
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
