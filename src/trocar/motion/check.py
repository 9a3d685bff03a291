"""The independent check of a planner's answer, the same for all planners."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import inf

import numpy as np

from trocar.arms import fk
from trocar.checks import small
from trocar.errors import InvalidInput, LimitExceeded, MotionRefused, NoPlan, OutOfReach, TooNear
from trocar.geometry import SE3, SO3, shown
from trocar.geometry.arrays import Array
from trocar.motion.clearance import Clearance, clearance_of
from trocar.motion.limits import CHECK_STEP_S, KEPT, LimitUse, knot_jumps, limit_use
from trocar.motion.planners import Demand, TimedPath
from trocar.motion.problem import ArmMotion, MotionProblem
from trocar.trajectory import Trajectory

REACHED = 1e-6  # how far (rad, m, per second) a waypoint, start or rest may be missed, and a knot may jump
TIP_KEPT = 1 + 1e-6  # a tip's speed limit counts as kept up to this factor: the speed is a difference quotient
ROUNDED = 1e-9  # by how much a tolerance (m, rad) may be exceeded
DISTANCE_M = 1e-5  # a distance may fall short by this: a planner may stop exactly at the limit
SHORT_M = 1e-6  # a piece whose ends are closer only rotates; the rotation then tells how much of it is done
TIP_STEP_S = 0.02  # time between samples of the tip
WIDTH = 1e-6  # half step (rad, m) of the difference quotient for the tip's speed


@dataclass(frozen=True)
class Violation:
    """A requirement that is violated, and by how much, as a typed error."""

    demand: Demand
    error: MotionRefused

    def __str__(self) -> str:
        return str(self.error)


@dataclass(frozen=True, eq=False)
class Check:
    """What the check found."""

    use: Mapping[str, LimitUse]  # what each arm uses of its limits
    clearance: Clearance  # the least distance between arms and to obstacles
    violations: tuple[Violation, ...]  # every violated requirement, worst kind first within each arm


def check(problem: MotionProblem, paths: Mapping[str, TimedPath]) -> Check:
    """Check the paths, one for each arm: what they use of the limits, and which requirements they violate.

    Limits and ranges are checked at 1 kHz and on both sides of all knots, straightness at 1 kHz, the tip's speed and
    facing at 50 Hz and at all knots, distances by a bound that also holds between samples.

    Raises:
        TrocarError: a path has the wrong number of joints or of waypoints, or does not start at 0.
    """
    _require_shape(problem, paths)
    use = {name: limit_use(arm.model, paths[name].trajectory, arm.limits) for name, arm in problem.arms.items()}
    violations: list[Violation] = []
    for name, arm in problem.arms.items():
        violations += _waypoints(name, arm, paths[name])
        violations += _limits(name, arm, use[name], problem.range_slack)
        violations += _straight(name, arm, paths[name], problem)
        violations += _tip(name, arm, paths[name])
    clearance = clearance_of(problem, [paths[name].trajectory for name in problem.arms], DISTANCE_M)
    if clearance.distance_m < problem.min_distance_m - DISTANCE_M:
        violations.append(Violation(Demand.DISTANCES, _too_near(clearance, problem.min_distance_m)))
    return Check(use, clearance, tuple(violations))


def _require_shape(problem: MotionProblem, paths: Mapping[str, TimedPath]) -> None:
    for name, arm in problem.arms.items():
        path, count = paths[name], len(arm.waypoints)
        joints, wanted = path.trajectory.coefficients.shape[2], len(arm.model.joints)
        if joints != wanted:
            raise InvalidInput("a planner", f"returned {joints} joints for arm '{name}'", f"it has {wanted}")
        times = path.waypoint_times_s
        if times.shape != (count,) or not np.isfinite(times).all() or np.any(np.diff(times) < 0):
            told = f"a planner returned {times.tolist()} s for the {count} waypoints"
            raise InvalidInput(told, f"of arm '{name}'", "it must say when each is passed, in order")
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
    for demand, what in ((Demand.LIMITS, "velocity"), (Demand.LIMITS, "acceleration"), (Demand.JERK, "jerk")):
        share = getattr(use, what)
        if share.max() > KEPT:
            joint = arm.model.joints[int(np.argmax(share))].name
            sentence = f"joint '{joint}' of '{name}' uses {share.max():.3f} of its {what} limit"
            yield Violation(demand, LimitExceeded(sentence, arm=name, ratio=float(share.max())))
    for joint, excess in zip(arm.model.joints, use.range_excess, strict=True):
        if excess > range_slack * (joint.upper - joint.lower) + ROUNDED:
            sentence = (
                f"joint '{joint.name}' of '{name}' goes {small(excess)} {joint.unit} out of its range "
                f"[{joint.lower:.4f}, {joint.upper:.4f}] between the waypoints"
            )
            yield Violation(Demand.RANGES, OutOfReach(sentence, arm=name, joint=joint.name, by=float(excess)))


def _straight(name: str, arm: ArmMotion, path: TimedPath, problem: MotionProblem) -> Iterator[Violation]:
    """Yield violations of the pieces that must be straight."""
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
    """Yield violations where the tip is too fast or does not face what it should."""
    speed, angle = tip_use(arm, path.trajectory)
    if speed > TIP_KEPT * arm.max_tip_m_s:
        sentence = f"the tip of '{name}' moves at up to {speed:.4f} m/s, not {arm.max_tip_m_s:.4f}"
        yield Violation(Demand.TIP_SPEED, LimitExceeded(sentence, arm=name, ratio=speed / arm.max_tip_m_s))
    if arm.facing is not None and angle > arm.facing.max_rad + ROUNDED:
        sentence = f"the tip of '{name}' faces aside by up to {angle:.4f} rad, not {arm.facing.max_rad:.4f}"
        yield Violation(Demand.FACING, NoPlan(sentence))


def _too_near(clearance: Clearance, min_distance_m: float) -> TooNear:
    a, b = clearance.between
    near, wanted = (shown(max(0.0, value), "m", ".2f") for value in (clearance.distance_m, min_distance_m))
    how = "overlaps" if clearance.sampled_m <= 0 else f"may come within {near} of"
    sentence = f"{a} {how} {b} at {clearance.time_s:.3f} s; {wanted} were to be kept"
    away_m, arms = clearance.distance_m, clearance.arms
    return TooNear(sentence, first=a, second=b, distance_m=away_m, required_m=min_distance_m, arms=arms)


def line_deviation(motion: ArmMotion, path: TimedPath, piece: int) -> tuple[float, float]:
    """Return how far the tip deviates from the line between two waypoints (m), and from the shortest turn (rad).

    Sampled at 1 kHz. The projection of the tip on the line tells how much of the piece is done, and so how far the tip
    should have turned. Piece k lies between waypoints k and k + 1.
    """
    begin, end = fk(motion.model, motion.waypoints[piece]), fk(motion.model, motion.waypoints[piece + 1])
    tips = _tips(motion, path, piece)
    line, turn = end.translation_m - begin.translation_m, (begin.rotation.inverse() @ end.rotation).log()
    gone, turned = tips.translation_m - begin.translation_m, (begin.rotation.inverse() @ tips.rotation).log()
    if np.linalg.norm(line) > SHORT_M:
        done = gone @ line / (line @ line)
    else:
        done = turned @ turn / max(float(turn @ turn), 1e-12)
    done = np.clip(done, 0.0, 1.0)[:, None]
    still_to_turn = (SO3.exp(done * turn).inverse() @ SO3.exp(turned)).log()
    off_m, off_rad = np.linalg.norm(gone - done * line, axis=1), np.linalg.norm(still_to_turn, axis=1)
    return float(off_m.max()), float(off_rad.max())


def vertical_deviation_m(motion: ArmMotion, path: TimedPath) -> float:
    """Return how far the tip deviates from the verticals of a transfer, along ``up``, at 1 kHz.

    The first piece (lifting) is compared with the vertical through the first waypoint, the last piece (lowering) with
    the vertical through the last waypoint.
    """
    deviations = []
    for piece, foot in ((0, 0), (len(motion.waypoints) - 2, -1)):
        off = _tips(motion, path, piece).translation_m - fk(motion.model, motion.waypoints[foot]).translation_m
        deviations.append(np.linalg.norm(off - (off @ motion.up)[:, None] * motion.up, axis=1).max())
    return float(max(deviations))


def _tips(motion: ArmMotion, path: TimedPath, piece: int) -> SE3:
    """Return the poses of the tip on a piece, at 1 kHz and at both ends."""
    begin, end = path.waypoint_times_s[piece : piece + 2]
    times: Array = np.linspace(begin, end, int(np.ceil((end - begin) / CHECK_STEP_S)) + 1)
    return fk(motion.model, path.trajectory(times))


def tip_speeds_m_s(arm: ArmMotion, q: Array, velocity: Array) -> Array:
    """Return the speeds (n,) of the tip at joints (n, 6) that move with velocities (n, 6)."""
    scale = WIDTH / np.maximum(1e-9, np.abs(velocity).max(axis=1, keepdims=True))
    ahead = fk(arm.model, np.stack([q + scale * velocity, q - scale * velocity])).translation_m
    return np.linalg.norm(ahead[0] - ahead[1], axis=1) / (2 * scale[:, 0])


def tip_use(arm: ArmMotion, motion: Trajectory) -> tuple[float, float]:
    """Return the greatest speed of the tip (m/s), and its greatest facing angle (rad), at 50 Hz and at all knots.

    Each is 0 if the arm has no such constraint.
    """
    if arm.max_tip_m_s == inf and arm.facing is None:
        return 0.0, 0.0
    times = np.union1d(motion.sample(TIP_STEP_S)[0], motion.times_s)
    q, speed, angle = motion(times), 0.0, 0.0
    if arm.max_tip_m_s < inf:
        speed = float(tip_speeds_m_s(arm, q, motion(times, 1)).max())
    if arm.facing is not None:
        angle = float(arm.facing.angle_rad(arm.T_world_base @ fk(arm.model, q)).max())
    return speed, angle
