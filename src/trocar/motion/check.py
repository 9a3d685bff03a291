"""The independent check of a planner's answer, the same for all planners."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from trocar.errors import InvalidInput, LimitExceeded, MotionRefused, NoPlan, OutOfReach, TooNear
from trocar.geometry import shown
from trocar.motion.arm_motion import ArmMotion
from trocar.motion.clearance import Clearance, swept_clearance
from trocar.motion.limits import KEPT, LimitUse, knot_jumps, limit_use
from trocar.motion.moving_arm import MovingArm
from trocar.motion.path import TimedPath
from trocar.motion.planners import Demand
from trocar.motion.problem import MotionProblem
from trocar.motion.tip import tip_use
from trocar.motion.tolerances import line_deviation

REACHED = 1e-6
"""How far (rad, m, and per second) a motion may miss a waypoint, its start, its rest, or itself at a knot."""

TIP_KEPT = 1 + 1e-6
"""The speed limit of the tip counts as kept up to this factor, since the speed is a difference quotient."""

ROUNDED = 1e-9
"""By how much a tolerance (m, rad) may be exceeded."""

DISTANCE_M = 1e-5
"""Accuracy of the least distance: a planner that stops exactly at the limit keeps it."""


@dataclass(frozen=True)
class Violation:
    """A requirement that is violated.

    Attributes:
        demand: which one.
        error: by how much, as a typed error.
    """

    demand: Demand
    error: MotionRefused

    def __str__(self) -> str:
        return str(self.error)


@dataclass(frozen=True, eq=False)
class Check:
    """What the check found.

    Attributes:
        use: what each arm uses of its limits.
        clearance: the least distance between arms and to obstacles.
        violations: every violated requirement, worst kind first within each arm.
    """

    use: Mapping[str, LimitUse]
    clearance: Clearance
    violations: tuple[Violation, ...]


def check(problem: MotionProblem, paths: Mapping[str, TimedPath]) -> Check:
    """Return which limits the paths, one for each arm of the problem, use, and which requirements they violate.

    Limits, ranges and straightness at 1 kHz and on both sides of all knots, distances by a bound that also
    holds between samples.

    Raises:
        TrocarError: the answer is malformed: no path of an arm, or one of another number of waypoints.
    """
    _require_shape(problem, paths)
    use = {name: limit_use(arm.model, paths[name].trajectory, arm.limits) for name, arm in problem.arms.items()}
    violations: list[Violation] = []
    for name, arm in problem.arms.items():
        violations += _waypoints(name, arm, paths[name])
        violations += _limits(name, arm, use[name], problem.range_slack)
        violations += _straight(name, arm, paths[name], problem)
        violations += _tip(name, arm, paths[name])
    clearance = _clearance(problem, paths)
    if clearance.distance_m < problem.min_distance_m - DISTANCE_M:
        violations.append(Violation(Demand.DISTANCES, _too_near(clearance, problem.min_distance_m)))
    return Check(use, clearance, tuple(violations))


def _require_shape(problem: MotionProblem, paths: Mapping[str, TimedPath]) -> None:
    for name, arm in problem.arms.items():
        path, count = paths[name], len(arm.waypoints)
        joints = path.trajectory.coefficients.shape[2]
        if joints != len(arm.model.joints):
            raise InvalidInput(
                "a planner", f"returned {joints} joints for arm '{name}'", f"it has {len(arm.model.joints)}"
            )
        times = path.waypoint_times_s
        if times.shape != (count,) or not np.isfinite(times).all() or np.any(np.diff(times) < 0):
            raise InvalidInput(
                f"a planner returned {times.tolist()} s for the {count} waypoints",
                f"of arm '{name}'",
                "it must say when each is passed, in order",
            )
        starts_s = float(path.trajectory.times_s[0]), float(times[0])
        if starts_s != (0.0, 0.0):
            raise InvalidInput("a planner's motion", f"of arm '{name}' starts at {max(starts_s)} s", "all start at 0")


def _waypoints(name: str, arm: ArmMotion, path: TimedPath) -> Iterator[Violation]:
    """Yield violations of the start, the waypoints, the rest at the end and the continuity of a path."""
    q, last = path.trajectory, path.trajectory.duration_s
    times = np.array([0.0, *path.waypoint_times_s[1:], last])
    off = np.abs(q(times) - np.concatenate([arm.waypoints, arm.waypoints[-1:]])).max(axis=1)
    for row in np.flatnonzero(off > REACHED).tolist():
        where = f"misses waypoint {row} at {times[row]:.3f} s" if 0 < row < len(off) - 1 else "is off its waypoint"
        where += {0: " at the start", len(off) - 1: " at the end"}.get(row, "")
        yield Violation(Demand.WAYPOINTS, NoPlan(f"'{name}' {where} by {off[row]:.6f} rad or m"))
    velocity_off = {
        "starts with a velocity that is off by": np.abs(q(0.0, 1) - arm.start_velocity).max(),
        "does not rest at the end but moves with": np.abs(q(np.nextafter(last, 0.0), 1)).max(),
        "jumps in velocity at a knot, by": knot_jumps(q, 1).max(initial=0.0),
    }
    for what, by in velocity_off.items():
        if by > REACHED:
            yield Violation(Demand.WAYPOINTS, NoPlan(f"'{name}' {what} {by:.6f} per second"))
    jump = knot_jumps(q, 0).max(initial=0.0)
    if jump > REACHED:
        yield Violation(Demand.WAYPOINTS, NoPlan(f"'{name}' jumps at a knot, by {jump:.6f} rad or m"))


def _limits(name: str, arm: ArmMotion, use: LimitUse, range_slack: float) -> Iterator[Violation]:
    """Yield violations of the joints' limits and ranges."""
    shares = ((Demand.LIMITS, "velocity"), (Demand.LIMITS, "acceleration"), (Demand.JERK, "jerk"))
    for demand, what in shares:
        share = getattr(use, what)
        if share.max() > KEPT:
            joint = arm.model.joints[int(np.argmax(share))].name
            sentence = f"joint '{joint}' of '{name}' uses {share.max():.3f} of its {what} limit"
            yield Violation(demand, LimitExceeded(sentence, arm=name, ratio=float(share.max())))
    for joint, excess in zip(arm.model.joints, use.range_excess, strict=True):
        if excess > range_slack * (joint.upper - joint.lower) + ROUNDED:
            sentence = (
                f"joint '{joint.name}' of '{name}' goes {excess:.4f} {joint.unit} out of its range "
                f"[{joint.lower:.4f}, {joint.upper:.4f}] between the waypoints"
            )
            yield Violation(Demand.RANGES, OutOfReach(sentence, arm=name, joint=joint.name, by=float(excess)))


def _straight(name: str, arm: ArmMotion, path: TimedPath, problem: MotionProblem) -> Iterator[Violation]:
    """Yield which of the pieces that must be straight are not."""
    for piece in np.flatnonzero(arm.straight).tolist():
        off_m, off_rad = line_deviation(arm, path, piece)
        if off_m > problem.straight_tolerance_m:
            off, allowed = (shown(value, "m", ".3f") for value in (off_m, problem.straight_tolerance_m))
            sentence = f"the tip of '{name}' strays {off} from its straight piece {piece}, not {allowed}"
            yield Violation(Demand.STRAIGHT, NoPlan(sentence))
        if off_rad > problem.straight_tolerance_rad:
            allowed = f"{problem.straight_tolerance_rad:.4f} rad"
            sentence = f"the tip of '{name}' turns {off_rad:.4f} rad aside on its straight piece {piece}, not {allowed}"
            yield Violation(Demand.STRAIGHT, NoPlan(sentence))


def _tip(name: str, arm: ArmMotion, path: TimedPath) -> Iterator[Violation]:
    """Yield violations where the tip is too fast or does not face what it should; at 50 Hz and at all knots."""
    speed, angle = tip_use(arm, path.trajectory)
    if speed > TIP_KEPT * arm.max_tip_m_s:
        sentence = f"the tip of '{name}' moves at up to {speed:.4f} m/s, not {arm.max_tip_m_s:.4f}"
        yield Violation(Demand.TIP_SPEED, LimitExceeded(sentence, arm=name, ratio=speed / arm.max_tip_m_s))
    if arm.facing is not None and angle > arm.facing.max_rad + ROUNDED:
        sentence = f"the tip of '{name}' faces aside by up to {angle:.4f} rad, not {arm.facing.max_rad:.4f}"
        yield Violation(Demand.FACING, NoPlan(sentence))


def _clearance(problem: MotionProblem, paths: Mapping[str, TimedPath]) -> Clearance:
    """Return how near arms and obstacles come, from the common start until all arms rest."""
    arms = {
        name: MovingArm(arm.model, paths[name].trajectory, arm.T_world_base, jaw_rad=arm.jaw_rad)
        for name, arm in problem.arms.items()
    }
    last_s = max(arm.end_s for arm in (*arms.values(), *problem.others.values()))
    return swept_clearance(
        arms,
        others=problem.others,
        obstacles=problem.obstacles,
        span_s=(0.0, last_s),
        enough_m=problem.min_distance_m,
        resolution_m=DISTANCE_M,
    )


def _too_near(clearance: Clearance, min_distance_m: float) -> TooNear:
    a, b = clearance.between
    near = shown(max(0.0, clearance.distance_m), "m", ".2f")
    how = "overlaps" if clearance.sampled_m <= 0 else f"may come within {near} of"
    return TooNear(
        f"{a} {how} {b} at {clearance.time_s:.3f} s; {shown(min_distance_m, 'm', '.2f')} were to be kept",
        first=a,
        second=b,
        distance_m=clearance.distance_m,
        required_m=min_distance_m,
        arms=clearance.arms,
    )
