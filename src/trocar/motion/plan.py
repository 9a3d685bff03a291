"""A planned motion through waypoints, and the table of the planners that make one."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.arms import ArmModel, MotionLimits, fk
from trocar.errors import TrocarError
from trocar.motion.bound import duration_bound_s
from trocar.motion.limits import CHECK_STEP_S, limit_use, require_range
from trocar.motion.splines import spline
from trocar.trajectory import Trajectory

Planner = Callable[
    [ArmModel, NDArray[np.float64], MotionLimits, NDArray[np.float64]],
    tuple[Trajectory, NDArray[np.float64]],
]
"""``planner(arm, waypoints (n, joints), limits, up (3,))`` returns a trajectory from rest to rest through the
waypoints, within the limits, and the times (n,) at which it passes them."""

PLANNERS: dict[str, Planner] = {"spline": spline}

UP = (0.0, 0.0, 1.0)
NEAREST = 1e-9  # waypoints closer than this in every joint are the same


@dataclass(frozen=True, eq=False)
class Plan:
    """A motion through waypoints.

    Attributes:
        planner: name in ``PLANNERS``.
        waypoints: (n, joints), rad or m.
        trajectory: the motion, from rest to rest.
        waypoint_times_s: (n,) when it passes the waypoints.
        compute_ms: time the planner took.
    """

    planner: str
    waypoints: NDArray[np.float64]
    trajectory: Trajectory
    waypoint_times_s: NDArray[np.float64]
    compute_ms: float


@dataclass(frozen=True)
class PlanQuality:
    """How good a plan of a transfer is, all of it measured on the trajectory.

    Attributes:
        duration_s: from rest to rest.
        bound_s: no motion through the same waypoints is shorter (``duration_bound_s``).
        compute_ms: time the planner took.
        max_velocity_ratio: largest share of the velocity limits, at 1 kHz and at the knots.
        max_acceleration_ratio: the same of the acceleration limits.
        vertical_deviation_m: farthest that the tip leaves the vertical through the peg while it lifts and
            lowers.
        range_excess: by joint, how far it leaves its nominal range, rad or m; only joints that do.
    """

    duration_s: float
    bound_s: float
    compute_ms: float
    max_velocity_ratio: float
    max_acceleration_ratio: float
    vertical_deviation_m: float
    range_excess: dict[str, float]


def plan_through(
    arm: ArmModel,
    waypoints: ArrayLike,
    limits: MotionLimits,
    *,
    up: ArrayLike = UP,
    planner: str = "spline",
    range_slack: float = 0.0,
) -> Plan:
    """Return a short motion from rest to rest through the waypoints.

    The inner waypoints are passed along ``up``, without a stop. Two waypoints: a plain move. Three: approach from
    above (start, above, down) or retreat (grasp, above, away). Four: a transfer.

    Args:
        arm: the arm that moves.
        waypoints: (n, joints) with n >= 2, rad or m, within the joints' ranges.
        limits: bounds of velocity and acceleration.
        up: (3,) direction of the pegs in the arm's base frame, of any length.
        planner: name in ``PLANNERS``.
        range_slack: share of each joint's range by which it may be left, for recordings of arms whose real
            range is wider than the nominal one.

    Raises:
        TrocarError: bad waypoints, an unknown planner, or a motion that would leave a joint's range.
    """
    if planner not in PLANNERS:
        raise TrocarError(f"no planner is called '{planner}'; choose one of: {', '.join(PLANNERS)}")
    points = _checked_waypoints(arm, waypoints, range_slack)
    direction = _unit(up)
    begin = time.perf_counter()
    trajectory, passed_s = PLANNERS[planner](arm, points, limits, direction)
    compute_ms = 1e3 * (time.perf_counter() - begin)
    require_range(arm, trajectory, range_slack)
    return Plan(planner, points, trajectory, passed_s, compute_ms)


def plan_transfer(
    arm: ArmModel,
    waypoints: ArrayLike,
    limits: MotionLimits,
    *,
    up: ArrayLike = UP,
    planner: str = "spline",
    range_slack: float = 0.0,
) -> Plan:
    """Return a transfer: ``plan_through`` for grasp, lifted, over the target, lowered, as (4, joints)."""
    shape = np.shape(waypoints)
    if shape != (4, len(arm.joints)):
        raise TrocarError(
            f"a transfer needs waypoints of shape (4, {len(arm.joints)}): grasp, lifted, over, lowered; got {shape}"
        )
    return plan_through(arm, waypoints, limits, up=up, planner=planner, range_slack=range_slack)


def assess_transfer(arm: ArmModel, plan: Plan, limits: MotionLimits, *, up: ArrayLike = UP) -> PlanQuality:
    """Return the quality of a planned transfer: duration beside the bound, limits, uprightness."""
    use = limit_use(arm, plan.trajectory, limits)
    return PlanQuality(
        duration_s=plan.trajectory.duration_s,
        bound_s=duration_bound_s(plan.waypoints, limits),
        compute_ms=plan.compute_ms,
        max_velocity_ratio=use.velocity_ratio,
        max_acceleration_ratio=use.acceleration_ratio,
        vertical_deviation_m=_vertical_deviation_m(arm, plan, _unit(up)),
        range_excess={j.name: float(e) for j, e in zip(arm.joints, use.range_excess, strict=True) if e > 0},
    )


def _vertical_deviation_m(arm: ArmModel, plan: Plan, up: NDArray[np.float64]) -> float:
    """Return how far the tip strays from the verticals through the grasp (lifting) and target (lowering)."""
    passed = plan.waypoint_times_s
    deviations = []
    for begin, end, foot in ((passed[0], passed[1], 0), (passed[-2], passed[-1], -1)):
        times = np.linspace(begin, end, int(np.ceil((end - begin) / CHECK_STEP_S)) + 1)
        tips = fk(arm, plan.trajectory(times)).translation_m
        off = tips - fk(arm, plan.waypoints[foot]).translation_m
        deviations.append(np.linalg.norm(off - (off @ up)[:, None] * up, axis=1).max())
    return float(max(deviations))


def _checked_waypoints(arm: ArmModel, waypoints: ArrayLike, range_slack: float) -> NDArray[np.float64]:
    """Return the waypoints as (n, joints), or raise with what is wrong with them."""
    points = np.asarray(waypoints, dtype=np.float64)
    joints = arm.joints
    if points.ndim != 2 or points.shape[1] != len(joints) or len(points) < 2:
        raise TrocarError(
            f"{arm.name} needs waypoints of shape (n, {len(joints)}) with n of 2 or more, got {points.shape}"
        )
    for index, point in enumerate(points):
        for joint, value in zip(joints, point, strict=True):
            if not np.isfinite(value):
                raise TrocarError(f"waypoint {index}, joint '{joint.name}' is {value}; give a finite number")
            slack = range_slack * (joint.upper - joint.lower)
            if not joint.lower - slack <= value <= joint.upper + slack:
                raise TrocarError(
                    f"waypoint {index}, joint '{joint.name}' = {value:.4f} {joint.unit} is outside "
                    f"[{joint.lower:.4f}, {joint.upper:.4f}] {joint.unit} of {arm.name}; move it inside"
                )
    same = np.flatnonzero(np.all(np.abs(np.diff(points, axis=0)) < NEAREST, axis=1))
    if len(same):
        raise TrocarError(f"waypoints {same[0]} and {same[0] + 1} coincide; remove one of them")
    return points


def _unit(up: ArrayLike) -> NDArray[np.float64]:
    """Return the direction as a unit vector (3,)."""
    direction = np.asarray(up, dtype=np.float64)
    if direction.shape != (3,) or not np.isfinite(direction).all() or not np.linalg.norm(direction) > 0:
        raise TrocarError(f"the upward direction needs three finite numbers that are not all 0, got {up}")
    return direction / np.linalg.norm(direction)
