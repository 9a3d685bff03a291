"""What every planner has to do: meet the demands of a problem, or say why it cannot."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from trocar.arms import ARMS, ArmModel
from trocar.errors import MotionRefused
from trocar.motion import ArmMotion, MotionPlan, MotionProblem, plan_motion
from trocar.motion.planners import Planner
from trocar.testing.requirement import CheckFailed, require

TOLERANCE = 1e-6
SAMPLES = 3001


def check_planner(
    planner: str | Planner, arms: Iterable[ArmModel] | None = None, *, problems: int = 10, seed: int = 0
) -> int:
    """Check a planner on random waypoints of several arms, at rest and from a moving start.

    Its answers are sampled here, independently of the checks in ``plan_motion``. A planner may refuse a problem, with a
    reason, but not all problems of an arm.

    Args:
        planner: the function, or its registered name.
        arms: to plan for; None: all that are registered.
        problems: number of problems for each arm.
        seed: of the waypoints.

    Returns:
        The number of problems that it solved.

    Raises:
        CheckFailed: the planner breaks a requirement; the message names arm and problem.
    """
    name, solved = planner if isinstance(planner, str) else getattr(planner, "__name__", repr(planner)), 0
    for arm in ARMS.values() if arms is None else arms:
        rng, before = np.random.default_rng(seed), solved
        for k in range(problems):
            asked = _random_motion(arm, rng, moving=bool(k % 2))
            plan = plan_motion(MotionProblem({"it": asked}), planner)
            solved += _check_plan(plan, asked, f"planner {name!r}, asked for problem {k} of {arm.name!r},")
        require(solved > before, f"planner {name!r}", f"solve at least one of {problems} problems of {arm.name!r}")
    return solved


def _random_motion(arm: ArmModel, rng: np.random.Generator, moving: bool) -> ArmMotion:
    points = arm.middle + rng.uniform(-0.15, 0.15, (rng.integers(2, 5), 6)) * (arm.upper - arm.lower)
    velocity = moving * rng.uniform(-0.3, 0.3, 6) * arm.motion_limits.velocity
    return ArmMotion(arm, points, arm.motion_limits, start_velocity=velocity)


def _check_plan(plan: MotionPlan, asked: ArmMotion, subject: str) -> bool:
    if not plan.found:
        require(plan.reason, subject, "give a reason when it finds no motion")
        require(plan.violations or not plan.paths, subject, "say which requirement the paths that it found violate")
        try:
            _ = plan.trajectory
        except MotionRefused:
            return False
        raise CheckFailed(f"{subject} must: raise MotionRefused when its missing trajectory is used")
    motion, times_s = plan.trajectory, np.linspace(0, plan.duration_s, SAMPLES)

    def near(value: np.ndarray, wanted: np.ndarray | float, requirement: str) -> None:
        off = float(np.abs(value - wanted).max())
        require(off <= TOLERANCE, subject, f"{requirement}, but it is off by {off:.2g}")

    near(motion(plan.waypoint_times_s["it"]), asked.waypoints, "pass every waypoint at the time that it tells")
    near(motion(0.0, 1), asked.start_velocity, "start with the velocity that the arm has")
    near(motion(times_s[-1] - 1e-9, 1), 0.0, "end at rest")
    q, limits = motion(times_s), asked.limits
    inside = np.all(q >= asked.model.lower) and np.all(q <= asked.model.upper)
    require(inside, subject, "stay within the joints' ranges")
    velocity = np.diff(q, axis=0) / times_s[1]
    acceleration = np.diff(velocity, axis=0) / times_s[1]
    for found, limit, noun in (
        (velocity, limits.velocity, "velocity"),
        (acceleration, limits.acceleration, "acceleration"),
    ):
        within = np.abs(found) <= limit * (1 + TOLERANCE) + 1e-5 * (noun == "acceleration")  # for rounding errors
        require(within.all(), subject, f"keep the limit of {noun}; it uses {np.max(np.abs(found) / limit):.6f} of it")
    require(plan.bound_s <= plan.duration_s * (1 + 1e-9), subject, f"need at least the proven {plan.bound_s:.4f} s")
    return True
