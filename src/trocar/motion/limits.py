"""Does a trajectory keep its limits? Checked between the knots too, where splines misbehave."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, MotionLimits
from trocar.errors import TrocarError
from trocar.trajectory import Trajectory

CHECK_STEP_S = 1e-3  # ten times finer than the control period of the dVRK, 10 ms
KEPT = 1 + 1e-9  # a ratio up to this counts as kept: planners stop at the limit itself, and floats round


@dataclass(frozen=True, eq=False)
class LimitUse:
    """The largest share of each limit that a trajectory uses; 1 is the limit.

    Attributes:
        velocity_ratio: over all joints and times.
        acceleration_ratio: over all joints and times, on both sides of every knot.
        range_excess: (joints,) how far each joint leaves its range, rad or m; 0 inside.
    """

    velocity_ratio: float
    acceleration_ratio: float
    range_excess: NDArray[np.float64]

    @property
    def kept(self) -> bool:
        """Return whether every limit is kept."""
        return self.velocity_ratio <= KEPT and self.acceleration_ratio <= KEPT and not self.range_excess.any()


def limit_use(arm: ArmModel, trajectory: Trajectory, limits: MotionLimits) -> LimitUse:
    """Return how much of the arm's limits the trajectory uses, at 1 kHz and on both sides of every knot."""
    times = trajectory.times_s
    grid = np.arange(times[0], times[-1], CHECK_STEP_S)
    q, v, a = (
        np.concatenate([trajectory(grid, order), _left_limits(trajectory, order), trajectory(times[:-1], order)])
        for order in (0, 1, 2)
    )
    return LimitUse(
        velocity_ratio=float(np.max(np.abs(v) / limits.velocity)),
        acceleration_ratio=float(np.max(np.abs(a) / limits.acceleration)),
        range_excess=np.maximum(np.maximum(arm.lower - q, q - arm.upper), 0.0).max(axis=0),
    )


def require_range(arm: ArmModel, trajectory: Trajectory, slack: float = 0.0) -> None:
    """Raise if a joint leaves its range, widened by the share ``slack``, anywhere on the trajectory."""
    unlimited = MotionLimits(np.full(len(arm.joints), np.inf), np.full(len(arm.joints), np.inf))
    use = limit_use(arm, trajectory, unlimited)
    for joint, excess in zip(arm.joints, use.range_excess, strict=True):
        if excess > slack * (joint.upper - joint.lower):
            raise TrocarError(
                f"the planned motion takes joint '{joint.name}' {excess:.4f} {joint.unit} out of its range "
                f"[{joint.lower:.4f}, {joint.upper:.4f}] between the waypoints; move the waypoints inwards"
            )


def _left_limits(trajectory: Trajectory, order: int) -> NDArray[np.float64]:
    """Return the derivative at the end of every piece, seen from within the piece: (pieces, joints)."""
    coefficients = trajectory.coefficients
    step = np.diff(trajectory.times_s)[:, None]
    powers = np.arange(len(coefficients) - 1, -1, -1)
    value = np.zeros(coefficients.shape[1:])
    for power, c in zip(powers, coefficients, strict=True):
        if power >= order:
            factor = np.prod(np.arange(power - order + 1, power + 1))
            value = value + factor * c * step ** (power - order)
    return value
