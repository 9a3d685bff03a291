"""The joints of the arm along sutures all round the circle, in both directions, within the limits or not."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms import ArmModel, ik_unbounded, wrist_depth_m
from trocar.sutures.primitive import places, tip_poses, turned_to
from trocar.sutures.setup import SutureSetup

LIMIT_TOLERANCE = 1e-9
ROLL = 3


@dataclass(frozen=True, eq=False)
class SutureJoints:
    """Configurations along sutures.

    Attributes:
        arm: whose.
        thetas_rad: (n,) positions on the circle.
        q: (2, n, k, 6) one row a direction of ``DIRECTIONS``; k places along the suture as ``places`` lists
            them; rad and m. NaN where the arm has no real solution. The roll runs on without jumps, in the winding
            whose largest value is least.
        station: (k,) which places are stations.
    """

    arm: ArmModel
    thetas_rad: NDArray[np.float64]
    q: NDArray[np.float64]
    station: NDArray[np.bool_]

    @cached_property
    def excess(self) -> NDArray[np.float64]:
        """Return how far each joint leaves its range at its worst (2, n, 6), rad or m; infinite where q is NaN."""
        outside = np.maximum(self.arm.lower - self.q, self.q - self.arm.upper).max(2)
        return np.where(np.isfinite(outside), np.maximum(outside, 0.0), np.inf)

    @cached_property
    def too_shallow_m(self) -> NDArray[np.float64]:
        """Return how far (2, n) the wrist comes too near to the remote centre at its worst."""
        lacking = self.arm.safe_depth_m - wrist_depth_m(self.arm, self.q).min(2)
        return np.where(np.isfinite(lacking), np.maximum(lacking, 0.0), np.inf)

    @cached_property
    def feasible(self) -> NDArray[np.bool_]:
        """Return which sutures (2, n) keep all joints within their limits and the wrist at its safe depth."""
        return (self.excess <= LIMIT_TOLERANCE).all(-1) & (self.too_shallow_m <= LIMIT_TOLERANCE)

    @cached_property
    def largest_wrist_rad(self) -> NDArray[np.float64]:
        """Return q_max of the paper (2, n, 3): the largest |angle| of roll, wrist pitch and yaw at the stations."""
        return np.abs(self.q[:, :, self.station, 3:]).max(2)


def suture_joints(setup: SutureSetup, thetas_rad: ArrayLike) -> SutureJoints:
    """Return the joints along the sutures at these positions (n,), both directions, in closed form."""
    thetas = np.atleast_1d(np.asarray(thetas_rad, dtype=np.float64))
    along = places(setup)
    T_base_tip = setup.T_base_circle @ turned_to(tip_poses(setup, along.advance_m, along.jaws_rad), thetas)
    q = ik_unbounded(setup.arm, T_base_tip)
    q[..., ROLL] = unwound(q[..., ROLL], setup.arm.middle_floats[ROLL])
    return SutureJoints(setup.arm, thetas, q, along.station)


def unwound(roll: NDArray[np.float64], middle: float = 0.0) -> NDArray[np.float64]:
    """Return roll (..., k) rad without jumps along its last axis, in the winding that stays nearest to the middle.

    The roll is known up to whole turns alone; wrapped naively, it jumps at some positions (``facts/suture.md``).
    """
    roll = np.unwrap(roll, axis=-1)
    center = (roll.max(-1) + roll.min(-1)) / 2
    return roll - 2 * np.pi * np.rint((center - middle) / (2 * np.pi))[..., None]
