"""The arm's joints along sutures all round the circle, in both directions, whether within the limits or not."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms import ArmModel, ik_unbounded, wrist_depth_m
from trocar.geometry import SE3, TURN
from trocar.geometry.arrays import finite
from trocar.tasks.suture.planning.primitive import path_samples, tip_poses
from trocar.tasks.suture.planning.setup import SutureSetup

LIMIT_TOLERANCE = 1e-9
INSERTION, ROLL = 2, 3


@dataclass(frozen=True, eq=False)
class SutureJoints:
    """Configurations of the arm along sutures.

    Attributes:
        arm: the arm.
        thetas_rad: (n,) positions on the circle.
        q: (2, n, k, 6) one row per direction of ``DIRECTIONS``, at the k samples of ``path_samples``; rad and m. NaN
            where the arm has no real solution. The roll is continuous, in the winding that stays nearest to the middle
            of its range.
        station: (k,) which samples are stations.
    """

    arm: ArmModel
    thetas_rad: NDArray[np.float64]
    q: NDArray[np.float64]
    station: NDArray[np.bool_]

    @cached_property
    def excess(self) -> NDArray[np.float64]:
        """Return how far each joint leaves its range at worst (2, n, 6), rad or m; infinite where q is NaN."""
        outside = np.maximum(self.arm.lower - self.q.min(2), self.q.max(2) - self.arm.upper)
        return np.where(np.isfinite(outside), np.maximum(outside, 0.0), np.inf)

    @cached_property
    def too_shallow_m(self) -> NDArray[np.float64]:
        """Return by how much (2, n) the wrist falls short of the safe depth at worst; infinite where q is NaN."""
        short_m = self.arm.safe_depth_m - wrist_depth_m(self.arm, self.q).min(2)
        return np.where(np.isfinite(short_m), np.maximum(short_m, 0.0), np.inf)

    @cached_property
    def feasible(self) -> NDArray[np.bool_]:
        """Return which sutures (2, n) keep all joints within their limits and the wrist at its safe depth."""
        return (self.excess <= LIMIT_TOLERANCE).all(-1) & (self.too_shallow_m <= LIMIT_TOLERANCE)

    @cached_property
    def largest_wrist_rad(self) -> NDArray[np.float64]:
        """Return the paper's q_max (2, n, 3): the largest |angle| of roll, wrist pitch and yaw at the stations."""
        return np.abs(self.q[:, :, self.station, 3:]).max(2)


def suture_joints(setup: SutureSetup, thetas_rad: ArrayLike) -> SutureJoints:
    """Return the joints along the sutures at these positions (n,), in both directions, in closed form.

    Raises:
        InvalidInput: a position is not finite.
    """
    thetas = np.atleast_1d(finite("positions of sutures", thetas_rad, ...))
    samples = path_samples(setup)
    # A suture at theta is the one at 0 rotated about the circle's axis, T_base_circle Rz(theta) T_circle_tip, and Rz is
    # linear in 1, cos and sin: a sum of three terms replaces two matrix products per sample and position.
    parts = np.zeros((3, 4, 4))
    parts[0, 2, 2] = parts[0, 3, 3] = parts[1, 0, 0] = parts[1, 1, 1] = parts[2, 1, 0] = 1.0
    parts[2, 0, 1] = -1.0
    at_zero = tip_poses(setup, samples.advance_m, samples.jaws_rad).matrix
    harmonics = (setup.T_base_circle.matrix @ parts)[:, None, None] @ at_zero
    turns = np.stack([np.ones_like(thetas), np.cos(thetas), np.sin(thetas)], -1)
    poses = turns @ np.moveaxis(harmonics.reshape(*harmonics.shape[:3], 16), 0, 2).swapaxes(0, 1)
    # samples are the outermost axis in memory, so that minima and maxima along a suture run over whole rows
    q = np.moveaxis(ik_unbounded(setup.arm, SE3.unchecked(poses.reshape(*poses.shape[:-1], 4, 4))), 0, 2)
    q[..., ROLL] = unwound(q[..., ROLL], setup.arm.middle_floats[ROLL])
    return SutureJoints(setup.arm, thetas, q, samples.station)


def unwound(roll: NDArray[np.float64], middle: float = 0.0, of: slice = slice(None)) -> NDArray[np.float64]:
    """Return roll (..., k) rad without jumps along its last axis, in the winding that stays nearest to the middle.

    The roll is known only up to whole turns; wrapped naively, it jumps at some positions (``facts/suture.md``).

    Args:
        roll: rad.
        middle: of the joint's range.
        of: the part of the last axis whose extremes decide.
    """
    roll = np.unwrap(roll, axis=-1)
    deciding = roll[..., of]
    center = (deciding.max(-1) + deciding.min(-1)) / 2
    return roll - TURN * np.rint((center - middle) / TURN)[..., None]
